import fake_engine
import mujoco
import numpy as np
import pytest

import sweep.engines
from sweep.cli.main import main
from sweep.engines.base import Trace
from sweep.models import scene
from sweep.report import replays
from sweep.runs import batches, results
from sweep.study.config import compose


def simulated(out, *overrides):
    """A study of the fake engine in the folder `out`; the exit status of the command."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sweep.engines, "make", fake_engine.FakeEngine)
        batches.forget_engine()
        status = main(["run", "study=walk_map", "study.expect=[]", *overrides, f"out={out}"])
        batches.forget_engine()
    return status


@pytest.fixture(scope="session")
def folder(tmp_path_factory):
    """A study of 180 rollouts of the fake engine: three parameters, two replicates, one invalid column."""
    out = tmp_path_factory.mktemp("study")
    axes = ["study.axes.friction.values=[0.1,0.3,0.5,0.7,0.9,7.0]", "study.axes.step.num=5",
            "+study.axes.damping={path: drive.damping, values: [500.0, 514.26, 530.0]}"]  # fmt: skip
    assert simulated(out, *axes, "noise.position_noise=0.001", "study.replicates=2", "engine.width=60") == 3
    return out


@pytest.fixture(scope="session")
def wide(tmp_path_factory):
    """A map of 16,384 rollouts of the fake engine, of which some have a replay that was moved by hand."""
    out = tmp_path_factory.mktemp("wide")
    assert simulated(out, "study.axes.friction.num=128", "study.axes.step.num=128", "engine.width=8192") == 0
    rows, trace = results.read(out).rows, moved("scenario=pole_climb")
    for place in range(64, len(rows), 1000):
        replays.keep(out, rows.iloc[place], trace)
    return out


def moved(*overrides):
    """A trace of the robot that was never simulated: its base goes along a line, its joints swing."""
    case = compose(list(overrides)).case
    model, frames = scene.compile_model(case), 50
    time = 0.1 * (1 + np.arange(frames))
    qpos = np.tile(model.qpos0, (frames, 1))
    qpos[:, 7:25] = 0.3 * np.sin(time[:, None] + np.arange(18))
    qpos[:, :3] = np.column_stack([0.2 * time, 1.5 - 0.1 * time, 0.5 + 0 * time])
    qpos[:, 3], qpos[:, 6] = np.cos(0.1 * time), np.sin(0.1 * time)
    none, force = np.zeros((frames, 18)), np.zeros((frames, 6, 3))
    force[:, ::2, 2] = 90.0
    return Trace(
        world=case, belief=case, model=model, time=time, qpos=qpos, qvel=np.zeros((frames, model.nv)),
        joint_target=none, joint_torque=none, foot_position=force, foot_target=force, foot_force=force,
        base_target=qpos[:, :7], stage=(time > 2).astype(int), stages=("stand", "walk"), figures={},
    )  # fmt: skip


def body_places(trace, frame):
    """Where MuJoCo has the bodies (m) in a frame."""
    data = mujoco.MjData(trace.model)
    data.qpos[:] = trace.qpos[frame]
    mujoco.mj_kinematics(trace.model, data)
    return data.xpos.copy()

"""Bodies that collide in C MuJoCo: what they meet, and that it changes nothing of what passes through nothing."""

import dataclasses
from importlib.resources import files

import mujoco
import numpy as np
import pytest

from sweep.config.experiment import compose
from sweep.contract.system import judge_rollout
from sweep.core.errors import InputError
from sweep.engines import make_engine
from sweep.models.scene import compile_native_model
from sweep.study.study import make_points

OWN = frozenset({"inner_thigh", "outer_shin"})  # of a leg
FAIL = {"beam_no_flywheel", "ladder_climb"}  # the first as it is meant to
FILES = (files("sweep.conf") / "scenario").iterdir()
SCENARIOS = sorted({file.name.removesuffix(".yaml") for file in FILES} - FAIL)


def touching(model, place, angles=()):
    """Names of the geoms that meet with the base at `place`, level, and their depths (m)."""
    data = mujoco.MjData(model)
    data.qpos[:3] = place
    data.qpos[7 : 7 + len(angles)] = angles
    mujoco.mj_forward(model, data)
    return {frozenset(model.geom(int(g)).name for g in c.geom): c.dist for c in data.contact}


def test_a_base_in_a_solid_is_pushed_out():
    """10 mm into the top of a pole, whose geometry for feet it does not feel."""
    case = compose(["scenario=pole_top"]).case
    place = [0, 0, case.obstacle.height + case.robot.body_height / 2 - 0.01]
    met = touching(compile_native_model(case, 1e-3, solid=True), place)
    assert met[frozenset({"base", "pole"})] == pytest.approx(-0.01, abs=1e-6)
    assert not any("base" in pair for pair in touching(compile_native_model(case, 1e-3), place))


@pytest.mark.parametrize("robot", ["base", "three_link"])
def test_legs_meet_each_other_and_their_own_base_but_no_neighbours(robot):
    """Knees folded all the way in lay shins on thighs and over the base; straight legs meet nothing."""
    model = compile_native_model(compose([f"robot={robot}"]).case, 1e-3, solid=True)
    straight = np.tile([0.0, np.pi / 2, 0.0, 0.0, np.pi / 2, np.pi], 3)  # at 0 left knees are folded
    assert not touching(model, [0, 0, 3], straight)
    assert frozenset({"inner_thigh2_solid", "outer_shin2_solid"}) in touching(
        model, [0, 0, 3], [0.0, np.pi / 2, 0.0] * 6
    )
    rng = np.random.default_rng(0)
    met = set().union(*(touching(model, [0, 0, 3], rng.uniform(-3, 3, 18)) for _ in range(500)))
    kinds = {frozenset(name.rstrip("_solid0123456789") for name in pair) for pair in met}
    assert {frozenset({"inner_base", "shin"}), frozenset({"thigh"}), frozenset({"thigh", "shin"}), frozenset({"shin"}),
            frozenset({"inner_base", "outer_thigh"}), OWN} <= kinds  # fmt: skip
    for pair in met:
        legs = {name.removesuffix("_solid")[-1] for name in pair if name != "inner_base"}
        own = {name.rstrip("_solid0123456789") for name in pair} == OWN
        assert "inner_base" in pair or len(legs) == 2 - own, pair


def test_a_shin_meets_the_rung_that_its_foot_is_on():
    """The foot of leg 4 is on the top of rung 3, 20 mm from the edge that its shin goes out over, its knee below."""
    case = compose(["scenario=ladder_climb"]).case
    ladder, data = case.obstacle, mujoco.MjData(model := compile_native_model(case, 1e-3, solid=True))
    angles = np.zeros((6, 3))
    angles[:, 1:] = [2.4, -1.5]
    data.qpos[:3], data.qpos[7:25] = [0, 0, 3], angles.ravel()
    mujoco.mj_forward(model, data)
    knee, foot = data.body("shin4").xpos, data.site("foot4").xpos
    towards = (knee - foot) / np.linalg.norm(knee - foot)
    assert towards[2] < -0.3
    out = np.sign(towards[1])
    turn = np.array([[out, 0, 0], [0, 0, out], [0, -1, 0]])  # the ladder's rails are upright, its front faces the knee
    top = [0.3, float(ladder.mass_centre_along_rails) - 3 * ladder.rung_step, ladder.rung_depth / 2 - 0.02]
    quat = np.zeros(4)
    mujoco.mju_mat2Quat(quat, turn.ravel())
    data.qpos[25:28], data.qpos[28:32] = foot - turn @ top, quat
    mujoco.mj_forward(model, data)
    met = {frozenset(model.geom(int(g)).name for g in c.geom): c.dist for c in data.contact}
    assert met[frozenset({"pin4_solid", "rung3"})] < -0.005


def test_only_native_can_be_solid():
    with pytest.raises(InputError, match=r"engine\.solid = True is not allowed: false, or engine=native"):
        compose(["engine.solid=true"])
    assert compose(["engine=native", "engine.solid=true"]).settings.solid
    exp = compose(["engine=native", "study.axes.solid={path: engine.solid, values: [true, false]}"])
    with pytest.raises(InputError, match=r"axis engine\.solid cannot be varied"):
        make_points(exp.study, exp.system, exp.settings)


def rolled_out(exp, solid):
    """Outcome, cause and stage, and the trace of the nominal rollout."""
    engine = make_engine(dataclasses.replace(exp.settings, solid=solid), exp.case, exp.case, exp.thresholds)
    trace = engine.trace(exp.case, exp.case, np.zeros(1, int), 0)
    labels = judge_rollout(exp.system, trace.metrics, exp.thresholds, engine.stages)
    return [labels[name] for name in ("outcome", "cause", "stage")], trace


@pytest.mark.slow
@pytest.mark.parametrize("name", SCENARIOS)
def test_a_scenario_passes_through_nothing(name):
    """With solid bodies it ends the same way, with the base within 5 mm of where it is without."""
    exp = compose([f"scenario={name}", "engine=native", "engine.width=1"])
    (plain, without), (solid, touched) = (rolled_out(exp, way) for way in (False, True))
    assert plain == solid
    ends = min(len(without.time), len(touched.time))
    assert np.abs(without.qpos[:ends, :3] - touched.qpos[:ends, :3]).max() < 5e-3

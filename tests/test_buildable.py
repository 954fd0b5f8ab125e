"""The same robots are allowed in single runs, studies and on both engines; what cannot be built ends no page."""

from dataclasses import replace

import numpy as np
import pytest
from fake_engine import FakeEngine
from small_study import STUDY, one_line

from sweep.cli.main import main
from sweep.config.experiment import compose
from sweep.contract.engine import MissingTrace
from sweep.engines import batching
from sweep.engines.native import NativeEngine
from sweep.models import scene
from sweep.report import replays

COXA = "robot.coxa = 0.05 is not allowed: 0 m, or robot.legs=three_link"


def axis(path: str, *values: float, side: str = "world") -> list[str]:
    """Overrides of a study with one listed axis."""
    return [f"+study.axes.x={{path: {path}, side: {side}, values: [{', '.join(map(str, values))}]}}"]


@pytest.mark.parametrize("engine", ["mjx", "native"])
@pytest.mark.parametrize(
    ("overrides", "line"),
    [
        (["robot.coxa=0.05"], COXA),
        (axis("robot.coxa", 0, 0.05), COXA),
        (axis("robot.coxa", 0, 0.05, side="belief"), COXA),
        (axis("robot.link_radius", 0.01, 1e-9), "world.robot.link_radius = 1e-09 is not allowed: a body's mass or"),
    ],
)
def test_a_robot_that_no_engine_can_build_is_refused_before_a_rollout(tmp_path, capsys, engine, overrides, line):
    out = tmp_path / "out"
    assert main(["run", "scenario=walk_tripod", f"engine={engine}", *overrides, f"out={out}"]) == 2
    one_line(capsys.readouterr().err, line)
    assert not out.exists()


def test_a_coxa_is_allowed_where_the_legs_of_the_row_have_one(tmp_path):
    legs = "+study.axes.legs={path: robot.legs, values: [three_link]}"
    assert main(["run", "scenario=walk_tripod", legs, *axis("robot.coxa", 0.05), f"out={tmp_path}", "--dry-run"]) == 0


@pytest.mark.parametrize("height", [6.2e-5, 1e-9])
def test_a_thin_body_is_built_though_its_inertia_is_rounded(height):
    exp = compose(["scenario=walk_tripod", f"robot.body_height={height}"])
    assert scene.compile_native_model(exp.case, 1e-3).nbody == scene.compile_model(exp.case).nbody


def test_rows_that_native_cannot_build_are_invalid_and_their_reason_is_said(capsys):
    exp = compose(["scenario=stand_push", "engine=native", "manoeuvre.duration=0.1"])
    world = replace(exp.case, robot=replace(exp.case.robot, thigh_mass=np.array([0.5, 1e-20])))
    engine = NativeEngine(replace(exp.settings, width=2), exp.case, exp.case, exp.thresholds)
    figures = engine.run(world, exp.case, np.zeros(2, int))
    assert figures["finite"].tolist() == [True, False]
    one_line(capsys.readouterr().err, "1 of 2 rollouts", "MuJoCo cannot compile their models: mass and inertia")


def test_a_rollout_that_cannot_be_drawn_has_no_trace_and_the_others_have(monkeypatch):
    exp = compose(["scenario=stand_push", "manoeuvre.duration=0.1"])
    world = replace(exp.case, robot=replace(exp.case.robot, thigh_mass=np.array([0.5, 1e-20])))
    engine = NativeEngine(replace(exp.settings, width=2), exp.case, exp.case, exp.thresholds)
    first, second = engine.traces(world, exp.case, np.zeros(2, int), 1)
    assert len(batching.require_trace(first).time)
    assert isinstance(second, MissingTrace)
    assert "mass and inertia" in second.reason


def test_a_page_leaves_out_the_replay_that_cannot_be_drawn_only(tmp_path, capsys, fake_engine, monkeypatch):
    assert main(["run", *STUDY, f"out={tmp_path}"]) == 0
    draw = FakeEngine.traces

    def traces(self, *args):
        return [MissingTrace("too thin"), *draw(self, *args)[1:]]

    monkeypatch.setattr(FakeEngine, "traces", traces)
    capsys.readouterr()
    assert main(["report", str(tmp_path), "--replays", "12"]) == 0
    left_out = [line for line in capsys.readouterr().err.splitlines() if "too thin" in line]
    kept = [*(tmp_path / replays.REPLAYS_FOLDER).glob("*.json")]
    assert left_out
    assert kept
    assert len(left_out) + len(kept) == 12

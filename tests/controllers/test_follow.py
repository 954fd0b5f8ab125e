"""A manoeuvre that a scenario's file holds whole."""

import jax
import numpy as np
import pytest

from sweep.config.experiment import compose
from sweep.controllers.plan import stage_end_stances
from sweep.core.errors import InputError
from sweep.models.obstacles.surface import free_start_state

SCENARIO = """
# @package _global_
defaults: [override /obstacle: corner, override /manoeuvre: follow]
scenario: {name: touch}
plan:
  start:
    on: {base: {foot: [0.8, 0.5]}, front: {floor: [0.5, 0.3]}, middle: {floor: [0.5, 0.8]}, rear: {floor: [0.5, 1.3]}}
  up:
    base: foot
    back: {base: [0.88, 0.5, 10]}
    front: {front: {wall: [0.3, -1.6]}}
  down: {reverse: up, from: start}
"""


@pytest.fixture
def touch(tmp_path, monkeypatch):
    """A project with a scenario of its own."""
    (tmp_path / "sweep.yaml").write_text("")
    (tmp_path / "scenarios").mkdir()
    (tmp_path / "scenarios" / "touch.yaml").write_text(SCENARIO)
    monkeypatch.chdir(tmp_path)
    return tmp_path / "scenarios" / "touch.yaml"


def test_a_scenario_alone_is_a_manoeuvre_there_and_back(touch):
    case = compose(["scenario=touch", "obstacle.half_angle=0.7"]).case
    with jax.enable_x64(True):
        plan = case.manoeuvre.plan(case)
        stances = jax.tree.map(np.asarray, stage_end_stances(plan, free_start_state(case.obstacle)))
    assert plan.names == ("stand", "up.back", "up.front", "down.front", "down.back", "halt")
    front, x, z = stances.feet[2, 4:], 0.3 * 1.05, 2.3 - 1.6 * 1.05
    np.testing.assert_allclose(front, [[-x, -x / np.tan(0.7), z], [x, -x / np.tan(0.7), z]], atol=1e-6)
    assert stances.quat[2] @ stances.quat[0] == pytest.approx(np.cos(np.radians(10) / 2))
    for now, then in zip(stances, plan.start, strict=True):
        np.testing.assert_allclose(now[-1], then, atol=1e-6)


def planned():
    case = compose(["scenario=touch"]).case
    return case.manoeuvre.plan(case)


@pytest.mark.parametrize(
    ("old", "new", "told"),
    [
        ("-1.6", "0", r"foot 5 is 0\.\d+ m out of reach at the end of stage up.front"),
        ("/obstacle: corner", "/obstacle: flat", "chart floor is unknown on plane"),
        (SCENARIO[SCENARIO.index("plan:") :], "", "plan is missing: manoeuvre.kind = follow has no default plan"),
        (
            SCENARIO[SCENARIO.index("  up:") :],
            "",
            "plan is not allowed: manoeuvre.kind = follow needs a part with moves",
        ),
        ("back: {base", "back: {law: ride, base", "plan.up.back.law = ride is unknown"),
    ],
)
def test_what_a_scenario_lacks_is_told_in_one_line(touch, old, new, told):
    touch.write_text(SCENARIO.replace(old, new))
    with pytest.raises(InputError, match=told):
        planned()

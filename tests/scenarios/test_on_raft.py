"""Across water on a raft, and standing on one: speeds of monograph 4.3, and where statics says that it goes under."""

import numpy as np
import pytest
from test_on_ball import outcomes

from sweep.config.experiment import compose
from sweep.core.errors import InputError
from sweep.formulas import evaluate
from sweep.models.obstacles.raft import Raft


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        (["obstacle.density=990"], "corner .* mm under water under the robot of 16 kg"),
        (["obstacle.thickness=2", "obstacle.width=1", "obstacle.density=500"], "capsizes under the robot"),
        (["robot.body_mass=1000", "obstacle.density=500", "obstacle.length=1.6"], "obstacle.density = 500 is not"),
    ],
)
def test_a_raft_that_does_not_carry_its_robot_is_refused(changes, words):
    exp = compose(["scenario=raft_cross", *changes])
    with pytest.raises(InputError, match=words):
        exp.case.manoeuvre.plan(exp.case)


@pytest.mark.parametrize("changes", [[], ["obstacle.density=600"], ["manoeuvre.push=2"]])
def test_the_push_ends_within_reach_of_the_bank(changes):
    """Rear feet stay on the bank while raft and robot gain their speed, however heavy or fast."""
    exp = compose(["scenario=raft_cross", *changes])
    cross, plan = exp.case.manoeuvre, exp.case.manoeuvre.plan(exp.case)
    k = plan.names.index("push")
    speed = cross.push * float(cross.push_motion(exp.case).v0)
    assert 0.5 * speed * float(plan.duration[k]) <= cross.push_ratio * exp.case.robot.body_length + 1e-6


@pytest.mark.slow
@pytest.mark.parametrize("engine", ["mjx", "native"])
def test_it_crosses(engine):
    """As fast as (4.3) has it after the push, and at the other bank; nothing slips on the deck, no legs meet."""
    rows = outcomes(["scenario=raft_cross", f"engine={engine}"])
    assert rows["outcome"].tolist() == ["success"], rows["cause"]
    assert rows["push_speed_mps"][0] == pytest.approx(0.144, abs=0.005)
    assert rows["arrival_speed_mps"][0] == pytest.approx(0.1, abs=0.01)
    assert rows["deck_slip_max_m"][0] < 0.015
    assert rows["leg_gap_min_m"][0] > 0.01


@pytest.mark.slow
@pytest.mark.parametrize("engine", ["mjx", "native"])
def test_it_goes_ashore_from_a_raft_that_comes_turned(engine):
    """Pushed 0.14 m to either side of its middle: from where it then stands, and pulled in no faster than feet hold."""
    rows = outcomes(["scenario=raft_cross", f"engine={engine}"], 2, manoeuvre={"offset": np.array([-0.14, 0.14])})
    assert rows["outcome"].tolist() == ["success"] * 2, rows["cause"]
    assert rows["arrival_turn_rad"] == pytest.approx([0.25, -0.24], abs=0.025)
    assert rows["slip_max_m"].max() < 0.03


@pytest.mark.slow
def test_it_lands_on_a_bank_that_is_nearer_than_believed():
    """The raft, longer than believed too, meets it 60 mm early: the robot goes ashore there, and does not wait."""
    belief = compose(["scenario=raft_cross"]).case.obstacle_of_type(Raft)
    obstacle = {"water_width": np.array([0.99 * belief.water_width]), "length": np.array([1.01 * belief.length])}
    rows = outcomes(["scenario=raft_cross"], 1, known=False, obstacle=obstacle)
    assert rows["outcome"].tolist() == ["success"], rows["cause"]
    assert rows["duration_s"][0] < 45
    assert rows["leg_gap_min_m"][0] > 0.01


@pytest.mark.slow
def test_statics_says_how_far_it_may_go():
    """A heavy robot on a raft that floats deep: short of (4.1.28) the deck stays dry, beyond it does not."""
    load, width, length, thickness, mass = 76.0, 2.1, 3.15, 0.21, 900 * 2.1 * 3.15 * 0.21
    freeboard = thickness * 0.1 - load / (1000 * width * length)
    limit = evaluate("raft_offset_limit", {
        "tilt": freeboard / (length / 2), "P": 9.81 * (mass + load), "P_r": 9.81 * load,
        "z_s": load / (mass + load) * (thickness / 2 + 0.525), "a": length / 2, "b": width / 2, "d": thickness / 2,
    })["delta_x"]  # fmt: skip
    assert 0.2 < limit < 0.8
    overrides = ["scenario=raft_stand", "robot.body_mass=70", f"obstacle.laden={load}"]
    # The last one walks in step with the raft, whose own period in pitch is 0.9 s.
    where, swing = limit * np.array([0.8, 1.1, 0.8]), np.array([1.3, 1.3, 0.85])
    rows = outcomes(overrides, 3, manoeuvre={"ahead": where, "swing": swing})
    assert rows["outcome"].tolist() == ["success", "failure", "failure"], rows["cause"]
    assert rows["cause"][1:].tolist() == ["awash", "awash"]

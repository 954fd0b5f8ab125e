"""What each condition of a success asks for, of ways that are given: just within it and just beyond."""

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest

from sweep.metrics import clearance, depth, drives, free_bodies, rest
from sweep.metrics.geometry import base_gap, fold_gap
from sweep.metrics.outcome import limit_of
from sweep.models.obstacles.surface import FreeState, no_bodies, poses
from sweep.study.config import compose

EXPERIMENT = compose(["scenario=stand_push"])
CASE, LIMITS = EXPERIMENT.case, EXPERIMENT.thresholds
UPRIGHT, BASE = jnp.array([1.0, 0.0, 0.0, 0.0]), jnp.array([0.0, 0.0, 0.525])
# hips beside a base 0.5 m wide, thighs out and up, shins down to the ground
HIPS = np.array([[x, side * 0.25, 0.525] for x in (-0.525, 0.0, 0.525) for side in (-1, 1)])
LEGS = np.stack([HIPS, HIPS + [[0, y * 0.4, 0.0] for y in np.sign(HIPS[:, 1])],
                 HIPS + [[0, y * 0.4, -0.525] for y in np.sign(HIPS[:, 1])]], axis=1)  # fmt: skip


def moment(time: float = 0.0, legs: np.ndarray = LEGS, free: FreeState | None = None, **changes: Any) -> Any:
    """A tick of a robot that stands as it is told to."""
    free = no_bodies() if free is None else free
    none = jnp.zeros((6, 3))
    tick = {
        "joints": jnp.asarray(legs), "position": BASE, "quat": UPRIGHT, "bodies": poses(free), "free": free,
        "angles": none, "rates": none, "power": none, "torque_peak": none, "saturated": none, "effort": jnp.zeros(()),
    }  # fmt: skip
    now = {
        "target": SimpleNamespace(position=BASE, quat=UPRIGHT), "finished": jnp.asarray(False), "period": 0.02,
        "world": CASE, "stage": jnp.int32(0), "time": time, "phase": jnp.asarray(1.0),
        "plan": SimpleNamespace(duration=jnp.array([1.0])),
    }  # fmt: skip
    tick |= {name: value for name, value in changes.items() if name in tick}
    now |= {name: value for name, value in changes.items() if name in now}
    return SimpleNamespace(tick=SimpleNamespace(**tick), **now)


def judged(metric: Any, moments: list[Any], world: Any = CASE) -> tuple[dict[str, float], set[str]]:
    """Its figures of a way, and the names of the causes that hold."""
    start = SimpleNamespace(world=world, feet=jnp.asarray(LEGS[:, -1]), free=moments[0].tick.free)
    state = metric.METRIC.begin(start)
    for now in moments:
        state = metric.METRIC.update(state, now)
    end = SimpleNamespace(world=world, time=jnp.asarray(moments[-1].time), plan=moments[-1].plan)
    found = {name: float(value) for name, value in metric.METRIC.figures(state, end).items()}
    met = {cause.name for cause in metric.METRIC.causes if cause.holds(found[cause.figure], limit_of(cause, LIMITS))}
    return found, met


@pytest.mark.parametrize(("drift", "met"), [(4e-3, set()), (6e-3, {"restless"})])
def test_nothing_moves_on_when_the_plan_has_ended(drift, met):
    """Before, it may; and so may one that rests on what moves."""
    moved = LEGS + np.array([0, drift, 0])
    way = [moment(legs=LEGS - 0.3), moment(finished=jnp.asarray(True)), moment(legs=moved, finished=jnp.asarray(True))]
    found, causes = judged(rest, way)
    assert causes == met
    assert found["end_drift_m"] == pytest.approx(drift, rel=1e-3)
    carried = SimpleNamespace(position=BASE + jnp.array([0, drift, 0]), quat=UPRIGHT)
    way[2] = moment(legs=moved, finished=jnp.asarray(True), target=carried)
    assert judged(rest, way)[0]["end_drift_m"] == pytest.approx(0, abs=1e-6)


@pytest.mark.parametrize(("below", "met"), [(4e-3, set()), (6e-3, {"sunk"})])
def test_feet_stand_on_the_ground_not_in_it(below, met):
    found, causes = judged(depth, [moment(), moment(legs=LEGS - np.array([0, 0, below]))])
    assert causes == met
    assert found["depth_max_m"] == pytest.approx(below, rel=1e-3)


@pytest.mark.parametrize(
    ("what", "size", "joint", "cause"),
    [
        ("angles", 2 * np.pi / 3, 0, "overturned_leg"),
        ("rates", CASE.drive.speed_limit, 2, "overspeed"),
        ("power", CASE.drive.power_limit, 1, "overpower"),
    ],
)
def test_joints_keep_within_what_their_drives_bear(what, size, joint, cause):
    for share, met in ((0.99, set()), (1.01, {cause})):
        values = jnp.zeros((6, 3)).at[4, joint].set(-share * size)
        assert judged(drives, [moment(**{what: values}), moment(1.0)])[1] == met


@pytest.mark.parametrize(("share", "met"), [(0.4, set()), (0.6, {"overload"})])
def test_drives_are_not_at_their_limit_for_long(share, met):
    """All betas in that share of the time."""
    saturated = jnp.zeros((6, 3)).at[:, 1].set(share)
    assert judged(drives, [moment(0.02 * k, saturated=saturated) for k in (1, 2)])[1] == met


def folded(angle: float) -> np.ndarray:
    """A thigh straight out, and its shin back along it by all but `angle`."""
    knee = np.array([0.0, 0.77, 0.0])
    return np.tile([[0, 0.25, 0], knee, knee + 0.335 * np.array([0, -np.cos(angle), np.sin(angle)])], (6, 1, 1))


def test_a_shin_does_not_fold_into_its_thigh():
    """Beyond a knee's clearance c the two are 2 c sin(angle / 2) apart."""
    clear = CASE.robot.fork_ratio * CASE.robot.shin + CASE.robot.link_radius
    for angle in (0.1, 0.3, 1.0):
        gap = float(fold_gap(jnp.asarray(folded(angle)), clear))
        assert gap == pytest.approx(2 * clear * np.sin(angle / 2), abs=2e-4)
    touching = 2 * np.arcsin((CASE.robot.link_radius - 0.0025) / clear)  # as deep as allowed
    for angle, met in ((touching + 0.02, False), (touching - 0.02, True)):
        assert ("folded" in judged(clearance, [moment(legs=folded(angle))])[1]) == met


def test_a_thigh_does_not_go_through_the_base():
    """Its inner half neither: laid back over the base at 10 degrees, it is out again at its knee."""
    base = jnp.zeros(3), jnp.eye(3), replace(CASE.robot, body_length=1.05, body_width=0.5, body_height=0.1)
    over = np.array([[0, 0.25, 0.0], [0, -0.02, 0.1], [0, 0.6, 0.5]])
    legs = np.tile(LEGS[5] - [0.525, 0, 0.525], (6, 1, 1))
    free = float(base_gap(jnp.asarray(legs), *base))
    assert free == pytest.approx(CASE.robot.hip_clearance + CASE.robot.link_radius, abs=2e-3)
    along = legs.copy()
    along[:, 1] = along[:, 0] + [0.3, 0.0, 0.0]  # along the side that its hip is on, which stands back by its radius
    assert float(base_gap(jnp.asarray(along), *base)) == pytest.approx(0.0, abs=1e-3)
    legs[2] = over
    assert float(base_gap(jnp.asarray(legs), *base)) < -0.01


def ball(time: float, speed: float, turn: float = 0.0) -> FreeState:
    """That goes along x and has turned."""
    still = jnp.zeros((1, 3))
    quat = jnp.array([[np.cos(turn / 2), 0.0, np.sin(turn / 2), 0.0]])
    return FreeState(still.at[0, 0].set(speed * time), quat, still.at[0, 0].set(speed), still)


def test_a_ball_is_at_rest_when_the_plan_has_ended_not_in_the_mean_before():
    """Twelve seconds back and forth, and then it is left rolling."""
    balanced = replace(CASE, manoeuvre=compose(["scenario=ball_balance"]).case.manoeuvre)
    way = [moment(0.5 * k, free=ball(0.5 * (k % 2), 0.05), finished=jnp.asarray(k > 30)) for k in range(31)]
    rolling = [moment(15 + 0.1 * k, free=ball(0.1 * k, 0.05), finished=jnp.asarray(True)) for k in range(11)]
    assert judged(free_bodies, way + rolling, balanced)[0]["obstacle_speed_mps"] == pytest.approx(0.05, rel=0.01)
    assert judged(free_bodies, rolling[:1] * 3, balanced)[0]["obstacle_speed_mps"] == 0


def test_a_ladder_that_turns_is_told_of_though_its_centre_stays():
    way = [moment(0.0, free=ball(0, 0)), moment(1.0, free=ball(0, 0, 0.02), stage=jnp.int32(1))]
    found, _ = judged(free_bodies, way)
    assert found["obstacle_turn_max_rad"] == pytest.approx(0.02, rel=1e-3)
    assert found["obstacle_shift_m"] == 0
    assert compose(["scenario=ladder_climb"]).thresholds.obstacle_turn_max_rad == 1e-3


@pytest.mark.parametrize("scenario", ["walk_tripod", "raft_cross", "ball_climb", "ladder_climb", "stand_push"])
def test_every_manoeuvre_has_a_limit_of_slip(scenario):
    assert compose([f"scenario={scenario}"]).thresholds.slip_max_m <= 0.1

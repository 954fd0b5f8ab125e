"""What each condition of a success asks for, of ways that are given: just within it and just beyond."""

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest

from sweep.config.experiment import compose
from sweep.core.constants import GRAVITY
from sweep.core.outcomes import GOAL_MISSED
from sweep.metrics import attitude, clearance, depth, drives, free_bodies, rest, shins, slip, solver
from sweep.metrics.outcome import threshold_value
from sweep.metrics.tick import MetricContext, RolloutEnd, RolloutStart
from sweep.models.geometry import leg_base_gap, thigh_shin_gap
from sweep.models.obstacles.surface import FreeBodyState, body_poses, empty_free_body_state
from sweep.models.robot import total_mass

EXPERIMENT = compose(["scenario=stand_push"])
CASE = EXPERIMENT.case
UPRIGHT, BASE = jnp.array([1.0, 0.0, 0.0, 0.0]), jnp.array([0.0, 0.0, 0.525])
# hips beside a base 0.5 m wide, thighs out and up, shins down to the ground
HIPS = np.array([[x, side * 0.25, 0.525] for x in (-0.525, 0.0, 0.525) for side in (-1, 1)])
LEGS = np.stack([HIPS, HIPS + [[0, y * 0.4, 0.0] for y in np.sign(HIPS[:, 1])],
                 HIPS + [[0, y * 0.4, -0.525] for y in np.sign(HIPS[:, 1])]], axis=1)  # fmt: skip


def moment(time: float = 0.0, legs: np.ndarray = LEGS, free: FreeBodyState | None = None, **changes: Any) -> Any:
    """A tick of a robot that stands as it is told to."""
    free = empty_free_body_state() if free is None else free
    none = jnp.zeros((6, 3))
    tick = {
        "joints": jnp.asarray(legs), "bodies": body_poses(free), "power": none, "torque_peak": none, "saturated": none,
        "positive_work": jnp.zeros(()), "work": jnp.zeros(()), "energy": jnp.zeros(()), "residual": jnp.zeros(()),
    }  # fmt: skip
    truth = {"position": BASE, "quat": UPRIGHT, "free": free, "angles": none, "rates": none,
             "loaded": jnp.ones(6, bool)}  # fmt: skip
    now = {
        "target": SimpleNamespace(position=BASE, quat=UPRIGHT),
        "reference": SimpleNamespace(position=BASE, quat=UPRIGHT), "finished": jnp.asarray(False), "period": 0.02,
        "world": CASE, "stage": jnp.int32(0), "time": time, "phase": jnp.asarray(1.0),
        "plan": SimpleNamespace(duration=jnp.array([1.0]), swing=jnp.zeros((1, 6), bool)),
        "stage_start": BASE, "shortfall": jnp.zeros(()),
    }  # fmt: skip
    tick, truth, now = ({name: changes.get(name, value) for name, value in part.items()} for part in (tick, truth, now))
    return MetricContext(**now, report=SimpleNamespace(actual=SimpleNamespace(**truth), **tick))


def judged(metric: Any, moments: list[Any], experiment: Any = EXPERIMENT) -> tuple[dict[str, float], set[str]]:
    """Its figures of a way, and the names of the causes that hold, a goal's by its threshold."""
    world, limits, first = experiment.case, experiment.thresholds, moments[0].report
    start = RolloutStart(
        world, moments[0].plan, BASE, UPRIGHT, jnp.asarray(LEGS[:, -1]), first.actual.free, first.energy
    )
    state = metric.METRIC.begin(start)
    for now in moments:
        state = metric.METRIC.update(state, now._replace(world=world))
    end = RolloutEnd(world, moments[-1].plan, jnp.asarray(moments[-1].time), jnp.int32(0))
    found = {name: float(value) for name, value in metric.METRIC.compute(state, end).items()}
    met = {c for c in metric.METRIC.causes if c.holds(found[c.metric], threshold_value(c, limits))}
    return found, {c.threshold if c.name == GOAL_MISSED else c.name for c in met}


def turned(degrees: float, axis: int) -> Any:
    """A quaternion of that turn about an axis."""
    half = np.radians(degrees) / 2
    return jnp.array([np.cos(half), 0.0, 0.0, 0.0]).at[1 + axis].set(np.sin(half))


@pytest.mark.parametrize(
    ("quat", "met"),
    [
        (turned(19, 0), set()),
        (turned(21, 1), {"fell"}),
        (turned(-4.9, 2), set()),
        (turned(-5.1, 2), {"off_course"}),
    ],
)
def test_a_base_that_leans_has_fallen_and_one_that_turns_is_off_course(quat, met):
    """Of what it is told to do: told to lean or turn, it has done neither."""
    assert judged(attitude, [moment(quat=quat), moment()])[1] == met
    told = SimpleNamespace(position=BASE, quat=quat)
    assert judged(attitude, [moment(quat=quat, reference=told), moment()])[1] == set()


@pytest.mark.parametrize(("way", "met"), [(0.019, set()), (0.021, {"slipped"})])
def test_a_standing_foot_stays_where_it_took_hold(way, met):
    legs = LEGS.copy()
    legs[3, -1] += [0.6 * way, 0.8 * way, 0.0]
    assert judged(slip, [moment(), moment(legs=legs)], compose(["scenario=walk_tripod"]))[1] == met


@pytest.mark.parametrize(("rise", "met"), [(0.01, set()), (-0.01, {"shin_under_face"})])
def test_a_shin_stays_over_the_face_that_its_foot_stands_on(rise, met):
    legs = LEGS.copy()
    legs[1, 1] = legs[1, 2] + [0.0, -0.335, rise]
    assert judged(shins, [moment(), moment(legs=legs)])[1] == met


def lowered(part: str, above: float) -> Any:
    """A moment with the base's underside, or a knee's, that high (m) above the floor."""
    if part == "base":
        return moment(position=jnp.array([0.0, 0.0, CASE.robot.body_height / 2 + above]))
    legs = LEGS.copy()
    legs[2, 1:, 2] = CASE.robot.link_radius + above, 0.3  # under its lifted foot
    return moment(legs=legs)


@pytest.mark.parametrize("part", ["base", "knee"])
def test_neither_base_nor_links_go_into_the_ground(part):
    """5 mm are what shells give way."""
    for above, met in ((-4e-3, set()), (-6e-3, {"link_collision"})):
        found, causes = judged(clearance, [moment(), lowered(part, above)])
        assert causes == met
        assert found["clearance_min_m"] == pytest.approx(above, abs=1e-4)


def test_legs_do_not_go_through_each_other():
    for apart, met in ((-4e-3, set()), (-6e-3, {"leg_crossing"})):
        legs = LEGS.copy()
        legs[4] = legs[2] + [2 * CASE.robot.link_radius + apart, 0, 0]
        found, causes = judged(clearance, [moment(legs=legs)])
        assert causes == met
        assert found["leg_gap_min_m"] == pytest.approx(apart, abs=1e-4)


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
        gap = float(thigh_shin_gap(jnp.asarray(folded(angle)), clear))
        assert gap == pytest.approx(2 * clear * np.sin(angle / 2), abs=2e-4)
    touching = 2 * np.arcsin((CASE.robot.link_radius - 0.0025) / clear)  # as deep as allowed
    for angle, met in ((touching + 0.02, False), (touching - 0.02, True)):
        assert ("folded" in judged(clearance, [moment(legs=folded(angle))])[1]) == met


def test_a_thigh_does_not_go_through_the_base():
    """Its inner half neither: laid back over the base at 10 degrees, it is out again at its knee."""
    base = jnp.zeros(3), jnp.eye(3), replace(CASE.robot, body_length=1.05, body_width=0.5, body_height=0.1)
    over = np.array([[0, 0.25, 0.0], [0, -0.02, 0.1], [0, 0.6, 0.5]])
    legs = np.tile(LEGS[5] - [0.525, 0, 0.525], (6, 1, 1))
    free = float(leg_base_gap(jnp.asarray(legs), *base))
    assert free == pytest.approx(CASE.robot.hip_clearance + CASE.robot.link_radius, abs=2e-3)
    along = legs.copy()
    along[:, 1] = along[:, 0] + [0.3, 0.0, 0.0]  # along the side that its hip is on, which stands back by its radius
    assert float(leg_base_gap(jnp.asarray(along), *base)) == pytest.approx(0.0, abs=1e-3)
    legs[2] = over
    assert float(leg_base_gap(jnp.asarray(legs), *base)) < -0.01
    found = [judged(clearance, [moment(legs=legs, position=jnp.zeros(3))])[1] for legs in (along, legs)]
    assert [("base_hit" in met) for met in found] == [False, True]


def ball(time: float, speed: float, turn: float = 0.0) -> FreeBodyState:
    """That goes along x and has turned."""
    still = jnp.zeros((1, 3))
    quat = jnp.array([[np.cos(turn / 2), 0.0, np.sin(turn / 2), 0.0]])
    return FreeBodyState(still.at[0, 0].set(speed * time), quat, still.at[0, 0].set(speed), still)


def test_a_ball_is_at_rest_when_the_plan_has_ended_not_in_the_mean_before():
    """Twelve seconds back and forth, and then it is left rolling."""
    balanced = compose(["scenario=ball_balance"])
    way = [moment(0.5 * k, free=ball(0.5 * (k % 2), 0.05), finished=jnp.asarray(k > 30)) for k in range(31)]
    rolling = [moment(15 + 0.1 * k, free=ball(0.1 * k, 0.05), finished=jnp.asarray(True)) for k in range(11)]
    found, met = judged(free_bodies, way + rolling, balanced)
    assert found["obstacle_speed_mps"] == pytest.approx(0.05, rel=0.01)
    assert "obstacle_speed_error_max_mps" in met
    found, met = judged(free_bodies, rolling[:1] * 3, balanced)
    assert found["obstacle_speed_mps"] == 0
    assert "obstacle_speed_error_max_mps" not in met


def test_a_ladder_that_turns_is_told_of_though_its_centre_stays():
    ladder = compose(["scenario=ladder_climb"])
    for turn, met in ((0.9e-3, set()), (1.1e-3, {"obstacle_turned"})):
        way = [moment(0.0, free=ball(0, 0)), moment(1.0, free=ball(0, 0, turn), stage=jnp.int32(1))]
        found, causes = judged(free_bodies, way, ladder)
        assert causes == met
        assert found["obstacle_turn_max_rad"] == pytest.approx(turn, rel=1e-2)
        assert found["obstacle_shift_m"] == 0


def test_a_ladder_stands_still_once_it_has_come_to_rest():
    ladder = compose(["scenario=ladder_climb"])
    for shift, met in ((0.9e-3, set()), (1.1e-3, {"obstacle_shifted"})):
        way = [moment(0.0, free=ball(0, 0)), moment(1.0, free=ball(1.0, 0.01))]
        way.append(moment(2.0, free=ball(1.0, 0.01 + shift), stage=jnp.int32(1)))
        assert judged(free_bodies, way, ladder)[1] == met


@pytest.mark.parametrize("scenario", ["walk_tripod", "raft_cross", "ball_climb", "ladder_climb", "stand_push"])
def test_every_manoeuvre_has_a_limit_of_slip(scenario):
    assert compose([f"scenario={scenario}"]).thresholds.slip_max_m <= 0.1


@pytest.mark.parametrize(
    ("residual", "ticks", "met"),
    [(1.9, 1, set()), (2.1, 1, {"solver"}), (0.2, 2, set()), (0.2, 3, {"unsettled"}), (0.09, 9, set())],
)
def test_forces_that_the_solver_leaves_are_doubted(residual, ticks, met):
    """In weights, and ticks of 10 s: a half of a hundredth is two and a half."""
    left = jnp.asarray(residual * GRAVITY * total_mass(CASE.robot))
    assert judged(solver, [moment(), *[moment(10.0, residual=left)] * ticks])[1] == met


@pytest.mark.parametrize(("share", "met"), [(0.0045, set()), (0.0055, {"energy"})])
def test_energy_that_no_drive_has_given_is_doubted(share, met):
    """Compared with the drives' work and the weight at the height of the body's length."""
    most = 1000 + GRAVITY * total_mass(CASE.robot) * CASE.robot.body_length
    gives = {"work": jnp.asarray(800.0), "positive_work": jnp.asarray(1000.0)}
    way = [moment(), moment(10.0, energy=jnp.asarray(800 + share * most), **gives)]
    assert judged(solver, way)[1] == met

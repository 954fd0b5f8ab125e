"""The plan of the hexagonal robot's walk: the thesis' worked example, and what its steps promise."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from sweep.config.experiment import compose
from sweep.controllers.plan import Plan, reference_stance
from sweep.core.errors import InputError
from sweep.engines.batching import nominal_plan
from sweep.manoeuvres.walking.waypoints import CIRCLE, TRIPODS, WAYPOINTS
from sweep.models.case import Case
from sweep.models.posture import Stance, joint_targets

# Largest steps of the thesis' legs 1 to 6 on its three segments: in transfer for 1, 3, 5, in support for 2, 4, 6.
LIMITS = [
    [2.0019107401881766, 1.2175654419436563, 1.258801978162732] * 2,
    [2.5460025385461305, 0.7071067811875474, 2.5460025385461305] * 2,
    [2.0249289365378558, 1.3518377153320622, 1.1963012800406048] * 2,
]
PHI_MAX = 0.7762790307403773
LENGTHS = ("mount_radius", "coxa", "thigh", "shin")
DT = 1e-4
U = np.sort([*np.linspace(0, 1, 51), 0.5 - DT, 1 - DT])


pytestmark = pytest.mark.usefixtures("double")


@pytest.fixture(scope="module")
def case() -> Case:
    return compose(["scenario=hexagon_waypoints", "manoeuvre.phase_time=1", "manoeuvre.deepening=0"]).case


@jax.jit
def play(case: Case, phases: jax.Array) -> tuple[Plan, Stance, tuple[jax.Array, jax.Array]]:
    """The plan, its references at `phases` of every stage (S, U, ...), their joint angles and shortfalls."""
    plan = case.manoeuvre.plan(case)

    def stage(begin, k):
        stance = jax.vmap(lambda u: reference_stance(plan, k, u, *begin))(phases)
        return (stance.feet[-1], stance.position[-1]), stance

    stances = jax.lax.scan(stage, (plan.start.feet, plan.start.position), jnp.arange(len(plan.names)))[1]
    return plan, stances, jax.vmap(jax.vmap(lambda s: joint_targets(case.robot, s)))(stances)


def test_largest_steps_are_those_of_the_example(case):
    segments = np.diff(WAYPOINTS, axis=0)
    for segment, expected in zip(segments, LIMITS, strict=True):
        largest = case.manoeuvre.largest_step_by_leg(case.robot, jnp.asarray(segment / np.linalg.norm(segment)))
        np.testing.assert_allclose(largest[np.array(CIRCLE) - 1], expected, rtol=1e-9)


def test_steps_are_the_share_of_the_limit_or_half_of_what_is_left(case):
    lengths = np.linalg.norm(np.diff(WAYPOINTS, axis=0), axis=1)
    expected = []
    for length, limits in zip(lengths, LIMITS, strict=True):
        largest = 0.95 * min(limits)
        full = int(length // (2 * largest))
        expected += [largest] * full + [(length - 2 * full * largest) / 2]
    steps = np.linalg.norm(case.manoeuvre.gait_cycle_steps(case.robot), axis=1)
    np.testing.assert_allclose(steps, expected + [0.0] * (len(steps) - len(expected)), rtol=1e-9)


def test_body_passes_through_the_way_points(case):
    plan = case.manoeuvre.plan(case)
    np.testing.assert_allclose(plan.start.position, [0, 0, 2 - np.sqrt(0.5)], atol=1e-12)
    for point in np.array(WAYPOINTS)[1:]:
        assert np.linalg.norm(plan.position[:, :2] - point, axis=1).min() < 1e-12
    np.testing.assert_allclose(plan.position[-1, :2], WAYPOINTS[-1], atol=1e-12)
    active = plan.duration[1:-1] == 1
    assert active.sum() == 14
    assert np.all(plan.duration[1:-1][~active] < 0.05)


def test_cycles_end_at_home(case):
    plan, stances, _ = play(case, U)
    home = plan.start.feet - plan.start.position
    ends = stances.feet[:, -1] - stances.position[:, -1, None]
    np.testing.assert_allclose(ends[2:-1:2], np.broadcast_to(home, ends[2:-1:2].shape), atol=1e-12)


def test_no_foot_leaves_its_workspace(case):
    _, stances, (joints, shortfall) = play(case, U)
    assert shortfall.max() == 0
    assert np.abs(joints[..., 0]).max() < PHI_MAX
    below = stances.feet[..., 2] - stances.position[..., None, 2]
    assert below.max() < -1 + 1e-9  # l2 - l3: the highest that (19) leaves the inner radius at l1


def test_standing_feet_stand_still_and_others_swing(case):
    plan, stances, _ = play(case, U)
    moved = np.linalg.norm(stances.feet - stances.feet[:, :1], axis=-1).max(axis=1)
    assert np.all(moved[~plan.swing] == 0)
    assert np.all(moved[1:15][plan.swing[1:15]] > 0.1)
    np.testing.assert_array_equal(np.flatnonzero(plan.swing[1]) + 1, sorted(TRIPODS[0]))
    np.testing.assert_allclose(stances.feet[1:15, :, :, 2].max(axis=(1, 2)), 1 - np.sqrt(0.5), rtol=1e-9)  # h


def test_feet_touch_down_without_speed(case):
    _, stances, _ = play(case, U)
    feet = stances.feet[1:15]
    middle, end = (np.linalg.norm(feet[:, k] - feet[:, k - 1], axis=-1) / DT for k in (np.searchsorted(U, 0.5), -1))
    assert middle.max() > 5
    assert end.max() < 2e-3


def test_other_robots_in_one_batch_get_there_too(case):
    random = np.random.default_rng(0)
    n = 32
    sizes = {name: getattr(case.robot, name) * random.uniform(0.9, 1.1, n) for name in LENGTHS}
    axes = jax.tree.map(lambda _: None, case)
    axes = replace(axes, robot=replace(axes.robot, **dict.fromkeys(LENGTHS, 0)))
    robots = replace(case, robot=replace(case.robot, **sizes))
    plan, _, (_, shortfall) = jax.vmap(play, in_axes=(axes, None))(robots, U)
    assert np.all(shortfall == 0)
    np.testing.assert_allclose(plan.position[:, -2, :2], np.broadcast_to(WAYPOINTS[-1], (n, 2)), atol=1e-9)


def test_too_few_cycles_are_out_of_reach(case):
    short = replace(case, manoeuvre=replace(case.manoeuvre, cycles=5))
    _, _, (_, shortfall) = play(short, U)
    assert shortfall[:-1].max() == 0
    assert shortfall[-1].max() > 0.1


def test_a_shin_that_is_too_short_is_refused_by_name(case):
    short = replace(case, robot=replace(case.robot, shin=0.5))
    with pytest.raises(InputError, match=r"robot\.shin = 0\.5 is not allowed: greater than robot\.thigh = 1 m"):
        nominal_plan(short)


def test_a_nominal_plan_that_is_not_finite_is_refused(case):
    """Legs folded at home have their feet inside the sector that they may use: thesis (18)-(21) give no step."""
    with pytest.raises(InputError, match="manoeuvre = waypoints on obstacle = plane has no plan"):
        nominal_plan(replace(case, manoeuvre=replace(case.manoeuvre, psi=0.5, gamma=-3.1)))

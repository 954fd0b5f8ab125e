"""The plan from the floor on to a pole and up it, and the paths of the base that it is made of."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from playing import play_case, vary_lengths

from sweep.config.experiment import compose
from sweep.controllers.plan import Plan, Stage, reference_stance, transform_plan
from sweep.core.rotations import exponential, matrix, rotate
from sweep.formulas.leg import SIDE_BY_LEG
from sweep.formulas.stepping import LANDING_RATIO
from sweep.models.case import Case
from sweep.models.posture import Stance, joint_targets
from sweep.models.robot import length_unit
from sweep.planning.compile_plan import compile_plan
from sweep.planning.plan_table import evaluate_plan

U = np.linspace(0, 1, 41)
RADIUS, HALF, D, D_C = 0.42, 0.525, 0.525, 0.4935  # m: r, a_r / 2, d, d_c
X_STAR = 0.105 * LANDING_RATIO


pytestmark = pytest.mark.usefixtures("double")


@pytest.fixture(scope="module")
def case() -> Case:
    return compose(["scenario=pole_climb"]).case


@jax.jit
def play(case: Case) -> tuple[Plan, Stance, jax.Array]:
    """The plan, its references at `U` of every stage (S, U, ...) and how far feet are out of reach."""
    plan = case.manoeuvre.plan(case)
    return plan, *play_plan(case, plan)


def play_plan(case: Case, plan: Plan) -> tuple[Stance, jax.Array]:
    def stage(begin, k):
        stance = jax.vmap(lambda u: reference_stance(plan, k, u, *begin))(jnp.asarray(U))
        return (stance.feet[-1], stance.position[-1]), stance

    stances = jax.lax.scan(stage, (plan.start.feet, plan.start.position), jnp.arange(len(plan.names)))[1]
    return stances, jax.vmap(jax.vmap(lambda s: joint_targets(case.robot, s)[1]))(stances)


def draws(case: Case, n: int) -> tuple[Case, Case]:
    """Cases with sizes up to 2 % off, and their batch axes."""
    random = np.random.default_rng(0)

    def off(group, *names):
        return {name: getattr(group, name) * random.uniform(0.98, 1.02, n) for name in names}

    robot, pole = off(case.robot, "body_length", "body_width", "thigh", "shin"), off(case.obstacle, "radius")
    axes = jax.tree.map(lambda _: None, case)
    axes = replace(axes, robot=replace(axes.robot, **dict.fromkeys(robot, 0)),
                   obstacle=replace(axes.obstacle, **dict.fromkeys(pole, 0)))  # fmt: skip
    return replace(case, robot=replace(case.robot, **robot), obstacle=replace(case.obstacle, **pole)), axes


def test_all_feet_are_always_in_reach(case):
    assert play(case)[2].max() == 0


def test_feet_come_on_to_the_pole_a_little_inside_it(case):
    plan, _, _ = play(case)
    first = plan.names.index("on.rear")
    feet = plan.foothold[first:]
    np.testing.assert_allclose(np.hypot(feet[..., 0], feet[..., 1]), RADIUS - 5e-3, atol=1e-12)
    assert np.all(np.sign(feet[..., 0]) == SIDE_BY_LEG)
    np.testing.assert_allclose(plan.foothold[: plan.names.index("on.front"), :, 2], 0, atol=1e-12)


def test_feet_and_base_end_as_the_gallop_started_it_higher_by_nine_landings(case):
    plan, stances, _ = play(case)
    height = D + HALF + 9 * X_STAR
    np.testing.assert_allclose(stances.position[-1, -1], [0, D_C, height], atol=1e-9)
    offsets = np.repeat([X_STAR - HALF, 0, HALF - X_STAR], 2)
    np.testing.assert_allclose(plan.foothold[-1, :, 2], height + offsets, atol=1e-9)
    np.testing.assert_allclose(plan.foothold[-1, :, 1], 0, atol=1e-9)


def test_the_base_comes_to_stand_vertical_facing_up(case):
    _, stances, _ = play(case)
    forward, _, upward = np.asarray(matrix(stances.quat[-1, -1])).T
    np.testing.assert_allclose(forward, [0, 0, 1], atol=1e-9)
    np.testing.assert_allclose(upward, [0, 1, 0], atol=1e-9)


def test_its_edges_run_on_two_rails_while_it_pitches_up(case):
    plan, stances, _ = play(case)
    first = plan.names.index("on.front")
    quat, position = (x[first : first + 5].reshape(-1, x.shape[-1]) for x in (stances.quat, stances.position))
    front, rear = (rotate(quat, np.broadcast_to([x, 0.0, 0.0], position.shape)) + position for x in (HALF, -HALF))
    sizes = evaluate_plan(case)["sizes"]
    np.testing.assert_allclose(front[:, 1], D_C + 2 * HALF * sizes["away"], atol=1e-9)
    np.testing.assert_allclose(rear[:, 2], D - 2 * HALF * sizes["lower"], atol=1e-9)
    _, along, rise = (front - rear).T
    pitch = np.arctan2(rise, -along)
    assert np.all(np.diff(pitch) > -1e-9)
    after = [*(sizes[f"pitch{k}"] for k in range(1, 5)), 90]
    np.testing.assert_allclose(pitch.reshape(5, -1)[:, -1], np.radians(after), atol=1e-7)


def test_the_pitch_rate_does_not_jump_between_stages(case):
    plan, _, _ = play(case)
    first = plan.names.index("on.front")
    rates = (plan.path.rates * plan.path.arc[:, None] / plan.duration[:, None])[first : first + 5]
    np.testing.assert_allclose(rates[:-1, 1], rates[1:, 0], rtol=1e-12)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(2, 5))
def test_no_link_is_in_the_pole(case, seed):
    """Nor in the base or another leg, for sizes up to 2 % off; feet pressed in by 5 mm as they are."""
    plan, at = play_case(vary_lengths(case, 0.02, seed))
    first = plan.names.index("place.1-4-5")
    assert at["links"].min() > -0.003  # shins down to the feet, which are pressed in; the judge allows 5 mm
    assert at["legs"].min() > 0.02
    assert at["body"].min() > 0.01  # of thighs along the sides their hips are on, at the pole's foot
    assert at["base"].min() > 0.015
    assert at["reach"].min() > 0
    on = plan.names.index("on.nearer")  # from where on feet stand on the pole
    assert at["support"][first:on].min() > 0.08
    assert np.isinf(at["support"][on:]).all()


def test_swings_on_the_pole_stay_outside_it(case):
    plan, stances, _ = play(case)
    first = plan.names.index("up.middle")
    distance = np.hypot(stances.feet[first:, :, :, 0], stances.feet[first:, :, :, 1])
    assert distance.min() > RADIUS - 5e-3 - 1e-9
    swinging = np.broadcast_to(np.asarray(plan.swing)[first:-1, None], distance[:-1].shape)
    assert distance[:-1][swinging].max() > RADIUS + 0.02


def test_the_plan_follows_what_is_believed(case):
    cases, axes = draws(case, 16)
    plan, stances, shortfall = jax.vmap(play, in_axes=(axes,))(cases)
    assert shortfall.max() == 0
    last = plan.foothold[:, -1]
    grip = np.broadcast_to(cases.obstacle.radius[:, None] - 5e-3, last.shape[:2])
    np.testing.assert_allclose(np.hypot(last[..., 0], last[..., 1]), grip, atol=1e-12)
    height = cases.robot.body_length / 2 + length_unit(cases.robot) * (0.5 + 0.9 * LANDING_RATIO)
    np.testing.assert_allclose(stances.position[:, -1, -1, 2], height, rtol=1e-12)


def test_a_plan_may_be_made_anywhere(case):
    """Turning and shifting a plan is the same as turning and shifting where it leads."""
    plan, stances, _ = play(case)
    quat, by = exponential(jnp.array([0.0, 0.0, 0.7])), jnp.array([1.0, -2.0, 0.3])
    there, shortfall = play_plan(case, transform_plan(plan, quat, by))
    for before, after in ((stances.feet, there.feet), (stances.position, there.position)):
        expected = rotate(jnp.broadcast_to(quat, (*before.shape[:-1], 4)), before) + by
        np.testing.assert_allclose(after, expected, atol=1e-9)
    assert shortfall.max() == 0


def base_path(start: jax.Array, phase: jax.Array, **fields) -> jax.Array:
    """Positions of the base in a stage of these fields."""
    stance = Stance(jnp.zeros((6, 3)), start, jnp.array([1.0, 0, 0, 0]))

    @jax.jit
    def path(phase):
        plan = compile_plan(stance, [Stage("moves", 1.0, **fields)], 0.0)
        return jax.vmap(lambda u: reference_stance(plan, jnp.int32(0), u, stance.feet, start).position)(phase)

    return path(phase)


def test_arcs_are_straight_circular_or_elliptic():
    start, end, pivot = jnp.array([2.0, 0, 0]), jnp.array([0, 1.0, 0]), jnp.array([0.0, 0, 0])
    way = base_path(start, jnp.asarray(U), position=end, pivot=pivot, arc=jnp.pi / 2)
    np.testing.assert_allclose(way[:, 0], 2 * np.cos(np.pi / 2 * U), atol=1e-12)
    np.testing.assert_allclose(way[:, 1], np.sin(np.pi / 2 * U), atol=1e-12)
    straight = base_path(start, jnp.asarray(U), position=end, pivot=pivot + 5, arc=0.0)
    np.testing.assert_allclose(straight, start + U[:, None] * (end - start), atol=1e-12)


def test_a_steady_pace_has_the_rates_that_it_is_given():
    rates = (0.3, 1.6)
    ends = jnp.array([0.0, 1.0])
    way, rate = jax.jvp(
        lambda phase: base_path(jnp.zeros(3), phase, position=jnp.array([1.0, 0, 0]), rates=rates)[:, 0],
        (ends,), (jnp.ones(2),),
    )  # fmt: skip
    np.testing.assert_allclose(rate, rates, atol=1e-12)
    np.testing.assert_array_equal(way, ends)

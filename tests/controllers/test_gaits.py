"""Regular gaits: every leg swings in turn, about its own centre, and the body goes on as far as the steps do."""

import jax.numpy as jnp
import numpy as np
import pytest

from sweep.controllers.plan import CYCLE_A, CYCLE_B, CYCLE_B_SMOOTH, HALF_ELLIPSE, swing_progress_and_lift
from sweep.models.posture import Stance
from sweep.planning.compile_plan import compile_plan
from sweep.planning.gaits import GAITS, GaitStep, body_advance_per_swing, initial_foot_offsets, regular_gait_stages

STEP = GaitStep(0.105, 0.03, 1.2)
CENTRES = jnp.asarray(np.random.default_rng(0).normal(size=(6, 3))).at[:, 2].set(0)
FORWARD = jnp.array([1.0, 0.0, 0.0])


def plan_of(name, cycles=3):
    gait = GAITS[name]
    start = CENTRES + initial_foot_offsets(gait, STEP, FORWARD)
    stance = Stance(start, jnp.zeros(3), jnp.array([1.0, 0, 0, 0]))
    stages = regular_gait_stages(gait, STEP, stance, CENTRES, FORWARD, cycles * len(gait), 0.0)
    return gait, compile_plan(stance, stages, 0.1)


@pytest.mark.parametrize("name", GAITS)
def test_every_leg_swings_in_every_cycle(name):
    gait, plan = plan_of(name)
    swings = np.asarray(plan.swing).reshape(3, len(gait), 6).sum(axis=1)
    assert np.all(swings == [[sum(leg in legs for legs in gait) for leg in range(1, 7)]])
    assert swings.min() >= 1


@pytest.mark.parametrize("name", GAITS)
def test_the_gait_repeats_from_the_start(name):
    """After a cycle the feet stand about the body as at the start: the start belongs to the regular cycle."""
    gait, plan = plan_of(name)
    start = np.asarray(plan.start.feet - plan.start.position)
    for cycle in range(3):
        k = (cycle + 1) * len(gait) - 1
        np.testing.assert_allclose(plan.foothold[k] - plan.position[k], start, atol=1e-6)


@pytest.mark.parametrize(("name", "k_prime"), [("tripod", 2), ("gallop", 1), ("level_gallop", 1)])
def test_speed_is_v_o(name, k_prime):
    """v_o = k' x*/t*: gallop half as fast as tripod; (1.3.2)."""
    _, plan = plan_of(name)
    speed = float(plan.position[-1, 0] / plan.duration.sum())
    assert speed == pytest.approx(k_prime * STEP.half_swing_length / STEP.time, rel=1e-5)
    assert body_advance_per_swing(GAITS[name], STEP) == pytest.approx(k_prime * STEP.half_swing_length)


@pytest.mark.parametrize("name", ["tripod", "gallop", "level_gallop"])
def test_feet_swing_from_minus_to_plus_x_star(name):
    """About their centres, which go with the body."""
    gait, plan = plan_of(name)
    position = np.concatenate([plan.start.position[None], plan.position])
    feet = np.concatenate([plan.start.feet[None], plan.foothold])
    for k in range(len(plan.duration)):
        for leg in gait[k % len(gait)]:
            before, after = (feet[i, leg - 1] - position[i] - CENTRES[leg - 1] for i in (k, k + 1))
            np.testing.assert_allclose([-before[0], after[0]], float(STEP.half_swing_length), atol=1e-6)


@pytest.mark.parametrize("cycle", [CYCLE_A, CYCLE_B, CYCLE_B_SMOOTH, HALF_ELLIPSE])
@pytest.mark.parametrize("carry", [0.0, 0.5])
def test_swings_start_and_end_on_the_ground(cycle, carry):
    share, height = zip(
        *[swing_progress_and_lift(jnp.int32(cycle), carry, jnp.asarray(u)) for u in (0.0, 0.5, 1.0)], strict=True
    )
    np.testing.assert_allclose(share, [0, 0.5, 1], atol=1e-6)
    np.testing.assert_allclose([height[0], height[2]], 0, atol=1e-6)
    assert height[1] >= 1

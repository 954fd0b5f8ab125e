"""Programmed support, feet that are pressed into a ball, and stages that end with an event."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from sweep.config.experiment import compose
from sweep.controllers import tracker
from sweep.controllers.observation import Observation
from sweep.controllers.plan import (
    GRIP,
    KEPT,
    MEASURED,
    RESTS,
    STAYS,
    TO_POSE,
    TO_VELOCITY,
    TOGETHER,
    Stage,
    SupportMotion,
)
from sweep.controllers.reference_body_motion import FreeBodyReferenceMotion, free_body_reference_state
from sweep.core.rotations import exponential, logarithm
from sweep.manoeuvres.balancing.ball import stance_on_ball, stand_pose
from sweep.models.case import Manoeuvre
from sweep.models.frames import body_frame_number, koenig_frame_number
from sweep.models.obstacles.surface import FreeBodyState, free_start_state
from sweep.models.posture import Stance, joint_targets
from sweep.planning.compile_plan import compile_plan

CASE = compose(["scenario=ball_balance"]).case
PERIOD, TIME = 4e-3, 2.0


def bodies(x, angle, speed, rate):
    """Two of them on the x axis, turned and turning about y."""
    place, turn = (jnp.zeros((2, 3)).at[:, k].set(jnp.asarray(v)) for k, v in ((0, x), (1, angle)))
    velocity, rates = (jnp.zeros((2, 3)).at[:, k].set(jnp.asarray(v)) for k, v in ((0, speed), (1, rate)))
    return FreeBodyState(place, exponential(turn), velocity, rates)


START, NOW = bodies([0.0, 3.0], [0.0, 0.5], [0.2, -0.2], [0.4, 0.4]), bodies([0.3, 3.1], [0.2, 0.5], 0.1, [0.2, 0.0])


def moved(mode, clock, **goal):
    """Place along x and angle about y of both."""
    many = [jnp.stack([jnp.asarray(getattr(SupportMotion(mode, **goal), name))] * 2) for name in SupportMotion._fields]
    free = free_body_reference_state(SupportMotion(*many), START, NOW, jnp.asarray(clock), jnp.asarray(TIME))
    return np.asarray(free.position[:, 0]), np.asarray(logarithm(free.quat)[:, 1]), free


def test_a_body_goes_over_to_a_velocity_from_where_it_is():
    to = {"velocity": np.array([0.4, 0, 0]), "turn": np.array([0, 0.8, 0])}
    x, angle, free = moved(TO_VELOCITY, TIME, **to)
    np.testing.assert_allclose(x, [0.3 * TIME, 3 + 0.1 * TIME], atol=1e-5)  # at the mean of both velocities
    np.testing.assert_allclose(angle, [0.6 * TIME, 0.5 + 0.6 * TIME], atol=1e-5)
    np.testing.assert_allclose(free.velocity[:, 0], 0.4, atol=1e-6)
    half, *_ = moved(TO_VELOCITY, TIME / 2, **to)
    np.testing.assert_allclose(half, [0.25 * TIME / 2, 3 - 0.05 * TIME / 2], atol=1e-5)
    late, *_ = moved(TO_VELOCITY, 2 * TIME, **to)
    np.testing.assert_allclose(late, x, atol=1e-6)


def test_a_body_that_falls_for_a_moment_is_not_meant_to_sink():
    falls = START._replace(velocity=START.velocity.at[:, 2].set(-0.01))
    many = jax.tree.map(lambda *x: jnp.stack([jnp.asarray(each) for each in x]), RESTS, RESTS)
    ends = free_body_reference_state(many, falls, NOW, jnp.asarray(TIME), jnp.asarray(TIME))
    np.testing.assert_array_equal(ends.position[:, 2], START.position[:, 2])
    np.testing.assert_array_equal(ends.velocity[:, 2], 0.0)


def test_a_body_goes_to_a_pose_follows_or_rolls_with_the_others():
    goal = {"position": np.array([1.0, 0, 0]), "quat": np.asarray(exponential(jnp.array([0.0, 0.7, 0.0])))}
    x, angle, _ = moved(TO_POSE, TIME, **goal)
    np.testing.assert_allclose([*x, *angle], [1, 1, 0.7, 0.7], atol=1e-5)
    begins, *_ = moved(TO_POSE, 0.0, **goal)
    np.testing.assert_allclose(begins, START.position[:, 0], atol=1e-6)
    np.testing.assert_allclose(moved(MEASURED, 1.0)[0], NOW.position[:, 0])
    x, angle, _ = moved(TOGETHER, 1.0)
    np.testing.assert_allclose([*x, *angle], [0.2, 3.2, 0.1, 0.6], atol=1e-5)


def test_a_body_that_is_kept_is_where_it_was_meant_to_be():
    np.testing.assert_allclose(moved(KEPT, TIME)[0], START.position[:, 0], atol=1e-6)
    one_kept = jax.tree.map(lambda *x: jnp.stack([jnp.asarray(each) for each in x]), STAYS, RESTS)
    _, free = FreeBodyReferenceMotion(jax.tree.map(lambda x: x[None], one_kept), afloat=False).on_stage_enter(
        jnp.int32(0), START, START, NOW
    )
    np.testing.assert_allclose(free.position[:, 0], [START.position[0, 0], NOW.position[1, 0]], atol=1e-6)


@pytest.fixture(scope="module")
def standing():
    """On a ball, and what is seen of it."""
    stance = jax.jit(lambda: stance_on_ball(CASE, stand_pose(CASE, CASE.manoeuvre)))()
    still, joints = jnp.zeros(3), joint_targets(CASE.robot, stance)[0]
    return stance, Observation(stance.position, stance.quat, still, still, joints, 0 * joints, 0 * joints,
                               jnp.ones(6, bool), free_start_state(CASE.obstacle))  # fmt: skip


def test_feet_that_grip_are_pressed_in_and_inward(standing):
    """From where they are measured, however they were commanded; one in the air comes down as deep as commanded."""
    stance, seen = standing
    plan = compile_plan(stance, [Stage("a", 1.0), Stage("b", 1.0, onset=GRIP, press=(2e-3, 3e-3))], 0.0)
    told = stance._replace(feet=stance.feet + 0.01)
    hangs = seen._replace(loaded=jnp.arange(6) > 0)
    feet = tracker.STAGE_STARTS[GRIP](CASE, plan, jnp.asarray(1), told, hangs).feet
    normal = (stance.feet - seen.free.position[0]) / jnp.linalg.norm(stance.feet - seen.free.position[0], axis=1)[
        :, None
    ]
    inward = -3e-3 * jnp.array([0.0, 1.0, 0.0]) * jnp.sign(stance.feet[:, 1:2])
    depth = jnp.full(6, 2e-3).at[0].set(-jnp.sum(0.01 * normal[0]))
    np.testing.assert_allclose(feet, stance.feet - depth[:, None] * normal + inward, atol=1e-5)


class Waits(Manoeuvre):
    """A manoeuvre whose first stage ends when the ball has gone 0.1 m."""

    observer = 0.0

    def is_stage_over(self, belief, plan, state, seen):
        return (state.stage == 0) & (seen.free.position[0, 0] > 0.1)


def test_an_event_ends_a_stage_and_the_next_goes_on_from_there(standing):
    """The ball goes along x at 0.1 m/s, the base over it and rising; one foot is in the air."""
    stance, seen = standing
    frames = {
        "foot_frames": (koenig_frame_number(0),) + (body_frame_number(0),) * 5,
        "base_frame": koenig_frame_number(0),
        "onset": GRIP,
    }
    centre = seen.free.position[0]
    up, foot = stance.position - centre + jnp.array([0.0, 0.0, 0.2]), stance.feet[0] - centre
    stages = [Stage("wait", 4.0, {1: foot + jnp.array([0.0, 0.0, 0.2])}, position=up, support=(), **frames),
              Stage("on", 1.0, position=up, support=(RESTS,), **frames)]  # fmt: skip
    plan = compile_plan(stance, stages, 0.0, ease=0.1)
    case = replace(CASE, manoeuvre=Waits())

    @jax.jit
    def run():
        def tick(carry, k):
            state, told = carry
            x = 0.1 * PERIOD * k
            free = seen.free._replace(position=centre[None].at[0, 0].add(x), velocity=jnp.array([[0.1, 0.0, 0.0]]))
            joints, _ = joint_targets(case.robot, told)
            now = seen._replace(position=told.position, quat=told.quat, angles=joints, free=free)
            state, command = tracker.step(case, plan, state, now, PERIOD)
            return (state, command.target), (state.stage, command.target)

        start = tracker.init(case, plan), Stance(*plan.start)
        return jax.lax.scan(tick, start, jnp.arange(400))[1]

    stage, target = run()
    first = int(np.argmax(np.asarray(stage) == 1))
    assert first * PERIOD == pytest.approx(1.0, abs=0.02)
    for points in (target.feet, target.position):
        assert np.abs(np.diff(points, axis=0)).max() / PERIOD < 0.5  # m/s: nothing jumps
    risen = float(target.position[first, 2] - stance.position[2])
    assert 0.03 < risen < 0.07  # a quarter of the way, from where it goes on

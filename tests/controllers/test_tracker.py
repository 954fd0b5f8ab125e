"""The tracker: goes through a plan's stages in time, waits for touchdowns, and hands the body's error on."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from sweep.config.experiment import compose
from sweep.controllers import tracker
from sweep.controllers.layers import CREEP_TIME, LONE_CREEP_FACTOR, ForceFeedforward
from sweep.controllers.observation import Observation
from sweep.controllers.plan import REGRIP
from sweep.core.rotations import exponential, logarithm, rotate
from sweep.models.noise import Noise
from sweep.models.obstacles.surface import empty_free_body_state
from sweep.models.posture import Stance, feet_in_world, joint_targets

PERIOD = 4e-3
CASE = compose(["manoeuvre.steps=2"]).case


@pytest.fixture(scope="module")
def plan():
    return CASE.manoeuvre.plan(CASE)


@pytest.fixture(scope="module")
def follow(plan):
    """Ticks of a robot that is where it is told but for `offset` (m) and `turn` (rad), its feet loaded as `loaded`."""

    ticks = int(1.3 * float(plan.duration.sum()) / PERIOD)

    @jax.jit
    def run(offset, loaded, turn):
        def tick(carry, _):
            state, at = carry
            still, joints = jnp.zeros(3), jnp.zeros((6, 3))
            seen = Observation(at + offset, exponential(turn), still, still, joints, joints, joints, loaded,
                               empty_free_body_state())  # fmt: skip
            state, command = tracker.step(CASE, plan, state, seen, PERIOD)
            return (state, command.target.position), (state, command)

        _, history = jax.lax.scan(tick, (tracker.init(CASE, plan), plan.start.position), None, length=ticks)
        return history

    def history_of(offset, loaded, turn=(0.0, 0.0, 0.0)):
        return jax.tree.map(np.asarray, run(jnp.asarray(offset), jnp.asarray(loaded), jnp.asarray(turn)))

    return history_of


def pressed(plan, creep):
    """The plan with forces, none, that press feet down: those that hang by `creep` (m/s); footholds follow in 30 ms."""
    down = jnp.broadcast_to(jnp.array([0.0, 0.0, -1.0]), plan.foothold.shape)
    numbers = jnp.zeros((len(plan.names), 2, 6, 3)), jnp.zeros(len(plan.names)), down, jnp.array(creep), jnp.array(0.03)
    return plan.replace_layer(ForceFeedforward(*numbers))


def seen_at_start(plan, loaded):
    """A robot at rest, its base where the plan starts, all joints at 0."""
    still, joints = jnp.zeros(3), jnp.zeros((6, 3))
    return Observation(*plan.start[1:], still, still, joints, joints, joints, loaded, empty_free_body_state())


def stage_starts(states) -> np.ndarray:
    return (1 + np.flatnonzero(np.diff(states.stage))) * PERIOD


def test_stages_come_in_time_and_the_plan_ends(follow, plan):
    states, commands = follow(np.zeros(3), np.ones(6, bool))
    np.testing.assert_allclose(stage_starts(states), np.cumsum(plan.duration)[:-1], atol=2 * PERIOD)
    assert states.finished[-1]
    np.testing.assert_allclose(commands.target.position[-1], plan.position[-1], atol=1e-6)
    np.testing.assert_allclose(commands.target.feet[-1], plan.foothold[-1], atol=2e-3)  # seen a tick late: 1.2 mm
    assert commands.shortfall.max() == 0


def test_targets_do_not_jump(follow, plan):
    """From tick to tick a foot goes no further than its fastest swing: no jump where stages meet."""
    _, commands = follow(np.zeros(3), np.ones(6, bool))
    for points, limit in ((commands.target.feet, 1.0), (commands.target.position, 0.3), (commands.joints, 3.0)):
        assert np.abs(np.diff(points, axis=0)).max() / PERIOD < limit  # m/s, m/s, rad/s


def test_a_stage_waits_for_its_feet_as_long_as_patience_lasts(follow, plan):
    """Foot 1 never touches down: only the stages in which it swings take longer, by the patience."""
    states, _ = follow(np.zeros(3), np.arange(6) > 0)
    took = np.diff(np.concatenate([[0.0], stage_starts(states)]))
    late = np.asarray(plan.swing)[:-1, 0] * float(plan.patience)
    assert late.max() > 0
    np.testing.assert_allclose(took, np.asarray(plan.duration)[:-1] + late, atol=2 * PERIOD)


@pytest.mark.parametrize(("sure", "late"), [(True, 0.0), (False, 0.0), (True, 0.08)])
def test_a_foot_that_hangs_goes_on_alone(plan, sure, late):
    """Held by planned forces: those that swing with it, and have touched down, are soon pressed on no farther.

    Neither are those that may have, as far as can be told (not `sure`), nor any until loads are known (`late`, s). Of
    that three quarters are how much later loads are seen than places: for so long none goes on.
    """
    stage, creep, wait = int(np.argmax(np.any(plan.swing, axis=1))), 0.01, 0.3  # m/s, s
    first, *others = np.flatnonzero(plan.swing[stage])
    held, stands = pressed(replace(plan, patience=jnp.array(1.0)), creep), jnp.arange(6) != first
    seen = seen_at_start(plan, stands & sure)._replace(maybe_loaded=stands)
    told = replace(CASE, noise=Noise(delay=0.25 * late / PERIOD, load_delay=0.75 * late / PERIOD))
    begun = tracker.init(told, held)._replace(stage=jnp.int32(stage), clock=plan.duration[stage])

    @jax.jit
    def waiting(state):
        def tick(state, _):
            state, command = tracker.step(told, held, state, seen, PERIOD)
            return state, (state.stage, command.target.feet)

        return jax.lax.scan(tick, state, None, length=round(wait / PERIOD))[1]

    stages, feet = waiting(begun)
    assert np.all(stages == stage)
    below = np.asarray(plan.foothold[stage, :, 2] - feet[:, :, 2])
    gone = np.clip(PERIOD * np.arange(1, 1 + len(below)) - 0.75 * late, 0, CREEP_TIME)
    np.testing.assert_allclose(below[:, others], np.outer(creep * gone, np.ones(len(others))), atol=1e-5)
    assert below[-1, first] == pytest.approx(
        creep * (CREEP_TIME + LONE_CREEP_FACTOR * (wait - CREEP_TIME - late)), abs=1e-5
    )


@pytest.mark.parametrize(("behind", "time"), [(0.0, 0.03), (0.02, 0.03), (0.08, 0.08)])
def test_footholds_follow_no_faster_than_loads_come_behind(plan, behind, time):
    """Those of feet that bear planned forces; one that left would be followed until its load (s) is known."""
    held, told = pressed(plan, 0.01), replace(CASE, noise=Noise(load_delay=behind / PERIOD))
    seen, begun = seen_at_start(plan, jnp.ones(6, bool)), tracker.init(told, held)
    after, _ = tracker.step(told, held, begun, seen, PERIOD)
    places = feet_in_world(CASE.robot, seen.position, seen.quat, seen.angles)
    np.testing.assert_allclose(after.feet - begun.feet, PERIOD / time * (places - begun.feet), atol=1e-6)


def test_body_error_shifts_feet_and_body_and_fades(follow, plan):
    """Seen 10 mm to the left: feet and body targets shift together at a stage's start, and the body's part fades."""
    offset = np.array([0.0, 0.01, 0.0])
    states, commands = follow(offset, np.ones(6, bool))
    first = int(np.flatnonzero(states.stage == 1)[0])
    last = int(np.flatnonzero(states.stage == 1)[-1])
    standing = ~np.asarray(plan.swing)[1]
    shift = commands.target.feet[first] - np.asarray(plan.start.feet)
    np.testing.assert_allclose(shift[standing], np.broadcast_to(offset, (standing.sum(), 3)), atol=1e-5)
    assert commands.target.position[first, 1] == pytest.approx(0.01, rel=0.02)
    assert commands.target.position[last, 1] == pytest.approx(0.0, abs=1e-4)
    landing = commands.target.feet[last] - np.asarray(plan.foothold)[1]
    np.testing.assert_allclose(landing[~standing], 0, atol=1e-3)  # footholds are absolute


def test_attitude_error_turns_feet_and_body_and_fades(follow, plan):
    """Seen rolled by 10 mrad: standing feet turn about the base with it at a stage's start, and its own part fades."""
    roll = np.array([0.01, 0.0, 0.0])
    states, commands = follow(np.zeros(3), np.ones(6, bool), roll)
    first, last = np.flatnonzero(states.stage == 1)[[0, -1]]
    standing = ~np.asarray(plan.swing)[1]
    base, feet = np.asarray(plan.position)[0], np.asarray(plan.start.feet)
    turned = base + rotate(exponential(jnp.asarray(roll))[None], jnp.asarray(feet - base))
    np.testing.assert_allclose(commands.target.feet[first][standing], turned[standing], atol=1e-4)
    assert np.abs(turned - feet).max() > 4e-3
    attitude = logarithm(jnp.asarray(commands.target.quat[[first, last]]))
    np.testing.assert_allclose(attitude, [0.98 * roll, 0 * roll], atol=2e-4)


def test_regripped_feet_stand_where_they_are(plan):
    """Also those that have not touched down: base and feet all being 5 mm ahead strains nothing, and must not."""
    gripping, ahead = replace(plan, onset=(REGRIP,) * len(plan.names)), jnp.array([5e-3, 0.0, 0.0])

    @jax.jit
    def second_stage():
        position, quat = plan.start.position + ahead, plan.start.quat
        feet = plan.start.feet + ahead
        angles, _ = joint_targets(CASE.robot, Stance(feet, position, quat))
        still, joints = jnp.zeros(3), jnp.zeros((6, 3))
        seen = Observation(
            position, quat, still, still, angles, joints, joints, jnp.zeros(6, bool), empty_free_body_state()
        )
        late = tracker.init(CASE, plan)._replace(clock=plan.duration[0] + plan.patience)
        return tracker.step(CASE, gripping, late, seen, PERIOD)[0], feet

    state, feet = second_stage()
    assert state.stage == 1
    np.testing.assert_allclose(state.feet[:, :2], feet[:, :2], atol=1e-5)
    np.testing.assert_allclose(state.feet[:, 2], plan.foothold[0, :, 2], atol=1e-5)  # as deep as commanded

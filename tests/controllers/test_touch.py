"""Touch: what feet on the obstacle tell of its sizes, where they are told to stand then, and the plan that follows."""

import dataclasses
from functools import cache

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from sweep.config.experiment import compose
from sweep.controllers.frames import stance_to_world
from sweep.controllers.layers import JointSpaceLegs, TrackerLayer
from sweep.controllers.observation import FreeBodyFilterState, Observation
from sweep.controllers.plan import reference_stance, stage_start_pose
from sweep.controllers.tracker import init
from sweep.core.errors import InputError
from sweep.core.rotations import exponential, multiply
from sweep.engines import closed_loop, make_engine
from sweep.engines.pre_rollout import measure_body_positions, prepare_belief
from sweep.estimation import touch
from sweep.estimation.belief_update import LearnedState, replan_remaining_stages, update_belief_from_touch
from sweep.estimation.calibration import CalibrationResult
from sweep.estimation.touch import TouchState
from sweep.models.frames import WORLD_FRAME
from sweep.models.noise import Noise
from sweep.models.obstacles.ball import Ball
from sweep.models.obstacles.kerb import Kerb
from sweep.models.obstacles.ladder import Ladder
from sweep.models.obstacles.pole_ledge import PoleLedge
from sweep.models.obstacles.surface import (
    empty_free_body_state,
    free_start_state,
    landmark_state,
    landmarks,
    state_from_landmarks,
)
from sweep.models.posture import Stance, joint_targets

PERIOD, DEEPENING = 4e-3, 5e-3
CASE = compose(["scenario=pole_climb", "control.touch=obstacle", "control.replan=touched"]).case


@cache
def planned():
    return jax.jit(lambda: CASE.manoeuvre.plan(CASE))()


def seen(stance: Stance, loaded=True) -> Observation:
    """The robot in a stance."""
    angles, _ = joint_targets(CASE.robot, stance)
    still = jnp.zeros(3)
    return Observation(stance.position, stance.quat, still, still, angles, 0 * angles, 0 * angles,
                       jnp.full(6, loaded), empty_free_body_state())  # fmt: skip


def on_pole(radius: float) -> tuple[int, Stance]:
    """The first stage in which all legs are on the pole but those that swing, at its end; feet at its true surface."""
    plan = planned()
    stage = plan.names.index("up.middle")
    stance = reference_stance(
        plan, jnp.int32(stage), jnp.ones(()), *stage_start_pose(plan, jnp.int32(stage), empty_free_body_state())
    )
    feet = stance.feet.at[:, :2].multiply(radius / jnp.linalg.norm(stance.feet[:, :2], axis=1)[:, None])
    return stage, stance._replace(feet=feet)


def walk_on(stage: int, stance: Stance, ticks: int, loaded=True, noise=CASE.noise):
    """What is known, and the footholds told, after `ticks` in which no foot had been felt before."""
    plan, state = planned(), untouched()._replace(has_landed=jnp.zeros(6, bool))
    ground = touch.planned_foothold_surface(untouched(), plan, jnp.int32(stage))
    now = seen(stance, loaded)
    tracked = init(CASE, plan)._replace(stage=jnp.int32(stage), feet=plan.foothold[stage], clock=plan.duration[stage])
    step = jax.jit(
        lambda s, t: touch.update_touch_estimate(CASE.control, noise, CASE.robot, plan, ground, t, s, now, PERIOD)
    )
    for _ in range(ticks):
        state, moves, _ = step(state, tracked)
        from_where = jnp.where(plan.swing[stage][:, None], plan.foothold[stage], tracked.feet)
        tracked = tracked._replace(feet=from_where + moves)
    return state, tracked.feet


def untouched() -> TouchState:
    return touch.init_touch_state(CASE.control, CASE.obstacle)


def from_axis(feet) -> np.ndarray:
    return np.linalg.norm(np.asarray(feet)[:, :2], axis=1)


def sizes(state: TouchState) -> np.ndarray:
    return np.array([getattr(state.obstacle, name) for name in touch.learnable_sizes(state.obstacle)])


@pytest.mark.parametrize("radius", [0.40, 0.44])
def test_feet_on_the_pole_tell_its_radius_and_nothing_else(radius):
    stage, stance = on_pole(radius)
    state, _ = walk_on(stage, stance, 3)
    found, before = sizes(state), untouched()
    np.testing.assert_allclose(found[0], radius, atol=2e-3)
    assert abs(found[0] - radius) < 4 * np.sqrt(state.covariance[0, 0]) < 5e-3
    np.testing.assert_array_equal(found[1:], sizes(before)[1:])
    np.testing.assert_array_equal(state.covariance[1:, 1:], before.covariance[1:, 1:])


def test_a_foot_is_told_to_stand_as_deep_as_planned_in_the_surface_that_it_felt():
    radius = 0.41
    stage, stance = on_pole(radius)
    _, feet = walk_on(stage, stance, 100)
    stands = ~np.asarray(planned().swing[stage])
    np.testing.assert_allclose(from_axis(feet)[stands], radius - DEEPENING, atol=1e-4)


def test_a_foot_that_finds_a_height_lower_than_cautiously_planned_stands_as_deep_in_it():
    case = compose(["scenario=walk_kerb", "control=learn", "control.calibrate=none", "control.caution=2"]).case
    _, plan, learned = prepare_belief(case, case, jax.random.key(0))
    stage = len(plan.names) - 1
    higher = np.asarray(plan.foothold[stage] - case.manoeuvre.plan(case).foothold[stage])[:, 2]
    assert np.all(higher > 2e-3)
    stance = reference_stance(
        plan, jnp.int32(stage), jnp.ones(()), *stage_start_pose(plan, jnp.int32(stage), empty_free_body_state())
    )
    now = seen(stance._replace(feet=stance.feet.at[:, 2].set(case.obstacle_of_type(Kerb).height)))
    assert learned.touch is not None
    learned = learned._replace(touch=learned.touch._replace(has_landed=jnp.zeros(6, bool)))
    state = init(case, plan)._replace(stage=jnp.int32(stage), feet=plan.foothold[stage], clock=plan.duration[stage])
    step = jax.jit(lambda s, known: update_belief_from_touch(case, case, plan, s, known, now, PERIOD))
    for _ in range(100):
        state, _, _, learned = step(state, learned)
    stands = ~np.asarray(plan.swing[stage])
    lower = np.asarray(plan.foothold[stage] - state.feet)[:, 2]
    np.testing.assert_allclose(lower[stands], higher[stands], atol=1e-4)


@pytest.mark.parametrize(("radius", "pressed", "moved"), [
    (0.44, 0.002, 0.02 + DEEPENING + touch.CLEARANCE),  # far outside of the believed pole: lifted off the true one
    (0.44, -0.002, 0),  # it is on its way
    (0.424, DEEPENING + 0.002, touch.YIELD_SHARE * 0.002),  # nearly where believed: gives way to the extra pressure
    (0.424, -0.002, 0),
])  # fmt: skip
def test_a_foot_that_lands_early_gives_way_or_is_lifted_clear(radius, pressed, moved):
    plan, (stage, stance) = planned(), on_pole(radius)
    swings = np.asarray(plan.swing[stage])
    told = seen(stance._replace(feet=stance.feet.at[:, :2].multiply(1 - pressed / radius)))
    clock = 0.75 * plan.duration[stage]
    state = init(CASE, plan)._replace(stage=jnp.int32(stage), feet=stance.feet, joints=told.angles, clock=clock)
    ground = touch.planned_foothold_surface(untouched(), plan, jnp.int32(stage))
    rest = plan, ground, state, untouched(), seen(stance), PERIOD
    known, moves, searches = touch.update_touch_estimate(CASE.control, CASE.noise, CASE.robot, *rest)
    np.testing.assert_allclose(np.sum(moves * ground.normal, axis=1)[swings], moved, atol=2e-4)
    assert not np.any(np.asarray(searches)[swings])
    assert not np.any(np.asarray(known.has_landed)[swings])  # it has not come to stand


def test_a_foot_in_the_air_goes_on_inwards_so_far_and_no_farther():
    stage, stance = on_pole(0.43)
    for ticks, way in ((10, 10 * PERIOD * CASE.control.touch_speed), (200, touch.MAX_SEARCH)):
        _, feet = walk_on(stage, stance, ticks, loaded=False)
        moved = from_axis(planned().foothold[stage]) - from_axis(feet)
        np.testing.assert_allclose(moved, way, atol=1.01 * PERIOD * CASE.control.touch_speed)


def test_a_leg_that_is_held_by_its_joints_does_not_search():
    case = compose(["scenario=beam_cross", "control.touch=obstacle"]).case
    plan = case.manoeuvre.plan(case)
    stage = plan.names.index("narrow.1-4-5.down")
    stance = reference_stance(
        plan, jnp.int32(stage), jnp.ones(()), *stage_start_pose(plan, jnp.int32(stage), empty_free_body_state())
    )
    state = init(case, plan)._replace(stage=jnp.int32(stage), feet=plan.foothold[stage], clock=plan.duration[stage])
    known = touch.init_touch_state(case.control, case.obstacle)._replace(has_landed=jnp.zeros(6, bool))
    ground = touch.planned_foothold_surface(known, plan, jnp.int32(stage))
    rest = plan, ground, state, known, seen(stance, loaded=False), PERIOD
    _, moves, searches = touch.update_touch_estimate(case.control, case.noise, case.robot, *rest)
    held = np.asarray(plan.find_layer(JointSpaceLegs).held[stage])
    assert held.sum() == 3
    np.testing.assert_array_equal(searches, ~held)
    np.testing.assert_array_equal(np.any(moves != 0, axis=1), ~held)


def test_a_foot_that_is_told_late_of_its_load_goes_on_no_faster_than_that_allows():
    stage, stance = on_pole(0.43)
    late, ticks = 20.0, 50
    _, feet = walk_on(stage, stance, ticks, loaded=False, noise=Noise(load_delay=late))
    moved = from_axis(planned().foothold[stage]) - from_axis(feet)
    stands = ~np.asarray(planned().swing[stage])
    np.testing.assert_allclose(moved[stands], ticks / late * touch.MAX_OVERSHOOT, rtol=0.01)
    np.testing.assert_allclose(moved[~stands], 0, atol=1e-6)  # the load of those that land now is not known of yet


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class ContactRecorder(TrackerLayer):
    """Keeps which feet surely carry load by the measurement, and which may."""

    def init_state(self, start, joints, free):
        return jnp.zeros(6, bool), jnp.zeros(6, bool)

    def modify_command(self, ctx, state, command):
        return (ctx.obs.loaded, ctx.obs.maybe_loaded), command


def contacts_of_loads(noise: Noise, loads: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """What the controller takes for contact in one tick, where it believes in this noise of exact sensors; (k, 6)."""
    world, plan = compose(["scenario=pole_climb"]).case, planned().replace_layer(ContactRecorder())
    belief, start = dataclasses.replace(world, noise=noise), closed_loop.start_state(world, world, plan)
    start = start, jnp.zeros(()), jax.random.key(0), LearnedState(), "exact"
    loop = closed_loop.init_loop(world, belief, plan, *start)

    def record(load):
        shown = loop._replace(actual=loop.actual._replace(load=load))
        return closed_loop.run_controller(world, belief, plan, shown, jnp.int32(0), PERIOD)[0].tracker.layer_states[-1]

    return jax.jit(jax.vmap(record))(jnp.asarray(loads))


def test_what_a_sensor_shows_in_the_air_makes_no_foot_stand():
    """But a foot that it says bears some load may stand; where nothing is wrong with it, it does for sure."""
    rng, least, noise = np.random.default_rng(0), CASE.control.load_threshold, Noise(load_noise=3.0, load_bias=4.0)
    loads = 4 * rng.standard_normal((1700, 6)) + 3 * rng.standard_normal((1700, 6))
    (doubted, perhaps), (believed, also_perhaps) = (contacts_of_loads(noise, loads) for noise in (noise, Noise()))
    assert np.mean(doubted) < 1e-3
    for shown in (perhaps, believed, also_perhaps):
        np.testing.assert_array_equal(shown, loads > least)


def test_heights_are_planned_for_as_larger_until_a_foot_stands_there():
    nothing, pole = untouched(), CASE.obstacle_of_type(PoleLedge)
    more = CASE.control.caution * CASE.control.obstacle_error
    wary = touch.cautious_planning_obstacle(nothing)
    np.testing.assert_allclose(wary.height, pole.height * (1 + more), rtol=1e-6)
    np.testing.assert_allclose(wary.radius, pole.radius, rtol=1e-6)
    top = 1.01 * pole.height  # on which a robot stands that believes in the one above
    feet = jnp.stack([0.2 * jnp.cos(jnp.arange(6.0)), 0.2 * jnp.sin(jnp.arange(6.0)), jnp.full(6, pole.height)], axis=1)
    start = Stance(feet, jnp.array([0.0, 0.0, pole.height + 0.3]), jnp.array([1.0, 0.0, 0.0, 0.0]))
    up = jnp.array([0.0, 0.0, top - pole.height])
    true = start._replace(feet=start.feet + up, position=start.position + up)
    angles, short = joint_targets(CASE.robot, true)
    found = touch.update_from_stance(
        CASE.control, CASE.noise, CASE.robot, start, nothing, true.position, true.quat, angles
    )
    assert float(short.max()) == 0
    np.testing.assert_allclose(touch.cautious_planning_obstacle(found).height, top, atol=1e-3)


@pytest.mark.parametrize("scenario", ["ball_climb", "ball_to_ball", "ball_ledges"])
def test_balls_tell_their_radius_by_how_high_they_lie(scenario):
    belief = compose([f"scenario={scenario}", "control.touch=obstacle"]).case
    larger = 1.01 * belief.obstacle_of_type(Ball).radius
    world = dataclasses.replace(belief, obstacle=dataclasses.replace(belief.obstacle_of_type(Ball), radius=larger))
    for bias in (0.0, 0.01):
        key, noise = jax.random.key(3), Noise(body_position_bias=bias)
        seen = measure_body_positions(dataclasses.replace(world, noise=noise), key)
        np.testing.assert_allclose(seen, free_start_state(world.obstacle).position, atol=4 * bias + 1e-6)
        nothing = touch.init_touch_state(belief.control, belief.obstacle)
        found = touch.update_from_resting_bodies(belief.control, noise, nothing, seen)
        deviation = float(np.sqrt(found.covariance[0, 0]))
        assert deviation > 0.5 * bias  # two balls tell as much twice
        np.testing.assert_allclose(sizes(found), [larger], atol=4 * deviation if bias else 1e-4)
    before = dataclasses.replace(found.obstacle, radius=belief.obstacle_of_type(Ball).radius)
    assert before == belief.obstacle


@pytest.mark.slow
def test_feet_on_the_rungs_of_a_ladder_that_leans_otherwise_tell_their_step():
    belief = compose(["scenario=ladder_climb", "control.touch=obstacle", "control.replan=touched"]).case
    ladder = belief.obstacle_of_type(Ladder)
    other = dataclasses.replace(ladder, rung_step=1.01 * ladder.rung_step)
    plan, true = (case.manoeuvre.plan_without_forces(case)
                  for case in (belief, dataclasses.replace(belief, obstacle=other)))  # fmt: skip
    stage = plan.names.index("climb.front4.load")  # front feet on rung 3, middle ones on 2
    leans = dataclasses.replace(other, lean=ladder.lean - 0.02).start()
    stance = Stance(true.foothold[stage], true.position[stage], multiply(exponential(true.turn), true.quat)[stage])
    told = state_from_landmarks(
        ladder, landmark_state(other, leans)
    )  # by its lower ends, as if its rungs were where they are believed
    now = seen(stance_to_world(stance, true.foot_frame[stage], true.base_frame[stage], leans))._replace(free=told)
    known = touch.init_touch_state(belief.control, ladder)._replace(has_landed=jnp.zeros(6, bool))
    state = init(belief, plan)._replace(stage=jnp.int32(stage), feet=plan.foothold[stage], clock=plan.duration[stage])
    state = state._replace(observer=FreeBodyFilterState(told, told))
    ground = touch.planned_foothold_surface(known, plan, jnp.int32(stage))
    rest = belief.noise, belief.robot, plan, ground
    found, moves, _ = touch.update_touch_estimate(belief.control, *rest, state, known, now, 1.0)
    np.testing.assert_allclose(found.obstacle.rung_step, other.rung_step, atol=1e-3)
    on_rungs = np.asarray(plan.foot_frame[stage]) != WORLD_FRAME
    assert on_rungs.sum() == 4
    off = landmarks(ladder) - landmarks(other)  # of the axes in which the two plans are given
    told = np.asarray(plan.foothold[stage] + moves - true.foothold[stage] - off)[on_rungs]
    deeper = [[0.0, belief.manoeuvre.deepening, 0.0]] * 4  # along the rails: by what they were seen to be off
    np.testing.assert_allclose(told, deeper, atol=1e-5)
    np.testing.assert_array_equal(moves[~on_rungs], 0)


def test_what_is_left_of_the_way_is_planned_for_the_pole_that_was_found():
    plan, found = planned(), dataclasses.replace(CASE.obstacle_of_type(PoleLedge), radius=0.43)
    other = dataclasses.replace(CASE, obstacle=found)
    stage = plan.names.index("on.front")
    touched = untouched()._replace(obstacle=found)
    learned = jax.jit(
        lambda: replan_remaining_stages(CASE, plan, jnp.int32(stage), LearnedState(None, touched, plan))
    )()
    again = learned.plan
    assert float(learned.shortfall) == 0
    fresh = other.manoeuvre.plan(other)
    np.testing.assert_array_equal(again.foothold[: stage + 1], plan.foothold[: stage + 1])
    np.testing.assert_allclose(again.foothold[stage + 1 :], fresh.foothold[stage + 1 :], atol=1e-5)
    np.testing.assert_allclose(again.position[stage + 1 :], fresh.position[stage + 1 :], atol=1e-5)
    none = LearnedState(None, touched._replace(obstacle=dataclasses.replace(found, radius=jnp.nan)), plan)
    kept = jax.jit(lambda: replan_remaining_stages(CASE, plan, jnp.int32(stage), none))()
    np.testing.assert_array_equal(kept.plan.foothold, plan.foothold)
    assert float(kept.shortfall) == np.inf


def test_a_plan_out_of_reach_is_told_as_soon_as_it_is_made():
    plan, stage = planned(), jnp.int32(planned().names.index("on.front"))
    small = CalibrationResult(dataclasses.replace(CASE.robot, shin=0.2), jnp.zeros((4, 4)))
    learned = jax.jit(lambda: replan_remaining_stages(CASE, plan, stage, LearnedState(small, untouched(), plan)))()
    assert 0.005 < float(learned.shortfall) < 0.5


@pytest.mark.parametrize(
    ("overrides", "message"),
    [(["scenario=raft_cross", "control.touch=obstacle"], "control.touch = obstacle is not allowed: obstacle = raft"),
     (["scenario=ball_climb", "control=learn"], "control.replan = touched is not allowed: obstacle = ball may move"),
     (["scenario=walk_tripod", "control.replan=touched"], "control.replan = touched is not allowed: it needs")],
)  # fmt: skip
def test_what_a_robot_cannot_do_is_refused_in_one_line(overrides, message):
    exp = compose([*overrides, "engine=native"])
    with pytest.raises(InputError, match=message):
        make_engine(dataclasses.replace(exp.settings, width=1), exp.case, exp.case, exp.thresholds)

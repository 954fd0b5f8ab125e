"""From ball to ball: what is where, what plans are refused, how stages end, how feet close the gap: (3.5.2), 3.5.3."""

from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest
from test_on_ball import outcomes

from sweep.config.experiment import compose
from sweep.controllers import tracker
from sweep.controllers.ball_state import centre_of_mass
from sweep.controllers.layers import TickContext
from sweep.controllers.observation import Observation
from sweep.controllers.plan import MEASURED, stage_end_stances
from sweep.controllers.reference_body_motion import FreeBodyReferenceMotion
from sweep.core.errors import InputError
from sweep.engines import make_engine
from sweep.manoeuvres.balancing.ball import BallDrive
from sweep.manoeuvres.balancing.ball_to_ball import BallClosingLaw, BallDockingLaw
from sweep.metrics.outcome import classify
from sweep.models.frames import WORLD_FRAME
from sweep.models.obstacles.surface import body_poses
from sweep.models.obstacles.two_balls import TwoBalls
from sweep.models.posture import Stance, feet_in_hip_axes


def test_balls_and_feet_feel_floor_and_balls():
    """A foot what it is deepest in; the second ball's centre the floor, and a second time the first ball."""
    balls = TwoBalls(gap=0.01)
    radius, second = balls.radius, 2 * balls.radius + 0.01
    points = [(0, 0, 2 * radius - 1e-3), (second, 0, 2 * radius - 1e-3), (second / 2, 0, -1e-3)] + [(0, 0, 9.0)] * 3
    points += [(0, 0, radius)] + [(second, 0, radius)] * 2
    surface = balls.surface(jnp.array(points), (-1,) * 6 + (0, 1, 1), body_poses(balls.start()))
    told = np.asarray(surface.depth)[[0, 1, 2, 6, 7, 8]]
    assert told == pytest.approx([1e-3, 1e-3, 1e-3, 0.0, 0.0, -0.01], abs=1e-6)
    assert np.asarray(surface.body)[[0, 1, 2, 6, 7, 8]].tolist() == [0, 1, -1, -1, -1, 0]
    assert np.asarray(surface.normal)[8] == pytest.approx([1, 0, 0], abs=1e-6)
    assert len(set(np.asarray(surface.face)[:3].tolist())) == 3


@pytest.mark.parametrize(
    ("numbers", "words"),
    [
        ({"rear2_base_ahead": 1.6}, r"ball_to_ball: foot \d is .* m out of reach at the end of stage over.rear2"),
        (
            {"ahead_base_ahead": 0.2},
            "ball_to_ball: the mass centre is -.* standing feet at the end of stage over.ahead:",
        ),
    ],
)
def test_plans_that_no_check_mends_are_refused(numbers, words):
    with pytest.raises(InputError, match=words):
        planned(**numbers)


def planned(**numbers):
    """The way from ball to ball with numbers of its plan changed: where base and feet are at the ends of stages."""
    case = compose(["scenario=ball_to_ball"]).case
    for path, value in numbers.items():
        case = replace(case, plan=case.plan.replace_number(f"over.{path.replace('_', '.')}", value))
    plan = case.manoeuvre.plan(case)
    last = stage_end_stances(plan, replace(case.obstacle_of_type(TwoBalls), gap=0.0).start())
    at = {name: Stance(*(x[k] for x in last)) for k, name in enumerate(plan.names) if name.startswith("over.")}
    return case, at


def inside(case, stance, legs):
    """How far (m) the mass centre is inside what these feet span along x."""
    centre, ahead = float(centre_of_mass(case.robot, stance)[0]), np.asarray(stance.feet)[[leg - 1 for leg in legs], 0]
    return min(ahead.max() - centre, centre - ahead.min())


def stretch(case, stance, leg):
    """Of a leg from hip to foot, over thigh and shin."""
    return float(jnp.linalg.norm(feet_in_hip_axes(case.robot, stance)[leg - 1]) / (case.robot.thigh + case.robot.shin))


@pytest.mark.slow
def test_a_base_goes_on_until_the_mass_centre_is_over_the_feet_that_stand_next():
    """Check 5."""
    case, at = planned(ahead3_base_ahead=-0.28)
    asked = (2 - 0.28) * 0.84
    assert at["over.ahead3"].position[0] > asked + 0.02
    assert inside(case, at["over.ahead3"], (3, 4, 5, 6)) == pytest.approx(case.manoeuvre.spare, abs=1e-3)
    assert at["over.rear3"].position[0] == pytest.approx((2 - 0.16) * 0.84, abs=1e-5)


@pytest.mark.slow
def test_a_foot_stands_farther_where_the_mass_centre_had_no_room():
    """Check 3: on the ball, in its vertical plane."""
    case, at = planned(middle2_middle_ahead=0.26)
    foot = np.asarray(at["over.middle2"].feet)[2] - (0, 0, 0.84)
    assert foot[0] > 0.26 * 0.84 + 5e-3
    assert foot[1] == pytest.approx(-0.713 * 0.84, abs=1e-3)
    assert np.linalg.norm(foot) == pytest.approx(0.84 - case.manoeuvre.deepening, abs=1e-5)
    assert inside(case, at["over.front2"], (1, 2, 3, 4)) == pytest.approx(case.manoeuvre.spare, abs=1e-3)


@pytest.mark.slow
@pytest.mark.parametrize(("ahead", "nearer"), [(-0.27, False), (-0.2, True)])
def test_a_robot_squats_for_a_foot_that_is_too_far_and_then_sets_it_nearer(ahead, nearer):
    """Check 2: no lower than over the ball."""
    case, at = planned(front2_front_ahead=ahead)
    _, was = planned()
    there, foot = at["over.front2"], np.asarray(at["over.front2"].feet)[4] - (2 * 0.84, 0, 0.84)
    assert stretch(case, there, 5) == pytest.approx(case.manoeuvre.straight, abs=1e-4)
    assert there.position[2] < was["over.front2"].position[2] - 5e-3
    above = there.position[2] - case.robot.body_height / 2 - 2 * 0.84
    assert (above == pytest.approx(case.manoeuvre.clear, abs=1e-5)) if nearer else above > case.manoeuvre.clear
    assert (foot[0] < ahead * 0.84 - 5e-3) if nearer else foot[0] == pytest.approx(ahead * 0.84, abs=1e-3)
    assert foot[1] == pytest.approx(-0.566 * 0.84, abs=1e-3)
    assert np.linalg.norm(foot) == pytest.approx(0.84 - case.manoeuvre.deepening, abs=1e-5)


def at_start(plan, free, joints=0.0):
    """The robot as the plan has it at the start, at rest, all joints at an angle (rad)."""
    still, joints = jnp.zeros(3), jnp.full((6, 3), joints)
    return Observation(plan.start.position, plan.start.quat, still, still, joints, 0 * joints, 0 * joints,
                       jnp.ones(6, bool), free)  # fmt: skip


@pytest.mark.parametrize(("gap", "over"), [(0.003, True), (0.005, False)])
def test_no_step_is_begun_where_the_balls_touch(gap, over):
    """Check 1."""
    case = compose(["scenario=ball_to_ball", f"obstacle.gap={gap}"]).case
    plan = case.manoeuvre.plan(case)
    state, seen = tracker.init(case, plan), at_start(plan, case.obstacle_of_type(TwoBalls).start())
    assert bool(BallDockingLaw(BallDrive(), 0.03).is_stage_over(case, plan, state, seen)) is over
    late = state._replace(clock=0.5 * plan.duration[0])
    assert not bool(BallDockingLaw(BallDrive(), 0.03).is_stage_over(case, plan, late, seen))


@pytest.mark.parametrize(("knees", "over"), [(0.0, True), (1.0, False)])
def test_the_base_goes_no_farther_on_a_straight_leg(knees, over):
    """Check 4."""
    case = compose(["scenario=ball_to_ball", "obstacle.gap=0"]).case
    plan = case.manoeuvre.plan(case)
    seen, state = at_start(plan, case.obstacle_of_type(TwoBalls).start(), knees), tracker.init(case, plan)
    ahead, front = (jnp.int32(plan.names.index(f"over.{name}")) for name in ("ahead", "front2"))
    assert bool(BallClosingLaw(0.0, 0.985).is_stage_over(case, plan, state._replace(stage=ahead), seen)) is over
    assert not bool(BallClosingLaw(0.0, 0.985).is_stage_over(case, plan, state._replace(stage=front), seen))


def test_the_way_down_is_told_from_the_second_ball():
    """Feet on the floor stay in the world; the first ball is where it is seen."""
    case = compose(["scenario=ball_to_ball", "manoeuvre.finish=floor"]).case
    plan = case.manoeuvre.plan(case)
    lone = compose(["scenario=ball_descend"]).case
    down = lone.manoeuvre.plan(lone)
    for name in ("turn", "down", "rest"):
        here, there = plan.names.index(name), down.names.index(name)
        wanted = np.asarray(down.foot_frame[there])
        assert (
            np.asarray(plan.foot_frame[here]).tolist()
            == np.where(wanted == WORLD_FRAME, WORLD_FRAME, wanted + 2).tolist()
        )
        mode, of_one = (np.asarray(of.find_layer(FreeBodyReferenceMotion).support.mode) for of in (plan, down))
        assert mode[here].tolist() == [MEASURED, of_one[there, 0]]


def test_the_second_ball_may_roll_at_the_start():
    free = TwoBalls(second_speed=0.1).start()
    assert np.asarray(free.velocity) == pytest.approx(np.array([[0, 0, 0], [0.1, 0, 0]]))
    assert np.asarray(free.turn) == pytest.approx(np.array([[0, 0, 0], [0, 0.1 / 0.84, 0]]), abs=1e-7)


def test_feet_on_the_second_ball_close_the_gap():
    """(3.5.2), its eta against our x, with the angle by which a ball rolls."""
    gap, press = 0.004, 7e-4
    case = compose(["scenario=ball_to_ball", f"obstacle.gap={gap}"]).case
    plan, free = case.manoeuvre.plan(case), case.obstacle_of_type(TwoBalls).start()
    stage = plan.names.index("over.ahead")
    state = tracker.init(case, plan)
    feet = plan.foothold[stage]
    state = state._replace(
        stage=jnp.int32(stage),
        clock=plan.duration[stage],
        feet=feet,
        memory=BallClosingLaw(press, 1.0).init_memory(case, plan),
    )
    seen = at_start(plan, free)
    now = TickContext(case.robot, plan, state.stage, state.stage, state.clock, jnp.ones(()), jnp.asarray(True), seen,
              tracker.stage_free_body_reference(plan, state, free)[0], 0.004, state.joints, case.noise)  # fmt: skip
    told = BallClosingLaw(press, 1.0).guide(case, now, state)
    radius, way = case.obstacle_of_type(TwoBalls).radius, gap + press
    eta, zeta = -np.asarray(feet)[4:, 0], np.asarray(feet)[4:, 2]
    round_, angle = np.hypot(eta, zeta), np.arctan2(zeta, eta)
    wanted = np.stack([-(way + round_ * np.cos(angle - way / radius)), round_ * np.sin(angle - way / radius)], axis=-1)
    assert np.asarray(told.stance.feet)[4:, ::2] == pytest.approx(wanted, abs=1e-6)
    assert np.asarray(told.stance.feet)[:4] == pytest.approx(np.asarray(feet)[:4], abs=1e-7)


@pytest.mark.slow
@pytest.mark.parametrize("engine", ["mjx", "native"])
@pytest.mark.parametrize("finish", ["ball", "floor"])
def test_it_goes_from_ball_to_ball(engine, finish):
    """They meet, stay together, and are at rest in the end; legs keep apart, and clear of the balls."""
    rows = outcomes(["scenario=ball_to_ball", f"engine={engine}", f"manoeuvre.finish={finish}"])
    assert rows["outcome"].tolist() == ["success"], rows["cause"]
    assert 0.02 < rows["meeting_speed_mps"][0] < 0.1
    assert rows["balls_apart_max_m"][0] < 0.02
    assert rows["second_ball_speed_mps"][0] < 0.002
    assert rows["leg_gap_min_m"][0] > 0.015
    if finish == "ball":  # coming down has margins of its own: those of `ball_descend`
        assert rows["clearance_min_m"][0] > 0
    assert rows["slip_max_m"][0] < (0.03 if finish == "ball" else 0.06)


@pytest.mark.slow
@pytest.mark.parametrize("gap", [0.1, 1.3])
def test_the_plan_is_for_every_gap(gap):
    """Numbers follow sizes in proportion: what was searched for close to nominal must not lead astray far from it."""
    assert outcomes(["scenario=ball_to_ball", f"obstacle.gap={gap}"])["outcome"].tolist() == ["success"]


@pytest.mark.slow
@pytest.mark.parametrize("engine", ["mjx", "native"])
def test_what_the_checks_have_mended_succeeds(engine):
    """All three: the base goes on, a foot stands farther, another one nearer after a squat as low as may be."""
    trial = compose(["scenario=ball_to_ball", f"engine={engine}", "manoeuvre.spare=0.1"])
    case = replace(trial.case, plan=trial.case.plan.replace_number("over.front2.front.ahead", -0.2))
    simulation = make_engine(replace(trial.settings, width=1), case, case, trial.thresholds)
    figures = simulation.run(case, case, np.arange(1))
    rows = {**figures, **classify(figures, trial.thresholds, simulation.stages)}
    assert rows["outcome"].tolist() == ["success"], rows["cause"]
    assert rows["leg_gap_min_m"][0] > 0.01
    assert rows["clearance_min_m"][0] > 0

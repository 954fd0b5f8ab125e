"""The plan of a climb up a ladder: frames, reversal, distances, and what is refused."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from sweep.config.experiment import compose
from sweep.controllers.frames import stance_to_world
from sweep.controllers.plan import Plan, stage_start_pose
from sweep.core.errors import InputError
from sweep.core.rotations import exponential, matrix, multiply
from sweep.models.frames import WORLD_FRAME, body_frame_number
from sweep.models.obstacles.surface import body_poses
from sweep.models.posture import Stance
from sweep.planning.kinematic_margins import planned_margins
from sweep.planning.symmetry import reverse_in_time

CASE = compose(["scenario=ladder_climb"]).case
FREE = CASE.obstacle.start()


@pytest.fixture(scope="module")
def plan() -> Plan:
    return jax.jit(lambda: CASE.manoeuvre.plan_without_forces(CASE))()


@jax.jit
def ends(plan: Plan) -> tuple[Stance, Stance]:
    """Where every stage begins and ends, world axes."""

    def one(k):
        last = Stance(plan.foothold[k], plan.position[k], multiply(exponential(plan.turn[k]), plan.quat[k]))
        both = Stance(*stage_start_pose(plan, k, FREE), plan.quat[k]), last
        first, last = (stance_to_world(each, plan.foot_frame[k], plan.base_frame[k], FREE) for each in both)
        return first, last

    return jax.vmap(one)(jnp.arange(plan.duration.shape[0]))


def same(one: Stance, other: Stance):
    np.testing.assert_allclose(one.feet, other.feet, atol=1e-5)
    np.testing.assert_allclose(one.position, other.position, atol=1e-5)
    np.testing.assert_allclose(matrix(one.quat), matrix(other.quat), atol=1e-5)


def test_stages_fit_together_where_frames_change(plan):
    """From the world's frame to the ladder's and back: what one stage ends with, the next begins with."""
    assert {WORLD_FRAME, body_frame_number(0)} == set(np.unique(plan.foot_frame)) == set(np.unique(plan.base_frame))
    first, last = ends(plan)
    same(Stance(*(x[1:] for x in first)), Stance(*(x[:-1] for x in last)))
    same(Stance(*(x[0] for x in first)), plan.start)


def test_backwards_it_goes_through_the_same_stances(plan):
    first, last = ends(plan)
    back_first, back_last = ends(reverse_in_time(plan, FREE))
    same(Stance(*(x[::-1] for x in back_last)), first)
    same(Stance(*(x[::-1] for x in back_first)), last)


def test_up_and_down_feet_go_to_where_they_stand_in_its_frame(plan):
    """A foothold on a ladder that has come to rest elsewhere is where the ladder is; one beside it is not."""
    for way in (plan, reverse_in_time(plan, FREE)):
        feet = ends(way)[1].feet
        body = CASE.obstacle.surface(feet.reshape(-1, 3), (-1,) * (feet.size // 3), body_poses(FREE)).body.reshape(
            -1, 6
        )
        swing = np.asarray(way.swing)
        assert set(np.asarray(body[swing])) == {-1, 0}
        np.testing.assert_array_equal(
            way.foot_frame[swing], np.where(body[swing] == 0, body_frame_number(0), WORLD_FRAME)
        )
    twice = reverse_in_time(way, FREE)
    np.testing.assert_array_equal(twice.foot_frame, plan.foot_frame)
    np.testing.assert_allclose(twice.curve.guides[plan.curve.guided], plan.curve.guides[plan.curve.guided], atol=1e-5)


@pytest.mark.slow
def test_it_keeps_clear_of_ladder_ledge_and_its_own_legs(plan):
    number, phases = jnp.arange(len(plan.names)), jnp.linspace(0, 1, 9)
    found = jax.jit(jax.vmap(jax.vmap(lambda k, u: planned_margins(CASE, plan, k, u), (None, 0)), (0, None)))(
        number, phases
    )
    assert found.legs.min() > 0.03
    assert found.base.min() > 0.005
    assert found.links.min() > -0.003  # the judge allows 5 mm, as for the next
    assert found.fold.min() > -0.003
    assert found.reach.min() > 0.01
    assert found.outer.min() > 0.005  # or a leg turns over


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        (
            ["obstacle.length=2.2", "obstacle.rung_step=0.36"],
            r"ledge_height = 2.625 .* reach at the end of stage climb",
        ),
        (["obstacle.ledge_height=3.0"], r"ledge_height = 3 .* reach at the end of stage climb"),
        (["obstacle.rungs=4"], "obstacle.rungs = 4 is not allowed: at least 5 for the moves of part climb"),
        (["obstacle.floor_grip=0.1"], r"obstacle.lean = 1.309 .* the ladder slides under the robot at its top"),
        (["obstacle.length=2.8"], "obstacle.length = 2.8 is not allowed"),
    ],
)
def test_ladders_that_cannot_be_climbed_are_refused(changes, said):
    case = compose(["scenario=ladder_climb", *changes]).case
    with pytest.raises(InputError, match=said):
        case.manoeuvre.plan(case)

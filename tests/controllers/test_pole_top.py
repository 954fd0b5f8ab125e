"""The plan over a pole's edge on to its top: in reach, clear of the pole, legs apart, following the belief."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from sweep.case import Case
from sweep.config import compose
from sweep.controllers.manoeuvres.pole_top import RIM
from sweep.controllers.plan import Plan, along_guides, reference
from sweep.controllers.tracker import joint_targets
from sweep.formulas.leg import SIDE, fk
from sweep.maths import matrix, rotate
from sweep.metrics.geometry import leg_gap, link_points
from sweep.models.obstacles.surface import no_bodies, poses
from sweep.models.scene import mounts

U = np.linspace(0, 1, 41)


@pytest.fixture(scope="module")
def case() -> Case:
    return compose(["scenario=pole_top", "manoeuvre.forces=deepening"]).case


@jax.jit
def play(case: Case) -> tuple[Plan, dict[str, jax.Array]]:
    """The plan, and for `U` of every stage (S, U): reach shortfall, clearance of the links, gap of legs, base, feet."""
    plan, robot = case.manoeuvre.plan(case), case.robot

    def at(k, u, begin):
        stance = reference(plan, k, u, *begin)
        joints, shortfall = joint_targets(robot, stance)
        knee = fk(SIDE, joints.at[:, 2].set(0.0), 0.0, robot.thigh, 0.0)
        foot = fk(SIDE, joints, 0.0, robot.thigh, robot.shin)
        legs = mounts(robot)[:, None] + jnp.stack([jnp.zeros((6, 3)), knee, foot], axis=1)
        legs = rotate(stance.quat[None, None], legs) + stance.position
        points = link_points(legs)
        depth = case.obstacle.surface(points, (-1,) * points.shape[0], poses(no_bodies())).depth
        return stance, {
            "shortfall": shortfall.max(), "clearance": -depth.max() - robot.link_radius,
            "gap": leg_gap(legs) - 2 * robot.link_radius, "position": stance.position, "quat": stance.quat,
        }  # fmt: skip

    def stage(begin, k):
        stance, seen = jax.vmap(lambda u: at(k, u, begin))(jnp.asarray(U, float))
        return (stance.feet[-1], stance.position[-1]), seen

    return plan, jax.lax.scan(stage, (plan.start.feet, plan.start.position), jnp.arange(len(plan.names)))[1]


def test_links_stay_in_reach_clear_of_the_pole_and_apart(case):
    plan, seen = play(case)
    first = plan.names.index("edge.front")
    assert seen["shortfall"].max() == 0
    assert seen["clearance"][first:].min() > 0
    assert seen["gap"][first:].min() > 0.005


def test_it_ends_level_with_all_feet_on_the_top_off_the_rim(case):
    plan, seen = play(case)
    feet = np.asarray(plan.foothold[-1])
    top = case.obstacle.height
    np.testing.assert_allclose(feet[:, 2], top, atol=0.005)
    assert np.hypot(feet[:, 0], feet[:, 1]).max() < RIM * case.obstacle.radius + 1e-6
    np.testing.assert_allclose(matrix(seen["quat"][-1, -1])[2], [0, 0, 1], atol=1e-6)
    np.testing.assert_allclose(seen["position"][-1, -1], [0, 0, top + 0.62 * case.robot.body_length], atol=1e-6)


def test_it_follows_what_is_believed(case):
    random = np.random.default_rng(1)
    for _ in range(3):
        scale = random.uniform(0.98, 1.02, 5)
        robot = replace(case.robot, body_length=1.05 * scale[0], body_width=0.5 * scale[1], thigh=0.52 * scale[2],
                        shin=0.335 * scale[3])  # fmt: skip
        other = replace(case, robot=robot, obstacle=replace(case.obstacle, radius=0.42 * scale[4]))
        plan, seen = play(other)
        first = plan.names.index("edge.front")
        assert seen["shortfall"].max() < 0.005
        assert seen["clearance"][first:].min() > -0.005
        assert seen["gap"][first:].min() > -0.005
        assert np.hypot(plan.foothold[-1, :, 0], plan.foothold[-1, :, 1]).max() < 0.42 * scale[4]


def test_guides_shape_a_swing_and_keep_it_in_their_hull():
    start, end = jnp.zeros(3), jnp.array([1.0, 0, 0])
    guides = jnp.array([[0.0, 0, 2], [1.0, 0, 2]])
    way = np.asarray(jax.vmap(lambda s: along_guides(start, guides, end, s))(jnp.asarray(U, float)))
    np.testing.assert_allclose(way[[0, 20, 40]], [[0, 0, 0], [0.5, 0, 1.5], [1, 0, 0]], atol=1e-6)
    assert way.min() >= 0
    assert way[:, 2].max() < 2

"""The way from a corner on to the roof: what its plan asks for, without physics."""

from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest
from playing import play

from sweep.case import Case
from sweep.config import compose
from sweep.controllers import forces
from sweep.controllers.manoeuvres.corner_roof import below_edge, over_edge, walk_on
from sweep.controllers.plan import Plan, Stance, assemble
from sweep.formulas.leg import SIDE
from sweep.maths import matrix


@pytest.fixture(scope="module")
def case() -> Case:
    return compose(["scenario=corner_full"]).case


def plan_of(case: Case) -> Plan:
    """From the end of the gallop on, without the forces."""
    site, feet = case.manoeuvre.site(case), {}
    heights = below_edge(site, case.obstacle.height)
    for legs, height in heights.items():
        feet |= site.on_wall(legs, height)
    places = jnp.stack([feet[leg] for leg in range(1, 7)])
    start = Stance(places, site.between(heights), jnp.array([0.5, -0.5, -0.5, -0.5]))
    return assemble(start, [*over_edge(site, case), *walk_on(site, case, 10, 0.1)], 0.5)


@pytest.mark.parametrize("change", [1.0, 1.01])
def test_links_stay_in_reach_clear_of_the_house_and_apart(case, change):
    robot = replace(case.robot, body_length=1.05 * change, thigh=0.52 / change)
    other = replace(case, robot=robot)
    seen = play(other, plan_of(other))
    assert seen["shortfall"].max() < 0.001
    assert seen["clearance"].min() > 0
    assert seen["gap"].min() > 0
    # a leg whose foot passes under its hip turns over at once
    out = SIDE * np.asarray(seen["feet"])[..., 0]
    assert out.min() > robot.body_width / 2


def test_the_robot_ends_level_on_the_roof_off_its_edges(case):
    plan = plan_of(case)
    seen = play(case, plan)
    feet = np.asarray(plan.foothold[-1])
    np.testing.assert_allclose(feet[:, 2], case.obstacle.height, atol=1e-6)
    assert np.all(np.abs(feet[:, 0]) < -feet[:, 1] * np.tan(case.obstacle.half_angle) - 0.05)
    np.testing.assert_allclose(matrix(seen["quat"][-1, -1])[2], [0, 0, 1], atol=1e-6)


@pytest.mark.slow
def test_every_stance_is_held_with_less_friction_than_the_gallop(case):
    """The book's friction is 1.1; the gallop needs 1.06, the way over the edge no more."""
    course = forces.along(case, plan_of(case), forces.Bounds(1.1, 0.85 * 380.0, 8.0), "friction")
    assert float(course.planned.imbalance.max()) < 0.01
    assert 1.0 < float(course.planned.friction.max()) < 1.06

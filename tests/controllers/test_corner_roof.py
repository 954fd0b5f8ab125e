"""The way from a corner on to the roof: what its plan asks for, without physics."""

from dataclasses import replace

import numpy as np
import pytest
from playing import play_plan, vary_lengths

from sweep.config.experiment import compose
from sweep.controllers.plan import Plan
from sweep.core.errors import InputError
from sweep.core.rotations import matrix
from sweep.models.case import Case
from sweep.models.robot import length_unit
from sweep.planning import forces
from sweep.planning.compile_plan import compile_plan


@pytest.fixture(scope="module")
def case() -> Case:
    return compose(["scenario=corner_full"]).case


def plan_of(case: Case) -> Plan:
    """The whole way, without the forces and the rests that they need."""
    return compile_plan(*case.manoeuvre.route_stages(case), 0.5)


@pytest.mark.parametrize(("share", "seed"), [(0.0, 0), (0.02, 101), (0.02, 102), (0.04, 103)])
def test_base_and_links_stay_in_reach_clear_of_the_house_and_apart(case, share, seed):
    """True distances. Shins come as near to the house as the foot's end of them leans."""
    other = vary_lengths(case, share, seed, heights=share)
    plan = plan_of(other)
    seen = {key: np.asarray(value) for key, value in play_plan(other, plan).items()}
    over = np.char.startswith(plan.names, "roof.")
    assert seen["base"][over][1:].min() > 0.012  # the first begins where the climb ends
    assert seen["base"].min() > 0.003
    assert seen["links"][over].min() > 0.0
    assert seen["legs"].min() > 0.02
    assert seen["body"].min() > 0.005  # of thighs from near their hips on, along the base's sides
    assert seen["swing"].min() > 0.015
    assert seen["rate"].min() > -6  # rad/s: a leg whose foot passes under its hip turns over at once
    if share < 0.04:
        assert seen["reach"].min() > 0.003
        assert seen["links"].min() > -0.002


def test_the_climb_touches_nothing(case):
    plan = plan_of(case)
    assert play_plan(case, plan)["links"].min() > -5e-4


def test_the_robot_ends_level_on_the_roof_off_its_edges(case):
    plan = plan_of(case)
    seen = play_plan(case, plan)
    feet = np.asarray(plan.foothold[-1])
    np.testing.assert_allclose(feet[:, 2], case.obstacle.height, atol=1e-6)
    assert np.all(np.abs(feet[:, 0]) < -feet[:, 1] * np.tan(case.obstacle.half_angle) - 0.05)
    np.testing.assert_allclose(matrix(seen["quat"][-1, -1])[2], [0, 0, 1], atol=1e-6)


@pytest.mark.parametrize(
    ("height", "told"),
    [(2.0, "obstacle.height = 2 is not allowed: at least 2.07 m"),
     (3.0, "manoeuvre.cycles = 2 is not allowed: at least 4 for obstacle.height = 3 m")],
)  # fmt: skip
def test_a_house_that_the_gallop_does_not_end_at_is_refused(case, height, told):
    other = replace(case, obstacle=replace(case.obstacle, height=height))
    with pytest.raises(InputError, match=told):
        other.manoeuvre.plan(other)


@pytest.mark.slow
def test_the_way_over_the_edge_needs_no_more_friction_than_the_climb(case):
    """The book's friction is 1.1; the climb needs 1.06."""
    plan = plan_of(case)
    course = forces.plan_forces(case, plan, forces.ForceBounds(1.1, 0.85 * 380.0, 8.0), "friction")
    needed, over = np.asarray(course.optimum.friction.max(axis=1)), np.char.startswith(plan.names, "roof.")
    assert float(course.optimum.imbalance.max()) < 0.01
    assert needed[over].max() <= needed[~over].max() < 1.07


def test_what_a_search_raises_a_formula_by_stays_raised():
    """Of the gallop's rise, which is made not a number where a house is too low."""
    case = compose(["scenario=corner_full"]).case
    lower = replace(case, plan=case.plan.increment_number("sizes.rise", -0.02).increment_number("sizes.rise", -0.01))
    ends = [{stage.name: stage.position for stage in one.manoeuvre.route_stages(one)[1]} for one in (case, lower)]
    off = ends[1]["gallop2.up"] - ends[0]["gallop2.up"]
    np.testing.assert_allclose(off, [0, 0, -0.03 * 0.75 * length_unit(case.robot)], atol=1e-6)  # after 1.5 of 2 cycles

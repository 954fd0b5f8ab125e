"""Plans backwards in time, in a mirror and one after the other."""

from dataclasses import replace

import jax
import numpy as np
import pytest
from test_pole import play_plan

from sweep.config.experiment import compose
from sweep.controllers.plan import Plan
from sweep.core.rotations import matrix
from sweep.models.case import Case
from sweep.models.posture import Stance
from sweep.planning.plan_table import evaluate_plan
from sweep.planning.symmetry import OTHER_SIDE, join_plans, last_stance, mirror_plan, reverse_in_time

SHORT = ["manoeuvre.steps=0", "manoeuvre.cycles=1", "manoeuvre.down_cycles=0", "obstacle.ledge_height=0.3"]
NORMAL = np.array([0.6, 0.0, 0.8])


pytestmark = pytest.mark.usefixtures("double")


@pytest.fixture(scope="module")
def case() -> Case:
    return compose(["scenario=pole_round", *SHORT]).case


@pytest.fixture(scope="module")
def plan(case) -> Plan:
    """Swings of several cycles, planes and guides, a base that goes round bends and turns."""
    with jax.enable_x64(True):
        return jax.jit(lambda c: c.manoeuvre.plan(c))(case)


wanted = jax.jit(play_plan)


def references(case: Case, plan: Plan) -> Stance:
    return wanted(case, replace(plan, names=("",) * len(plan.names)))[0]  # other names would compile anew


def same_attitude(a, b):
    np.testing.assert_allclose(np.abs(np.sum(np.asarray(a) * np.asarray(b), axis=-1)), 1, atol=1e-12)


def same_plan(a: Plan, b: Plan):
    assert a.names == b.names
    turned = {"quat": (a.quat, b.quat), "start": (a.start.quat, b.start.quat)}
    for one, other in turned.values():
        same_attitude(one, other)
    for name in ("duration", "swing", "foothold", "curve", "position", "turn", "path"):
        for one, other in zip(*map(jax.tree.leaves, (getattr(a, name), getattr(b, name))), strict=True):
            np.testing.assert_allclose(one, other, atol=1e-12, err_msg=name)
    assert (a.onset, a.laws) == (b.onset, b.laws)
    np.testing.assert_allclose(a.start.feet, b.start.feet, atol=1e-12)
    np.testing.assert_allclose(a.start.position, b.start.position, atol=1e-12)


def test_back_at_any_time_is_where_it_was(case, plan):
    there, back = references(case, plan), references(case, reverse_in_time(plan))
    np.testing.assert_allclose(back.feet[::-1, ::-1], there.feet, atol=1e-9)
    np.testing.assert_allclose(back.position[::-1, ::-1], there.position, atol=1e-9)
    same_attitude(back.quat[::-1, ::-1], there.quat)


def test_twice_backwards_or_mirrored_is_the_plan(plan):
    same_plan(reverse_in_time(reverse_in_time(plan)), plan)
    same_plan(mirror_plan(mirror_plan(plan, NORMAL), NORMAL), plan)


def test_the_mirror_image_of_what_a_plan_wants_is_what_its_mirror_image_wants(case, plan):
    mirror = np.eye(3) - 2 * np.outer(NORMAL, NORMAL)
    there, image = references(case, plan), references(case, mirror_plan(plan, NORMAL))
    np.testing.assert_allclose(image.feet, (there.feet @ mirror)[:, :, OTHER_SIDE], atol=1e-9)
    np.testing.assert_allclose(image.position, there.position @ mirror, atol=1e-9)
    expected = mirror @ np.asarray(matrix(there.quat)) @ np.diag([1, -1, 1])  # the base is its own mirror image
    np.testing.assert_allclose(matrix(image.quat), expected, atol=1e-9)


def test_joined_plans_follow_each_other(case, plan):
    back = reverse_in_time(plan)
    both = join_plans(plan, back)
    assert both.names == plan.names + back.names
    stances = references(case, both)
    np.testing.assert_allclose(stances.feet[::-1, ::-1], stances.feet, atol=1e-9)
    np.testing.assert_allclose(last_stance(both).feet, plan.start.feet, atol=1e-12)


def test_round_the_pole_ends_behind_it_on_the_ledge(case, plan):
    stances, shortfall = wanted(case, plan)
    assert shortfall.max() == 0
    ledge, length = case.obstacle.ledge_height, case.robot.body_length
    end = last_stance(plan)
    np.testing.assert_allclose(end.feet[:, 2], ledge, atol=1e-9)
    assert np.all(end.feet[:, 1] < -case.obstacle.radius)
    np.testing.assert_allclose(
        end.position[2], ledge + (0.5 - evaluate_plan(case)["sizes"]["lower"]) * length, atol=1e-9
    )
    np.testing.assert_allclose(matrix(end.quat)[:, 0], [0, 1, 0], atol=1e-9)  # it looks back at the pole
    # consecutive parts of the plan fit together: nothing jumps between stages
    for values in (stances.feet, stances.position):
        np.testing.assert_allclose(values[1:, 0], values[:-1, -1], atol=1e-9)
    same_attitude(stances.quat[1:, 0], stances.quat[:-1, -1])
    going = [k for k, name in enumerate(plan.names) if name.startswith("round")]
    distance = np.hypot(stances.feet[going, ..., 0], stances.feet[going, ..., 1])
    assert distance.min() > case.obstacle.radius - 5e-3 - 1e-9

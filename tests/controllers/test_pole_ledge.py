"""The plans from a pole's top on to a ledge: in reach, clear of pole and ledge, legs apart, the robot's weight held."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from playing import play_case, vary_lengths
from slow_cases import mark_slow_cases

from sweep.config.experiment import compose
from sweep.controllers.plan import Plan, reference_stance
from sweep.core.rotations import matrix, rotate
from sweep.models.case import Case
from sweep.models.geometry import support_margin
from sweep.models.posture import Stance, joint_targets, mass_centre

RADIUS, LENGTH = 0.42, 1.05  # m
HEIGHT = {"level": -0.2, "above": 0.35, "below": -0.6}  # a_r, of the ledge over the pole's top


@pytest.fixture(scope="module", params=mark_slow_cases(HEIGHT, ["below", "above"]))
def case(request) -> Case:
    return compose([f"scenario=pole_ledge_{request.param}", "manoeuvre.forces=deepening"]).case


def test_the_ledge_is_as_high_as_the_book_has_it(request, case):
    over = case.obstacle.ledge_height - case.obstacle.height
    np.testing.assert_allclose(over, HEIGHT[request.node.callspec.params["case"]] * LENGTH, atol=1e-12)


def test_links_stay_in_reach_clear_of_pole_and_ledge_and_apart(case):
    plan, seen = play_case(case)
    first = plan.names.index("ledge.back")
    assert seen["reach"].min() > 0
    assert seen["base"][first:].min() > 0.008
    assert seen["links"][first:].min() > -0.005
    assert seen["body"][first:].min() > -0.005
    assert seen["legs"][first:].min() > 0.01


def test_the_mass_centre_stays_over_the_standing_feet(case):
    plan, _ = play_case(case)
    first = plan.names.index("ledge.back")
    assert margins(case, plan)[first:].min() > 0.03  # m


@jax.jit
def margins(case: Case, plan: Plan) -> jax.Array:
    """How far (m) the planned centre of mass is inside the standing feet's polygon, at the ends of every stage."""
    feet = jnp.concatenate([plan.start.feet[None], plan.foothold[:-1]])
    base = jnp.concatenate([plan.start.position[None], plan.position[:-1]])

    def at(k, u):
        stance: Stance = reference_stance(plan, k, u, feet[k], base[k])
        joints, _ = joint_targets(case.robot, stance)
        centre = stance.position + rotate(stance.quat, mass_centre(case.robot, joints))
        return support_margin(stance.feet[:, :2], ~plan.swing[k], centre[:2])

    return jax.vmap(lambda k: jax.vmap(lambda u: at(k, u))(jnp.linspace(0, 1, 5)))(jnp.arange(len(plan.names)))


def test_it_ends_level_on_the_ledge_and_stands_off_every_edge_on_the_way(case):
    plan, seen = play_case(case)
    feet = np.asarray(plan.foothold[plan.names.index("ledge.back") :]).reshape(-1, 3)
    beyond = -feet[:, 1] - RADIUS
    on_top = np.isclose(feet[:, 2], case.obstacle.height, atol=0.005)  # some are pressed in by 3 mm
    np.testing.assert_allclose(feet[~on_top, 2], case.obstacle.ledge_height, atol=1e-6)
    assert beyond[~on_top].min() > 0.04 * LENGTH
    assert np.hypot(feet[on_top, 0], feet[on_top, 1]).max() < 0.9 * RADIUS
    assert not np.isclose(plan.foothold[-1, :, 2], case.obstacle.height).any()
    np.testing.assert_allclose(matrix(seen["quat"][-1, -1])[2], [0, 0, 1], atol=1e-6)


@pytest.mark.slow
def test_it_follows_what_is_believed(case):
    for seed in (2, 3):
        other = vary_lengths(case, 0.02, seed)
        plan, seen = play_case(other)
        first = plan.names.index("ledge.back")
        assert seen["reach"].min() > -0.005
        assert seen["base"][first:].min() > 0
        assert seen["links"][first:].min() > -0.008
        assert seen["legs"][first:].min() > -0.005
        assert margins(other, plan)[first:].min() > 0.02

"""The plan over a pole's edge on to its top: in reach, clear of the pole, legs apart, following the belief."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from playing import U, play_case

from sweep.config.experiment import compose
from sweep.controllers.plan import Stage, reference_stance
from sweep.core.rotations import matrix
from sweep.models.case import Case
from sweep.models.posture import Stance
from sweep.planning.compile_plan import compile_plan


@pytest.fixture(scope="module")
def case() -> Case:
    return compose(["scenario=pole_top", "manoeuvre.forces=deepening"]).case


def test_links_stay_in_reach_clear_of_the_pole_and_apart(case):
    plan, seen = play_case(case)
    first = plan.names.index("edge.front")
    assert seen["reach"].min() > 0
    assert seen["links"][first:].min() > -0.005
    assert seen["base"][first:].min() > 0.003
    assert seen["legs"][first:].min() > 0.005


def test_it_ends_level_with_all_feet_on_the_top_off_the_rim(case):
    plan, seen = play_case(case)
    feet = np.asarray(plan.foothold[-1])
    top = case.obstacle.height
    np.testing.assert_allclose(feet[:, 2], top, atol=0.005)
    assert np.hypot(feet[:, 0], feet[:, 1]).max() < 0.875 * case.obstacle.radius + 1e-6
    np.testing.assert_allclose(matrix(seen["quat"][-1, -1])[2], [0, 0, 1], atol=1e-6)
    np.testing.assert_allclose(seen["position"][-1, -1], [0, 0, top + 0.62 * case.robot.body_length], atol=1e-6)


@pytest.mark.slow
def test_it_follows_what_is_believed(case):
    random = np.random.default_rng(1)
    for _ in range(3):
        scale = random.uniform(0.98, 1.02, 5)
        robot = replace(case.robot, body_length=1.05 * scale[0], body_width=0.5 * scale[1], thigh=0.52 * scale[2],
                        shin=0.335 * scale[3])  # fmt: skip
        other = replace(case, robot=robot, obstacle=replace(case.obstacle, radius=0.42 * scale[4]))
        plan, seen = play_case(other)
        first = plan.names.index("edge.front")
        assert seen["reach"].min() > -0.005
        assert seen["base"][first:].min() > 0
        assert seen["legs"][first:].min() > -0.005
        assert np.hypot(plan.foothold[-1, :, 0], plan.foothold[-1, :, 1]).max() < 0.42 * scale[4]


def test_guides_shape_a_swing_and_keep_it_in_their_hull():
    start = Stance(jnp.zeros((6, 3)), jnp.zeros(3), jnp.array([1.0, 0, 0, 0]))
    swing, guides = {2: jnp.array([1.0, 0, 0])}, {2: jnp.array([[0.0, 0, 2], [1.0, 0, 2]])}

    @jax.jit
    def feet(phase):
        plan = compile_plan(start, [Stage("swing", 1.0, swing=swing, guides=guides, carry=1.0)], 0.0)
        return reference_stance(plan, jnp.int32(0), phase, start.feet, start.position).feet

    way = np.asarray(jax.vmap(feet)(jnp.asarray(U, float)))[:, 1]
    np.testing.assert_allclose(way[[0, 20, 40]], [[0, 0, 0], [0.5, 0, 1.5], [1, 0, 0]], atol=1e-6)
    assert way.min() >= 0
    assert way[:, 2].max() < 2

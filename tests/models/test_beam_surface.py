"""The beam and its ledges as feet feel them."""

import jax.numpy as jnp
import numpy as np
import pytest

from sweep.models.obstacles import Beam
from sweep.models.obstacles.surface import body_poses, empty_free_body_state

BEAM = Beam(width=0.25, length=2.0, height=1.0, thickness=0.1)
UP, LEFT, RIGHT, DOWN, NEAR, FAR = (0, 0, 1), (1, 0, 0), (-1, 0, 0), (0, 0, -1), (0, -1, 0), (0, 1, 0)


@pytest.mark.parametrize(
    ("point", "depth", "normal"),
    [
        ((0.1, -1.0, 0.999), 0.001, UP),  # on the beam
        ((0.124, -1.0, 0.95), 0.001, LEFT),
        ((-0.124, -1.0, 0.95), 0.001, RIGHT),
        ((0.0, -1.0, 0.901), 0.001, DOWN),
        ((0.13, -1.0, 1.02), -0.02, UP),  # above its edge: outside, by the farthest face
        ((0.4, -1.0, 0.999), -0.275, LEFT),  # beside it there is nothing to stand on
        ((0.4, 0.3, 0.999), 0.001, UP),  # on the near ledge
        ((0.4, -2.3, 0.999), 0.001, UP),  # on the far ledge
        ((0.4, 0.001, 0.5), 0.001, NEAR),  # at the walls
        ((0.4, -2.001, 0.5), 0.001, FAR),
        ((0.4, -1.0, 0.01), -0.01, UP),  # over the floor
        ((0.05, 1e-4, 0.999), 0.001, UP),  # no edge where the beam meets the ledge
        ((0.05, -2.0 - 1e-4, 0.999), 0.001, UP),
    ],
)
def test_depth_and_normal(point, depth, normal):
    felt = BEAM.surface(jnp.array([point], jnp.float32), (-1,), body_poses(empty_free_body_state()))
    assert float(felt.depth[0]) == pytest.approx(depth, abs=1e-6)
    np.testing.assert_array_equal(felt.normal[0], normal)

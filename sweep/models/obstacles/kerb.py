"""A step up in level ground."""

from typing import ClassVar

import jax.numpy as jnp
from jaxtyping import Array, Float

from sweep.core.parameters import choice, parameters, quantity
from sweep.models.obstacles.base import StaticObstacle
from sweep.models.obstacles.charts import ALONG_X, approach_charts, level_ground_charts
from sweep.models.obstacles.surface import BodyPoses, Surface
from sweep.models.solids import SOIL, Box, HalfSpace, Solid

FLOOR, TOP, WALL = range(3)
BLOCK_HALF_SIZE_M = 5.0  # m, of the block that is drawn; its surface has no end
BEYOND_EDGE_CHART, OVER_EDGE_BASE_CHART = level_ground_charts(lambda obstacle: (0.0, obstacle.height))


@parameters
class Kerb(StaticObstacle):
    """A step up in level ground, by default 0.1 m high: the ground is higher where x > 0."""

    # `floor` and `top` for feet before and beyond the edge, `foot` and `edge` for bases from there
    charts: ClassVar = {
        **approach_charts(lambda obstacle: 0.0, ALONG_X),
        "top": BEYOND_EDGE_CHART,
        "edge": OVER_EDGE_BASE_CHART,
    }
    forward = ALONG_X
    heights = ("height",)
    kind: str = choice("kerb", "kerb")
    height: float = quantity(0.1, "m", above=0, at_most=1)  # of the ground beyond the edge, above that before it

    def solids(self, bodies: BodyPoses) -> tuple[Solid, ...]:
        """Return the lower ground and the raised block as solids; the block ends where no robot reaches."""
        floor, half = HalfSpace(name="floor", normal=(0.0, 0.0, 1.0)), self.height / 2
        return floor, Box(
            name="kerb",
            position=(BLOCK_HALF_SIZE_M, 0.0, half),
            half=(BLOCK_HALF_SIZE_M, BLOCK_HALF_SIZE_M, half),
            colour=SOIL,
        )

    def surface(self, points: Float[Array, "n 3"], owner: tuple[int, ...], bodies: BodyPoses) -> Surface:
        """Return the contact surface at points: that of ground or raised block, whichever they are deeper in."""
        x, _, z = points.T
        block = jnp.minimum(x, self.height - z)
        face = jnp.select([-z >= block, x <= self.height - z], [FLOOR, WALL], TOP)
        normal = jnp.where((face == WALL)[:, None], jnp.array([-1.0, 0.0, 0.0]), jnp.array([0.0, 0.0, 1.0]))
        return Surface(jnp.maximum(-z, block), normal, face, jnp.full_like(face, -1), jnp.ones_like(x))

"""A narrow beam between two ledges of one height (monograph 2.6)."""

from typing import ClassVar

import jax.numpy as jnp
from jaxtyping import Array, Float

from sweep.core.parameters import choice, parameters, quantity
from sweep.models.obstacles.base import StaticObstacle
from sweep.models.obstacles.charts import ALONG_Y, level_ground_charts
from sweep.models.obstacles.surface import FOOT_RADIUS, BodyPoses, Surface
from sweep.models.solids import SOIL, Box, HalfSpace, Solid

FLOOR, LEDGE, NEAR_WALL, FAR_WALL, TOP, LEFT, RIGHT, BOTTOM = range(8)
LEDGE_HALF_LENGTH_M = 2.0  # m, of a ledge's drawing and collision geometry; its surface has no end
NEAR_LEDGE_CHART, NEAR_LEDGE_BASE_CHART = level_ground_charts(lambda obstacle: (0.0, obstacle.height), ALONG_Y)
FAR_LEDGE_CHART, FAR_LEDGE_BASE_CHART = level_ground_charts(
    lambda obstacle: (obstacle.length, obstacle.height), ALONG_Y
)


@parameters
class Beam(StaticObstacle):
    """A narrow beam between two ledges.

    It lies along the world's y axis, its top level with the ledges, which fill y > 0 and y < -length."""

    # for feet, and for bases, from the edges of the ledges; the beam's top is ahead of the near one
    charts: ClassVar = {
        "near": NEAR_LEDGE_CHART,
        "far": FAR_LEDGE_CHART,
        "by_near": NEAR_LEDGE_BASE_CHART,
        "by_far": FAR_LEDGE_BASE_CHART,
    }
    heights = ("height",)
    kind: str = choice("beam", "beam")
    width: float = quantity(0.25, "m", above=0, at_most=4)  # of the beam's top, along the world's x axis
    length: float = quantity(2.0, "m", above=0)  # of the gap between the ledges
    height: float = quantity(1.0, "m", above=0)  # h_1, of the ledges and the beam's top above the floor
    thickness: float = quantity(0.1, "m", above=0)  # of the beam, from its top down

    def solids(self, bodies: BodyPoses) -> tuple[Solid, ...]:
        """Return the solids: the beam and both ledges; the beam overlaps the ledges by the foot radius."""
        half, length, thickness = self.height / 2, self.length / 2, self.thickness / 2
        ledges = (("near_ledge", LEDGE_HALF_LENGTH_M), ("far_ledge", -self.length - LEDGE_HALF_LENGTH_M))
        return (
            HalfSpace(name="floor", normal=(0.0, 0.0, 1.0)),
            *[
                Box(
                    name=name,
                    position=(0.0, y, half),
                    half=(LEDGE_HALF_LENGTH_M, LEDGE_HALF_LENGTH_M, half),
                    colour=SOIL,
                )
                for name, y in ledges
            ],
            Box(
                name="beam",
                position=(0.0, -length, self.height - thickness),
                half=(self.width / 2, length + 2 * FOOT_RADIUS, thickness),
            ),
        )

    def surface(self, points: Float[Array, "n 3"], owner: tuple[int, ...], bodies: BodyPoses) -> Surface:
        """Return the contact surface at points: that of the solid (beam or ledge) in which each point lies deepest.

        The beam goes on inside the ledges, so that a foot crosses their edges on its top as if there were none.
        """
        x, y, z = points.T
        top = self.height - z
        near, far = y, -self.length - y
        left, right, bottom = self.width / 2 - x, self.width / 2 + x, z - (self.height - self.thickness)
        beam = jnp.stack([top, left, right, bottom])
        solids = jnp.stack([-z, jnp.minimum(top, near), jnp.minimum(top, far), beam.min(axis=0)])
        solid = jnp.argmax(solids, axis=0)
        face = jnp.select(
            [solid == 0, solid == 1, solid == 2],
            [FLOOR, jnp.where(near < top, NEAR_WALL, LEDGE), jnp.where(far < top, FAR_WALL, LEDGE)],
            TOP + jnp.argmin(beam, axis=0),
        )
        normals = jnp.array([[0, 0, 1], [0, 0, 1], [0, -1, 0], [0, 1, 0], [0, 0, 1], [1, 0, 0], [-1, 0, 0], [0, 0, -1]])
        fixed = jnp.full_like(face, -1)
        return Surface(solids.max(axis=0), normals.astype(points.dtype)[face], face, fixed, jnp.ones_like(x))

"""The vertical corner of a house with a flat roof (monograph 2.4)."""

from typing import ClassVar

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from sweep.core.parameters import choice, parameters, quantity
from sweep.models.obstacles.base import StaticObstacle
from sweep.models.obstacles.charts import Chart, Number, approach_charts, edge_chart, stack_components
from sweep.models.obstacles.surface import BodyPoses, Surface
from sweep.models.solids import HalfSpace, Prism, Solid, array_module

FLOOR, RIGHT, LEFT, ROOF = range(4)  # faces; the walls as a robot sees them that comes along -y
HOUSE_DEPTH_M = 3.0  # m, that the house reaches back in y


def wall_point(
    obstacle: "Corner", side: float, unit: Number, depth: Number, aside: Number, above: Number
) -> Float[Array, " 3"]:
    """Return a foothold on a wall (m), given `aside` of the house's vertical edge and `above` the roof."""
    x = aside * unit
    return stack_components(side * x, -x / jnp.tan(obstacle.half_angle), obstacle.height + above * unit)


def roof_point(
    obstacle: "Corner", side: float, unit: Number, depth: Number, aside: Number, ahead: Number
) -> Float[Array, " 3"]:
    """Return a foothold on the roof (m), given `aside` of the middle and `ahead` of the house's vertical edge."""
    return stack_components(side * (aside * unit), -ahead * unit, obstacle.height)


@parameters
class Corner(StaticObstacle):
    """The vertical corner of a house with a flat roof, as an obstacle.

    Two walls that meet in the world's z axis and open towards -y, symmetric about the plane x = 0."""

    # `edge`, for bases, begins where the corner's edge ends; `floor`, and `foot` for bases, where it begins
    charts: ClassVar = {
        **approach_charts(lambda obstacle: 0.0),
        "wall": Chart(("aside", "above"), wall_point),
        "roof": Chart(("aside", "ahead"), roof_point),
        "edge": edge_chart(lambda obstacle: (0.0, obstacle.height)),
    }
    heights = ("height",)
    kind: str = choice("corner", "corner")
    half_angle: float = quantity(np.pi / 4, "rad", at_least=0.2, at_most=1.5)  # psi, of the house between its walls
    height: float = quantity(2.3, "m", above=0)  # h, of the house above the floor

    def walls(self) -> Float[Array, "2 3"]:
        """Outward unit normals of the house's two walls, first of the wall towards -x, then of the one towards +x."""
        cos, sin = jnp.cos(self.half_angle), jnp.sin(self.half_angle)
        zero = jnp.zeros_like(cos)
        return jnp.stack([jnp.stack([-cos, sin, zero]), jnp.stack([cos, sin, zero])])

    def solids(self, bodies: BodyPoses) -> tuple[Solid, ...]:
        """Return floor and house as solids; the house ends so far behind that no robot reaches its back wall."""
        half = HOUSE_DEPTH_M * array_module(self.half_angle).tan(self.half_angle)
        polygon = ((0.0, 0.0), (half, -HOUSE_DEPTH_M), (-half, -HOUSE_DEPTH_M))
        floor = HalfSpace(name="floor", normal=(0.0, 0.0, 1.0))
        return floor, Prism(name="house", polygon=polygon, height=self.height)

    def surface(self, points: Float[Array, "n 3"], owner: tuple[int, ...], bodies: BodyPoses) -> Surface:
        """Return the contact surface at points: that of floor or house, whichever contains the point more deeply."""
        walls = self.walls().astype(points.dtype)
        up = jnp.array([0.0, 0.0, 1.0], points.dtype)
        z = points[:, 2]
        faces = jnp.stack([-(points @ walls[0]), -(points @ walls[1]), self.height - z])  # RIGHT, LEFT, ROOF
        house, face = jnp.min(faces, axis=0), 1 + jnp.argmin(faces, axis=0)
        face = jnp.where(-z >= house, FLOOR, face).astype(jnp.int32)
        normal = jnp.stack([up, walls[0], walls[1], up])[face]
        return Surface(jnp.maximum(-z, house), normal, face, jnp.full_like(face, -1), jnp.ones_like(z))

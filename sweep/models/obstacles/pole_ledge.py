"""A vertical pole on the floor and a ledge behind it (monograph 2.3)."""

from typing import ClassVar

import jax.numpy as jnp
from jaxtyping import Array, Float

from sweep.core.parameters import choice, parameters, quantity
from sweep.models.obstacles.base import StaticObstacle
from sweep.models.obstacles.charts import Chart, Number, approach_charts, edge_chart, stack_components
from sweep.models.obstacles.surface import BodyPoses, Surface
from sweep.models.solids import SOIL, Box, Cylinder, HalfSpace, Solid

FLOOR, SIDE, TOP, LEDGE, WALL = range(5)


def side_point(
    obstacle: "PoleLedge", side: float, unit: Number, depth: Number, ahead: Number, above: Number
) -> Float[Array, " 3"]:
    """Return a foothold on the pole's side (m), `ahead` of its axis (in pole radii) and `above` its top."""
    y = -ahead * obstacle.radius
    return stack_components(
        side * jnp.sqrt(jnp.asarray(obstacle.radius - depth) ** 2 - y**2), y, obstacle.height + above * unit
    )


def top_point(
    obstacle: "PoleLedge", side: float, unit: Number, depth: Number, aside: Number, ahead: Number
) -> Float[Array, " 3"]:
    """Return a foothold on the pole's top (m), `aside` and `ahead` of its axis (in pole radii)."""
    return stack_components(side * aside * obstacle.radius, -ahead * obstacle.radius, obstacle.height - depth)


def ledge_point(
    obstacle: "PoleLedge", side: float, unit: Number, depth: Number, aside: Number, ahead: Number
) -> Float[Array, " 3"]:
    """Return a foothold on the ledge (m), `aside` of the middle (in pole radii) and `ahead` of the ledge's edge."""
    return stack_components(
        side * aside * obstacle.radius, -obstacle.radius - ahead * unit, obstacle.ledge_height - depth
    )


@parameters
class PoleLedge(StaticObstacle):
    """A pole along the world's z axis, and a ledge that fills y < -radius, z < ledge_height."""

    # `axis` and `brink`, for bases, begin at the height of the pole's top: on its axis, and over the ledge's edge;
    # `floor`, and `foot` for bases, at the foot of its axis
    charts: ClassVar = {
        **approach_charts(lambda obstacle: 0.0),
        "side": Chart(("ahead", "above"), side_point),
        "top": Chart(("aside", "ahead"), top_point),
        "ledge": Chart(("aside", "ahead"), ledge_point),
        "axis": edge_chart(lambda obstacle: (0.0, obstacle.height)),
        "brink": edge_chart(lambda obstacle: (-obstacle.radius, obstacle.height)),
    }
    heights = ("height", "ledge_height")
    kind: str = choice("pole_ledge", "pole_ledge")
    radius: float = quantity(0.42, "m", above=0)  # r, of the pole
    height: float = quantity(2.286660689865613, "m", above=0)  # h, of the pole above the floor
    ledge_height: float = quantity(2.076660689865613, "m", above=0)  # h1, of the ledge above the floor

    def solids(self, bodies: BodyPoses) -> tuple[Solid, ...]:
        """Return floor, pole and ledge as solids; the ledge ends where no robot reaches."""
        half, ledge = self.height / 2, self.ledge_height / 2
        return (
            HalfSpace(name="floor", normal=(0.0, 0.0, 1.0)),
            Cylinder(name="pole", position=(0.0, 0.0, half), radius=self.radius, half=half),
            Box(name="ledge", position=(0.0, -self.radius - 1.5, ledge), half=(2.0, 1.5, ledge), colour=SOIL),
        )

    def surface(self, points: Float[Array, "n 3"], owner: tuple[int, ...], bodies: BodyPoses) -> Surface:
        """Return the contact surface at points: of floor, pole or ledge, whichever contains the point most deeply."""
        x, y, z = points.T
        distance = jnp.sqrt(x**2 + y**2 + 1e-12)
        side, top = self.radius - distance, self.height - z
        wall, ledge = -self.radius - y, self.ledge_height - z
        solids = jnp.stack([-z, jnp.minimum(side, top), jnp.minimum(wall, ledge)])
        solid = jnp.argmax(solids, axis=0)
        face = jnp.select(
            [solid == 0, (solid == 1) & (side <= top), solid == 1, wall <= ledge], [FLOOR, SIDE, TOP, WALL], LEDGE
        )
        zero, one = jnp.zeros_like(x), jnp.ones_like(x)
        up = jnp.stack([zero, zero, one], axis=-1)
        outward = jnp.stack([x / distance, y / distance, zero], axis=-1)
        to_wall = jnp.stack([zero, one, zero], axis=-1)
        pick = face[:, None]
        normal = jnp.where(pick == SIDE, outward, jnp.where(pick == WALL, to_wall, up))
        return Surface(solids.max(axis=0), normal, face, jnp.full_like(face, -1), one)

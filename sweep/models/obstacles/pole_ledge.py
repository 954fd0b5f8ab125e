"""A vertical pole on the floor and a ledge behind it (monograph 2.3)."""

from typing import ClassVar

import jax.numpy as jnp
from jaxtyping import Array, Float

from sweep.core.parameters import choice, parameters, quantity
from sweep.models.obstacles.charts import Chart, Number, ahead_above, approached, point
from sweep.models.obstacles.surface import Bodies, Surface
from sweep.models.obstacles.usual import Fixed
from sweep.models.solids import SOIL, Box, Cylinder, HalfSpace, Solid

FLOOR, SIDE, TOP, LEDGE, WALL = range(5)


def on_side(
    of: "PoleLedge", side: float, unit: Number, depth: Number, ahead: Number, above: Number
) -> Float[Array, " 3"]:
    """A point of the pole's side: `ahead` of its axis (r), `above` its top."""
    y = -ahead * of.radius
    return point(side * jnp.sqrt(jnp.asarray(of.radius - depth) ** 2 - y**2), y, of.height + above * unit)


def on_top(
    of: "PoleLedge", side: float, unit: Number, depth: Number, aside: Number, ahead: Number
) -> Float[Array, " 3"]:
    """A point of the pole's top, from its axis (r)."""
    return point(side * aside * of.radius, -ahead * of.radius, of.height - depth)


def on_ledge(
    of: "PoleLedge", side: float, unit: Number, depth: Number, aside: Number, ahead: Number
) -> Float[Array, " 3"]:
    """A point of the ledge: `aside` of the middle (r), `ahead` of its edge."""
    return point(side * aside * of.radius, -of.radius - ahead * unit, of.ledge_height - depth)


@parameters
class PoleLedge(Fixed):
    """Pole along the world's z axis; the ledge fills y < -radius, z < ledge_height."""

    # `axis` and `brink`, for bases, begin at the height of the pole's top: on its axis, and over the ledge's edge;
    # `floor`, and `foot` for bases, at the foot of its axis
    charts: ClassVar = {
        **approached(lambda of: 0.0),
        "side": Chart(("ahead", "above"), on_side),
        "top": Chart(("aside", "ahead"), on_top),
        "ledge": Chart(("aside", "ahead"), on_ledge),
        "axis": ahead_above(lambda of: (0.0, of.height)),
        "brink": ahead_above(lambda of: (-of.radius, of.height)),
    }
    heights = ("height", "ledge_height")
    kind: str = choice("pole_ledge", "pole_ledge")
    radius: float = quantity(0.42, "m", above=0)  # r, of the pole
    height: float = quantity(2.286660689865613, "m", above=0)  # h, of the pole above the floor
    ledge_height: float = quantity(2.076660689865613, "m", above=0)  # h1, of the ledge above the floor

    def solids(self, bodies: Bodies) -> tuple[Solid, ...]:
        """The ledge ends where no robot comes."""
        half, ledge = self.height / 2, self.ledge_height / 2
        return (
            HalfSpace(name="floor", normal=(0.0, 0.0, 1.0)),
            Cylinder(name="pole", position=(0.0, 0.0, half), radius=self.radius, half=half),
            Box(name="ledge", position=(0.0, -self.radius - 1.5, ledge), half=(2.0, 1.5, ledge), colour=SOIL),
        )

    def surface(self, points: Float[Array, "n 3"], owner: tuple[int, ...], bodies: Bodies) -> Surface:
        """A solid's depth is the least over its faces; of three solids the deepest counts."""
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

"""Ground that is flat, or tilted along x."""

from typing import ClassVar

import jax.numpy as jnp
from jaxtyping import Array, Float

from sweep.core.parameters import choice, parameters, quantity
from sweep.models.obstacles.base import StaticObstacle
from sweep.models.obstacles.charts import ALONG_X, Chart, Number, stack_components
from sweep.models.obstacles.surface import BodyPoses, Surface
from sweep.models.solids import HalfSpace, Solid, array_module


def ground_point(
    obstacle: "Plane", side: float, unit: Number, depth: Number, aside: Number, ahead: Number
) -> Float[Array, " 3"]:
    """Return a foothold on the ground (m) from its coordinates `aside` and `ahead` of the world's origin."""
    return obstacle.rotation() @ stack_components(ahead * unit, side * aside * unit, -depth)


def base_position_over_ground(
    obstacle: "Plane", side: float, unit: Number, depth: Number, ahead: Number, above: Number, pitch: Number = 0.0
) -> Float[Array, " 3"]:
    """Return a base position (m), `ahead` of the origin and `above` the ground, for a base pitched by `pitch` (deg)."""
    return obstacle.rotation() @ stack_components(ahead * unit, 0.0, above * unit)


def base_pitch(obstacle: "Plane", unit: Number, ahead: Number, above: Number, pitch: Number = 0.0) -> Array:
    """Return the pitch (rad, nose up) of a base over ground that may slope, from its pitch against the ground (deg)."""
    return obstacle.slope + jnp.radians(jnp.asarray(pitch, float))


@parameters
class Plane(StaticObstacle):
    """Flat ground through the world's origin, rising towards +x by `slope`."""

    # of feet, then of bases
    charts: ClassVar = {
        "ground": Chart(("aside", "ahead"), ground_point),
        "over_ground": Chart(
            ("ahead", "above", "pitch"), base_position_over_ground, pitch=base_pitch, optional_count=1
        ),
    }
    forward = ALONG_X
    kind: str = choice("plane", "plane")
    slope: float = quantity(0.0, "rad", at_least=-1.2, at_most=1.2)  # angle by which the ground rises towards +x

    def rotation(self) -> Float[Array, "3 3"]:
        """Rotation matrix from ground axes (x uphill, z along the normal) to world axes."""
        cos, sin = jnp.cos(self.slope), jnp.sin(self.slope)
        zero, one = jnp.zeros_like(cos), jnp.ones_like(cos)
        rows = [jnp.stack([cos, zero, -sin]), jnp.stack([zero, one, zero]), jnp.stack([sin, zero, cos])]
        return jnp.stack(rows)

    def solids(self, bodies: BodyPoses) -> tuple[Solid, ...]:
        """Return the solid that the robot stands on: the half-space below the ground."""
        sin, cos = (getattr(array_module(self.slope), name)(self.slope) for name in ("sin", "cos"))
        return (HalfSpace(name="ground", normal=(-sin, 0.0, cos)),)

    def surface(self, points: Float[Array, "n 3"], owner: tuple[int, ...], bodies: BodyPoses) -> Surface:
        """Return the contact surface at points: their depth in the plane, and its normal, the same for all points."""
        normal = self.rotation()[:, 2].astype(points.dtype)
        n = points.shape[0]
        none = jnp.zeros(n, jnp.int32)
        return Surface(-points @ normal, jnp.broadcast_to(normal, (n, 3)), none, none - 1, jnp.ones(n, points.dtype))

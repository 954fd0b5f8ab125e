"""Flat or tilted ground."""

import jax.numpy as jnp
import mujoco
import numpy as np
from jaxtyping import Array, Float

from sweep.core.parameters import choice, parameters, quantity
from sweep.models.obstacles.geoms import add_plane
from sweep.models.obstacles.surface import Bodies, Surface


@parameters
class Plane:
    """Ground through the world's origin, rising towards +x by `slope`."""

    kind: str = choice("plane", "plane")
    slope: float = quantity(0.0, "rad", at_least=-1.2, at_most=1.2)

    free_bodies = ()
    contact_sites = ()

    def rotation(self) -> Float[Array, "3 3"]:
        """Ground axes (x uphill, z along the normal) to world axes."""
        cos, sin = jnp.cos(self.slope), jnp.sin(self.slope)
        zero, one = jnp.zeros_like(cos), jnp.ones_like(cos)
        rows = [jnp.stack([cos, zero, -sin]), jnp.stack([zero, one, zero]), jnp.stack([sin, zero, cos])]
        return jnp.stack(rows)

    def add_to(self, spec: mujoco.MjSpec, friction: float) -> None:
        """One plane."""
        add_plane(spec.worldbody, "ground", [-np.sin(self.slope), 0.0, np.cos(self.slope)], friction)

    def leaves(self) -> dict[str, dict[str, Array]]:
        """Nothing moves."""
        return {}

    def surface(self, points: Float[Array, "n 3"], owner: tuple[int, ...], bodies: Bodies) -> Surface:
        """Depth below the plane."""
        normal = self.rotation()[:, 2].astype(points.dtype)
        n = points.shape[0]
        none = jnp.zeros(n, jnp.int32)
        return Surface(-points @ normal, jnp.broadcast_to(normal, (n, 3)), none, none - 1, jnp.ones(n, points.dtype))

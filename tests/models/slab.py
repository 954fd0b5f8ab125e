"""A test obstacle: a slab that lies on a frictionless floor and is free to move under the robot."""

import jax.numpy as jnp
import mujoco
import numpy as np
from jaxtyping import Array, Float

from sweep.core.parameters import choice, parameters, quantity
from sweep.models.obstacles.surface import BodyPoses, FreeBodyState, Surface
from sweep.models.solids import Box, Solid

CORNERS = np.array([[1, 1, -1], [1, -1, -1], [-1, 1, -1], [-1, -1, -1]])


@parameters
class Slab:
    """A box whose four lower corners rest on the floor z = 0; feet feel its upper face, however far they go."""

    kind: str = choice("slab", "slab")
    mass: float = quantity(20.0, "kg", above=0)
    half_length: float = quantity(1.2, "m", above=0)
    half_width: float = quantity(1.0, "m", above=0)
    half_height: float = quantity(0.05, "m", above=0)
    grip: float = quantity(1.0, "-", at_least=0)  # of the upper face

    free_bodies = ("slab",)
    contact_sites = tuple((f"corner{k}", 0) for k in range(4))

    def _half(self) -> Array:
        return jnp.stack([jnp.asarray(x) for x in (self.half_length, self.half_width, self.half_height)])

    def add_to(self, spec: mujoco.MjSpec, friction: float) -> None:
        """The free body and its corners."""
        values = self.batched_model_fields()
        body = spec.worldbody.add_body(name="slab", pos=[0, 0, self.half_height], ipos=[0, 0, 0], explicitinertial=True,
                                       mass=self.mass, inertia=np.asarray(values["body_inertia"]["slab"]))  # fmt: skip
        body.add_freejoint(name="slab")
        for name, _ in self.contact_sites:
            body.add_site(name=name, pos=np.asarray(values["site_pos"][name]))

    def batched_model_fields(self) -> dict[str, dict[str, Array]]:
        """Mass, inertia and corners."""
        half = self._half()
        sites = {name: half * corner for (name, _), corner in zip(self.contact_sites, CORNERS, strict=True)}
        return {
            "body_mass": {"slab": jnp.asarray(self.mass)},
            "body_inertia": {"slab": self.mass / 3 * (jnp.sum(half**2) - half**2)},
            "site_pos": sites,
        }

    def solids(self, bodies: BodyPoses) -> tuple[Solid, ...]:
        """The slab."""
        half = (self.half_length, self.half_width, self.half_height)
        return (Box(name="slab", position=bodies.position[0], rotation=bodies.rotation[0], half=half, body=0),)

    def external_wrench(self, free: FreeBodyState) -> None:
        """Nothing beside weight and contact."""

    def surface(self, points: Float[Array, "n 3"], owner: tuple[int, ...], bodies: BodyPoses) -> Surface:
        """The robot's feet stand on the slab, the slab's corners on the floor without friction."""
        own = np.array(owner) >= 0
        up, top = bodies.rotation[0, :, 2], bodies.position[0] + self.half_height * bodies.rotation[0, :, 2]
        depth = jnp.where(own, -points[:, 2], (top - points) @ up)
        normal = jnp.where(own[:, None], jnp.array([0.0, 0.0, 1.0], points.dtype), up)
        grip = jnp.where(own, 0.0, jnp.asarray(self.grip, points.dtype))
        return Surface(depth, normal, jnp.asarray(own, jnp.int32), jnp.asarray(np.where(own, -1, 0), jnp.int32), grip)

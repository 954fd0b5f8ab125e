"""Test obstacles whose bodies touch in several places: two balls before a wall, and a rod that leans on it."""

import jax.numpy as jnp
import mujoco
import numpy as np
from jaxtyping import Array, Float

from sweep.core.parameters import choice, parameters, quantity
from sweep.models.obstacles.surface import BodyPoses, FreeBodyState, RollingResistance, Surface

FLOOR, WALL, BALL = range(3)
UP, OUT = np.array([0.0, 0.0, 1.0]), np.array([-1.0, 0.0, 0.0])


@parameters
class TwoBalls:
    """They lie on a floor without friction; the first may touch the second, which may touch the wall x = `wall`."""

    kind: str = choice("two_balls", "two_balls")
    radius: float = quantity(0.5, "m", above=0)
    mass: float = quantity(400.0, "kg", above=0)  # of the second; the first has half of it
    wall: float = quantity(4.0, "m")
    damping: float = quantity(0.0, "N*s/m", at_least=0)  # of balls and wall, beside the contact's own
    spring: float = quantity(0.0, "N/m", at_least=0)  # that draws the second ball to x = 0

    free_bodies = ("first", "second")
    contact_sites = (("first", 0), ("second", 1), ("touch", 0), ("bump", 1))

    def add_to(self, spec: mujoco.MjSpec, friction: float) -> None:
        """The bodies, which C MuJoCo only weighs here."""
        values = self.batched_model_fields()
        for name in self.free_bodies:
            mass, inertia = (np.asarray(values[field][name], float) for field in ("body_mass", "body_inertia"))
            body = spec.worldbody.add_body(name=name, explicitinertial=True, mass=float(mass), inertia=inertia)
            body.ipos = [0, 0, 0]
            body.add_freejoint(name=name)
        for name, body in self.contact_sites:
            spec.body(self.free_bodies[body]).add_site(name=name)

    def batched_model_fields(self) -> dict[str, dict[str, Array]]:
        """Mass and inertia."""
        masses = dict(zip(self.free_bodies, (0.5 * self.mass, 1.0 * self.mass), strict=True))
        return {
            "body_mass": {name: jnp.asarray(mass) for name, mass in masses.items()},
            "body_inertia": {name: jnp.full(3, 0.4) * mass * self.radius**2 for name, mass in masses.items()},
        }

    def external_wrench(self, free: FreeBodyState) -> Float[Array, "2 6"]:
        """The spring."""
        return jnp.zeros((2, 6)).at[1, 0].set(-self.spring * free.position[1, 0])

    def surface(self, points: Float[Array, "n 3"], owner: tuple[int, ...], bodies: BodyPoses) -> Surface:
        """Feet feel the floor only."""
        n = len(owner)
        touch, bump = (np.arange(n) == n - k for k in (2, 1)) if n > 6 else (np.zeros(n, bool),) * 2
        off = points - bodies.position[1]
        away = jnp.linalg.norm(off, axis=-1)
        radius = np.where(np.array(owner) >= 0, 1.0, 0.0) * self.radius
        depth = jnp.where(
            touch, 2 * self.radius - away, jnp.where(bump, points[:, 0] - self.wall, -points[:, 2]) + radius
        )
        normal = jnp.where(touch[:, None], off / away[:, None], jnp.where(bump[:, None], OUT, UP))
        none = jnp.zeros(n)
        face = np.where(touch, BALL, np.where(bump, WALL, FLOOR)).astype(np.int32)
        rolling = RollingResistance(radius + none, none, none)
        return Surface(depth, normal, jnp.asarray(face), jnp.asarray(np.where(touch, 1, -1), jnp.int32), none,
                       rolling, jnp.where(touch | bump, self.damping, 0.0))  # fmt: skip


@parameters
class Rod:
    """A thin rod in the plane y = 0 between the floor and the wall x = 0; both have the contact's friction."""

    kind: str = choice("rod", "rod")
    mass: float = quantity(20.0, "kg", above=0)
    length: float = quantity(2.0, "m", above=0)

    free_bodies = ("rod",)
    contact_sites = (("lower", 0), ("upper", 0))

    def add_to(self, spec: mujoco.MjSpec, friction: float) -> None:
        """The body and its ends."""
        values = self.batched_model_fields()
        body = spec.worldbody.add_body(name="rod", explicitinertial=True, mass=self.mass, ipos=[0, 0, 0],
                                       inertia=np.asarray(values["body_inertia"]["rod"]))  # fmt: skip
        body.add_freejoint(name="rod")
        for name, _ in self.contact_sites:
            body.add_site(name=name, pos=np.asarray(values["site_pos"][name]))

    def batched_model_fields(self) -> dict[str, dict[str, Array]]:
        """Along its own x axis."""
        across, half = self.mass * self.length**2 / 12, 0.5 * self.length * jnp.array([1.0, 0.0, 0.0])
        return {
            "body_mass": {"rod": jnp.asarray(self.mass)},
            "body_inertia": {"rod": across * jnp.array([1e-2, 1.0, 1.0])},
            "site_pos": {"lower": -half, "upper": half},
        }

    def external_wrench(self, free: FreeBodyState) -> None:
        """Nothing beside weight and contact."""

    def surface(self, points: Float[Array, "n 3"], owner: tuple[int, ...], bodies: BodyPoses) -> Surface:
        """The floor z = 0, and the wall x = 0 for the upper end."""
        upper = np.arange(len(owner)) == len(owner) - 1
        depth = jnp.where(upper, points[:, 0], -points[:, 2])
        normal = jnp.where(upper[:, None], OUT, UP) + 0.0 * points
        none = jnp.zeros(len(owner), jnp.int32)
        return Surface(depth, normal, none + upper, none - 1, jnp.ones(len(owner)))

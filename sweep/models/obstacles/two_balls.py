"""Two equal free balls on the floor, one before the other (monograph 3.5).

World axes: x from the first ball, on which the robot stands, to the second; z = 0 is the floor.
"""

from typing import TYPE_CHECKING, ClassVar

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from sweep.core.parameters import choice, parameters, quantity
from sweep.models.frames import body_frame_number, koenig_frame_number
from sweep.models.obstacles.ball import BALL, Ball, cap_point
from sweep.models.obstacles.charts import Chart, Number, stack_components
from sweep.models.obstacles.geoms import add_contact_pair
from sweep.models.obstacles.surface import BodyPoses, FreeBodyState, RollingResistance, Surface, critical_damping
from sweep.models.solids import Solid, Sphere

if TYPE_CHECKING:
    import mujoco

SECOND_BALL = BALL + 1


def base_position_above_ball(
    obstacle: "TwoBalls", side: float, unit: Number, depth: Number, ahead: Number, above: Number
) -> Float[Array, " 3"]:
    """Return a base position (m) `ahead` of a ball's centre (in radii) and `above` its top (in plan units)."""
    return stack_components(ahead * obstacle.radius, 0.0, obstacle.radius + above * unit)


@parameters
class TwoBalls(Ball):
    """Two balls of 400 kg and radius 0.84 m, one ahead of the other; the first starts at the origin."""

    charts: ClassVar = {
        **Ball.charts,
        "second": Chart(("aside", "ahead"), cap_point, koenig_frame_number(1), body_frame_number(1)),
        "above": Chart(("ahead", "above"), base_position_above_ball, koenig_frame_number(0)),
        "above_second": Chart(("ahead", "above"), base_position_above_ball, koenig_frame_number(1)),
    }
    kind: str = choice("two_balls", "two_balls")
    mass: float = quantity(400.0, "kg", above=0)  # M, of each
    gap: float = quantity(0.5, "m", at_least=0)  # between the balls, at the start
    offset: float = quantity(0.0, "m")  # of the second ball to the left, at the start
    second_speed: float = quantity(0.0, "m/s")  # of the second ball along x, rolling, at the start
    ball_grip: float = quantity(1.0, "-", at_least=0)  # multiplies the friction coefficient of ball and ball
    impact_damping: float = quantity(1.0, "-", at_least=0)  # of ball and ball, over the critical

    free_bodies = ("ball", "second_ball")
    contact_sites = (("ball", 0), ("second_ball", 1), ("between", 1))

    def add_to(self, spec: "mujoco.MjSpec", friction: float) -> None:
        """Add the floor and both balls to a MuJoCo spec."""
        super().add_to(spec, friction)
        add_contact_pair(spec, "ball", "second_ball", friction * self.ball_grip, self.impact_damping)

    def batched_model_fields(self) -> dict[str, dict[str, Array]]:
        """Return the MuJoCo model fields that hold mass and inertia of both balls, by field and body."""
        return {
            field: dict.fromkeys(self.free_bodies, of["ball"]) for field, of in super().batched_model_fields().items()
        }

    def start(self) -> FreeBodyState:
        """Return the start state of both balls, at rest or rolling without slip."""
        first = super().start()
        ahead = 2 * self.radius + self.gap
        place = stack_components(ahead, self.offset, self.radius)[None]
        velocity = self.second_speed * jnp.array([[1.0, 0.0, 0.0]])
        turn = self.second_speed / self.radius * jnp.array([[0.0, 1.0, 0.0]])
        second = FreeBodyState(place, first.quat, velocity, turn)
        return FreeBodyState(*[jnp.concatenate(both) for both in zip(first, second, strict=True)])

    def solids(self, bodies: BodyPoses) -> tuple[Solid, ...]:
        """Return the floor and both balls as solids."""
        second = Sphere(name="second_ball", radius=self.radius, centre=bodies.position[1], body=1)
        return *super().solids(bodies), second

    def surface(self, points: Float[Array, "n 3"], owner: tuple[int, ...], bodies: BodyPoses) -> Surface:
        """Return the contact surface at points: of floor or a ball, whichever they are deepest in."""
        one = super().surface(points, owner, bodies)
        assert one.rolling is not None
        dtype, own = points.dtype, np.array(owner) >= 0
        between = np.cumsum(np.array(owner) == 1) == 2
        radius = jnp.asarray(self.radius, dtype)
        offset = points - jnp.where(between[:, None], bodies.position[0], bodies.position[1])
        distance = jnp.sqrt(jnp.sum(offset**2, axis=-1) + 1e-12)
        inside = jnp.where(between, 2 * radius, radius) - distance
        other = between | (~own & (inside > one.depth))
        rolls = jnp.where(between, 0.0, 1.0).astype(dtype)
        return Surface(
            depth=jnp.where(other, inside, one.depth),
            normal=jnp.where(other[:, None], offset / distance[:, None], one.normal),
            face=jnp.where(other, jnp.where(between, BALL, SECOND_BALL), one.face).astype(jnp.int32),
            body=jnp.where(other, jnp.where(between, 0, 1), one.body).astype(jnp.int32),
            friction_scale=jnp.where(between, jnp.asarray(self.ball_grip, dtype), one.friction_scale),
            rolling=RollingResistance(one.rolling.radius, rolls * one.rolling.roll, rolls * one.rolling.spin),
            damping=jnp.asarray(between, dtype) * self.impact_damping * critical_damping(self.mass / 2),
        )

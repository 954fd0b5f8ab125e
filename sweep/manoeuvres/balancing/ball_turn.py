"""Steering a free ball along a curve, the robot standing on it (monograph 3.1.6)."""

from typing import ClassVar

import jax.numpy as jnp
from jaxtyping import Array, Float

from sweep.core.parameters import choice, parameters, quantity
from sweep.manoeuvres.balancing.ball import BallDrive, BallPathPoint


@parameters
class BallTurn(BallDrive):
    """Drive a ball straight on, then along a circle to the left, or to the right if its radius is negative.

    By the law of `BallDrive` along that path. On the circle, the mass centre leans inward as (3.1.33) requires at the
    ball's speed. The robot faces x throughout.
    """

    goal: ClassVar = {"obstacle_speed_error_max_mps": 0.01, "obstacle_aside_max_m": 0.05}
    kind: str = choice("ball_turn", "ball_turn")
    straight: float = quantity(1.5, "m", at_least=0)  # length of the path before the turn
    radius: float = quantity(4.0, "m")  # rho, of the path of the ball's centre

    def path_point_at(self, place: Float[Array, " 3"]) -> BallPathPoint:
        """Return point and direction of the planned path at a ball position `place` (m): along x, then along a
        circle."""
        before = super().path_point_at(place)
        x, y = (place[0] - self.straight) / self.radius, 1 - place[1] / self.radius
        angle, out = jnp.arctan2(x, y), jnp.hypot(x, y)
        along = jnp.stack([jnp.cos(angle), jnp.sin(angle)])
        off, curve = self.radius * (1 - out), jnp.ones_like(out) / self.radius
        circle = BallPathPoint(along, self.straight + self.radius * angle, off, curve)
        return BallPathPoint(*(jnp.where(place[0] > self.straight, a, b) for a, b in zip(circle, before, strict=True)))

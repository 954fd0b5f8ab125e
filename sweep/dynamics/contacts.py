"""Contact points as parts of root bodies: how fast they pass over their surfaces, and what their forces do to both."""

from collections.abc import Sequence
from functools import reduce
from operator import add
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from sweep.core.vectors import Matrix, Vector
from sweep.dynamics.spatial import Spatial
from sweep.models.contact import Geometry
from sweep.models.obstacles.surface import Rolling


class Arm(NamedTuple):
    """What a root body does to n contact points: it carries some, and others stand on it."""

    body: int
    share: Float[Array, " n"] | None  # 1 carries, -1 is stood on, 0 neither; None: it carries all
    at: Vector  # m, of the points from the body's origin

    def shared(self, v: Vector) -> Vector:
        """The body's share of what belongs to the points."""
        return v if self.share is None else self.share * v

    def rows(self, m: Matrix) -> tuple[Matrix, Matrix]:
        """Of a matrix that gives forces on the points: those that give force and torque on the body."""
        m = m if self.share is None else m.scaled(self.share)
        return m, m.transposed.crossed(-self.at).transposed

    def columns(self, m: Matrix) -> tuple[Matrix, Matrix]:
        """Of a matrix that takes velocities of the points: those that take the body's velocity and rate of turning."""
        m = m if self.share is None else m.scaled(self.share)
        return m, m.crossed(-self.at)


class Contacts(NamedTuple):
    """Points with the law of contact in common: the feet, or the sites of free bodies."""

    geometry: Geometry
    arms: tuple[Arm, ...]
    rolling: Rolling | None = None

    def velocity(self, root: Sequence[Spatial]) -> Vector:
        """Of the points relative to their surfaces, as the root bodies move (m/s)."""
        return reduce(
            add, [arm.shared(root[arm.body].linear + root[arm.body].angular.cross(arm.at)) for arm in self.arms]
        )

    def turning(self, root: Sequence[Spatial]) -> Vector:
        """Rates at which the bodies that carry the points turn relative to those under them (rad/s)."""
        return reduce(add, [arm.shared(root[arm.body].angular) for arm in self.arms])

    def onto(self, force: Vector, moment: Vector | None = None) -> list[tuple[int, Spatial]]:
        """Force and torque on root bodies, of forces and moments at the points."""
        out = []
        for arm in self.arms:
            own = arm.shared(force)
            torque = arm.at.cross(own) if moment is None else arm.at.cross(own) + arm.shared(moment)
            out.append((arm.body, Spatial(own.total(), torque.total())))
        return out


def arms(at: Vector, body: Array, owner: Sequence[int], origins: Sequence[Vector]) -> tuple[Arm, ...]:
    """Arms of free bodies to points `at` that `owner` carries and that stand on `body`; their origins, base axes."""
    shares = [jnp.equal(np.array(owner), k) - (body == k).astype(at.x.dtype) for k in range(len(origins))]
    return tuple(Arm(k + 1, share, at - origin) for k, (share, origin) in enumerate(zip(shares, origins, strict=True)))

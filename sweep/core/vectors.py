"""Vectors as three arrays, one a component: sums over legs and rollouts then never mix with sums over components.

Arrays of a component broadcast against each other: (1,) for a body, (6,) for the legs, and so on. That is the layout
in which a compiler turns a formula into a loop over many rollouts.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

Number = Array | float


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Vector:
    """Three components as arrays over legs or other points; the frame is the caller's."""

    x: Array
    y: Array
    z: Array
    __array_ufunc__ = None  # numpy arrays leave products to this class

    @classmethod
    def from_array(cls, array: Float[Array, "*n 3"]) -> "Vector":
        """Make a vector from an array with the components last."""
        return cls(array[..., 0], array[..., 1], array[..., 2])

    def array(self) -> Float[Array, "*n 3"]:
        """The components stacked last."""
        return jnp.stack([self.x, self.y, self.z], axis=-1)

    def __iter__(self) -> Iterator[Array]:
        return iter((self.x, self.y, self.z))

    def __add__(self, other: "Vector") -> "Vector":
        return Vector(self.x + other.x, self.y + other.y, self.z + other.z)

    def __sub__(self, other: "Vector") -> "Vector":
        return Vector(self.x - other.x, self.y - other.y, self.z - other.z)

    def __mul__(self, factor: Number) -> "Vector":
        return Vector(self.x * factor, self.y * factor, self.z * factor)

    __rmul__ = __mul__

    def __neg__(self) -> "Vector":
        return Vector(-self.x, -self.y, -self.z)

    def dot(self, other: "Vector") -> Array:
        """Return the scalar product."""
        return self.x * other.x + self.y * other.y + self.z * other.z

    def cross(self, other: "Vector") -> "Vector":
        """Return the vector product."""
        return Vector(
            self.y * other.z - self.z * other.y,
            self.z * other.x - self.x * other.z,
            self.x * other.y - self.y * other.x,
        )

    def total(self) -> "Vector":
        """Sum over the legs (the last axis), which stays as an axis of length 1."""
        return Vector(*(total(part) for part in self))


class Matrix(NamedTuple):
    """3x3 matrices by their rows."""

    x: Vector
    y: Vector
    z: Vector

    @classmethod
    def from_array(cls, array: Float[Array, "*n 3 3"]) -> "Matrix":
        """Make a matrix from an array with rows and columns last."""
        return cls(*(Vector.from_array(array[..., k, :]) for k in range(3)))

    def array(self) -> Float[Array, "*n 3 3"]:
        """One array whose last two axes are rows and columns."""
        return jnp.stack([row.array() for row in self], axis=-2)

    def __matmul__(self, v: Vector) -> Vector:  # pyright: ignore[reportIncompatibleMethodOverride]
        return Vector(self.x.dot(v), self.y.dot(v), self.z.dot(v))

    @property
    def transpose(self) -> "Matrix":
        """The transposed matrix."""
        return Matrix(*(Vector(*parts) for parts in zip(*self, strict=True)))

    def plus(self, other: "Matrix") -> "Matrix":
        """Return the sum."""
        return Matrix(*(a + b for a, b in zip(self, other, strict=True)))

    def minus(self, other: "Matrix") -> "Matrix":
        """Return the difference."""
        return Matrix(*(a - b for a, b in zip(self, other, strict=True)))

    def scale(self, factor: Number) -> "Matrix":
        """Multiply every entry by `factor`."""
        return Matrix(*(row * factor for row in self))

    @property
    def negative(self) -> "Matrix":
        """The matrix times -1."""
        return Matrix(*(-row for row in self))

    def times(self, other: "Matrix") -> "Matrix":
        """Return the matrix product with `other` on the right."""
        columns = other.transpose
        return Matrix(*(columns @ row for row in self))

    def times_cross_matrix(self, v: Vector) -> "Matrix":
        """Return the matrix product with `cross_matrix(v)` on the right."""
        return Matrix(*(row.cross(v) for row in self))

    def total(self) -> "Matrix":
        """Sum over the legs (the last axis), which stays as an axis of length 1."""
        return Matrix(*(row.total() for row in self))

    def inverse(self) -> "Matrix":
        """Return the inverse, by cofactors."""
        rows = self.y.cross(self.z), self.z.cross(self.x), self.x.cross(self.y)
        scale = 1 / self.x.dot(rows[0])
        return Matrix(*(row * scale for row in rows)).transpose


def total(x: Array) -> Array:
    """Sum over the last axis, which stays as an axis of length 1."""
    return jnp.sum(x, axis=-1, keepdims=True)


def select(condition: Array, a: Vector, b: Vector) -> Vector:
    """Choose `a` where `condition` holds, else `b`, component by component."""
    return Vector(*(jnp.where(condition, x, y) for x, y in zip(a, b, strict=True)))


def axis_vector(axis: int, value: Array) -> Vector:
    """Return a vector of length `value` along coordinate axis `axis` (0, 1 or 2)."""
    zero = jnp.zeros_like(value)
    return Vector(*(value if i == axis else zero for i in range(3)))


def diagonal(x: Array, y: Array, z: Array) -> Matrix:
    """Return the diagonal matrix with these entries."""
    return Matrix(*(axis_vector(k, value) for k, value in enumerate((x, y, z))))


def symmetric(xx: Array, yy: Array, zz: Array, xy: Array, xz: Array, yz: Array) -> Matrix:
    """Return the symmetric matrix with these entries."""
    return Matrix(Vector(xx, xy, xz), Vector(xy, yy, yz), Vector(xz, yz, zz))


def cross_matrix(v: Vector) -> Matrix:
    """Return the matrix whose product with a vector is `v` cross that vector."""
    zero = jnp.zeros_like(v.x)
    return Matrix(Vector(zero, -v.z, v.y), Vector(v.z, zero, -v.x), Vector(-v.y, v.x, zero))


def rotation(w: Array, x: Array, y: Array, z: Array) -> Matrix:
    """Return the rotation matrix, body to world, of the unit quaternion (w, x, y, z)."""
    return Matrix(
        Vector(1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
        Vector(2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
        Vector(2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
    )

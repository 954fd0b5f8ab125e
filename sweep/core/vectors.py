"""Vectors whose three components are separate arrays, so that sums over legs or rollouts never mix components.

The arrays of components broadcast against each other: (1,) for a body, (6,) for the legs, and so on. A compiler turns
formulas of this layout into one loop over many rollouts.
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
    """A 3-vector whose components are separate arrays, an element for each leg or point; the caller knows the frame."""

    x: Array
    y: Array
    z: Array
    __array_ufunc__ = None  # numpy arrays leave products to this class

    @classmethod
    def from_array(cls, array: Float[Array, "*n 3"]) -> "Vector":
        """Make a vector from an array (..., 3) whose last axis holds the components."""
        return cls(array[..., 0], array[..., 1], array[..., 2])

    def array(self) -> Float[Array, "*n 3"]:
        """Return an array (..., 3) whose last axis holds the components."""
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
        """Return the scalar product with another vector."""
        return self.x * other.x + self.y * other.y + self.z * other.z

    def cross(self, other: "Vector") -> "Vector":
        """Return the vector product with another vector, which is on the right."""
        return Vector(
            self.y * other.z - self.z * other.y,
            self.z * other.x - self.x * other.z,
            self.x * other.y - self.y * other.x,
        )

    def sum_last_axis(self) -> "Vector":
        """Sum over the last axis (such as the legs), which stays with length 1."""
        return Vector(*(sum_last_axis(part) for part in self))


class Matrix(NamedTuple):
    """3x3 matrices stored as three row vectors."""

    x: Vector
    y: Vector
    z: Vector

    @classmethod
    def from_array(cls, array: Float[Array, "*n 3 3"]) -> "Matrix":
        """Make a matrix from an array (..., 3, 3), rows before columns."""
        return cls(*(Vector.from_array(array[..., k, :]) for k in range(3)))

    def array(self) -> Float[Array, "*n 3 3"]:
        """Return an array (..., 3, 3), rows before columns."""
        return jnp.stack([row.array() for row in self], axis=-2)

    def __matmul__(self, v: Vector) -> Vector:  # pyright: ignore[reportIncompatibleMethodOverride]
        return Vector(self.x.dot(v), self.y.dot(v), self.z.dot(v))

    @property
    def transpose(self) -> "Matrix":
        """Return the transposed matrix."""
        return Matrix(*(Vector(*parts) for parts in zip(*self, strict=True)))

    def plus(self, other: "Matrix") -> "Matrix":
        """Return the sum with another matrix."""
        return Matrix(*(a + b for a, b in zip(self, other, strict=True)))

    def minus(self, other: "Matrix") -> "Matrix":
        """Return this matrix less another one."""
        return Matrix(*(a - b for a, b in zip(self, other, strict=True)))

    def scale(self, factor: Number) -> "Matrix":
        """Multiply every entry by `factor`."""
        return Matrix(*(row * factor for row in self))

    @property
    def negative(self) -> "Matrix":
        """Return the matrix times -1."""
        return Matrix(*(-row for row in self))

    def times(self, other: "Matrix") -> "Matrix":
        """Return the matrix product with `other` on the right."""
        columns = other.transpose
        return Matrix(*(columns @ row for row in self))

    def times_cross_matrix(self, v: Vector) -> "Matrix":
        """Return the matrix product with `cross_matrix(v)` on the right."""
        return Matrix(*(row.cross(v) for row in self))

    def sum_last_axis(self) -> "Matrix":
        """Sum over the last axis (such as the legs), which stays with length 1."""
        return Matrix(*(row.sum_last_axis() for row in self))

    def inverse(self) -> "Matrix":
        """Return the inverse matrix, computed from cofactors."""
        rows = self.y.cross(self.z), self.z.cross(self.x), self.x.cross(self.y)
        scale = 1 / self.x.dot(rows[0])
        return Matrix(*(row * scale for row in rows)).transpose


def sum_last_axis(x: Array) -> Array:
    """Sum an array over its last axis, which stays with length 1."""
    return jnp.sum(x, axis=-1, keepdims=True)


def select_vector(condition: Array, a: Vector, b: Vector) -> Vector:
    """Choose between two vectors element by element.

    Args:
        condition: Booleans that broadcast against the components.
        a: Values where the condition holds.
        b: Values elsewhere.

    Returns:
        The chosen values.
    """
    return Vector(*(jnp.where(condition, x, y) for x, y in zip(a, b, strict=True)))


def vector_along_axis(axis: int, value: Array) -> Vector:
    """Make a vector along a coordinate axis.

    Args:
        axis: 0, 1 or 2 for x, y or z.
        value: Component along the axis, of any shape; the other components are 0.

    Returns:
        The vector.
    """
    zero = jnp.zeros_like(value)
    return Vector(*(value if i == axis else zero for i in range(3)))


def diagonal_matrix(x: Array, y: Array, z: Array) -> Matrix:
    """Make a diagonal matrix.

    Args:
        x: First diagonal entry.
        y: Second diagonal entry.
        z: Third diagonal entry.

    Returns:
        The matrix, whose entries have the shapes of the arguments.
    """
    return Matrix(*(vector_along_axis(k, value) for k, value in enumerate((x, y, z))))


def symmetric_matrix(xx: Array, yy: Array, zz: Array, xy: Array, xz: Array, yz: Array) -> Matrix:
    """Make a symmetric matrix, such as an inertia tensor.

    Args:
        xx: Diagonal entry.
        yy: Diagonal entry.
        zz: Diagonal entry.
        xy: Off-diagonal entry.
        xz: Off-diagonal entry.
        yz: Off-diagonal entry.

    Returns:
        The matrix, whose entries have the shapes of the arguments.
    """
    return Matrix(Vector(xx, xy, xz), Vector(xy, yy, yz), Vector(xz, yz, zz))


def cross_matrix(v: Vector) -> Matrix:
    """Return the skew-symmetric matrix M of a vector v, with M w = v x w."""
    zero = jnp.zeros_like(v.x)
    return Matrix(Vector(zero, -v.z, v.y), Vector(v.z, zero, -v.x), Vector(-v.y, v.x, zero))


def rotation_from_quaternion(w: Array, x: Array, y: Array, z: Array) -> Matrix:
    """Return the rotation matrix, body to world, of a unit quaternion.

    Args:
        w: Scalar part.
        x: First component of the vector part.
        y: Second component of the vector part.
        z: Third component of the vector part.

    Returns:
        The matrix, whose entries have the shapes of the arguments.
    """
    return Matrix(
        Vector(1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
        Vector(2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
        Vector(2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
    )

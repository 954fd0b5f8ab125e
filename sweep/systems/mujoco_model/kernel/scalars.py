"""Numbers of one rollout that fold constants, and vectors and symmetric matrices of them.

A number belongs to one body, or to each of n like bodies (a stack). What is known when a program is made is a float or
a NumPy array (n,) in double precision, anything else an array of JAX, () or (n,). Known zeros and ones make no
operation in the program.
"""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple, Union

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from jaxtyping import Array

Value = Any  # a float, an array of NumPy (n,), or one of JAX, () or (n,)
Operand = Union["Scalar", float, int]


class Scalar:
    """A number in the kernel's program: a constant known at compile time, or a value computed in each rollout."""

    __slots__ = ("value",)
    __array_ufunc__ = None

    def __init__(self, value: Value):
        if isinstance(value, (bool, int, np.number)):
            value = float(value)
        if isinstance(value, np.ndarray) and value.dtype.kind == "f" and (value == value.flat[0]).all():
            value = float(value.flat[0])
        self.value = value

    @property
    def is_constant(self) -> bool:
        """Whether the number is a constant known at compile time."""
        return isinstance(self.value, (float, np.ndarray))

    def is_exactly(self, number: float) -> bool:
        """Return whether the number is a compile-time constant equal to `number`."""
        return isinstance(self.value, float) and self.value == number

    @property
    def varies_over_stack(self) -> bool:
        """Whether the number differs between the bodies of a stack (corresponding bodies of all limbs)."""
        return getattr(self.value, "ndim", 0) == 1

    def __add__(self, other: Operand) -> "Scalar":
        other = as_scalar(other)
        if self.is_exactly(0):
            return other
        if other.is_exactly(0):
            return self
        return Scalar(_apply(lambda a, b: a + b, self, other))

    __radd__ = __add__

    def __neg__(self) -> "Scalar":
        return Scalar(-self.value)

    def __sub__(self, other: Operand) -> "Scalar":
        other = as_scalar(other)
        if other.is_exactly(0):
            return self
        if self.is_exactly(0):
            return -other
        return Scalar(_apply(lambda a, b: a - b, self, other))

    def __rsub__(self, other: Operand) -> "Scalar":
        return as_scalar(other) - self

    def __mul__(self, other: Operand) -> "Scalar":
        other = as_scalar(other)
        for one, factor in ((self, other), (other, self)):
            if one.is_exactly(0):
                return ZERO
            if one.is_exactly(1):
                return factor
            if one.is_exactly(-1):
                return -factor
        return Scalar(_apply(lambda a, b: a * b, self, other))

    __rmul__ = __mul__

    def __truediv__(self, other: Operand) -> "Scalar":
        other = as_scalar(other)
        if other.is_constant:
            return self * Scalar(1 / other.value)
        return Scalar(_apply(lambda a, b: a / b, self, other))

    def __rtruediv__(self, other: Operand) -> "Scalar":
        return as_scalar(other) / self

    def __lt__(self, other: Operand) -> Any:
        return _apply(lambda a, b: a < b, self, as_scalar(other))

    def stack_member(self, k: int) -> "Scalar":
        """Return the number's value for body `k` of a stack (corresponding bodies of all limbs)."""
        return Scalar(self.value[k]) if self.varies_over_stack else self

    def sum_over_stack(self, n: int) -> "Scalar":
        """Return the sum of the number over the n bodies of a stack (corresponding bodies of all limbs)."""
        if self.varies_over_stack:
            return Scalar(self.value.sum())
        return self * n


ZERO, ONE = Scalar(0.0), Scalar(1.0)


def as_scalar(value: Operand) -> Scalar:
    """Convert a number or array to a `Scalar` of the kernel's program."""
    return value if isinstance(value, Scalar) else Scalar(value)


def _apply(function: Callable[..., Any], *numbers: Scalar) -> Any:
    """Apply a function to values; where one is computed, known ones take its precision."""
    computed = next((one.value for one in numbers if not one.is_constant), None)
    if computed is None:
        return function(*(one.value for one in numbers))
    return function(*(jnp.asarray(one.value, computed.dtype) if one.is_constant else one.value for one in numbers))


def where(condition: Any, one: Operand, other: Operand) -> Scalar:
    """Return `one` where a condition holds, else `other`; the condition may be known at compile time or computed."""
    one, other = as_scalar(one), as_scalar(other)
    if isinstance(condition, (bool, np.bool_)):
        return one if condition else other
    if isinstance(condition, np.ndarray) and one.is_constant and other.is_constant:
        return Scalar(np.where(condition, one.value, other.value))
    if one.is_constant and other.is_constant:
        dtype = jnp.zeros(()).dtype
        return Scalar(jnp.where(condition, jnp.asarray(one.value, dtype), jnp.asarray(other.value, dtype)))
    return Scalar(_apply(lambda a, b: jnp.where(condition, a, b), one, other))


def smallest(one: Operand, other: Operand) -> Scalar:
    """Return the smaller of two numbers of the kernel's program."""
    one, other = as_scalar(one), as_scalar(other)
    return Scalar(_apply(np.minimum if one.is_constant and other.is_constant else jnp.minimum, one, other))


def largest(one: Operand, other: Operand) -> Scalar:
    """Return the larger of two numbers of the kernel's program."""
    return -smallest(-as_scalar(one), -as_scalar(other))


def clip(number: Operand, low: Operand, high: Operand) -> Scalar:
    """Return a number of the kernel's program, limited to the range from `low` to `high`."""
    return smallest(largest(number, low), high)


def square_root(number: Operand) -> Scalar:
    """Return the square root of a number of the kernel's program."""
    number = as_scalar(number)
    return Scalar(np.sqrt(number.value) if number.is_constant else jnp.sqrt(number.value))


def round_down(number: Scalar) -> Scalar:
    """Return the largest whole number that is not above a computed number of the kernel's program."""
    return Scalar(jnp.floor(number.value))


def round_up(number: Scalar) -> Scalar:
    """Return the smallest whole number that is not below a computed number of the kernel's program."""
    return Scalar(jnp.ceil(number.value))


def look_up_number(values: Any, place: Scalar) -> Scalar:
    """Return the numbers of an array (k,) at computed places, which are whole numbers within it."""
    table = jnp.asarray(values, place.value.dtype)
    return Scalar(table.at[place.value.astype(jnp.int32)].get(mode="promise_in_bounds"))


class Vector(NamedTuple):
    """A 3-vector of numbers in the kernel's program, with constants folded at compile time."""

    x: Scalar
    y: Scalar
    z: Scalar

    def __add__(self, other: "Vector") -> "Vector":  # pyright: ignore[reportIncompatibleMethodOverride]
        return Vector(*(a + b for a, b in zip(self, other, strict=True)))

    def __sub__(self, other: "Vector") -> "Vector":
        return Vector(*(a - b for a, b in zip(self, other, strict=True)))

    def __mul__(self, factor: Operand) -> "Vector":  # pyright: ignore[reportIncompatibleMethodOverride]
        return Vector(*(a * factor for a in self))

    __rmul__ = __mul__  # pyright: ignore[reportAssignmentType]

    def __neg__(self) -> "Vector":
        return Vector(*(-a for a in self))

    def stack_member(self, k: int) -> "Vector":
        """Return the vector of body `k` of a stack (corresponding bodies of all limbs)."""
        return Vector(*(one.stack_member(k) for one in self))

    def dot(self, other: "Vector") -> Scalar:
        """Return the scalar product with another vector."""
        return self.x * other.x + self.y * other.y + self.z * other.z

    def cross(self, other: "Vector") -> "Vector":
        """Return the vector product self x other."""
        return Vector(
            self.y * other.z - self.z * other.y,
            self.z * other.x - self.x * other.z,
            self.x * other.y - self.y * other.x,
        )


NOTHING = Vector(ZERO, ZERO, ZERO)


def choose[T: tuple](condition: Any, one: T, other: T) -> T:
    """Return one of two vectors, or of two named tuples of numbers and vectors, for each rollout.

    Args:
        condition: Whether to take the first.
        one: The first.
        other: The second.
    """
    parts = (
        where(condition, a, b) if isinstance(a, Scalar) else choose(condition, a, b)
        for a, b in zip(one, other, strict=True)
    )
    return type(one)(*parts)  # pyright: ignore[reportArgumentType]


def keep_nearest[T: tuple](kept: list[T], one: T, most: int) -> Scalar | None:
    """Sort a place into a list of the nearest ones, which begin with their distance.

    Args:
        kept: The nearest places so far, in order, at most `most`; changed in place.
        one: A further place.
        most: Number of places to keep.

    Returns:
        The distance of the place that is left out; None if there was room.
    """
    for k, other in enumerate(kept):
        is_nearer = one[0] < other[0]
        kept[k], one = choose(is_nearer, one, other), choose(is_nearer, other, one)
    if len(kept) < most:
        kept.append(one)
        return None
    return one[0]


class SymmetricMatrix(NamedTuple):
    """A symmetric 3x3 matrix of numbers in the kernel's program."""

    xx: Scalar
    yy: Scalar
    zz: Scalar
    xy: Scalar
    xz: Scalar
    yz: Scalar

    def __add__(self, other: "SymmetricMatrix") -> "SymmetricMatrix":  # pyright: ignore[reportIncompatibleMethodOverride]
        return SymmetricMatrix(*(a + b for a, b in zip(self, other, strict=True)))

    def __matmul__(self, v: Vector) -> Vector:
        return Vector(*(row.dot(v) for row in self.rows))

    @property
    def rows(self) -> tuple[Vector, Vector, Vector]:
        """The three rows of the symmetric matrix."""
        return Vector(self.xx, self.xy, self.xz), Vector(self.xy, self.yy, self.yz), Vector(self.xz, self.yz, self.zz)


NO_MATRIX = SymmetricMatrix(*[ZERO] * 6)


def as_symmetric_matrix(rows: Sequence[Vector]) -> SymmetricMatrix:
    """Convert a matrix (3, 3) that is symmetric except for rounding errors to a symmetric one."""
    return SymmetricMatrix(rows[0].x, rows[1].y, rows[2].z, rows[1].x, rows[2].x, rows[2].y)


def scaled_identity(value: Operand) -> SymmetricMatrix:
    """Return `value` times the identity matrix."""
    value = as_scalar(value)
    return SymmetricMatrix(value, value, value, ZERO, ZERO, ZERO)


def outer_product(v: Vector, factor: Operand) -> SymmetricMatrix:
    """Return the matrix factor v vᵀ."""
    w = v * factor
    return SymmetricMatrix(w.x * v.x, w.y * v.y, w.z * v.z, w.x * v.y, w.x * v.z, w.y * v.z)


def rotation_matrix(quat: np.ndarray) -> np.ndarray:
    """Return the rotation matrix (3, 3) of a constant unit quaternion, with rounding errors of zeros removed."""
    matrix = np.zeros(9)
    mujoco.mju_quat2Mat(matrix, quat)
    matrix[np.abs(matrix) < 1e-15] = 0
    return matrix.reshape(3, 3)


def constant_vector(values: np.ndarray) -> Vector:
    """Return a vector (3,) of constants known at compile time."""
    return Vector(*(Scalar(float(x)) for x in values))


Axes = tuple[Vector, Vector, Vector]  # of a body, in world axes: the columns of its rotation matrix


def rotate_to_world(axes: Axes, v: Vector) -> Vector:
    """Rotate a vector from a body's axes to the world's."""
    return axes[0] * v.x + axes[1] * v.y + axes[2] * v.z


def rotate_to_body(axes: Axes, v: Vector) -> Vector:
    """Rotate a vector from the world's axes to a body's."""
    return Vector(*(one.dot(v) for one in axes))


def quaternion_axes(w: Scalar, x: Scalar, y: Scalar, z: Scalar) -> Axes:
    """Return the axes of a body (columns of its rotation matrix, body to world) from a unit quaternion (w, x, y, z)."""
    return (
        Vector(1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y)),
        Vector(2 * (x * y - w * z), 1 - 2 * (x * x + z * z), 2 * (y * z + w * x)),
        Vector(2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)),
    )


def rotate_body_about_axis(axes: Axes, axis: Vector, angle: Scalar) -> tuple[Axes, Vector]:
    """Rotate a body about an axis that is fixed in it.

    Args:
        axes: The body's axes before.
        axis: Unit vector in the body's axes.
        angle: The angle, rad.

    Returns:
        The axes after the rotation, and the axis in world axes.
    """
    cosine, sine = Scalar(jnp.cos(angle.value)), Scalar(jnp.sin(angle.value))
    for k in range(3):
        i, j = (k + 1) % 3, (k + 2) % 3
        if axis[i].is_exactly(0) and axis[j].is_exactly(0):
            sine = sine * axis[k]
            new = {k: axes[k], i: axes[i] * cosine + axes[j] * sine, j: axes[j] * cosine - axes[i] * sine}
            return (new[0], new[1], new[2]), axes[k] * axis[k]
    world, rest = rotate_to_world(axes, axis), 1 - cosine
    turned = tuple(
        one * cosine + world.cross(one) * sine + world * (rest * a) for one, a in zip(axes, axis, strict=True)
    )
    return turned, world  # pyright: ignore[reportReturnType]


def multiply_quaternions(a: tuple[Scalar, ...], b: tuple[Scalar, ...]) -> tuple[Scalar, ...]:
    """Return the product of two quaternions (w, x, y, z), `b` on the right."""
    w, x, y, z = a
    p, q, r, s = b
    return (
        w * p - x * q - y * r - z * s,
        w * q + x * p + y * s - z * r,
        w * r - x * s + y * p + z * q,
        w * s + x * r - y * q + z * p,
    )


def rotation_quaternion(axis: Vector, angle: Scalar) -> tuple[Scalar, ...]:
    """Return the quaternion (w, x, y, z) of a rotation by an angle (rad) about a unit vector."""
    half = angle.value * 0.5
    return Scalar(jnp.cos(half)), *(axis * Scalar(jnp.sin(half)))


def stack_scalars(numbers: list[Scalar], dtype: Any) -> Array:
    """Join the numbers of k single bodies to an array (k,)."""
    return jnp.stack([jnp.asarray(one.value, dtype) for one in numbers])


def join_members(numbers: list[Scalar]) -> Scalar:
    """Join the numbers of n single bodies to a number of a stack; the number of one body stays as it is."""
    if len(numbers) == 1:
        return numbers[0]
    if all(one.is_constant for one in numbers):
        return Scalar(np.array([one.value for one in numbers], float))
    dtype = next(one.value.dtype for one in numbers if not one.is_constant)
    return Scalar(stack_scalars(numbers, dtype))


def join_vectors(vectors: list[Vector]) -> Vector:
    """Join the vectors of n single bodies to a vector of a stack."""
    return Vector(*(join_members([one[k] for one in vectors]) for k in range(3)))


def flatten_scalars(tree: Any) -> tuple[list[Any], Callable[[list[Any]], Any]]:
    """Flatten a tree of the kernel's numbers to a list; return it and a function that restores the tree.

    Returns:
        The values, and a function that makes the tree of other values.
    """
    leaves, structure = jax.tree.flatten(tree, is_leaf=lambda x: isinstance(x, Scalar))
    return [one.value for one in leaves], lambda values: jax.tree.unflatten(structure, [Scalar(x) for x in values])

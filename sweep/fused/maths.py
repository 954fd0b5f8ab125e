"""Elementary functions in single precision from basic arithmetic, for vector units; double precision uses the C
library.

The coefficients are fits of the least relative error on Chebyshev points, good to 2e-8 or better. Results are within
three units in the last place for angles up to some thousand radians.
"""

from collections.abc import Callable, Sequence

import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float, Int

SIN_COEFFICIENTS = (1.0, -0.1666666663, 0.00833332869, -0.0001983917835, 2.717152793e-06)  # sin(x)/x in x^2, up to pi/4
COS_COEFFICIENTS = (1.0, -0.4999999957, 0.04166661323, -0.001388652915, 2.437267913e-05)  # cos(x) in x^2, up to pi/4
ATAN_COEFFICIENTS = (0.9999999976, -0.3333328364, 0.1999826587, -0.1426193135, 0.1094202159, -0.08377289117,
                     0.05755165368, -0.03080415247, 0.01072670635,
                     -0.001753877222)  # of atan(x)/x in x^2, to 1  # fmt: skip
EXP_COEFFICIENTS = (
    1.0,
    1.000000036,
    0.4999999208,
    0.166664201,
    0.04166822621,
    0.008374822042,
    0.0013836829,
)  # to ln(2)/2
LOG_COEFFICIENTS = (1.0, -0.4999998829, 0.3333332602, -0.2500158657, 0.2000196718, -0.1660901136, 0.1418185768,
                    -0.1324349502, 0.1290453789,
                    -0.07620890799)  # of log(1 + x)/x, from 1/sqrt(2) - 1 to sqrt(2) - 1  # fmt: skip
ERF_INV_CENTRE = (1.50140941, 0.246640727, -0.00417768164, -0.00125372503, 0.00021858087, -4.39150654e-06,
                  -3.5233877e-06, 3.43273939e-07, 2.81022636e-08)  # fmt: skip
ERF_INV_TAIL = (2.83297682, 1.00167406, 0.00943887047, -0.0076224613, 0.00573950773, -0.00367342844, 0.00134934322,
                0.000100950558, -0.000200214257)  # fmt: skip
HALF_PI_PARTS = (1.5703125, 4.837512969970703e-4, 7.549790126404332e-8)  # pi/2 as a sum of parts with few digits
LN2_PARTS = (0.693359375, -2.12194440e-4)
PI, HALF_PI = 3.14159265358979, 1.57079632679490


def _sum(coefficients: Sequence[float], x: Array) -> Array:
    total = jnp.full_like(x, coefficients[-1])
    for c in coefficients[-2::-1]:
        total = total * x + c
    return total


def _reduce_angle(x: Float[Array, "..."]) -> tuple[Array, Int[Array, "..."]]:
    """Angle minus its quarter turns, and their number."""
    turns = jnp.round(x * (1 / HALF_PI))
    for part in HALF_PI_PARTS:
        x = x - turns * part
    return x, turns.astype(jnp.int32)


def _wave(x: Array, ahead: int) -> Array:
    rest, turns = _reduce_angle(x)
    turns = turns + ahead
    square = rest * rest
    value = jnp.where(turns & 1 == 0, rest * _sum(SIN_COEFFICIENTS, square), _sum(COS_COEFFICIENTS, square))
    return jnp.where(turns & 2 == 0, value, -value)


def sin(x: Array) -> Array:
    """Sine of an angle (rad)."""
    return _wave(x, 0)


def cos(x: Array) -> Array:
    """Cosine of an angle (rad)."""
    return _wave(x, 1)


def tan(x: Array) -> Array:
    """Tangent of an angle (rad)."""
    return sin(x) / cos(x)


def atan2(y: Array, x: Array) -> Array:
    """Angle (rad) of the point (x, y)."""
    a, b = jnp.abs(x), jnp.abs(y)
    least, most = jnp.minimum(a, b), jnp.maximum(a, b)
    ratio = least / jnp.where(most == 0, 1.0, most)
    angle = ratio * _sum(ATAN_COEFFICIENTS, ratio * ratio)
    angle = jnp.where(b > a, HALF_PI - angle, angle)
    angle = jnp.where(x < 0, PI - angle, angle)
    return jnp.where(y < 0, -angle, angle)


def acos(x: Array) -> Array:
    """Angle (rad) whose cosine is x."""
    return atan2(jnp.sqrt((1.0 - x) * (1.0 + x)), x)


def asin(x: Array) -> Array:
    """Angle (rad) whose sine is x."""
    return atan2(x, jnp.sqrt((1.0 - x) * (1.0 + x)))


def atan(x: Array) -> Array:
    """Angle (rad) whose tangent is x."""
    return atan2(x, jnp.ones_like(x))


def exp(x: Array) -> Array:
    """Exponential function, from arithmetic alone."""
    x = jnp.clip(x, -87.0, 89.0)
    power = jnp.round(x * 1.442695041)
    rest = (x - power * LN2_PARTS[0]) - power * LN2_PARTS[1]
    half = (power * 0.5).astype(jnp.int32)  # in two factors, since 2^128 is infinite
    value = _sum(EXP_COEFFICIENTS, rest)
    for n in (half, power.astype(jnp.int32) - half):
        value = value * lax.bitcast_convert_type((n + 127) << 23, jnp.float32)
    return value


def log(x: Array) -> Array:
    """Natural logarithm of x."""
    bits = lax.bitcast_convert_type(x, jnp.int32)
    power = ((bits - 0x3F3504F3) >> 23).astype(jnp.float32)  # so that the mantissa lies around 1
    rest = lax.bitcast_convert_type(bits - (power.astype(jnp.int32) << 23), jnp.float32) - 1.0
    value = rest * _sum(LOG_COEFFICIENTS, rest) + power * LN2_PARTS[1] + power * LN2_PARTS[0]
    value = jnp.where(x > 0, value, jnp.where(x == 0, -jnp.inf, jnp.nan))
    return jnp.where(x < jnp.inf, value, x)


def erf_inv(x: Array) -> Array:
    """Inverse of the error function, by Giles' two polynomials (2010)."""
    tail = -log((1.0 - x) * (1.0 + x))
    value = jnp.where(tail < 5.0, _sum(ERF_INV_CENTRE, tail - 2.5), _sum(ERF_INV_TAIL, jnp.sqrt(tail) - 3.0))
    return jnp.where(jnp.abs(x) == 1.0, x * jnp.inf, x * value)


def rem(x: Array, y: Array) -> Array:
    """Remainder of x / y with the sign of x, for quotients up to some thousand."""
    rest = x - jnp.trunc(x / y) * y
    size = jnp.where(x < 0, -jnp.abs(y), jnp.abs(y))
    rest = jnp.where(rest * x < 0, rest + size, rest)
    return jnp.where(jnp.abs(rest) >= jnp.abs(y), rest - size, rest)


def sign(x: Array) -> Array:
    """Sign of x: -1, 0 or 1."""
    return jnp.where(x > 0, jnp.ones_like(x), jnp.where(x < 0, -jnp.ones_like(x), x))


def log1p(x: Array) -> Array:
    """Natural logarithm of 1 + x."""
    return log(1.0 + x)


SINGLE_PRECISION_EXPANSIONS: dict[str, Callable] = {
    f.__name__: f for f in (sin, cos, tan, atan2, acos, asin, atan, exp, log, log1p, erf_inv, rem)
}
EXPANSIONS: dict[str, Callable] = {"sign": sign, "one_minus_square": lambda x: (1.0 - x) * (1.0 + x)}

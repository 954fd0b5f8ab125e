"""A root of a scalar equation."""

from collections.abc import Callable

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float


def newton(
    residual: Callable[[Float[Array, "*b"]], Float[Array, "*b"]], start: Float[Array, "*b"], steps: int
) -> Float[Array, "*b"]:
    """Elementwise root of `residual` from `start` after `steps` steps of Newton; differentiable in both modes."""

    def step(x: Array, _: None) -> tuple[Array, None]:
        value, slope = jax.jvp(residual, (x,), (jnp.ones_like(x),))
        return x - value / slope, None

    return jax.lax.scan(step, start, length=steps)[0]

"""Newton's method for roots of scalar equations."""

from collections.abc import Callable

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float


def newton_root(
    residual: Callable[[Float[Array, "*b"]], Float[Array, "*b"]], start: Float[Array, "*b"], steps: int
) -> Float[Array, "*b"]:
    """Elementwise root of a scalar equation by Newton's method; differentiable in forward and reverse mode.

    Args:
        residual: The elementwise function whose root is sought.
        start: First guess.
        steps: Number of Newton steps; nothing stops earlier.

    Returns:
        The last iterate, of the shape of `start`.
    """

    def step(x: Array, _: None) -> tuple[Array, None]:
        value, slope = jax.jvp(residual, (x,), (jnp.ones_like(x),))
        return x - value / slope, None

    return jax.lax.scan(step, start, length=steps)[0]

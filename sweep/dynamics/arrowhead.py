"""Linear algebra of an arrowhead system: one dense root block and six 3x3 leg blocks."""

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float


class Arrowhead(NamedTuple):
    """[[root, upper], [lower, leg]], unsymmetric while a foot slips."""

    root: Float[Array, "r r"]
    upper: Float[Array, "6 r 3"]
    lower: Float[Array, "6 3 r"]
    leg: Float[Array, "6 3 3"]


class Split(NamedTuple):
    """A generalised vector: its root part and its legs."""

    root: Float[Array, " r"]
    leg: Float[Array, "6 3"]

    def plus(self, share: Array | float, other: "Split") -> "Split":
        """self + share * other."""
        return Split(self.root + share * other.root, self.leg + share * other.leg)


def times(a: Arrowhead, x: Split) -> Split:
    """The product a x."""
    root = a.root @ x.root + jnp.einsum("lij,lj->i", a.upper, x.leg)
    return Split(root, a.lower @ x.root + jnp.einsum("lij,lj->li", a.leg, x.leg))


def solve(a: Arrowhead, b: Split) -> Split:
    """The solution of a x = b: leg blocks by cofactors, then Gauss on the Schur complement, scaled, no pivoting."""
    inverse = inverse_3x3(a.leg)
    lower = inverse @ a.lower
    leg = jnp.einsum("lij,lj->li", inverse, b.leg)
    schur = a.root - jnp.einsum("lij,ljk->ik", a.upper, lower)
    x = _gauss(schur, b.root - jnp.einsum("lij,lj->i", a.upper, leg))
    return Split(x, leg - lower @ x)


def _gauss(a: Array, b: Array) -> Array:
    """Solve a small dense system whose diagonal dominates well enough to need no pivoting."""
    n = a.shape[0]
    rows = jnp.concatenate([a, b[:, None]], axis=1)
    for i in range(n):
        pivot = rows[i] / rows[i, i]
        rows = rows - rows[:, i].at[i].set(0.0)[:, None] * pivot
        rows = rows.at[i].set(pivot)
    return rows[:, n]


def inverse_3x3(m: Float[Array, "*b 3 3"]) -> Float[Array, "*b 3 3"]:
    """Inverses by cofactors."""
    x, y, z = m[..., 0, :], m[..., 1, :], m[..., 2, :]
    columns = jnp.stack([jnp.cross(y, z), jnp.cross(z, x), jnp.cross(x, y)], axis=-1)
    determinant = jnp.sum(x * columns[..., :, 0], axis=-1)
    return columns / determinant[..., None, None]

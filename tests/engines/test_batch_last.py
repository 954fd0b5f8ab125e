"""`batch_last_vmap` against `jax.vmap` on what controllers, physics and metrics are made of."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from sweep.engines.batch_last import batch_last_vmap

B = 5
TABLE = np.array([2, 0, 1])


def arithmetic(x, m, k, shared):
    y = jnp.where(x > shared, jnp.sin(x) / (1 + x**2), 0.5) + jnp.linalg.norm(m, axis=0)
    return jnp.clip(y, -1.0, jnp.max(m)), jnp.argmax(m, axis=0), ~jnp.any(m > 0, axis=1)


def algebra(x, m, k, shared):
    return m @ x, x @ m, jnp.einsum("ij,kj->ik", m, m), jnp.cross(x, m[0]), shared @ m, jnp.trace(m)


def shapes(x, m, k, shared):
    stacked = jnp.stack([x, m[1], jnp.full(3, k)], axis=-1).reshape(9)[::2]
    return stacked, jnp.concatenate([m, x[None]]), jnp.pad(x, (1, 2)), jnp.cumsum(m, axis=1), jnp.flip(m, 0).T


def indices(x, m, k, shared):
    return m[k], x[TABLE], m[TABLE, k], m[:, TABLE], x.at[1:].add(2.0), m.at[TABLE].set(x), shared[k], jnp.sort(x)


def loops(x, m, k, shared):
    def body(carry, row):
        return carry + row @ x, (carry, row * k)

    last, rows = jax.lax.scan(body, 0.0, m)
    branch = jax.lax.cond(x[0] > 0, lambda: x, lambda: -x)
    shared_branch = jax.lax.cond(shared[0] > 0, lambda: (x @ m, k), lambda: (shared, k + 1))
    noise = jax.random.normal(jax.random.fold_in(jax.random.key(3), k), (2,))
    return last, rows, branch, shared_branch, noise, jax.lax.fori_loop(0, 3, lambda i, y: jnp.cos(y + i), x)


def loops_of_own_length(x, m, k, shared):
    """Loops and branches that differ between rollouts."""
    halved = jax.lax.while_loop(lambda now: jnp.sum(now[0] ** 2) > 0.1, lambda now: (now[0] / 2, now[1] + 1), (x, 0))
    counted = jax.lax.while_loop(lambda n: n < k, lambda n: n + 1, 0)
    chosen = jax.lax.switch(k, [lambda: (x, 1.0), lambda: (m[0], x[0]), lambda: (shared, 2.0)])
    return halved, counted, chosen


def derivatives(x, m, k, shared):
    return jax.grad(lambda s: jnp.sum(s * shared) + jnp.sum(s * x))(x), jax.jvp(jnp.linalg.norm, (m,), (m**2,))


@pytest.mark.parametrize("reuse_from", [1, 1 << 40])
@pytest.mark.parametrize("function", [arithmetic, algebra, shapes, indices, loops, loops_of_own_length, derivatives])
def test_equals_vmap(function, reuse_from):
    rng = np.random.default_rng(0)
    args = (rng.normal(size=(3, B)), rng.normal(size=(3, 3, B)), rng.integers(0, 3, B), rng.normal(size=3))
    args = tuple(jnp.asarray(a) for a in args)
    axes = (-1, -1, -1, None)
    expected = jax.jit(jax.vmap(function, axes, -1))(*args)
    given = jax.jit(batch_last_vmap(function, axes, reuse_from))(*args)
    assert jax.tree.structure(given) == jax.tree.structure(expected)
    for a, b in zip(jax.tree.leaves(given), jax.tree.leaves(expected), strict=True):
        assert a.dtype == b.dtype
        np.testing.assert_allclose(a, b, rtol=1e-5, atol=1e-6)


def test_a_not_finite_rollout_touches_no_other():
    x = jnp.ones((3, B)).at[1, 2].set(jnp.nan)
    out = batch_last_vmap(lambda x: jnp.sum(jnp.sqrt(x) @ jnp.eye(3)) * x, (-1,), 1)(x)
    assert np.all(np.isnan(out[:, 2]))
    assert np.all(np.isfinite(np.delete(out, 2, axis=1)))


def test_no_operation_moves_the_batch():
    """Only indices that differ between rollouts may: elsewhere a transpose costs more than the arithmetic around it."""

    def function(x, m):
        summed = jax.lax.while_loop(lambda y: jnp.sum(y) < 9, lambda y: y + m[0] * jnp.max(x), jnp.abs(x))
        branch = jax.lax.cond(x[0] > 0, lambda: m @ x, lambda: x)
        written = m.at[TABLE].set(x), m.at[:, 1].add(x), jnp.zeros(6).at[1:4].set(x)
        return (
            m[TABLE],
            m[:, TABLE[:2]],
            *written,
            summed,
            branch,
            m @ x,
            jnp.concatenate([m, x[None]]).T,
            jnp.sort(x),
            jnp.max(m, axis=0),
        )

    program = jax.make_jaxpr(batch_last_vmap(function, (-1, -1), 1))(jnp.ones((3, B)), jnp.ones((3, 3, B)))
    results = [(eqn.primitive.name, out.aval.shape) for eqn in program.jaxpr.eqns for out in eqn.outvars]
    assert {"gather", "scatter", "scatter-add", "transpose"} <= {name for name, _ in results}
    assert not [result for result in results if B in result[1][:-1]]

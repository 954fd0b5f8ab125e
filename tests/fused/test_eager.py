"""What NumPy makes of a traced function of one rollout, against XLA's, and the same in any batch."""

import pickle
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from sweep.fused import eager
from sweep.fused.arrays import UnsupportedPrimitive

WIDTH = 37  # rollouts, no whole number of any processor's lanes
TABLE = jnp.linspace(-2.0, 3.0, 7)
GRID = jnp.sin(jnp.arange(24.0)).reshape(4, 6)


def arithmetic(x, y, _):
    whole = jnp.floor(7 * x).astype(jnp.int32)
    return {
        "powers": (x**3, x**-2, (1 + x * x) ** y, jax.lax.rsqrt(1 + x * x), jax.nn.sigmoid(x), jnp.sqrt(x)),
        "waves": (jnp.sin(9 * x), jnp.cos(y), jnp.tan(x), jnp.arctan2(x, y), jnp.arccos(x), jnp.arcsin(x), jnp.tanh(y)),
        "logs": (jnp.log(x), jnp.log1p(x), jnp.exp(y), jnp.expm1(x), jax.lax.erf_inv(x)),
        "limits": (jnp.clip(x, -0.3, y), jnp.maximum(x, y), jnp.round(3 * x), jnp.sign(x), jnp.isfinite(jnp.log(x))),
        "integers": (whole // 3, jax.lax.div(whole, whole * 0 + 2), jnp.fmod(whole, 3), whole & 5, ~whole, whole << 2),
        "chosen": (jnp.where(x > y, x, 2.0), jax.lax.select_n(abs(whole) % 3, x, y, x + y), jnp.polyval(TABLE, x)),
        "remainders": jnp.fmod(5 * x, y),
    }


def reductions(x, y, _):
    return {
        "sums": (x.sum(), x.sum(0), jnp.mean(x, axis=1), x.prod(1), jnp.sum(jnp.zeros((0, 3)), axis=0)),
        "extremes": (x.max(), x.min(0), jnp.any(x > y, axis=1), jnp.all(x > -2), x.argmax(1), jnp.argmin(x, axis=0)),
        "totals": (jnp.cumsum(x, axis=1), jnp.cumprod(x, axis=0), jax.lax.cummax(x, axis=0, reverse=True)),
        "products": (x @ x.T, jnp.einsum("ij,kj->ki", x, y), GRID @ x.T, x.ravel() @ y.ravel()),
        "many": jnp.einsum("bij,bjk->bik", jnp.stack([x, y]), jnp.stack([y.T, x.T])),
    }


def places(x, y, _):
    return (
        jnp.concatenate([x, GRID, y], axis=0)[::2, ::-1], jnp.stack([x, GRID], axis=1), jnp.pad(x, ((1, 2), (0, 1))),
        jax.lax.pad(y, 3.0, ((1, 0, 2), (0, 0, 1))), jnp.transpose(x).reshape(3, 8), jnp.tile(x[:, :1], (1, 3)),
        jnp.split(x, (1, 3)), jnp.broadcast_to(x[0], (5, 6)), jnp.arange(6) + x, jnp.roll(y, 2, axis=1),
    )  # fmt: skip


def lookups(x, y, _):
    at = jnp.clip((4 * jnp.abs(x[0, :3])).astype(jnp.int32), 0, 5)  # otherwise in every rollout
    return (
        TABLE[at], x[:, at], x[jnp.array([3, 0, 3])], GRID[at[0] % 4], jnp.take(TABLE, at + 5, mode="fill"),
        jnp.take(x, at + 4, axis=1, mode="clip"), jax.vmap(lambda row, k: row[k])(y, jnp.arange(4) + at[0]),
        jax.lax.dynamic_slice(x, (at[0], at[1]), (2, 3)), jax.lax.dynamic_slice(y, (9, 1), (2, 3)),
        jax.lax.dynamic_update_slice(x, y[:2, :2], (at[1], at[2])), x.at[1, 2].set(7.0), x.at[at[0] % 4].set(y[0]),
        x.at[:, at].add(y[:, :3]), TABLE.at[at + 5].add(1.0, mode="drop"), x.at[jnp.array([1, 1, 2])].add(y[0]),
    )  # fmt: skip


def loops(x, y, _):
    def step(carry, row):
        carry = jnp.sin(carry) + row * y[0]
        return carry, (carry.sum(), row)

    return {
        "scan": jax.lax.scan(step, jnp.zeros(6), x),
        "back": jax.lax.scan(step, x[0], GRID, reverse=True),
        "count": jax.lax.fori_loop(0, 5, lambda k, s: s + k * x[k % 4, 0], 0.0),
        "cond": jax.lax.cond(x[0, 0] > 0, lambda v: v * 2, lambda v: v.at[0].set(0.0), y),
        "switch": jax.lax.switch((3 * jnp.abs(x[1, 1])).astype(int), [jnp.sin, jnp.cos, jnp.tan], x),
        "slope": jax.grad(lambda v: jnp.sum(jnp.linalg.norm(v, axis=1) * y[:, 0]))(x),
        "map": jax.lax.map(lambda row: row @ row, x),
        "while": jax.lax.while_loop(lambda s: s.sum() < 9, lambda s: s + 0.5 + jnp.abs(x[0]), y[0]),
    }


def matrices(x, y, _):
    square = x @ x.T + 2 * jnp.eye(4)
    factor, solve = jnp.linalg.cholesky(square), jax.scipy.linalg.solve_triangular
    return (
        factor, solve(factor, y, lower=True), solve(factor, y, trans=1, lower=True), solve(square, y[:, 0]),
        solve(factor, y, lower=True, unit_diagonal=True), jnp.linalg.cholesky(-square),
        jax.lax.linalg.triangular_solve(factor, y.T, lower=True, transpose_a=True),
        jax.lax.linalg.triangular_solve(factor, y.T, lower=True),
    )  # fmt: skip


def draws(x, y, key):
    one, two = jax.random.split(jax.random.fold_in(key, 3))
    return jax.random.normal(one, (4, 6)) * x, jax.random.uniform(two, minval=y[0, 0], maxval=2.0), two, x[0, 0]


def batch(width: int = WIDTH, dtype: Any = np.float32):
    """The first argument differs among rollouts, the second does not."""
    random = np.random.default_rng(0)
    x, y = random.uniform(-1, 1, (width, 4, 6)).astype(dtype), random.uniform(-1, 1, (4, 6)).astype(dtype)
    return x, y, jax.random.split(jax.random.key(0), width)


def leaves(tree):
    return [np.asarray(x if isinstance(x.dtype, np.dtype) else jax.random.key_data(x)) for x in jax.tree.leaves(tree)]


@pytest.mark.parametrize("double", [False, True])
@pytest.mark.parametrize("function", [arithmetic, reductions, places, lookups, loops, matrices, draws])
def test_it_is_what_xla_makes_of_it(function, double):
    with jax.enable_x64(double):
        x, y, keys = batch(dtype=np.float64 if double else np.float32)
        program = eager.trace_numpy_program(function, x[0], y, keys[0])
        made, expected = program(WIDTH, x, y, keys), jax.jit(jax.vmap(function, (0, None, 0)))(x, y, keys)
        assert jax.tree.structure(made) == jax.tree.structure(expected)
        for one, other in zip(leaves(made), leaves(expected), strict=True):
            assert (one.shape, one.dtype) == (other.shape, other.dtype)
            rounding = 1e-12 if double else 1e-5  # of some dozen operations, on numbers up to some ten
            np.testing.assert_allclose(one, other, rounding, rounding)


@pytest.mark.parametrize("function", [arithmetic, reductions, lookups, loops, matrices, draws])
def test_numbers_depend_neither_on_the_batch_nor_on_the_place_in_it(function):
    x, y, keys = batch()
    program = pickle.loads(pickle.dumps(eager.trace_numpy_program(function, x[0], y, keys[0])))
    whole = leaves(program(WIDTH, x, y, keys))
    for here in (slice(0, 1), slice(5, 6), slice(36, 37), slice(3, 20), slice(None, None, -1)):
        part = leaves(program(len(x[here]), x[here], y, keys[here]))
        each = leaves(program(len(x[here]), x[here], np.broadcast_to(y, (len(x[here]), 4, 6)), keys[here]))
        for k, all_of_it in enumerate(whole):
            np.testing.assert_array_equal(part[k], all_of_it[here])
            np.testing.assert_array_equal(each[k], all_of_it[here])


def test_what_is_set_apart_is_done_by_others():
    @jax.jit
    def dear(rows, scale):
        return jnp.sort(rows) * scale  # for which there is no rule

    def function(x, y):
        return dear(x, 2.0) + y.sum()

    x, y, _ = batch(3)
    program = eager.trace_numpy_program(function, x[0], y, external=("dear",))
    assert [(a.shape, a.dtype) for a in program.external_functions["dear"]] == [((4, 6), np.float32), ((), np.float32)]
    made = program(3, x, y, external={"dear": lambda rows, scale: np.sort(rows, axis=1) * scale})
    np.testing.assert_allclose(made, np.sort(x, axis=2) * 2 + y.sum(), rtol=1e-6)
    with pytest.raises(UnsupportedPrimitive, match="sort"):
        eager.trace_numpy_program(function, x[0], y)


def test_plain_numbers_are_worked_out_while_something_is_traced_and_by_xla_without_a_rule():
    def traced(x):
        assert eager.evaluate_constant_function(lambda: jnp.sin(2.0) + 1) == pytest.approx(np.sin(2) + 1)
        assert eager.evaluate_constant_function(lambda: jnp.sort(jnp.array([2.0, 1.0])))[0] == 1
        return x

    jax.make_jaxpr(traced)(1.0)

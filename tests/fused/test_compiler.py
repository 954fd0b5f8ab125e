"""The fused compiler against XLA: single operations, loops and branches, groups, and the page that tells of it."""

import re
import subprocess
import sys
from functools import partial
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sweep.fused import kernel, llvm
from sweep.fused import program as fused_program
from sweep.fused.arrays import UnsupportedPrimitive
from sweep.fused.program import Branch, Node, walk_block

PAGE = Path(__file__).parents[2] / "docs/compiler.md"
WIDTH = 5


def both(function, *batch, group=6):
    """What `function` of one rollout records for a batch, fused, by narrow tiles and wide ones, and by XLA."""
    one = [jax.ShapeDtypeStruct(x.shape[1:], x.dtype) for x in batch]

    def fused(lanes: int):
        code = kernel.compile_function(
            lambda given, carried, k: (carried, function(*given)), one, [jnp.zeros(())], group, lanes
        )
        tiles = kernel.Kernel(code).load_batch(list(batch), [jnp.zeros(WIDTH)], WIDTH)
        record = tiles.advance_ticks(0, 1, np.arange(WIDTH))
        assert record is not None
        return {name: x[0] for name, x in record.items()}

    wide, narrow = fused(llvm.TILE_LANES), fused(llvm.NARROW_TILE_LANES)
    for name, values in narrow.items():
        np.testing.assert_array_equal(values, wide[name], err_msg=name)
    return wide, jax.vmap(function)(*batch)


def some(*shape: int, seed: int = 0) -> jax.Array:
    return jnp.asarray(np.random.default_rng(seed).uniform(-3, 3, (WIDTH, *shape)), jnp.float32)


EXACT = {
    "sin": np.sin,
    "cos": np.cos,
    "tan": np.tan,
    "acos": lambda x: np.arccos(x / 4),
    "asin": lambda x: np.arcsin(x / 4),
    "atan2": lambda x: np.arctan2(x, x[:, ::-1] - 1),
    "exp": lambda x: np.exp(8 * x),
    "log": lambda x: np.log(np.abs(x)),
    "rem": lambda x: np.fmod(x, 0.75),
}


def test_functions_that_vector_units_lack_are_good_to_three_units_in_the_last_place():
    def of(x):
        return {
            "sin": jnp.sin(x),
            "cos": jnp.cos(x),
            "tan": jnp.tan(x),
            "acos": jnp.arccos(x / 4),
            "asin": jnp.arcsin(x / 4),
            "atan2": jnp.arctan2(x, x[::-1] - 1),
            "exp": jnp.exp(8 * x),
            "log": jnp.log(jnp.abs(x)),
            "rem": jnp.fmod(x, jnp.float32(0.75)),
        }

    x = some(9)
    fused, _ = both(of, x)
    for name, values in fused.items():
        exact = EXACT[name](np.asarray(x, np.float64))
        assert np.all(np.abs(values - exact) <= 3 * np.spacing(np.abs(exact).astype(np.float32)) + 2e-7), name


def test_not_a_number_stays_one_and_infinities_are_kept():
    x = jnp.array([[np.nan, 1.0], [1.0, np.nan], [np.inf, 1.0], [0.0, -0.0], [-np.inf, 2.0]], jnp.float32)
    fused, xla = both(
        lambda x: {
            "max": jnp.max(x),
            "min": jnp.min(x),
            "sin": jnp.sin(x),
            "sum": jnp.sum(x),
            "at": jnp.argmax(x),
            "sign": jnp.sign(x),
            "sqrt": jnp.sqrt(x),
            "finite": jnp.isfinite(x),
            "log": jnp.log(x),
        },
        x,
    )
    for name, values in fused.items():
        np.testing.assert_allclose(values, xla[name], rtol=1e-6, err_msg=name)


def test_zero_times_what_is_no_number_is_none_as_by_xla():
    """An outcome is invalid where NaN arrives: no product with a zero of a matrix may lose it on its way."""
    eye, axis = np.eye(3, dtype=np.float32), np.array([0.0, 0.0, 1.0], np.float32)
    x = np.ones((WIDTH, 3), np.float32)
    x[[0, 1, 2], [0, 1, 2]] = np.nan, np.inf, -np.inf

    def of(x):
        return {
            "product": 0.0 * x,
            "turned": x * jnp.zeros(3),
            "dot": jnp.asarray(axis) @ x,
            "matrix": jnp.asarray(eye) @ x,
            "cross": jnp.cross(x, jnp.asarray(axis)),
            "of the legs": jnp.sum(jnp.zeros((6, 1)) * x, axis=0),
            "counted": 0.0 * (x > 1).astype(jnp.float32) + 0.0 * jnp.where(x > 1, 2.0, 3.0),
        }

    fused, xla = both(of, jnp.asarray(x))
    for name, values in fused.items():
        np.testing.assert_array_equal(values, xla[name], err_msg=name)


def ring(size: int):
    """A tick that reads a ring buffer by each rollout's own delay, then puts this tick's numbers into it."""

    def tick(delay, carried, number):
        past, feet = carried
        late = past[(number + size - delay) % size]
        feet = 0.9 * feet + 0.1 * late + number
        past = jax.lax.dynamic_update_index_in_dim(past, feet, number % size, 0)
        return (past, feet), {"feet": feet, "late": late}

    return tick


@pytest.mark.parametrize("shape", [(6, 3), (4,)])
def test_a_row_is_stored_at_a_computed_address(shape):
    size, ticks, tick = 5, 12, ring(5)
    delays, start = jnp.arange(WIDTH) % size, (some(size, *shape), some(*shape, seed=1))
    code = kernel.compile_function(tick, delays[0], jax.tree.map(lambda x: x[0], start))
    record = kernel.Kernel(code).load_batch(delays, start, WIDTH).advance_ticks(0, ticks, np.arange(WIDTH))
    assert record is not None
    for k in range(WIDTH):
        carried = jax.tree.map(lambda x, k=k: x[k], start)
        for number in range(ticks):
            carried, expected = tick(delays[k], carried, number)
            for name, value in expected.items():
                np.testing.assert_allclose(record[name][number, k], value, rtol=1e-6, atol=1e-5)


def test_a_longer_ring_buffer_takes_no_more_instructions():
    def instructions(size: int) -> int:
        _, printer = kernel.print_llvm_program(ring(size), jnp.int32(0), (jnp.zeros((size, 6, 3)), jnp.zeros((6, 3))))
        return len(printer.lines)

    assert instructions(100) == instructions(4)


def test_a_replaced_row_that_is_used_at_once_is_looked_up():
    def tick(x, table, number):
        new = jax.lax.dynamic_update_index_in_dim(table, table[2] + x, number % 3, 0)
        return table, {"new": new, "doubled": 2 * new}

    start = some(3, 2)
    code = kernel.compile_function(tick, jnp.float32(0), start[0])
    tiles = kernel.Kernel(code).load_batch(jnp.ones(WIDTH), start, WIDTH)
    record = tiles.advance_ticks(0, 4, np.arange(WIDTH))
    assert record is not None
    for number in range(4):
        expected = start.at[:, number % 3].set(start[:, 2] + 1)
        np.testing.assert_array_equal(record["new"][number], expected)
        np.testing.assert_array_equal(record["doubled"][number], 2 * expected)


def test_a_batch_keeps_the_program_that_it_goes_through():
    """In a process of its own, which ended in a segmentation fault."""
    code = """if True:
        import gc, jax, jax.numpy as jnp
        from sweep.fused.kernel import Kernel, compile_function
        one = jnp.zeros(()) 
        code = compile_function(lambda given, carried, k: (carried + given, {}), one, one)
        tiles = Kernel(code).load_batch(one + 2, one[None], 1)
        gc.collect()
        tiles.advance_ticks(0, 3)
        print(tiles.read_full_state())
    """
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout) == (0, "[6.]\n"), done.stderr


def test_random_numbers_are_those_of_jax():
    def drawn(words):
        key = jax.random.wrap_key_data(words)
        first, second = jax.random.split(jax.random.fold_in(key, 7))
        chosen = jnp.where(words[0] % 2 == 0, first, second)
        return {
            "bits": jax.random.bits(first, (3, 2)),
            "normal": jax.random.normal(second, (4,)),
            "chosen": jax.random.bits(chosen),
        }

    fused, xla = both(drawn, jax.random.key_data(jax.random.split(jax.random.key(3), WIDTH)))
    for name in ("bits", "chosen"):
        np.testing.assert_array_equal(fused[name], xla[name])
    np.testing.assert_allclose(fused["normal"], xla["normal"], rtol=1e-6)


@given(st.integers(0, 1000))
@settings(max_examples=5, deadline=None)
def test_arrays_are_moved_about_and_summed_as_jax_does(seed):
    def moved(x, m):
        legs = jnp.einsum("lij,lj->li", m, x)  # leg by leg
        swapped = legs[jnp.array([1, 2, 3, 4, 5, 0])]
        total = jnp.sum(jnp.cross(legs, swapped), axis=0)
        pairs = legs[jnp.array([0, 2])] - legs[jnp.array([2, 4])]
        flat = jnp.concatenate([total, legs.ravel()])
        return {
            "legs": legs,
            "total": total,
            "pairs": pairs,
            "max": jnp.max(legs, axis=0),
            "flat": flat[3:].reshape(6, 3) @ total,
            "best": jnp.argmin(legs[:, 0]),
            "set": legs.at[:, 1].set(total[0]),
            "order": jnp.cumsum(x, axis=0),
            "diagonal": jnp.diagonal(m[0] @ m[1]),
        }

    fused, xla = both(moved, some(6, 3, seed=seed), some(6, 3, 3, seed=seed + 1))
    for name, values in fused.items():
        np.testing.assert_allclose(values, xla[name], rtol=1e-4, atol=1e-3, err_msg=name)


def test_a_place_in_a_long_table_of_constants():
    """Such as which of a plan's stages follow a law of their own: as many choices as there are runs of the same."""
    table = np.repeat([0.5, 2.0, 0.5, -1.0], [70, 1, 40, 9]).astype(np.float32)
    places = jnp.array([0, 69, 70, 71, 119])
    fused, _ = both(lambda k: {"found": jnp.asarray(table)[k]}, places)
    np.testing.assert_array_equal(fused["found"], table[places])


@pytest.mark.parametrize("double", [False, True])
def test_a_choice_of_several_by_numbers_of_either_size(double):
    with jax.enable_x64(double):
        which = jnp.array([0, 1, 2, 1, 0])
        fused, xla = both(lambda k, x: {"of": jax.lax.select_n(k, x[0], x[1], x[2])}, which, some(3))
        np.testing.assert_array_equal(fused["of"], xla["of"])


def test_places_that_depend_on_the_rollout_and_loops():
    def walked(table, index):
        k = index[0].astype(jnp.int32)

        def body(carry, i):
            x, y = carry
            return (y, jnp.sin(x) + 0.1 * table[k] + i), None

        (x, y), _ = jax.lax.scan(body, (table[0], table[1]), jnp.arange(40.0))
        chosen = jax.lax.cond(k > 1, lambda: x, lambda: y)
        return {
            "row": table[k],
            "clipped": jax.lax.dynamic_slice(table, (k, 1), (3, 1)),
            "x": x,
            "y": y,
            "chosen": chosen,
            "put": table.at[k, 0].set(9.0),
        }

    index = jnp.array([[0.0], [1.0], [2.0], [3.0], [4.0]], jnp.float32)
    fused, xla = both(walked, some(5, 6), index)
    for name, values in fused.items():
        np.testing.assert_allclose(values, xla[name], rtol=1e-5, atol=1e-5, err_msg=name)


def cube_root(form, x):
    """By Newton's method, as exactly as single precision allows: the root, and how many iterations were needed."""

    def improve(y, n):
        return y - (y**3 - jnp.sqrt(x * x)) / (3 * y * y), n + 1

    def wants_more(y):
        return jnp.abs(y**3 - x) > 1e-4 * x

    def iterate(carry, _):
        return jax.lax.cond(wants_more(carry[0]), lambda: improve(*carry), lambda: carry), None

    start = jnp.ones(()), jnp.zeros(())
    if form == "while":
        y, n = jax.lax.while_loop(lambda carry: wants_more(carry[0]), lambda carry: improve(*carry), start)
    else:
        y, n = jax.lax.scan(iterate, start, length=400)[0]
    return {"y": y, "n": n}


@pytest.mark.parametrize("form", ["cond", "while"])
def test_what_no_rollout_needs_is_skipped_and_changes_nothing_where_another_needs_it(form):
    x = jnp.array([1.0, 8.0, 1e3, 0.5, 64.0], jnp.float32)
    fused, xla = both(partial(cube_root, form), x)
    assert len(set(fused["n"].tolist())) > 3
    np.testing.assert_array_equal(fused["n"], xla["n"])
    np.testing.assert_allclose(fused["y"], np.cbrt(x), rtol=1e-4)
    for row, alone in zip(fused["y"], x, strict=True):  # the rollouts beside it make no difference
        assert both(partial(cube_root, form), jnp.full(WIDTH, alone))[0]["y"][0] == row


def square_roots(x):
    """Roots (6,) of x and the numbers beside it: Newton's method in a loop that ends when all six are found.

    Each step's length is halved in a loop within it, until no root passes 9.
    """
    wanted = x + jnp.arange(6.0)

    def wants_more(state):
        return (state[0] < 40) & (jnp.abs(state[1] ** 2 - wanted) > 1e-4 * wanted).any()

    def step(state):
        count, roots, halvings = state
        way = (wanted - roots**2) / (2 * roots)
        length, more = jax.lax.while_loop(
            lambda inner: (roots + inner[0] * way > 9).any(),
            lambda inner: (inner[0] / 2, inner[1] + 1),
            (jnp.ones(()), jnp.int32(0)),
        )
        return count + 1, roots + length * way, halvings + more

    count, roots, halvings = jax.lax.while_loop(wants_more, step, (jnp.int32(0), jnp.full(6, 0.5), jnp.int32(0)))
    return {"count": count, "roots": roots, "halvings": halvings}


def test_a_loop_within_a_loop_ends_for_each_rollout_by_itself():
    x = jnp.array([0.0, 2.0, 40.0, 9.0, 75.0], jnp.float32)  # the root of 0 takes all 40 steps
    fused, xla = both(square_roots, x)
    assert len(set(fused["count"].tolist())) > 2
    assert 0 in fused["halvings"]
    assert fused["halvings"].max() > 2
    for name in ("count", "halvings"):
        np.testing.assert_array_equal(fused[name], xla[name])
    np.testing.assert_allclose(fused["roots"], np.sqrt(np.asarray(x)[:, None] + np.arange(6)), rtol=1e-4, atol=1e-6)
    for row, alone in zip(fused["roots"], x, strict=True):  # the rollouts beside it make no difference
        np.testing.assert_array_equal(both(square_roots, jnp.full(WIDTH, alone))[0]["roots"][0], row)


def test_a_loop_that_no_rollout_enters_leaves_what_it_carries():
    def count_down(x):
        left, steps = jax.lax.while_loop(lambda s: s[0] > 0, lambda s: (s[0] - 1, s[1] + 1), (x, jnp.int32(3)))
        return {"left": left, "steps": steps}

    fused, _ = both(count_down, jnp.array([-1.0, -2.5, 0.0, -7.0, -0.5], jnp.float32))
    np.testing.assert_array_equal(fused["left"], [-1.0, -2.5, 0.0, -7.0, -0.5])
    np.testing.assert_array_equal(fused["steps"], 3)


def test_what_may_be_skipped_stands_in_a_branch_but_for_what_the_loop_repeats():
    one = jax.ShapeDtypeStruct((), jnp.float32)
    program, _ = kernel.print_llvm_program(lambda x, carried, k: (carried, cube_root("cond", x)), one, jnp.zeros(()), 6)
    (branch,) = (x for x in walk_block(program.top_block) if isinstance(x, Branch))
    idle, busy = branch.blocks
    assert [x for x in walk_block(idle) if isinstance(x, Node)] == []
    assert [x.op for x in walk_block(busy) if isinstance(x, Node) and x.op in ("div", "sqrt")] == ["div"]


def test_what_is_carried_keeps_its_shapes_or_is_refused():
    """Else ticks would write beyond the memory that a batch began with."""
    given, carried = jnp.zeros(()), (jnp.zeros(2), jnp.zeros(()))
    with pytest.raises(TypeError, match=r"shapes: \(2,\) to \(3,\)$"):
        kernel.compile_function(lambda given, carried, k: ((jnp.zeros(3), carried[1] + given), {}), given, carried)


def test_what_has_no_rule_is_named():
    with pytest.raises(UnsupportedPrimitive, match="sort"):
        both(lambda x: {"x": jnp.sort(x)}, some(3))


@pytest.mark.parametrize("group", [4, 8])
def test_a_group_may_have_another_size(group):
    """As that of a robot with four legs: one operation for all, the results those of XLA."""

    def moved(x):
        far = jnp.sqrt(jnp.sum(x * x, axis=-1))
        return {"far": far, "most": jnp.max(far), "sum": jnp.sum(x, axis=0), "next": jnp.roll(x, 1, axis=0) * x}

    x = some(group, 3)
    fused, xla = both(moved, x, group=group)
    for name, values in fused.items():
        np.testing.assert_allclose(values, xla[name], rtol=1e-5, atol=1e-6, err_msg=name)
    one = jax.ShapeDtypeStruct(x.shape[1:], x.dtype)
    program, _ = kernel.print_llvm_program(lambda given, carried, k: (carried, moved(given)), one, jnp.zeros(()), group)
    roots = [n for n in walk_block(program.top_block) if isinstance(n, Node) and n.op == "sqrt"]
    assert [n.leg for n in roots] == [True]


def test_rows_that_are_alike_leave_the_others_one_operation_for_the_legs():
    def rooted(x):
        return {"x": jnp.sqrt(jnp.stack([jnp.broadcast_to(x[0], 6), x * x]))}

    fused, xla = both(rooted, x := abs(some(6)))
    np.testing.assert_allclose(fused["x"], xla["x"], rtol=1e-6)
    one = jax.ShapeDtypeStruct(x.shape[1:], x.dtype)
    program, _ = kernel.print_llvm_program(lambda given, carried, k: (carried, rooted(given)), one, jnp.zeros(()))
    roots = [n for n in walk_block(program.top_block) if isinstance(n, Node) and n.op == "sqrt"]
    assert sorted(n.leg for n in roots) == [False, True]


def test_the_pages_example_runs_and_its_operations_are_those_of_the_code(capsys):
    text = PAGE.read_text(encoding="utf-8")
    (sample,) = re.findall(r"```python\n(.*?)```", text, re.DOTALL)
    names = {}
    exec(sample, names)
    assert names["record"]["sum"].shape == (2, 1)
    assert "define void @run" in capsys.readouterr().out
    described = " ".join(
        re.findall(r'"""Extra data of (.*?):', Path(fused_program.__file__).read_text(encoding="utf-8"))
    )
    told = set(re.findall(r"`(\w+)`", described))
    with_extra = {n.op for n in walk_block(names["program"].top_block) if isinstance(n, Node) and n.extra is not None}
    assert with_extra
    assert with_extra <= told

"""The fused compiler for GPUs: its kernels in NumPy beside XLA and the CPU's, and on a GPU where there is one."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import ptx  # beside this file
import pytest
from validity import precision, simulation
from validity.scenes import kick_on_slope

from sweep.backends import program_cache
from sweep.config.experiment import compose
from sweep.contract.engine_settings import EngineSettings
from sweep.core.errors import InputError
from sweep.engines.mjx import MjxEngine
from sweep.fused import driver, launch
from sweep.fused.arrays import UnsupportedPrimitive

WIDTH = launch.MIN_ROLLOUTS_PER_BLOCK
HOW = pytest.mark.parametrize("few", [False, True], ids=["many", "few"])  # some parts without legs in lanes, or none


@pytest.fixture(autouse=True)
def without_a_gpu(monkeypatch):
    if jax.default_backend() != "gpu":
        monkeypatch.setattr(launch, "call_kernel", ptx.call)


def both(function, *batch, few=False):
    """What `function` of one rollout records for a batch, by a kernel and by XLA."""
    one = [jax.ShapeDtypeStruct(x.shape[1:], x.dtype) for x in batch]
    state = [jax.ShapeDtypeStruct((), jnp.bool)]
    code = launch.compile_to_ptx(
        lambda given, carried, k: (carried, function(*given)),
        one,
        state,
        lambda x: x[0],
        1,
        WIDTH,
        WIDTH,
        small_batch=few,
    )
    every = jnp.arange(WIDTH)
    _, record = launch.run_kernel(code, list(batch), [jnp.zeros(WIDTH, bool)], jnp.int32(0), every)
    return {name: x[0] for name, x in record.items()}, jax.vmap(function)(*batch)


def some(*shape: int, seed: int = 0) -> jax.Array:
    return jnp.asarray(np.random.default_rng(seed).uniform(-3, 3, (WIDTH, *shape)), jnp.float32)


@HOW
def test_legs_in_lanes_are_moved_about_and_summed_as_jax_does(few):
    def moved(x, m):
        legs = jnp.einsum("lij,lj->li", m, x)
        swapped = legs[jnp.array([1, 2, 3, 4, 5, 0])]
        total = jnp.sum(jnp.cross(legs, swapped), axis=0)
        return {
            "legs": legs,
            "total": total,
            "most": jnp.max(legs, axis=0),
            "flat": jnp.concatenate([total, legs.ravel()])[3:].reshape(6, 3) @ total,
            "best": jnp.argmin(legs[:, 0]),
            "any": jnp.any(legs > 2, axis=0),
            "set": legs.at[:, 1].set(total[0]),
        }

    kernel, xla = both(moved, some(6, 3), some(6, 3, 3, seed=1), few=few)
    for name, values in kernel.items():
        np.testing.assert_allclose(values, xla[name], rtol=1e-4, atol=1e-3, err_msg=name)


@HOW
@pytest.mark.parametrize("shape", [(6, 3), (4,)])
def test_a_row_is_stored_at_a_computed_address(few, shape):
    size, ticks = 5, 12

    def tick(delay, carried, number):
        past, feet, over = carried
        late = past[(number + size - delay) % size]
        past = jax.lax.dynamic_update_index_in_dim(past, feet, number % size, 0)  # carried, and changed below
        feet = 0.9 * feet + 0.1 * late + number
        return (past, feet, over), {"late": late}

    delays = jnp.arange(WIDTH) % size
    start = some(size, *shape), some(*shape, seed=1), jnp.zeros(WIDTH, bool)
    one = jax.tree.map(lambda x: x[0], (delays, start))
    code = launch.compile_to_ptx(tick, *one, lambda x: x[2], ticks, WIDTH, WIDTH, small_batch=few)
    after, record = launch.run_kernel(code, delays, start, jnp.int32(0), jnp.arange(WIDTH))
    carried = start
    for number in range(ticks):
        carried, expected = jax.vmap(tick, (0, 0, None))(delays, carried, number)
        np.testing.assert_allclose(record["late"][number], expected["late"], rtol=1e-5, atol=1e-5)
    jax.tree.map(lambda a, b: np.testing.assert_allclose(a, b, rtol=1e-5, atol=1e-5), after, carried)


@HOW
def test_loops_branches_and_places_that_depend_on_the_rollout(few):
    def walked(table, index):
        k = index.astype(jnp.int32)

        def body(carry, i):
            feet, force = carry
            force = 0.5 * force + jnp.sin(feet) * jnp.sum(feet[:, 0]) + table[k, 0] + i
            return (feet + 0.01 * force, force), None

        (feet, force), _ = jax.lax.scan(body, (jnp.outer(table[:, 1], table[0]), jnp.zeros((6, 6))), jnp.arange(40.0))
        chosen = jax.lax.cond(k > 1, lambda: feet[0], lambda: force[3])
        return {"row": table[k], "feet": feet, "chosen": chosen, "put": table.at[k, 0].set(9.0)}

    kernel, xla = both(walked, 0.1 * some(6, 6), jnp.arange(WIDTH, dtype=jnp.float32) % 6, few=few)
    for name, values in kernel.items():
        np.testing.assert_allclose(values, xla[name], rtol=1e-4, atol=1e-4, err_msg=name)


@HOW
def test_not_a_number_stays_one_and_random_numbers_are_those_of_jax(few):
    def drawn(x, words):
        bits = jax.random.bits(jax.random.fold_in(jax.random.wrap_key_data(words), 7), (3,))
        return {"most": jnp.max(x), "least": jnp.min(x), "finite": jnp.isfinite(x), "bits": bits, "log": jnp.log(x)}

    x = some(3).at[0, 1].set(jnp.nan).at[1, 0].set(jnp.inf).at[2, 2].set(0.0)
    kernel, xla = both(drawn, x, jax.random.key_data(jax.random.split(jax.random.key(3), WIDTH)), few=few)
    for name, values in kernel.items():
        np.testing.assert_allclose(values, xla[name], rtol=1e-6, err_msg=name)


def test_quotients_and_roots_are_rounded_as_ieee_has_it_and_keep_what_is_no_number():
    def worked(a, b):
        return {"quotient": a / b, "root": jnp.sqrt(b)}

    odd = [0.0, -0.0, 1.0, -3.0, np.inf, -np.inf, np.nan, 1e-30, 1e30]
    pairs = [(a, b) for a in odd for b in odd] + [(1.0, b) for b in (1e-40, 3e-39, 1e-37)]
    pairs = np.resize(np.array(pairs, np.float32), (2, WIDTH, 3, 2))
    pairs[1] = np.random.default_rng(0).lognormal(0, 20, pairs.shape[1:])
    a, b = (np.concatenate(x, axis=1) for x in np.moveaxis(pairs, -1, 0))
    kernel, _ = both(worked, jnp.asarray(a), jnp.asarray(b))
    with np.errstate(all="ignore"):
        quotient, root = a / b, np.sqrt(b)
    tiny = [(x != 0) & (np.abs(x) < 2.0**-126) for x in (b, quotient)]
    usual = ~(tiny[0] | tiny[1])
    np.testing.assert_array_equal(kernel["quotient"][usual], quotient[usual])
    np.testing.assert_array_equal(kernel["root"], root)


def test_rollouts_go_on_until_all_of_their_warp_are_over():
    def counted(given, carried, k):
        count, over = carried
        return (count + 1, over | (count + 1 >= given)), {}

    like = (jax.ShapeDtypeStruct((), jnp.int32), jax.ShapeDtypeStruct((), jnp.bool))
    code = launch.compile_to_ptx(counted, like[0], like, lambda x: x[1], 6, 0, 34)
    ends = jnp.where(jnp.arange(34) < 32, 3, 9)  # a warp has 32 rollouts
    carried = jnp.zeros(34, jnp.int32), jnp.zeros(34, bool)
    (count, over), _ = launch.run_kernel(code, ends, carried, jnp.int32(0), None)
    assert count.tolist() == [3] * 32 + [6] * 2
    assert over.tolist() == [True] * 32 + [False] * 2
    # a batch that stays as the kernel lays it out: a number of each rollout is read and written between launches
    given, state = launch.pack_batch(code, ends, carried)
    state, _ = launch.advance_packed_batch(code, given, state, jnp.int32(0), None)
    leaf = code.carry_leaves[0]
    assert launch.read_carry_leaf(leaf, jnp.asarray(state), 34).tolist() == count.tolist()
    state = launch.write_carry_leaf(leaf, jnp.asarray(state), jnp.arange(34, dtype=jnp.int32))
    count, over = launch.unpack_carry(code, state, carried)
    assert count.tolist() == [*range(34)]
    assert over.tolist() == [True] * 32 + [False] * 2


@HOW
def test_lanes_do_not_part_where_some_rollouts_of_a_warp_are_over_with_all_beside_them_in_another_part(few):
    def ticked(given, carried, k):
        feet, over, least = carried
        often = (k + jnp.int32(2)) % 3  # worked out beside the flag, and asked for among legs
        feet, _ = jax.lax.scan(lambda x, i: (0.5 * x + jnp.sin(x) + 0.1 * i, None), feet, jnp.arange(99.0))
        least = jax.lax.cond(often == 1, lambda: jnp.minimum(least, jnp.min(jnp.sin(feet) + given)), lambda: least)
        return (feet, over | (k >= given), least), {}

    given = jnp.where(jnp.arange(WIDTH) < 32, 1.0, 9.0)  # 32 have a thread each in one warp, five their legs in one
    feet = 0.1 * jnp.arange(WIDTH * 18.0).reshape(WIDTH, 6, 3)
    carried = feet, jnp.zeros(WIDTH, bool), jnp.full(WIDTH, 9.0)
    one = jax.tree.map(lambda x: jax.ShapeDtypeStruct(x.shape[1:], x.dtype), (given, carried))
    code = launch.compile_to_ptx(ticked, *one, lambda carried: carried[1], 7, 0, WIDTH, small_batch=few)
    kernel, _ = launch.run_kernel(code, given, carried, jnp.int32(0), None)
    for k in range(7):
        carried, _ = jax.vmap(ticked, (0, 0, None))(given, carried, jnp.int32(k))
    going = np.asarray(given) > 2
    np.testing.assert_array_equal(kernel[1], carried[1])
    np.testing.assert_allclose(kernel[2][going], carried[2][going], rtol=1e-4)


@HOW
def test_parts_hand_on_what_they_have_worked_out_however_many_rollouts_a_block_has(monkeypatch, few):
    def between(feet, given):
        some = jax.lax.scan(lambda x, i: (jnp.cos(given @ x) + x, None), given, jnp.arange(30.0))[0]
        return jnp.sum(some @ some) + jnp.min(feet[0] - feet[3])

    def ticked(given, carried, k):
        feet, total, over = carried
        pressed = jnp.cos(feet) * given[0]  # of the old feet, before and after a loop and a sum
        most = jnp.max(feet)
        feet, _ = jax.lax.scan(lambda x, i: (0.5 * x + jnp.sin(x @ given) + 0.1 * i, None), feet + k, jnp.arange(9.0))
        total = total + jnp.sum(pressed * feet) + most
        near = jax.lax.cond(k % 2 == 0, lambda: between(feet, given), lambda: total)
        return (pressed[:, ::-1] - total, total, over | (total > 1e9)), {
            "total": total,
            "old": carried[0],
            "near": near,
        }

    width = WIDTH + 3
    given = jnp.asarray(np.random.default_rng(0).uniform(-0.2, 0.2, (width, 3, 3)), jnp.float32)
    feet = jnp.asarray(np.random.default_rng(1).uniform(-1, 1, (width, 6, 3)), jnp.float32)
    carried = feet, jnp.zeros(width), jnp.zeros(width, bool)
    one = jax.tree.map(lambda x: jax.ShapeDtypeStruct(x.shape[1:], x.dtype), (given, carried))

    def run(turns):
        monkeypatch.setattr(launch, "MAX_BLOCK_FACTOR", turns)
        code = launch.compile_to_ptx(ticked, *one, lambda carried: carried[2], 2, WIDTH, width, small_batch=few)
        assert code.rollouts_per_block == turns * WIDTH
        return launch.run_kernel(code, given, carried, jnp.int32(3), jnp.arange(WIDTH))

    parts, xla = run(1), carried
    jax.tree.map(np.testing.assert_array_equal, parts, run(2))
    for k in (3, 4):
        xla, record = jax.vmap(ticked, (0, 0, None))(given, xla, jnp.int32(k))
    for a, b in zip(parts[0], xla, strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-3, atol=1e-3)
    for name, values in record.items():
        np.testing.assert_allclose(parts[1][name][1], values[:WIDTH], rtol=1e-3, atol=1e-3, err_msg=name)


@HOW
def test_branches_of_the_legs_that_depend_on_one_another_go_in_their_order(few):
    def ticked(given, carried, k):
        feet, least, over = carried
        feet, _ = jax.lax.scan(lambda x, i: (0.5 * x + jnp.sin(x) + 0.1 * i, None), feet, jnp.arange(30.0))
        often = k % 2 == 0
        first = jax.lax.cond(often, lambda: jnp.sin(feet) * jnp.cos(feet + given), lambda: feet)
        scale = jnp.exp(given) + 1  # of what is given alone, asked for only behind a branch
        then = jnp.max(first) * scale
        second = jax.lax.cond(often, lambda: jnp.sin(first * then) + jnp.cos(feet), lambda: first)
        return (second, jnp.minimum(least, jnp.sum(second)) + jnp.sum(feet), over), {}

    given = jnp.linspace(0.1, 0.4, WIDTH)
    carried = 0.1 * some(6, 3), jnp.zeros(WIDTH), jnp.zeros(WIDTH, bool)
    one = jax.tree.map(lambda x: jax.ShapeDtypeStruct(x.shape[1:], x.dtype), (given, carried))
    code = launch.compile_to_ptx(ticked, *one, lambda carried: carried[2], 3, 0, WIDTH, small_batch=few)
    kernel, _ = launch.run_kernel(code, given, carried, jnp.int32(0), None)
    for k in range(3):
        carried, _ = jax.vmap(ticked, (0, 0, None))(given, carried, jnp.int32(k))
    for a, b in zip(kernel, carried, strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-3, atol=1e-3)


def test_what_a_gpu_has_no_rule_for_is_named():
    with jax.enable_x64(True), pytest.raises(UnsupportedPrimitive, match="float64 on a GPU"):
        both(lambda x: {"x": 2 * x}, some(3).astype(jnp.float64))


@pytest.mark.parametrize("few", [pytest.param(False, id="many", marks=pytest.mark.slow), pytest.param(True, id="few")])
def test_a_walk_is_that_of_the_cpu(monkeypatch, few):
    exp = compose(["scenario=walk_tripod", "manoeuvre.steps=1"])
    engine = MjxEngine(replace(exp.settings, width=WIDTH, compiler="fused"), exp.case, exp.case)
    world = replace(exp.case, contact=replace(exp.case.contact, friction=np.linspace(0.1, 1.0, WIDTH)))
    (world, belief, keys), program, *_ = engine._prepare(world, exp.case, np.arange(WIDTH), None, 1, None)
    given, tick = (world, belief, program.make_initial_batch(world, belief, keys)[0]), engine._tick
    _, carry = program.planning(world, belief, keys)
    one = jax.tree.map(lambda x: jax.ShapeDtypeStruct(x.shape[1:] if x.ndim else (), x.dtype), (given, carry))
    code = launch.compile_to_ptx(tick, *one, lambda carry: carry.is_over, 2, WIDTH, WIDTH, small_batch=few)
    gpu, _ = launch.run_kernel(code, given, carry, jnp.int32(0), jnp.arange(WIDTH))
    _, going = program.make_initial_batch(world, belief, keys)
    going.tiles.advance_ticks(0, 2)
    cpu = going.tiles.read_full_state()
    for name, step in (("q", 1e-6), ("v", 1e-3)):
        np.testing.assert_allclose(getattr(gpu.state, name), getattr(cpu.state, name), atol=step, err_msg=name)


@pytest.mark.parametrize("name", ["standing", pytest.param("scene", marks=pytest.mark.slow)])
def test_steps_alone_are_those_of_the_cpu(monkeypatch, name):
    """What `bench/validity` measures on a GPU: a robot whose targets move, and a block beside one."""
    task = precision.standing() if name == "standing" else precision.scene(kick_on_slope())
    case, nominal, q, v, _ = task.own
    given = (np.asarray(x, np.float32) for x in (q, v, task.table[:3]))
    given = (case, nominal, *given, 2e-3, 2, 2)
    cpu = simulation.compile_batch(*given).advance()

    def interpreted(code, operands):
        changed = [operands[k] for k in (2, 4)]
        return jax.pure_callback(lambda *of: ptx.call(code, of), changed, *operands)

    if jax.default_backend() != "gpu":
        monkeypatch.setattr(launch, "call_kernel", interpreted)
        monkeypatch.setattr(jax, "default_backend", lambda: "gpu")
    gpu = simulation.compile_batch(*given).advance()
    assert cpu["q"].shape == (2, 1, q.shape[1])
    for key, step in (("q", 1e-6), ("v", 1e-3), ("normal", 0.05)):
        np.testing.assert_allclose(gpu[key], cpu[key], atol=step, err_msg=key)


@pytest.mark.skipif(jax.default_backend() == "gpu", reason="takes a CPU for a GPU")
def test_few_rollouts_begin_and_end_as_on_a_cpu_and_their_kernel_is_kept_beside_their_program(tmp_path, monkeypatch):
    exp = compose(["scenario=walk_tripod", "manoeuvre.steps=1"])
    launched, translated = [], []

    def ended(chunks):
        engine = MjxEngine(replace(exp.settings, width=2), exp.case, exp.case)
        (world, belief, keys), programs, kept, _ = engine._prepare(exp.case, exp.case, np.arange(2), None, 1, None)
        plans, carry = programs.make_initial_batch(world, belief, keys)
        for _ in range(chunks):
            carry, _ = programs.simulate_chunk(world, belief, plans, carry, 0, kept)
        return programs.compute_batch_metrics(world, plans, carry)

    handler = driver.make_xla_handler(
        lambda call: launched.append(driver.wait_for_kernel(call.key).code)
    )  # changes nothing
    jax.ffi.register_ffi_target("idle", jax.ffi.pycapsule(handler), platform="cpu")
    monkeypatch.setattr(
        launch,
        "call_kernel",
        lambda code, of: driver.call_kernel(driver.start_ptx_translation(code.text), 1, of, [2], "idle"),
    )
    monkeypatch.setattr(driver, "_translate", lambda text: translated.append(text) or b"machine code")
    begun = ended(0)
    monkeypatch.setattr(program_cache, "_folder", lambda: tmp_path)
    monkeypatch.setattr(MjxEngine, "_runs_outside_xla", False)
    monkeypatch.setattr(launch, "XLA_OPTIONS", {})
    for _ in range(2):  # the second finds all there is
        monkeypatch.setattr(driver, "_machine_code", {})
        for name, figure in ended(1).items():
            np.testing.assert_array_equal(figure, begun[name], err_msg=name)
    assert (set(launched), len(translated)) == ({b"machine code"}, 1)
    del handler


@pytest.mark.skipif(jax.default_backend() != "gpu", reason="needs an NVIDIA GPU")
def test_rollouts_on_a_gpu_are_those_of_xla():
    exp = compose(["scenario=walk_tripod", "manoeuvre.steps=2"])
    world = replace(exp.case, contact=replace(exp.case.contact, friction=np.linspace(0.05, 1.0, 20)))

    def figures(compiler):
        return MjxEngine(EngineSettings(width=20, compiler=compiler), exp.case, exp.case).run(
            world, exp.case, np.arange(20)
        )

    fused, xla = figures("fused"), figures("xla")
    for name in ("distance_m", "duration_s", "tilt_max_deg", "torque_peak_alpha_nm"):
        np.testing.assert_allclose(fused[name], xla[name], rtol=0.02, atol=2e-3, err_msg=name)


def test_no_other_device_is_fused_for(monkeypatch):
    monkeypatch.setattr(jax, "default_backend", lambda: "tpu")
    exp = compose(["scenario=walk_tripod"])
    with pytest.raises(InputError, match=r"engine\.compiler = fused is not allowed on a tpu"):
        MjxEngine(EngineSettings(width=1, compiler="fused"), exp.case, exp.case)

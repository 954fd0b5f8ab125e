"""The fused compiler against XLA: single operations, loops and branches, and whole rollouts."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sweep.core.errors import InputError
from sweep.engines.fused import kernel
from sweep.engines.fused.arrays import Unsupported
from sweep.engines.mjx import Mjx
from sweep.engines.native import Native
from sweep.engines.settings import EngineSettings
from sweep.study.config import compose

WIDTH = 5


def both(function, *batch):
    """What `function` of one rollout records for a batch, fused and by XLA."""
    one = [jax.ShapeDtypeStruct(x.shape[1:], x.dtype) for x in batch]
    code = kernel.compiled(lambda given, carried, k: (carried, function(*given)), one, [jnp.zeros(())])
    program = kernel.Kernel(code)
    tiles = program.enter(list(batch), [jnp.zeros(WIDTH)], WIDTH)
    record = tiles.advance(0, 1, np.arange(WIDTH))
    assert record is not None
    return {name: x[0] for name, x in record.items()}, jax.vmap(function)(*batch)


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


def test_random_numbers_are_those_of_jax():
    def drawn(words):
        key = jax.random.wrap_key_data(words)
        first, second = jax.random.split(jax.random.fold_in(key, 7))
        return {"bits": jax.random.bits(first, (3, 2)), "normal": jax.random.normal(second, (4,))}

    fused, xla = both(drawn, jax.random.key_data(jax.random.split(jax.random.key(3), WIDTH)))
    np.testing.assert_array_equal(fused["bits"], xla["bits"])
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


def test_what_has_no_rule_is_named():
    with pytest.raises(Unsupported, match="sort"):
        both(lambda x: {"x": jnp.sort(x)}, some(3))


@pytest.fixture(scope="module")
def walks():
    """A short walk of 20 rollouts on ground from slippery to rough: figures by either compiler."""
    exp = compose(["scenario=walk_tripod", "manoeuvre.steps=2"])
    friction = np.linspace(0.05, 1.0, 20)

    def figures(compiler: str, width: int = 20, pick=slice(None)):
        values = friction[pick]
        world = replace(exp.case, contact=replace(exp.case.contact, friction=values))
        engine = Mjx(EngineSettings(width=width, compiler=compiler), exp.case, exp.case)
        return engine.run(world, exp.case, np.arange(20)[pick])

    return figures


def test_a_rollout_is_that_of_xla_to_round_off(walks):
    fused, xla = walks("fused"), walks("xla")
    for name in ("distance_m", "duration_s", "tilt_max_deg", "torque_peak_alpha_nm"):
        np.testing.assert_allclose(fused[name], xla[name], rtol=0.02, atol=2e-3, err_msg=name)


def test_a_rollouts_bits_depend_neither_on_its_neighbours_nor_on_their_number(walks):
    whole, part = walks("fused"), walks("fused", 3, slice(16, 19))
    for name, values in part.items():
        np.testing.assert_array_equal(values, whole[name][16:19], err_msg=name)


def test_what_cannot_be_fused_is_refused_where_it_was_to_be(monkeypatch):
    monkeypatch.setattr("sweep.engines.fused.interpret.ELEMENTWISE", frozenset())
    exp = compose(["scenario=walk_tripod", "manoeuvre.steps=1"])
    engine = Mjx(EngineSettings(width=1, compiler="fused"), exp.case, exp.case)
    with pytest.raises(InputError, match=r"engine\.compiler = fused is not allowed here: .* no rule for \w+"):
        engine.run(exp.case, exp.case, np.arange(1))
    with pytest.raises(InputError, match=r"not allowed with engine\.dynamics = mjx"):
        EngineSettings(compiler="fused", dynamics="mjx")


def test_under_native_the_controller_is_that_of_xla_which_takes_what_has_no_rule(monkeypatch, capsys):
    exp = compose(["scenario=walk_tripod", "manoeuvre.steps=1", "engine=native"])
    world = replace(exp.case, contact=replace(exp.case.contact, friction=np.array([0.6, 0.8, 1.0])))

    def figures():
        engine = Native(replace(exp.settings, width=3), exp.case, exp.case, exp.thresholds)
        return engine.run(world, exp.case, np.arange(3)), engine.fused

    def without(*_):
        raise Unsupported("sort")

    fused, by_itself = figures()
    monkeypatch.setattr("sweep.engines.fused.kernel.compiled", without)
    monkeypatch.setattr("sweep.engines.program_cache._folder", lambda: None)
    xla, still = figures()
    assert by_itself
    assert not still
    assert "XLA compiles the closed loop: the fused compiler has no rule for sort" in capsys.readouterr().err
    for name in ("distance_m", "duration_s", "tilt_max_deg", "torque_peak_alpha_nm", "energy_j"):
        np.testing.assert_allclose(fused[name], xla[name], rtol=1e-3, atol=1e-4, err_msg=name)


def test_a_robot_that_learns_is_fused_too():
    exp = compose(["scenario=walk_kerb", "manoeuvre.steps=2", "control=learn"])
    world = replace(exp.case, obstacle=replace(exp.case.obstacle, height=np.array([0.095, 0.105])))
    engine = Mjx(EngineSettings(width=2, compiler="fused"), exp.case, exp.case)
    figures = engine.run(world, exp.case, np.arange(2))
    np.testing.assert_allclose(figures["learned_height_m"], [0.095, 0.105], atol=1e-3)

"""Whole rollouts by the fused compiler, against XLA."""

from dataclasses import replace

import numpy as np
import pytest

from sweep.config.experiment import compose
from sweep.contract.engine_settings import EngineSettings
from sweep.core.errors import InputError
from sweep.engines.mjx import MjxEngine
from sweep.engines.native import NativeEngine
from sweep.fused.arrays import UnsupportedPrimitive


@pytest.fixture(scope="module")
def walks():
    """A short walk of 20 rollouts on ground from slippery to rough: figures by either compiler."""
    exp = compose(["scenario=walk_tripod", "manoeuvre.steps=2"])
    friction = np.linspace(0.05, 1.0, 20)

    def figures(compiler: str, width: int = 20, pick=slice(None)):
        values = friction[pick]
        world = replace(exp.case, contact=replace(exp.case.contact, friction=values))
        engine = MjxEngine(EngineSettings(width=width, compiler=compiler), exp.case, exp.case)
        return engine.run(world, exp.case, np.arange(20)[pick])

    return figures


@pytest.mark.slow
def test_a_rollout_is_that_of_xla_to_round_off(walks):
    fused, xla = walks("fused"), walks("xla")
    for name in ("distance_m", "duration_s", "tilt_max_deg", "torque_peak_alpha_nm"):
        np.testing.assert_allclose(fused[name], xla[name], rtol=0.02, atol=2e-3, err_msg=name)


def test_a_rollouts_bits_depend_neither_on_its_neighbours_nor_on_their_number(walks, monkeypatch):
    monkeypatch.setattr("sweep.backends.devices.count_cores", lambda: 1)  # twenty take wide tiles, three a narrow one
    whole, part = walks("fused"), walks("fused", 3, slice(16, 19))
    for name, values in part.items():
        np.testing.assert_array_equal(values, whole[name][16:19], err_msg=name)


def test_what_cannot_be_fused_is_refused_where_it_was_to_be(monkeypatch):
    monkeypatch.setattr("sweep.fused.interpret.ELEMENTWISE", frozenset())
    exp = compose(["scenario=walk_tripod", "manoeuvre.steps=1"])
    engine = MjxEngine(EngineSettings(width=1, compiler="fused"), exp.case, exp.case)
    with pytest.raises(InputError, match=r"engine\.compiler = fused is not allowed here: .* no rule for \w+"):
        engine.run(exp.case, exp.case, np.arange(1))
    with pytest.raises(InputError, match=r"not allowed with engine\.dynamics = mjx"):
        EngineSettings(compiler="fused", dynamics="mjx")


def test_under_native_the_controller_is_that_of_xla_which_takes_what_has_no_rule(monkeypatch, capsys):
    exp = compose(["scenario=walk_tripod", "manoeuvre.steps=1", "engine=native"])
    world = replace(exp.case, contact=replace(exp.case.contact, friction=np.array([0.6, 0.8, 1.0])))

    def figures():
        engine = NativeEngine(replace(exp.settings, width=3), exp.case, exp.case, exp.thresholds)
        return engine.run(world, exp.case, np.arange(3)), engine.fused

    def without(*_, **__):
        raise UnsupportedPrimitive("sort")

    fused, by_itself = figures()
    monkeypatch.setattr("sweep.fused.kernel.start_compilation", without)
    monkeypatch.setattr("sweep.backends.program_cache._folder", lambda: None)
    xla, still = figures()
    assert by_itself
    assert not still
    assert "XLA compiles the closed loop: the fused compiler has no rule for sort" in capsys.readouterr().err
    for name in ("distance_m", "duration_s", "tilt_max_deg", "torque_peak_alpha_nm", "energy_j"):
        np.testing.assert_allclose(fused[name], xla[name], rtol=1e-3, atol=1e-4, err_msg=name)


def test_a_robot_that_learns_is_fused_too():
    exp = compose(["scenario=walk_kerb", "manoeuvre.steps=2", "control=learn"])
    world = replace(exp.case, obstacle=replace(exp.case.obstacle, height=np.array([0.095, 0.105])))
    engine = MjxEngine(EngineSettings(width=2, compiler="fused"), exp.case, exp.case)
    figures = engine.run(world, exp.case, np.arange(2))
    np.testing.assert_allclose(figures["learned_height_m"], [0.095, 0.105], atol=1e-3)

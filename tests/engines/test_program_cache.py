"""Programs kept between processes: found again, made anew where anything differs, never in the way."""

import contextlib
import dataclasses
import os
import subprocess
import sys
import zlib
from concurrent.futures import ThreadPoolExecutor
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from sweep.backends import program_cache
from sweep.config.experiment import compose
from sweep.contract.engine_settings import EngineSettings
from sweep.core import files, provenance
from sweep.core.errors import InputError
from sweep.engines import fused_loop
from sweep.engines.mjx import MjxEngine
from sweep.fused import driver
from sweep.fused.arrays import UnsupportedPrimitive
from sweep.metrics.outcome import OutcomeThresholds

CASE = compose(["scenario=walk_tripod"]).case
X = jnp.arange(3.0)
ONE = jax.devices()[:1]


@contextlib.contextmanager
def setting(**values):
    """JAX's settings, inside."""
    before = {name: getattr(jax.config, name) for name in values}
    for name, value in values.items():
        jax.config.update(name, value)
    try:
        yield
    finally:
        for name, value in before.items():
            jax.config.update(name, value)


@pytest.fixture
def folder(tmp_path):
    """An empty place for kept programs."""
    with setting(jax_compilation_cache_dir=str(tmp_path)):
        yield tmp_path


class Compiler:
    """Compiles x -> factor x, and counts how often."""

    def __init__(self, factor):
        self.factor, self.times = factor, 0

    def __call__(self):
        self.times += 1
        return [jax.jit(lambda x: {"y": self.factor * x}).lower(X).compile()]


def test_what_one_process_compiled_the_next_loads(folder):
    compiler = Compiler(2.0)
    first, again = (program_cache.load_or_compile("two", ONE, compiler)[0](X)["y"] for _ in range(2))
    np.testing.assert_array_equal(first, again)
    np.testing.assert_array_equal(again, 2 * X)
    assert compiler.times == 1


def test_a_program_that_calls_lapack_runs_where_nothing_else_has_called_it(tmp_path):
    code = """if True:
        import sys, jax, jax.numpy as jnp
        from sweep.backends import program_cache
        jax.config.update("jax_compilation_cache_dir", sys.argv[1])
        compiled = lambda: print("anew") or [jax.jit(jnp.linalg.cholesky).lower(jnp.eye(2)).compile()]
        (program,) = program_cache.load_or_compile("cholesky", jax.devices()[:1], compiled)
        print(program(4 * jnp.eye(2))[1, 1])
    """
    run = partial(subprocess.run, [sys.executable, "-c", code, str(tmp_path)], capture_output=True, text=True)
    assert [run(check=True).stdout.split() for _ in range(2)] == [["anew", "2.0"], ["2.0"]]


@pytest.mark.parametrize("change", ["made of", "code", "compiler flags", "JAX's settings", "driver"])
def test_where_anything_differs_it_is_compiled_anew(folder, monkeypatch, change):
    program_cache.load_or_compile("two", ONE, Compiler(2.0))
    if change == "code":
        monkeypatch.setattr(provenance, "program_version", lambda: "another")
    if change == "driver":
        monkeypatch.setattr(driver, "driver_version", lambda: 12090)
    if change == "compiler flags":
        monkeypatch.setenv("XLA_FLAGS", "--xla_cpu_enable_fast_math=true")
    precision = "bfloat16" if change == "JAX's settings" else jax.config.jax_default_matmul_precision
    compiler = Compiler(3.0)
    with setting(jax_default_matmul_precision=precision):
        (program,) = program_cache.load_or_compile("three" if change == "made of" else "two", ONE, compiler)
    np.testing.assert_array_equal(program(X)["y"], 3 * X)
    assert compiler.times == 1


@pytest.mark.parametrize("damage", [b"", b"not a program"])
def test_a_damaged_file_is_replaced(folder, damage):
    program_cache.load_or_compile("two", ONE, Compiler(2.0))
    (file,) = folder.glob("*.programs")
    whole = file.read_bytes()
    file.write_bytes(damage)
    compiler = Compiler(2.0)
    with pytest.warns(RuntimeWarning, match="was not found again"):
        (program,) = program_cache.load_or_compile("two", ONE, compiler)
    np.testing.assert_array_equal(program(X)["y"], 2 * X)
    assert compiler.times == 1
    assert len(file.read_bytes()) == pytest.approx(len(whole), rel=0.05)


def test_a_program_that_is_damaged_within_its_archive_never_reaches_xla(folder, monkeypatch):
    program_cache.load_or_compile("two", ONE, Compiler(2.0))
    (file,) = folder.glob("*.programs")
    whole = file.read_bytes()
    content = bytearray(zlib.decompress(whole[program_cache.DIGEST_SIZE :]))
    content[len(content) // 2] ^= 1
    file.write_bytes(whole[: program_cache.DIGEST_SIZE] + zlib.compress(bytes(content)))
    monkeypatch.setattr(program_cache, "deserialize_and_load", lambda *_, **__: pytest.fail("XLA was given it"))
    compiler = Compiler(2.0)
    with pytest.warns(RuntimeWarning, match="its content has changed"):
        program_cache.load_or_compile("two", ONE, compiler)
    assert compiler.times == 1


def test_a_folder_that_cannot_be_written_is_no_fault(tmp_path):
    (tmp_path / "file").touch()
    with setting(jax_compilation_cache_dir=str(tmp_path / "file")):
        np.testing.assert_array_equal(program_cache.load_or_compile("two", ONE, Compiler(2.0))[0](X)["y"], 2 * X)


def test_a_program_that_cannot_be_kept_runs_and_says_so(folder, monkeypatch):
    def refuse(_):
        raise NotImplementedError("mutable arrays")

    monkeypatch.setattr(program_cache, "serialize", refuse)
    with pytest.warns(RuntimeWarning, match="was not kept: NotImplementedError: mutable arrays"):
        (program,) = program_cache.load_or_compile("two", ONE, Compiler(2.0))
    np.testing.assert_array_equal(program(X)["y"], 2 * X)


def test_two_threads_that_compile_at_once_leave_keeping_as_it_was(folder):
    with ThreadPoolExecutor(2) as pool:
        list(pool.map(lambda k: program_cache.load_or_compile(k, ONE, Compiler(float(k))), (2, 3)))
    assert jax.config.jax_enable_compilation_cache
    assert len(list(folder.glob("*.programs"))) == 2


def test_nothing_is_kept_of_sources_written_since_the_start(folder, monkeypatch):
    monkeypatch.setattr(provenance, "PROCESS_START_S", 0.0)
    program_cache.load_or_compile("two", ONE, Compiler(2.0))
    assert not list(folder.glob("*.programs"))


def made_of(monkeypatch, settings=(), limits=(), case=CASE, vary=False, slots=None) -> str:
    """What an engine says that its programs depend on."""
    asked = []
    none = None, {}, None, None
    engine = MjxEngine(
        EngineSettings(**{"width": 2, "compiler": "xla", **dict(settings)}),
        case,
        case,
        OutcomeThresholds(**dict(limits)),
    )
    world = dataclasses.replace(case, contact=dataclasses.replace(case.contact, friction=np.ones(2) if vary else 1.0))
    with jax.enable_x64(engine.settings.precision == "float64"), monkeypatch.context() as patch:
        patch.setattr(program_cache, "load_or_compile", lambda parts, *_: asked.append(repr(parts)) or none)
        engine._prepare(world, case, np.zeros(2, int), slots, 1, None)
    return asked[0]


def changed(group, **values):
    return dataclasses.replace(CASE, **{group: dataclasses.replace(getattr(CASE, group), **values)})


MJX = {"settings": {"dynamics": "mjx"}}
DIFFERENT = {
    "steps of the solver": {"settings": {"iterations": 3}}, "time step": {"settings": {"time_step": 1e-3}},
    "precision": {"settings": {"precision": "float64"}}, "limits": {"limits": {"tilt_max_deg": 21.0}},
    "dynamics": MJX, "what varies": {"vary": True}, "a recorded slot": {"slots": np.zeros(1, int)},
    "the compiler": {"settings": {"compiler": "fused"}},
    "links": {"case": changed("robot", legs="three_link", coxa=0.05)},
    "noise": {"case": changed("noise", position_noise=1e-3)},
    "length of the walk": {"case": changed("manoeuvre", steps=3)},
    "MJX's own constants": {**MJX, "case": changed("robot", body_mass=11.0)},
}  # fmt: skip


def test_an_engines_programs_depend_on_all_that_shapes_them_and_on_no_swept_number(monkeypatch):
    texts = {name: made_of(monkeypatch, **change) for name, change in DIFFERENT.items()}
    texts["nominal"] = made_of(monkeypatch)
    assert len(set(texts.values())) == len(texts)
    assert made_of(monkeypatch, case=changed("robot", body_mass=11.0)) == texts["nominal"]


def test_what_has_no_rule_is_traced_once(folder, monkeypatch):
    traced = []

    def none(*_):
        traced.append(1)
        raise UnsupportedPrimitive("sort")

    monkeypatch.setattr(MjxEngine, "_compile", fused_loop.catch_unsupported_primitive(none))
    for _ in range(2):
        engine = MjxEngine(EngineSettings(width=1, compiler="fused"), CASE, CASE)
        with pytest.raises(InputError, match="no rule for sort"):
            engine.run(CASE, CASE, np.arange(1))
    assert len(traced) == 1


@pytest.mark.parametrize("what", ["folder", "programs"])
@pytest.mark.parametrize("how", ["others may write it", "another user's"])
def test_what_others_could_have_written_is_not_run(folder, monkeypatch, what, how):
    program_cache.load_or_compile("two", ONE, Compiler(2.0))
    (path,) = [folder] if what == "folder" else folder.glob("*.programs")
    if how == "others may write it":
        path.chmod(0o777)
    elif os.geteuid() == 0:
        os.chown(path, 12345, -1)
    else:
        monkeypatch.setattr(os, "geteuid", lambda: 12345)
    with pytest.raises(InputError, match=path.name):
        program_cache.load_or_compile("two", ONE, Compiler(2.0))


def test_programs_are_kept_in_an_absolute_folder_or_not_at_all(monkeypatch, tmp_path):
    monkeypatch.setenv("HOME", str(tmp_path))
    for given in ("", "here", "./here"):
        monkeypatch.setenv("XDG_CACHE_HOME", given)
        assert files.cache_folder() == tmp_path / ".cache" / "insect-sweep"
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "x"))
    assert files.cache_folder() == tmp_path / "x" / "insect-sweep"
    assert files.ensure_private_folder(tmp_path / "x")
    assert (tmp_path / "x").stat().st_mode & 0o777 == 0o700
    assert not files.ensure_private_folder(tmp_path / ("z" * 300))

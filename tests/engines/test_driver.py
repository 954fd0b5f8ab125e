"""Machine code of a GPU's kernels: linked, kept and launched, with a driver and a launch that are made up."""

import ctypes

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from sweep.backends import program_cache
from sweep.fused import driver
from sweep.fused.arrays import UnsupportedPrimitive

CODE = bytes(range(256)) * 8  # no UTF-8, and zeros in it


def made_up(target, launch):
    """A handler on a CPU, and a program that calls it for three blocks."""
    handler = driver.make_xla_handler(launch)
    jax.ffi.register_ffi_target(target, jax.ffi.pycapsule(handler), platform="cpu")
    given = jnp.zeros((3, 5), jnp.uint32), jnp.int32(7), jnp.zeros((3, len(CODE)), jnp.uint8)

    def program(*operands):
        (state,) = driver.call_kernel("of a kernel", 64, operands, [2], target)
        return state

    return handler, given, lambda: [jax.jit(program).lower(*given).compile()]


def test_a_program_that_is_kept_knows_its_kernel_by_key(tmp_path, monkeypatch):
    calls = []

    def launch(call):
        calls.append((call.stream, call.key, call.blocks, call.threads, len(call.operands)))
        assert ctypes.string_at(call.operands[1], 4) == b"\x07\0\0\0"
        for block in range(call.blocks):
            ctypes.memmove(call.operands[2] + block * len(CODE), CODE, len(CODE))

    monkeypatch.setattr(program_cache, "_folder", lambda: tmp_path)
    handler, given, compiled = made_up("made_up_kernel", launch)
    made = []
    for _ in range(2):  # pyproject.toml makes errors of warnings that a program is not kept
        (program,) = program_cache.load_or_compile("kernel", jax.devices()[:1], lambda: made.append(1) or compiled())
        np.testing.assert_array_equal(program(*given), np.tile(np.frombuffer(CODE, np.uint8), (3, 1)))
    assert made == [1]
    assert calls == [(None, "of a kernel", 3, 64, 3)] * 2
    del handler


def test_what_a_launch_fails_of_is_told():
    def launch(call):
        raise RuntimeError("cuLaunchKernel: CUDA_ERROR_INVALID_IMAGE (200)")

    handler, given, compiled = made_up("failing_kernel", launch)
    with pytest.raises(jax.errors.JaxRuntimeError, match="CUDA_ERROR_INVALID_IMAGE"):
        jax.block_until_ready(compiled()[0](*given))
    del handler


class Driver:
    """Links what ends in `ret;` to `CODE`, in a context that has to be current."""

    def __init__(self):
        self.contexts, self.links = [], 0
        self.code = ctypes.create_string_buffer(CODE, len(CODE))

    def __getattr__(self, name):
        return lambda *given: 0  # which says that all is well

    def cuDevicePrimaryCtxRetain(self, context, device):
        context._obj.value = 77

    def cuDevicePrimaryCtxRelease_v2(self, device):
        assert not self.contexts

    def cuCtxPushCurrent_v2(self, context):
        self.contexts.append(context.value)

    def cuCtxPopCurrent_v2(self, context):
        self.contexts.pop()

    def cuLinkCreate_v2(self, count, options, values, link):
        assert list(options) == [5, 6]
        self.log = values[0]

    def cuLinkAddData_v2(self, link, kind, text, size, *_):
        assert text[-1:] == b"\0"
        assert size.value == len(text)
        if text.endswith(b"ret;\0"):
            return 0
        ctypes.memmove(self.log, b"line 1; error", 13)
        return 218

    def cuLinkComplete(self, link, code, size):
        assert self.contexts == [77]
        code._obj.value, size._obj.value = ctypes.addressof(self.code), len(CODE)


def test_what_the_driver_links_is_its_machine_code_and_what_it_cannot_is_told(monkeypatch):
    made_up = Driver()
    monkeypatch.setattr(driver, "_driver", lambda: made_up)
    assert driver.wait_for_kernel(driver.start_ptx_translation("ret;")) == (driver.kernel_cache_key("ret;"), CODE)
    with pytest.raises(UnsupportedPrimitive, match=r"cuLinkAddData_v2: error \(218\): line 1; error"):
        driver.wait_for_kernel(driver.start_ptx_translation("rat;"))
    assert made_up.contexts == []

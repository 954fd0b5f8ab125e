"""Kernels by NVIDIA's driver: PTX as machine code, once, and its launch from a program of XLA's.

XLA's own call of a kernel keeps it as text: PTX, which the driver translates at every start. Machine code, not being
UTF-8, is lost with the program there. So it is kept beside the program, which a handler of XLA's typed interface
(`xla/ffi/api/c_api.h`) knows it from by its key alone: XLA compiles the one while the driver translates the other.
"""

import ctypes
import functools
import hashlib
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager, suppress
from typing import Any, NamedTuple

import jax
import numpy as np
from jaxtyping import Array

from sweep.fused.arrays import Unsupported

TARGET, PLATFORM = "insect_sweep_kernel", "CUDA"
ENTRY = b"run"  # the kernel of every module
OLDEST = 0, 1  # version of the interface whose structures these are; later ones only add to them
EXECUTE = 3  # the stage of a call in which it is made
PTX = 1  # what the linker is given
INTERNAL = 13  # code of an error
LOG, LOG_SIZE = 5, 6  # options: where it writes what is wrong
Launch = Callable[["Call"], None]


class Call(NamedTuple):
    """One of a kernel, as XLA has it."""

    stream: int | None  # none on a CPU
    key: str
    blocks: int
    threads: int  # of a block
    operands: list[int]  # where they are


class GpuKernel(NamedTuple):
    """A GPU's kernel as machine code, as it is kept."""

    key: str
    code: bytes  # for a machine


class _Metadata(ctypes.Structure):
    _fields_ = [("size", ctypes.c_size_t), ("version_size", ctypes.c_size_t), ("version_next", ctypes.c_void_p),
                ("major", ctypes.c_int), ("minor", ctypes.c_int)]  # fmt: skip


class _Extension(ctypes.Structure):  # the one there is asks for the handler's version
    _fields_ = [("size", ctypes.c_size_t), ("kind", ctypes.c_int), ("next", ctypes.c_void_p),
                ("metadata", ctypes.POINTER(_Metadata))]  # fmt: skip


class _Text(ctypes.Structure):
    _fields_ = [("data", ctypes.c_void_p), ("size", ctypes.c_size_t)]


class _Number(ctypes.Structure):
    _fields_ = [("dtype", ctypes.c_int), ("value", ctypes.POINTER(ctypes.c_int32))]


class _Buffer(ctypes.Structure):
    _fields_ = [("size", ctypes.c_size_t), ("next", ctypes.c_void_p), ("dtype", ctypes.c_int),
                ("data", ctypes.c_void_p), ("rank", ctypes.c_int64),
                ("dims", ctypes.POINTER(ctypes.c_int64))]  # fmt: skip


class _Buffers(ctypes.Structure):
    _fields_ = [("size", ctypes.c_size_t), ("next", ctypes.c_void_p), ("count", ctypes.c_int64),
                ("kinds", ctypes.c_void_p), ("all", ctypes.POINTER(ctypes.POINTER(_Buffer)))]  # fmt: skip


class _Attributes(ctypes.Structure):
    _fields_ = [("size", ctypes.c_size_t), ("next", ctypes.c_void_p), ("count", ctypes.c_int64),
                ("kinds", ctypes.c_void_p), ("names", ctypes.POINTER(ctypes.POINTER(_Text))),
                ("all", ctypes.POINTER(ctypes.c_void_p))]  # fmt: skip


class _ErrorMade(ctypes.Structure):
    _fields_ = [("size", ctypes.c_size_t), ("next", ctypes.c_void_p), ("message", ctypes.c_char_p),
                ("code", ctypes.c_int)]  # fmt: skip


class _StreamGot(ctypes.Structure):
    _fields_ = [("size", ctypes.c_size_t), ("next", ctypes.c_void_p), ("context", ctypes.c_void_p),
                ("stream", ctypes.c_void_p)]  # fmt: skip


class _Api(ctypes.Structure):
    _fields_ = [("size", ctypes.c_size_t), ("next", ctypes.c_void_p), ("version_size", ctypes.c_size_t),
                ("version_next", ctypes.c_void_p), ("major", ctypes.c_int), ("minor", ctypes.c_int),
                ("internal", ctypes.c_void_p),
                ("error", ctypes.CFUNCTYPE(ctypes.c_void_p, ctypes.POINTER(_ErrorMade))),
                ("unused", ctypes.c_void_p * 3),
                ("stream", ctypes.CFUNCTYPE(ctypes.c_void_p, ctypes.POINTER(_StreamGot)))]  # fmt: skip


class _Frame(ctypes.Structure):
    _fields_ = [("size", ctypes.c_size_t), ("extension", ctypes.POINTER(_Extension)), ("api", ctypes.POINTER(_Api)),
                ("context", ctypes.c_void_p), ("stage", ctypes.c_int), ("operands", _Buffers), ("results", _Buffers),
                ("attributes", _Attributes)]  # fmt: skip


def key(text: str) -> str:
    """Of a kernel, from its PTX."""
    return hashlib.blake2b(text.encode(), digest_size=16).hexdigest()


def call(key: str, threads: int, operands: Sequence[Array], changed: Sequence[int], target: str = TARGET) -> Any:
    """The operands `changed` by a kernel, of which the first has a block for each of its rows.

    It has to be there by the time of the call, or begun; see `begin` and `add`.
    """
    kernel = jax.ffi.ffi_call(
        target,
        [jax.ShapeDtypeStruct(operands[k].shape, operands[k].dtype) for k in changed],
        input_output_aliases={k: n for n, k in enumerate(changed)},
    )
    return kernel(*operands, key=key, threads=np.int32(threads))


def handler(launch: Launch) -> Any:
    """What XLA calls, by a pointer, for calls that `launch` makes; it has to be kept."""

    @ctypes.CFUNCTYPE(ctypes.c_void_p, ctypes.POINTER(_Frame))
    def called(at: Any) -> int | None:
        frame = at.contents
        if frame.extension:
            told = frame.extension.contents.metadata.contents
            told.major, told.minor = OLDEST
            return None
        try:
            _called(frame, launch)
        except Exception as error:
            made = _ErrorMade(ctypes.sizeof(_ErrorMade), None, f"{type(error).__name__}: {error}".encode(), INTERNAL)
            return frame.api.contents.error(made)
        return None

    return called


def _called(frame: _Frame, launch: Launch) -> None:
    if frame.stage != EXECUTE:
        return
    values = frame.attributes
    found = {_read(values.names[k].contents): values.all[k] for k in range(values.count)}
    key = _Text.from_address(found[b"key"])
    threads = _Number.from_address(found[b"threads"]).value[0]
    operands = [frame.operands.all[k].contents for k in range(frame.operands.count)]
    got = _StreamGot(ctypes.sizeof(_StreamGot), None, frame.context, None)
    stream = None if frame.api.contents.stream(got) else got.stream
    blocks, places = operands[0].dims[0], [x.data for x in operands]
    launch(Call(stream, _read(key).decode(), blocks, threads, places))


def _read(text: _Text) -> bytes:
    return ctypes.string_at(text.data, text.size)


def version() -> int:
    """The driver's, 0 without one: older ones may not take the machine code of this one."""
    found = ctypes.c_int(0)
    with suppress(OSError):
        _do("cuDriverGetVersion", ctypes.byref(found))
    return found.value


def start_translation(text: str) -> str:
    """Have PTX translated in a thread; its key."""
    if (name := key(text)) not in _made:
        _made[name] = _pool.submit(_translated, text)
    return name


def finished_kernel(name: str) -> GpuKernel:
    """What has been translated. Raises `Unsupported` with what is wrong."""
    return GpuKernel(name, _made[name].result())


def add_kernel(kernel: GpuKernel) -> None:
    """Have it at hand for calls, as it was kept."""
    _made[kernel.key] = done = Future()
    done.set_result(kernel.code)


def _translated(text: str) -> bytes:
    """PTX as machine code of the GPU that programs are made for."""
    device, context, link, made = ctypes.c_int(), ctypes.c_void_p(), ctypes.c_void_p(), ctypes.c_void_p()
    size, log, given = ctypes.c_size_t(), ctypes.create_string_buffer(4096), text.encode() + b"\0"
    options, values = (ctypes.c_int * 2)(LOG, LOG_SIZE), (ctypes.c_void_p * 2)(ctypes.addressof(log), len(log))
    _do("cuDeviceGet", ctypes.byref(device), jax.devices()[0].local_hardware_id or 0)
    _do("cuDevicePrimaryCtxRetain", ctypes.byref(context), device)  # which is XLA's
    try:
        with _current(context):
            _do("cuLinkCreate_v2", 2, options, values, ctypes.byref(link))
            _do("cuLinkAddData_v2", link, PTX, given, ctypes.c_size_t(len(given)), b"kernel", 0, None, None)
            _do("cuLinkComplete", link, ctypes.byref(made), ctypes.byref(size))
            code = ctypes.string_at(made, size.value)
            _do("cuLinkDestroy", link)
            return code
    except RuntimeError as error:
        raise Unsupported(f"{error}: {log.value.decode(errors='replace').strip()}") from None
    finally:
        _do("cuDevicePrimaryCtxRelease_v2", device)


def _launched(call: Call) -> None:
    if call.stream is None:
        raise RuntimeError("no stream")
    stream, context = ctypes.c_void_p(call.stream), ctypes.c_void_p()
    _do("cuStreamGetCtx", stream, ctypes.byref(context))
    places = [ctypes.c_void_p(x) for x in call.operands]
    operands = (ctypes.c_void_p * len(places))(*map(ctypes.addressof, places))
    size = [ctypes.c_uint(x) for x in (call.blocks, 1, 1, call.threads, 1, 1, 0)]
    with _current(context):
        at = context.value, call.key
        if at not in _loaded:
            module, kernel = ctypes.c_void_p(), ctypes.c_void_p()
            _do("cuModuleLoadData", ctypes.byref(module), finished_kernel(call.key).code)
            _do("cuModuleGetFunction", ctypes.byref(kernel), module, ENTRY)
            _loaded[at] = kernel
        _do("cuLaunchKernel", _loaded[at], *size, stream, operands, None)


@contextmanager
def _current(context: ctypes.c_void_p) -> Iterator[None]:
    """Inside, the driver's calls of this thread are of `context`."""
    _do("cuCtxPushCurrent_v2", context)
    try:
        yield
    finally:
        _do("cuCtxPopCurrent_v2", ctypes.byref(ctypes.c_void_p()))


@functools.cache
def _driver() -> ctypes.CDLL:
    return ctypes.CDLL("libcuda.so.1")


def _do(name: str, *given: Any) -> None:
    """A call of the driver's. Raises RuntimeError where it fails, OSError where there is none."""
    if failed := getattr(_driver(), name)(*given):
        told = ctypes.c_char_p()
        _driver().cuGetErrorName(failed, ctypes.byref(told))
        raise RuntimeError(f"{name}: {(told.value or b'error').decode()} ({failed})")


_pool = ThreadPoolExecutor(1)
_made: dict[str, Future[bytes]] = {}  # machine code, by key
_loaded: dict[tuple[int | None, str], ctypes.c_void_p] = {}  # kernels, by context and key
_handler = handler(_launched)
jax.ffi.register_ffi_target(TARGET, jax.ffi.pycapsule(_handler), platform=PLATFORM)

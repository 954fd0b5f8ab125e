"""Interface to NVIDIA's driver: translates PTX to machine code, and launches kernels from XLA programs.

XLA's own call of a kernel keeps its PTX text, which the driver translates at every start; machine code, which is not
UTF-8, is lost when XLA serialises the program. So the machine code is stored beside the program. A handler of XLA's
typed interface (`xla/ffi/api/c_api.h`) finds it by its key. XLA compiles the program while the driver translates.
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

from sweep.fused.arrays import UnsupportedPrimitive

CALL_TARGET, PLATFORM = "insect_sweep_kernel", "CUDA"
KERNEL_NAME = b"run"  # name of the kernel in every module
API_VERSION = 0, 1  # version of XLA's interface with these structures; later ones only append to them
EXECUTE_STAGE = 3  # stage of a call in which the handler does its work
LINKER_INPUT_PTX = 1  # type of the linker's input
INTERNAL_ERROR_CODE = 13  # XLA's code of an internal error
LINKER_LOG_OPTION, LINKER_LOG_SIZE_OPTION = 5, 6  # the linker's options for its error log
LaunchFunction = Callable[["KernelCall"], None]


class KernelCall(NamedTuple):
    """One launch of a GPU kernel, as XLA passes it to the handler."""

    stream: int | None  # None on a CPU
    key: str
    blocks: int
    threads: int  # threads of a block
    operands: list[int]  # their addresses


class GpuKernel(NamedTuple):
    """Machine code of a GPU kernel as the cache stores it."""

    key: str
    code: bytes  # machine code


class _Metadata(ctypes.Structure):
    _fields_ = [("size", ctypes.c_size_t), ("version_size", ctypes.c_size_t), ("version_next", ctypes.c_void_p),
                ("major", ctypes.c_int), ("minor", ctypes.c_int)]  # fmt: skip


class _Extension(ctypes.Structure):  # the only extension asks for the handler's version
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


def kernel_cache_key(text: str) -> str:
    """Return the cache key of a kernel, the hash of its PTX."""
    return hashlib.blake2b(text.encode(), digest_size=16).hexdigest()


def call_kernel(
    key: str, threads: int, operands: Sequence[Array], changed: Sequence[int], target: str = CALL_TARGET
) -> Any:
    """Launch a kernel that changes some of its operands in place, within a function that XLA compiles.

    By the time of the call the kernel has to be added (`register_kernel`), or its translation has to be started
    (`start_ptx_translation`).

    Args:
        key: key of the kernel.
        threads: threads of a block; the first operand has a block in each row.
        operands: arrays that the kernel gets.
        changed: indices of the operands that it changes.
        target: name of the handler.

    Returns:
        The changed operands.
    """
    kernel = jax.ffi.ffi_call(
        target,
        [jax.ShapeDtypeStruct(operands[k].shape, operands[k].dtype) for k in changed],
        input_output_aliases={k: n for n, k in enumerate(changed)},
    )
    return kernel(*operands, key=key, threads=np.int32(threads))


def make_xla_handler(launch: LaunchFunction) -> Any:
    """Make a function pointer through which XLA calls `launch`; the returned object must be kept alive."""

    @ctypes.CFUNCTYPE(ctypes.c_void_p, ctypes.POINTER(_Frame))
    def handle_call(address: Any) -> int | None:
        frame = address.contents
        if frame.extension:
            told = frame.extension.contents.metadata.contents
            told.major, told.minor = API_VERSION
            return None
        try:
            _handle_call(frame, launch)
        except Exception as error:
            made = _ErrorMade(
                ctypes.sizeof(_ErrorMade), None, f"{type(error).__name__}: {error}".encode(), INTERNAL_ERROR_CODE
            )
            return frame.api.contents.error(made)
        return None

    return handle_call


def _handle_call(frame: _Frame, launch: LaunchFunction) -> None:
    if frame.stage != EXECUTE_STAGE:
        return
    values = frame.attributes
    found = {_read(values.names[k].contents): values.all[k] for k in range(values.count)}
    key = _Text.from_address(found[b"key"])
    threads = _Number.from_address(found[b"threads"]).value[0]
    operands = [frame.operands.all[k].contents for k in range(frame.operands.count)]
    got = _StreamGot(ctypes.sizeof(_StreamGot), None, frame.context, None)
    stream = None if frame.api.contents.stream(got) else got.stream
    blocks, places = operands[0].dims[0], [x.data for x in operands]
    launch(KernelCall(stream, _read(key).decode(), blocks, threads, places))


def _read(text: _Text) -> bytes:
    return ctypes.string_at(text.data, text.size)


def driver_version() -> int:
    """Return the version of NVIDIA's driver, 0 if there is none."""
    found = ctypes.c_int(0)
    with suppress(OSError):
        _call_driver("cuDriverGetVersion", ctypes.byref(found))
    return found.value


def start_ptx_translation(text: str) -> str:
    """Start to translate PTX to machine code in a thread, and return the key of the kernel."""
    if (name := kernel_cache_key(text)) not in _machine_code:
        _machine_code[name] = _pool.submit(_translate, text)
    return name


def wait_for_kernel(name: str) -> GpuKernel:
    """Wait until a kernel is translated from PTX. Raises `UnsupportedPrimitive` with the driver's message on error."""
    return GpuKernel(name, _machine_code[name].result())


def register_kernel(kernel: GpuKernel) -> None:
    """Register a kernel that was loaded from the cache, so that programs can call it."""
    _machine_code[kernel.key] = done = Future()
    done.set_result(kernel.code)


def _translate(text: str) -> bytes:
    """Translate PTX to machine code of the GPU that programs are compiled for."""
    device, context, link, made = ctypes.c_int(), ctypes.c_void_p(), ctypes.c_void_p(), ctypes.c_void_p()
    size, log, given = ctypes.c_size_t(), ctypes.create_string_buffer(4096), text.encode() + b"\0"
    options, values = (
        (ctypes.c_int * 2)(LINKER_LOG_OPTION, LINKER_LOG_SIZE_OPTION),
        (ctypes.c_void_p * 2)(ctypes.addressof(log), len(log)),
    )
    _call_driver("cuDeviceGet", ctypes.byref(device), jax.devices()[0].local_hardware_id or 0)
    _call_driver("cuDevicePrimaryCtxRetain", ctypes.byref(context), device)  # XLA's context
    try:
        with _use_context(context):
            _call_driver("cuLinkCreate_v2", 2, options, values, ctypes.byref(link))
            _call_driver(
                "cuLinkAddData_v2", link, LINKER_INPUT_PTX, given, ctypes.c_size_t(len(given)), b"kernel", 0, None, None
            )
            _call_driver("cuLinkComplete", link, ctypes.byref(made), ctypes.byref(size))
            code = ctypes.string_at(made, size.value)
            _call_driver("cuLinkDestroy", link)
            return code
    except RuntimeError as error:
        raise UnsupportedPrimitive(f"{error}: {log.value.decode(errors='replace').strip()}") from None
    finally:
        _call_driver("cuDevicePrimaryCtxRelease_v2", device)


def _launch(call: KernelCall) -> None:
    if call.stream is None:
        raise RuntimeError("no stream")
    stream, context = ctypes.c_void_p(call.stream), ctypes.c_void_p()
    _call_driver("cuStreamGetCtx", stream, ctypes.byref(context))
    places = [ctypes.c_void_p(x) for x in call.operands]
    operands = (ctypes.c_void_p * len(places))(*map(ctypes.addressof, places))
    size = [ctypes.c_uint(x) for x in (call.blocks, 1, 1, call.threads, 1, 1, 0)]
    with _use_context(context):
        at = context.value, call.key
        if at not in _loaded:
            module, kernel = ctypes.c_void_p(), ctypes.c_void_p()
            _call_driver("cuModuleLoadData", ctypes.byref(module), wait_for_kernel(call.key).code)
            _call_driver("cuModuleGetFunction", ctypes.byref(kernel), module, KERNEL_NAME)
            _loaded[at] = kernel
        _call_driver("cuLaunchKernel", _loaded[at], *size, stream, operands, None)


@contextmanager
def _use_context(context: ctypes.c_void_p) -> Iterator[None]:
    """Context in which this thread's calls of the driver use the CUDA context `context`."""
    _call_driver("cuCtxPushCurrent_v2", context)
    try:
        yield
    finally:
        _call_driver("cuCtxPopCurrent_v2", ctypes.byref(ctypes.c_void_p()))


@functools.cache
def _driver() -> ctypes.CDLL:
    return ctypes.CDLL("libcuda.so.1")


def _call_driver(name: str, *args: Any) -> None:
    """Call a function of the driver. Raises RuntimeError if it fails, and OSError if there is no driver."""
    if failed := getattr(_driver(), name)(*args):
        told = ctypes.c_char_p()
        _driver().cuGetErrorName(failed, ctypes.byref(told))
        raise RuntimeError(f"{name}: {(told.value or b'error').decode()} ({failed})")


_pool = ThreadPoolExecutor(1)
_machine_code: dict[str, Future[bytes]] = {}  # machine code, by key
_loaded: dict[tuple[int | None, str], ctypes.c_void_p] = {}  # kernels, by context and key
_handler = make_xla_handler(_launch)
jax.ffi.register_ffi_target(CALL_TARGET, jax.ffi.pycapsule(_handler), platform=PLATFORM)

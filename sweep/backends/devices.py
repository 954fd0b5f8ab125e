"""The devices of a batch: set-up, precision, batch axes, and how arrays are sharded."""

import contextlib
import glob
import os
import sys
from collections.abc import Callable, Iterator, Sequence
from importlib.util import find_spec
from threading import Thread
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import NamedSharding, PartitionSpec
from jax.stages import Compiled
from jaxtyping import Array

from sweep.contract.engine_settings import EngineSettings
from sweep.core import files
from sweep.core.errors import InputError
from sweep.fused.cores import count_cores

BATCH_MESH_AXIS = "batch"
NEVER_REUSE = 1 << 40
CPU_WIDTH, GPU_WIDTH = 256, 131072  # rollouts at which a device is fastest, if its memory holds them
NATIVE_WIDTH = 64  # for C MuJoCo
NUMPY_WIDTH = 256  # largest batch whose plans and metrics NumPy computes before a GPU's compiler has begun
PLANNING_WIDTH = 1024  # rollouts that plan at a time on a GPU; planning with calibration takes 6 MiB each
NVIDIA_DEVICE_FILES = "/dev/nvidia[0-9]*"
GPU_ROLLOUT_BYTES = 64 << 10  # generous: 10 to 31 KiB were measured
_precision_of_user_code: list[str] = []  # in which it was last traced in this process


def configure_jax() -> None:
    """Configure JAX for this process: exact matrix products, and a persistent compilation cache.

    Raises:
        InputError: Other users can write to the cache's folder.
    """
    jax.config.update("jax_default_matmul_precision", "highest")  # with TF32 the robot sinks and the solver drifts
    if jax.__version_info__ < (0, 12):  # its newer partitioner crashes on programs for several devices
        jax.config.update("jax_use_shardy_partitioner", False)
    folder = files.cache_folder() if jax.config.jax_compilation_cache_dir is None else None
    if folder and files.ensure_private_folder(folder):
        jax.config.update("jax_compilation_cache_dir", str(folder))
    if "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS" not in os.environ:
        jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)  # cache small programs, too
    with contextlib.suppress(RuntimeError):  # too late if JAX is in use already
        jax.config.update("jax_num_cpu_devices", count_cores())


def search_devices_in_background() -> None:
    """Let JAX search for devices in a thread, which takes most of a second on a GPU; the first user of a device sees
    errors."""
    configure_jax()

    def found() -> None:
        with contextlib.suppress(RuntimeError):
            jax.devices()

    Thread(target=found).start()


def would_use_gpu() -> bool:
    """Whether JAX would use an NVIDIA GPU of this machine by default, found out without starting CUDA."""
    return not jax.config.jax_platforms and bool(find_spec("jax_plugins")) and bool(glob.glob(NVIDIA_DEVICE_FILES))


def prefer_cpu(reason: str) -> None:
    """Keep JAX, before it searches for devices, from using a GPU by default. A line on standard error says why."""
    if would_use_gpu():
        jax.config.update("jax_platforms", "cpu")
        print(f"sweep: on the CPU, {reason} (set JAX_PLATFORMS=cuda,cpu to use the GPU)", file=sys.stderr)


@contextlib.contextmanager
def convert_memory_errors() -> Iterator[None]:
    """Raise a `MemoryError` in place of a device's out-of-memory error within this context."""
    try:
        yield
    except jax.errors.JaxRuntimeError as error:
        if "RESOURCE_EXHAUSTED" not in str(error):
            raise
        raise MemoryError(str(error).splitlines()[0]) from None


def precision_context(settings: EngineSettings) -> contextlib.AbstractContextManager:
    """Context that enables double precision in JAX if the engine settings ask for it."""
    return jax.enable_x64(settings.precision == "float64")


def forget_constants_of_other_precision(precision: str) -> None:
    """Clear JAX's caches if user code was last traced in another precision.

    JAX knows a NumPy array by its identity: one that a controller, or a network, holds as a constant would keep the
    precision in which it was first traced, and the next program would not compile.

    Args:
        precision: `float32` or `float64`, in which user code is traced next.
    """
    if _precision_of_user_code not in ([], [precision]):
        jax.clear_caches()
    _precision_of_user_code[:] = [precision]


def cpu_context() -> contextlib.AbstractContextManager:
    """Context in which JAX's default device is the CPU. Raises `InputError` if JAX has none."""
    try:
        return jax.default_device(jax.local_devices(backend="cpu")[0])
    except RuntimeError:
        raise InputError("engine.name = native needs JAX's CPU: set JAX_PLATFORMS=cuda,cpu") from None


def recomputation_cost_threshold() -> int:
    """Return the cost above which `batch_last_vmap` stores a value instead of recomputing it; on a GPU never."""
    return 8 if jax.default_backend() == "cpu" else NEVER_REUSE


def run_program(program: Compiled, *args: Any) -> Any:
    """Distribute arguments over the devices for which a program was compiled, then run it.

    Args:
        program: the compiled program.
        args: its arguments, trees of arrays.
    """
    return program(*jax.device_put(args, program.input_shardings[0]))


def planning_compiler_options(forces: bool) -> dict[str, Any]:
    """Return XLA compiler options for programs that compute plans; plans with foot forces need other options.

    A plan runs once for each batch, so autotuning, 14 s on a GPU, does not pay. Fused, XLA computes a plan again among
    its forces, and gave two stages of a ladder the forces of wrong poses; unfused they are right.
    """
    if jax.default_backend() != "gpu":
        return {}
    apart = {"xla_disable_hlo_passes": "fusion,multi_output_fusion,priority-fusion"} if forces else {}
    return {"xla_gpu_autotune_level": 0, **apart}


def default_batch_width() -> int:
    """Default number of rollouts of a batch over all devices.

    An accelerator gets as many as fill its memory, up to where its speed levels off; a CPU as many as fit its caches.
    """
    if jax.default_backend() == "cpu":
        return jax.device_count() * CPU_WIDTH
    room = min((device.memory_stats() or {}).get("bytes_limit", 1 << 40) for device in jax.devices())
    return jax.device_count() * max(1, min(GPU_WIDTH, room // GPU_ROLLOUT_BYTES))


def make_mesh(width: int) -> jax.sharding.Mesh:
    """Make the JAX device mesh for a batch: all devices if their number divides `width`, else a single device."""
    devices = jax.devices() if width % jax.device_count() == 0 else jax.devices()[:1]
    return jax.make_mesh((len(devices),), (BATCH_MESH_AXIS,), (jax.sharding.AxisType.Auto,), devices=devices)


def partition_specs(tree: Any) -> Any:
    """Return the partition spec of each leaf of a tree: split over devices along its batch axis, or replicated without
    one."""
    return jax.tree.map(lambda x: PartitionSpec(BATCH_MESH_AXIS) if np.ndim(x) else PartitionSpec(), tree)


def vmap_in_chunks(function: Callable[..., Any], width: int) -> Callable[..., Any]:
    """Batch a function like `jax.vmap`, in chunks, which take less memory than the whole batch at once.

    Args:
        function: function of one rollout.
        width: number of rollouts; arguments without axes are shared by all of them.
    """
    turn = next((k for k in range(min(width, PLANNING_WIDTH), PLANNING_WIDTH // 8, -1) if width % k == 0), width)

    def batched(*args: Any) -> Any:
        leaves, tree = jax.tree.flatten(args)
        differ = [k for k, x in enumerate(leaves) if jnp.ndim(x)]

        def one(rows: Sequence[Array]) -> Any:
            given = dict(zip(differ, rows, strict=True))
            return function(*jax.tree.unflatten(tree, [given.get(k, x) for k, x in enumerate(leaves)]))

        # not by map's batch_size, which does not allow empty arrays
        own = [leaves[k].reshape(width // turn, turn, *leaves[k].shape[1:]) for k in differ]
        return jax.tree.map(lambda x: x.reshape(width, *x.shape[2:]), jax.lax.map(jax.vmap(one), own))

    return batched


def shard_leaves(tree: Any, over: jax.sharding.Mesh) -> Any:
    """Put leaves on the devices as JAX arrays, sharded by `partition_specs`.

    Args:
        tree: numbers or arrays over the batch.
        over: the mesh.
    """
    return jax.tree.map(lambda x, spec: jax.device_put(x, NamedSharding(over, spec)), tree, partition_specs(tree))


def sharded_shapes(tree: Any, over: jax.sharding.Mesh) -> Any:
    """Return the shapes and shardings of a tree of arrays that all have a batch axis.

    Args:
        tree: arrays or shapes.
        over: the mesh.
    """
    parts, whole = NamedSharding(over, PartitionSpec(BATCH_MESH_AXIS)), NamedSharding(over, PartitionSpec())

    def laid_out(x: Any) -> jax.ShapeDtypeStruct:  # XLA does not shard empty arrays
        return jax.ShapeDtypeStruct(x.shape, x.dtype, sharding=parts if np.prod(x.shape) else whole)

    return jax.tree.map(laid_out, tree)


def put_on_devices(tree: Any, over: jax.sharding.Mesh) -> Any:
    """Put arrays of a batch on the devices, sharded as in `sharded_shapes`.

    Args:
        tree: arrays that all have a batch axis.
        over: the mesh.
    """
    return jax.device_put(tree, jax.tree.map(lambda x: x.sharding, sharded_shapes(tree, over)))


def vmap_in_axes(tree: Any) -> Any:
    """Return `in_axes` for `jax.vmap`: 0 for leaves of a tree that have a batch axis, None for the others."""
    return jax.tree.map(lambda x: 0 if np.ndim(x) else None, tree)


def program_signature(tree: Any) -> Any:
    """Return everything in `tree` that a compiled program depends on: static values, and which leaves have a batch
    axis."""
    return jax.tree.structure(tree), tuple(bool(np.ndim(leaf)) for leaf in jax.tree.leaves(tree))


def to_jax_arrays(tree: Any) -> Any:
    """Convert leaves to JAX arrays of the default float type.

    Numbers too large for it become infinite, which makes their row invalid.
    """
    with np.errstate(over="ignore"):
        return jax.tree.map(lambda x: jnp.asarray(x, float), tree)


def noise_keys(streams: np.ndarray) -> Array:
    """Return a random key for each rollout, derived only from the number of its noise stream (random sequence)."""
    return _keys(np.uint32(streams & 0xFFFFFFFF), np.uint32(np.int64(streams) >> 32))


@jax.jit  # one program to load instead of four
def _keys(low: Array, high: Array) -> Array:
    root = jax.random.key(0)
    return jax.vmap(lambda a, b: jax.random.fold_in(jax.random.fold_in(root, a), b))(low, high)

"""The devices a batch runs on: set-up, precision, batch axes, and how arrays are spread."""

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

from sweep.core import files
from sweep.core.errors import InputError
from sweep.engines.settings import EngineSettings

BATCH = "batch"
NEVER = 1 << 40
CPU_WIDTH, GPU_WIDTH = 256, 131072  # a device's best number of rollouts, where its memory holds them
NATIVE_WIDTH = 64  # of C MuJoCo
FEW = 256  # rollouts that NumPy plans for, and works figures out of, before a GPU's compiler has begun
PLANNED = 1024  # rollouts that plan at a time on a GPU: one that learns takes 6 MiB for it
GPUS = "/dev/nvidia[0-9]*"
GPU_ROLLOUT = 64 << 10  # bytes of a rollout on a GPU with room to spare: 10 to 31 KiB were measured


def configure() -> None:
    """Process-wide choices of JAX: exact matrix products, and compiled programs kept between processes.

    Raises `InputError` where others can write to the folder of the programs.
    """
    jax.config.update("jax_default_matmul_precision", "highest")  # TF32 lets the robot sink and the solver wander
    if jax.__version_info__ < (0, 12):  # its newer partitioner crashes on programs for several devices
        jax.config.update("jax_use_shardy_partitioner", False)
    folder = files.cache_folder() if jax.config.jax_compilation_cache_dir is None else None
    if folder and files.ensure_private_folder(folder):
        jax.config.update("jax_compilation_cache_dir", str(folder))
    if "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS" not in os.environ:
        jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)  # small ones, too
    with contextlib.suppress(RuntimeError):  # too late where JAX was used before
        jax.config.update("jax_num_cpu_devices", cores())


def cores() -> int:
    """Of this machine, as many as this process may use."""
    return len(os.sched_getaffinity(0))


def begin() -> None:
    """Have JAX find its devices in a thread, which for a GPU takes most of a second; errors wait for who asks next."""
    configure()

    def found() -> None:
        with contextlib.suppress(RuntimeError):
            jax.devices()

    Thread(target=found).start()


def gpu_is_taken() -> bool:
    """Whether JAX, told nothing, takes an NVIDIA GPU of this machine, found without starting CUDA."""
    return not jax.config.jax_platforms and bool(find_spec("jax_plugins")) and bool(glob.glob(GPUS))


def prefer_cpu(why: str) -> None:
    """Keep JAX, before it looks for devices, from a GPU that it would take unasked; a line says so and `why`."""
    if gpu_is_taken():
        jax.config.update("jax_platforms", "cpu")
        print(f"sweep: on the CPU, {why} (JAX_PLATFORMS=cuda,cpu takes the GPU)", file=sys.stderr)


@contextlib.contextmanager
def memory() -> Iterator[None]:
    """A device's lack of memory, inside, as a `MemoryError`."""
    try:
        yield
    except jax.errors.JaxRuntimeError as error:
        if "RESOURCE_EXHAUSTED" not in str(error):
            raise
        raise MemoryError(str(error).splitlines()[0]) from None


def precision(settings: EngineSettings) -> contextlib.AbstractContextManager:
    """Double precision where asked for, for the calls inside."""
    return jax.enable_x64(settings.precision == "float64")


def on_cpu() -> contextlib.AbstractContextManager:
    """The CPU, for JAX's calls inside, whatever its default device is. Raises `InputError` where JAX has none."""
    try:
        return jax.default_device(jax.local_devices(backend="cpu")[0])
    except RuntimeError:
        raise InputError("engine.name = native needs JAX's CPU: as JAX_PLATFORMS=cuda,cpu") from None


def reuse_from() -> int:
    """From how many operations on a value used again is kept by `batch_last_vmap`: a GPU's compiler knows itself."""
    return 8 if jax.default_backend() == "cpu" else NEVER


def run(program: Compiled, *given: Any) -> Any:
    """What a program gives, of arrays that are spread over the devices as it was compiled for."""
    return program(*jax.device_put(given, program.input_shardings[0]))


def plan_options(forces: bool) -> dict[str, Any]:
    """How plans are compiled, with `forces` or without.

    Once run, they are not worth the 14 s that a GPU's compiler takes to time one variant. What it fuses works a plan
    out anew among its forces, and gave two stages of a ladder those of wrong poses; unfused they are right.
    """
    if jax.default_backend() != "gpu":
        return {}
    apart = {"xla_disable_hlo_passes": "fusion,multi_output_fusion,priority-fusion"} if forces else {}
    return {"xla_gpu_autotune_level": 0, **apart}


def default_width() -> int:
    """Rollouts of a batch over all devices: as many as an accelerator's memory holds, up to where its speed levels off.

    On a CPU few enough for its caches.
    """
    if jax.default_backend() == "cpu":
        return jax.device_count() * CPU_WIDTH
    room = min((device.memory_stats() or {}).get("bytes_limit", 1 << 40) for device in jax.devices())
    return jax.device_count() * max(1, min(GPU_WIDTH, room // GPU_ROLLOUT))


def mesh(width: int) -> jax.sharding.Mesh:
    """The devices that share a batch of `width`: all of them where it divides evenly, else one."""
    devices = jax.devices() if width % jax.device_count() == 0 else jax.devices()[:1]
    return jax.make_mesh((len(devices),), (BATCH,), (jax.sharding.AxisType.Auto,), devices=devices)


def specs(tree: Any) -> Any:
    """How each leaf of `tree` lies on the mesh: split where it varies over the batch, else on every device."""
    return jax.tree.map(lambda x: PartitionSpec(BATCH) if np.ndim(x) else PartitionSpec(), tree)


def in_turns(function: Callable[..., Any], width: int) -> Callable[..., Any]:
    """`function` of a rollout for `width` of them, as many at a time as planning has memory for.

    Arguments without axes are the same for all.
    """
    turn = next((k for k in range(min(width, PLANNED), PLANNED // 8, -1) if width % k == 0), width)

    def batched(*args: Any) -> Any:
        leaves, tree = jax.tree.flatten(args)
        differ = [k for k, x in enumerate(leaves) if jnp.ndim(x)]

        def one(own: Sequence[Array]) -> Any:
            given = dict(zip(differ, own, strict=True))
            return function(*jax.tree.unflatten(tree, [given.get(k, x) for k, x in enumerate(leaves)]))

        # by hand, as map's own batches may hold no empty arrays
        own = [leaves[k].reshape(width // turn, turn, *leaves[k].shape[1:]) for k in differ]
        return jax.tree.map(lambda x: x.reshape(width, *x.shape[2:]), jax.lax.map(jax.vmap(one), own))

    return batched


def spread(tree: Any, over: jax.sharding.Mesh) -> Any:
    """Leaves as JAX arrays, laid out on the mesh by `specs`."""
    return jax.tree.map(lambda x, spec: jax.device_put(x, NamedSharding(over, spec)), tree, specs(tree))


def split(tree: Any, over: jax.sharding.Mesh) -> Any:
    """The form of arrays like those of `tree`, which all vary over the batch, split over the mesh."""
    parts, whole = NamedSharding(over, PartitionSpec(BATCH)), NamedSharding(over, PartitionSpec())

    def laid_out(x: Any) -> jax.ShapeDtypeStruct:  # the compiler leaves empty arrays whole
        return jax.ShapeDtypeStruct(x.shape, x.dtype, sharding=parts if np.prod(x.shape) else whole)

    return jax.tree.map(laid_out, tree)


def put_on_devices(tree: Any, over: jax.sharding.Mesh) -> Any:
    """Arrays of a batch, laid out as `split` has them."""
    return jax.device_put(tree, jax.tree.map(lambda x: x.sharding, split(tree, over)))


def axes(tree: Any) -> Any:
    """The same tree with 0 at leaves that vary over the batch, None elsewhere."""
    return jax.tree.map(lambda x: 0 if np.ndim(x) else None, tree)


def form(tree: Any) -> Any:
    """What a compiled program depends on in `tree`: its static values, and which leaves vary over the batch."""
    return jax.tree.structure(tree), tuple(bool(np.ndim(leaf)) for leaf in jax.tree.leaves(tree))


def as_arrays(tree: Any) -> Any:
    """Leaves as JAX arrays of the default float type; what is too large for it becomes infinite, its row invalid."""
    with np.errstate(over="ignore"):
        return jax.tree.map(lambda x: jnp.asarray(x, float), tree)


def keys(streams: np.ndarray) -> Array:
    """A noise key per rollout, from its stream number alone."""
    return _keys(np.uint32(streams & 0xFFFFFFFF), np.uint32(np.int64(streams) >> 32))


@jax.jit  # one program to load at a start, in place of four
def _keys(low: Array, high: Array) -> Array:
    root = jax.random.key(0)
    return jax.vmap(lambda a, b: jax.random.fold_in(jax.random.fold_in(root, a), b))(low, high)

"""What engines share in handling batches: batch axes, keys, precision, records of a traced rollout."""

import contextlib
import os
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from jax.sharding import NamedSharding, PartitionSpec
from jaxtyping import Array

from sweep.case import Case
from sweep.controllers.tracker import Command, TrackerState
from sweep.engines.base import Trace
from sweep.engines.settings import EngineSettings
from sweep.metrics.stream import Tick
from sweep.models.step import Limits
from sweep.parameters import InputError

BATCH = "batch"
CPU_WIDTH, GPU_WIDTH = 64, 8192  # a device's best number of rollouts


def configure(settings: EngineSettings) -> None:
    """Process-wide choices of JAX: exact matrix products, and compiled programs kept between processes."""
    jax.config.update("jax_default_matmul_precision", "highest")  # TF32 lets the robot sink and the solver wander
    if jax.config.jax_compilation_cache_dir is None:
        home = os.environ.get("XDG_CACHE_HOME", Path.home() / ".cache")
        jax.config.update("jax_compilation_cache_dir", str(Path(home) / "insect-sweep"))
        jax.config.update("jax_persistent_cache_min_compile_time_secs", 1.0)
    with contextlib.suppress(RuntimeError):  # too late where JAX was used before
        jax.config.update("jax_num_cpu_devices", len(os.sched_getaffinity(0)))


def precision(settings: EngineSettings) -> contextlib.AbstractContextManager:
    """Double precision where asked for, for the calls inside."""
    return jax.enable_x64(settings.precision == "float64")


def default_width() -> int:
    """Rollouts of a batch over all devices: wide on an accelerator, narrow enough for the caches of a CPU."""
    return jax.device_count() * (CPU_WIDTH if jax.default_backend() == "cpu" else GPU_WIDTH)


def mesh(width: int) -> jax.sharding.Mesh:
    """The devices that share a batch of `width`: all of them where it divides evenly, else one."""
    devices = jax.devices() if width % jax.device_count() == 0 else jax.devices()[:1]
    return jax.make_mesh((len(devices),), (BATCH,), (jax.sharding.AxisType.Auto,), devices=devices)


def specs(tree: Any) -> Any:
    """How each leaf of `tree` lies on the mesh: split where it varies over the batch, else on every device."""
    return jax.tree.map(lambda x: PartitionSpec(BATCH) if np.ndim(x) else PartitionSpec(), tree)


def spread(tree: Any, over: jax.sharding.Mesh) -> Any:
    """Leaves as JAX arrays, laid out on the mesh by `specs`."""
    return jax.tree.map(lambda x, spec: jax.device_put(x, NamedSharding(over, spec)), tree, specs(tree))


def step_time(settings: EngineSettings) -> float:
    """Physics time step of the engine (s)."""
    return settings.native_time_step if settings.name == "native" else settings.time_step


def substeps(settings: EngineSettings) -> int:
    """Physics steps of a control tick. Raises `InputError` where they do not fit."""
    key = "native_time_step" if settings.name == "native" else "time_step"
    step = step_time(settings)
    ratio = settings.control_period / step
    if ratio < 1 or abs(ratio - round(ratio)) > 1e-6:
        raise InputError(
            f"engine.{key} = {step:g} is not allowed: a whole fraction of "
            f"engine.control_period = {settings.control_period:g} s"
        )
    return round(ratio)


def axes(tree: Any) -> Any:
    """The same tree with 0 at leaves that vary over the batch, None elsewhere."""
    return jax.tree.map(lambda x: 0 if np.ndim(x) else None, tree)


def as_arrays(tree: Any) -> Any:
    """Leaves as JAX arrays of the default float type."""
    return jax.tree.map(lambda x: jnp.asarray(x, float), tree)


def pick(case: Case, slot: int) -> Case:
    """One row's parameters as plain numbers."""
    return jax.tree.map(lambda x: float(x[slot]) if np.ndim(x) else x, case)


def check(streams: np.ndarray, width: int) -> None:
    """Raises `ValueError` where a batch does not have the engine's width."""
    if len(streams) != width:
        raise ValueError(f"a batch of {len(streams)} rollouts for an engine of width {width}")


def keys(streams: np.ndarray) -> Array:
    """A noise key per rollout, from its stream number alone."""
    low, high = np.uint32(streams & 0xFFFFFFFF), np.uint32(np.int64(streams) >> 32)
    root = jax.random.key(0)
    return jax.vmap(lambda a, b: jax.random.fold_in(jax.random.fold_in(root, a), b))(low, high)


def execution_limits(world: Case, time: Array) -> Limits:
    """What the drives can do, and the push, at `time` (s)."""
    execution = world.execution
    alive = jnp.arange(18).reshape(6, 3) != jnp.round(execution.dead_joint)
    torque = jnp.full((6, 3), execution.torque_scale * world.drive.torque_limit)
    pushed = (time >= execution.push_time) & (time < execution.push_time + execution.push_duration)
    size = jnp.where(pushed, execution.push_impulse / execution.push_duration, 0.0)
    angle = execution.push_direction
    direction = jnp.stack([jnp.cos(angle), jnp.sin(angle), jnp.zeros_like(jnp.cos(angle))])
    return Limits(alive.astype(torque.dtype), torque, size * direction)


def record(command: Command, state: TrackerState, tick: Tick, q: Array) -> dict[str, Array]:
    """What a trace keeps of a tick."""
    return {
        "qpos": q, "joint_target": command.joints.reshape(18), "joint_torque": tick.torque_peak.reshape(18),
        "foot_position": tick.joints[:, -1], "foot_target": command.target.feet, "foot_force": tick.force,
        "base_target": jnp.concatenate([command.target.position, command.target.quat]), "stage": state.stage,
    }  # fmt: skip


def to_trace(
    model: mujoco.MjModel, record: dict[str, np.ndarray], period: float, stages: tuple[str, ...], figures: dict
) -> Trace:
    """The records of one rollout up to its end."""
    frames = round(float(figures["duration_s"]) / period)
    kept = {key: value[:frames] for key, value in record.items()}
    time = period * (1 + np.arange(frames))
    return Trace(model=model, time=time, stages=stages, figures=figures, **kept)

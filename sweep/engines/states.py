"""Columns that `study.keep` can record over time, and how they are computed from rollout states."""

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any

import jax.numpy as jnp
import numpy as np

from sweep.core.shared_metrics.attitude import tilt_deg
from sweep.models.case import Case
from sweep.models.legs import JOINT_NAMES, LEGS, N_JOINTS

TickRecord = Mapping[str, Any]  # see `batching.record_tick`; components first, then rollouts or ticks
ColumnGetter = Callable[[TickRecord], Any]


def available_columns(world: Case) -> dict[str, ColumnGetter]:
    """Return the names of the columns that can be recorded over time with this robot and obstacle.

    `qpos_k` and `qvel_k` are MuJoCo's; forces are on the robot, in world axes.

    Returns:
        A function of a record (see `batching.record_tick`) by column name.
    """
    bodies = len(world.obstacle.free_bodies)
    columns: dict[str, ColumnGetter] = {
        f"base_{axis}_m": partial(_component, "qpos", (k,)) for k, axis in enumerate("xyz")
    }
    columns["tilt_deg"] = lambda record: tilt_deg(record["qpos"][3:7], jnp)
    columns |= {f"qpos_{k}": partial(_component, "qpos", (k,)) for k in range(7 + N_JOINTS + 7 * bodies)}
    columns |= {f"qvel_{k}": partial(_component, "qvel", (k,)) for k in range(6 + N_JOINTS + 6 * bodies)}
    columns |= {
        f"torque_peak_{name}_nm": partial(_component, "joint_torque", (k,)) for k, name in enumerate(JOINT_NAMES)
    }
    for leg in LEGS:
        at = {axis: (leg - 1, k) for k, axis in enumerate("xyz")}
        columns |= {f"foot{leg}_force_{axis}_n": partial(_component, "foot_force", place) for axis, place in at.items()}
    return columns


def select_columns(world: Case, record: TickRecord, names: Sequence[str]) -> Any:
    """Select time-series columns by name from the recorded states of some rollouts.

    Args:
        world: simulated parameters; they determine which columns there are.
        record: arrays (samples, rollouts, ...) by name, of NumPy or JAX.
        names: columns.

    Returns:
        Array (samples, rollouts, columns), of NumPy or JAX as the record.
    """
    columns, xp = available_columns(world), np if isinstance(record["qpos"], np.ndarray) else jnp
    last = {name: xp.moveaxis(x, (0, 1), (-2, -1)) for name, x in record.items()}
    return xp.stack([xp.asarray(columns[name](last)) for name in names], axis=-1)


def _component(name: str, index: tuple[int, ...], record: TickRecord) -> Any:
    return record[name][index]

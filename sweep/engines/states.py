"""Names for what engines record of a rollout: the columns of its states, in files and in `study.keep`."""

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any

import jax.numpy as jnp
import numpy as np

from sweep.metrics.attitude import tilt_deg
from sweep.models.case import Case
from sweep.models.legs import JOINTS, LEGS, N_JOINTS

Record = Mapping[str, Any]  # see `batching.record`; components first, so that what comes after may be rollouts or ticks
Column = Callable[[Record], Any]


def available_columns(world: Case) -> dict[str, Column]:
    """All columns of a kind of world. `qpos_k` and `qvel_k` are MuJoCo's; forces are on the robot, in world axes."""
    bodies = len(world.obstacle.free_bodies)
    columns: dict[str, Column] = {f"base_{axis}_m": partial(_number, "qpos", (k,)) for k, axis in enumerate("xyz")}
    columns["tilt_deg"] = lambda record: tilt_deg(record["qpos"][3:7])
    columns |= {f"qpos_{k}": partial(_number, "qpos", (k,)) for k in range(7 + N_JOINTS + 7 * bodies)}
    columns |= {f"qvel_{k}": partial(_number, "qvel", (k,)) for k in range(6 + N_JOINTS + 6 * bodies)}
    columns |= {f"torque_peak_{name}_nm": partial(_number, "joint_torque", (k,)) for k, name in enumerate(JOINTS)}
    for leg in LEGS:
        at = {axis: (leg - 1, k) for k, axis in enumerate("xyz")}
        columns |= {f"foot{leg}_force_{axis}_n": partial(_number, "foot_force", place) for axis, place in at.items()}
    return columns


def select_columns(world: Case, record: Record, names: Sequence[str]) -> Any:
    """Columns (samples, rollouts, names) of a record (samples, rollouts, ...), of NumPy or of JAX as that is."""
    columns, xp = available_columns(world), np if isinstance(record["qpos"], np.ndarray) else jnp
    last = {name: xp.moveaxis(x, (0, 1), (-2, -1)) for name, x in record.items()}
    return xp.stack([xp.asarray(columns[name](last)) for name in names], axis=-1)


def _number(name: str, place: tuple[int, ...], record: Record) -> Any:
    return record[name][place]

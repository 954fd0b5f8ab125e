"""Where rollouts of user models start: offsets from the keyframe, and random ones, of poses and velocities."""

from collections.abc import Mapping
from typing import Any, NamedTuple

import mujoco
import numpy as np

from sweep.contract.engine import hinge_and_slide_joints
from sweep.contract.system import Parameter
from sweep.core.parameters import quantity

TURN = ("roll", "pitch", "yaw")
BASE_UNITS = {
    "x": "m",
    "y": "m",
    "height": "m",
    **dict.fromkeys(TURN, "rad"),  # about the body's axes: first yaw, then pitch, then roll
    "velocity_x": "m/s",  # in world axes
    "velocity_y": "m/s",
    "velocity_z": "m/s",
    "roll_rate": "rad/s",  # about the body's axes
    "pitch_rate": "rad/s",
    "yaw_rate": "rad/s",
}
JOINT_UNITS = {"joint_positions": "rad", "joint_velocities": "rad/s"}  # of slides: m, m/s
START, RANDOM, JOINT = "start", "start.random", "start.joint"


class StartOffsets(NamedTuple):
    """Offsets that are added to the initial positions and velocities of n rollouts."""

    base: np.ndarray  # (n, 12) in the order of `BASE_UNITS`
    positions: np.ndarray  # (n, j) of the hinges and slides, rad or m
    velocities: np.ndarray  # (n, j) rad/s or m/s

    def add_to_states(self, model: mujoco.MjModel, base: int | None, limits: np.ndarray, qpos: Any, qvel: Any) -> None:
        """Add the offsets to the initial states in place; joints with limits stay within them.

        Args:
            model: The model.
            base: Index in `qpos` of the first free joint; None without one.
            limits: Ranges of all joints (n, njnt, 2).
            qpos: Positions (n, nq).
            qvel: Velocities (n, nv).
        """
        if base is not None and self.base.any():
            dof = int(model.jnt_dofadr[np.flatnonzero(model.jnt_qposadr == base)[0]])
            qpos[:, base : base + 3] += self.base[:, :3]
            roll, pitch, yaw = (_turn_about(axis, self.base[:, 3 + axis]) for axis in range(3))
            turn = _multiply(_multiply(yaw, pitch), roll)
            qpos[:, base + 3 : base + 7] = _multiply(qpos[:, base + 3 : base + 7], turn)
            qvel[:, dof : dof + 6] += self.base[:, 6:]
        joints = hinge_and_slide_joints(model)
        if self.positions.any():
            places = model.jnt_qposadr[joints]
            low, high = np.moveaxis(limits[:, joints], -1, 0)
            free = ~model.jnt_limited[joints].astype(bool)
            low, high = np.where(free, -np.inf, low), np.where(free, np.inf, high)
            moved = np.clip(qpos[:, places] + self.positions, low, high)
            qpos[:, places] = np.where(self.positions != 0, moved, qpos[:, places])
        qvel[:, model.jnt_dofadr[joints]] += self.velocities


def _turn_about(axis: int, angle: np.ndarray) -> np.ndarray:
    """Return the quaternions (n, 4) of turns by angles (n,) about the x, y or z axis."""
    found = np.zeros((len(angle), 4))
    found[:, 0], found[:, 1 + axis] = np.cos(angle / 2), np.sin(angle / 2)
    return found


def _multiply(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return the products (n, 4) of quaternions (n, 4)."""
    (aw, ax, ay, az), (bw, bx, by, bz) = a.T, b.T
    return np.stack(
        [
            aw * bw - ax * bx - ay * by - az * bz,
            aw * bx + ax * bw + ay * bz - az * by,
            aw * by - ax * bz + ay * bw + az * bx,
            aw * bz + ax * by - ay * bx + az * bw,
        ],
        axis=1,
    )


def default_parameters(model: mujoco.MjModel, has_base: bool) -> dict[str, Parameter]:
    """Return the parameters of the initial state, such as offsets of joints, with default values, by path.

    Args:
        model: The model.
        has_base: Whether it has a free joint.
    """
    units = (BASE_UNITS if has_base else {}) | JOINT_UNITS
    found = {f"{START}.{name}": quantity(0.0, unit) for name, unit in units.items()}
    found |= {f"{RANDOM}.{name}": quantity(0.0, unit, at_least=0) for name, unit in units.items()}
    for name in filter(None, (model.joint(k).name for k in hinge_and_slide_joints(model))):
        found |= {f"{JOINT}.{name}.position": quantity(0.0, "rad"), f"{JOINT}.{name}.velocity": quantity(0.0, "rad/s")}
    return found


def count_random_numbers(model: mujoco.MjModel) -> int:
    """Return how many random numbers the initial state of one rollout needs."""
    return len(BASE_UNITS) + 2 * len(hinge_and_slide_joints(model))


def make_offsets(model: mujoco.MjModel, values: Mapping[str, Any], luck: np.ndarray) -> StartOffsets:
    """Return the offsets that n rollouts add to their initial positions and velocities.

    Args:
        model: The model.
        values: Numbers by path, see `default_parameters`; each a number, or an array (n,).
        luck: Even random numbers from -1 to 1, (n, k): see `count_random_numbers`.
    """
    n, joints = len(luck), hinge_and_slide_joints(model)

    def rows(path: str) -> np.ndarray:
        return np.broadcast_to(np.asarray(values.get(path, 0.0), float), (n,))

    def offset(name: str, draws: np.ndarray) -> np.ndarray:
        return rows(f"{START}.{name}")[:, None] + rows(f"{RANDOM}.{name}")[:, None] * draws

    base, rest = luck[:, : len(BASE_UNITS)], luck[:, len(BASE_UNITS) :]
    columns = [offset(name, base[:, [k]]) for k, name in enumerate(BASE_UNITS)]
    every = []
    for k, (name, what) in enumerate(zip(JOINT_UNITS, ("position", "velocity"), strict=True)):
        alone = [rows(f"{JOINT}.{model.joint(j).name}.{what}") for j in joints]
        own = np.stack(alone, axis=1) if alone else np.zeros((n, 0))
        every.append(own + offset(name, rest[:, k * len(joints) : (k + 1) * len(joints)]))
    return StartOffsets(np.concatenate(columns, axis=1), *every)

"""Joint controllers that run at the physics rate: torques from stiffness and damping, as policies were trained with."""

from typing import Any, NamedTuple

import mujoco
import numpy as np

from sweep.core.errors import InputError

JOINT_TRANSMISSIONS = (int(mujoco.mjtTrn.mjTRN_JOINT), int(mujoco.mjtTrn.mjTRN_JOINTINPARENT))


class JointPdControl(NamedTuple):
    """Proportional-derivative law from joint targets to controls; actuators without a law take commands as controls."""

    qpos: np.ndarray  # (nu,) index of the joint's position
    qvel: np.ndarray  # (nu,) index of the joint's velocity
    stiffness: np.ndarray  # (nu,) N*m/rad
    damping: np.ndarray  # (nu,) N*m*s/rad
    limit: np.ndarray  # (nu,) N*m
    lever: np.ndarray  # (nu,) N*m of torque for a unit of control
    active: np.ndarray  # (nu,) whether the actuator has a law

    def controls(self, command: Any, qpos: Any, qvel: Any) -> Any:
        """Return the controls (n, nu) of the actuators for one physics step.

        Args:
            command: Joint targets (n, nu) in rad; of actuators without a law, controls.
            qpos: Positions (n, nq) as the step begins.
            qvel: Velocities (n, nv).

        Returns:
            Controls (n, nu).
        """
        xp = qpos.__array_namespace__()
        torque = self.stiffness * (command - qpos[:, self.qpos]) - self.damping * qvel[:, self.qvel]
        torque = xp.clip(torque, -self.limit, self.limit)
        return xp.where(self.active, torque / self.lever, command)


def find_actuator_name(model: mujoco.MjModel, index: int) -> str:
    """Return the name of an actuator, else that of its joint, else its index.

    Args:
        model: The model.
        index: Index of the actuator.
    """
    joint = int(model.actuator_trnid[index, 0]) if model.actuator_trntype[index] in JOINT_TRANSMISSIONS else -1
    return model.actuator(index).name or (model.joint(joint).name if joint >= 0 else "") or f"actuator {index}"


def find_actuators(error_prefix: str, model: mujoco.MjModel, joints: list[str]) -> np.ndarray:
    """Return the actuator that drives each joint. Raises `InputError` where a joint has none or several.

    Args:
        error_prefix: What messages begin with.
        model: The model.
        joints: Names of hinge and slide joints.

    Returns:
        Indices (n,).
    """
    kind, target = model.actuator_trntype, model.actuator_trnid[:, 0]
    found = []
    for name in joints:
        mine = np.flatnonzero(np.isin(kind, JOINT_TRANSMISSIONS) & (target == model.joint(name).id))
        if len(mine) != 1:
            count = "no actuator" if not len(mine) else f"{len(mine)} actuators"
            raise InputError(f"{error_prefix}: joint {name} has {count} in the model: exactly one is needed")
        found.append(int(mine[0]))
    return np.array(found, int)


def actuated_joints(model: mujoco.MjModel) -> list[str]:
    """Return the names of the joints that have actuators, in the order of the actuators."""
    return [model.joint(j).name for k, j in zip(model.actuator_trntype, model.actuator_trnid[:, 0], strict=True)
            if int(k) in JOINT_TRANSMISSIONS]  # fmt: skip


def is_servo(model: mujoco.MjModel) -> np.ndarray:
    """Return which actuators (nu,) are position servos, with force kp (command - length) minus damping."""
    gain, bias = model.actuator_gainprm[:, 0], model.actuator_biasprm[:, 1]
    return (model.actuator_biastype == int(mujoco.mjtBias.mjBIAS_AFFINE)) & (gain == -bias) & (gain != 0)


def make_joint_control(
    model: mujoco.MjModel, actuators: np.ndarray, stiffness: np.ndarray, damping: np.ndarray, limit: np.ndarray
) -> JointPdControl:
    """Make the proportional-derivative law that turns joint targets into torques of the given motors.

    Args:
        model: The model.
        actuators: Indices (k,).
        stiffness: N*m/rad, (k,).
        damping: N*m*s/rad, (k,).
        limit: N*m, (k,).

    Returns:
        The law of all actuators.
    """

    def spread(values: Any, usual: float) -> np.ndarray:
        found = np.full(model.nu, usual)
        found[actuators] = values
        return found

    joints = model.actuator_trnid[actuators, 0]
    lever = model.actuator_gear[actuators, 0] * model.actuator_gainprm[actuators, 0]
    return JointPdControl(
        spread(model.jnt_qposadr[joints], 0).astype(int),
        spread(model.jnt_dofadr[joints], 0).astype(int),
        spread(stiffness, 0.0),
        spread(damping, 0.0),
        spread(limit, np.inf),
        spread(lever, 1.0),
        spread(1.0, 0.0).astype(bool),
    )

"""Torque limits of electric motors that fall with speed, to zero at the no-load speed."""

import fnmatch
from collections.abc import Mapping
from typing import Any, NamedTuple

import mujoco
import numpy as np
from mujoco.batch import Batch

from sweep.contract.system import Parameter
from sweep.core.errors import InputError
from sweep.core.parameters import quantity
from sweep.systems.mujoco_model.actuation import JOINT_TRANSMISSIONS
from sweep.systems.mujoco_model.actuator_networks import KEYS, UNLIMITED, ActuatorNetwork, parse_network
from sweep.systems.mujoco_model.named_groups import iterate_named_entries

MOTOR: Mapping[str, Parameter] = {  # numbers of the motors of some joints
    "stall_torque": quantity(0.0, "N*m", above=0),  # at rest, if `torque_limit` allows it
    "no_load_speed": quantity(0.0, "rad/s", above=0),  # at which no torque is left
    "torque_limit": quantity(1e6, "N*m", above=0),  # at any speed
    "strength": quantity(1.0, "", at_least=0),  # factor of `stall_torque` and `torque_limit`
}
NEEDED = ("stall_torque", "no_load_speed")


class MotorGroup(NamedTuple):
    """Motors of a scenario that share limits: their name, and the actuators that they drive."""

    name: str
    actuators: tuple[int, ...]


class MotorLimits(NamedTuple):
    """Torque limits of the motors of n rollouts, and the force laws of the nu actuators."""

    stall: Any  # (n, nu) N*m
    speed: Any  # (n, nu) rad/s
    most: Any  # (n, nu) N*m
    strength: Any  # (n, nu) factor of the torques of networks
    gear: Any  # (n, nu)
    gain: Any  # (n, nu) force for a unit of control
    bias: Any  # (n, nu, 3) constant force, and force by length and velocity of the actuator
    low: Any  # (n, nu) least control
    high: Any  # (n, nu) largest control


class MotorLaw(NamedTuple):
    """Clips the controls of nu actuators so that joint torques stay within what motors can deliver at their speed."""

    qpos: np.ndarray  # (nu,) index of the joint's position
    qvel: np.ndarray  # (nu,) index of the joint's velocity
    active: np.ndarray  # (nu,) whether the actuator has a motor
    learned: np.ndarray  # (nu,) whether a network gives the motor's torque

    def controls(self, ctrl: Any, qpos: Any, qvel: Any, limits: MotorLimits, torques: Any = None) -> Any:
        """Return controls (n, nu) for a physics step that the motors can deliver.

        The torque of a motor at the speed v is between `-stall (1 + v / speed)` and `stall (1 - v / speed)`, and at
        most `most` in size: beyond the no-load speed it brakes.

        Args:
            ctrl: Wanted controls (n, nu).
            qpos: Positions (n, nq).
            qvel: Velocities (n, nv).
            limits: Limits of the motors.
            torques: Torques (n, nu) of the motors that have a network, N*m.
        """
        xp = qpos.__array_namespace__()
        speed = qvel[:, self.qvel]
        motion = limits.bias[..., 1] * qpos[:, self.qpos] + limits.bias[..., 2] * speed
        passive = limits.bias[..., 0] + limits.gear * motion
        torque = limits.gear * (limits.gain * xp.clip(ctrl, limits.low, limits.high) + passive)
        torque = torque if torques is None else xp.where(self.learned, limits.strength * torques, torque)
        high = xp.clip(limits.stall * (1 - speed / limits.speed), -limits.most, limits.most)
        low = xp.clip(-limits.stall * (1 + speed / limits.speed), -limits.most, limits.most)
        torque = xp.clip(torque, low, high)
        return xp.where(self.active & (limits.gain != 0), (torque / limits.gear - passive) / limits.gain, ctrl)


def parse_motors(
    given: Any, model: mujoco.MjModel
) -> tuple[tuple[MotorGroup, ...], tuple[ActuatorNetwork, ...], dict[str, Any]]:
    """Return the motors in a configuration, their networks, and their numeric parameters by path. Raises `InputError`.

    Args:
        given: For each name a mapping with `joints`, a pattern of names, keys of `MOTOR`, and with the key `network`
            those of `actuator_networks.KEYS`.
        model: The model.
    """
    groups, networks, numbers, taken = [], [], {}, {}
    such = "motors by name, such as {legs: {joints: '*', stall_torque: 30, no_load_speed: 20}}"
    learned = ("network", *KEYS, "order", "recurrent")
    for name, said in iterate_named_entries("motor", given, such, ("joints", *MOTOR, *learned), ("joints",)):
        has_network = "network" in said
        if odd := next((key for key in said if key in learned and not has_network), None):
            raise InputError(f"motor.{name}.{odd} is not allowed without the key network")
        if missing := next((key for key in NEEDED if key not in said and not has_network), None):
            raise InputError(f"motor.{name} needs the key {missing}")
        actuators = _find_motors(f"motor.{name}", str(said["joints"]), model)
        for one in actuators:
            if one in taken:
                joint = model.joint(int(model.actuator_trnid[one, 0])).name
                raise InputError(f"motor.{name}.joints = {said['joints']}: {joint} is in motor.{taken[one]}, too")
            taken[one] = name
        groups.append(MotorGroup(name, actuators))
        if has_network:
            networks.append(parse_network(f"motor.{name}", said, actuators, model))
        own = {**(UNLIMITED if has_network else {}), **said}
        numbers |= {f"motor.{name}.{key}": value for key, value in own.items() if key in MOTOR}
    return tuple(groups), tuple(networks), numbers


def _find_motors(error_prefix: str, pattern: str, model: mujoco.MjModel) -> tuple[int, ...]:
    """Return the actuators of joints whose names fit a pattern. Raises `InputError`."""
    on_joints = [k for k in range(model.nu) if int(model.actuator_trntype[k]) in JOINT_TRANSMISSIONS]
    names = [model.joint(int(model.actuator_trnid[k, 0])).name for k in on_joints]
    found = [k for k, name in zip(on_joints, names, strict=True) if fnmatch.fnmatchcase(name, pattern)]
    if not found:
        raise InputError(f"{error_prefix}.joints = {pattern} fits no joint with an actuator ({', '.join(names)})")
    kinds = model.actuator_dyntype, model.actuator_gaintype, model.actuator_biastype
    known = (
        {int(mujoco.mjtDyn.mjDYN_NONE)},
        {int(mujoco.mjtGain.mjGAIN_FIXED)},
        {int(mujoco.mjtBias.mjBIAS_NONE), int(mujoco.mjtBias.mjBIAS_AFFINE)},
    )
    for k in found:
        if (
            not all(int(kind[k]) in one for kind, one in zip(kinds, known, strict=True))
            or not model.actuator_gainprm[k, 0]
        ):
            joint = model.joint(int(model.actuator_trnid[k, 0])).name
            raise InputError(f"{error_prefix}.joints = {pattern} is not allowed: the actuator of {joint} is neither a "
                             "motor nor a servo of position or velocity without a state")  # fmt: skip
    return tuple(found)


def make_motor_law(
    model: mujoco.MjModel, groups: tuple[MotorGroup, ...], networks: tuple[ActuatorNetwork, ...] = ()
) -> MotorLaw | None:
    """Make the law that clips actuator torques to motor limits; None if no joint has a motor.

    Args:
        model: The model.
        groups: The motors.
        networks: Networks of some of them.
    """
    if not groups:
        return None
    active = np.isin(np.arange(model.nu), [k for one in groups for k in one.actuators])
    joints = np.where(active, model.actuator_trnid[:, 0], 0)
    learned = np.isin(np.arange(model.nu), [k for one in networks for k in one.actuators])
    return MotorLaw(model.jnt_qposadr[joints].astype(int), model.jnt_dofadr[joints].astype(int), active, learned)


def make_motor_limits(groups: tuple[MotorGroup, ...], values: Mapping[str, Any], batch: Batch) -> MotorLimits | None:
    """Return the torque limits of motors in n rollouts; None if no joint has a motor.

    Args:
        groups: The motors of the scenario.
        values: Numbers by path; each a number, or an array (n,).
        batch: The n models.
    """
    if not groups:
        return None
    model, n = batch.model, batch.nsim
    stall, speed, most, strength = (np.ones((n, model.nu)) for _ in range(4))
    for one in groups:
        number = {key: np.asarray(values[f"motor.{one.name}.{key}"], float)[..., None] for key in MOTOR}
        which = list(one.actuators)
        stall[:, which] = number["strength"] * number["stall_torque"]
        speed[:, which] = number["no_load_speed"]
        strength[:, which] = number["strength"]
        most[:, which] = number["strength"] * number["torque_limit"]
    names = "gear", "gainprm", "biasprm", "ctrlrange"
    gear, gain, bias, controls = (np.array(batch.expand(f"actuator_{name}")) for name in names)
    affine = (model.actuator_biastype == int(mujoco.mjtBias.mjBIAS_AFFINE))[:, None]
    limited = model.actuator_ctrllimited.astype(bool)[:, None]
    low, high = np.moveaxis(np.where(limited, controls, [-np.inf, np.inf]), -1, 0)
    return MotorLimits(
        stall, speed, most, strength, gear[..., 0], gain[..., 0], np.where(affine, bias[..., :3], 0.0), low, high
    )

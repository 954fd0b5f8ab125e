"""Learned models of actuators: networks that map the last position errors and velocities of a joint to its torque.

They run at every physics step. The form is that of published actuator networks: position errors and velocities of some
earlier steps, scaled, one joint a row.
"""

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import mujoco
import numpy as np

from sweep.core.errors import InputError, require_choice
from sweep.core.parameters import convert_and_check_value, count, quantity
from sweep.systems.mujoco_model import files, onnx_network

KEYS = {  # of a motor with a network, beside the network's file
    "history": count(1, at_least=1, at_most=100),  # samples that the network receives, the present one included
    "spacing": count(1, at_least=1, at_most=1000),  # physics steps between two samples
    "position_scale": quantity(1.0, ""),  # factor of position errors (rad)
    "velocity_scale": quantity(1.0, ""),  # factor of velocities (rad/s)
    "torque_scale": quantity(1.0, ""),  # factor of the network's output, which gives N*m
}
INPUT_ORDERS = ("positions", "velocities")  # what comes first; both newest first
UNLIMITED = {"stall_torque": 1e6, "no_load_speed": 1e9}  # N*m, rad/s of a motor whose network alone limits it


class ActuatorNetwork(NamedTuple):
    """A neural network that gives the torques of some joints from their recent position errors and velocities."""

    file: str
    digest: str
    actuators: tuple[int, ...]
    qpos: tuple[int, ...]  # index of each joint's position
    qvel: tuple[int, ...]  # index of each joint's velocity
    history: int
    spacing: int  # physics steps
    position_scale: float
    velocity_scale: float
    torque_scale: float
    order: str
    recurrent: tuple[tuple[str, str], ...]  # inputs of the network that receive outputs of the step before

    def load_torque_function(self) -> Callable[[Any, Any], tuple[Any, Any]]:
        """Load the network as a function from samples and memory of all joints to torques. Raises `InputError`."""
        network = _read(self.file)
        return onnx_network.vectorize_joint_network(network, dict(self.recurrent), 2 * self.history)

    def begin(self, n: int) -> dict[str, Any]:
        """Return the state of n rollouts before the first step: no past errors or velocities, network memory zero."""
        length, joints = (self.history - 1) * self.spacing + 1, len(self.actuators)
        network = _read(self.file)
        memory = {name: np.zeros((n, joints, *network.input_shape(name))) for name, _ in self.recurrent}
        return {"errors": np.zeros((n, length, joints)), "velocities": np.zeros((n, length, joints)), "memory": memory}

    def push_sample(self, state: Mapping[str, Any], targets: Any, qpos: Any, qvel: Any) -> tuple[Any, dict[str, Any]]:
        """Return the network's inputs (n, joints, k) in a step, and the history of samples for the next step.

        Args:
            state: State of the rollouts.
            targets: Targets (n, nu) of the actuators, rad.
            qpos: Positions (n, nq).
            qvel: Velocities (n, nv).
        """
        xp = qpos.__array_namespace__()
        new = targets[:, list(self.actuators)] - qpos[:, list(self.qpos)], qvel[:, list(self.qvel)]
        past = [xp.concatenate([one[:, None], state[name][:, :-1]], axis=1)
                for one, name in zip(new, ("errors", "velocities"), strict=True)]  # fmt: skip
        scales = self.position_scale, self.velocity_scale
        parts = [scale * xp.moveaxis(one[:, :: self.spacing], 1, 2) for one, scale in zip(past, scales, strict=True)]
        parts = parts if self.order == INPUT_ORDERS[0] else parts[::-1]
        return xp.concatenate(parts, axis=2), {"errors": past[0], "velocities": past[1]}


Evaluation = Callable[[Any, Any], tuple[Any, Any]]  # of inputs (n, joints, k) and memory: torques (n, joints), memory


def compute_torques(
    networks: Sequence[ActuatorNetwork],
    evaluations: Sequence[Evaluation],
    states: Sequence[Mapping[str, Any]],
    targets: Any,
    qpos: Any,
    qvel: Any,
) -> tuple[Any, list[dict[str, Any]]]:
    """Compute the torques of all actuators that have networks, when a physics step begins.

    Args:
        networks: The networks.
        evaluations: Their functions over n rollouts.
        states: Their states.
        targets: Targets (n, nu) of the actuators, rad.
        qpos: Positions (n, nq).
        qvel: Velocities (n, nv).

    Returns:
        Torques (n, nu) at the joints in N*m, 0 for other actuators, and the next states.
    """
    xp, nu = qpos.__array_namespace__(), targets.shape[1]
    torques, after = xp.zeros_like(targets), []
    for network, evaluate, state in zip(networks, evaluations, states, strict=True):
        inputs, new = network.push_sample(state, targets, qpos, qvel)
        found, memory = evaluate(inputs, state["memory"])
        spread = np.eye(nu)[list(network.actuators)]
        torques = torques + (network.torque_scale * found) @ xp.asarray(spread, torques.dtype)
        after.append({**new, "memory": memory})
    return torques, after


def parse_network(
    error_prefix: str, config: Mapping[str, Any], actuators: Sequence[int], model: mujoco.MjModel
) -> ActuatorNetwork:
    """Parse the configuration of a motor whose torque a network gives. Raises `InputError`.

    Args:
        error_prefix: The motor, such as `motor.legs`.
        config: Keys and values, `network` among them.
        actuators: Actuators of the motor.
        model: The model.
    """
    numbers = {
        key: convert_and_check_value(one, config.get(key, one.default), f"{error_prefix}.{key}")
        for key, one in KEYS.items()
    }
    order, recurrent = config.get("order", INPUT_ORDERS[0]), config.get("recurrent") or {}
    require_choice(order, INPUT_ORDERS, f"{error_prefix}.order = {order}")
    if not isinstance(recurrent, Mapping):
        raise InputError(
            f"{error_prefix}.recurrent = {recurrent!r} is not allowed: outputs by input, such as {{h: h_out}}"
        )
    servos = model.actuator_biastype == int(mujoco.mjtBias.mjBIAS_AFFINE)
    for k in actuators:
        if servos[k] and model.actuator_ctrllimited[k]:
            raise InputError(
                f"{error_prefix}.network is not allowed: the servo {model.actuator(k).name} has a ctrlrange, which "
                "would limit the network's torque: use a motor"
            )
    name, joints = str(config["network"]), model.actuator_trnid[list(actuators), 0]
    file = files.require_file("network", name, files.ONNX_SUFFIX, error_prefix)
    found = ActuatorNetwork(name, files.digest_file_contents(files.list_network_files(file)), tuple(actuators),
                            tuple(map(int, model.jnt_qposadr[joints])), tuple(map(int, model.jnt_dofadr[joints])),
                            **numbers, order=order, recurrent=tuple(sorted(recurrent.items())))  # fmt: skip
    try:
        found.load_torque_function()
    except InputError as error:
        raise InputError(f"{error_prefix}.network: {error}") from None
    return found


def _read(name: str) -> onnx_network.Network:
    return files.read_network(name, files.require_file("network", name, files.ONNX_SUFFIX, "motor"))

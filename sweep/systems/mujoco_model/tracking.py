"""How well a rollout follows its velocity commands: errors of the base's velocities, once a control tick."""

from collections.abc import Mapping, Sequence
from typing import Any

import jax.numpy as jnp
import mujoco
import numpy as np
from jaxtyping import Array

from sweep.core.rotations import conjugate, rotate
from sweep.systems.mujoco_model.policy_spec import VELOCITY_COMMANDS

SPEED, TURN = "velocity_error_rms_mps", "yaw_rate_error_rms_radps"
COLUMNS = {
    SPEED: "root mean square difference between commanded and actual horizontal velocity, in the base's axes",
    TURN: "root mean square difference between commanded and actual yaw rate, about the base's vertical axis",
}


def tracking_columns(names: Sequence[str]) -> dict[str, str]:
    """Return the meanings of the columns with velocity-tracking errors, by column."""
    linear, yaw = {"velocity_x", "velocity_y"} & {*names}, "yaw_rate" in names
    return {name: meaning for name, meaning in COLUMNS.items() if (linear if name == SPEED else yaw)}


class VelocityTracking:
    """State of the velocity-tracking metric of one rollout: sums of squared errors.

    Args:
        model: The model, whose first free joint is the base.
        commands: Names of the commands that are tracked, of `velocity_x`, `velocity_y` and `yaw_rate`.
    """

    def __init__(self, model: mujoco.MjModel, commands: Sequence[str]):
        self._commands = commands
        base = int(np.flatnonzero(model.jnt_type == int(mujoco.mjtJoint.mjJNT_FREE))[0])
        place, dof = int(model.jnt_qposadr[base]), int(model.jnt_dofadr[base])
        self._quat, self._linear, self._yaw = slice(place + 3, place + 7), slice(dof, dof + 3), dof + 5

    def begin(self) -> Array:
        """Return the initial sums of squared errors (m^2/s^2, rad^2/s^2) and the number of ticks, all zero."""
        return jnp.zeros(3)

    def update(self, total: Array, belief: Mapping[str, Any], state: Mapping[str, Array]) -> Array:
        """Add the squared errors (commanded minus measured velocity) of a tick.

        Args:
            total: Sums so far (3,).
            belief: Commands of the tick, by name.
            state: State of the model at its end, by name: see `ModelSpec.split_state`.
        """
        velocity = rotate(conjugate(state["qpos"][self._quat]), state["qvel"][self._linear])
        actual = dict(zip(VELOCITY_COMMANDS, (velocity[0], velocity[1], state["qvel"][self._yaw]), strict=True))
        error = {name: (belief[name] - actual[name]) ** 2 for name in self._commands}
        linear = error.get("velocity_x", 0.0) + error.get("velocity_y", 0.0)
        return total + jnp.stack([jnp.asarray(x, total.dtype) for x in (linear, error.get("yaw_rate", 0.0), 1.0)])

    def compute(self, total: Array) -> dict[str, Array]:
        """Return the velocity-tracking errors of a rollout, by column."""
        mean = jnp.sqrt(total[:2] / jnp.maximum(total[2], 1.0))
        return {name: mean[k] for k, name in enumerate(COLUMNS) if name in tracking_columns(self._commands)}

"""Standing postures that manoeuvres start from."""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from sweep.formulas.leg import SIDE
from sweep.models.robot import Robot
from sweep.models.scene import mount_yaw, mounts


def outward(robot: Robot) -> Float[Array, "6 3"]:
    """Unit vectors in which the legs point at alpha = 0, base axes."""
    yaw = mount_yaw(robot)
    return jnp.asarray(np.stack([-SIDE * np.sin(yaw), SIDE * np.cos(yaw), np.zeros(6)], axis=-1))


def foot_centres(robot: Robot, spread: Array | float, height: Array | float) -> Float[Array, "6 3"]:
    """Feet `spread` (m) out from the hips and `height` (m) below them, base axes: C' of monograph (1.3.4)."""
    down = jnp.array([0.0, 0.0, -1.0])
    return mounts(robot) + spread * outward(robot) + height * down

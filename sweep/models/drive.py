"""Joint drives (monograph 1.2.1): a PD voltage inside a clamp, back-EMF outside."""

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float

from sweep.core.parameters import parameters, quantity


@parameters
class Drive:
    """Parameters of a joint drive: U = clip(stiffness (ref - q) - damping q', +-torque_limit), joint torque M = U -
    back_emf q'.

    `damping` is -chi2 = 2 sqrt(chi1) + delta - c_e of the book for chi1 = 4.5e4, delta = 100.
    """

    # chi1, torque for each radian that the joint is off its reference
    stiffness: float = quantity(4.5e4, "N*m/rad", above=0)
    damping: float = quantity(514.26, "N*m*s/rad", at_least=0)  # -chi2, torque against the joint's rate
    # c_e, torque that the motor's own rotation takes off, beyond the limit too
    back_emf: float = quantity(10.0, "N*m*s/rad", at_least=0)
    torque_limit: float = quantity(150.0, "N*m", above=0)  # U_max, largest torque that the servo asks for
    armature: float = quantity(0.1, "kg*m^2", at_least=0)  # rotor inertia seen at the joint
    # largest |alpha|, 2 pi / 3 of the thesis (1.3): farther back a leg would be over the body
    turn_limit: float = quantity(2.0943951, "rad", above=0)
    # rate of a joint that its drive bears; the book has none: that at which c_e q' takes off all of its U_max
    speed_limit: float = quantity(15.0, "rad/s", above=0)
    # mechanical power of a joint, given or taken, that its drive bears; the book has none: U_max at speed_limit
    power_limit: float = quantity(2250.0, "W", above=0)


class ServoCommand(NamedTuple):
    """Command to all drives in a tick: U = clip(stiffness (target - q) - damping q' + torque, +-torque_limit).

    In position mode stiffness and damping are those of (1.2.1). A joint in torque mode has no stiffness, and a damping
    of -back_emf, so that its torque is `torque` itself.
    """

    target: Float[Array, "6 3"]  # rad
    stiffness: Float[Array, "6 3"]  # N m/rad
    damping: Float[Array, "6 3"]  # N m s/rad
    torque: Float[Array, "6 3"]  # N m


def position_command(drive: Drive, target: Float[Array, "6 3"]) -> ServoCommand:
    """Return the command that drives all joints to target angles with the drive's own gains.

    Args:
        drive: The gains.
        target: alpha, beta, gamma of each leg (rad).
    """
    stiffness, damping = (jnp.full_like(target, gain) for gain in (drive.stiffness, drive.damping))
    return ServoCommand(target, stiffness, damping, jnp.zeros_like(target))


def interpolate_target(start: ServoCommand, end: ServoCommand, share: Array | float) -> ServoCommand:
    """Interpolate the target angles linearly within a control tick; constant targets would ratchet the feet.

    Args:
        start: The last tick's command.
        end: This tick's command, whose gains and torques apply.
        share: Elapsed share of the tick, 0 to 1.
    """
    return end._replace(target=start.target + share * (end.target - start.target))

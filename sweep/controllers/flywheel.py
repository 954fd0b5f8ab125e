"""The middle legs as a flywheel: straight out to the sides, they turn the body by their reaction (monograph 2.6.2)."""

from dataclasses import dataclass
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from sweep.controllers.layers import Command, Layer, Now
from sweep.controllers.observation import Observation
from sweep.controllers.plan import BALANCE, LOCKED, Plan
from sweep.controllers.posture import mass_centre
from sweep.core.constants import GRAVITY
from sweep.core.rotations import rotate, wrapped
from sweep.models.drive import Servo
from sweep.models.robot import Robot

RIGHT, LEFT = (2, 1), (3, 1)  # beta of legs 3 and 4, in tables of joints (6, 3)
TURNING = np.zeros((6, 3), bool)
TURNING[RIGHT] = TURNING[LEFT] = True


class Gains(NamedTuple):
    """Feedback of the middle legs as a flywheel, c_1 ... c_6 of monograph 2.6.2."""

    c1: Array | float  # N/m
    c2: Array | float  # N s/m
    c3: Array | float  # N m/rad
    c4: Array | float  # N m s/rad
    c5: Array | float  # N m/rad
    c6: Array | float  # N m s/rad
    back_emf: Array | float  # N m s/rad, what the drives are believed to lose and make up for


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Flywheel(Layer):
    """How the middle legs balance the body, over S stages."""

    mode: Int[Array, " s"]
    gains: Gains

    def blind(self, stage: Int[Array, ""]) -> Bool[Array, ""]:
        """While the robot stands on two feet, about which it tilts."""
        return self.mode[stage] == BALANCE

    def commanded(self, now: Now, own: None, command: Command) -> tuple[None, Command]:
        """The middle legs in torque mode, from where they are seen."""
        turning, servo = self.order(now.robot, now.plan, now.stage, now.seen)
        joints = jnp.where(turning, now.seen.angles, command.joints)  # where position mode takes over from
        return own, command._replace(joints=joints, own=(turning, servo))

    def order(
        self, robot: Robot, plan: Plan, stage: Int[Array, ""], seen: Observation
    ) -> tuple[Bool[Array, "6 3"], Servo]:
        """What the drives are told of the joints in torque mode, and which these are.

        M_3 = -(c_1 xi_c + c_2 xi_c')/2 - M_g while the robot balances, c_5 (beta_3 - pi/2) - c_6 beta_3' - M_g while
        four feet stand; xi_c is how far the centre of mass is off the planned line to the left. Leg 4 follows leg 3,
        M_4 = c_3 (beta_4 - beta_3) - c_4 beta_4', as a servo of its drive: at c_3 = -5e4 it is too stiff for the
        controller's ticks. (c_4 = 2 sqrt(-c_3) + 100 makes it the drive of (1.2.1).) The drives make up for their
        back-EMF.
        """
        gains = self.gains
        left = rotate(plan.quat[stage], jnp.array([0.0, 1.0, 0.0], seen.position.dtype))
        place, velocity = centre_of_mass(robot, seen)
        balance = -(gains.c1 * ((place - plan.position[stage]) @ left) + gains.c2 * (velocity @ left)) / 2
        angle = seen.angles[RIGHT]
        level = gains.c5 * wrapped(angle - jnp.pi / 2) - gains.c6 * seen.rates[RIGHT]
        torque = jnp.where(self.mode[stage] == BALANCE, balance, level) - weight(robot) * jnp.sin(angle)
        zeros = jnp.zeros_like(seen.angles)
        along = seen.angles[LEFT] + wrapped(angle - seen.angles[LEFT])
        servo = Servo(
            target=seen.angles.at[LEFT].set(along),
            stiffness=zeros.at[LEFT].set(-gains.c3),
            damping=zeros.at[RIGHT].set(-gains.back_emf).at[LEFT].set(gains.c4 - gains.back_emf),
            torque=zeros.at[RIGHT].set(torque),
        )
        return jnp.asarray(TURNING) & (self.mode[stage] != LOCKED), servo


def weight(robot: Robot) -> Array | float:
    """Moment of a straight, level leg's weight about its hip (N m): (m_1 + m_2) g l_c."""
    return GRAVITY * (robot.thigh_mass * robot.thigh / 2 + robot.shin_mass * (robot.thigh + robot.shin / 2))


def centre_of_mass(robot: Robot, seen: Observation) -> tuple[Float[Array, " 3"], Float[Array, " 3"]]:
    """Of the believed robot as it is seen: place (m) and velocity (m/s), world axes."""
    arm, change = jax.jvp(lambda angles: mass_centre(robot, angles), (seen.angles,), (seen.rates,))
    place = seen.position + rotate(seen.quat, arm)
    return place, seen.velocity + rotate(seen.quat, jnp.cross(seen.spin, arm) + change)

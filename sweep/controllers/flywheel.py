"""Middle legs as a flywheel: stretched out to the sides, they turn the body by their reaction (monograph 2.6.2)."""

from dataclasses import dataclass
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from sweep.controllers.layers import Command, TickContext, TrackerLayer
from sweep.controllers.observation import Observation
from sweep.controllers.plan import BALANCE, LOCKED, Plan
from sweep.core.constants import GRAVITY
from sweep.core.rotations import rotate, wrap_angle
from sweep.models.drive import ServoCommand
from sweep.models.posture import mass_centre
from sweep.models.robot import Robot

RIGHT, LEFT = (2, 1), (3, 1)  # indices of beta of legs 3 and 4 in joint arrays (6, 3)
TURNING = np.zeros((6, 3), bool)
TURNING[RIGHT] = TURNING[LEFT] = True


class FlywheelGains(NamedTuple):
    """Feedback gains c_1 to c_6 of the controller that balances on a beam with the middle legs: monograph 2.6.2."""

    c1: Array | float  # N/m
    c2: Array | float  # N s/m
    c3: Array | float  # N m/rad
    c4: Array | float  # N m s/rad
    c5: Array | float  # N m/rad
    c6: Array | float  # N m s/rad
    back_emf: Array | float  # N m s/rad, believed loss of the drives, which the law compensates


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class MiddleLegFlywheel(TrackerLayer):
    """Tracker layer that balances the body on a beam by swinging the middle legs like a flywheel."""

    mode: Int[Array, " s"]  # `LOCKED`, `LEVELLING` or `BALANCE`
    gains: FlywheelGains

    def ignores_base_pose(self, stage: Int[Array, ""]) -> Bool[Array, ""]:
        """Return whether the robot balances on two feet in this stage; its base then tilts about them."""
        return self.mode[stage] == BALANCE

    def modify_command(self, ctx: TickContext, state: None, command: Command) -> tuple[None, Command]:
        """Put the middle legs under torque control, with their measured angles as joint targets."""
        turning, servo = self.servo_command(ctx.robot, ctx.plan, ctx.stage, ctx.obs)
        joints = jnp.where(turning, ctx.obs.angles, command.joints)  # where position mode takes over from
        return state, command._replace(joints=joints, servo=(turning, servo))

    def servo_command(
        self, robot: Robot, plan: Plan, stage: Int[Array, ""], obs: Observation
    ) -> tuple[Bool[Array, "6 3"], ServoCommand]:
        """Return which joints (6, 3) are under torque control, and the servo law that gives their torques.

        While the robot balances, M_3 = -(c_1 xi_c + c_2 xi_c')/2 - M_g, where xi_c is the distance of the mass centre
        to the left of the planned line. While four feet stand, M_3 = c_5 (beta_3 - pi/2) - c_6 beta_3' - M_g. Leg 4
        follows leg 3 by M_4 = c_3 (beta_4 - beta_3) - c_4 beta_4'. Its drive runs that law as a servo, since c_3 = -5e4
        is too stiff for the control period. (c_4 = 2 sqrt(-c_3) + 100 makes it the drive of (1.2.1).) The law
        compensates the back-EMF of the drives.

        Args:
            robot: the robot, as believed.
            plan: the plan.
            stage: stage number.
            obs: measurement of this tick.

        Returns:
            Mask of the joints (6, 3), and the servo law.
        """
        gains = self.gains
        left = rotate(plan.quat[stage], jnp.array([0.0, 1.0, 0.0], obs.position.dtype))
        place, velocity = measured_centre_of_mass(robot, obs)
        balance = -(gains.c1 * ((place - plan.position[stage]) @ left) + gains.c2 * (velocity @ left)) / 2
        angle = obs.angles[RIGHT]
        level = gains.c5 * wrap_angle(angle - jnp.pi / 2) - gains.c6 * obs.rates[RIGHT]
        torque = jnp.where(self.mode[stage] == BALANCE, balance, level) - leg_weight_moment(robot) * jnp.sin(angle)
        zeros = jnp.zeros_like(obs.angles)
        target = obs.angles[LEFT] + wrap_angle(angle - obs.angles[LEFT])
        servo = ServoCommand(
            target=obs.angles.at[LEFT].set(target),
            stiffness=zeros.at[LEFT].set(-gains.c3),
            damping=zeros.at[RIGHT].set(-gains.back_emf).at[LEFT].set(gains.c4 - gains.back_emf),
            torque=zeros.at[RIGHT].set(torque),
        )
        return jnp.asarray(TURNING) & (self.mode[stage] != LOCKED), servo


def leg_weight_moment(robot: Robot) -> Array | float:
    """Return the moment (N m) of a straight, level leg's weight about its hip."""
    return GRAVITY * (robot.thigh_mass * robot.thigh / 2 + robot.shin_mass * (robot.thigh + robot.shin / 2))


def measured_centre_of_mass(robot: Robot, obs: Observation) -> tuple[Float[Array, " 3"], Float[Array, " 3"]]:
    """Return position (m) and velocity (m/s) of the robot's mass centre from a measurement, world axes.

    Args:
        robot: the robot, as believed.
        obs: the measurement.
    """
    offset, rate = jax.jvp(lambda angles: mass_centre(robot, angles), (obs.angles,), (obs.rates,))
    place = obs.position + rotate(obs.quat, offset)
    return place, obs.velocity + rotate(obs.quat, jnp.cross(obs.spin, offset) + rate)

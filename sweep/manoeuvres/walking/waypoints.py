"""Walking of the hexagonal robot through waypoints by the largest step within reach (thesis, chapters 2 and 3)."""

from typing import ClassVar

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from sweep.controllers.plan import ELLIPTIC, HALF_ELLIPSE, STAND, Plan, Stage
from sweep.core.errors import InputError
from sweep.core.parameters import choice, count, parameters, quantity
from sweep.formulas.thesis import thesis_fk, thesis_step, thesis_workspace
from sweep.manoeuvres.goals import ON_ITS_FEET
from sweep.manoeuvres.walking.walk import level_stance, tilt_plan_to_ground
from sweep.models.case import Case, Manoeuvre
from sweep.models.legs import LEGS
from sweep.models.obstacles.plane import Plane
from sweep.models.posture import leg_directions
from sweep.models.robot import Robot
from sweep.planning.compile_plan import compile_plan

WAYPOINTS = ((0.0, 0.0), (3.0, 2.0), (3.0, 3.5), (8.0, 5.0))  # m, on the ground
# this robot's legs in the order of the thesis, whose leg 1 is 30 deg from x and which counts counter-clockwise
CIRCLE = (6, 4, 2, 1, 3, 5)
TRIPODS = ((6, 2, 3), (4, 1, 5))  # legs 1, 3, 5 of the thesis, which swing first, and 2, 4, 6
IDLE = 0.02  # s, phase of a cycle after arrival, without step or lift


@parameters
class Waypoints(Manoeuvre):
    """Walk straight from each point of `WAYPOINTS` to the next without turning: thesis, chapter 3.

    A cycle has two phases of one step each. In the first, one tripod swings from home to one step ahead in body axes
    while the other carries the body that step on; in the second, they exchange roles. So every cycle starts and ends
    with all feet at home. For robots with radial legs on a circle and a shin longer than the thigh.

    With lengths in metres and T = 1 s, the longest step accelerates the body by 9.24 l/T^2 = 10.7 m/s^2. That needs
    friction above 1; the feet slide by 0.25 m. From T = 1.35 s on they slide by less than 0.02 m at friction 0.7, so
    `conf/manoeuvre/waypoints.yaml` sets 2 s.
    """

    goal: ClassVar = ON_ITS_FEET
    kind: str = choice("waypoints", "waypoints")
    phase_time: float = quantity(1.0, "s", above=0, at_most=20)  # T, time of a step of either tripod
    psi: float = quantity(np.pi / 4, "rad", at_least=-np.pi / 2, at_most=np.pi / 2)  # angle at home, where phi is 0
    gamma: float = quantity(-3 * np.pi / 4, "rad", at_least=-np.pi, at_most=0)  # knee angle at home
    # share of the largest step that is taken; the thesis takes it only where the leg is singular, not at phi_max
    share: float = quantity(0.95, "-", above=0, at_most=1)
    # number of cycles; the robot of the thesis arrives after 7, the rest are idle
    cycles: int = count(9, at_least=1, at_most=100)
    deepening: float = quantity(2e-3, "m", at_least=0, at_most=0.05)  # epsilon, depth of footholds below the ground
    patience: float = quantity(0.1, "s", at_least=0)  # longest wait for a touchdown

    needs = (Plane,)

    def plan(self, belief: Case) -> Plan:
        """Return the plan: stand, two stages per gait cycle, halt.

        At the end, the body goes to the last waypoint even if the steps fell short of it. So a plan with too few
        `cycles` shows as legs out of reach rather than as a success. If thigh and shin vary in a study, plans of rows
        in which they do not fit are not a number, hence invalid.

        Raises:
            InputError: the shin is not longer than the thigh, both plain numbers.
        """
        robot = belief.robot
        if all(isinstance(size, float) for size in (robot.thigh, robot.shin)) and robot.shin <= robot.thigh:
            raise InputError(
                f"robot.shin = {robot.shin:g} is not allowed: greater than robot.thigh = {robot.thigh:g} m for "
                "manoeuvre = waypoints"
            )
        spread, height = self.neutral_foot_position(robot)
        start, centres = level_stance(belief, spread, height)
        lift = height - (robot.shin - robot.thigh)  # m, h: keeps the foot below z = l2 - l3, where OA of (19) grows
        stages = [Stage("stand", STAND)]
        position = start.position
        for k, step in enumerate(self.gait_cycle_steps(robot)):
            moving = jnp.any(step != 0)
            time = jnp.where(moving, self.phase_time, IDLE)
            footing = position + 2 * step + centres - jnp.array([0.0, 0.0, self.deepening])
            for tripod in TRIPODS:
                position = position + step
                landing = {leg: footing[leg - 1] for leg in tripod}
                name = f"{k + 1}.{'-'.join(map(str, tripod))}"
                stages.append(Stage(name, time, landing, HALF_ELLIPSE, moving * lift, position=position, pace=ELLIPTIC))
        stages.append(Stage("halt", 2 * STAND, position=start.position.at[:2].set(jnp.array(WAYPOINTS[-1]))))
        return tilt_plan_to_ground(compile_plan(start, stages, self.patience), belief)

    def neutral_foot_position(self, robot: Robot) -> tuple[Array, Array]:
        """Return a foot's neutral position (m): outward from its hip and at depth H below it: thesis (11)."""
        foot = thesis_fk(0.0, self.psi, self.gamma, robot.coxa, robot.thigh, robot.shin).foot
        return foot[0], -foot[2]

    def gait_cycle_steps(self, robot: Robot) -> Float[Array, "cycles 3"]:
        """Return the step length of each gait cycle (m): the largest possible, or half of the remaining distance if
        shorter."""
        points = jnp.array(WAYPOINTS)

        def cycle(state: tuple[Array, Array], _: None) -> tuple[tuple[Array, Array], Array]:
            position, next_point = state
            remaining = points[next_point] - position
            length = jnp.linalg.norm(remaining)
            direction = jnp.where(length > 0, remaining / jnp.where(length > 0, length, 1.0), jnp.array([1.0, 0.0]))
            largest = self.share * jnp.min(self.largest_step_by_leg(robot, direction))
            arrives = 2 * largest >= length
            step = jnp.where(arrives, remaining / 2, largest * direction)
            position = jnp.where(arrives, points[next_point], position + 2 * step)
            following = jnp.minimum(next_point + arrives, len(WAYPOINTS) - 1)
            return (position, following), jnp.append(step, 0.0)

        return jax.lax.scan(cycle, (points[0], jnp.int32(1)), length=self.cycles)[1]

    def largest_step_by_leg(self, robot: Robot, direction: Float[Array, " 2"]) -> Float[Array, " 6"]:
        """Return the largest step (m) of each leg in a direction, by leg number: thesis (18)-(21).

        Feet of the first tripod step ahead of home and back, those of the second behind home and back. Either segment
        is covered in support once, so the whole segment must be admissible, and the limit of the transfer is never the
        active one.

        Args:
            robot: the robot, as believed.
            direction: unit vector of the body's motion.
        """
        spread, height = self.neutral_foot_position(robot)
        zone = thesis_workspace(-height, robot.coxa, robot.thigh, robot.shin, robot.mount_radius)
        out = leg_directions(robot)[:, :2]
        across = jnp.stack([out[:, 1], -out[:, 0]], axis=-1)  # x axis of the leg's frame, whose y axis points outward
        ahead = jnp.array([1.0 if leg in TRIPODS[0] else -1.0 for leg in LEGS])
        direction_in_leg = ahead[:, None] * jnp.stack([across @ direction, out @ direction], axis=-1)
        foot = jnp.stack([jnp.zeros_like(spread), spread])
        return thesis_step(foot, direction_in_leg, zone.OA, zone.OB, zone.phimax).support

"""Walking on level or tilted ground by a regular gait (monograph 1.3)."""

from collections.abc import Callable
from typing import ClassVar

import jax.numpy as jnp
from jaxtyping import Array

from sweep.controllers.plan import STAND, Plan, Stage, transform_plan
from sweep.core.parameters import choice, count, parameters, quantity
from sweep.core.rotations import IDENTITY, exponential
from sweep.manoeuvres.goals import ON_ITS_FEET
from sweep.models.case import Case, Manoeuvre
from sweep.models.obstacles.plane import Plane
from sweep.models.posture import Stance, foot_centres
from sweep.planning.compile_plan import compile_plan
from sweep.planning.gaits import GAITS, MEANINGS, GaitStep, initial_foot_offsets, regular_gait_stages


@parameters
class Walk(Manoeuvre):
    """Walk straight along the world's x axis, uphill on a slope.
    Ratios are to the body length a_r."""

    goal: ClassVar = ON_ITS_FEET
    kind: str = choice("walk", "walk")
    gait: str = choice("tripod", **MEANINGS)  # which legs swing together, and in which order
    steps: int = count(7, at_least=1, at_most=200)  # number of swings, t* each
    half_step_ratio: float = quantity(0.1, "a_r", above=0, at_most=0.5)  # d_x, half the length of a swing
    lift_ratio: float = quantity(0.03, "a_r", above=0, at_most=0.5)  # d_y, height of a swing
    height_ratio: float = quantity(0.5, "a_r", above=0, at_most=2)  # d, height of the hips above the ground
    spread_ratio: float = quantity(0.3, "a_r", at_least=0, at_most=2)  # distance of feet outward from their hips
    rate: float = quantity(3.0, "rad/s", above=0, at_most=20)  # varpi, rate of the swings, which gives their time t*
    deepening: float = quantity(2e-3, "m", at_least=0, at_most=0.05)  # epsilon, depth of footholds below the ground
    patience: float = quantity(0.1, "s", at_least=0)  # longest wait for a touchdown

    needs = (Plane,)

    def plan(self, belief: Case) -> Plan:
        """Return the plan: stand, `steps` swings, stand, with the base parallel to the believed ground."""
        start, swings = self.swing_stages(belief, lambda centres: 0.0)
        plan = compile_plan(start, [Stage("stand", STAND), *swings, Stage("halt", 2 * STAND)], self.patience)
        return tilt_plan_to_ground(plan, belief)

    def swing_stages(self, belief: Case, start_offset: Callable[[Array], Array | float]) -> tuple[Stance, list[Stage]]:
        """Return the start stance and the plan stages of all swings on level ground.

        Args:
            belief: believed parameters.
            start_offset: gives, from the feet relative to the base (m), how far (m) behind the origin the robot starts.
        """
        length, gait, forward = belief.robot.body_length, GAITS[self.gait], jnp.array([1.0, 0.0, 0.0])
        step = GaitStep.from_ratios(length, self.half_step_ratio, self.lift_ratio, self.rate)
        start, centres = level_stance(belief, self.spread_ratio * length, self.height_ratio * length)
        behind = start_offset(centres) * forward
        feet = start.feet + initial_foot_offsets(gait, step, forward) - behind
        start = start._replace(feet=feet, position=start.position - behind)
        return start, regular_gait_stages(gait, step, start, centres, forward, self.steps, self.deepening)


@parameters
class Stand(Manoeuvre):
    """Stand still, for studies of pushes from outside."""

    goal: ClassVar = ON_ITS_FEET
    kind: str = choice("stand", "stand")
    duration: float = quantity(4.0, "s", above=0)  # time of standing
    height_ratio: float = quantity(0.5, "a_r", above=0, at_most=2)  # d, height of the hips above the ground
    spread_ratio: float = quantity(0.3, "a_r", at_least=0, at_most=2)  # distance of feet outward from their hips

    needs = (Plane,)

    def plan(self, belief: Case) -> Plan:
        """Return a plan with one stage in which all feet stand."""
        length = belief.robot.body_length
        start, _ = level_stance(belief, self.spread_ratio * length, self.height_ratio * length)
        return tilt_plan_to_ground(compile_plan(start, [Stage("stand", self.duration)], 0.0), belief)


def level_stance(belief: Case, spread: Array | float, height: Array | float) -> tuple[Stance, Array]:
    """Return a stance over the origin of level ground, and the foot positions relative to the base (m).

    Args:
        belief: has the robot.
        spread: distance of feet outward from their hips (m).
        height: of the hips above the ground (m).
    """
    centres = foot_centres(belief.robot, spread, height)
    position = jnp.array([0.0, 0.0, 1.0]) * height
    return Stance(position + centres, position, jnp.array(IDENTITY)), centres


def tilt_plan_to_ground(plan: Plan, belief: Case) -> Plan:
    """Return a plan that was made for level ground, rotated to the slope that the controller believes in."""
    return transform_plan(
        plan, exponential(jnp.array([0.0, -1.0, 0.0]) * belief.obstacle_of_type(Plane).slope), jnp.zeros(3)
    )

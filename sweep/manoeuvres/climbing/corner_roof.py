"""From the walls of a corner over its edge on to the roof (monograph 2.4.3), with planned foot forces.

World axes as in `corner`. The roof is a wedge: at a distance d behind its tip it is 2 d tan psi wide.

The part `roof` of the plan file replaces the printed sequence of events (table 2.1). Its lengths are in `length_unit`s:
measured by the body, they would be out of reach for robots with legs 2 % shorter than the body suggests.
"""

import math
from dataclasses import replace
from typing import ClassVar

import jax.numpy as jnp
from jax.core import Tracer
from jaxtyping import Array, Float

from sweep.controllers.plan import CYCLE_B_SMOOTH, SMOOTH, Stage
from sweep.core.errors import InputError
from sweep.core.parameters import choice, count, parameters, quantity
from sweep.formulas.leg import SIDE_BY_LEG
from sweep.manoeuvres.climbing.corner import CornerManoeuvre
from sweep.manoeuvres.goals import UPRIGHT
from sweep.models.case import Case
from sweep.models.obstacles.charts import stack_components
from sweep.models.obstacles.corner import Corner
from sweep.models.posture import Stance
from sweep.models.robot import length_unit
from sweep.planning.gaits import TRIPOD
from sweep.planning.moves import plan_part_stages, read_moves
from sweep.planning.plan_table import SIZES, evaluate_plan

MOST_RISE = 0.28  # a_r, rise of one cycle of the gallop; from 0.35 on front and middle legs cross
# a_r, least distance along y of feet on the roof behind its edges
BRINK = 0.05
NARROWEST = 0.28  # a_r, least half distance between a pair's feet on the roof


@parameters
class CornerRoof(CornerManoeuvre):
    """Climb the corner of a house from the floor, and get over its edge on to the roof.

    For houses that reach above the front feet at the start of the gallop, which covers the rest in `cycles`.
    """

    goal: ClassVar = UPRIGHT
    kind: str = choice("corner_roof", "corner_roof")
    cycles: int = count(2, at_least=1, at_most=100)  # cycles of the gallop, which rises to the height of the house

    default_plan_name = "corner_roof"

    def route_stages(self, belief: Case) -> tuple[Stance, list[Stage]]:
        """Return the start stance and the plan stages: climb until the front feet are below the edge, then get over it.

        If the height varies in a study, plans of rows in which the house is too low are not a number, hence invalid.

        Raises:
            InputError: the house is too low, or too high for the cycles, both plain numbers.
        """
        sizes = evaluate_plan(belief, SIZES).get(SIZES, {})
        if "rise" not in sizes:
            raise InputError(f"plan.{SIZES}.rise is missing")
        rise = sizes["rise"]
        if not isinstance(rise, Tracer):
            unit = length_unit(belief.robot)
            self.validate(belief, float(rise * unit), float(MOST_RISE * belief.robot.body_length))
        changed_plan = belief.plan.increment_number(f"{SIZES}.rise", jnp.where(rise >= 0, 0.0, jnp.nan))
        start, stages, standing = self.climb_stages(replace(belief, plan=changed_plan))
        roof, _ = plan_part_stages("roof", self.move_context(belief), standing)
        return start, [*stages, *roof]

    def validate(self, belief: Case, rise: float, most: float) -> None:
        """Raise an error unless the gallop can raise the base by `rise` (m).

        Args:
            belief: believed parameters.
            rise: of the whole gallop (m).
            most: largest rise of a cycle (m).

        Raises:
            InputError: the house is too low, or too high for the cycles.
        """
        top, needed = belief.obstacle_of_type(Corner).height, math.ceil(rise / most)
        if rise < 0:
            least = math.ceil(100 * (top - rise)) / 100
            raise InputError(
                f"obstacle.height = {top:g} is not allowed: at least {least:g} m for manoeuvre = {self.kind}"
            )
        if needed > self.cycles:
            raise InputError(
                f"manoeuvre.cycles = {self.cycles} is not allowed: at least {needed} for obstacle.height = {top:g} m"
            )


@parameters
class CornerFull(CornerRoof):
    """Climb the corner of a house from the floor on to the roof, and walk some steps on the roof."""

    kind: str = choice("corner_full", "corner_full")
    steps: int = count(10, at_least=0, at_most=100)  # number of swings by tripod on the roof
    # motion of the base in each swing, from the third on
    roof_step_ratio: float = quantity(0.1, "a_r", above=0, at_most=0.3)

    def route_stages(self, belief: Case) -> tuple[Stance, list[Stage]]:
        """Return the start stance and the plan stages: on to the roof, then some steps."""
        start, stages = super().route_stages(belief)
        return start, [*stages, *self.roof_stages(belief)]

    def roof_stages(self, belief: Case) -> list[Stage]:
        """Return the plan stages of the tripod steps on the roof.

        Tracks narrow with the roof. In the first two swings the feet go beside their hips and the base rests: farther
        ahead, middle feet would meet the front legs.
        """
        context, stages, length = self.move_context(belief), [], belief.robot.body_length
        stride, height = (
            self.roof_step_ratio * length,
            belief.obstacle_of_type(Corner).height + self.height_ratio * context.unit,
        )
        *_, last = read_moves(belief, "roof").values()
        base = context.base_pose_at(last.base, last.path)[0][1]
        for k in range(self.steps):
            advance = stride if k >= len(TRIPOD) else 0.0
            base = base - advance
            swing = {}
            for leg in TRIPOD[k % 2]:
                hip = base - advance / 2 + (1 - (leg - 1) // 2) * length / 2
                swing[leg] = roof_foothold(belief, leg, hip, self.floor_track_ratio * context.unit)
            stages.append(Stage(f"on{k + 1}", context.time, swing, CYCLE_B_SMOOTH, context.lift, pace=SMOOTH,
                                position=stack_components(0.0, base, height)))  # fmt: skip
        return stages


def roof_foothold(belief: Case, leg: int, y: Array | float, aside: Array | float) -> Float[Array, " 3"]:
    """Return a foothold (m) beside a hip on the roof, moved back to where the roof is wide enough.

    Args:
        belief: believed parameters.
        leg: leg number.
        y: of the hip (m).
        aside: distance from the middle of the roof (m), at most.
    """
    slope, length = jnp.tan(belief.obstacle_of_type(Corner).half_angle), belief.robot.body_length
    y = jnp.minimum(y, -BRINK * length - NARROWEST * length / slope)
    aside = jnp.minimum(aside, slope * (-y - BRINK * length))
    return stack_components(float(SIDE_BY_LEG[leg - 1]) * aside, y, belief.obstacle_of_type(Corner).height)

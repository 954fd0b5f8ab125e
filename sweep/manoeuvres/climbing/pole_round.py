"""Up a pole, sideways round it, and backwards down on to the ledge behind it (monograph 2.3.4 and 2.3.6).

For ledges so low that the robot hangs above them on the pole: h - h1 > a + x*. World axes as in `pole`.
"""

from dataclasses import replace
from typing import ClassVar

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from sweep.controllers.plan import CYCLE_B, STAND, Plan, Stage, transform_plan
from sweep.core.parameters import choice, count, parameters
from sweep.core.rotations import exponential, rotate
from sweep.manoeuvres.climbing.pole import PoleManoeuvre
from sweep.manoeuvres.goals import UPRIGHT
from sweep.models.case import Case
from sweep.models.obstacles.charts import stack_components
from sweep.models.obstacles.pole_ledge import PoleLedge
from sweep.models.posture import Stance
from sweep.models.robot import length_unit
from sweep.planning.compile_plan import compile_plan
from sweep.planning.gaits import GALLOP, GaitStep
from sweep.planning.plan_table import SIZES
from sweep.planning.symmetry import join_plans, last_stance, mirror_plan, reverse_in_time

STEP = np.pi / 8  # sigma, angle round the pole that the base covers in 3 t*; printed as pi/6 in 2 t*
HALF_TURN = (0.0, 0.0, np.pi)  # rotation vector of the half turn to the ledge's side


@parameters
class PoleRound(PoleManoeuvre):
    """Climb the pole, go half-way round it by gallop, descend backwards on to the ledge, and walk away.

    The way down is the climb backwards in time, from the other side and above the ledge's height. The book calls it the
    reverse of 2.3.3, the way on to the top, but means 2.3.2, since the robot goes to the ledge.
    """

    goal: ClassVar = UPRIGHT
    kind: str = choice("pole_round", "pole_round")
    cycles: int = count(3, at_least=1, at_most=100)  # cycles of the gallop, enough to get above the ledge
    side: str = choice("left", "left", "right")  # side on which the robot goes round the pole, as seen on arrival
    down_cycles: int = count(1, at_least=0, at_most=100)  # cycles of the gallop backwards, 3 x* each

    def plan(self, belief: Case) -> Plan:
        """Return the plan: climb, go round the pole, and descend by the reversed climb from the ledge."""
        step, ledge, away = (
            self.approach_gait_step(belief),
            belief.obstacle_of_type(PoleLedge).ledge_height,
            replace(self, cycles=self.down_cycles),
        )
        # The gap of x* keeps the front feet on the ledge: without it they would stand beside the pole, beyond its edge.
        start, stages, _ = away.climb_stages(replace(belief, manoeuvre=away), step.half_swing_length)
        from_ledge = compile_plan(start, stages, self.patience)
        rise = (ledge + 3 * self.down_cycles * step.half_swing_length) / (3 * self.cycles * length_unit(belief.robot))
        start, stages, _ = self.climb_stages(replace(belief, plan=belief.plan.replace_number(f"{SIZES}.rise", rise)))
        up = compile_plan(start, stages, self.patience)
        top = last_stance(up)
        across = compile_plan(top, [Stage("hang", STAND), *half_turn_stages(step, top)], self.patience)
        down = transform_plan(
            reverse_in_time(from_ledge), exponential(jnp.array(HALF_TURN)), stack_components(0.0, 0.0, ledge)
        )
        plan = join_plans(up, across, down)
        return plan if self.side == "left" else mirror_plan(plan, np.array([1.0, 0.0, 0.0]))


def half_turn_stages(step: GaitStep, start: Stance) -> list[Stage]:
    """Return the plan stages of a half turn round the pole: leg pairs step in turn while the base turns evenly.

    Printed for tripods. The three standing feet then press unevenly, since the base turns a little while only three
    hold it: feet that land 2 mm off carry nothing when it is their turn to hold, and the robot falls. The pairs of the
    gallop hold it as on the way up. A swing is lifted radially from the pole; the printed directions are those to the
    nearest quarter.

    Args:
        step: the regular step.
        start: stance on the pole, world axes.
    """
    feet, position = start.feet, start.position
    advance = STEP / len(GALLOP)
    axis, turn = stack_components(0.0, 0.0, position[2]), stack_components(0.0, 0.0, advance)
    stages = []
    for k in range(round(np.pi / advance)):
        legs = GALLOP[k % 3]
        swing = {leg: rotate_about_pole(feet[leg - 1], STEP) for leg in legs}
        away = jnp.stack([rotate_about_pole(foot, STEP / 2) for foot in feet]).at[:, 2].set(0.0)
        position = rotate_about_pole(position, advance)
        name = f"round{k // 3 + 1}.{('front', 'middle', 'rear')[k % 3]}"
        stages.append(Stage(name, step.time, swing, CYCLE_B, 1.5 * step.height, away, position=position,
                            turn=turn, pivot=axis, arc=advance))  # fmt: skip
        for leg in legs:
            feet = feet.at[leg - 1].set(swing[leg])
    return stages


def rotate_about_pole(place: Array, angle: float) -> Array:
    """Return a point (m) turned about the pole's axis by an angle (rad)."""
    return rotate(exponential(stack_components(0.0, 0.0, angle)), place)

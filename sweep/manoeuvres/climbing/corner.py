"""Up the corner of a house (monograph 2.4.2), with planned foot forces.

World axes: the corner's edge stands along z at the origin and the robot comes along -y. The book's xi and zeta are x
and z; its eta counts from the middle between the tracks on the walls. The plan file has the parts `arrive`, `climb` and
`gallop`.
"""

from abc import abstractmethod
from typing import ClassVar

import jax.numpy as jnp

from sweep.controllers.plan import STAND, Plan, Stage
from sweep.core.parameters import choice, count, parameters, quantity
from sweep.manoeuvres.climbing.walking import FACING_MINUS_Y
from sweep.manoeuvres.goals import ON_ITS_FEET
from sweep.models.case import Case
from sweep.models.obstacles.charts import rearing_base_chart
from sweep.models.obstacles.corner import Corner
from sweep.models.posture import Stance
from sweep.models.robot import length_unit
from sweep.planning.compile_plan import compile_plan
from sweep.planning.forces import PlannedForces
from sweep.planning.gaits import GaitStep
from sweep.planning.moves import MoveContext, StandingState, initial_stance, plan_part_stages
from sweep.planning.symmetry import apply_plan_direction


@parameters
class CornerManoeuvre(PlannedForces):
    """Base class of manoeuvres that climb the corner of a house.
    Ratios are to the length a_r: thigh plus shin, times 1.23.

    Here a_r is `length_unit` where legs have to reach, and the body's length for the rise of a gallop and roof steps.
    The book measures everything by the body; legs shorter than the body suggests then do not reach their footholds.
    """

    cycles: int = count(1, at_least=0, at_most=100)  # cycles of the gallop up the corner
    anchoring: float = quantity(0.03, "s", above=0)  # time constant with which footholds follow the measured feet
    # x_f, half the distance between the tracks on the walls
    track_ratio: float = quantity(1 / 3, "a_r", above=0, at_most=1)
    # eta_f, distance of the vertical base from the middle between the tracks
    standoff_ratio: float = quantity(0.39, "a_r", above=0, at_most=2)
    # least distance of the vertical base from the corner's edge; a sharper edge takes a larger one
    edge_gap: float = quantity(8e-3, "m", at_least=0, at_most=1)
    # half the distance between the feet on the floor
    floor_track_ratio: float = quantity(0.44, "a_r", above=0, at_most=1)
    span_ratio: float = quantity(1.3, "a_r", above=0, at_most=3)  # distance from the rear to the front feet on the wall
    # distance along the wall from the middle feet to the pair that swings next
    near_ratio: float = quantity(0.24, "a_r", above=0, at_most=1)
    height_ratio: float = quantity(0.5, "a_r", above=0, at_most=2)  # zeta_f, height of the base above the floor
    half_step_ratio: float = quantity(0.1, "a_r", above=0, at_most=0.5)  # d_x, half the length of a swing
    lift_ratio: float = quantity(0.05, "a_r", above=0, at_most=0.5)  # d_y, height of a swing
    rate: float = quantity(3.0, "rad/s", above=0, at_most=20)  # varpi, rate of the swings, which gives their time t*
    patience: float = quantity(0.5, "s", at_least=0)  # longest wait for a touchdown

    needs = (Corner,)
    two_way: ClassVar = True
    default_plan_name = "corner"

    def move_context(self, belief: Case) -> MoveContext:
        """Return the coordinate systems and directions for moves in the plan file, on floor and walls.

        The chart `edges` is for a base that pitches up before the corner.
        """
        unit = length_unit(belief.robot)
        step = GaitStep.from_ratios(unit, self.half_step_ratio, self.lift_ratio, self.rate)
        return MoveContext(
            belief, unit, step.time, step.height, extra_charts={"edges": rearing_base_chart(belief.robot.body_length)}
        )

    def climb_stages(self, belief: Case) -> tuple[Stance, list[Stage], StandingState]:
        """Return the start stance, the plan stages to the end of the gallop up the corner, and feet and base then."""
        context = self.move_context(belief)
        places, position, standing = initial_stance("arrive", context)
        climb, standing = plan_part_stages("climb", context, standing, "")
        gallop, standing = plan_part_stages("gallop", context, standing, "gallop")
        return Stance(places, position, jnp.array(FACING_MINUS_Y)), [*climb, *gallop], standing

    def plan(self, belief: Case) -> Plan:
        """Return the plan with its planned forces: stand, climb, halt."""
        start, stages = self.route_stages(belief)
        stages = [Stage("stand", STAND), *self.insert_load_transfers(stages), Stage("halt", STAND)]
        return self.add_force_feedforward(
            belief, apply_plan_direction(belief, compile_plan(start, stages, self.patience))
        )

    @abstractmethod
    def route_stages(self, belief: Case) -> tuple[Stance, list[Stage]]:
        """Return the start stance and the plan stages of the whole way, from the floor to the end."""


@parameters
class CornerClimb(CornerManoeuvre):
    """Climb up the corner of a house by the modified gallop.

    Forces are planned (`PlannedForces`), where the book presses the feet into the walls by a fixed depth: before every
    swing, the feet that are to swing are unloaded, and standing feet are commanded to where they are. x_f is a_r/3 and
    eta_f 0.39 a_r, which need less friction than the book's 0.374 a_r. The plan file lists the other differences from
    the printed plan.
    """

    goal: ClassVar = ON_ITS_FEET
    kind: str = choice("corner_climb", "corner_climb")
    rise_ratio: float = quantity(0.14, "a_r", at_least=0, at_most=100)  # rise of the whole gallop

    def route_stages(self, belief: Case) -> tuple[Stance, list[Stage]]:
        """Return the start stance and the plan stages until the end of the gallop."""
        return self.climb_stages(belief)[:2]

"""From the floor on to a pole and up it (monograph 2.3.1 and 2.3.2 of section 2.3.2, "Construction of the motion").

World axes: the pole stands along z at the origin and the robot comes along -y. The book's xi, eta, zeta are x, y, z.
The plan file has the parts from the arrival on: `arrive`, `climb` and `gallop`.
"""

from typing import ClassVar

from jaxtyping import Array

from sweep.controllers.plan import STAND, Plan, Stage
from sweep.core.parameters import choice, count, parameters, quantity
from sweep.manoeuvres.climbing.walking import approach_stages
from sweep.manoeuvres.goals import ON_ITS_FEET
from sweep.models.case import Case
from sweep.models.legs import LEGS
from sweep.models.obstacles.charts import edge_chart, rearing_base_chart
from sweep.models.obstacles.pole_ledge import PoleLedge
from sweep.models.posture import Stance
from sweep.models.robot import length_unit
from sweep.planning.compile_plan import compile_plan
from sweep.planning.forces import PlannedForces
from sweep.planning.gaits import GaitStep
from sweep.planning.moves import MoveContext, StandingState, initial_stance, plan_part_stages
from sweep.planning.symmetry import apply_plan_direction

PRESS = "press"  # law of moves that press feet in, which are left out where planned forces hold them


@parameters
class PoleManoeuvre(PlannedForces):
    """Base class of manoeuvres on a pole: walk to it by tripod, and climb it by gallop.
    Ratios are to the length a_r: thigh plus shin, times 1.23.

    Feet press on the pole by footholds inside it, as printed, or by planned forces.

    For robots with legs along their sides, and poles of radius 0.32 to 0.52 a_r. Differences from the printed plan,
    besides those in the plan file:

    - `front_ahead`, see there.
    - d_c is printed as 0.47 a_r, with which the base touches poles thicker than 0.45 a_r.
    - Feet on the floor keep their distance from the hips whatever the pole. Printed is the pole's radius, with which
      knees meet in front of thin poles.
    """

    steps: int = count(4, at_least=0, at_most=100)  # number of swings of the approach, 2 x* each
    cycles: int = count(3, at_least=0, at_most=100)  # cycles of the gallop, 3 x* each
    half_step_ratio: float = quantity(0.1, "a_r", above=0, at_most=0.5)  # d_x, half the length of a swing
    lift_ratio: float = quantity(0.03, "a_r", above=0, at_most=0.5)  # d_y, height of a swing
    height_ratio: float = quantity(0.5, "a_r", above=0, at_most=2)  # d, height of the base above the floor
    # d_c - r, gap between the hanging base's centre and the pole
    gap_ratio: float = quantity(0.07, "a_r", at_least=0, at_most=2)
    # distance of feet on the floor from their hips, sideways
    spread_ratio: float = quantity(0.175, "a_r", above=0, at_most=1)
    # Distance in front of the pole's axis at which the front feet first touch it. With the printed 0 and the printed
    # pitch, the shins are 34 mm inside the pole. A foot that touches it at the angle psi in front of its side needs a
    # friction of tan(psi) to stay (2.1), so a larger distance than the shins need is no better.
    front_ahead: float = quantity(0.47, "r", at_least=0, at_most=1)
    # increase of that distance for each a_r by which the pole's radius exceeds 0.4 a_r
    front_ahead_slope: float = quantity(1.5, "r/a_r", at_least=0, at_most=10)
    rate: float = quantity(3.0, "rad/s", above=0, at_most=20)  # varpi, rate of the swings, which gives their time t*
    deepening: float = quantity(5e-3, "m", at_least=0, at_most=0.05)  # epsilon, depth of footholds inside the pole
    patience: float = quantity(0.1, "s", at_least=0)  # longest wait for a touchdown
    # how feet press on: by footholds inside the pole, or by planned forces
    forces: str = choice("deepening", "deepening", "planned")

    needs = (PoleLedge,)
    default_plan_name = "pole"

    def approach_gait_step(self, belief: Case) -> GaitStep:
        """Return length, lift and duration of the swings in the approach; swings on the pole use them too."""
        return GaitStep.from_ratios(length_unit(belief.robot), self.half_step_ratio, self.lift_ratio, self.rate)

    def move_context(self, belief: Case) -> MoveContext:
        """Return the coordinate systems and directions for moves in the plan file, on floor and pole.

        The chart `edges` is for a base that pitches up before the pole, `hang` for one that is upright beside it.
        """
        unit, step = length_unit(belief.robot), self.approach_gait_step(belief)
        hang = edge_chart(lambda pole: (pole.radius + self.gap_ratio * unit, pole.height))
        charts = {"edges": rearing_base_chart(belief.robot.body_length), "hang": hang}
        return MoveContext(belief, unit, step.time, step.height, {"side": self.deepening}, charts, laws=(PRESS,))

    def climb_stages(self, belief: Case, gap: Array | float = 0.0) -> tuple[Stance, list[Stage], StandingState]:
        """Return the start stance, the plan stages to the end of the gallop up the pole, and feet and base then.

        Args:
            belief: believed parameters.
            gap: as in `approach_stages` (m).
        """
        context, step = self.move_context(belief), self.approach_gait_step(belief)
        places, arrival, standing = initial_stance("arrive", context)
        spread = self.spread_ratio * context.unit
        start, walk = approach_stages(
            belief, step, arrival, spread, dict(zip(LEGS, places, strict=True)), self.steps, gap
        )
        climb, standing = plan_part_stages("climb", context, standing, "")
        gallop, standing = plan_part_stages("gallop", context, standing, "gallop")
        return start, [Stage("stand", STAND), *walk, *self.insert_load_transfer_rests([*climb, *gallop])], standing

    def insert_load_transfer_rests(self, stages: list[Stage]) -> list[Stage]:
        """Return the plan stages, with rests in which load moves between feet if foot forces are planned."""
        return self.insert_load_transfers(stages) if self.forces == "planned" else stages


@parameters
class PoleClimb(PoleManoeuvre):
    """Walk by tripod to the pole, and climb it by gallop."""

    goal: ClassVar = ON_ITS_FEET
    two_way: ClassVar = True
    kind: str = choice("pole_climb", "pole_climb")

    def plan(self, belief: Case) -> Plan:
        """Return the plan: climb and halt, with planned forces if configured."""
        start, stages = self.route_stages(belief)
        plan = apply_plan_direction(belief, compile_plan(start, [*stages, Stage("halt", STAND)], self.patience))
        return self.add_force_feedforward(belief, plan) if self.forces == "planned" else plan

    def route_stages(self, belief: Case) -> tuple[Stance, list[Stage]]:
        """Return the start stance and the plan stages of the climb."""
        return self.climb_stages(belief)[:2]

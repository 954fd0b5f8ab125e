"""From the floor on to a pole and up it (monograph 2.3.1 and 2.3.2 of section 2.3.2, "Construction of the motion").

World axes: the pole stands along z at the origin and the robot comes along -y. The book's xi, eta, zeta are x, y, z.
The way from where the pole is reached is in the plan's file: its parts `arrive`, `climb` and `gallop`.
"""

from typing import ClassVar

from jaxtyping import Array

from sweep.controllers.compile_plan import compile_plan
from sweep.controllers.forces import PlannedForces
from sweep.controllers.frames import Stance
from sweep.controllers.gaits import Step
from sweep.controllers.manoeuvres.climbing.walking import approach_stages
from sweep.controllers.manoeuvres.goals import ON_ITS_FEET
from sweep.controllers.moves import MoveContext, Standing, initial_stance, part_stages
from sweep.controllers.plan import STAND, Plan, Stage
from sweep.controllers.symmetry import apply_direction
from sweep.core.parameters import choice, count, parameters, quantity
from sweep.models.case import Case
from sweep.models.legs import LEGS
from sweep.models.obstacles.charts import ahead_above, rearing
from sweep.models.obstacles.pole_ledge import PoleLedge
from sweep.models.robot import leg_unit

PRESS = "press"  # law of moves for feet that are pressed in, left out where planned forces hold them


@parameters
class OnPole(PlannedForces):
    """What manoeuvres on a pole have in common: by tripod to it, on to it, and up it by gallop. Ratios are to a_r.

    The feet are pressed on to the pole by footholds inside it, as printed, or by planned forces.

    For robots with legs along their sides, and poles from 0.32 to 0.52 a_r. What differs from the printed plan, and
    why: what the plan's file says, and `front_ahead`; d_c, printed 0.47 a_r, where the base touches poles thicker than
    0.45 a_r; and feet on the floor stay as far from the hips whatever the pole, printed at its radius, where knees meet
    before thin poles.
    """

    steps: int = count(4, at_least=0, at_most=100)  # swings of the approach, 2 x* each
    cycles: int = count(3, at_least=0, at_most=100)  # of the gallop, 3 x* each
    # d_x, half of what a foot moves ahead in a swing
    half_step_ratio: float = quantity(0.1, "a_r", above=0, at_most=0.5)
    lift_ratio: float = quantity(0.03, "a_r", above=0, at_most=0.5)  # d_y, how high a swinging foot is lifted
    height_ratio: float = quantity(0.5, "a_r", above=0, at_most=2)  # d, of the base above the floor
    gap_ratio: float = quantity(0.07, "a_r", at_least=0, at_most=2)  # d_c - r
    spread_ratio: float = quantity(0.175, "a_r", above=0, at_most=1)  # of feet on the floor from their hips, sideways
    # How far in front of the pole's axis the front feet first touch it, and how much more for every a_r by which r
    # passes 0.4 a_r. With the printed 0, and the printed pitch, their shins are 34 mm inside the pole. A foot that
    # touches it at the angle psi in front of its side needs a friction of tan(psi) to stay there (2.1): farther ahead
    # than shins need is no better.
    front_ahead: float = quantity(0.47, "r", at_least=0, at_most=1)
    # by how much more for each a_r that the pole's radius is above 0.4 a_r
    front_ahead_slope: float = quantity(1.5, "r/a_r", at_least=0, at_most=10)
    rate: float = quantity(3.0, "rad/s", above=0, at_most=20)  # varpi, of the swings, whose time t* it gives
    deepening: float = quantity(5e-3, "m", at_least=0, at_most=0.05)  # epsilon, footholds inside the pole
    patience: float = quantity(0.1, "s", at_least=0)  # longest wait for a touchdown
    # what presses feet on: footholds inside the pole, or forces planned for every stance
    forces: str = choice("deepening", "deepening", "planned")

    needs = (PoleLedge,)
    own_plan = "pole"

    def regular_step(self, belief: Case) -> Step:
        """Of the approach; swings on the pole are as long and as high."""
        return Step.from_ratios(leg_unit(belief.robot), self.half_step_ratio, self.lift_ratio, self.rate)

    def move_context(self, belief: Case) -> MoveContext:
        """Of moves; charts `edges` and `hang` are for a base that pitches up before the pole, and upright beside it."""
        unit, step = leg_unit(belief.robot), self.regular_step(belief)
        hang = ahead_above(lambda pole: (pole.radius + self.gap_ratio * unit, pole.height))
        own = {"edges": rearing(belief.robot.body_length), "hang": hang}
        return MoveContext(belief, unit, step.time, step.height, {"side": self.deepening}, own, laws=(PRESS,))

    def climb_stages(self, belief: Case, gap: Array | float = 0.0) -> tuple[Stance, list[Stage], Standing]:
        """Stand, go to the pole, get on and gallop up; where it stands then. `gap` (m) is as in `walk_up`."""
        context, step = self.move_context(belief), self.regular_step(belief)
        places, arrival, standing = initial_stance("arrive", context)
        spread = self.spread_ratio * context.unit
        start, walk = approach_stages(
            belief, step, arrival, spread, dict(zip(LEGS, places, strict=True)), self.steps, gap
        )
        climb, standing = part_stages("climb", context, standing, "")
        gallop, standing = part_stages("gallop", context, standing, "gallop")
        return start, [Stage("stand", STAND), *walk, *self.with_rests([*climb, *gallop])], standing

    def with_rests(self, stages: list[Stage]) -> list[Stage]:
        """With planned forces, `stages` with a rest before each of them for the load to go over."""
        return self.with_load_transfer(stages) if self.forces == "planned" else stages


@parameters
class PoleClimb(OnPole):
    """By tripod to the pole, on to it, and up it by gallop."""

    goal: ClassVar = ON_ITS_FEET
    two_way: ClassVar = True
    kind: str = choice("pole_climb", "pole_climb")

    def plan(self, belief: Case) -> Plan:
        """The way and a halt, with its forces if they are planned."""
        start, stages = self.route(belief)
        plan = apply_direction(belief, compile_plan(start, [*stages, Stage("halt", STAND)], self.patience))
        return self.with_feedforward(belief, plan) if self.forces == "planned" else plan

    def route(self, belief: Case) -> tuple[Stance, list[Stage]]:
        """The climb to the end of the gallop."""
        return self.climb_stages(belief)[:2]

"""From the floor up a leaning ladder on to the ledge behind it, and away by tripod (monograph 2.5).

World axes and the ladder's own axes as in `sweep/models/obstacles/ladder.py`: the robot comes along -y, and the
ladder's axes are turned against the world's about x. Feet on rungs, and the base while it is along the ladder, are
planned in the ladder's axes, so the robot climbs the ladder where it is measured, whatever lean was believed.
"""

from typing import ClassVar

import jax.numpy as jnp

from sweep.controllers.plan import Plan, Stage
from sweep.core.errors import InputError
from sweep.core.parameters import choice, count, parameters, quantity
from sweep.formulas.ladder import ladder as statics
from sweep.fused.numbers import evaluate_with_numpy
from sweep.manoeuvres.climbing.walking import approach_stages, departure_stages
from sweep.manoeuvres.goals import UPRIGHT
from sweep.models.case import Case
from sweep.models.legs import LEGS
from sweep.models.obstacles.charts import stack_components
from sweep.models.obstacles.ladder import Ladder
from sweep.models.robot import length_unit, total_mass
from sweep.planning.compile_plan import compile_plan
from sweep.planning.forces import MIN_SLACK, PlannedForces
from sweep.planning.gaits import GaitStep
from sweep.planning.moves import MoveContext, initial_stance, plan_part_stages, read_moves
from sweep.planning.symmetry import apply_plan_direction
from sweep.planning.validation import are_plain_numbers, require_within_reach, stances_at_stage_ends

GAP = 0.15  # leg units, before arrival, that the base covers while the feet take their places at the ladder
AWAY = 0.72  # leg units, position of the base behind the ledge's edge when it starts to walk away


@parameters
class LadderClimb(PlannedForces):
    """Walk by tripod to a leaning ladder, climb it and step over its top on to the ledge, and walk away.

    Feet hold on by planned forces. Ratios are to a_r.
    """

    goal: ClassVar = {**UPRIGHT, "obstacle_shift_max_m": 1e-3, "obstacle_turn_max_rad": 1e-3}
    kind: str = choice("ladder_climb", "ladder_climb")
    settle: float = quantity(1.5, "s", above=0, at_most=60)  # time that the robot waits for the ladder to come to rest
    steps: int = count(2, at_least=0, at_most=100)  # number of swings of the approach, 2 x* each
    steps_away: int = count(3, at_least=0, at_most=100)  # number of swings on the ledge, 2 x* each
    half_step_ratio: float = quantity(0.1, "a_r", above=0, at_most=0.5)  # d_x, half the length of a swing
    lift_ratio: float = quantity(0.03, "a_r", above=0, at_most=0.5)  # d_y, height of a swing
    height_ratio: float = quantity(0.5, "a_r", above=0, at_most=2)  # d, height of the base above floor and ledge
    # distance of walking feet from their hips, sideways
    spread_ratio: float = quantity(0.262, "a_r", above=0, at_most=1)
    rate: float = quantity(3.0, "rad/s", above=0, at_most=20)  # varpi, rate of the swings, which gives their time t*
    deepening: float = quantity(5e-4, "m", at_least=0, at_most=0.05)  # depth of footholds inside the surface
    patience: float = quantity(0.5, "s", at_least=0)  # longest wait for a touchdown
    slack: float = quantity(0.2, "-", at_least=MIN_SLACK, at_most=2)  # of planned forces, see `PlannedForces`
    least_normal: float = quantity(12.0, "N", at_least=0)  # least normal force of a standing foot
    load_time: float = quantity(0.3, "s", above=0, at_most=10)  # time of the load transfer between feet before a swing
    # time constant of the filter of the ladder's measured pose
    observer: float = quantity(0.1, "s", at_least=0, at_most=10)

    needs = (Ladder,)
    two_way: ClassVar = True
    default_plan_name = "ladder_climb"  # in leg units

    def plan(self, belief: Case) -> Plan:
        """Return the plan: wait, walk to the ladder, climb, walk away, halt.

        Raises:
            InputError: the ladder cannot be climbed.
        """
        self.validate(belief)
        return self.add_force_feedforward(belief, self.plan_without_forces(belief))

    def plan_without_forces(self, belief: Case) -> Plan:
        """Return the plan of the climb without planned foot forces, which `plan` adds."""
        ladder, robot = belief.obstacle_of_type(Ladder), belief.robot
        length, unit = robot.body_length, length_unit(robot)
        step = GaitStep.from_ratios(length, self.half_step_ratio, self.lift_ratio, self.rate)
        context = MoveContext(belief, unit, step.time, 0.0, dict.fromkeys(ladder.charts, self.deepening))
        height, spread = self.height_ratio * unit, self.spread_ratio * length
        places, arrival, standing = initial_stance("arrive", context)
        start, walk = approach_stages(
            belief, step, arrival, spread, dict(zip(LEGS, places, strict=True)), self.steps, GAP * unit
        )
        climb, _ = plan_part_stages("climb", context, standing)
        last = stack_components(0.0, -AWAY * unit, ladder.ledge_height + height)
        settle, depart = departure_stages(belief, step, last, spread, height, self.steps_away)
        stages = [
            Stage("settle", self.settle),
            *walk,
            *self.insert_load_transfers([*climb, *settle]),
            *depart,
            Stage("halt", self.settle),
        ]
        return apply_plan_direction(belief, compile_plan(start, stages, self.patience, free=ladder.start()))

    def validate(self, belief: Case) -> None:
        """Raise an error unless the ladder stands, has enough rungs and is in reach; skipped under JAX tracing.

        Raises:
            InputError: the ladder slides, lacks rungs or is out of reach.
        """
        ladder, robot, contact = belief.obstacle_of_type(Ladder), belief.robot, belief.contact
        if not are_plain_numbers(robot, ladder, contact, self):
            return
        ladder.check()
        places = [place for move in read_moves(belief, "climb").values() for place in move.feet.values() if place]
        needs = max(int(place["rung"][0]) for place in places if "rung" in place)
        if ladder.rungs < needs:
            raise InputError(
                f"obstacle.rungs = {ladder.rungs} is not allowed: at least {needs} for the moves of part climb"
            )
        grips = [contact.friction * grip for grip in (ladder.floor_grip, ladder.wall_grip)]
        bears = evaluate_with_numpy(lambda: statics(jnp.asarray(ladder.lean), *map(jnp.asarray, grips)).chi_max)
        mass = float(total_mass(robot))
        load = (mass + ladder.mass * ladder.mass_centre_along_rails / ladder.length) / (mass + ladder.mass)
        if not bears >= load:
            raise InputError(
                f"obstacle.lean = {ladder.lean:g} is not allowed: with friction {grips[0]:g} on the floor and "
                f"{grips[1]:g} on the wall the ladder slides under the robot at its top"
            )
        require_within_reach(
            belief,
            lambda: stances_at_stage_ends(self.plan_without_forces(belief), ladder.start()),
            f"obstacle.ledge_height = {ladder.ledge_height:g} is not allowed with obstacle.length = {ladder.length:g} "
            f"and obstacle.rung_step = {ladder.rung_step:g}: ",
        )

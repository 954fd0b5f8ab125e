"""Manoeuvre that executes the moves of a plan file, one part after the other."""

from typing import ClassVar

import jax.numpy as jnp
import numpy as np

from sweep.controllers.plan import GRIP, RESTS, STAND, STAYS, TOGETHER, Plan, Stage, SupportMotion
from sweep.core.errors import InputError
from sweep.core.parameters import choice, parameters, quantity
from sweep.core.rotations import exponential, multiply, rotation_about_vertical
from sweep.formulas import stepping
from sweep.manoeuvres.goals import ON_ITS_FEET
from sweep.models.case import Case
from sweep.models.obstacles.surface import Obstacle, free_start_state
from sweep.models.posture import Stance
from sweep.models.robot import length_unit
from sweep.planning.compile_plan import compile_plan
from sweep.planning.forces import PlannedForces
from sweep.planning.moves import MoveContext, initial_stance, plan_part_stages
from sweep.planning.plan_table import BESIDE, plan_content
from sweep.planning.symmetry import apply_plan_direction
from sweep.planning.validation import require_within_reach, stances_at_stage_ends

START = "start"  # part that places the robot


@parameters
class Follow(PlannedForces):
    """Follow a plan file: start where its part `start` places the robot, then make the moves of its other parts.

    For any obstacle with charts; lengths are in `length_unit`s. Free bodies may be planned to rest (`rests`), to stay
    in place (`stays`) or to roll together (`together`).
    """

    goal: ClassVar = ON_ITS_FEET
    kind: str = choice("follow", "follow")
    lift_ratio: float = quantity(0.03, "a_r", above=0, at_most=0.5)  # d_y, height of a swing
    rate: float = quantity(3.0, "rad/s", above=0, at_most=20)  # varpi, rate of the swings, which gives their time t*
    # epsilon, depth of footholds inside what they stand on
    deepening: float = quantity(5e-4, "m", at_least=0, at_most=0.05)
    # depth of feet on free bodies below where they are measured
    press: float = quantity(1.6e-3, "m", at_least=0, at_most=0.05)
    squeeze: float = quantity(0.0, "m", at_least=0, at_most=0.05)  # the same towards the middle plane
    observer: float = quantity(0.1, "s", at_least=0)  # time constant of the filter of measured poses of free bodies
    patience: float = quantity(0.5, "s", at_least=0)  # longest wait for a touchdown
    # how feet press on: by footholds inside the surface, or by planned forces
    forces: str = choice("deepening", "deepening", "planned")

    needs = (Obstacle,)
    two_way: ClassVar = True
    default_plan_name = ""

    def plan(self, belief: Case) -> Plan:
        """Return the plan: stand, make the moves of the plan file, halt.

        Raises:
            InputError: the file lacks something, or a foot is out of reach.
        """
        plan = self.plan_without_forces(belief)
        require_within_reach(
            belief,
            lambda: stances_at_stage_ends(self.plan_without_forces(belief), free_start_state(belief.obstacle)),
            "plan is not allowed: ",
        )
        return self.add_force_feedforward(belief, plan) if self.forces == "planned" else plan

    def plan_without_forces(self, belief: Case) -> Plan:
        """Return the plan of the plan file's moves without planned foot forces, which `plan` adds."""
        context, stages = self.move_context(belief), []
        feet, position, standing = initial_stance(START, context)
        for part in plan_content(belief):
            if part not in (START, *BESIDE):
                stages_of_part, standing = plan_part_stages(part, context, standing)
                stages += stages_of_part
        if not stages:
            raise InputError(f"plan is not allowed: manoeuvre.kind = {self.kind} needs a part with moves")
        x, y = belief.obstacle.forward
        level = rotation_about_vertical(jnp.asarray(np.arctan2(y, x)))
        start = Stance(
            feet, position, multiply(exponential(-jnp.asarray(standing.pitch) * context.left_direction), level)
        )
        stages = self.insert_load_transfers(stages) if self.forces == "planned" else stages
        plan = compile_plan(start, [Stage("stand", STAND), *stages, Stage("halt", STAND)], self.patience,
                        free=free_start_state(belief.obstacle))  # fmt: skip
        return apply_plan_direction(belief, plan)

    def move_context(self, belief: Case) -> MoveContext:
        """Return the coordinate systems and directions for moves in the plan file."""
        unit, obstacle = length_unit(belief.robot), belief.obstacle
        supports = {"free": SupportMotion(), "rests": RESTS, "stays": STAYS, "together": SupportMotion(TOGETHER)}
        bodies = len(obstacle.free_bodies)
        return MoveContext(
            belief, unit, stepping.swing_time(self.rate), self.lift_ratio * unit,
            dict.fromkeys(obstacle.charts, self.deepening),
            supports={name: (support,) * bodies for name, support in supports.items()},
            stage={"onset": GRIP, "press": (self.press, self.squeeze)} if bodies else {},
        )  # fmt: skip

"""From the floor on to a pole, up it, and over its edge on to its top (monograph 2.3.3).

World axes as in `pole`. After the gallop, the plan file has the parts `edge`, `over` and `top`.
"""

from typing import ClassVar

from sweep.controllers.plan import Stage
from sweep.core.parameters import choice, count, parameters
from sweep.manoeuvres.climbing.pole import PRESS, PoleClimb
from sweep.manoeuvres.goals import UPRIGHT
from sweep.models.case import Case
from sweep.models.posture import Stance
from sweep.planning.moves import StandingState, plan_part_stages


@parameters
class PoleTop(PoleClimb):
    """Walk by tripod to the pole, climb it by gallop, and stand on its top."""

    goal: ClassVar = UPRIGHT
    kind: str = choice("pole_top", "pole_top")
    cycles: int = count(2, at_least=1, at_most=100)  # cycles of the gallop, all alike, of about 3 x* each

    default_plan_name = "pole_top"

    def pole_top_stages(self, belief: Case) -> tuple[Stance, list[Stage], StandingState]:
        """Return the start stance, the plan stages on to the top, and feet and base after them.

        The gallop ends with the front edge of the base x* below the top.
        """
        start, climb, standing = self.climb_stages(belief)
        context, stages = self.move_context(belief), []
        for part in ("edge", "over", "top"):
            stages_of_part, standing = plan_part_stages(part, context, standing)
            stages += [stage for stage in stages_of_part if stage.law != PRESS or self.forces != "planned"]
        return start, [*climb, *self.insert_load_transfer_rests(stages)], standing

    def route_stages(self, belief: Case) -> tuple[Stance, list[Stage]]:
        """Return the start stance and the plan stages until the robot stands on the top."""
        return self.pole_top_stages(belief)[:2]

"""From the floor on to a pole, up it, and over its edge on to its top (monograph 2.3.3).

World axes as in `pole`. The way from the gallop on is in the plan's file: its parts `edge`, `over` and `top`.
"""

from typing import ClassVar

from sweep.controllers.frames import Stance
from sweep.controllers.manoeuvres.climbing.pole import PRESS, PoleClimb
from sweep.controllers.manoeuvres.goals import UPRIGHT
from sweep.controllers.moves import Standing, part_stages
from sweep.controllers.plan import Stage
from sweep.core.parameters import choice, count, parameters
from sweep.models.case import Case


@parameters
class PoleTop(PoleClimb):
    """By tripod to the pole, up it by gallop, and on to its top."""

    goal: ClassVar = UPRIGHT
    kind: str = choice("pole_top", "pole_top")
    cycles: int = count(2, at_least=1, at_most=100)  # of the gallop, all alike, of about 3 x* each

    own_plan = "pole_top"

    def top_stages(self, belief: Case) -> tuple[Stance, list[Stage], Standing]:
        """Climb until the base's front edge is x* below the top, and go on to the top; where it stands then."""
        start, climb, standing = self.climb_stages(belief)
        context, stages = self.move_context(belief), []
        for part in ("edge", "over", "top"):
            more, standing = part_stages(part, context, standing)
            stages += [stage for stage in more if stage.law != PRESS or self.forces != "planned"]
        return start, [*climb, *self.with_rests(stages)], standing

    def route(self, belief: Case) -> tuple[Stance, list[Stage]]:
        """To where it stands on the top, at rest."""
        return self.top_stages(belief)[:2]

"""From the floor on to a pole, up it, and over its edge on to its top (monograph 2.3.3).

World axes as in `pole`. The way from the gallop on is in the plan's file: its parts `edge`, `over` and `top`.
"""

from typing import ClassVar

import numpy as np

from sweep.controllers.frames import Stance
from sweep.controllers.gaits import GALLOP
from sweep.controllers.manoeuvres.climbing.pole import PoleClimb, PoleSite
from sweep.controllers.manoeuvres.goals import UPRIGHT
from sweep.controllers.moves import Standing, Terms, stages_of, standing
from sweep.controllers.plan import Stage
from sweep.core.parameters import choice, count, parameters
from sweep.models.case import Case
from sweep.models.obstacles.charts import ahead_above

PRESS = "press"  # law of moves for feet that are pressed in, left out where planned forces hold them


@parameters
class PoleTop(PoleClimb):
    """By tripod to the pole, up it by gallop, and on to its top."""

    goal: ClassVar = UPRIGHT
    kind: str = choice("pole_top", "pole_top")
    cycles: int = count(2, at_least=1, at_most=100)  # of the gallop, all alike, of about 3 x* each

    own_plan = "pole_top"

    def terms(self, site: PoleSite, belief: Case) -> Terms:
        """Of moves on the pole; the chart `hang` is for a base beside the pole."""
        hang = ahead_above(lambda pole: (site.standoff, pole.height))
        sides = {"side": self.deepening}
        return Terms(belief, site.unit, site.step.time, site.step.height, sides, {"hang": hang}, laws=(PRESS,))

    def ascend(self, site: PoleSite, belief: Case) -> tuple[Stance, list[Stage], Standing]:
        """Climb until the base's front edge is x* below the top, and go on to the top; where it stands then."""
        below = site.top - site.step.landing - site.length / 2  # zeta_O(t_1) of 2.3.3
        start, climb = self.climb(site, belief, (below - site.upright) / (3 * self.cycles))
        feet = {leg: foot for legs in GALLOP for leg, foot in site.on_pole(legs, 0.0, below).items()}
        terms, stages, at = self.terms(site, belief), [], standing(feet, np.pi / 2)
        for part in ("edge", "over", "top"):
            more, at = stages_of(part, terms, at)
            stages += [stage for stage in more if stage.law != PRESS or self.forces != "planned"]
        return start, [*climb, *self.rested(stages)], at

    def way(self, belief: Case) -> tuple[Stance, list[Stage]]:
        """To where it stands on the top, at rest."""
        return self.ascend(self.site(belief), belief)[:2]

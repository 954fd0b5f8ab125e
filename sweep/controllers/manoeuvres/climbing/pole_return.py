"""Up a pole and down again: the climb, then the climb backwards in time."""

from typing import ClassVar

from sweep.controllers.manoeuvres.climbing.pole import PoleClimb
from sweep.controllers.manoeuvres.goals import UPRIGHT
from sweep.controllers.plan import Plan
from sweep.controllers.symmetry import joined, reversed_in_time
from sweep.core.parameters import choice, parameters
from sweep.models.case import Case


@parameters
class PoleReturn(PoleClimb):
    """Up a pole by gallop, and the same way down and away from it.

    The climb of `PoleClimb` and its reversal, which ends walking away from the pole backwards."""

    goal: ClassVar = UPRIGHT
    kind: str = choice("pole_return", "pole_return")

    def plan(self, belief: Case) -> Plan:
        """The climb and its way back."""
        up = super().plan(belief)
        return joined(up, reversed_in_time(up))

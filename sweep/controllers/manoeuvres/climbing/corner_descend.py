"""From the roof of a house down its corner to the floor: the way up, backwards in time (monograph, introduction)."""

from sweep.controllers.manoeuvres.climbing.corner_roof import CornerFull
from sweep.controllers.plan import Plan, Stage, Stance
from sweep.controllers.symmetry import reversed_in_time
from sweep.core.parameters import choice, parameters
from sweep.models.case import Case


@parameters
class CornerDescend(CornerFull):
    """Backwards by tripod to the edge of a roof, over it, and down the corner to the floor.

    The way of `CornerFull` reversed; forces are planned for the reversed plan, not reversed."""

    kind: str = choice("corner_descend", "corner_descend")

    def assembled(self, belief: Case, start: Stance, stages: list[Stage]) -> Plan:
        """The plan backwards in time, and its forces."""
        return self.with_feedforward(belief, reversed_in_time(self.rested(start, stages)))

"""From a ledge down a leaning ladder to the floor: the way up, backwards in time."""

from sweep.controllers.manoeuvres.climbing.ladder import LadderClimb
from sweep.controllers.plan import Plan
from sweep.controllers.symmetry import reversed_in_time
from sweep.core.parameters import choice, parameters
from sweep.models.case import Case
from sweep.models.obstacles.ladder import Ladder


@parameters
class LadderDescend(LadderClimb):
    """Backwards by tripod to the edge of a ledge, down the ladder that leans on it, and away by tripod.

    The way of `LadderClimb` reversed; forces are planned for the reversed plan, not reversed."""

    kind: str = choice("ladder_descend", "ladder_descend")

    @property
    def own_plan(self) -> str:
        """See `LadderClimb`."""
        return "ladder_descend"

    def way(self, belief: Case) -> Plan:
        """The plan but for its forces."""
        return reversed_in_time(super().way(belief), belief.on(Ladder).start())

"""From a ledge down a leaning ladder to the floor: the way up, backwards in time."""

from collections.abc import Sequence

from sweep.controllers.manoeuvres.climbing.ladder import LadderClimb
from sweep.controllers.manoeuvres.climbing.ladder_moves import MOVES, Move
from sweep.controllers.plan import Plan
from sweep.controllers.symmetry import reversed_in_time
from sweep.core.parameters import choice, parameters
from sweep.models.case import Case
from sweep.models.obstacles.ladder import Ladder

# Control points of a swing that comes down to its rung from above, not along it: a foot that meets it early is dragged
# over it until its swing ends.
DOWN = {"front6": {"first": (0.02, -0.03, 0.27), "last": (0.03, 0.3, 0.35), "time": 1.5}}


@parameters
class LadderDescend(LadderClimb):
    """Backwards by tripod to the edge of a ledge, down the ladder that leans on it, and away by tripod.

    The way of `LadderClimb` reversed; forces are planned for the reversed plan, not reversed."""

    kind: str = choice("ladder_descend", "ladder_descend")

    @property
    def table(self) -> tuple[Move, ...]:
        """The numbers of the way up, but for `DOWN`."""
        return tuple(move._replace(**DOWN.get(move.name, {})) for move in MOVES)

    def way(self, belief: Case, moves: Sequence[Move]) -> Plan:
        """The plan but for its forces."""
        return reversed_in_time(super().way(belief, moves), belief.on(Ladder).start())

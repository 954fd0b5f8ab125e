"""From a ledge over a pole's top down to the floor: the way up, backwards in time (monograph, end of 2.3)."""

from sweep.controllers.assembly import assemble
from sweep.controllers.manoeuvres.climbing.pole_ledge import PoleToLedge
from sweep.controllers.plan import STAND, Plan, Stage
from sweep.controllers.symmetry import reversed_in_time
from sweep.core.parameters import choice, parameters
from sweep.models.case import Case


@parameters
class PoleDescent(PoleToLedge):
    """From the ledge behind a pole over its top and down it.

    The way of `PoleToLedge` reversed: backwards by tripod to the pole, over its top, down it, and away by tripod.

    Forces are planned for the reversed plan, not reversed: the weight does not change its direction.
    """

    kind: str = choice("pole_descent", "pole_descent")

    def plan(self, belief: Case) -> Plan:
        """From the ledge to the floor."""
        start, stages = self.way(belief)
        down = reversed_in_time(assemble(start, [*stages, Stage("halt", STAND)], self.patience))
        return self.with_feedforward(belief, down) if self.forces == "planned" else down

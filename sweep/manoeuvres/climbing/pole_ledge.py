"""From a pole's top on to the ledge behind it, and away by tripod (monograph 2.3.4, 2.3.5 and 2.3.7).

World axes as in `pole`; the ledge begins at the pole's far side, at y = -r. The printed plans are tables of places of
feet and base, and so are the parts `ledge` of the plan files: for h_1 = h - 0.2 a_r (2.3.7), h + 0.35 a_r (2.3.5) and h
- 0.6 a_r (2.3.4). They hold for these heights, and for others as far as the legs reach.

Differences from the printed plans, and their reasons:

- While the front feet leave the top, the base is 0.14 to 0.17 a_r behind the axis (printed 0.05 to 0.075 a_r). The
  front legs weigh 2 of 16 kg: with the printed path the mass centre is 3 mm outside the standing feet.
- The base starts that from 0.69 a_r above the top, once the front legs pass the middle ones (printed 0.31 a_r from
  2.3.3 for the first, where they cross). It comes down together with the front feet, to where these reach the ledge.
- On the ledge, feet stand 0.9 to 1.28 r to the side (printed as on the top, 0.625 to 0.875 r). Where a hip passes over
  its foot, the leg has to turn by half a turn at once.
- On the ledge, the front feet come down three times in every plan and the middle feet twice, at distances from the edge
  that keep neighbouring legs apart. Printed are three or two times, with the middle feet at 0.3 to 0.4 a_r in the end.
- The rear feet go half-way over the top, 0.27 r ahead, before they go to the ledge (printed: where the middle feet
  stood).
- Lengths are in `length_unit`s, nominally a_r. Measured by the body, they would be out of reach for robots with legs
  2 % shorter than the body suggests.
- Stages take 1.5 to 2 t*, and swings follow Bezier curves that come down from above.
"""

from typing import ClassVar

from sweep.controllers.plan import Stage
from sweep.core.parameters import choice, count, parameters
from sweep.manoeuvres.climbing.pole_top import PoleTop
from sweep.manoeuvres.climbing.walking import departure_stages
from sweep.manoeuvres.goals import UPRIGHT
from sweep.models.case import Case
from sweep.models.obstacles.charts import stack_components
from sweep.models.obstacles.pole_ledge import PoleLedge
from sweep.models.posture import Stance
from sweep.planning.moves import plan_part_stages


@parameters
class PoleToLedge(PoleTop):
    """Walk by tripod to the pole, climb it, cross its top to the ledge, and walk away."""

    goal: ClassVar = UPRIGHT
    kind: str = choice("pole_ledge", "pole_ledge")
    # height of the ledge: 0.2 a_r below the top, 0.35 a_r above it, or 0.6 a_r below it
    across: str = choice("level", "level", "above", "below")
    steps_away: int = count(3, at_least=0, at_most=100)  # number of swings on the ledge, 2 x* each

    @property
    def default_plan_name(self) -> str:
        """Name of the default plan file for a ledge level with the pole's top, above it or below it."""
        return f"pole_ledge_{self.across}"

    def route_stages(self, belief: Case) -> tuple[Stance, list[Stage]]:
        """Return the start stance and the plan stages: on to the top, across to the ledge, away."""
        start, stages, standing = self.pole_top_stages(belief)
        context, pole = self.move_context(belief), belief.obstacle_of_type(PoleLedge)
        cross, _ = plan_part_stages("ledge", context, standing)
        height, spread = self.height_ratio * context.unit, self.spread_ratio * context.unit
        last = stack_components(0.0, -pole.radius - 0.75 * context.unit, pole.ledge_height + height)
        away, walk = departure_stages(belief, self.approach_gait_step(belief), last, spread, height, self.steps_away)
        return start, [*stages, *self.insert_load_transfer_rests([*cross, *away]), *walk]

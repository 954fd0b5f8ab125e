"""From a pole's top on to the ledge behind it, and away by tripod (monograph 2.3.4, 2.3.5 and 2.3.7).

World axes as in `pole`; the ledge begins at the pole's far side, at y = -r. The printed plans are tables of places of
the feet and of the base, and so are these: `LEVEL` (h_1 = h - 0.2 a_r, 2.3.7), `ABOVE` (h + 0.35 a_r, 2.3.5), `BELOW`
(h - 0.6 a_r, 2.3.4). They hold for these heights, and for others as far as the legs reach.

What differs from the print, and why:

- The base goes 0.14 to 0.17 a_r (printed 0.05 to 0.075 a_r) behind the axis while the front feet leave the top. The
  front legs weigh 2 of 16 kg: with the printed way the mass centre is 3 mm outside the standing feet.
- It starts that from 0.69 a_r above the top, from where the front legs pass the middle ones (printed 0.31 a_r from
  2.3.3 for `LEVEL`, where they cross), and comes down as the front feet do, to where these reach the ledge.
- Feet stand at 0.9 to 1.28 r aside on the ledge (printed as on the top, 0.625 to 0.875 r): where a hip passes over its
  foot, the leg has to turn by half a turn at once.
- On the ledge the front feet come down three times in every plan, the middle feet twice, at distances from the edge
  that keep neighbouring legs apart; printed are three or two times, with the middle feet at 0.3 to 0.4 a_r at last.
- The rear feet go half-way over the top, 0.27 r ahead, before they go to the ledge (printed: where the middle feet
  stood).
- `BELOW` is printed with a base that stays level until 2.3.4.3 and front, middle and rear feet that stand on the pole's
  side meanwhile. Here the base pitches down by 25 to 49 degrees, so that the front feet reach the ledge at once, and no
  foot goes to the side. While the middle feet are on the top their hips stay 0.4 a_r above it: lower, their knees
  sink below the top's edge, since thighs are longer than shins. Before, its nose goes up by 2 degrees: the front legs
  pass the middle ones 20 mm farther away. The rear feet step aside to the pole's widest: behind it their shins would
  lie on the rim when the base goes ahead. All its numbers but the first move's were searched for together, against true
  distances (`tools/search_plan.py`).
- Its way is measured by the legs (`leg_unit`), nominally a_r: by the body, robots with legs 2 % shorter than it asks
  for would be out of reach.
- Stages take 1.5 to 2 t*, and swings go along Bezier curves that come down from above.
"""

from collections.abc import Sequence
from typing import ClassVar, NamedTuple

from jaxtyping import Array, Float

from sweep.controllers.manoeuvres.climbing import walking
from sweep.controllers.manoeuvres.climbing.pole import FRONT, MIDDLE, REAR, PoleSite, pair, point
from sweep.controllers.manoeuvres.climbing.pole_top import TOP, Footholds, PoleTop, lofted, on_disc
from sweep.controllers.manoeuvres.goals import UPRIGHT
from sweep.controllers.plan import CYCLE_B, Plan, Stage, Stance
from sweep.controllers.posture import leg_unit
from sweep.core.parameters import choice, count, parameters
from sweep.models.case import Case
from sweep.models.obstacles import pole_ledge

ON_TOP, ON_LEDGE = "top", "ledge"


class Move(NamedTuple):
    """A stage on the way across: a pair of feet, or none, goes to a place while the base goes to another one."""

    name: str
    base: tuple[float, float]  # beyond the ledge's edge, above the pole's top (a_r)
    legs: tuple[int, int] | None = None
    where: str = ON_LEDGE
    # on the top aside and ahead (r), on the ledge aside (r) and beyond its edge (a_r)
    place: tuple[float, float] = (0.0, 0.0)
    first: tuple[float, float, float] = (0.1, 0.0, 0.2)  # guides of the swing, see `lofted`
    last: tuple[float, float, float] = (0.1, 0.0, 0.2)
    time: float = 1.5  # t*
    pitch: float = 0.0  # rad, of the base, nose down, in the end


LEVEL = (
    Move("back", (-0.479, 0.69)),
    Move("front", (-0.554, 0.53), FRONT, ON_LEDGE, (1.1, 0.11), (0.166, -0.245, 0.111), (-0.151, 0.33, 0.133), 2.0),
    Move("middle", (-0.4, 0.535), MIDDLE, ON_TOP, TOP[FRONT]),
    Move("front2", (-0.316, 0.464), FRONT, ON_LEDGE, (0.98, 0.518)),
    Move("middle2", (-0.109, 0.488), MIDDLE, ON_LEDGE, (1.013, 0.115)),
    Move("ahead", (0.27, 0.47)),
    Move("rear", (0.27, 0.47), REAR, ON_TOP, (0.83, -0.27)),
    Move("middle3", (0.3, 0.45), MIDDLE, ON_LEDGE, (0.995, 0.37)),
    Move("front3", (0.3, 0.45), FRONT, ON_LEDGE, (0.987, 1.1)),
    Move("ahead2", (0.72, 0.42)),
    Move("rear2", (0.72, 0.4), REAR, ON_LEDGE, (1.0, 0.15)),
)
ABOVE = (
    Move("back", (-0.47, 0.69)),
    Move("front", (-0.54, 0.62), FRONT, ON_LEDGE, (1.08, 0.09), (0.18, -0.21, 0.17), (-0.08, 0.24, 0.14), 2.0),
    Move("middle", (-0.42, 0.67), MIDDLE, ON_TOP, TOP[FRONT]),
    Move("front2", (-0.305, 0.748), FRONT, ON_LEDGE, (1.08, 0.75)),
    Move("middle2", (-0.1, 0.68), MIDDLE, ON_LEDGE, (1.13, 0.11), (0.2, 0.09, 0.154), (-0.08, 0.19, 0.135), 2.0),
    Move("ahead", (0.28, 0.63)),
    Move("rear", (0.28, 0.67), REAR, ON_TOP, (0.83, -0.27)),
    Move("middle3", (0.3, 0.74), MIDDLE, ON_LEDGE, (1.0, 0.39)),
    Move("front3", (0.2, 0.74), FRONT, ON_LEDGE, (1.0, 1.15)),
    Move("ahead2", (0.56, 0.7)),
    Move("rear2", (0.62, 0.87), REAR, ON_LEDGE, (1.0, 0.08), (0.05, -0.185, 0.24), (-0.03, 0.175, 0.11), 2.0),
)
BELOW = (
    Move("back", (-0.479, 0.724), pitch=-0.037),
    Move("front", (-0.521, 0.348), FRONT, ON_LEDGE, (1.096, 0.042), (0.377, -0.34, 0.231), (0.176, 0.484, 0.427), 2.0,
         0.43),
    Move("middle", (-0.341, 0.407), MIDDLE, ON_TOP, (0.7047, -0.5591), pitch=0.652),
    Move("front2", (-0.303, 0.407), FRONT, ON_LEDGE, (1.276, 0.38), (0.126, -0.022, 0.244), (0.085, 0.004, 0.202),
         pitch=0.82),
    Move("middle2", (0.298, 0.144), MIDDLE, ON_LEDGE, (0.897, 0.151), (0.212, -0.136, 0.307), (0.124, 0.511, 0.444),
         pitch=0.855),
    Move("ahead", (0.307, 0.13), pitch=0.634),
    Move("rear", (0.342, 0.139), REAR, ON_TOP, (0.8205, 0.07), (0.115, -0.17, 0.146), (-0.14, 0.14, 0.08),
         pitch=0.666),
    Move("middle3", (0.335, 0.153), MIDDLE, ON_LEDGE, (0.965, 0.41), pitch=0.717),
    Move("front3", (0.343, 0.156), FRONT, ON_LEDGE, (1.155, 1.231), pitch=0.566),
    Move("ahead2", (0.622, 0.016), pitch=0.76),
    Move("rear2", (0.648, -0.1), REAR, ON_LEDGE, (0.982, 0.187), (0.156, -0.043, 0.316), (0.212, 0.317, 0.513), 2.0,
         0.0),
)  # fmt: skip
WAYS = {"level": LEVEL, "above": ABOVE, "below": BELOW}


@parameters
class PoleToLedge(PoleTop):
    """By tripod to the pole, up it, over its top on to the ledge, and away by tripod."""

    goal: ClassVar = UPRIGHT
    kind: str = choice("pole_ledge", "pole_ledge")
    across: str = choice("level", *WAYS)  # the ledge is 0.2 a_r lower than the pole, 0.35 a_r higher, 0.6 a_r lower
    steps_away: int = count(3, at_least=0, at_most=100)  # swings on the ledge, 2 x* each

    @property
    def table(self) -> tuple[Move, ...]:
        """The numbers of the way across."""
        return WAYS[self.across]

    def way(self, belief: Case, moves: Sequence[Move]) -> tuple[Stance, list[Stage]]:
        """Get on the top, cross to the ledge, walk away."""
        site, ledge = self.site(belief), belief.on(pole_ledge.PoleLedge).ledge_height
        start, stages = self.ascend(site, belief)
        away, walk = walk_away(site, belief, ledge, self.steps_away)
        return start, [*stages, *self.rested([*cross(site, belief, moves), *away]), *walk]

    def plan(self, belief: Case, table: Sequence[Move] | None = None) -> Plan:
        """Go all the way, halt."""
        return self.assembled(belief, *self.way(belief, table or self.table))


def beyond(site: PoleSite, way: float, height: Array | float) -> Float[Array, " 3"]:
    """A point (m) in the plane x = 0, `way` (a_r) beyond the ledge's edge."""
    return point(0.0, -site.radius - way * site.length, height)


def on_ledge(site: PoleSite, ledge: Array | float, legs: tuple[int, int], place: tuple[float, float]) -> Footholds:
    """Footholds of a pair on the ledge, aside (r) and beyond its edge (a_r)."""
    return pair(legs, place[0] * site.radius, -site.radius - place[1] * site.length, ledge)


def cross(site: PoleSite, belief: Case, moves: Sequence[Move]) -> list[Stage]:
    """Stages from the top on to the ledge; the feet begin at `TOP`, the base level. Measured by `leg_unit`s."""
    ledge, site = belief.on(pole_ledge.PoleLedge).ledge_height, site._replace(length=leg_unit(belief.robot))
    at = {legs: on_disc(site, legs, TOP[legs]) for legs in (FRONT, MIDDLE, REAR)}
    stages, pitch = [], 0.0
    for move in moves:
        swing, guides = {}, {}
        if move.legs is not None:
            swing = on_disc(site, move.legs, move.place) if move.where == ON_TOP else on_ledge(
                site, ledge, move.legs, move.place)  # fmt: skip
            guides = lofted(site, at[move.legs], swing, move.first, move.last)
            at[move.legs] = swing
        base = beyond(site, move.base[0], site.top + move.base[1] * site.length)
        stages.append(Stage(f"ledge.{move.name}", move.time * site.step.time, swing, CYCLE_B, position=base,
                            turn=point(move.pitch - pitch, 0.0, 0.0), rates=walking.EASED, guides=guides))  # fmt: skip
        pitch = move.pitch
    return stages


def walk_away(site: PoleSite, belief: Case, ledge: Array | float, steps: int) -> tuple[list[Stage], list[Stage]]:
    """The feet to where a tripod gait may start, and `steps` swings of it on the ledge."""
    spread = site.track - belief.robot.body_width / 2
    return walking.walk_away(belief, site.step, beyond(site, 0.75, ledge + site.clearance), spread, site.clearance,
                             steps)  # fmt: skip

"""From the floor on to a pole, up it, and over its edge on to its top (monograph 2.3.3).

World axes as in `pole`. Places on the pole are given as (ahead of its axis in r, above its top in a_r), places on its
top as (aside, ahead) in r, the base's centre as (ahead of the axis, above the top) in a_r.

What differs from the printed plan. Its links cut the pole by up to 33 mm and its legs cross one another:

- `EDGE`: the middle feet go up in two swings, about the rear ones, which pass them otherwise; they end less far behind
  the axis, the front feet ahead of it, and the base 0.19 a_r below the top instead of at it.
- `SLOPE`: the feet go to the top while the base is still pitched by 22 degrees. Level, the rear shins would cut the
  edge by 19 mm.
- The base's way over the edge is an arc about a point behind the axis, on which it clears the edge, and ends 0.36 a_r
  above the top (printed 0.67 d_c = 0.31 a_r). It then rises with the rear feet to 0.72 a_r: lower, the knees of rear
  and middle legs meet.
- While feet on the side are let go, they are pressed in by `PRESS` only, and the front feet on the top as much.
- The middle and rear feet swing along curves of their own (`lofted`), more slowly.
- In the end the base stands 0.62 a_r above the top, as where the print goes on to a ledge (2.3.4.1).
"""

from typing import ClassVar

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from sweep.controllers.manoeuvres.climbing.pole import (
    FRONT,
    MIDDLE,
    OUTWARD,
    REAR,
    OnPole,
    PoleSite,
    curves,
    pair,
    point,
)
from sweep.controllers.manoeuvres.climbing.walking import EASED
from sweep.controllers.manoeuvres.goals import UPRIGHT
from sweep.controllers.plan import CYCLE_B, SMOOTH, Plan, Stage, Stance
from sweep.core.parameters import choice, count, parameters
from sweep.models.case import Case

RIM = 0.875  # r' / r, keeps feet off the rim of the top
PRESS = 0.003  # m
SLOPE = np.radians(22.0)
# where the feet stand while the base turns over the edge
EDGE = {FRONT: (0.1, -0.03), MIDDLE: (-0.2, -0.19), REAR: (0.55, -0.476)}
BELOW_EDGE = (0.0, -0.355)  # where the middle feet wait for the rear ones
# where they stand on the top in the end; were the rear ones less far aside, their thighs would rub along the base's
# sides when it pitches down to a lower ledge
TOP = {FRONT: (0.625, -((RIM**2 - 0.625**2) ** 0.5)), MIDDLE: (RIM, 0.0), REAR: (0.7, (RIM**2 - 0.7**2) ** 0.5)}
PROPPED = (0.864, 0.077)  # where the middle feet stand while the rear ones come up

type Footholds = dict[int, Array]


@parameters
class PoleTop(OnPole):
    """By tripod to the pole, up it by gallop, and on to its top."""

    goal: ClassVar = UPRIGHT
    kind: str = choice("pole_top", "pole_top")
    cycles: int = count(2, at_least=1, at_most=100)  # of the gallop, all alike, of about 3 x* each

    def ascend(self, site: PoleSite, belief: Case) -> tuple[Stance, list[Stage]]:
        """Climb until the base's front edge is x* below the top, and go on to the top."""
        below = site.top - site.step.landing - site.length / 2  # zeta_O(t_1) of 2.3.3
        start, climb = self.climb(site, belief, (below - site.upright) / (3 * self.cycles))
        return start, [
            *climb,
            *self.rested([*to_the_edge(site), *over_the_edge(site), *on_top(site, self.forces == "planned")]),
        ]

    def plan(self, belief: Case) -> Plan:
        """Get on the top, halt."""
        start, stages = self.ascend(self.site(belief), belief)
        return self.assembled(belief, start, stages)


def on_side(site: PoleSite, legs: tuple[int, int], place: tuple[float, float], foot_radius: Array | float) -> Footholds:
    """Footholds of a pair on the pole's side, `foot_radius` (m) from its axis."""
    ahead, height = place[0] * site.radius, site.top + place[1] * site.length
    return pair(legs, jnp.sqrt(jnp.asarray(foot_radius) ** 2 - ahead**2), ahead, height)


def on_disc(site: PoleSite, legs: tuple[int, int], place: tuple[float, float]) -> Footholds:
    """Footholds of a pair on the pole's top."""
    return pair(legs, place[0] * site.radius, place[1] * site.radius, site.top)


def centre(site: PoleSite, ahead: float, above: float) -> Float[Array, " 3"]:
    """The base's centre (m)."""
    return point(0.0, ahead * site.length, site.top + above * site.length)


def lofted(
    site: PoleSite, start: Footholds, end: Footholds, first: tuple, last: tuple
) -> dict[int, Float[Array, "2 3"]]:
    """Guides of swings: `first` from where they start and `last` from where they land, outward, ahead and up in a_r."""
    return curves(start, end, site.length * jnp.array(first), site.length * jnp.array(last))


def to_the_edge(site: PoleSite) -> list[Stage]:
    """2.3.3 until t_4: the feet spread round the pole while the base comes up."""
    front, middle, rear = (on_side(site, legs, EDGE[legs], site.foot_radius) for legs in (FRONT, MIDDLE, REAR))
    below = on_side(site, MIDDLE, BELOW_EDGE, site.foot_radius)
    gallop_end = site.on_pole(REAR, 0.0, site.top - site.step.landing - site.length / 2)
    past_middle = lofted(site, gallop_end, rear, (0.3, 0.22, 0.385), (0.18, -0.13, -0.05))
    past_front = lofted(site, below, middle, (0.19, 0.0, 0.15), (0.08, 0.0, -0.2))
    stages = []
    for name, swing, guides, height in (
        ("front", front, {}, -0.5),
        ("below", below, {}, -0.33),
        ("rear", rear, past_middle, -0.33),
        ("middle", middle, past_front, -0.19),
    ):
        base = point(0.0, site.standoff, site.top + height * site.length)
        stages.append(Stage(f"edge.{name}", site.step.time, swing, CYCLE_B, site.step.height, OUTWARD, guides=guides,
                            position=base))  # fmt: skip
    return stages


def over_the_edge(site: PoleSite) -> list[Stage]:
    """2.3.3 from t_4 to t_5: the base goes over the edge and turns nearly level, the front feet go to the top."""
    side, front = on_side(site, FRONT, EDGE[FRONT], site.foot_radius), on_disc(site, FRONT, TOP[FRONT])
    turn = Stage("over.front", 2 * site.step.time, front, CYCLE_B, position=centre(site, 0.019, 0.36),
                 turn=point(np.pi / 2 - SLOPE, 0.0, 0.0), pace=SMOOTH, pivot=centre(site, -0.09, 0.0), arc=np.pi / 2,
                 guides=lofted(site, side, front, (0.15, 0.0, 0.2), (0.0, 0.0, 0.2)))  # fmt: skip
    return [Stage("edge.hold", 0.3), turn]


def on_top(site: PoleSite, held: bool) -> list[Stage]:
    """2.3.3 from t_5 on: middle and rear feet to the top, the base level, middle feet abreast of its centre.

    Feet that are `held` by planned forces need not be pressed less first.
    """
    time = site.step.time
    middle, rear = (on_side(site, legs, EDGE[legs], site.radius - PRESS) for legs in (MIDDLE, REAR))
    front = {leg: foot - point(0.0, 0.0, PRESS) for leg, foot in on_disc(site, FRONT, TOP[FRONT]).items()}
    propped, last = on_disc(site, MIDDLE, PROPPED), on_disc(site, REAR, TOP[REAR])
    up, round_middle = (
        lofted(site, middle, propped, (0.15, 0.0, 0.25), (0.0, 0.0, 0.2)),
        lofted(site, rear, last, (0.22, -0.05, 0.47), (0.77, 0.15, 0.25)),
    )
    regrip = Stage("top.regrip", time, {**front, **middle, **rear}, CYCLE_B)
    return [
        *([] if held else [regrip]),
        Stage("top.middle", 1.5 * time, propped, CYCLE_B, position=centre(site, -0.11, 0.444), rates=EASED, guides=up),
        Stage("top.rear", 3 * time, last, CYCLE_B, position=centre(site, -0.025, 0.728), rates=EASED,
              turn=point(SLOPE, 0.0, 0.0), guides=round_middle),
        Stage("top.centre", time, on_disc(site, MIDDLE, TOP[MIDDLE]), CYCLE_B, site.step.height,
              position=centre(site, 0.0, 0.62), rates=EASED),
    ]  # fmt: skip

"""Plans as data: parts of moves, read from a file, become stages.

A move takes the base somewhere and feet to places, both in charts that the obstacle offers. For robots that come along
-y, their left and right feet placed alike.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, fields
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from sweep.controllers.gaits import GALLOP
from sweep.controllers.plan import CYCLE_A, CYCLE_B, CYCLE_B_SMOOTH, HALF_ELLIPSE, SMOOTH, STEADY, Stage
from sweep.core.errors import InputError, suggest
from sweep.formulas.leg import SIDE
from sweep.models.case import Case
from sweep.models.obstacles.charts import Chart, Number, charts, point
from sweep.models.plan_table import COMPONENTS, Content, tabled

PAIRS: Mapping[str, tuple[int, int]] = dict(zip(("front", "middle", "rear"), GALLOP, strict=True))
CYCLES = {"a": CYCLE_A, "b": CYCLE_B, "b_smooth": CYCLE_B_SMOOTH, "half_ellipse": HALF_ELLIPSE}
# how the base's way is spent: evenly, as a cubic from rest to rest, or by lambda_1
PACES = {"even": (STEADY, (1.0, 1.0)), "eased": (STEADY, (0.0, 0.0)), "smooth": (SMOOTH, (1.0, 1.0))}
AHEAD = np.array([1.0, -1.0, 1.0])  # out, ahead, up in world axes, on the right
type Feet = dict[int, Float[Array, " 3"]]  # m, by leg
type Numbers = list[Any]


@dataclass(frozen=True)
class Move:
    """A stage in a file's words; what a part says counts for all its moves. Lengths are in the manoeuvre's unit."""

    time: Number = 1.0  # t*
    seconds: Number | None = None  # instead of `time`
    base: Mapping[str, Numbers] = field(
        default_factory=dict
    )  # at the end, by chart: ahead, above, pitch (deg, nose up)
    pace: str = "even"
    pivot: Numbers | None = None  # of an arc of the base, in the same chart
    arc: Number = 0.0  # deg
    # by pair, coordinates in one chart; None: a pair stays where it is, and gets another depth
    feet: Mapping[str, Mapping[str, Numbers] | None] = field(default_factory=dict)
    depth: Number | None = None  # m, of these feet in what they stand on
    swing: str = "b"
    lift: Number = 0.0  # d_y
    plane: Numbers | None = None  # in which the swing is lifted; upwards if it does not say
    leave: Numbers | None = None  # control points of the swing's curve, from the place that is left ...
    land: Numbers | None = None  # ... and from the new one


WORDS = {"pace": PACES, "swing": CYCLES}
SIZES = {**{key: (len(names),) for key, names in COMPONENTS.items()}, "base": (2, 3)}  # of lists


class Stand(NamedTuple):
    """Where a pair stands."""

    feet: Feet  # from where its next swing's curve is told
    place: Mapping[str, Numbers] | None = None  # where a chart says so


@dataclass(frozen=True)
class Terms:
    """What a file's words mean on an obstacle, for a manoeuvre."""

    belief: Case
    unit: Number  # m
    time: Number  # s, t*
    lift: Number  # m, d_y
    depths: Mapping[str, Number] = field(default_factory=dict)  # m, of feet in what they stand on, by chart; else 0
    own: Mapping[str, Chart] = field(default_factory=dict)  # charts of the manoeuvre's

    def feet(self, pair: str, place: Mapping[str, Numbers], depth: Number | None = None) -> Feet:
        """Footholds of a pair, at the usual depth or another one (m)."""
        chart, numbers = _only(place)
        deep = self.depths.get(chart, 0.0) if depth is None else depth
        return {leg: self._at(chart, numbers, float(SIDE[leg - 1]), deep) for leg in PAIRS[pair]}

    def base(self, place: Mapping[str, Numbers]) -> Float[Array, " 3"]:
        """The base's centre, or the centre of an arc that it goes along."""
        chart, numbers = _only(place)
        return self._at(chart, numbers[:2], 1.0, 0.0)

    def _at(self, chart: str, numbers: Numbers, side: float, depth: Number) -> Float[Array, " 3"]:
        offered = {**charts(self.belief.obstacle), **self.own}
        if chart not in offered:
            raise InputError(f"plan: chart {chart} is unknown on {self.belief.obstacle.kind}{suggest(chart, offered)}")
        names, at = offered[chart]
        if len(numbers) != len(names):
            raise InputError(f"plan: {chart}: {numbers} is not allowed: {', '.join(names)}")
        return at(self.belief.obstacle, side, self.unit, depth, *numbers)


def stages_of(
    part: str, terms: Terms, stands: Mapping[str, Stand], pitch: Number
) -> tuple[list[Stage], dict[str, Stand], Number]:
    """Stages of a part's moves, where pairs stand after them, and the base's pitch (deg), which begins as given.

    Raises `InputError` for what the language has no words for.
    """
    stages, stands = [], dict(stands)
    for name, move in moves(tabled(terms.belief), part).items():
        swing, guides = {}, {}
        for pair, place in move.feet.items():
            left, place = stands[pair], place or stands[pair].place
            if place is None:
                raise InputError(
                    f"plan.{part}.{name}.{pair} is not allowed without a place: nothing says where it stands"
                )
            stands[pair] = Stand(terms.feet(pair, place), place)
            swing |= terms.feet(pair, place, move.depth)
            if move.leave and move.land:
                ways = (terms.unit * jnp.array(numbers) * AHEAD for numbers in (move.leave, move.land))
                guides |= curves(left.feet, stands[pair].feet, *ways)
        chart, numbers = next(iter(move.base.items()), ("", []))
        turn = jnp.radians(jnp.asarray(pitch - numbers[2], float)) if len(numbers) > 2 else None
        pitch = numbers[2] if len(numbers) > 2 else pitch
        pace, rates = PACES[move.pace]
        stages.append(Stage(
            f"{part}.{name}", move.time * terms.time if move.seconds is None else move.seconds, swing,
            CYCLES[move.swing], move.lift * terms.lift, _plane(move.plane),
            position=terms.base(move.base) if numbers else None, turn=None if turn is None else point(turn, 0.0, 0.0),
            pace=pace, rates=rates, pivot=terms.base({chart: move.pivot}) if move.pivot else None,
            arc=jnp.radians(jnp.asarray(move.arc, float)), guides=guides,
        ))  # fmt: skip
    return stages, stands, pitch


def moves(content: Content, part: str) -> dict[str, Move]:
    """The moves of a part by name. Raises `InputError`."""
    if part not in content:
        raise InputError(f"plan.{part} is missing{suggest(part, content)}")
    common = {key: value for key, value in content[part].items() if not isinstance(value, Mapping)}
    return {name: _move(f"plan.{part}.{name}", {**common, **given, "base": _based(common, given)})
            for name, given in content[part].items() if isinstance(given, Mapping)}  # fmt: skip


def _based(common: Mapping[str, Any], given: Mapping[str, Any]) -> Any:
    """The base's place with its chart, which the part says if the move does not."""
    place = given.get("base", {})
    return {common.get("base", ""): place} if isinstance(place, list) else place


def _move(where: str, given: Mapping[str, Any]) -> Move:
    feet = {key: given[key] for key in PAIRS if key in given}
    words = {key: value for key, value in given.items() if key not in PAIRS}
    allowed = [f.name for f in fields(Move) if f.name != "feet"]
    for key, value in words.items():
        if key not in allowed:
            raise InputError(f"{where}.{key} is unknown{suggest(key, [*allowed, *PAIRS])}")
        if key in WORDS and value not in WORDS[key]:
            raise InputError(f"{where}.{key} = {value} is unknown{suggest(str(value), WORDS[key])}")
        numbers = next(iter(value.values()), []) if key == "base" and isinstance(value, Mapping) else value
        if key in SIZES and (not isinstance(numbers, list) or (numbers and len(numbers) not in SIZES[key])):
            names = COMPONENTS[key]
            raise InputError(f"{where}.{key} = {value} is not allowed: [{', '.join(names)}]")
    for key, value in given.items():
        if key not in WORDS and (wrong := [number for number in _listed(value) if isinstance(number, str | bool)]):
            raise InputError(f"{where}.{key} = {wrong[0]} is not allowed: a number")
    for pair, place in feet.items():
        if place is not None and (not isinstance(place, Mapping) or len(place) != 1):
            raise InputError(f"{where}.{pair} = {place} is not allowed: coordinates in one chart")
    return Move(**words, feet=feet)


def _only(place: Mapping[str, Numbers]) -> tuple[str, Numbers]:
    if len(place) != 1:
        raise InputError(f"plan: {dict(place)} is not allowed: coordinates in one chart")
    return next(iter(place.items()))


def _listed(value: Any) -> Iterator[Any]:
    """What stands in a value of a move, but in it alone."""
    if isinstance(value, Mapping | list):
        for part in value.values() if isinstance(value, Mapping) else value:
            yield from _listed(part)
    elif value is not None:
        yield value


def curves(start: Feet, end: Feet, leave: Array | np.ndarray, land: Array | np.ndarray) -> dict[int, Array]:
    """Guides of swings by leg: `leave` from where they start, `land` from where they end (m; out to the side, y, z)."""
    guides = {}
    for leg, goal in end.items():
        out = np.array([float(SIDE[leg - 1]), 1.0, 1.0])
        guides[leg] = jnp.stack([start[leg] + out * leave, goal + out * land])
    return guides


def _plane(numbers: Numbers | None) -> Array | tuple[float, float, float]:
    """By leg, out to whose side it is."""
    if numbers is None:
        return (0.0, 0.0, 1.0)
    out, ahead, up = (jnp.asarray(number, float) for number in numbers)
    return jnp.stack([jnp.stack([side * out, -ahead, up]) for side in SIDE])


def numbers_of[T](cls: type[T], belief: Case, part: str) -> T:
    """A part of a case's plan that holds numbers, not moves, as a named tuple. Raises `InputError`."""
    given, names = tabled(belief).get(part, {}), cls.__annotations__
    if missing := [name for name in names if name not in given]:
        raise InputError(f"plan.{part}.{missing[0]} is missing")
    if unknown := [name for name in given if name not in names]:
        raise InputError(f"plan.{part}.{unknown[0]} is unknown{suggest(unknown[0], names)}")
    return cls(**{name: tuple(value) if isinstance(value, list) else value for name, value in given.items()})

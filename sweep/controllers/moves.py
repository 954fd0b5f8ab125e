"""Plans as data: parts of moves, read from a file, become stages.

A move takes the base somewhere and feet to places, both in charts that the obstacle offers. Left and right feet of a
pair are placed alike.
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from typing import Any, NamedTuple, get_args, get_origin

import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Float

from sweep.controllers.frames import to_frame, to_world
from sweep.controllers.plan import CYCLE_A, CYCLE_B, CYCLE_B_SMOOTH, HALF_ELLIPSE, SMOOTH, STEADY, Stage, Support
from sweep.core.errors import InputError, known, suggest
from sweep.formulas.leg import SIDE
from sweep.models.case import Case
from sweep.models.frames import WORLD
from sweep.models.legs import GROUPS, LEGS, NAMES
from sweep.models.obstacles.charts import Chart, Number
from sweep.models.obstacles.surface import free_start
from sweep.models.plan_table import COMPONENTS, LONG, REPEAT, SINGLE, tabled

CYCLES = {"a": CYCLE_A, "b": CYCLE_B, "b_smooth": CYCLE_B_SMOOTH, "half_ellipse": HALF_ELLIPSE}
# how the base's way is spent: evenly, as a cubic from rest to rest, or by lambda_1
PACES = {"even": (STEADY, (1.0, 1.0)), "eased": (STEADY, (0.0, 0.0)), "smooth": (SMOOTH, (1.0, 1.0))}
OPPOSITE = {group: group.replace("front", "rear") if "front" in group else group.replace("rear", "front")
            for group in GROUPS}  # fmt: skip
NOT_A_NUMBER = str | bool | list | Mapping | None  # is no number
type Feet = dict[int, Float[Array, " 3"]]  # m, by leg
type Numbers = list[Any]
type Place = Mapping[str, Numbers]  # coordinates in one chart


@dataclass(frozen=True)
class Move:
    """A stage in a file's words; what a part says counts for all its moves. Lengths are in the manoeuvre's unit."""

    path: str  # of the move in a file, for messages
    # where groups of legs go; None: they stay where they are, and get another depth
    feet: Mapping[str, Place | None] = field(default_factory=dict)
    time: Number = 1.0  # t*
    seconds: Number | None = None  # instead of `time`
    base: Place = field(default_factory=dict)  # at the end, with its pitch (deg, nose up) after the coordinates
    pace: str = "even"
    rates: Numbers | None = None  # of an even pace at its ends, in units of its mean
    pivot: Numbers | None = None  # of an arc of the base, in the same chart
    arc: Number = 0.0  # deg
    depth: Number | None = None  # m, of these feet in what they stand on
    swing: str = "b"
    lift: Number = 0.0  # d_y
    carry: Number = 0.0  # share of the swing's way that is made evenly, as the base goes
    plane: Numbers | None = None  # in which the swing is lifted; upwards if it does not say
    leave: Numbers | None = None  # control points of the swing's curve, from the place that is left ...
    land: Numbers | None = None  # ... and from the new one
    press: Number = 1.0  # of feet on free bodies, over the manoeuvre's own
    support: str = "free"  # of free bodies, as the manoeuvre names it; where they are seen if it does not say
    law: str = ""  # of the manoeuvre's, that leads it or by which metrics know it


REVERSED = ("reverse", "from", "mirror", "law")  # what a part says that is another one backwards
WORDS = {"pace": PACES, "swing": CYCLES}
NUMBERS = {f.name: f.default for f in fields(Move) if f.name in SINGLE}
SIZES = {key: len(names) for key, names in COMPONENTS.items() if key != "base"}  # of lists


class Footing(NamedTuple):
    """Where a foot stands, and with what it goes."""

    point: Float[Array, " 3"]  # m, from where its next swing's curve is told
    frame: int = WORLD  # of that
    stance_frame: int = WORLD  # the frame with which it goes
    place: Place | None = None  # where a chart says so


class Standing(NamedTuple):
    """Where the robot stands between two moves."""

    feet: Mapping[int, Footing]  # by leg
    pitch: Number  # rad, of the base, nose up
    frame: int = WORLD  # of the base


def standing_on(feet: Feet, pitch: Number, frame: int = WORLD) -> Standing:
    """On footholds (m) that no chart tells, feet and base in one frame."""
    return Standing({leg: Footing(point, frame, frame) for leg, point in feet.items()}, pitch, frame)


@dataclass(frozen=True)
class MoveContext:
    """What a file's words mean on an obstacle, for a manoeuvre."""

    belief: Case
    unit: Number  # m
    time: Number  # s, t*
    lift: Number  # m, d_y
    depths: Mapping[str, Number] = field(default_factory=dict)  # m, of feet in what they stand on, by chart; else 0
    extra_charts: Mapping[str, Chart] = field(default_factory=dict)  # charts of the manoeuvre's
    supports: Mapping[str, tuple[Support, ...]] = field(default_factory=lambda: {"free": ()})  # by name, of every body
    laws: tuple[str, ...] = ()  # that moves may be under
    stage: Mapping[str, Any] = field(default_factory=dict)  # what all stages have besides

    def foot(self, leg: int, place: Place, where: str, depth: Number | None = None) -> Footing:
        """Of a leg at a place, at the usual depth or another one (m). Raises `InputError` of what stands `where`."""
        name, chart, numbers = self.chart(place, where)
        if not len(chart.names) - chart.optional <= len(numbers) <= len(chart.names):
            raise InputError(f"{where} = {_plain(numbers)} is not allowed: [{', '.join(chart.names)}]")
        deep = self.depths.get(name, 0.0) if depth is None else depth
        stands = chart.frame if chart.stands is None else chart.stands
        point = chart.at(self.belief.obstacle, float(SIDE[leg - 1]), self.unit, deep, *numbers)
        return Footing(point, chart.frame, stands, place)

    def base(self, place: Place, where: str) -> tuple[Float[Array, " 3"], Number | None, Chart]:
        """The base's centre (m), its pitch (rad) if that is said, and its chart. Raises `InputError`."""
        _, chart, numbers = self.chart(place, where)
        names, count = chart.based(), len(chart.names)
        if not (count - chart.optional <= len(numbers) <= len(names)):
            raise InputError(f"{where} = {_plain(numbers)} is not allowed: [{', '.join(names)}]")
        obstacle, numbers, pitch = self.belief.obstacle, numbers[:count], numbers[count:]
        point = chart.at(obstacle, 1.0, self.unit, 0.0, *numbers)
        if chart.pitch:
            return point, chart.pitch(obstacle, self.unit, *numbers), chart
        return point, jnp.radians(jnp.asarray(pitch[0], float)) if pitch else None, chart

    def chart(self, place: Place, where: str) -> tuple[str, Chart, Numbers]:
        """Name and chart of a place, and its coordinates. Raises `InputError`."""
        if len(place) != 1:
            raise InputError(f"{where} = {_plain(place)} is not allowed: coordinates in one chart")
        name, numbers = next(iter(place.items()))
        offered = {**self.belief.obstacle.charts, **self.extra_charts}
        if name not in offered:
            kind = self.belief.obstacle.kind
            raise InputError(f"{where}: chart {name} is unknown on {kind}{suggest(name, offered)}")
        return name, offered[name], numbers

    @property
    def left(self) -> Float[np.ndarray, " 3"]:
        """Unit vector (world axes) to the left of the robot."""
        x, y = self.belief.obstacle.forward
        return np.array([-y, x, 0.0])

    def vector(self, leg: int, numbers: Numbers) -> Float[Array, " 3"]:
        """Out to the leg's side, ahead and up."""
        out, ahead, up = (jnp.asarray(number, float) for number in numbers)
        level = float(SIDE[leg - 1]) * out * self.left + ahead * np.array([*self.belief.obstacle.forward, 0.0])
        return level + up * np.array([0.0, 0.0, 1.0])


def initial_stance(part: str, context: MoveContext) -> tuple[Float[Array, "6 3"], Float[Array, " 3"], Standing]:
    """Where feet and base are (m, world axes) before anything moves, by a part that is `placing`.

    Raises `InputError`.
    """
    _, move = placing_move(context.belief, part)
    feet = {leg: context.foot(leg, place or {}, f"{move.path}.{group}", move.depth)
            for group, place in move.feet.items() for leg in GROUPS[group]}  # fmt: skip
    position, pitch, chart = context.base(move.base, f"{move.path}.base")
    standing = Standing(feet, 0.0 if pitch is None else pitch, chart.frame)
    world = jnp.stack([foot_in_frame(context.belief, feet[leg], WORLD) for leg in LEGS])
    return world, foot_in_frame(context.belief, Footing(position, chart.frame), WORLD), standing


def part_stages(
    part: str, context: MoveContext, standing: Standing, prefix: str | None = None
) -> tuple[list[Stage], Standing]:
    """Stages of a part's moves from where the robot stands, and where it stands then; `PART.` is before their names.

    Raises `InputError` for what the language has no words for.
    """
    return move_stages(read_moves(context.belief, part), context, standing, f"{part}." if prefix is None else prefix)


def move_stages(
    moves: Mapping[str, Move], context: MoveContext, standing: Standing, prefix: str
) -> tuple[list[Stage], Standing]:
    """Stages of moves by name, as `stages_of` makes them."""
    stages = []
    for name, move in moves.items():
        stage, standing = _move_stage(prefix + name, move, context, standing)
        stages.append(stage)
    return stages, standing


def _move_stage(name: str, move: Move, context: MoveContext, standing: Standing) -> tuple[Stage, Standing]:
    feet, frames, swing, guides = (
        dict(standing.feet),
        {leg: foot.stance_frame for leg, foot in standing.feet.items()},
        {},
        {},
    )
    for group, place_said in move.feet.items():
        where = f"{move.path}.{group}"
        for leg in GROUPS[group]:
            old_footing = standing.feet[leg]
            if (place := place_said or old_footing.place) is None:
                raise InputError(f"{where} is not allowed without a place: nothing says where it stands")
            feet[leg] = context.foot(leg, place, where)
            frames[leg] = feet[leg].frame
            swing[leg] = feet[leg].point if move.depth is None else context.foot(leg, place, where, move.depth).point
            if move.leave and move.land:
                ways = (context.unit * context.vector(leg, numbers) for numbers in (move.leave, move.land))
                starts = foot_in_frame(context.belief, old_footing, frames[leg]), feet[leg].point
                guides[leg] = jnp.stack([start + way for start, way in zip(starts, ways, strict=True)])
    known(move.support, context.supports, f"{move.path}.support = {move.support}")
    if move.law:
        known(move.law, context.laws, f"{move.path}.law = {move.law}")
    stage = Stage(
        name, move.time * context.time if move.seconds is None else move.seconds, swing,
        CYCLES[move.swing], move.lift * context.lift,
        (0.0, 0.0, 1.0) if move.plane is None else jnp.stack([context.vector(leg, move.plane) for leg in LEGS]),
        carry=move.carry, guides=guides, foot_frames=tuple(frames[leg] for leg in LEGS), base_frame=standing.frame,
        support=context.supports[move.support], law=move.law, **context.stage,
    )  # fmt: skip
    pace, rates = PACES[move.pace]
    press = move.press * stage.press[0], move.press * stage.press[1]
    stage = replace(stage, pace=pace, rates=tuple(move.rates) if move.rates else rates, press=press)
    if not move.base:
        return stage, standing._replace(feet=feet)
    position, pitch, chart = context.base(move.base, f"{move.path}.base")
    turn = None if pitch is None else jnp.asarray(standing.pitch - pitch, float)
    pivot, arc = None, jnp.radians(jnp.asarray(move.arc, float))
    if move.pivot:
        pivot = context.base({next(iter(move.base)): move.pivot}, f"{move.path}.pivot")[0]
    elif chart.about and turn is not None:
        pivot, arc = chart.about(context.belief.obstacle, context.unit, *next(iter(move.base.values()))), jnp.abs(turn)
    stage = replace(
        stage, position=position, turn=None if turn is None else turn * context.left, pivot=pivot, arc=arc,
        base_frame=chart.frame,
    )  # fmt: skip
    return stage, Standing(feet, standing.pitch if pitch is None else pitch, chart.frame)


def foot_in_frame(belief: Case, foot: Footing, frame: int) -> Float[Array, " 3"]:
    """Where a foot stands (m), in a frame, free bodies as they start."""
    if foot.frame == frame:
        return foot.point
    free = free_start(belief.obstacle)
    return to_frame(to_world(foot.point[None], jnp.array([foot.frame]), free), jnp.array([frame]), free)[0]


def read_moves(belief: Case, part: str, enclosing: tuple[str, ...] = ()) -> dict[str, Move]:
    """The moves of a part of a case's plan, by name. Raises `InputError`.

    A part with `reverse` has those of another one backwards, which began as the only move of the part `from` places the
    robot; with `mirror`, two charts, as seen in a mirror across its way, in which the charts change places; under a
    `law` of its own, if it says one. One with `repeat` has its own again and again, with `1.`, `2.` before their names.
    """
    content = tabled(belief, part)
    if part not in content:
        raise InputError(f"plan.{part} is missing{suggest(part, content)}")
    common = {key: value for key, value in content[part].items() if not isinstance(value, Mapping)}
    if not isinstance(chart := common.get("base", ""), str):
        raise InputError(f"plan.{part}.base = {chart} is not allowed: a chart's name")
    if "reverse" not in common:
        prefixes = [f"{k + 1}." for k in range(common.pop(REPEAT))] if REPEAT in common else [""]
        parsed = {name: {**common, **values, "base": _base_with_chart(common, values)}
                 for name, values in content[part].items() if isinstance(values, Mapping)}  # fmt: skip
        return {prefix + name: _parse_move(f"plan.{part}.{name}", _repetition(values, k))
                for k, prefix in enumerate(prefixes) for name, values in parsed.items()}  # fmt: skip
    for key in content[part]:
        known(key, REVERSED, f"plan.{part}.{key}")
    enclosing = (*enclosing, part)  # which are made of this one
    for key in ("reverse", "from"):
        if not isinstance(other_part := common.get(key), str) or other_part in enclosing:
            raise InputError(f"plan.{part}.{key} = {other_part} is not allowed: another part")
    forward_moves = {
        "": placing_move(belief, common["from"], enclosing)[1],
        **read_moves(belief, common["reverse"], enclosing),
    }
    parsed = reverse_moves(_with_pitch(belief, forward_moves))
    if mirror_charts := common.get("mirror"):
        if not isinstance(mirror_charts, list) or len(mirror_charts) != 2:
            raise InputError(f"plan.{part}.mirror = {mirror_charts} is not allowed: two charts")
        parsed = {name: mirror_move(belief, move, mirror_charts) for name, move in parsed.items()}
    return {name: replace(move, law=common.get("law", move.law)) for name, move in parsed.items()}


def _repetition(values: Any, k: int) -> Any:
    """What a move says when it is made after `k` times: numbers that go by it are arrays."""
    return jax.tree.map(lambda x: x[k] if np.ndim(x) else x, values)


def reverse_moves(moves: Mapping[str, Move]) -> dict[str, Move]:
    """Moves that go back to where the robot is placed by the first one: each to where the forward one came from."""
    start, *others = moves.items()
    base, feet, reversed_moves = start[1].base, _by_leg(start[1]), {}
    for name, move in others:
        targets = _by_leg(move)
        reversed_moves[name] = replace(
            move, base=base, feet={leg: feet[leg] for leg in targets}, leave=move.land, land=move.leave
        )
        base, feet = move.base or base, feet | {leg: place for leg, place in targets.items() if place}
    return dict(reversed(reversed_moves.items()))


def _with_pitch(belief: Case, moves: Mapping[str, Move]) -> dict[str, Move]:
    """Moves that say the pitch which the base keeps where it says none: its charts do not tell it."""
    offered, pitch, result = belief.obstacle.charts, 0.0, {}
    for name, move in moves.items():
        for place, numbers in move.base.items():
            chart = offered.get(place)
            if chart is None or chart.pitch:
                pitch = None
            elif len(numbers) > len(chart.names):
                pitch = numbers[-1]
            elif pitch is not None:
                move = replace(move, base={place: [*numbers, pitch]})
        result[name] = move
    return result


def _by_leg(move: Move) -> dict[str, Place | None]:
    """Where each leg goes that a move names."""
    return {NAMES[leg]: place for group, place in move.feet.items() for leg in GROUPS[group]}


def placing_move(belief: Case, part: str, enclosing: tuple[str, ...] = ()) -> tuple[str, Move]:
    """A part's only move, which places base and feet, with its name. Raises `InputError`."""
    (name, move), *others = read_moves(belief, part, enclosing).items()
    if others or not move.base or len({leg for leg, place in _by_leg(move).items() if place}) < len(LEGS):
        raise InputError(f"plan.{part} is not allowed: one move, which places the base and all feet")
    return name, move


def mirror_move(belief: Case, move: Move, charts: Sequence[str]) -> Move:
    """A move in a mirror across the robot's way: what is ahead is behind, front legs are rear ones."""
    offered, swapped_chart = belief.obstacle.charts, dict(zip(charts, reversed(charts), strict=True))

    def place(values: Place | None) -> Place | None:
        return values and {swapped_chart.get(chart, chart): [-number if name == "ahead" else number
                          for name, number in zip(offered[chart].names, numbers, strict=False)]
                          for chart, numbers in values.items()}  # fmt: skip

    def vector(values: Numbers | None) -> Numbers | None:
        return values and [values[0], -values[1], values[2]]

    feet = {OPPOSITE[group]: place(values) for group, values in move.feet.items()}
    return replace(move, feet=feet, base=place(move.base) or {}, plane=vector(move.plane), leave=vector(move.leave),
                   land=vector(move.land))  # fmt: skip


def _base_with_chart(common: Mapping[str, Any], values: Mapping[str, Any]) -> Any:
    """The base's place with its chart, which the part says if the move does not."""
    place = values.get("base", {})
    return {common.get("base", ""): place} if isinstance(place, list) else place


def _parse_move(where: str, values: Mapping[str, Any]) -> Move:
    feet = {key: values[key] for key in GROUPS if key in values}
    words = {key: value for key, value in values.items() if key not in GROUPS}
    allowed = [f.name for f in fields(Move) if f.name not in ("feet", "path")]
    for key, value in words.items():
        known(key, [*allowed, *GROUPS], f"{where}.{key}")
        if key in WORDS:
            known(value, WORDS[key], f"{where}.{key} = {value}")
        if key in SIZES and (not isinstance(value, list) or (value and len(value) != SIZES[key])):
            raise InputError(f"{where}.{key} = {_plain(value)} is not allowed: [{', '.join(COMPONENTS[key])}]")
        if key in NUMBERS and (isinstance(value, Mapping | list) or (value is None is not NUMBERS[key])):
            raise InputError(f"{where}.{key} = {_plain(value)} is not allowed: a number")
    for key, value in values.items():
        wrong = [number for number in _leaves(value) if isinstance(number, NOT_A_NUMBER)]
        if wrong and key not in (*WORDS, "support", "law"):
            raise InputError(f"{where}.{key} = {wrong[0]} is not allowed: a number")
        if key in LONG and isinstance(value, int | float) and not 0 < value < math.inf:
            raise InputError(f"{where}.{key} = {value:g} is not allowed: above 0")
    for key in ("base", *feet):
        place = values.get(key)
        if place and not (isinstance(place, Mapping) and [*map(type, place.values())] == [list]):
            raise InputError(f"{where}.{key} = {_plain(place)} is not allowed: coordinates in one chart")
    return Move(where, feet, **words)


def _plain(value: Any) -> Any:
    """What stands in a plan, for a message: numbers that have followed a size as others."""

    def plain(x: Any) -> Any:
        return float(f"{x:.6g}") if isinstance(x, jax.Array) and not isinstance(x, Tracer) else x

    return jax.tree.map(plain, value)


def _leaves(value: Any) -> Iterator[Any]:
    """What stands in a value of a move, but in it alone."""
    if isinstance(value, Mapping | list):
        for part in value.values() if isinstance(value, Mapping) else value:
            yield from _leaves(part)
    elif value is not None:
        yield value


def read_numbers[T](cls: type[T], belief: Case, part: str) -> T:
    """A part of a case's plan that holds numbers, not moves, as a named tuple. Raises `InputError`."""
    values, names = tabled(belief).get(part, {}), cls.__annotations__
    if missing := [name for name in names if name not in values]:
        raise InputError(f"plan.{part}.{missing[0]} is missing")
    for name, value in values.items():
        known(name, names, f"plan.{part}.{name}")
        is_list = get_origin(names[name]) is tuple
        length, numbers = (len(get_args(names[name])), value) if is_list else (1, [value])
        if not isinstance(numbers, list) or len(numbers) != length or any(isinstance(x, NOT_A_NUMBER) for x in numbers):
            allowed = f"{length} numbers" if is_list else "a number"
            raise InputError(f"plan.{part}.{name} = {_plain(value)} is not allowed: {allowed}")
    return cls(**{name: tuple(value) if isinstance(value, list) else value for name, value in values.items()})

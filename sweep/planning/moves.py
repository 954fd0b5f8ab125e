"""Reading of the moves in a plan file and their conversion to stages.

A move takes the base to a pose and feet to places, given by coordinates in charts that the obstacle offers. The left
and right foot of a pair get mirrored places.
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

from sweep.controllers.frames import points_to_frame, points_to_world
from sweep.controllers.plan import CYCLE_A, CYCLE_B, CYCLE_B_SMOOTH, HALF_ELLIPSE, SMOOTH, STEADY, Stage, SupportMotion
from sweep.core.errors import InputError, format_name_suggestion, require_choice
from sweep.formulas.leg import SIDE_BY_LEG
from sweep.models.case import Case
from sweep.models.frames import WORLD_FRAME
from sweep.models.legs import LEG_GROUPS, LEG_NAMES, LEGS
from sweep.models.obstacles.charts import Chart, Number
from sweep.models.obstacles.surface import free_start_state
from sweep.planning.plan_table import COMPONENTS, LONG, REPEAT, SINGLE, evaluate_plan

CYCLES = {"a": CYCLE_A, "b": CYCLE_B, "b_smooth": CYCLE_B_SMOOTH, "half_ellipse": HALF_ELLIPSE}
# timing of the base along its path: even, a cubic from rest to rest, or trapezoidal
PACES = {"even": (STEADY, (1.0, 1.0)), "eased": (STEADY, (0.0, 0.0)), "smooth": (SMOOTH, (1.0, 1.0))}
# front legs for rear legs, and the other way round
OPPOSITE = {group: group.replace("front", "rear") if "front" in group else group.replace("rear", "front")
            for group in LEG_GROUPS}  # fmt: skip
NOT_A_NUMBER = str | bool | list | Mapping | None  # types in a plan file that are no numbers
type Feet = dict[int, Float[Array, " 3"]]  # m, by leg
type Numbers = list[Any]
type Place = Mapping[str, Numbers]  # coordinates in one chart


@dataclass(frozen=True)
class Move:
    """One move of a plan file: which feet go where, where the base goes, and how long this takes.

    Lengths are in the manoeuvre's unit unless said otherwise.
    """

    path: str  # path of the move in the file, for messages
    # group of legs -> place of its feet; None: they stay in place and get another depth
    feet: Mapping[str, Place | None] = field(default_factory=dict)
    time: Number = 1.0  # t*
    seconds: Number | None = None  # in place of `time`
    # base at the end; its pitch (deg, nose up) may follow the coordinates
    base: Place = field(default_factory=dict)
    pace: str = "even"  # timing of the base
    rates: Numbers | None = None  # speed of an even pace at the start and end, over its mean speed
    pivot: Numbers | None = None  # centre of the base's arc, in the same chart
    arc: Number = 0.0  # deg
    depth: Number | None = None  # m, of these feet in what they stand on
    swing: str = "b"  # profile of the swing
    lift: Number = 0.0  # height of the swing, in units of d_y
    carry: Number = 0.0  # share of the swing that progresses evenly, as the base does
    plane: Numbers | None = None  # direction in which the swing is lifted; None: upward
    leave: Numbers | None = None  # offset of the swing curve's first control point from the old place
    land: Numbers | None = None  # offset of its second control point from the new place
    press: Number = 1.0  # factor on the manoeuvre's own pressure of feet on free bodies
    support: str = "free"  # reference motion of free bodies, by a name of the manoeuvre; "free": as measured
    law: str = ""  # law that guides the move, or by which metrics find it


REVERSED = ("reverse", "from", "mirror", "law")  # keys of a part that is another part reversed
WORDS = {"pace": PACES, "swing": CYCLES}
NUMBERS = {f.name: f.default for f in fields(Move) if f.name in SINGLE}
SIZES = {key: len(names) for key, names in COMPONENTS.items() if key != "base"}  # lengths of lists


class FramedFoothold(NamedTuple):
    """Foothold of a foot: a point (m), and the body or world frame in which the point is fixed."""

    point: Float[Array, " 3"]  # m, in `frame`; the next swing's curve starts from it
    frame: int = WORLD_FRAME  # frame of `point`
    stance_frame: int = WORLD_FRAME  # frame that the foot moves with while it stands
    place: Place | None = None  # place in a chart, if the file names one


class StandingState(NamedTuple):
    """Footholds of all feet and pitch of the base between two moves of a plan file."""

    feet: Mapping[int, FramedFoothold]  # by leg
    pitch: Number  # rad, of the base, nose up
    frame: int = WORLD_FRAME  # of the base


def make_standing_state(feet: Feet, pitch: Number, frame: int = WORLD_FRAME) -> StandingState:
    """Return the `StandingState` of a robot whose footholds are given as points, not as coordinates of the obstacle.

    Args:
        feet: leg number -> foothold (m).
        pitch: of the base (rad), nose up.
        frame: frame of all feet and the base.
    """
    return StandingState({leg: FramedFoothold(point, frame, frame) for leg, point in feet.items()}, pitch, frame)


@dataclass(frozen=True)
class MoveContext:
    """Coordinate systems of the obstacle, units and directions by which moves of a plan file are interpreted."""

    belief: Case
    unit: Number  # m, unit of lengths
    time: Number  # s, t*
    lift: Number  # m, d_y
    # m, of feet in what they stand on, by chart; 0 for others
    depths: Mapping[str, Number] = field(default_factory=dict)
    # charts of the manoeuvre, besides those of the obstacle
    extra_charts: Mapping[str, Chart] = field(default_factory=dict)
    # by name, the reference motion of every free body
    supports: Mapping[str, tuple[SupportMotion, ...]] = field(default_factory=lambda: {"free": ()})
    laws: tuple[str, ...] = ()  # names of laws that moves may use
    stage: Mapping[str, Any] = field(default_factory=dict)  # further fields of all stages

    def foothold_at(self, leg: int, place: Place, where: str, depth: Number | None = None) -> FramedFoothold:
        """Return the foothold of a leg from its coordinates in a plan file.

        Args:
            leg: leg number.
            place: coordinates in a chart.
            where: path of the place in the file, for messages.
            depth: depth of the foot in what it stands on (m); None: that of the chart.

        Raises:
            InputError: the chart is unknown, or has other coordinates.
        """
        name, chart, numbers = self.chart_and_coordinates(place, where)
        if not len(chart.names) - chart.optional_count <= len(numbers) <= len(chart.names):
            raise InputError(f"{where} = {_plain(numbers)} is not allowed: [{', '.join(chart.names)}]")
        deep = self.depths.get(name, 0.0) if depth is None else depth
        stands = chart.frame if chart.standing_frame is None else chart.standing_frame
        point = chart.at(self.belief.obstacle, float(SIDE_BY_LEG[leg - 1]), self.unit, deep, *numbers)
        return FramedFoothold(point, chart.frame, stands, place)

    def base_pose_at(self, place: Place, where: str) -> tuple[Float[Array, " 3"], Number | None, Chart]:
        """Return the base's centre (m), its pitch (rad) if given, and the chart, from coordinates in a plan file.

        Args:
            place: coordinates in a chart, with the pitch (deg) after them if the chart does not determine it.
            where: path of the place in the file, for messages.

        Raises:
            InputError: the chart is unknown, or has other coordinates.
        """
        _, chart, numbers = self.chart_and_coordinates(place, where)
        names, count = chart.base_coordinate_names(), len(chart.names)
        if not (count - chart.optional_count <= len(numbers) <= len(names)):
            raise InputError(f"{where} = {_plain(numbers)} is not allowed: [{', '.join(names)}]")
        obstacle, numbers, pitch = self.belief.obstacle, numbers[:count], numbers[count:]
        point = chart.at(obstacle, 1.0, self.unit, 0.0, *numbers)
        if chart.pitch:
            return point, chart.pitch(obstacle, self.unit, *numbers), chart
        return point, jnp.radians(jnp.asarray(pitch[0], float)) if pitch else None, chart

    def chart_and_coordinates(self, place: Place, where: str) -> tuple[str, Chart, Numbers]:
        """Return name and definition of the chart (coordinates on the obstacle) of a plan-file place, and its numbers.

        Args:
            place: coordinates in a chart.
            where: path of the place in the file, for messages.

        Raises:
            InputError: the place names no chart, or an unknown one.
        """
        if len(place) != 1:
            raise InputError(f"{where} = {_plain(place)} is not allowed: coordinates in one chart")
        name, numbers = next(iter(place.items()))
        offered = {**self.belief.obstacle.charts, **self.extra_charts}
        if name not in offered:
            kind = self.belief.obstacle.kind
            raise InputError(f"{where}: chart {name} is unknown on {kind}{format_name_suggestion(name, offered)}")
        return name, offered[name], numbers

    @property
    def left_direction(self) -> Float[np.ndarray, " 3"]:
        """Unit vector (world axes) to the left of the robot."""
        x, y = self.belief.obstacle.forward
        return np.array([-y, x, 0.0])

    def to_world_vector(self, leg: int, numbers: Numbers) -> Float[Array, " 3"]:
        """Convert a vector to world axes from components outward from the leg's side of the body, ahead, and up."""
        out, ahead, up = (jnp.asarray(number, float) for number in numbers)
        level = float(SIDE_BY_LEG[leg - 1]) * out * self.left_direction + ahead * np.array(
            [*self.belief.obstacle.forward, 0.0]
        )
        return level + up * np.array([0.0, 0.0, 1.0])


def initial_stance(part: str, context: MoveContext) -> tuple[Float[Array, "6 3"], Float[Array, " 3"], StandingState]:
    """Return feet and base at the start, as the given part of the plan file places them.

    Args:
        part: name of the part.
        context: meaning of the file's words.

    Returns:
        Feet (m), (6, 3), and base position (m), world axes; and where the robot stands.

    Raises:
        InputError: the part does not place the base and all feet.
    """
    _, move = read_placement_move(context.belief, part)
    feet = {leg: context.foothold_at(leg, place or {}, f"{move.path}.{group}", move.depth)
            for group, place in move.feet.items() for leg in LEG_GROUPS[group]}  # fmt: skip
    position, pitch, chart = context.base_pose_at(move.base, f"{move.path}.base")
    standing = StandingState(feet, 0.0 if pitch is None else pitch, chart.frame)
    world = jnp.stack([transform_foothold(context.belief, feet[leg], WORLD_FRAME) for leg in LEGS])
    return world, transform_foothold(context.belief, FramedFoothold(position, chart.frame), WORLD_FRAME), standing


def plan_part_stages(
    part: str, context: MoveContext, standing: StandingState, prefix: str | None = None
) -> tuple[list[Stage], StandingState]:
    """Convert the moves in one part of a plan file to plan stages; return these, and feet and base after them.

    Args:
        part: name of the part.
        context: meaning of the file's words.
        standing: where the robot stands before.
        prefix: put before the names of the stages; None: the part's name with a dot.

    Raises:
        InputError: a move is not understood.
    """
    return move_stages(read_moves(context.belief, part), context, standing, f"{part}." if prefix is None else prefix)


def move_stages(
    moves: Mapping[str, Move], context: MoveContext, standing: StandingState, prefix: str
) -> tuple[list[Stage], StandingState]:
    """Convert moves of a plan file to plan stages; return these, and feet and base after them.

    Args:
        moves: moves by name.
        context: meaning of the file's words.
        standing: where the robot stands before.
        prefix: put before the names of the stages.

    Raises:
        InputError: a move is not understood.
    """
    stages = []
    for name, move in moves.items():
        stage, standing = _move_stage(prefix + name, move, context, standing)
        stages.append(stage)
    return stages, standing


def _move_stage(name: str, move: Move, context: MoveContext, standing: StandingState) -> tuple[Stage, StandingState]:
    feet, frames, swing, guides = (
        dict(standing.feet),
        {leg: foot.stance_frame for leg, foot in standing.feet.items()},
        {},
        {},
    )
    for group, place_said in move.feet.items():
        where = f"{move.path}.{group}"
        for leg in LEG_GROUPS[group]:
            old_footing = standing.feet[leg]
            if (place := place_said or old_footing.place) is None:
                raise InputError(
                    f"{where} is not allowed without a place: no chart gives the place where this foot stands"
                )
            feet[leg] = context.foothold_at(leg, place, where)
            frames[leg] = feet[leg].frame
            swing[leg] = (
                feet[leg].point if move.depth is None else context.foothold_at(leg, place, where, move.depth).point
            )
            if move.leave and move.land:
                offsets = (context.unit * context.to_world_vector(leg, numbers) for numbers in (move.leave, move.land))
                starts = transform_foothold(context.belief, old_footing, frames[leg]), feet[leg].point
                guides[leg] = jnp.stack([start + offset for start, offset in zip(starts, offsets, strict=True)])
    require_choice(move.support, context.supports, f"{move.path}.support = {move.support}")
    if move.law:
        require_choice(move.law, context.laws, f"{move.path}.law = {move.law}")
    stage = Stage(
        name, move.time * context.time if move.seconds is None else move.seconds, swing,
        CYCLES[move.swing], move.lift * context.lift,
        ((0.0, 0.0, 1.0) if move.plane is None
         else jnp.stack([context.to_world_vector(leg, move.plane) for leg in LEGS])),
        carry=move.carry, guides=guides, foot_frames=tuple(frames[leg] for leg in LEGS), base_frame=standing.frame,
        support=context.supports[move.support], law=move.law, **context.stage,
    )  # fmt: skip
    pace, rates = PACES[move.pace]
    press = move.press * stage.press[0], move.press * stage.press[1]
    stage = replace(stage, pace=pace, rates=tuple(move.rates) if move.rates else rates, press=press)
    if not move.base:
        return stage, standing._replace(feet=feet)
    position, pitch, chart = context.base_pose_at(move.base, f"{move.path}.base")
    turn = None if pitch is None else jnp.asarray(standing.pitch - pitch, float)
    pivot, arc = None, jnp.radians(jnp.asarray(move.arc, float))
    if move.pivot:
        pivot = context.base_pose_at({next(iter(move.base)): move.pivot}, f"{move.path}.pivot")[0]
    elif chart.pivot and turn is not None:
        pivot, arc = chart.pivot(context.belief.obstacle, context.unit, *next(iter(move.base.values()))), jnp.abs(turn)
    stage = replace(
        stage, position=position, turn=None if turn is None else turn * context.left_direction, pivot=pivot, arc=arc,
        base_frame=chart.frame,
    )  # fmt: skip
    return stage, StandingState(feet, standing.pitch if pitch is None else pitch, chart.frame)


def transform_foothold(belief: Case, foot: FramedFoothold, frame: int) -> Float[Array, " 3"]:
    """Transform a foothold (m) to another coordinate frame, with free bodies at their start poses.

    Args:
        belief: has the obstacle.
        foot: the footing.
        frame: number of the frame.
    """
    if foot.frame == frame:
        return foot.point
    free = free_start_state(belief.obstacle)
    return points_to_frame(points_to_world(foot.point[None], jnp.array([foot.frame]), free), jnp.array([frame]), free)[
        0
    ]


def read_moves(belief: Case, part: str, enclosing: tuple[str, ...] = ()) -> dict[str, Move]:
    """Return the moves (steps of feet and base) in one part of a case's plan file, by name.

    A part with `repeat` has its moves several times, with prefixes `1.`, `2.` and so on. A part with `reverse` has the
    moves of another part backwards, which started where the only move of the part `from` places the robot. It may have
    a `law` of its own, and a `mirror`: two charts that are exchanged while the moves are mirrored across the robot's
    direction.

    Args:
        belief: the case.
        part: name of the part.
        enclosing: parts that are made of this one.

    Raises:
        InputError: the part is missing or not understood.
    """
    content = evaluate_plan(belief, part)
    if part not in content:
        raise InputError(f"plan.{part} is missing{format_name_suggestion(part, content)}")
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
        require_choice(key, REVERSED, f"plan.{part}.{key}")
    enclosing = (*enclosing, part)  # which are made of this one
    for key in ("reverse", "from"):
        if not isinstance(other_part := common.get(key), str) or other_part in enclosing:
            raise InputError(f"plan.{part}.{key} = {other_part} is not allowed: another part")
    forward_moves = {
        "": read_placement_move(belief, common["from"], enclosing)[1],
        **read_moves(belief, common["reverse"], enclosing),
    }
    parsed = reverse_moves(_with_pitch(belief, forward_moves))
    if mirror_charts := common.get("mirror"):
        if not isinstance(mirror_charts, list) or len(mirror_charts) != 2:
            raise InputError(f"plan.{part}.mirror = {mirror_charts} is not allowed: two charts")
        parsed = {name: mirror_move(belief, move, mirror_charts) for name, move in parsed.items()}
    return {name: replace(move, law=common.get("law", move.law)) for name, move in parsed.items()}


def _repetition(values: Any, k: int) -> Any:
    """Values of a move in its repetition number `k`; numbers that depend on it are arrays."""
    return jax.tree.map(lambda x: x[k] if np.ndim(x) else x, values)


def reverse_moves(moves: Mapping[str, Move]) -> dict[str, Move]:
    """Return moves in reverse order, so that they lead back to where the first move begins."""
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
    """Add the pitch that the base keeps to moves that give none, neither themselves nor by their charts."""
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
    """Place of each leg that a move names."""
    return {LEG_NAMES[leg]: place for group, place in move.feet.items() for leg in LEG_GROUPS[group]}


def read_placement_move(belief: Case, part: str, enclosing: tuple[str, ...] = ()) -> tuple[str, Move]:
    """Return name and content of the only move in a part of a plan file; the move must place the base and all feet.

    Args:
        belief: the case.
        part: name of the part.
        enclosing: parts that are made of this one.

    Raises:
        InputError: the part has several moves, or does not place everything.
    """
    (name, move), *others = read_moves(belief, part, enclosing).items()
    if others or not move.base or len({leg for leg, place in _by_leg(move).items() if place}) < len(LEGS):
        raise InputError(f"plan.{part} is not allowed: one move, which places the base and all feet")
    return name, move


def mirror_move(belief: Case, move: Move, charts: Sequence[str]) -> Move:
    """Mirror a move across the robot's direction of motion: ahead becomes behind, front legs become rear legs.

    Args:
        belief: the case.
        move: move to mirror.
        charts: charts to exchange.
    """
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
    """Place of the base with its chart, which the part names if the move does not."""
    place = values.get("base", {})
    return {common.get("base", ""): place} if isinstance(place, list) else place


def _parse_move(where: str, values: Mapping[str, Any]) -> Move:
    feet = {key: values[key] for key in LEG_GROUPS if key in values}
    words = {key: value for key, value in values.items() if key not in LEG_GROUPS}
    allowed = [f.name for f in fields(Move) if f.name not in ("feet", "path")]
    for key, value in words.items():
        require_choice(key, [*allowed, *LEG_GROUPS], f"{where}.{key}")
        if key in WORDS:
            require_choice(value, WORDS[key], f"{where}.{key} = {value}")
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
    """Values of a plan file for a message, with traced-size numbers as plain ones."""

    def plain(x: Any) -> Any:
        return float(f"{x:.6g}") if isinstance(x, jax.Array) and not isinstance(x, Tracer) else x

    return jax.tree.map(plain, value)


def _leaves(value: Any) -> Iterator[Any]:
    """All leaves of nested lists and mappings, except None."""
    if isinstance(value, Mapping | list):
        for part in value.values() if isinstance(value, Mapping) else value:
            yield from _leaves(part)
    elif value is not None:
        yield value


def read_plan_part[T](cls: type[T], belief: Case, part: str) -> T:
    """Return a part of the plan file that holds numbers instead of moves, as the named tuple class `cls`.

    Args:
        cls: named tuple with the part's keys.
        belief: the case.
        part: name of the part.

    Raises:
        InputError: a number is missing, unknown or no number.
    """
    values, names = evaluate_plan(belief).get(part, {}), cls.__annotations__
    if missing := [name for name in names if name not in values]:
        raise InputError(f"plan.{part}.{missing[0]} is missing")
    for name, value in values.items():
        require_choice(name, names, f"plan.{part}.{name}")
        is_list = get_origin(names[name]) is tuple
        length, numbers = (len(get_args(names[name])), value) if is_list else (1, [value])
        if not isinstance(numbers, list) or len(numbers) != length or any(isinstance(x, NOT_A_NUMBER) for x in numbers):
            allowed = f"{length} numbers" if is_list else "a number"
            raise InputError(f"plan.{part}.{name} = {_plain(value)} is not allowed: {allowed}")
    return cls(**{name: tuple(value) if isinstance(value, list) else value for name, value in values.items()})

"""Numbers of plans, as files of the group `plan` have them: parts of moves, or of numbers that a manoeuvre names.

A file's `extends` names the one that it starts from. Every number has a path, such as `plan.ledge.front2.base.ahead`.
Numbers hold for the sizes that the part `slopes` has under `at`, and follow others in proportion. With `way: back` the
whole is gone backwards in time, with `way: there_and_back` both ways.
"""

import dataclasses
import functools
import json
import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Any, NoReturn, Protocol, runtime_checkable

import jax
import jax.numpy as jnp
import yaml
from jaxtyping import Array

from sweep.core import project
from sweep.core.errors import InputError, known, suggest
from sweep.core.parameters import checked, quantity
from sweep.models.legs import GROUPS
from sweep.models.obstacles.charts import Chart

GROUP = "plan"
SLOPES, AT = "slopes", "at"  # the part that says how numbers follow sizes; its line with the sizes where they hold
WAY = "way"  # the line that says how the whole is gone: `forth` if there is none
FORTH, BACK, _ = DIRECTIONS = ("forth", "back", "there_and_back")
BESIDE = (SLOPES, WAY)  # keys of no part of moves or numbers
SIZED = ("robot", "obstacle")  # groups whose sizes numbers may follow
CURVE = ("out", "ahead", "up")  # out to the leg's side, in the robot's way, up
# names of the numbers in a list, by the key that it stands under; those of a place are its chart's
COMPONENTS = {"base": ("ahead", "above", "pitch"), "leave": CURVE, "land": CURVE, "plane": CURVE,
              "pivot": ("ahead", "above"), "rates": ("first", "last")}  # fmt: skip
PLACE = ("aside", "ahead")  # the same of a foot, or just the last one, in charts of a manoeuvre's own
LONG = ("time", "seconds")  # keys of how long a move lasts, which is above 0
ANY = quantity(0.0, "")
Content = Mapping[str, Any]
Names = tuple[str, ...]


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class PlanTable:
    """What a case says of its plan's numbers: a file's content, where it is not the manoeuvre's own, and changes.

    Only what is changed is traced.
    """

    text: str = dataclasses.field(default="", metadata={"static": True})  # JSON; empty: as the manoeuvre's own file
    paths: tuple[str, ...] = dataclasses.field(default=(), metadata={"static": True})  # of numbers that are changed
    values: tuple[Array | float, ...] = ()

    def changed(self, path: str, value: Any) -> "PlanTable":
        """With the number at `path` (without `plan.`) changed."""
        changes = dict(zip(self.paths, self.values, strict=True)) | {path: value}
        return dataclasses.replace(self, paths=tuple(changes), values=tuple(changes.values()))


@runtime_checkable
class Tabled(Protocol):
    """A manoeuvre whose plan's numbers are in a file has this member besides."""

    @property
    def own_plan(self) -> str:
        """Name of the file that holds them if a case has no other; empty where it must have one."""
        ...


@runtime_checkable
class TwoWay(Tabled, Protocol):
    """One whose whole plan may be gone backwards has this member besides."""

    @property
    def two_way(self) -> bool:
        """That it goes backwards in time, too: True."""
        ...


def refuse_malformed(content: Content) -> None:
    """Raise `InputError` where a file's content cannot be a plan: parts, and slopes, of words and finite numbers."""

    def wanted(form: Any, value: Any, path: str, what: str) -> None:
        if not isinstance(value, form):
            raise InputError(f"{path} = {value} is not allowed: {what}")

    def leaves(value: Any, path: str) -> None:
        if isinstance(value, Mapping):
            for key, below in value.items():
                leaves(below, f"{path}.{key}")
        elif isinstance(value, list):
            for below in value:
                wanted(str | bool | int | float, below, path, "numbers or words")
                leaves(below, path)
        elif not isinstance(value, str | bool | None):
            checked(ANY, value, path)

    for part, given in content.items():
        if part != WAY:
            wanted(Mapping, given, f"{GROUP}.{part}", "keys and values")
            leaves(given, f"{GROUP}.{part}")
    for number, line in content.get(SLOPES, {}).items():
        wanted(Mapping, line, f"{GROUP}.{SLOPES}.{number}", "sizes and numbers")
        for size, value in line.items():
            at = f"{GROUP}.{SLOPES}.{number}.{size}"
            if not checked(ANY, value, at) and number == AT:
                raise InputError(f"{at} = {value} is not allowed: a number other than 0")


def way(case: Any) -> str:
    """How a case's plan is gone, one of `DIRECTIONS`."""
    return str(_written(case).get(WAY, FORTH))


def told(case: Any) -> Content:
    """What a case says of its plan, by part and move; nothing where its numbers are not in a file."""
    return _changed(case, {})


def tabled(case: Any) -> Content:
    """The same, with numbers that have followed the sizes of this case.

    Raises `InputError` for slopes of no number, or by no size.
    """
    content = _written(case)
    slopes = content.get(SLOPES, {})
    lines, sizes = {path: line for path, line in slopes.items() if path != AT}, slopes.get(AT, {})
    off = [jnp.asarray(size(case, path) / at - 1.0, float) for path, at in sizes.items()]
    if not lines:
        return told(case)
    found = numbers(content, case.obstacle.charts)
    for path, line in lines.items():
        if path not in found:
            _refuse_lost(content, path, found)
        for by in line:
            known(by, sizes, f"plan.{SLOPES}.{path}.{by}")
    # one operation for all numbers, not one for each: it is compiled with every plan
    matrix = jnp.asarray([[line.get(by, 0.0) for by in sizes] for line in lines.values()])
    return _changed(case, dict(zip(lines, jnp.sum(matrix * jnp.stack(off), axis=1), strict=True)))


def _refuse_lost(content: Content, path: str, found: Mapping[str, float]) -> NoReturn:
    """Raise `InputError` of slopes whose number is none of those that are `found`, by what stands in its place."""
    stands, names = content, path.split(".")
    while names and isinstance(stands, Mapping) and names[0] in stands:
        stands = stands[names.pop(0)]
    above = path.removesuffix(".".join(names)).removesuffix(".")
    if not names:
        raise InputError(f"plan.{path} = {stands} is not allowed: a number")
    if isinstance(stands, Mapping) and above.count(".") < 2:  # no move has it
        raise InputError(f"plan.{SLOPES}.{path} is unknown{near(path, found, f'plan.{SLOPES}.')}")
    own = [one.removeprefix(f"{above}.") for one in found if one.startswith(f"{above}.")]
    alone = f", not {', '.join(own)} alone" if own else ""
    number = ".".join(names)
    raise InputError(f"plan.{above} = {stands} is not allowed: plan.{SLOPES} want its number {number}{alone}")


def near(path: str, found: Iterable[str], before: str = "plan.") -> str:
    """The number whose path is the closest, as what may have been meant; empty without."""
    return suggest(before + path, [before + one for one in found]).partition(" (allowed")[0]


def _written(case: Any) -> Content:
    """What the file of a case's plan says."""
    return json.loads(case.plan.text) if case.plan.text else own(case)


def _changed(case: Any, added: Mapping[str, Array]) -> Content:
    """The same with the numbers that a case changes, and what is added to numbers by path."""
    table: PlanTable = case.plan
    changes = dict(zip(table.paths, table.values, strict=True))
    if not changes and not added:
        return _written(case)

    def now(path: str, value: Any) -> Any:
        value = changes.get(path, value)
        return value + added[path] if path in added else value

    return mapped(_written(case), case.obstacle.charts, now)


def size(case: Any, path: str) -> Any:
    """A size of robot or obstacle, as axes name it, such as `robot.thigh`. Raises `InputError`."""
    group, _, name = path.partition(".")
    every = {f"{owner}.{f.name}" for owner in SIZED for f in dataclasses.fields(getattr(case, owner))
             if f.metadata.get("role") in ("quantity", "count")}  # fmt: skip
    known(path, every, f"plan.{SLOPES}.{AT}.{path}")
    return getattr(getattr(case, group), name)


def own(case: Any) -> Content:
    """Those of the manoeuvre's own file."""
    return shipped(case.manoeuvre.own_plan) if isinstance(case.manoeuvre, Tabled) and case.manoeuvre.own_plan else {}


def numbers(content: Content, places: Mapping[str, Chart]) -> dict[str, float]:
    """All numbers of a plan by path."""
    found: dict[str, float] = {}
    mapped(content, places, lambda path, value: found.setdefault(path, float(value)))
    return found


def mapped(
    content: Any, places: Mapping[str, Chart], change: Callable[[str, Any], Any], path: str = "", names: Names = ()
) -> Any:
    """`content` with every number, but those of `slopes`, replaced by what `change` makes of its path and value.

    A path does not name the chart (of `places`) in which a place is. Numbers of a list have `names`, or are counted.
    """
    if isinstance(content, Mapping):
        return {key: value if key == SLOPES else
                mapped(value, places, change, *_below(key, value, content, places, path, names))
                for key, value in content.items()}  # fmt: skip
    if isinstance(content, list):
        named = (*names, *range(len(names), len(content)))
        return [mapped(value, places, change, f"{path}.{name}") for name, value in zip(named, content, strict=False)]
    if isinstance(content, int | float) and not isinstance(content, bool):
        return change(path, content)
    return content


def _below(
    key: str, value: Any, content: Content, places: Mapping[str, Chart], path: str, names: Names
) -> tuple[str, Names]:
    """Path of what stands under a key, and names of the numbers in a list there; `names` are those of a base."""
    above = path.rpartition(".")[2]
    if above == "base":
        return path, places[key].based() if key in places else COMPONENTS["base"]
    if above in GROUPS and isinstance(value, list) and key not in COMPONENTS:
        told = places[key].names if key in places else ()
        return path, told if len(told) == len(value) else PLACE[-len(value) :]
    if isinstance(chart := content.get("base"), str):
        names = places[chart].based() if chart in places else COMPONENTS["base"]
    below = f"{path}.{key}".removeprefix(".")
    if isinstance(value, list):
        return below, (names if key == "base" else ()) or COMPONENTS.get(key, ())
    return below, names


def member(case: Any, path: str) -> "dataclasses.Field[Any]":
    """The number at `path` (without `plan.`) as a parameter. Raises `InputError`."""
    found = numbers(told(case), case.obstacle.charts)
    if path not in found:
        if not found:
            raise InputError(
                f"plan.{path} is unknown: manoeuvre.kind = {case.manoeuvre.kind} has its numbers in no file"
            )
        raise InputError(f"plan.{path} is unknown{near(path, found)} (`sweep describe plan` tells what plans have)")
    name = path.rpartition(".")[2]
    field = quantity(found[path], "", above=0 if name in LONG else -math.inf)
    field.name = name
    return field


@functools.cache
def shipped(name: str) -> Content:
    """A plan that comes with the package."""
    return merged(name, lambda other: project.shipped(GROUP)[other].read_text(encoding="utf-8"))


def merged(name: str, read: Callable[[str], str]) -> Content:
    """The plan `name` over those that it extends, the first one or a list; texts of files are `read` by name."""
    content = dict(yaml.load(project.words(read(name)), project.LOADER))
    bases = content.pop("extends", [])
    below = [merged(base, read) for base in ([bases] if isinstance(bases, str) else bases)]
    return functools.reduce(_over, [*below, content])


def differences(content: Content, other: Content) -> dict[str, Any]:
    """What a file has to say that extends `content` to be `other`: deep, lists whole."""
    found = {}
    for key, value in other.items():
        if isinstance(value, Mapping) and isinstance(content.get(key), Mapping):
            if inner := differences(content[key], value):
                found[key] = inner
        elif key not in content or content[key] != value:
            found[key] = value
    return found


def _over(below: Content, above: Content) -> dict[str, Any]:
    """Two contents, deep; what is in `above` counts."""
    found = dict(below)
    for key, value in above.items():
        deep = isinstance(value, Mapping) and isinstance(found.get(key), Mapping)
        found[key] = _over(found[key], value) if deep else value
    return found

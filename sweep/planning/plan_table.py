"""Plan files as tables: parts that hold moves or numbers of a manoeuvre, with formulas and slopes by sizes.

A file's `extends` names the one that it starts from. Every number has a path, such as `plan.ledge.front2.base.ahead`.
In place of a number a formula may stand, of names of the part `sizes` and of parameters, such as `obstacle.radius`; the
moves of a part with `repeat` are made again and again, `k` times before. Numbers hold for the sizes that the part
`slopes` has under `at`, and follow others in proportion. With `way: back` the whole is gone backwards in time, with
`way: there_and_back` both ways. The part `searched` names the command that found the numbers, and its ranges of sizes.
"""

import dataclasses
import functools
import json
import math
from collections.abc import Callable, Iterable, Mapping
from typing import Any, NoReturn

import jax.numpy as jnp
import numpy as np
import yaml
from jaxtyping import Array

from sweep.core import project
from sweep.core.errors import InputError, format_name_suggestion, require_choice
from sweep.core.expressions import evaluate_expression
from sweep.core.parameters import convert_and_check_value, quantity
from sweep.models.legs import LEG_GROUPS
from sweep.models.obstacles.charts import Chart
from sweep.models.plan_numbers import INCREMENT_PREFIX
from sweep.models.robot import length_unit
from sweep.models.solids import array_module

GROUP = "plan"
SLOPES, AT = "slopes", "at"  # the part that says how numbers follow sizes; its line with the sizes where they hold
WAY = "way"  # the line that says how the whole is gone: `forth` if there is none
FORTH, BACK, _ = DIRECTIONS = ("forth", "back", "there_and_back")
SIZES = "sizes"  # the part whose numbers formulas name
# the part that says how the numbers were found; its keys
SEARCHED, ORIGIN, COMMAND, RANGES = "searched", "origin", "command", "ranges"
# what made a plan's numbers: a person; `command`, at least the last of them; a program or command that is lost,
# at least some of them; the plans that it extends
BY_COMMAND = "command"
ORIGINS = ("hand", BY_COMMAND, "lost", "extended")
REPEAT, TIMES = "repeat", "k"  # the line that says how often a part is made; how often it was, in its formulas
BESIDE = (SLOPES, WAY, SIZES)  # keys of no part of moves or of a manoeuvre's numbers
SIZED = ("robot", "obstacle")  # groups whose sizes numbers may follow
NAMED = (*SIZED, "manoeuvre")  # groups whose numbers formulas may name
CURVE = ("out", "ahead", "up")  # out to the leg's side, in the robot's way, up
# names of the numbers in a list, by the key that it stands under; those of a place are its chart's
COMPONENTS = {"base": ("ahead", "above", "pitch"), "leave": CURVE, "land": CURVE, "plane": CURVE,
              "pivot": ("ahead", "above"), "rates": ("first", "last")}  # fmt: skip
PLACE = ("aside", "ahead")  # the same of a foot, or just the last one, in charts of a manoeuvre's own
LONG = ("time", "seconds")  # keys of how long a move lasts, which is above 0
SINGLE = (*LONG, "arc", "depth", "lift", "carry", "press")  # keys of a move's single numbers
ANY = quantity(0.0, "")
Content = Mapping[str, Any]
Names = tuple[str, ...]
Ranges = Mapping[str, tuple[float, float]]  # least and largest value of sizes, by path


def check_plan_content(content: Content) -> None:
    """Raise `InputError` if a plan file's content has other values than tables of words and finite numbers."""

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
            convert_and_check_value(ANY, value, path)

    origin = content.get(SEARCHED, {}).get(ORIGIN, BY_COMMAND)
    require_choice(origin, ORIGINS, f"{GROUP}.{SEARCHED}.{ORIGIN}")
    wanted(
        Mapping, ranges := content.get(SEARCHED, {}).get(RANGES, {}), f"{GROUP}.{SEARCHED}.{RANGES}", "sizes by path"
    )
    for size, ends in ranges.items():
        at = f"{GROUP}.{SEARCHED}.{RANGES}.{size}"
        if not isinstance(ends, list) or [type(end) in (int, float) for end in ends] != [True, True]:
            raise InputError(f"{at} = {ends} is not allowed: the least and the largest value, such as [0.4, 0.5]")
        if not ends[0] <= ends[1]:
            raise InputError(f"{at} = {ends} is not allowed: the least value comes first")
    for part, given in content.items():
        if part not in (WAY, SEARCHED):
            wanted(Mapping, given, f"{GROUP}.{part}", "keys and values")
            leaves(given, f"{GROUP}.{part}")
    for name, value in content.get(SIZES, {}).items():
        wanted(str | int | float, value, f"{GROUP}.{SIZES}.{name}", "a number or a formula")
    for number, line in content.get(SLOPES, {}).items():
        wanted(Mapping, line, f"{GROUP}.{SLOPES}.{number}", "sizes and numbers")
        for size, value in line.items():
            at = f"{GROUP}.{SLOPES}.{number}.{size}"
            if not convert_and_check_value(ANY, value, at) and number == AT:
                raise InputError(f"{at} = {value} is not allowed: a number other than 0")


def plan_direction(case: Any) -> str:
    """Return whether a case's plan is executed forward, backward in time, or there and back: one of `DIRECTIONS`."""
    return str(_file_content(case).get(WAY, FORTH))


def plan_content(case: Any) -> Content:
    """Return the content of a case's plan file with the study's numbers in it and its formulas not evaluated."""
    changes = case.plan.changed_numbers

    def now(path: str, value: Any) -> Any:
        more = changes.get(INCREMENT_PREFIX + path)
        return changes.get(path, value) if more is None else f"{value} + {more:.4g}"

    return map_numbers(_file_content(case), case.obstacle.charts, now) if changes else _file_content(case)


def evaluate_plan(case: Any, part: str = "") -> Content:
    """Return the content of a case's plan file, with formulas evaluated and corrections for sizes (`slopes`) applied.

    Args:
        case: The believed case; its numbers may be traced.
        part: Evaluate only this part; empty for all.

    Returns:
        The table's content with numbers; a formula of `k` gives an array over the repetitions.

    Raises:
        InputError: A formula has an unknown name, or a slope an unknown number or size.
    """
    content = _file_content(case)
    return _evaluate_content(case, content, _slope_amounts(case, content), part if part in content else "")


def plan_values(case: Any) -> dict[str, float]:
    """Return all numbers of a case's plan by path, formulas evaluated, without corrections for sizes (`slopes`)."""
    found = numbers_by_path(_evaluate_content(case, _file_content(case), {}), case.obstacle.charts)
    return {path: float(value) for path, value in found.items()}


def formula_values(case: Any) -> dict[str, float]:
    """Evaluate the formulas in a case's plan file; return their values by path in the file."""
    text = {
        path
        for path, value in numbers_by_path(plan_content(case), case.obstacle.charts).items()
        if isinstance(value, str)
    }
    return {path: value for path, value in plan_values(case).items() if path in text}


def _slope_amounts(case: Any, content: Content) -> dict[str, Array]:
    """Amounts by which slopes change numbers for the sizes of this case, by path."""
    slopes = content.get(SLOPES, {})
    lines, sizes = {path: line for path, line in slopes.items() if path != AT}, slopes.get(AT, {})
    off = [jnp.asarray(parameter_value(case, path) / at - 1.0, float) for path, at in sizes.items()]
    if not lines:
        return {}
    found = numbers_by_path(content, case.obstacle.charts)
    for path, line in lines.items():
        if path not in found:
            _refuse_lost(content, path, found)
        for by in line:
            require_choice(by, sizes, f"plan.{SLOPES}.{path}.{by}")
    # one operation for all numbers, not one for each: it is compiled with every plan
    matrix = jnp.asarray([[line.get(by, 0.0) for by in sizes] for line in lines.values()])
    return dict(zip(lines, jnp.sum(matrix * jnp.stack(off), axis=1), strict=True))


def _evaluate_content(case: Any, content: Content, added: Mapping[str, Array], alone: str = "") -> Content:
    """Evaluate formulas of `content`, or of one part, and apply the case's changes and the amounts `added` by path."""
    changes, sizes, times = case.plan.changed_numbers, content.get(SIZES, {}), {}
    names: dict[str, Any] = {"unit": length_unit(case.robot)}

    def named(name: str) -> Any:
        if name not in names and name in sizes:
            names[name] = None  # until it is known
            names[name] = now(f"{SIZES}.{name}", sizes[name])
        group = name.partition(".")[0]
        if group in NAMED:
            return parameter_value(case, name, name, (group,))
        if name not in names:
            beside = f", or numbers of {', '.join(NAMED)}, such as obstacle.height"
            raise InputError(f"{name} is unknown{format_name_suggestion(name, {*names, *sizes})}{beside}")
        if names[name] is None:
            raise InputError(f"{name} is told by itself")
        return names[name]

    def now(path: str, value: Any) -> Any:
        if isinstance(value, str):
            value = _number(path, value, named, times.get(path.partition(".")[0]))
        if path in changes:  # what goes by `k` is told as it is at first, and changed as much later
            value = changes[path] + (value - value[0]) if np.ndim(value) else changes[path]
        for more in (changes.get(INCREMENT_PREFIX + path), added.get(path)):
            value = value if more is None else value + more
        return value

    def counted(part: str, given: Any) -> Any:
        if part in BESIDE or REPEAT not in given:
            return given
        said = given[REPEAT]
        count = _number(f"{part}.{REPEAT}", said, named) if isinstance(said, str) else said
        if not isinstance(count, int | np.integer) or isinstance(count, bool) or count < 0:
            raise InputError(f"plan.{part}.{REPEAT} = {said} is not allowed: a whole number, or one that "
                             "shapes what is compiled, such as manoeuvre.cycles")  # fmt: skip
        times[part] = np.arange(max(1, count))
        return {**given, REPEAT: count}

    def change(path: str, value: Any) -> Any:
        part, _, name = path.partition(".")
        return named(name) if part == SIZES else now(path, value)

    parts = {part: counted(part, given) for part, given in content.items() if part == alone or not alone}
    return map_numbers(parts, case.obstacle.charts, change)


def _number(path: str, formula: str, named: Callable[[str], Any], times: np.ndarray | None = None) -> Any:
    """Evaluate the formula at a path; a formula of `k` gives an array. Raises `InputError`."""
    try:
        value = evaluate_expression(
            formula, lambda name: named(name) if times is None or name != TIMES else times, array_module
        )
        if jnp.issubdtype(jnp.result_type(value), jnp.number):
            return value
        raise TypeError
    except (SyntaxError, TypeError, ValueError) as error:
        reason = error if isinstance(error, InputError) else "a number, or a formula such as 'obstacle.radius / unit'"
        raise InputError(f"plan.{path} = {formula} is not allowed: {reason}") from None


def _refuse_lost(content: Content, path: str, found: Iterable[str]) -> NoReturn:
    """Raise `InputError` for a slope of an unknown number; the message says what is at its path instead."""
    stands, names = content, path.split(".")
    while names and isinstance(stands, Mapping) and names[0] in stands:
        stands = stands[names.pop(0)]
    above = path.removesuffix(".".join(names)).removesuffix(".")
    if not names:
        raise InputError(f"plan.{path} = {stands} is not allowed: a number")
    if isinstance(stands, Mapping) and above.count(".") < 2:  # no move has it
        raise InputError(f"plan.{SLOPES}.{path} is unknown{suggest_path(path, found, f'plan.{SLOPES}.')}")
    own = [one.removeprefix(f"{above}.") for one in found if one.startswith(f"{above}.")]
    alone = f", not {', '.join(own)} alone" if own else ""
    number = ".".join(names)
    raise InputError(
        f"plan.{above} = {stands} is not allowed: plan.{SLOPES} has a slope for its number {number}{alone}"
    )


def suggest_path(path: str, paths: Iterable[str], prefix: str = "plan.") -> str:
    """Return the closest path as the end of an error message (": did you mean ...?"); empty if none is close."""
    return format_name_suggestion(prefix + path, [prefix + one for one in paths]).partition(" (allowed")[0]


def _file_content(case: Any) -> Content:
    """Content of a case's plan table as in its file."""
    return json.loads(case.plan.text) if case.plan.text else default_plan_content(case)


def parameter_value(case: Any, path: str, label: str = "", groups: Names = SIZED) -> Any:
    """Read the value of a parameter of robot, obstacle or manoeuvre by its dotted path.

    Args:
        case: The case.
        path: As axes name it, such as `robot.thigh`.
        label: What the message calls the path; by default a line of the table's slopes.
        groups: Groups that are allowed.

    Raises:
        InputError: No such parameter.
    """
    group, _, name = path.partition(".")
    every = {f"{owner}.{f.name}" for owner in groups for f in dataclasses.fields(getattr(case, owner))
             if f.metadata.get("role") in ("quantity", "count")}  # fmt: skip
    require_choice(path, every, label or f"plan.{SLOPES}.{AT}.{path}")
    return getattr(getattr(case, group), name)


def default_plan_content(case: Any) -> Content:
    """Return the content of the default plan file of a case's manoeuvre; empty if it has none."""
    return load_shipped_plan(case.manoeuvre.default_plan_name) if case.manoeuvre.default_plan_name else {}


def numbers_by_path(content: Content, charts: Mapping[str, Chart]) -> dict[str, float | str]:
    """Return all numbers in the content of a plan file, by their dotted path in it.

    Args:
        content: The table's content.
        charts: The obstacle's charts, which name coordinates.

    Returns:
        Numbers, the first of repeated ones, and formulas as text.
    """
    found: dict[str, float | str] = {}
    map_numbers(content, charts, lambda path, value: found.setdefault(
        path, value if isinstance(value, str) else float(np.ravel(value)[0])))  # fmt: skip
    return found


def map_numbers(
    content: Any, charts: Mapping[str, Chart], change: Callable[[str, Any], Any], path: str = "", names: Names = ()
) -> Any:
    """Replace each number and formula in a plan's content by the result of a function `change`; skip the part `slopes`.

    Args:
        content: The table's content, or a branch of it.
        charts: The obstacle's charts, which name coordinates; paths do not name the chart.
        change: From path and value to the new value.
        path: Path of the branch; empty for the whole table.
        names: Names of the numbers if `content` is a list; further ones are counted.

    Returns:
        The content with new numbers.
    """
    if isinstance(content, Mapping):
        return {key: value if _is_word(key, value, path) else
                map_numbers(value, charts, change, *_nested_path(key, value, content, charts, path, names))
                for key, value in content.items()}  # fmt: skip
    if isinstance(content, list):
        named = (*names, *range(len(names), len(content)))
        return [
            map_numbers(value, charts, change, f"{path}.{name}") for name, value in zip(named, content, strict=False)
        ]
    return content if content is None or isinstance(content, bool) else change(path, content)


def _is_word(key: str, value: Any, path: str) -> bool:
    """Whether the value of a key is neither a number or formula nor contains any."""
    return key in (SLOPES, REPEAT, "mirror") or (isinstance(value, str) and key not in SINGLE and path != SIZES)


def _nested_path(
    key: str, value: Any, content: Content, charts: Mapping[str, Chart], path: str, names: Names
) -> tuple[str, Names]:
    """Path of a key's value, and names of its components if it is a list; `names` are those of a base pose."""
    above = path.rpartition(".")[2]
    if above == "base":
        return path, charts[key].base_coordinate_names() if key in charts else COMPONENTS["base"]
    if above in LEG_GROUPS and isinstance(value, list) and key not in COMPONENTS:
        told = charts[key].names if key in charts else ()
        return path, told if len(told) == len(value) else PLACE[-len(value) :]
    if isinstance(chart := content.get("base"), str):
        names = charts[chart].base_coordinate_names() if chart in charts else COMPONENTS["base"]
    below = f"{path}.{key}".removeprefix(".")
    if isinstance(value, list):
        return below, (names if key == "base" else ()) or COMPONENTS.get(key, ())
    return below, names


def plan_number_field(case: Any, path: str) -> "dataclasses.Field[Any]":
    """Return unit, bounds and default of a number in a case's plan, so that a study can vary it.

    Args:
        case: The case.
        path: The number's path without `plan.`.

    Raises:
        InputError: The plan has no such number.
    """
    found = plan_values(case)
    if path not in found:
        if not found:
            raise InputError(f"plan.{path} is unknown: manoeuvre.kind = {case.manoeuvre.kind} has no plan file")
        raise InputError(
            f"plan.{path} is unknown{suggest_path(path, found)} (`sweep describe plan` lists the numbers of plans)"
        )
    name = path.rpartition(".")[2]
    field = quantity(found[path], "", above=0 if name in LONG else -math.inf)
    field.name = name
    return field


def load_shipped_plan(name: str) -> Content:
    """Load a plan file that comes with the package, without its part on how the numbers were found."""
    return _load_shipped_parts(name)[0]


def default_searched_ranges(plan_name: str | None) -> Ranges:
    """Return the ranges of robot and obstacle sizes for which a shipped plan was optimized; empty without a file."""
    return _load_shipped_parts(plan_name)[1] if plan_name else {}


@functools.cache
def _load_shipped_parts(name: str) -> tuple[Content, Ranges]:
    files = project.shipped_files(GROUP)
    return split_search_ranges(merge_plan_with_bases(name, lambda other: files[other].read_text(encoding="utf-8")))


def split_search_ranges(content: Content) -> tuple[Content, Ranges]:
    """Split a plan file's content into the plan and the ranges of sizes for which its numbers were optimized.

    Args:
        content: The file's content, with those that it extends merged.

    Returns:
        The content without the part `searched`; the least and the largest value of each size, by path.
    """
    ranges = content.get(SEARCHED, {}).get(RANGES, {})
    plan = {key: value for key, value in content.items() if key != SEARCHED}
    return plan, {size: (float(low), float(high)) for size, (low, high) in ranges.items()}


def merge_plan_with_bases(name: str, read: Callable[[str], str]) -> Content:
    """Load a plan file and merge it over the plan files that it names under `extends`.

    Args:
        name: The table's name.
        read: From the name of a table to the text of its file.
    """
    content = dict(yaml.load(project.quote_boolean_words(read(name)), project.YAML_LOADER))
    bases = content.pop("extends", [])
    below = [merge_plan_with_bases(base, read) for base in ([bases] if isinstance(bases, str) else bases)]
    return functools.reduce(_merge_contents, [*below, content])


def find_overrides(content: Content, other: Content) -> dict[str, Any]:
    """Return the keys that a plan file must set so that, extending `content`, it equals `other`.

    Args:
        content: The table that is extended.
        other: The table that results.

    Returns:
        Nested keys with the values of `other`; lists are whole.
    """
    found = {}
    for key, value in other.items():
        if isinstance(value, Mapping) and isinstance(content.get(key), Mapping):
            if inner := find_overrides(content[key], value):
                found[key] = inner
        elif key not in content or content[key] != value:
            found[key] = value
    return found


def _merge_contents(below: Content, above: Content) -> dict[str, Any]:
    """Merge two contents key by key; `above` takes precedence."""
    found = dict(below)
    for key, value in above.items():
        deep = isinstance(value, Mapping) and isinstance(found.get(key), Mapping)
        found[key] = _merge_contents(found[key], value) if deep else value
    return found

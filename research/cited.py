"""Fills what the pages cite from research/data: `python research/cited.py` writes every block between markers anew.

    <!-- data pole_map: rate --> 239 of 375 succeed <!-- end -->

A block names a target of jobs/paper.yaml, or several, whose data jobs/paper.py writes, and a form of `FORMS`, with
words for it after a comma. A page with blocks ends in one of `<!-- data: sources -->`, a table of what made its data,
or in the guide of `<!-- data: origin -->`, a sentence. Every page of evidence begins with `<!-- data: age -->`.

`python research/cited.py --age` tells instead which data are older than the code at hand.
"""

import json
import re
import sys
from collections.abc import Iterable, Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import pandas as pd

sys.path.insert(0, str(Path(__file__).parent))
import headlines
import hexagon_figures
import validity_figures
from robustness_figures import bounds_of, errors_of, rates

from sweep.analysis.intervals import wilson
from sweep.core.errors import InputError
from sweep.core.provenance import is_current_code
from sweep.metrics.outcome import COLUMN_MEANINGS
from sweep.report.labels import axis_words, split_metric_column

RESEARCH = Path(__file__).parent
DOCS = RESEARCH.parent / "docs"
DATA = RESEARCH / "data"
ROBOT, GROUND = ("axis.size_error", 0.02), ("axis.ground_error", 0.01)  # of all sizes, which learning is to bear
TOUCH_ALONE = ("ball_descend", "ball_to_ball")  # who start on a ball, where nobody can calibrate
TABLE = re.compile(r"(?:^\|.*\n)+", re.MULTILINE)
FENCE = re.compile(r"^```.*?^```", re.MULTILINE | re.DOTALL)
NUMBER = re.compile(r"\d+(?:[.,]\d+)*")
COMMIT = re.compile(r"[0-9a-f]{12}(?:-dirty)?")
BLOCK = re.compile(r"(<!-- data ?([\w ]*): (\w+)(?:, (.*?))? -->)(\s)((?:(?!<!--).)*?)(\s)(<!-- end -->)", re.DOTALL)


def filled(text: str) -> str:
    """A page with all its blocks as the data have them. Raises `InputError` where a block cites what is not there."""
    cited = sorted(targets(text))

    def block(found: re.Match[str]) -> str:
        start, name, form, words, before, _, after, end = found.groups()
        if form not in FORMS and form not in OF_PAGE:
            raise InputError(f"{start}: {form} is not a form (allowed: {', '.join([*FORMS, *OF_PAGE])})")
        given = words.split(", ") if words else ()
        content = OF_PAGE[form](cited) if form in OF_PAGE else FORMS[form](name, *given)
        return f"{start}{before}{content}{after}{end}"

    return BLOCK.sub(block, text)


def targets(text: str) -> set[str]:
    """Those whose data a page cites."""
    return {name for found in BLOCK.finditer(text) for name in found[2].split()}


def read(name: str) -> dict[str, Any]:
    """The data of a target; of `rates`, what made all of it. Raises `InputError` where there are none."""
    if name == "rates":
        parts = [read(path.stem) for path in sorted(DATA.glob("rates_*.json"))]
        made = {key: ", ".join(sorted({part[key] for part in parts})) for key in ("engine", "commit", "code")}
        devices = sorted({device for part in parts for device in part["devices"]})
        seconds = sum(part["seconds"] for part in parts)
        made |= {"command": "python jobs/paper.py 'rates_*'", "devices": devices, "seconds": seconds}
        return made | {"versions": parts[0]["versions"]}  # of one code are those of one set of libraries
    path = DATA / f"{name}.json"
    if not path.exists():
        raise InputError(f"{name} has no data: jobs/paper.py {name}, or bench/validity, writes them")
    return json.loads(path.read_text(encoding="utf-8"))


def rate(name: str) -> str:
    """`239 of 375 succeed`, and how many are invalid."""
    data = read(name)
    are = "is" if data["invalid"] == 1 else "are"
    broken = f" ({data['invalid']:,} more {are} invalid)" if data["invalid"] else ""
    return f"{data['success']:,} of {data['valid']:,} succeed{broken}"


def rollouts(name: str) -> str:
    """How many rollouts were run."""
    return f"{read(name)['rollouts']:,}"


def causes(name: str) -> str:
    """What came of the others, the most frequent first."""
    data = read(name)
    return ", ".join(f"{number:,} `{cause}`" for cause, number in data["causes"].items()) or "none"


def errors(name: str) -> str:
    """Rates along each error, a line each."""
    table = []
    for axis, lines in read(name)["along"].items():
        for value, success, valid, invalid in lines:
            table.append(interval(success, valid) | {"axis": axis, "value": value, "invalid": invalid})
    return errors_of(pd.DataFrame(table))


def along(name: str, axis: str) -> str:
    """Successes at each value of an axis, a line each."""
    lines = ([shown(value), share(success, valid)] for value, success, valid, _ in read(name)["along"][axis])
    return ruled([True, False], [axis, "succeed"], *lines)


def draws(names: str, figures: str = "") -> str:
    """A line for each of several targets: successes, what came of the others, and the worst of some figures.

    The worst is the least of a figure named `min`, and the greatest of another, over the rollouts that succeed.
    """
    columns = figures.split()
    lines = [f"| | succeed | others |{''.join(f' {in_words(one)} |' for one in columns)}"]
    lines.append("|:--|:--|:--|" + "--:|" * len(columns))
    for name in names.split():
        data = read(name)
        others = ", ".join(f"{number:,} `{cause}`" for cause, number in data["causes"].items())
        ends = [data["figures"].get(one) for one in columns]
        worst = [f" {told(one, *end)} |" if end else " |" for one, end in zip(columns, ends, strict=True)]
        lines.append(f"| `{name}` | {share(data['success'], data['valid'])} | {others} |{''.join(worst)}")
    return "\n".join(lines)


def groups(names: str, values: str = "") -> str:
    """A line for each group of rows: what they have in common, what came of them, and values of those that succeed.

    A value is `NAME`, the worst of it as of `draws`, or `NAME:min`, `:mean`, `:rms` or `:max`.
    """
    rows, columns = [row for name in names.split() for row in read(name)["groups"]], values.split()
    axes = list(rows[0]["at"])
    heads = [*map(axis_words, axes), "succeed", *(in_words(*one.split(":")) for one in columns)]
    lines = (
        [*map(shown, row["at"].values()), came(row), *(valued(row, *one.split(":")) for one in columns)] for row in rows
    )
    return ruled([True] * len(axes) + [False] + [True] * len(columns), heads, *lines)


def grid(name: str, across: str, value: str) -> str:
    """The value of each group as of `groups`, those of one axis beside each other; of what fails why it does."""
    rows = read(name)["groups"]
    beside = next(axis for axis in rows[0]["at"] if axis.endswith(across))
    heads = list(dict.fromkeys(row["at"][beside] for row in rows))
    others = [axis for axis in rows[0]["at"] if axis != beside]
    table: dict[tuple[Any, ...], dict[Any, str]] = {}
    for row in rows:
        cell = valued(row, *value.split(":"))
        table.setdefault(tuple(row["at"][axis] for axis in others), {})[row["at"][beside]] = cell or came(row)
    first, *rest = map(shown, heads)
    lines = ([*map(shown, at), *(line.get(head, "") for head in heads)] for at, line in table.items())
    columns = [*map(axis_words, others), f"{axis_words(beside)} {first}", *rest]
    return ruled([True] * len(columns), columns, *lines)


def came(row: dict[str, Any]) -> str:
    """What came of a group: `yes` or why not of one rollout, of several how many succeed, and of the others."""
    others = ", ".join(f"{number:,} `{cause}`" for cause, number in row["causes"].items())
    if row["success"] + sum(row["causes"].values()) == 1:
        return others.partition(" ")[2] or "yes"
    return f"{share(row['success'], row['valid'])}{others and f'; {others}'}"


def valued(row: dict[str, Any], name: str, how: str = "") -> str:
    """A value of a group; empty where none succeeds."""
    ends = row["values"].get(name)
    return (told(name, ends[how], ends[how]) if how else told(name, ends["min"], ends["max"])) if ends else ""


def nominal(name: str, runs: str, figures: str) -> str:
    """A line for each of some nominal rollouts, `SCENARIO` or `SCENARIO:ENGINE`: whether it succeeds, and figures."""
    columns, found = figures.split(), read(name)["runs"]
    lines = [f"| | succeeds |{''.join(f' {in_words(one)} |' for one in columns)}", "|:--|:--|" + "--:|" * len(columns)]
    for run in runs.split():
        row = found[run]
        ended = "yes" if row["outcome"] == "success" else f"`{row['cause']}`"
        values = "".join(f" {told(one, row[one], row[one])} |" if one in row else " |" for one in columns)
        lines.append(f"| {', '.join(f'`{word}`' for word in run.split(':'))} | {ended} |{values}")
    return "\n".join(lines)


def in_words(figure: str, how: str = "") -> str:
    """`slip_max_m` -> `slip max (mm)`."""
    words, unit = split_metric_column(figure)
    words = f"{words}, {how}" if how else words
    return f"{words} ({'mm' if unit == 'm' else unit})" if unit else words


def told(figure: str, least: float, greatest: float) -> str:
    """The worse end of a figure, lengths in mm."""
    worse = least if "min" in figure.split("_") else greatest
    shown = 1000 * worse if split_metric_column(figure)[1] == "m" else worse
    return f"{shown:.3g}" if abs(shown) < 1000 else f"{shown:.0f}"


def cells(name: str) -> str:
    """Successes in every cell over two axes, the first across; of valid rollouts where these are not equally many."""
    grid = read(name)["map"]
    (x, across), (y, up) = grid["values"].items()
    most = max(max(line) for line in grid["valid"])
    heads, lines = [f"{axis_words(y)} by {axis_words(x)}, of {most}", *map(shown, across)], []
    for value, success, valid in zip(up, grid["success"], grid["valid"], strict=True):
        counts = (f"{a}" if b == most else f"{a} of {b}" for a, b in zip(success, valid, strict=True))
        lines.append([shown(value), *counts])
    return ruled([True] * len(heads), heads, *lines)


def each(name: str) -> str:
    """Successes along each axis for itself, a line each."""
    lines = []
    for axis, table in read(name)["along"].items():
        counts = ", ".join(f"{success} of {valid}" for _, success, valid, _ in table)
        lines.append([axis_words(axis), ", ".join(shown(value) for value, *_ in table), counts])
    return ruled([False] * 3, ["error", "values", "succeed"], *lines)


def shown(value: float | str) -> str:
    """A value of an axis, which may be a name."""
    return value if isinstance(value, str) else f"{value:g}"


def share(success: int, valid: int) -> str:
    """`3 of 4 (30 to 95 %)`, with the 95 % Wilson interval."""
    found = interval(success, valid)
    return f"{success:,} of {valid:,} ({100 * found['low']:.0f} to {100 * found['high']:.0f} %)"


def interval(success: int, valid: int) -> dict[str, float]:
    """Share of successes with its 95 % Wilson interval."""
    low, high = wilson(success, valid)
    return {"share": success / valid if valid else float("nan"), "low": float(low), "high": float(high)}


def compared(_: str) -> str:
    """The sources' figures beside ours."""
    return headlines.table(share, read)


def bounds(_: str) -> str:
    """How large an error each manoeuvre bears."""
    return next(bounds_of(rates(DATA)))


def seen(_: str) -> str:
    """How large an error of rates, and of what is seen of free bodies, each manoeuvre bears."""
    return [*bounds_of(rates(DATA))][1]


def borne(_: str, scenario: str, robot: str, axis: str, value: str) -> str:
    """`19 of 128`: successes with one error."""
    table = rates(DATA)
    here = (table["scenario"] == scenario) & (table["robot"] == robot) & (table["axis"] == axis)
    (found,) = table[here & (table["value"] == float(value))].to_dict("records")
    return f"{found['success']} of {found['valid']}"


def table(name: str, which: str) -> str:
    """A table as it was measured; columns of numbers end at the right."""
    columns, *rows = read(name)["tables"][which]
    numbers = (all(NUMBER.match(cell.lstrip("-")) for cell in column if cell) for column in zip(*rows, strict=True))
    return ruled(numbers, columns, *rows)


def ruled(right: Iterable[bool], *lines: Sequence[str]) -> str:
    """A table, its heads first, and whether each of its columns ends at the right."""
    head, *body = (f"| {' | '.join(line)} |" for line in lines)
    return "\n".join([head, f"|{'|'.join('--:' if one else ':--' for one in right)}|", *body])


def halved(name: str, scenarios: str) -> str:
    """Of scenarios: draws that succeed at each step, and of pairs at a step and half of it how many end otherwise."""
    counts = read(name)["counts"]
    lines = ["| | `mjx`, 2, 1, 0.5 ms | `native`, 1, 0.5 ms | end otherwise at half the step |", "|:--|:--|:--|:--|"]
    for scenario in scenarios.split():
        both = [counts[f"{engine}-{scenario}"] for engine in ("mjx", "native")]
        succeed = (", ".join(map(str, one["success"])) for one in both)
        otherwise, pairs = (sum(one[key] for one in both) for key in ("otherwise", "pairs"))
        lines.append(f"| `{scenario}` | {' | '.join(succeed)} | {otherwise} of {pairs} |")
    return "\n".join(lines)


def sources(names: list[str]) -> str:
    """What made the data of a page: command, engine, code, machine, a line each."""
    lines = []
    for name in names:
        data = read(name)
        where = f"{data['engine']}, {'; '.join(data['devices'])}"
        lines.append([name, f"`{data['command']}`", where, data["commit"], str(data["seconds"])])
    return ruled([False] * 4 + [True], ["data", "made by", "engine, machine", "code", "s"], *lines)


def origin(names: list[str]) -> str:
    """Return the words of a page of the guide that say at which commits its data were measured."""
    return f"Measured at commits {codes(names)}."


def age(names: list[str]) -> str:
    """Return the sentence at the top of a page of evidence that says how old its data are."""
    if not names:
        return (
            "This page has no stored data: its numbers were noted when they were measured, with the code that it names."
        )
    number = f"The {len(names)} data sets of this page were" if len(names) > 1 else f"The data set `{names[0]}` was"
    older = "`python research/cited.py --age` lists data that are older than the current code"
    return f"{number} measured with code {codes(names)}. {older}."


def codes(names: list[str]) -> str:
    """Return the commits with which some data were measured."""
    found = {commit for name in names for commit in COMMIT.findall(read(name)["commit"])}
    return ", ".join(f"`{commit}`" for commit in sorted(found)) or "that their tables name"


def changes(_: str) -> str:
    """What is beyond its interval since the data before those that are there, a line for each count."""
    lines = []
    for path in sorted(DATA.glob("*.json")):
        data = read(path.stem)
        changed = data.get("changed") or {"before": "", "counts": []}
        lines += [[path.stem, data["commit"], changed["before"], one] for one in changed["counts"]]
    heads = ["data", "code", "before", "beyond its interval"]
    return ruled([False] * 4, heads, *lines) if lines else "Nothing is beyond its interval."


def outdated(text: str) -> str:
    """A sentence about data of a page that are of other code than this, for the site; empty where there are none."""
    data = {name: read(name) for name in sorted(targets(text))}
    older = [name for name, one in data.items() if not is_current_code(one["code"], one.get("versions", {}))]
    which = f"all {len(older)} sets of data" if len(older) == len(data) > 3 else ", ".join(older)
    return f"Measured before the code of this site: {which}." if older else ""


def metrics(_: str) -> str:
    """Every figure of a rollout and what it means, as the code has them."""
    lines = ["| figure | meaning |", "|---|---|"]
    return "\n".join([*lines, *(f"| `{name}` | {meaning} |" for name, meaning in COLUMN_MEANINGS.items())])


def learned(_: str) -> str:
    """Successes of robots that are told wrong sizes, and of the same that learn, from their rates."""
    columns = [(axis, error, robot) for axis, error in (ROBOT, GROUND) for robot in ("believes", "learns")]
    lines = ["| manoeuvre | robot: believes | learns | ground: believes | learns |", "|:--|--:|--:|--:|--:|"]
    for scenario, of_one in _learning().groupby("scenario"):
        found = {(one["axis"], one["value"], one["robot"]): one for one in of_one.to_dict("records")}
        cells = [share(one["success"], one["valid"]) if (one := found.get(key)) else "" for key in columns]
        lines.append(f"| `{scenario}` | {' | '.join(cells)} |")
    return "\n".join(lines)


def gained(_: str, of: str) -> str:
    """Successes of all who learn with wrong sizes of the `robot` or the `ground`, and of the same that believe.

    Of the robot's sizes only those count that it can learn: it calibrates itself, or drives by what it has seen.
    """
    axis, error = {"robot": ROBOT, "ground": GROUND}[of]
    kept = _learning()
    kept = kept[(kept["axis"] == axis) & (kept["value"] == error)]
    both = kept.pivot_table(index="scenario", columns="robot", values=["success", "valid"]).dropna()
    if of == "robot":
        both = both.drop(index=list(TOUCH_ALONE))
    (believe, learn), (_, of_all) = (both[count].to_numpy(int).sum(axis=0) for count in ("success", "valid"))
    return f"{learn:,} of {of_all:,} rollouts of {len(both)} manoeuvres succeed, without it {believe:,}"


def _learning() -> pd.DataFrame:
    """All rates, with no difference between who calibrates only and who learns all there is."""
    kept = rates(DATA)
    return kept.assign(robot=kept["robot"].replace("calibrates", "learns"))


def by_hand(text: str) -> list[str]:
    """Heads of tables with numbers that no block makes; what a command prints in a tutorial is none."""
    plain = FENCE.sub("", BLOCK.sub("", text))
    return [found.partition("\n")[0] for found in TABLE.findall(plain) if NUMBER.search(found)]


def pages() -> Iterator[Path]:
    """All pages that are written by hand."""
    for folder in (DOCS, RESEARCH):
        yield from (page for page in sorted(folder.rglob("*.md")) if page.parent != DOCS / "reference")


FORMS = {
    "rate": rate, "rollouts": rollouts, "causes": causes, "errors": errors, "along": along, "draws": draws,
    "groups": groups, "grid": grid, "cells": cells, "each": each, "bounds": bounds, "seen": seen, "borne": borne,
    "compared": compared, "table": table,
    "halved": halved, "nominal": nominal, "learned": learned, "gained": gained, "metrics": metrics,
    "way_points": hexagon_figures.way_points, "changes": changes,
    **{name: partial(lambda table, of, *words: table(*map(read, of.split()), *words), table)
       for name, table in validity_figures.TABLES.items()},
}  # fmt: skip
OF_PAGE = {"age": age, "sources": sources, "origin": origin}  # forms of all data that a page cites

if __name__ == "__main__":
    for page in pages():
        text = page.read_text(encoding="utf-8")
        if "--age" in sys.argv:
            print(f"{page.relative_to(RESEARCH.parent)}: {outdated(text) or 'nothing is older than the code'}")
        elif (new := filled(text)) != text:
            page.write_text(new, encoding="utf-8")
            print(page)

"""`sweep formula`: evaluate the closed-form formulas from the shell: one value, a table or a plot."""

import argparse
import json
import re
from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from sweep.cli.command import Command, Section
from sweep.cli.exits import DONE
from sweep.core import terminal
from sweep.core.arguments import Arguments
from sweep.core.errors import InputError
from sweep.core.files import write_atomically

if TYPE_CHECKING:
    from sweep.formulas import Formula, Input

COMMAND = Command(Section.LOOK_UP, "evaluate a closed-form formula from the literature")
PICTURE_SUFFIXES = (".pdf", ".png", ".svg")


def add_arguments(parser: Arguments) -> None:
    """Add the arguments of `sweep formula`: name of the formula, values of its inputs, and form of the output."""
    parser.formatter_class = argparse.HelpFormatter  # wraps the epilog
    parser.description = "Evaluate a closed-form formula from the literature. Without a name, list all formulas."
    parser.epilog = "Elements of a vector are set together (r_s=0.1,0,0.05) or one by one (r_s.0=0.1)."
    parser.add_argument("name", nargs="?", help="name of a formula, or an equation number such as 2.1.6 to search for")
    parser.add_argument(
        "values", nargs="*", metavar="key=value", help="values of inputs; other inputs keep their defaults"
    )
    parser.add_argument("--json", action="store_true", help="print JSON")
    parser.add_argument("--sweep", metavar="key=lo:hi:n", help="print a table over n values of one input")
    parser.add_argument("--plot", metavar="FILE", type=Path, help="plot the table of --sweep")


def run(args: argparse.Namespace) -> int:
    """Print a formula's values, a table or all formulas. Raises `InputError`."""
    lines = _evaluate_command(args)
    if args.json or args.sweep:  # data for another program, whose lines must stay whole
        print(*lines, sep="\n")
    else:
        terminal.print_markdown("\n".join(lines) + "\n", is_paged=args.name is None)
    return DONE


def _evaluate_command(args: argparse.Namespace) -> Iterator[str]:
    from sweep.formulas import FORMULAS, find_by_equation, find_formula

    if args.plot and not args.sweep:
        raise InputError("--plot needs --sweep key=lo:hi:n, whose table it plots")
    if args.name is None:
        return _format_listing(FORMULAS.values(), args.json)
    if re.fullmatch(r"\d+(\.\d+)*", args.name):
        found = find_by_equation(args.name)
        if not found:
            raise InputError(f"equation {args.name} is unknown (`sweep formula` lists all equations)")
        return _format_listing(found, args.json)
    formula = find_formula(args.name)
    values = _parse_inputs(formula, args.values)
    if args.sweep:
        key, points = _parse_range(formula, args.sweep)
        rows = _evaluate_over(formula, values, key, points)
        if args.plot:
            _plot(formula, rows, key, args.plot)
        return iter([json.dumps(rows)]) if args.json else _table_lines(rows)
    report = _report(formula, values)
    return iter([json.dumps(report, indent=2, ensure_ascii=False)]) if args.json else _report_lines(formula, report)


def _format_listing(formulas: Any, as_json: bool) -> Iterator[str]:
    if as_json:
        yield json.dumps({formula.name: {"what": formula.summary, "source": formula.reference} for formula in formulas})
        return
    for formula in formulas:
        units = ", ".join(f"{name} {unit}".rstrip() for name, unit in formula.outputs.items())
        yield f"{formula.name:22} {formula.summary}: {units}. {formula.reference}"


def _parse_inputs(formula: "Formula", assignments: Sequence[str]) -> dict[str, Any]:
    """Parse `key=value` assignments to checked inputs by flat name, with defaults for the others."""
    values = formula.complete_inputs({})
    for assignment in assignments:
        key, equals, text = assignment.partition("=")
        if not equals:
            raise InputError(f"{assignment} is not allowed: give inputs as key=value")
        values = _assign(formula, values, key, _parse_value(text))
    return values


def _assign(formula: "Formula", values: Mapping[str, Any], key: str, value: Any) -> dict[str, Any]:
    """Set input `key`, or element name.index of a vector, to a checked value."""
    name, _, index = key.rpartition(".")
    vector = values.get(name)
    if isinstance(vector, list) and index.isdigit() and int(index) < len(vector):
        key, value = name, [*vector[: int(index)], value, *vector[int(index) + 1 :]]
    return formula.complete_inputs({**values, key: value})


def _parse_value(text: str) -> Any:
    """Parse numbers as int or float, a comma-separated list as such, and keep other text."""
    if "," in text:
        return [_parse_value(part) for part in text.split(",")]
    for kind in (int, float):
        try:
            return kind(text)
        except ValueError:
            continue
    return text


def _parse_range(formula: "Formula", text: str) -> tuple[str, list[float]]:
    """Parse `key=lo:hi:n` to an input and its values."""
    import numpy as np

    match, key = re.fullmatch(r"[^=]+=([^:]+):([^:]+):(\d+)", text), text.partition("=")[0]
    try:
        low, high, count = match.groups()  # pyright: ignore[reportOptionalMemberAccess]
        points = np.linspace(float(low), float(high), int(count)).tolist() if len(count) < 7 else []
    except (AttributeError, ValueError):
        points = []
    if len(points) < 2:
        raise InputError(f"--sweep {text} is not allowed: key=lo:hi:n with two numbers and n from 2 to 999999")
    return key, points


def _evaluate_over(
    formula: "Formula", values: Mapping[str, Any], key: str, points: Sequence[float]
) -> list[dict[str, Any]]:
    """Evaluate a formula over values of one input: a row each, None where there is no solution."""
    from sweep.formulas import NoSolution

    rows: list[dict[str, Any]] = []
    for point in points:
        inputs = _assign(formula, values, key, point)
        try:
            outputs = dict(_elements(formula.evaluate(inputs)))
        except NoSolution:
            outputs = {}
        rows.append({key: point, **outputs})
    columns = max(rows, key=len)
    if len(columns) == 1:
        formula.evaluate(_assign(formula, values, key, points[0]))  # raises, and says why
    return [{column: row.get(column) for column in columns} for row in rows]


def _elements(outputs: Mapping[str, Any]) -> Iterator[tuple[str, Any]]:
    for name, value in outputs.items():
        if isinstance(value, list):
            yield from _elements({f"{name}.{i}": element for i, element in enumerate(value)})
        else:
            yield name, value


def _table_lines(rows: Sequence[Mapping[str, Any]]) -> Iterator[str]:
    width = max(12, *(len(name) for name in rows[0]))
    yield "  ".join(f"{name:>{width}}" for name in rows[0])
    for row in rows:
        yield "  ".join(f"{'-' if value is None else _text(value):>{width}}" for value in row.values())


def _report(formula: "Formula", values: Mapping[str, Any]) -> dict[str, Any]:
    outputs = formula.evaluate(values)
    return {
        "formula": formula.name,
        "what": formula.summary,
        "source": formula.reference,
        "corrected": formula.is_corrected,
        "correction": formula.correction,
        "inputs": {
            entry.name: {"value": values[entry.name], "unit": entry.unit, "allowed": entry.domain()}
            for entry in formula.inputs
        },
        "outputs": {name: {"value": outputs[name], "unit": unit} for name, unit in formula.outputs.items()},
    }


def _report_lines(formula: "Formula", report: Mapping[str, Any]) -> Iterator[str]:
    yield f"{formula.name}: {formula.summary}"
    yield f"source: {formula.reference}"
    yield f"corrected: {formula.correction or 'no, as printed'}"
    yield "inputs"
    for name, entry in report["inputs"].items():
        yield f"  {name} = {_quantity(entry)}  ({entry['allowed']})"
    if formula.condition:
        yield f"  together: {formula.condition}"
    yield "outputs"
    for name, entry in report["outputs"].items():
        yield f"  {name} = {_quantity(entry)}"


def _quantity(entry: Mapping[str, Any]) -> str:
    return f"{_text(entry['value'])} {entry['unit']}".rstrip()


def _text(value: Any) -> str:
    if isinstance(value, list):
        return f"[{', '.join(map(_text, value))}]"
    if isinstance(value, bool):
        return "yes" if value else "no"
    return f"{value:.6g}" if isinstance(value, float) else str(value)


def _plot(formula: "Formula", rows: Sequence[Mapping[str, Any]], key: str, file: Path) -> None:
    """Plot every output against `key`, one panel for each unit."""
    if file.suffix not in PICTURE_SUFFIXES or not file.parent.is_dir():
        raise InputError(f"--plot {file} is not allowed: a {', '.join(PICTURE_SUFFIXES)} file in a folder that exists")
    import numpy as np
    from matplotlib.figure import Figure

    names = [name for name in rows[0] if name != key]
    units = dict.fromkeys(formula.outputs[name.partition(".")[0]] for name in names)
    figure = Figure(figsize=(6.4, 2.4 + 1.8 * len(units)), layout="constrained")
    panels = figure.subplots(len(units), sharex=True, squeeze=False)[:, 0]
    for panel, unit in zip(panels, units, strict=True):
        for name in names:
            if formula.outputs[name.partition(".")[0]] == unit:
                column = [np.nan if row[name] is None else row[name] for row in rows]
                panel.plot([row[key] for row in rows], column, label=name)
        panel.set_ylabel(unit or "1")
        panel.legend()
    panels[-1].set_xlabel(f"{key} ({_unit(formula.inputs, key) or '1'})")
    figure.suptitle(f"{formula.summary}\n{formula.reference}", fontsize="medium")
    write_atomically(file, partial(figure.savefig, dpi=120))


def _unit(inputs: "Sequence[Input]", key: str) -> str:
    """Unit of input `key`, or of the vector to which it belongs."""
    units = {entry.name: entry.unit for entry in inputs}
    return units[key] if key in units else units[key.rpartition(".")[0]]

"""The table of the sources' figures beside ours, of research/headlines.yaml."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import yaml

from sweep.formulas import evaluate

ROWS = Path(__file__).with_suffix(".yaml")
HEAD = "| what | source | the source's | ours | of | by |\n|:--|:--|:--|:--|:--|:--|"

ERROR = 0.0025  # of all sizes and masses, that the robot is not told


def rows() -> list[dict[str, Any]]:
    """What is compared."""
    return yaml.safe_load(ROWS.read_text(encoding="utf-8"))


def table(share: Callable[[int, int], str], read: Callable[[str], dict[str, Any]]) -> str:
    """All rows in Markdown; `share` tells successes of valid rollouts, `read` gives the data of a target."""
    lines = [HEAD]
    for row in rows():
        if "formula" in row:
            found = by_formula(row)
        elif "rates" in row:
            found = by_rollouts(read(f"rates_{row['rates']}_believes"), share)
        else:
            data = read(row["data"])
            found = share(data["success"], data["valid"]), data["commit"], f"`{data['command']}`"
        lines.append(f"| {row['what']} | {row['where']} | {row['theirs']} | {' | '.join(found)} |")
    return "\n".join(lines)


def by_formula(row: dict[str, Any]) -> tuple[str, str, str]:
    """A closed form's value, which every commit has, and its command."""
    name, *given = row["formula"]
    output, _, place = row["output"].partition(".")
    value = evaluate(name, {key: float(text) for key, text in (word.split("=") for word in given)})[output]
    value = value[int(place)] if place else value
    return f"{value:.4g} {row.get('unit', '')}".strip(), "closed form", f"`sweep formula {' '.join(row['formula'])}`"


def by_rollouts(data: dict[str, Any], share: Callable[[int, int], str]) -> tuple[str, str, str]:
    """How many draws succeed of a robot that believes what it is told, code and command."""
    ((success, valid),) = ((a, b) for value, a, b, _ in data["along"]["axis.size_error"] if value == ERROR)
    return share(success, valid), data["commit"], f"`{data['command']} --where 'size_error == {ERROR}'`"

"""The table of the sources' figures beside ours, of docs/headlines.yaml."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pandas as pd
import yaml

from sweep.formulas import evaluate

ROWS = Path(__file__).with_suffix(".yaml")
HEAD = "| what | source | the source's | ours | of | by |\n|:--|:--|:--|:--|:--|:--|"

ERROR = 0.0025  # of all sizes and masses, that the robot is not told


def rows() -> list[dict[str, Any]]:
    """What is compared."""
    return yaml.safe_load(ROWS.read_text(encoding="utf-8"))


def table(rates: pd.DataFrame, share: Callable[[int, int], str]) -> str:
    """All rows in Markdown; `rates` as robustness_rates.csv has them, `share` tells successes of valid rollouts."""
    lines = [HEAD]
    for row in rows():
        found = by_formula(row) if "formula" in row else by_rollouts(row, rates, share)
        lines.append(f"| {row['what']} | {row['where']} | {row['theirs']} | {' | '.join(found)} |")
    return "\n".join(lines)


def by_formula(row: dict[str, Any]) -> tuple[str, str, str]:
    """A closed form's value, which every commit has, and its command."""
    name, *given = row["formula"]
    output, _, place = row["output"].partition(".")
    value = evaluate(name, {key: float(text) for key, text in (word.split("=") for word in given)})[output]
    value = value[int(place)] if place else value
    return f"{value:.4g} {row.get('unit', '')}".strip(), "closed form", f"`sweep formula {' '.join(row['formula'])}`"


def by_rollouts(row: dict[str, Any], rates: pd.DataFrame, share: Callable[[int, int], str]) -> tuple[str, str, str]:
    """How many draws succeed of a robot that believes what it is told, code and command."""
    here = (rates["scenario"] == row["rates"]) & (rates["robot"] == "believes") & (rates["axis"] == "axis.size_error")
    (found,) = rates[here & (rates["value"] == ERROR)].to_dict("records")
    command = f"sweep run study=any_robustness scenario={row['rates']} {row.get('given', '')}".strip()
    return share(found["success"], found["valid"]), found["commit"], f"`{command}`"

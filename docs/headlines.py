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
GIVEN = "sweep run study=any_robustness scenario={} study.seed={}{} --where 'size_error == {}'"
SEED, BEFORE = 41, {"674a363242e2", "9464865514ab", "f66d5e4b940c"}  # of jobs/robustness_all.sh; of these it was 40


def rows() -> list[dict[str, Any]]:
    """What is compared."""
    return yaml.safe_load(ROWS.read_text(encoding="utf-8"))


def table(rates: pd.DataFrame, share: Callable[[int, int], str], read: Callable[[str], dict[str, Any]]) -> str:
    """All rows in Markdown; `rates` as robustness_rates.csv has them, `read` gives the data of a target.

    `share` tells successes of valid rollouts.
    """
    lines = [HEAD]
    for row in rows():
        if "formula" in row:
            found = by_formula(row)
        elif "rates" in row:
            found = by_rollouts(row, rates, share)
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


def by_rollouts(row: dict[str, Any], rates: pd.DataFrame, share: Callable[[int, int], str]) -> tuple[str, str, str]:
    """How many draws succeed of a robot that believes what it is told, code and command."""
    here = (rates["scenario"] == row["rates"]) & (rates["robot"] == "believes") & (rates["axis"] == "axis.size_error")
    (found,) = rates[here & (rates["value"] == ERROR)].to_dict("records")
    seed = SEED - (found["commit"] in BEFORE)
    command = GIVEN.format(row["rates"], seed, f" {row['given']}" if "given" in row else "", ERROR)
    return share(found["success"], found["valid"]), found["commit"], f"`{command}`"

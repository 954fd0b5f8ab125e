"""Whether margins and reserves shrink before anything breaks: lines of errors from nominal to the first failure.

To run: `python bench/margins.py [SCENARIO ...] [--folder FOLDER] [OVERRIDE ...]`, from a checkout. Each line goes from
nominal into a random direction of the normals behind the errors of `study=any_rare`; a second pass goes through the
step in which it fails, and through those in which its margin falls by a cliff's height. The same command goes on where
it was. It adds the scenarios to research/data/margins.json, which research/certainty.md cites; without any
those that are there
are measured again, with the lengths that they had.
"""

import argparse
import sys
import time
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import shared
from scipy.special import ndtr

from sweep.core.provenance import made_with
from sweep.runs import runner, store
from sweep.study.config import Experiment, compose
from sweep.study.sought import Draws
from sweep.study.study import points

ROOT = Path(__file__).parents[1]
FOLDER, DATA = ROOT / "results" / "lines", ROOT / "research" / "data" / "margins.json"
LINES, FAR = 16, 6.0  # standard deviations
COARSE, FINE = 24, 5  # steps of a line; of one of them that is looked at closely
CLIFF = 0.25  # of a margin, in units of its threshold, within a fine step
LEADS = 0.8  # Spearman's coefficient of a column and the way, up to the first failure, of either sign
FEWEST = 5  # steps before a failure by which a column can be said to lead
MOST_CLIFFS = 2  # beyond which it is told what they are of
LENGTHS = ("body_length", "body_width", "thigh", "shin")
SPREAD = 0.02  # of them, where nothing else is told: their standard deviation, a share
COLUMNS = {"margin": "`margin`", "friction_reserve_min": "friction", "friction_demand_max": "a foot's friction",
           "torque_reserve_min": "torque", "reach_reserve_min_m": "reach", "edge_reserve_min_m": "edge",
           "landing_reserve_min": "landing", "stability_margin_min_m": "stability"}  # fmt: skip
GROWS = ("friction_demand_max",)  # which goes up where others go down


def simulated(exp: Experiment, folder: Path, u: np.ndarray) -> pd.DataFrame:
    """Rows (n,) of rollouts whose errors have the normals `u` (n, d), kept in `folder`."""
    one_noise = np.zeros(len(u), dtype=int)  # for all, so that lines are smooth
    nothing = {"weight": np.ones(len(u)), "round": np.zeros(len(u))}
    table = points(exp.study, exp.system, exp.settings, round_=Draws(ndtr(u), one_noise, nothing))
    with store.locked(folder):
        runner.mend(exp, folder)
        runner.run(runner.lay_out(exp, folder, table), lambda rows: print(f"  {len(rows)} rollouts", file=sys.stderr))
    return store.read_rows(folder).set_index("point_id").loc[table["point_id"]].reset_index()


def first(rows: pd.DataFrame) -> int:
    """Number of the first that does not succeed, or how many there are."""
    bad = (rows["outcome"] != "success").to_numpy()
    return int(np.argmax(bad)) if bad.any() else len(bad)


def falls(rows: pd.DataFrame, least: float = -1.0) -> np.ndarray:
    """How far the margin falls in each step of a line (n - 1,); what is below `least` is as low as it can be."""
    return -np.diff(rows["margin"].clip(lower=least))


def close(rows: pd.DataFrame) -> list[int]:
    """Numbers of the steps of a line that are looked at closely, up to the one in which it fails."""
    end = first(rows)
    steep = falls(rows)[:end] > CLIFF
    steep[end - 1 : end] = end < len(rows)
    return np.flatnonzero(steep).tolist()


def directions(exp: Experiment) -> np.ndarray:
    """Unit vectors (LINES, d) along which the lines go."""
    towards = np.random.default_rng(0).standard_normal((LINES, len(exp.study.axes)))
    return towards / np.linalg.norm(towards, axis=1, keepdims=True)


def lines(exp: Experiment, folder: Path) -> list[pd.DataFrame]:
    """Rows of each line up to its first failure, by `way` (standard deviations from nominal)."""
    towards = directions(exp)
    d = towards.shape[1]
    way = np.linspace(0, FAR, COARSE + 1)
    along = (way[None, 1:, None] * towards[:, None]).reshape(-1, d)
    coarse = simulated(exp, folder, np.concatenate([np.zeros((1, d)), along]))
    every = [coarse.iloc[[0, *range(1 + k * COARSE, 1 + (k + 1) * COARSE)]].assign(way=way) for k in range(LINES)]
    shares = np.linspace(0, 1, FINE + 1)[1:-1]
    inner = [(way[close(rows), None] + way[1] * shares).ravel() for rows in every]
    u = [away * direction for steps, direction in zip(inner, towards, strict=True) for away in steps]
    if not u:
        return every
    fine = simulated(exp, folder, np.array(u)).assign(way=np.concatenate(inner))
    found, at = [], 0
    for rows, steps in zip(every, inner, strict=True):
        part = pd.concat([rows, fine[at : at + len(steps)]]).sort_values("way", ignore_index=True)
        found.append(part[: first(part) + 1])
        at += len(steps)
    return found


def told(rows: pd.DataFrame, columns: list[str]) -> dict[str, Any]:
    """What a line that fails shows: where and by what, how far its margin falls at once, and what goes with the way."""
    last, before = rows.iloc[-1], rows.iloc[:-1]
    leads = {}
    if len(before) >= FEWEST:
        moving = [c for c in columns if before[c].nunique() > 1]
        leads = {c: round(before["way"].corr(before[c], method="spearman"), 3) for c in moving}
    return {
        "way": round(float(last["way"]), 3),
        "cause": str(last["cause"]),
        "limit": str(last["limit"]),
        "fall": round(float(falls(rows).max()), 3),
        "fall_to_nought": round(float(falls(rows, least=0.0).max()), 3),
        "margin_of": str(last["margin_of"]),
        "before_of": str(before["margin_of"].iloc[-1]),
        "steps": len(before),
        "leads": {c: value for c, value in leads.items() if abs(value) >= LEADS},
    }


def tables(scenarios: shared.Scenarios) -> dict[str, list[list[str]]]:
    """In how many lines what leads, and what the cliffs are of where there are more than a few."""
    heads = ["scenario", "lengths off by, %", "fail", "no cliff", "none above nought"]
    leading = [[*heads, *COLUMNS.values(), "any"]]
    falling = [["scenario", "cliffs", "above nought", "cause", "nearest limit before"]]
    for name, one in scenarios.items():
        if one["nominal_outcome"] != "success":  # no line begins
            continue
        failing, steep = one["lines"], [line for line in one["lines"] if line["fall"] > CLIFF]
        high = sum(line["fall_to_nought"] > CLIFF for line in failing)
        counts = [len(failing), len(failing) - len(steep), len(failing) - high]
        cells = [f"`{name}`", f"{100 * one['lengths']:g}", *map(str, counts)]
        goes = {column: [_leads(line, column) for line in failing] for column in COLUMNS}
        cells += [str(sum(lines)) if column in one["nominal"] else "" for column, lines in goes.items()]
        cells.append(str(sum(map(any, zip(*goes.values(), strict=True)))))
        leading.append(cells)
        if len(steep) > MOST_CLIFFS:
            causes = Counter(f"`{line['cause']}`" for line in steep)
            nearest = Counter(f"`{line['before_of']}`" for line in steep)
            words = (", ".join(f"{key} {n}" for key, n in each.most_common()) for each in (causes, nearest))
            falling.append([f"`{name}`", str(len(steep)), str(high), *words])
    return {"leading": leading, "cliffs": falling}


def _leads(line: dict[str, Any], column: str) -> bool:
    return (1 if column in GROWS else -1) * line["leads"].get(column, 0.0) >= LEADS


def main(words: list[str]) -> None:
    """Measure scenarios, or what is missing of them."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("words", nargs="*", metavar="SCENARIO or OVERRIDE")
    parser.add_argument("--lengths", type=float, help="standard deviation of the robot's lengths, a share (0.02)")
    parser.add_argument("--folder", type=Path, default=FOLDER)
    parser.add_argument("--out", type=Path, default=DATA)
    parser.add_argument("--commit", default="", help="where the sources are in no checkout")
    given = parser.parse_args(words)
    before = shared.read(given.out)
    for scenario in [word for word in given.words if "=" not in word] or before:
        known = before.get(scenario, {"lengths": SPREAD})["lengths"]
        measure(scenario, given.lengths or known, [word for word in given.words if "=" in word], given)


def experiment(scenario: str, spread: float, overrides: list[str]) -> Experiment:
    """The errors of `any_rare`, whose robot's lengths have the standard deviation `spread`."""
    lengths = [f"study.axes.{axis}.relative={spread:g}" for axis in LENGTHS]
    return compose([f"scenario={scenario}", "study=any_rare", "study.design.num=1", *lengths, *overrides])


def measure(scenario: str, spread: float, overrides: list[str], given: argparse.Namespace) -> None:
    """Measure a scenario, or what is missing of it, whose robot's lengths have the standard deviation `spread`."""
    start = time.perf_counter()
    exp = experiment(scenario, spread, overrides)
    where = given.folder / scenario
    where.mkdir(parents=True, exist_ok=True)
    every = lines(exp, where)
    columns = [c for c in COLUMNS if c in every[0]]
    failing = [rows for rows in every if rows["outcome"].iloc[-1] != "success" and len(rows) > 1]
    (device,) = store.read_study(where)["devices"][:1]
    found = {
        **made_with(),
        **({"commit": given.commit} if given.commit else {}),
        "device": device,
        "seconds": round(time.perf_counter() - start),
        "lengths": spread,
        "overrides": overrides,
        "nominal": {c: float(every[0][c].iloc[0]) for c in columns},
        "nominal_outcome": str(every[0]["outcome"].iloc[0]),
        "lines": [told(rows, columns) for rows in failing],
    }
    shared.add(given.out, scenario, found, "python bench/margins.py SCENARIO", tables)


if __name__ == "__main__":
    main(sys.argv[1:])

"""Whether margins shrink before a failure: lines of growing errors from nominal to the first failure.

To run: `python bench/margins.py [SCENARIO ...] [--folder FOLDER] [OVERRIDE ...]`, from a checkout. Each line goes from
nominal in a random direction of the normals behind the errors of `study=any_rare`. A second pass refines the step in
which it fails, and steps in which its margin falls by a cliff's height. The same command continues an interrupted one.
It adds the scenarios to research/data/margins.json, which research/certainty.md cites; without arguments, its scenarios
are measured again with the lengths that they had.
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

from sweep.config.experiment import Experiment, compose
from sweep.core.provenance import version_record
from sweep.runs import runner, store
from sweep.study.adaptive_sampling import RoundDraws
from sweep.study.study import make_points

ROOT = Path(__file__).parents[1]
FOLDER, DATA = ROOT / "results" / "lines", ROOT / "research" / "data" / "margins.json"
LINES, FAR = 16, 6.0  # number of lines, and their length in standard deviations
COARSE, FINE = 24, 5  # steps of a line, and of a refined step
CLIFF = 0.25  # fall of a margin within a fine step, in units of its threshold
LEADS = 0.8  # least absolute Spearman correlation of a leading column with the distance, up to the first failure
FEWEST = 5  # least number of steps before a failure for a column to lead
MOST_CLIFFS = 2  # number of cliffs above which their causes are listed
LENGTHS = ("body_length", "body_width", "thigh", "shin")
SPREAD = 0.02  # default standard deviation of the lengths, a share
COLUMNS = {"margin": "`margin`", "friction_reserve_min": "friction", "friction_demand_max": "a foot's friction",
           "torque_reserve_min": "torque", "reach_reserve_min_m": "reach", "edge_reserve_min_m": "edge",
           "landing_reserve_min": "landing", "stability_margin_min_m": "stability"}  # fmt: skip
GROWS = ("friction_demand_max",)  # columns that grow towards a failure


def simulate_errors(exp: Experiment, folder: Path, u: np.ndarray) -> pd.DataFrame:
    """Return the rows (n,) of rollouts whose errors have the normals `u` (n, d), stored in `folder`."""
    one_noise = np.zeros(len(u), dtype=int)  # for all, so that lines are smooth
    nothing = {"weight": np.ones(len(u)), "round": np.zeros(len(u))}
    table = make_points(exp.study, exp.system, exp.settings, round_=RoundDraws(ndtr(u), one_noise, nothing))
    with store.lock_folder(folder):
        runner.repair_folder(exp, folder)
        runner.run_job(
            runner.prepare_job(exp, folder, table), lambda rows: print(f"  {len(rows)} rollouts", file=sys.stderr)
        )
    return store.read_rows(folder).set_index("point_id").loc[table["point_id"]].reset_index()


def first_failure(rows: pd.DataFrame) -> int:
    """Return the number of the first row that does not succeed, or the number of rows."""
    bad = (rows["outcome"] != "success").to_numpy()
    return int(np.argmax(bad)) if bad.any() else len(bad)


def margin_falls(rows: pd.DataFrame, least: float = -1.0) -> np.ndarray:
    """Return how far the margin falls in each step of a line (n - 1,); values below `least` count as `least`."""
    return -np.diff(rows["margin"].clip(lower=least))


def steps_to_refine(rows: pd.DataFrame) -> list[int]:
    """Return the numbers of the steps to refine, up to the one in which the line fails."""
    end = first_failure(rows)
    steep = margin_falls(rows)[:end] > CLIFF
    steep[end - 1 : end] = end < len(rows)
    return np.flatnonzero(steep).tolist()


def directions(exp: Experiment) -> np.ndarray:
    """Return the unit vectors (LINES, d) of the lines."""
    towards = np.random.default_rng(0).standard_normal((LINES, len(exp.study.axes)))
    return towards / np.linalg.norm(towards, axis=1, keepdims=True)


def simulate_lines(exp: Experiment, folder: Path) -> list[pd.DataFrame]:
    """Return the rows of each line up to its first failure, with `way` (standard deviations from nominal)."""
    towards = directions(exp)
    d = towards.shape[1]
    way = np.linspace(0, FAR, COARSE + 1)
    along = (way[None, 1:, None] * towards[:, None]).reshape(-1, d)
    coarse = simulate_errors(exp, folder, np.concatenate([np.zeros((1, d)), along]))
    every = [coarse.iloc[[0, *range(1 + k * COARSE, 1 + (k + 1) * COARSE)]].assign(way=way) for k in range(LINES)]
    shares = np.linspace(0, 1, FINE + 1)[1:-1]
    inner = [(way[steps_to_refine(rows), None] + way[1] * shares).ravel() for rows in every]
    u = [away * direction for steps, direction in zip(inner, towards, strict=True) for away in steps]
    if not u:
        return every
    fine = simulate_errors(exp, folder, np.array(u)).assign(way=np.concatenate(inner))
    found, at = [], 0
    for rows, steps in zip(every, inner, strict=True):
        part = pd.concat([rows, fine[at : at + len(steps)]]).sort_values("way", ignore_index=True)
        found.append(part[: first_failure(part) + 1])
        at += len(steps)
    return found


def summarize_line(rows: pd.DataFrame, columns: list[str]) -> dict[str, Any]:
    """Return cause, largest falls of the margin, and leading columns of a line that fails."""
    last, before = rows.iloc[-1], rows.iloc[:-1]
    leads = {}
    if len(before) >= FEWEST:
        moving = [c for c in columns if before[c].nunique() > 1]
        leads = {c: round(before["way"].corr(before[c], method="spearman"), 3) for c in moving}
    return {
        "way": round(float(last["way"]), 3),
        "cause": str(last["cause"]),
        "limit": str(last["limit"]),
        "fall": round(float(margin_falls(rows).max()), 3),
        "fall_to_nought": round(float(margin_falls(rows, least=0.0).max()), 3),
        "margin_of": str(last["margin_of"]),
        "before_of": str(before["margin_of"].iloc[-1]),
        "steps": len(before),
        "leads": {c: value for c, value in leads.items() if abs(value) >= LEADS},
    }


def tables(scenarios: shared.Scenarios) -> dict[str, shared.Table]:
    """Return the numbers of lines in which each column leads, and the causes of cliffs."""
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
    args = parser.parse_args(words)
    before = shared.read_scenarios(args.out)
    for scenario in [word for word in args.words if "=" not in word] or before:
        known = before.get(scenario, {"lengths": SPREAD})["lengths"]
        measure(scenario, args.lengths or known, [word for word in args.words if "=" in word], args)


def experiment(scenario: str, spread: float, overrides: list[str]) -> Experiment:
    """Return the errors of `any_rare` with `spread` as the standard deviation of the robot's lengths."""
    lengths = [f"study.axes.{axis}.relative={spread:g}" for axis in LENGTHS]
    return compose([f"scenario={scenario}", "study=any_rare", "study.design.num=1", *lengths, *overrides])


def measure(scenario: str, spread: float, overrides: list[str], args: argparse.Namespace) -> None:
    """Measure a scenario, or what is missing of it."""
    start = time.perf_counter()
    exp = experiment(scenario, spread, overrides)
    where = args.folder / scenario
    where.mkdir(parents=True, exist_ok=True)
    every = simulate_lines(exp, where)
    columns = [c for c in COLUMNS if c in every[0]]
    failing = [rows for rows in every if rows["outcome"].iloc[-1] != "success" and len(rows) > 1]
    (device,) = store.read_study(where)["devices"][:1]
    found = {
        **version_record(),
        **({"commit": args.commit} if args.commit else {}),
        "device": device,
        "seconds": round(time.perf_counter() - start),
        "lengths": spread,
        "overrides": overrides,
        "nominal": {c: float(every[0][c].iloc[0]) for c in columns},
        "nominal_outcome": str(every[0]["outcome"].iloc[0]),
        "lines": [summarize_line(rows, columns) for rows in failing],
    }
    shared.add_scenario(args.out, scenario, found, "python bench/margins.py SCENARIO", tables)


if __name__ == "__main__":
    main(sys.argv[1:])

"""Nature of cliffs in margins: rollouts on either side of each, bisected to be close, compared tick by tick.

To run: `python bench/cliffs.py [SCENARIO ...] [--folder FOLDER]`, from a checkout. Lines are those of
`bench/margins.py`, whose folder provides existing rows. The steepest step of each line that falls by a cliff's height
is divided into eighths three times, each time the steepest eighth. For the two resulting rollouts, 1e-4 standard
deviations apart, it reports when their margins part, and how far their motions are apart by then. It adds the scenarios
to research/data/cliffs.json, which research/certainty.md cites; without arguments, all scenarios of
research/data/margins.json are measured.
"""

import argparse
import sys
import time
from collections import Counter
from pathlib import Path
from typing import Any

import margins
import numpy as np
import pandas as pd
import shared

from sweep.config.experiment import Experiment
from sweep.contract.engine import Trace
from sweep.core.constants import FOOT_LOAD_THRESHOLD_N
from sweep.core.provenance import version_record
from sweep.report.replays import resimulate_rows
from sweep.runs import store

DATA = margins.ROOT / "research" / "data" / "cliffs.json"
PARTS, ROUNDS = 8, 3  # eighths of a step, and rounds of division
PARTING_DISTANCE = 1e-3  # m, of feet, base or free bodies, from which on motions have parted
BEFORE = 1.0  # s, before the margins part


def steepest_step(rows: pd.DataFrame) -> int:
    """Return the number of the step of a line in which its margin falls most."""
    return int(np.argmax(margins.margin_falls(rows)))


def refine_cliffs(exp: Experiment, folder: Path, ways: list[pd.DataFrame], towards: np.ndarray) -> list[pd.DataFrame]:
    """Return two neighbouring rows on either side of each line's cliff; `falls` has its height after every round."""
    ends = [rows.iloc[(k := steepest_step(rows)) : k + 2] for rows in ways]
    told = [[float(margins.margin_falls(two)[0])] for two in ends]
    shares = np.linspace(0, 1, PARTS + 1)[1:-1]
    for _ in range(ROUNDS):
        inner = [two["way"].iloc[0] + shares * (two["way"].iloc[1] - two["way"].iloc[0]) for two in ends]
        u = np.concatenate([way[:, None] * to for way, to in zip(inner, towards, strict=True)])
        found = margins.simulate_errors(exp, folder, u).assign(way=np.concatenate(inner))
        for k, two in enumerate(ends):
            part = found[k * (PARTS - 1) : (k + 1) * (PARTS - 1)]
            every = pd.concat([two.iloc[:1], part, two.iloc[1:]], ignore_index=True)
            at = steepest_step(every)
            ends[k] = every.iloc[at : at + 2]
            told[k].append(float(margins.margin_falls(ends[k])[0]))
    return [two.assign(falls=pd.Series([each] * 2, index=two.index)) for two, each in zip(ends, told, strict=True)]


def point_positions(trace: Trace) -> np.ndarray:
    """Return feet, base and free bodies (m) in every tick: (F, 7 + k, 3)."""
    bodies = trace.qpos[:, 25:].reshape(len(trace.time), -1, 7)[..., :3]
    return np.concatenate([trace.foot_position, trace.qpos[:, None, :3], bodies], axis=1)


def compare_sides(rows: pd.DataFrame, high: Trace, low: Trace) -> dict[str, Any]:
    """Return when margins and motions of two rollouts part; `low` is the one with the smaller final margin."""
    n, tick = min(len(high.time), len(low.time)), float(high.time[0])
    off = np.linalg.norm(point_positions(high)[:n] - point_positions(low)[:n], axis=-1)  # (n, points)
    most = off.max(axis=1)
    fall = high.margin[:n].clip(-1) - low.margin[:n].clip(-1)
    during = np.flatnonzero(fall > margins.CLIFF)
    at = int(during[0]) if len(during) else n - 1
    parted = min(first_true(most > PARTING_DISTANCE), n - 1)
    loaded = [np.linalg.norm(t.foot_force[parted], axis=-1) > FOOT_LOAD_THRESHOLD_N for t in (high, low)]
    drop = -np.diff(low.margin[: at + 1].clip(-1)) if at else np.zeros(1)
    one = rows.iloc[int(np.argmin(rows["margin"]))]
    return {
        "cause": str(one["cause"]),
        "limit": str(one["limit"]),
        "falls": [round(f, 3) for f in rows["falls"].iloc[0]],
        "margins": sorted(round(float(m), 3) for m in rows["margin"]),
        "known": "tick" if len(during) else "end",
        "at_s": round(at * tick, 3),
        "end_s": round(n * tick, 3),
        "apart_m": float(f"{most[at]:.3g}"),
        "before_m": float(f"{most[max(0, at - round(BEFORE / tick))]:.3g}"),
        "parted_s": round(parted * tick, 3),
        "feet_loaded": [int(x.sum()) for x in loaded],
        "stage": high.stages[int(high.stage[parted])],
        "of": str(low.margin_of[at]),
        "tick_fall": round(float(drop[-5:].max()), 3),
    }


def first_true(holds: np.ndarray) -> int:
    """Return the index of the first true value, or the length."""
    return int(np.argmax(holds)) if holds.any() else len(holds)


def measure(scenario: str, args: argparse.Namespace, known: dict[str, Any]) -> None:
    """Compare the two sides of all cliffs of a scenario."""
    start = time.perf_counter()
    exp = margins.experiment(scenario, known["lengths"], known["overrides"])
    folder = args.folder / scenario
    folder.mkdir(parents=True, exist_ok=True)
    every, towards = margins.simulate_lines(exp, folder), margins.directions(exp)
    steep = [k for k, rows in enumerate(every) if len(rows) > 1 and margins.margin_falls(rows).max() > margins.CLIFF]
    steep = [k for k in steep if every[k]["outcome"].iloc[-1] != "success"][: args.most]
    if not steep:
        return
    ends = refine_cliffs(exp, folder, [every[k] for k in steep], towards[steep])
    both = pd.concat(ends, ignore_index=True)
    period = exp.settings.control_period
    traces = {
        row["point_id"]: t for row, t, _ in resimulate_rows(exp, both, store.read_points(folder), rate=1 / period)
    }
    told = []
    for two in ends:
        two = two.sort_values("margin", ascending=False)
        high, low = (traces[point] for point in two["point_id"])
        told.append(compare_sides(two, high, low))
    found = {
        **version_record(),
        **({"commit": args.commit} if args.commit else {}),
        "device": store.read_study(folder)["devices"][0],
        "seconds": round(time.perf_counter() - start),
        "cliffs": told,
    }
    shared.add_scenario(args.out, scenario, found, "python bench/cliffs.py SCENARIO", tables)


def classify_cliff(one: dict[str, Any]) -> str:
    """Return the kind of a cliff: `steep` alone, a `figure` that jumps while motions agree, or `motions` that part."""
    if one["falls"][-1] <= margins.CLIFF:
        return "steep"
    alike = one["apart_m"] < (2 * PARTING_DISTANCE if one["tick_fall"] > margins.CLIFF else PARTING_DISTANCE)
    return "figure" if alike else "motions"


def tables(scenarios: shared.Scenarios) -> dict[str, shared.Table]:
    """Return the kinds of cliffs, by cause and by scenario."""
    every = [{**one, "scenario": name} for name, found in scenarios.items() for one in found["cliffs"]]
    judged = ["cliffs", "none at 1e-4", "a figure jumps", "motions part"]
    heads = ["cause", *judged, "apart a second before, mm", "when margins part, mm", "parted before, s"]
    causes = [[*heads, "other feet bear load then"]]
    for cause, _ in Counter(one["cause"] for one in every).most_common():
        some = [one for one in every if one["cause"] == cause]
        parting = [one for one in some if classify_cliff(one) == "motions"]
        bears = sum(one["feet_loaded"][0] != one["feet_loaded"][1] for one in parting)
        typical = (
            *(1e3 * np.array([one[key] for one in parting]) for key in ("before_m", "apart_m")),
            np.array([max(one["at_s"] - one["parted_s"], 0.0) for one in parting]),
        )
        medians = (f"{float(f'{np.median(values):.2g}'):g}" if parting else "" for values in typical)
        causes.append(
            [
                f"`{cause}`" if cause else "none, within successes",
                *_counts(some),
                *medians,
                str(bears) if parting else "",
            ]
        )
    where = [["scenario", *judged, "stages in which they part"]]
    for name in scenarios:
        some = [one for one in every if one["scenario"] == name]
        stages = Counter(f"`{one['stage']}`" for one in some if classify_cliff(one) == "motions").most_common(3)
        where.append([f"`{name}`", *_counts(some), ", ".join(f"{stage} {n}" for stage, n in stages)])
    return {"causes": causes, "where": where}


def _counts(some: list[dict[str, Any]]) -> list[str]:
    kinds = Counter(classify_cliff(one) for one in some)
    return [str(len(some)), *(str(kinds[kind]) for kind in ("steep", "figure", "motions"))]


def main(words: list[str]) -> None:
    """Compare the cliffs of scenarios."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scenarios", nargs="*", metavar="SCENARIO")
    parser.add_argument("--folder", type=Path, default=margins.FOLDER)
    parser.add_argument("--most", type=int, default=margins.LINES, help="cliffs of a scenario (all)")
    parser.add_argument("--out", type=Path, default=DATA)
    parser.add_argument("--commit", default="", help="where the sources are in no checkout")
    args = parser.parse_args(words)
    known = shared.read_scenarios(margins.DATA)
    for scenario in args.scenarios or known:
        measure(scenario, args, known[scenario])


if __name__ == "__main__":
    main(sys.argv[1:])

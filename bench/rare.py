"""Accuracy and cost of rare-failure estimators: `python bench/rare.py SCENARIO [--seconds S] [...] [OVERRIDE ...]`.

All eight errors of `study=any_rare` at once, scaled so that about the `--targets` fail. Plain random draws are the
ground truth for repetitions of importance sampling (each the study of one seed) and of subset simulation. All run side
by side: room of a batch that their rounds leave is filled with plain draws. Scenarios may run in processes of their
own, on one GPU too. Finished cells are kept, those of other code too; plain draws continue, and with `--rows` searches
do; too few of other code start anew. After each batch, everything is written to research/data/rare.json, cited by
research/certainty.md.
"""

import argparse
import itertools
import sys
import time
from collections.abc import Callable, Generator, Iterable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import shared
from scipy.special import ndtri
from scipy.stats import t as student

from sweep.analysis.intervals import CONFIDENCE_LEVEL, clopper_pearson
from sweep.analysis.rare import estimate_failure_probability
from sweep.config.experiment import Experiment, build_experiment, compose_values
from sweep.contract.engine import Engine
from sweep.core.errors import InputError
from sweep.core.expressions import evaluate_expression, find_column
from sweep.core.files import write_atomically
from sweep.core.provenance import version_record
from sweep.runs import runner
from sweep.runs.batches import allocate_delay_buffers, make_engine, make_nominal_batch
from sweep.study.adaptive_sampling import RoundDraws
from sweep.study.design_kinds.base import FailureEstimate
from sweep.study.design_kinds.subset import SubsetEstimate
from sweep.study.study import make_points

DATA = Path(__file__).parents[1] / "research" / "data" / "rare.json"
# less the greater of two linear laws of the sizes, each of a way to fail: mean and half of the difference
_MEAN = (
    "0.398 - (-1.07 * world.robot.body_length + 1.43 * world.robot.body_width"
    " + 2.06 * world.robot.thigh - 0.79 * world.robot.shin)"
)
_HALF = (
    "(-0.63 * world.robot.body_length - 0.22 * world.robot.body_width"
    " - 0.94 * world.robot.thigh + 1.41 * world.robot.shin + 0.788)"
)
LEADS = {
    "walk_tripod": "margin",
    "ball_balance": "stability_margin_min_m",
    "ball_drive": "stability_margin_min_m",
    "ladder_climb": "edge_reserve_min_m",
    "pole_climb": f"{_MEAN} - sqrt({_HALF} * {_HALF})",
}
LEAD = "friction_reserve_min"  # leading column, see bench/margins.py
WAYS = ("plain", "importance", "levels")
LADDER = (0.5 ** np.arange(0, 8, 0.5)).tolist()  # scales to try first; above 1 friction may be negative
KNOWN, MOST = 6, 0.3  # failures from which on, and share up to which, one scale predicts the others
PILOTS, TRUTH = 4, 200  # repetitions that examine the middle scale; failures that plain draws should have
RAREST = 1e-5  # smallest target with plain draws
SETS = 5  # default number of subset simulations of a study
VARIATION = 0.1  # coefficient of variation for which costs are given
TERMS = 3  # terms of the law that extrapolates probabilities to other scales
PLAIN = 1_000_000  # seed of plain draws, which no repetition has

# a generator of rounds that receives their rows and returns all of them
Ask = Generator[RoundDraws, pd.DataFrame, pd.DataFrame]
Cell = dict[str, Any]
Search = tuple[str, str, int]  # target, estimator and number of the repetition
SEARCH = ["target", "way", "repetition"]
ROW = ["replicate", "outcome", "lead"]
BY = (*shared.BY, "lead")  # versions that each cell was made with


class Robots:
    """Rollouts of a scenario on one engine."""

    def __init__(self, scenario: str, width: int, overrides: list[str]):
        """Compile and run one batch, so that later ones are timed without compilation."""
        self.values = compose_values([f"scenario={scenario}", "study=any_rare", f"engine.width={width}", *overrides])
        self.lead = LEADS.get(scenario, LEAD)
        exp = self.scaled_study(1.0)
        first = self.points(exp, plain_draws(exp, 1, 0))
        self.exp = allocate_delay_buffers(exp, first)
        start = make_nominal_batch(self.exp, first.assign(width=width), width)
        self.width, self.engine = width, make_engine(self.exp, start)
        self.device = self.exp.system.device(start.settings)
        self.run([first])

    def scaled_study(self, scale: float, **design: Any) -> Experiment:
        """Return the study with all errors scaled, and another design."""
        study = self.values["study"]
        axes = {name: {**axis, "relative": scale * axis["relative"]} for name, axis in study["axes"].items()}
        asked = {**study, "axes": axes, "design": {**study["design"], "lead": ROW[-1], **design}}
        return build_experiment({**self.values, "study": asked})

    @staticmethod
    def points(exp: Experiment, draws: RoundDraws) -> pd.DataFrame:
        """Return the points of a round."""
        return make_points(exp.study, exp.system, exp.settings, round_=draws)

    def run(self, tables: list[pd.DataFrame]) -> list[pd.DataFrame]:
        """Return the rows of each table, simulated in full batches except the last."""
        return simulate_tables(self.exp, self.engine, self.width, tables, self.select_columns)

    def select_columns(self, rows: pd.DataFrame) -> pd.DataFrame:
        """Return the columns that searches need, with the leading margin."""
        lead = evaluate_expression(self.lead, lambda name: rows[find_column(rows, name)].to_numpy())
        return rows.assign(lead=lead)[[*(c for c in map(str, rows) if c.startswith("axis.")), *ROW]]


def simulate_tables(
    exp: Experiment,
    engine: Engine,
    width: int,
    tables: list[pd.DataFrame],
    select_columns: Callable[[pd.DataFrame], pd.DataFrame] = lambda rows: rows,
) -> list[pd.DataFrame]:
    """Return the rows of each table of points, simulated side by side in batches that are full except the last.

    Args:
        exp: Experiment of the points.
        engine: Its engine.
        width: Rollouts of a batch.
        tables: Points.
        select_columns: Selects the columns of rows to keep.
    """
    every = pd.concat(tables, ignore_index=True).assign(width=width)
    parts = [every[k : k + width] for k in range(0, len(every), width)]
    rows = pd.concat([select_columns(runner.simulate_batch(exp, engine, part)[0]) for part in parts])
    ends = np.cumsum([0, *map(len, tables)])
    return [rows[a:b].reset_index(drop=True) for a, b in itertools.pairwise(ends)]


def plain_draws(exp: Experiment, num: int, before: int) -> RoundDraws:
    """Return `num` plain draws that differ from the `before` ones."""
    shares = np.random.default_rng([PLAIN, before]).random((num, len(exp.study.axes)))
    return RoundDraws(shares, before + np.arange(num), {})


def adaptive_rounds(exp: Experiment) -> Ask:
    """Generate all rounds of an adaptive study."""
    design = exp.study.adaptive_design
    search = design.start_search(exp.study.draw_context)
    draws, every = next(search), []
    while True:
        every.append((yield draws))
        try:
            draws = search.send(design.summarize_finished_round(every[-1], draws))
        except StopIteration:
            return pd.concat(every, ignore_index=True)


def importance(robots: Robots, scale: float, num: int, seeds: Iterable[int]) -> list[Experiment]:
    """Return repetitions of one study, one for each seed."""
    exp = robots.scaled_study(scale, kind="importance", num=num)
    return [replace(exp, study=replace(exp.study, seed=seed)) for seed in seeds]


def find_scales(robots: Robots, targets: list[float], num: int) -> dict[str, float]:
    """Those at which about each target fails, by target.

    Reliability, the quantile of what does not fail, is taken to be linear in 1 / scale: through a look at plain draws
    of many scales and one at the middle target by importance sampling. Raises `InputError` where no scale has a failure
    now and then.
    """
    exps = [robots.scaled_study(scale) for scale in LADDER]
    tables = [robots.points(exp, plain_draws(exp, num, 0)) for exp in exps]
    shares, failures = zip(*((bad.mean(), bad.sum()) for bad in map(is_failure, robots.run(tables))), strict=True)
    told = [k for k in range(len(LADDER)) if failures[k] >= KNOWN and shares[k] <= MOST]
    print(
        "  " + ", ".join(f"{scale:.3g}: {share:.3g}" for scale, share in zip(LADDER, shares, strict=True)), flush=True
    )
    if not told:
        raise InputError(
            f"none of the scales {LADDER[0]:g} to {LADDER[-1]:.2g} has between {KNOWN} and {MOST:.0%} fail"
        )
    known = [(1 / LADDER[told[-1]], -ndtri(shares[told[-1]]))]
    aims = -ndtri(np.array(targets))
    middle = min(LADDER[told[-1]] * known[0][1] / aims[len(aims) // 2], LADDER[0])
    pilots = finish_studies(robots, importance(robots, middle, num, range(1, PILOTS + 1)))
    p = float(np.mean([one.probability for one in pilots]))
    if 0 < p < shares[told[-1]]:
        known.append((1 / middle, -ndtri(p)))
    (x, y), (x_, y_) = known[0], known[-1] if len(known) > 1 else (0.0, 0.0)
    slope = (y - y_) / (x - x_)
    found = 1 / (x + (aims - y) / slope)
    return {f"{p:g}": min(float(f"{scale:.3g}"), LADDER[0]) for p, scale in zip(targets, found, strict=True)}


def finish_studies(robots: Robots, exps: list[Experiment]) -> list[FailureEstimate]:
    """Return the estimates of studies that are continued side by side."""
    asks = [adaptive_rounds(exp) for exp in exps]
    draws, rows = [next(ask) for ask in asks], []
    while len(rows) < len(asks):
        found = robots.run([robots.points(exp, one) for exp, one in zip(exps, draws, strict=True)])
        draws, rows = [], []
        for ask, one in zip(asks, found, strict=True):
            try:
                draws.append(ask.send(one))
            except StopIteration as end:
                rows.append(end.value)
    return [estimate_failure_probability(one, exp) for one, exp in zip(rows, exps, strict=True)]


def is_failure(rows: pd.DataFrame) -> np.ndarray:
    """Return which rows failed, invalid ones included."""
    return (rows["outcome"] != "success").to_numpy()


def measure_cells(robots: Robots, kept: "Cells", given: argparse.Namespace, deadline: float) -> None:
    """Fill missing cells until the deadline."""
    exps: dict[tuple[str, str], list[Experiment]] = {}
    for target, num in given.level.items():  # levels first, whose rounds are many
        exps[target, "levels"] = [
            robots.scaled_study(kept.scales[target], kind="subset", num=num, runs=given.repetitions)
        ]
    for target, num in given.num.items():
        exps[target, "importance"] = importance(robots, kept.scales[target], num, range(1, given.repetitions + 1))
    exps = {key: some for key, some in exps.items() if key[1] in given.ways and "P" not in kept.cell(*key)}
    asks = {(*key, k): adaptive_rounds(exp) for key, some in exps.items() for k, exp in enumerate(some)}
    asked: dict[Search, RoundDraws] = {key: next(ask) for key, ask in asks.items()}
    ended: dict[Search, pd.DataFrame] = {}

    def table(key: Search) -> pd.DataFrame:
        return robots.points(exps[key[:2]][key[2]], asked[key])

    def advance(key: Search, rows: pd.DataFrame) -> None:
        try:
            asked[key] = asks[key].send(rows)
        except StopIteration as end:
            ended[key] = end.value
            del asked[key]
            target, way, _ = key
            every = {(target, way, k): exp for k, exp in enumerate(exps[target, way])}
            if every.keys() <= ended.keys():
                kept.add_estimates(
                    target, way, [estimate_failure_probability(ended[one], exp) for one, exp in every.items()]
                )

    past = SearchLog(given.rows)
    for key in list(asked):
        while key in asked and (rows := past.round_rows(key, table(key))) is not None:
            advance(key, rows)
    kept.write()
    lasts = 0.0  # a batch
    while (start := time.perf_counter()) + lasts < deadline and (asked or kept.next_short_target()):
        ends = np.cumsum([len(draws.numbers) for draws in asked.values()])
        fitting = list(asked)[: max(1, int(np.sum(ends <= robots.width)))]
        tables: dict[Any, pd.DataFrame] = {key: table(key) for key in fitting}
        room = -sum(map(len, tables.values())) % robots.width or (0 if tables else robots.width)
        if room and (growing := kept.plain_targets()):  # for the truth, of the first cell that lacks some
            exp = robots.scaled_study(kept.scales[target := kept.next_short_target() or growing[-1]])
            tables[target] = robots.points(exp, plain_draws(exp, room, kept.plain()))
        found = dict(zip(tables, robots.run(list(tables.values())), strict=True))
        took = (time.perf_counter() - start) / sum(map(len, tables.values()))
        for key, rows in found.items():
            if isinstance(key, str):
                kept.count_plain_draws(key, is_failure(rows), rows["outcome"].eq("invalid").to_numpy(), took)
                continue
            kept.count_rows(key[0], key[1], rows, took)
            past.add(key, rows)
            advance(key, rows)
        kept.seconds += (lasts := time.perf_counter() - start)
        past.write()
        kept.write()
        print(f"{kept.scenario} {kept.seconds:.0f} s: {len(asked)} searches go on; {kept.format_cells()}", flush=True)


class SearchLog:
    """Rows of searches by round, so that interrupted searches continue; in a file, if there is one."""

    def __init__(self, file: Path | None):
        """Read the file."""
        self.file = file
        there = pd.read_parquet(file) if file and file.exists() else pd.DataFrame(columns=[*SEARCH, *ROW])
        self.parts = [there]
        self.known = {key: rows.set_index(ROW[0])[ROW[1:]] for key, rows in there.groupby(SEARCH)}

    def round_rows(self, key: Search, table: pd.DataFrame) -> pd.DataFrame | None:
        """Return the rows of a round; None if one of them is missing."""
        if key not in self.known or not table["replicate"].isin(self.known[key].index).all():
            return None
        return table.join(self.known[key], on="replicate")

    def add(self, key: Search, rows: pd.DataFrame) -> None:
        """Add the rows of a round."""
        self.parts.append(rows[ROW].assign(**dict(zip(SEARCH, key, strict=True))))

    def write(self) -> None:
        """Write all rounds to the file."""
        if self.file:
            rows = pd.concat(self.parts[not len(self.parts[0]) :])
            write_atomically(self.file, rows.to_parquet(compression="zstd"))


class Cells:
    """The cells of a scenario's tables, and their file."""

    def __init__(self, file: Path, scenario: str, about: Mapping[str, Any], goes_on: bool):
        """Read the file. Interrupted searches continue or restart; those of other code always restart."""
        self.file, self.scenario = file, scenario
        there = shared.read_scenarios(file).get(scenario, {})
        self.content = {**about, "seconds": 0.0, "scales": {}, "cells": {}, **there}
        self.about = {key: about[key] for key in BY}
        self.truths: list[str] = []  # targets that have plain draws, or are to have them
        for ways in self.content["cells"].values():
            for way, cell in list(ways.items()):
                ways[way] = cell = {**{key: there[key] for key in BY}, **cell}
                if "P" not in cell and (cell["code"] != about["code"] or not goes_on):  # a search begins anew
                    del ways[way]
        self.content |= {key: shared.join_values([there, about], key) for key in self.about}

    @property
    def scales(self) -> dict[str, float]:
        """Scales by target."""
        return self.content["scales"]

    @property
    def seconds(self) -> float:
        """Seconds spent on cells."""
        return self.content["seconds"]

    @seconds.setter
    def seconds(self, value: float) -> None:
        self.content["seconds"] = round(value, 1)

    def cell(self, target: str, way: str) -> Cell:
        """Return a cell, empty at first."""
        cells = self.content["cells"].setdefault(target, {})
        return cells.setdefault(way, {**self.about, "rollouts": 0, "invalid": 0, "seconds": 0.0})

    def count_rows(self, target: str, way: str, rows: pd.DataFrame, took: float) -> None:
        """Count rows of a cell, each of which took so many seconds."""
        cell = self.cell(target, way)
        cell["rollouts"] += len(rows)
        cell["invalid"] += int(rows["outcome"].eq("invalid").sum())
        cell["seconds"] = round(cell["seconds"] + took * len(rows), 2)

    def count_plain_draws(self, target: str, bad: np.ndarray, invalid: np.ndarray, took: float) -> None:
        """Count plain draws."""
        cell = self.cell(target, "plain")
        n, k = cell["rollouts"] + len(bad), cell.get("failed", 0) + int(bad.sum())
        low, high = clopper_pearson(k, n)
        cell |= {"P": k / n, "low": float(low), "high": float(high), "failed": k, "rollouts": n,
                 "invalid": cell["invalid"] + int(invalid.sum()),
                 "seconds": round(cell["seconds"] + took * len(bad), 2)}  # fmt: skip

    def request_plain_draws(self, targets: list[str]) -> None:
        """Request plain draws for targets; report where too few of other code start anew."""
        self.truths = [p for p in targets if float(p) >= RAREST]
        while (target := self.next_short_target(own=False)) is not None:
            cell = self.content["cells"][target].pop("plain")
            others = f"its {cell['rollouts']} rollouts are of code {cell['code']}"
            print(f"{self.file}: {self.scenario} {target} plain begins anew, {others}", flush=True)

    def plain_targets(self, own: bool = True) -> list[str]:
        """Return targets with plain draws of this code, or of other code."""
        return [p for p in self.truths if (self.cell(p, "plain")["code"] == self.about["code"]) == own]

    def next_short_target(self, own: bool = True) -> str | None:
        """Return the first of them with too few plain draws."""
        return next((p for p in self.plain_targets(own) if self.cell(p, "plain")["rollouts"] * float(p) < TRUTH), None)

    def plain(self) -> int:
        """Number of plain draws."""
        return sum(self.cell(p, "plain")["rollouts"] for p in self.scales)

    def add_estimates(self, target: str, way: str, found: list[Any]) -> None:
        """Add the estimates of repetitions."""
        cell = self.cell(target, way)
        if isinstance(found[0], SubsetEstimate):
            (one,) = found
            taken = [share for run in one.runs for share in run.acceptance_rates]
            sets = [
                SubsetEstimate(one.target, one.runs[k : k + SETS]) for k in range(0, len(one.runs) - SETS + 1, SETS)
            ]
            told = [some.interval for some in sets if some.run_probabilities.any()]
            cell |= {"each": one.run_probabilities.tolist(), "intervals": told,
                     "early": len(one.stuck_runs), "why": one.stuck_runs[0].end_reason if one.stuck_runs else "",
                     "accepted": [min(taken), max(taken)] if taken else []}  # fmt: skip
        else:
            cell |= {"each": [one.probability for one in found], "intervals": [(one.low, one.high) for one in found],
                     "largest": [one.largest_weight_share for one in found],
                     "untrusted": sum(not one.is_reliable for one in found)}  # fmt: skip
        each = np.array(cell["each"])
        half = student.ppf(0.5 + CONFIDENCE_LEVEL / 2, len(each) - 1) * each.std(ddof=1) / np.sqrt(len(each))
        cell |= {"P": each.mean(), "low": max(each.mean() - half, 0.0), "high": each.mean() + half}

    def format_cells(self) -> str:
        """Format the cells in short."""
        cells = self.content["cells"]
        return ", ".join(
            f"{p} {way} {cell['P']:.3g}" for p, ways in cells.items() for way, cell in ways.items() if "P" in cell
        )

    def write(self) -> None:
        """Write this scenario to the file, which other processes write theirs to."""
        shared.add_scenario(self.file, self.scenario, self.content, "python bench/rare.py SCENARIO", tables)


def tables(scenarios: shared.Scenarios) -> dict[str, shared.Table]:
    """Return the tables that research/certainty.md cites."""
    return {"truth": truth_table(scenarios), "cost": cost_table(scenarios), "beyond": extrapolation_table(scenarios)}


def cells_by_line(scenarios: shared.Scenarios, known: bool = True) -> Iterable[tuple[list[str], dict[str, Cell]]]:
    """Cells by way, with the words that a line begins with, of every scale whose truth is known to have failures.

    Or of those of which there is no truth.
    """
    for name, one in scenarios.items():
        for target, ways in sorted(one["cells"].items(), key=lambda cells: -float(cells[0])):
            if bool(ways.get("plain", {}).get("failed")) == known:
                yield [f"`{name}`", f"{one['scales'][target]:g}"], {w: c for w, c in ways.items() if "P" in c}


def truth_table(scenarios: shared.Scenarios) -> shared.Table:
    """Return both estimators beside plain draws; cells are blank where one did not finish.

    The interval of a ratio includes both errors. Intervals of single studies hold if they contain the mean of all.
    """
    table = [["scenario", "errors times", "P(failure), plain draws", "of",
              "importance: mean / truth", "variation", "hold", "not trusted",
              "levels: mean / truth", "variation of a run", "hold", "early"]]  # fmt: skip
    for line, ways in cells_by_line(scenarios):
        plain, cells = ways["plain"], []
        for way, bad in (("importance", "untrusted"), ("levels", "early")):
            if way not in ways:
                cells += [""] * 4
                continue
            cell, mean = ways[way], ways[way]["P"]
            off = np.sqrt(variation(cell) ** 2 / len(cell["each"]) + (1 - plain["P"]) / plain["failed"])
            ratio, wide = (
                mean / plain["P"],
                np.exp(student.ppf(0.5 + CONFIDENCE_LEVEL / 2, len(cell["each"]) - 1) * off),
            )
            holds = sum(low <= mean <= high for low, high in cell["intervals"])
            cells += [f"{ratio:.2f} ({ratio / wide:.2f} to {ratio * wide:.2f})", f"{variation(cell):.2f}",
                      f"{holds} of {len(cell['intervals'])}", f"{cell[bad]} of {len(cell['each'])}"]  # fmt: skip
        ends = f"{plain['P']:.3g} ({plain['low']:.2g} to {plain['high']:.2g})"
        table.append([*line, ends, f"{plain['rollouts']:,}", *cells])
    return table


def cost_table(scenarios: shared.Scenarios) -> shared.Table:
    """Return the rollouts, and machine seconds, for a relative standard error of a tenth."""
    table = [["scenario", "P(failure)", "plain draws", "s", "importance", "s", "levels", "s"]]
    for (name, _), ways in cells_by_line(scenarios):
        cells = []
        for way in WAYS:
            if way not in ways:
                cells += ["", ""]
                continue
            needed = rollouts(cell := ways[way])
            cells += [f"{needed:,.0f}", f"{needed * cell['seconds'] / cell['rollouts']:.2g}"]
        table.append([name, f"{ways['plain']['P']:.2g}", *cells])
    return table


def extrapolation_table(scenarios: shared.Scenarios) -> shared.Table:
    """Return both estimators where there is no ground truth: mean of all repetitions, and rollouts needed.

    Plain draws of larger errors are extrapolated beside them, where there are some at three scales.
    """
    titles = ["variation", "early or not trusted", "rollouts for a tenth"]
    table = [["scenario", "errors times", "plain draws of larger errors: P(failure)",
              "importance: P(failure)", *titles, "levels: P(failure)", *titles]]  # fmt: skip
    plain: dict[str, list[tuple[float, int, int]]] = {}
    for (name, scale), ways in cells_by_line(scenarios):
        plain.setdefault(name, []).append((float(scale), ways["plain"]["failed"], ways["plain"]["rollouts"]))
    for line, ways in cells_by_line(scenarios, known=False):
        cells = [""]
        if len(larger := plain.get(line[0], [])) >= TERMS:
            larger_scales, failures, of = np.array(larger).T
            told = extrapolate(larger_scales, failures, of, float(line[1]))
            cells = ["{:.2g} ({:.2g} to {:.2g})".format(*told)]
        for way, bad in (("importance", "untrusted"), ("levels", "early")):
            if way not in ways:
                cells += [""] * 4
                continue
            cell = ways[way]
            ends = f"{cell['P']:.3g} ({cell['low']:.3g} to {cell['high']:.3g})"
            poor = f"{cell[bad]} of {len(cell['each'])}"
            cells += [ends, f"{variation(cell):.2f}", poor, f"{rollouts(cell):,.0f}"]
        if ways:
            table.append([*line, *cells])
    return table


def extrapolate(scales: np.ndarray, failed: np.ndarray, counts: np.ndarray, scale: float) -> tuple[float, float, float]:
    """A probability at a scale of errors, and its interval, from how many of plain draws failed at larger scales.

    log P = a + b log s - c / s², fitted with each share's error (scaled-sigma sampling: Sun et al. 2015).
    """
    s, share = scales / scale, failed / counts
    terms = np.stack([np.ones_like(s), np.log(s), 1 - s**-2], axis=1)  # times log P there, b, and c / at²
    certain = failed / (1 - share)  # 1 / variance of log P
    covariance = np.linalg.inv(terms.T @ (certain[:, None] * terms))
    log_p = (covariance @ terms.T @ (certain * np.log(share)))[0]
    half = ndtri(0.5 + CONFIDENCE_LEVEL / 2) * np.sqrt(covariance[0, 0])
    return float(np.exp(log_p)), float(np.exp(log_p - half)), float(np.exp(log_p + half))


def rollouts(cell: Cell) -> float:
    """Return the rollouts for a relative standard error of a tenth."""
    one = cell["rollouts"] / len(cell["each"]) if "each" in cell else 1
    spread = variation(cell) if "each" in cell else np.sqrt((1 - cell["P"]) / cell["P"])
    return one * (spread / VARIATION) ** 2


def variation(cell: Cell) -> float:
    """Return the coefficient of variation of one repetition; infinite if none found a failure."""
    each = np.array(cell["each"])
    return float(each.std(ddof=1) / each.mean()) if each.any() else np.inf


def numbers_by_target(targets: list[str], words: str) -> dict[str, int]:
    """Parse one number for all targets or one for each; 0 means none."""
    numbers = [int(word) for word in words.split(",")]
    numbers *= len(targets) if len(numbers) == 1 else 1
    return {target: number for target, number in zip(targets, numbers, strict=True) if number}


def main(words: list[str]) -> None:
    """Measure a scenario, or what is missing of it."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scenario")
    parser.add_argument("--seconds", type=float, default=np.inf, help="after which nothing is to go on")
    parser.add_argument("--targets", default="1e-2,1e-3,1e-4")
    parser.add_argument("--scales", help="at which these fail, if known: one for each target")
    parser.add_argument("--ways", default=",".join(WAYS))
    parser.add_argument("--repetitions", type=int, default=30)
    parser.add_argument("--num", default="1024", help="draws of a round of importance sampling, of all targets or each")
    parser.add_argument("--level", default="500", help="draws of a level of subset simulation, likewise; 0 is none")
    parser.add_argument("--width", type=int, default=32768, help="rollouts of a batch")
    parser.add_argument("--out", type=Path, default=DATA)
    parser.add_argument("--rows", type=Path, help="where what searches came to is kept, so that they go on")
    parser.add_argument("--commit", default="", help="where the sources are in no checkout")
    given, overrides = parser.parse_known_args(words)
    targets = [float(p) for p in given.targets.split(",")]
    given.targets = [f"{p:g}" for p in targets]
    start = time.perf_counter()
    robots = Robots(given.scenario, given.width, overrides)
    about = {**version_record(), "device": robots.device, "lead": robots.lead, "overrides": overrides}
    about |= {"num": given.num, "level": given.level, "repetitions": given.repetitions, "width": given.width}
    about |= {"commit": given.commit} if given.commit else {}
    kept = Cells(given.out, given.scenario, about, bool(given.rows and given.rows.exists()))
    given.num, given.level = (numbers_by_target(given.targets, told) for told in (given.num, given.level))
    if given.scales:
        known = [float(scale) for scale in given.scales.split(",")]
        kept.content["scales"] = {f"{p:g}": scale for p, scale in zip(targets, known, strict=True)} | kept.scales
    elif not kept.scales:
        kept.content["scales"] = find_scales(robots, targets, max(given.num.values()))
        kept.content["start_s"] = round(time.perf_counter() - start, 1)
    kept.write()
    kept.request_plain_draws(given.targets if "plain" in given.ways else [])
    print(f"{given.scenario}: {kept.scales}, {time.perf_counter() - start:.0f} s", flush=True)
    measure_cells(robots, kept, given, start + given.seconds)


if __name__ == "__main__":
    main(sys.argv[1:])

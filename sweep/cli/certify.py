"""`sweep certify`: the largest region of a study's parameters in which failures are promised to be rare."""

import argparse
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from sweep.analysis import certify, sensitivity
from sweep.analysis.intervals import clopper_pearson
from sweep.analysis.stats import percent
from sweep.cli.run import reporting
from sweep.core.errors import InputError
from sweep.core.files import path_in
from sweep.report.tables import page_table
from sweep.runs import extend, results, runner, store
from sweep.study.config import Experiment, experiment

MOST_PARAMETERS = 8
FRESH, AGAIN = "certify/fresh", "certify/again"  # studies of their own in the folder
CHECKED = 64  # rollouts of either kind that are run as a check of a certified region


def run(given: argparse.Namespace) -> tuple[str, dict[str, Any]]:
    """What is certified, in words and as plain values. Raises `InputError`.

    With `--rollouts` all rows of the folder teach the order of regions, and as many fresh draws test them; without,
    half of the rows does either. Fresh draws are a study of their own, so that the same command goes on.
    """
    check(given)
    folder, rows = given.dir, store.read_rows(given.dir)
    exp = results.load_experiment(folder)
    names = parameters(exp, rows)
    order = np.random.default_rng(0).permutation(len(rows))
    learned = values(rows if given.rollouts else rows.iloc[order[::2]], names)
    if learned[1].all():
        raise InputError("none of the rows to learn from succeeds: there is no region to begin with")
    least = certify.fewest(given.failures, given.confidence) / (given.rollouts or len(rows) // 2)
    with ThreadPoolExecutor() as pool:  # what is learned is learned while fresh draws are simulated
        score = pool.submit(certify.learn, given.shape, *learned, least)
        worst = pool.submit(certify.odds, *learned, convex=False) if given.shape != "score" else score
        new = partial(drawn, exp, path_in(folder, FRESH), exp.study.seed + 1)
        fresh = new(given.rollouts) if given.rollouts else rows.iloc[order[1::2]]
    found = certify.certify(score.result(), learned, values(fresh, names), given.failures, given.confidence)
    lines = [told(found, given.shape, names)]
    if not learned[1].any():
        lines.append("none of the rows to learn from failed, so that regions are in no order: wider draws tell more")
    again = checked(exp, folder, found, names, worst.result()) if found.found and given.rollouts else []
    if again:
        lines += ["", page_table(pd.DataFrame([{**one, "95 %": interval(one)} for one in again]))]
    return "\n".join(lines), as_data(found, given, names) | {"checked": again}


def check(given: argparse.Namespace) -> None:
    """Raise `InputError` where a number of the command line means nothing."""
    for name in ("failures", "confidence"):
        if not 0 < getattr(given, name) < 1:
            raise InputError(f"--{name} = {getattr(given, name):g} is not allowed: between 0 and 1")
    if given.rollouts is not None and given.rollouts < (need := certify.fewest(given.failures, given.confidence)):
        takes = f"{given.failures:g} at {as_given(given.confidence)} takes at least {need}, if none of them fails"
        raise InputError(f"--rollouts = {given.rollouts} is not allowed: {takes}")


def parameters(exp: Experiment, rows: pd.DataFrame) -> list[str]:
    """The columns of the drawn axes. Raises `InputError` where rows are no independent draws of a few numbers."""
    own = exp.study
    if own.points or own.is_refined or not own.design.num or own.design.kind != "monte_carlo" or own.replicates > 1:
        raise InputError(f"{own.name} has no independent draws: it takes a study of design monte_carlo, one replicate")
    if listed := sensitivity.listed(rows, exp):
        raise InputError(f"axis {listed[0].name} is listed: a region is promised for draws, so give it a distribution")
    names = [a.column for a in own.axes if a.distribution]
    if words := [name for name in names if rows[name].dtype.kind not in "fi"]:
        raise InputError(f"{words[0]} is a name: regions are of numbers")
    if len(names) > MOST_PARAMETERS:
        raise InputError(f"{len(names)} parameters are drawn: regions are of at most {MOST_PARAMETERS}")
    return names


def values(rows: pd.DataFrame, names: list[str]) -> tuple[np.ndarray, np.ndarray]:
    """Parameters (n, d), and which rows failed; one that is invalid counts as a failure."""
    return rows[names].to_numpy(dtype=float), (rows["outcome"] != "success").to_numpy()


def drawn(exp: Experiment, folder: Path, seed: int, number: int) -> pd.DataFrame:
    """So many rows of the study with another seed, in a `folder` of its own."""
    fresh = seeded(exp, folder, seed, number)
    with reporting("fresh draws", number, f"{exp.scenario} for fresh draws") as report:
        extend.grow(fresh, folder, number, report)
    rows = store.read_rows(folder)
    return rows[rows["replicate"] < number]


def seeded(exp: Experiment, folder: Path, seed: int, number: int) -> Experiment:
    """The study with another seed and number of draws."""
    own = exp.values["study"]
    study = {**own, "seed": seed, "design": {**own["design"], "num": number}, "keep": [], "expect": []}
    return experiment({**exp.values, "study": study, "out": str(folder)})


def checked(
    exp: Experiment, folder: Path, found: certify.Certificate, names: list[str], worst: certify.Outside
) -> list[dict[str, Any]]:
    """How many draws fail where the region looks worst, and outside it: they play no part in the promise.

    It looks worst where `worst`, a law of failing that was learned, is largest. They run in batches as wide as the
    fresh draws', for which an engine is there.
    """
    number, width = CHECKED * certify.STEPS, int(store.read_points(path_in(folder, FRESH))["width"].iloc[0])
    place = path_in(folder, AGAIN)
    again = seeded(exp, place, exp.study.seed + 2, number)
    again = replace(again, settings=replace(again.settings, width=width))
    table = runner.wanted_points(again)
    x = table[names].to_numpy(dtype=float)
    inside, order = found.inside(x), np.argsort(-worst(x))
    kinds = {
        "where the region looks worst": order[inside[order]][:CHECKED],
        "outside": np.flatnonzero(~inside)[:CHECKED],
    }
    chosen = np.unique(np.concatenate(list(kinds.values())))
    with store.lock_folder(place), reporting("checks", len(chosen), f"{exp.scenario} for checks") as report:
        runner.repair_folder(again, place)
        runner.run(runner.lay_out(again, place, table.iloc[chosen].reset_index(drop=True)), report)
    rows = store.read_rows(place).set_index("point_id")
    lines = []
    for kind, places in kinds.items():
        failed = rows.loc[table["point_id"].iloc[places], "outcome"] != "success"
        lines.append({"draws": kind, "rollouts": len(failed), "fail": int(failed.sum())})
    return lines


def interval(one: dict[str, Any]) -> str:
    """Of the rate of checks that failed."""
    low, high = (percent(float(v)) for v in clopper_pearson(one["fail"], one["rollouts"]))
    return f"{low} to {high}"


def told(found: certify.Certificate, shape: str, names: list[str]) -> str:
    """What is promised, for what, and under which assumptions."""
    where = f"{found.next_failed} of {found.next_rows} fresh rows fail in the next larger one"
    if not found.found:
        return f"no {shape} is certified at {found.failures:g}: {where}. More rows, or a larger probability, may do"
    promise = (
        f"with a confidence of {as_given(found.confidence)} at most {as_given(found.failures)} of the study's draws "
        f"that fall into this {shape} fail: {percent(found.share)} of all draws, {found.failed} of {found.rows} fresh "
        "rows failed there"
    )
    why = f"; {where}" if found.next_rows else "; it is the largest there is"
    assumed = (
        "promised for draws from the study's distributions, not for every point; invalid rollouts count as failures"
    )
    return f"{promise}{why}.\n{assumed}\nthe region, for --where:\n  {found.score.condition(names, found.threshold)}"


def as_given(share: float) -> str:
    """`1e-5` -> `0.001 %`: what is promised loses no digit."""
    return f"{100 * share:g} %"


def as_data(found: certify.Certificate, given: argparse.Namespace, names: list[str]) -> dict[str, Any]:
    """The certificate as plain values."""
    return {
        "study": str(given.dir),
        "shape": given.shape,
        "failures_at_most": found.failures,
        "confidence": found.confidence,
        "certified": found.found,
        "where": found.score.condition(names, found.threshold) if found.found else None,
        "rows": found.rows,
        "failed": found.failed,
        "fresh_rows": found.drawn,
        "next_rows": found.next_rows,
        "next_failed": found.next_failed,
        "share_of_draws": found.share,
        "bound_of_its_rows": found.at_most if found.found else None,
    }

"""`sweep compare A B --anytime`: a comparison that may be looked at after every pair, and stops by itself."""

import argparse

import pandas as pd

from sweep.analysis import compare, sequential
from sweep.analysis.intervals import CONFIDENCE
from sweep.cli.run import reporting
from sweep.core.errors import InputError
from sweep.core.expressions import mask
from sweep.runs import extend, results, store
from sweep.study.config import Experiment
from sweep.study.study import name_axes


def run(given: argparse.Namespace, by: list[str] | None) -> sequential.Verdict:
    """Compare what is there; with `--most`, simulate more draws in both folders until it is decided.

    Both grow by a batch of A at a time, or a quarter of what is there, to at most `--most` draws. Raises `InputError`.
    """
    level = CONFIDENCE if given.level is None else given.level
    if not 0.5 <= level < 1:
        raise InputError(f"--level = {level:g} is not allowed: at least 0.5 and below 1")
    if given.most is not None and given.most < 1:
        raise InputError(f"--most = {given.most} is not allowed: at least 1")
    others = {
        "regions": given.regions,
        "figures": given.figures,
        "output": given.output,
        "tolerance": given.tolerance or None,
    }
    if asked := [flag for flag, value in others.items() if value is not None]:
        raise InputError(f"--{asked[0]} is not for --anytime, which only says which is better")
    if len(given.b) > 1:
        raise InputError("--anytime compares two folders: give A and one B")
    folders, conditions = (given.a, given.b[0]), (given.where_a, given.where_b)
    rows = [store.read_rows(folder) for folder in folders]
    exps = [results.load_experiment(folder) for folder in folders]
    while True:
        a, b = (named_rows(*one) for one in zip(rows, exps, conditions, strict=True))
        found = sequential.verdict(compare.pair(a, b, by), level)
        now = max(map(extend.draws, exps))
        if found.decided or given.most is None or now >= given.most:
            return found
        for exp, folder in zip(exps, folders, strict=True):
            extend.check(exp, folder)
        a_draw = max(len(rows[0]) // extend.draws(exps[0]), 1)  # rollouts
        number = min(now + max(int(rows[0]["width"].iloc[-1]) // a_draw, now // 4, 1), given.most)
        for k, folder in enumerate(folders):
            asked = len(rows[k]) * number // extend.draws(exps[k]) - len(rows[k])
            with reporting(folder.name, asked, f"{exps[k].scenario} for {folder.name}") as report:
                exps[k] = extend.grow(exps[k], folder, number, report)
            rows[k] = store.read_rows(folder)


def named_rows(rows: pd.DataFrame, exp: Experiment, condition: str | None) -> pd.DataFrame:
    """The rows of a study that meet a condition, which may name its axes."""
    rows = name_axes(rows, exp.study.axes)
    return rows[mask(rows, condition)]

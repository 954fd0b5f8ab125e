"""`sweep compare A B --anytime`: a sequential comparison that stays valid however often it is evaluated."""

import argparse

import pandas as pd

from sweep.analysis import compare, sequential
from sweep.analysis.intervals import CONFIDENCE_LEVEL
from sweep.cli.run_progress import report_progress
from sweep.config.experiment import Experiment
from sweep.core.errors import InputError
from sweep.core.expressions import condition_mask
from sweep.runs import extend, results, store
from sweep.study.study import name_axes


def compare_anytime(args: argparse.Namespace, by: list[str] | None) -> sequential.SequentialResult:
    """Compare stored rows; with `--most`, simulate more draws in both folders until the comparison is decided.

    Both folders grow by a batch of A at a time, or a quarter of their draws, to at most `--most` draws. Raises
    `InputError`.
    """
    level = CONFIDENCE_LEVEL if args.level is None else args.level
    if not 0.5 <= level < 1:
        raise InputError(f"--level = {level:g} is not allowed: at least 0.5 and below 1")
    if args.most is not None and args.most < 1:
        raise InputError(f"--most = {args.most} is not allowed: at least 1")
    others = {
        "regions": args.regions,
        "figures": args.figures,
        "output": args.output,
        "tolerance": args.tolerance or None,
    }
    if asked := [flag for flag, value in others.items() if value is not None]:
        raise InputError(
            f"--{asked[0]} is not allowed with --anytime, which only decides which folder succeeds more often"
        )
    if len(args.b) > 1:
        raise InputError("--anytime compares exactly two folders: A and one B")
    folders, conditions = (args.a, args.b[0]), (args.where_a, args.where_b)
    rows = [store.read_rows(folder) for folder in folders]
    exps = [results.load_experiment(folder) for folder in folders]
    while True:
        a, b = (named_rows(*one) for one in zip(rows, exps, conditions, strict=True))
        pairs = compare.pair_rows(a, b, by)
        if (unit := compare.unit_numbers_of_pairs(pairs, exps[0])) is None:
            what = "were not drawn at random: they form a grid, or a search placed them"
            raise InputError(
                f"--anytime needs random draws, or noisy replicates of one point: the points of {args.a} {what}"
            )
        found = sequential.sequential_test(pairs, level, unit)
        now = max(map(extend.count_draws, exps))
        if found.is_decided or args.most is None or now >= args.most:
            return found
        for exp, folder in zip(exps, folders, strict=True):
            extend.check_extendable(exp, folder)
        a_draw = max(len(rows[0]) // extend.count_draws(exps[0]), 1)  # rollouts
        number = min(now + max(int(rows[0]["width"].iloc[-1]) // a_draw, now // 4, 1), args.most)
        for k, folder in enumerate(folders):
            asked = len(rows[k]) * number // extend.count_draws(exps[k]) - len(rows[k])
            with report_progress(folder.name, asked, f"{exps[k].scenario} for {folder.name}") as report:
                exps[k] = extend.extend_study(exps[k], folder, number, report)
            rows[k] = store.read_rows(folder)


def named_rows(rows: pd.DataFrame, exp: Experiment, condition: str | None) -> pd.DataFrame:
    """Select the rows of a study that meet a condition; the condition may use the study's names of axes as well as
    columns."""
    rows = name_axes(rows, exp.study.axes)
    return rows[condition_mask(rows, condition)]

"""`sweep compare A B --anytime`: a sequential comparison that stays valid however often it is evaluated."""

import argparse
from pathlib import Path

import pandas as pd

from sweep.analysis import compare, sequential
from sweep.analysis.intervals import CONFIDENCE_LEVEL
from sweep.cli.run_progress import report_progress
from sweep.config.experiment import Experiment
from sweep.core.errors import InputError
from sweep.core.expressions import condition_mask
from sweep.runs import extend, results, store
from sweep.study.study import attach_axis_names


def compare_folders_sequentially(args: argparse.Namespace, by: list[str] | None) -> sequential.SequentialResult:
    """Compare the success rates of two folders sequentially; with `--most`, simulate more draws until it is decided.

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
        a, b = (select_matching_rows(*one) for one in zip(rows, exps, conditions, strict=True))
        pairs = compare.pair_rows(a, b, by)
        if (unit := compare.pair_sampling_unit_ids(pairs, exps[0])) is None:
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
        number = min(next_draw_count(exps[0], folders[0], now), args.most)
        for k, folder in enumerate(folders):
            exps[k] = simulate_more_draws(exps[k], folder, number)
            rows[k] = store.read_rows(folder)


def next_draw_count(exp: Experiment, folder: Path, draws: int | None = None) -> int:
    """Return the next, larger number of draws of a study: one batch or a quarter of its draws more.

    Args:
        exp: Experiment of the study.
        folder: Its folder.
        draws: Number of draws that it counts from; None for its own.
    """
    now = extend.count_draws(exp) if draws is None else draws
    widths = store.read_rows(folder, ["width"])["width"]
    rollouts = max(len(widths) // extend.count_draws(exp), 1)  # of a draw
    return now + max(int(widths.iloc[-1]) // rollouts, now // 4, 1)


def simulate_more_draws(exp: Experiment, folder: Path, draws: int) -> Experiment:
    """Simulate more draws of a study in its folder, with a progress line; return the larger experiment.

    Args:
        exp: Experiment of the study.
        folder: Its folder.
        draws: New number of draws.

    Returns:
        The experiment of the larger study.
    """
    done = store.count_rollouts(folder)[1]
    asked = done * draws // extend.count_draws(exp) - done
    with report_progress(folder.name, asked, f"{exp.scenario} for {folder.name}") as report:
        return extend.extend_study(exp, folder, draws, report)


def select_matching_rows(rows: pd.DataFrame, exp: Experiment, condition: str | None) -> pd.DataFrame:
    """Select the rows of a study that meet a condition; the condition may use the study's names of axes as well as
    columns."""
    rows = attach_axis_names(rows, exp.study.axes)
    return rows[condition_mask(rows, condition)]

"""`sweep relabel`: apply other thresholds to stored rollouts."""

import argparse

from sweep.cli.arguments import add_folder
from sweep.cli.command import Command, Section
from sweep.cli.exits import DONE
from sweep.core.arguments import Arguments
from sweep.core.errors import InputError

COMMAND = Command(
    Section.READ,
    "apply other thresholds to stored rollouts without simulating",
    "sweep relabel results/walk_map 'slip_max_m<0.02' 'tilt_max_deg<15'",
)


def add_arguments(parser: Arguments) -> None:
    """Add the arguments of `sweep relabel`: folder, and new thresholds of success."""
    add_folder(parser)
    wanted = "such as 'slip_max_m<0.02'; for a MuJoCo model, a condition such as 'goal=travelled_m >= 1'"
    parser.add_argument("thresholds", nargs="+", metavar="'KEY<VALUE'", help=wanted)


def run(args: argparse.Namespace) -> int:
    """Judge the stored rollouts of a folder again by new thresholds of success, without simulating."""
    from sweep.report.headline import study_headline
    from sweep.runs import results, runner, store

    exp = results.load_experiment(args.dir)
    changes = dict(map(exp.system.parse_threshold, args.thresholds))
    if len(changes) < len(args.thresholds):
        raise InputError(f"a threshold is given twice: {' '.join(args.thresholds)}")
    with store.lock_folder(args.dir):
        runner.relabel_folder(args.dir, {**exp.values["outcome"], **changes})
    print(study_headline(store.read_rows(args.dir), exp))
    return DONE

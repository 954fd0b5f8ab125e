"""`sweep verify`: check a folder of results for damage."""

import argparse

from sweep.cli.arguments import add_folder
from sweep.cli.command import Command, Section
from sweep.cli.exits import DONE, UNEXPECTED
from sweep.core.arguments import Arguments
from sweep.core.errors import InputError

COMMAND = Command(
    Section.CHECK,
    "check the files and rows of a study for damage",
    "sweep verify results/walk_map --simulate 20",
)


def add_arguments(parser: Arguments) -> None:
    """Add the arguments of `sweep verify`: folder, and how many rows are simulated again."""
    add_folder(parser)
    parser.add_argument(
        "--simulate", type=int, metavar="N", help="simulate N stored rows again; exit code 4 if a metric changed"
    )


def run(args: argparse.Namespace) -> int:
    """Name damaged files in a folder; with `--simulate`, simulate rows again and compare them."""
    if args.simulate is not None and args.simulate < 1:
        raise InputError(f"--simulate = {args.simulate} is not allowed: at least 1")
    from sweep.runs import repair, store

    problems, others, sound = repair.verify_folder(args.dir)
    for line in (*problems, *others):
        print(line)
    remedy = f", {len(problems)} damaged: repeat the same `sweep run` to repair it" if problems else ""
    print(f"{args.dir}: {sound} part{' is' if sound == 1 else 's are'} sound{remedy}")
    if problems:
        return UNEXPECTED
    planned, done = store.count_rollouts(args.dir)
    if done < planned:
        print(f"{args.dir}: {done} of {planned} planned rollouts are there")
    if args.simulate is None:
        return DONE
    from sweep.cli.simulated_again import report_resimulation
    from sweep.runs import results

    return report_resimulation(results.read_results(args.dir), args.simulate)

"""`sweep status`: show progress and outcomes of a study."""

import argparse

from sweep.cli.arguments import add_folder
from sweep.cli.command import Command, Section
from sweep.cli.exits import DONE
from sweep.core import terminal
from sweep.core.arguments import Arguments

COMMAND = Command(Section.READ, "show progress and outcomes of a study")


def add_arguments(parser: Arguments) -> None:
    """Add the argument of `sweep status`: the folder of results."""
    add_folder(parser)


def run(args: argparse.Namespace) -> int:
    """Print how many rollouts are planned and done, and their outcomes."""
    from sweep.analysis.stats import format_cause_counts
    from sweep.report.headline import study_headline
    from sweep.runs import results, store

    stored = store.read_study(args.dir)
    _, done = store.count_rollouts(args.dir)
    exp = results.load_experiment(args.dir) if done else None
    rows = store.read_rows(args.dir, None if exp.study.is_adaptive else ["outcome", "cause"]) if exp else None
    # only now are the rows compared with the plan
    lines = [f"{args.dir}: {done} of {stored['rollouts']} rollouts done, code {stored['commit'] or stored['code']}"]
    if exp is not None and rows is not None:
        meanings = exp.system.cause_meanings(exp.thresholds)
        if exp.study.is_adaptive:
            lines.append(study_headline(rows, exp))
        lines.append(", ".join(f"{number} {outcome}" for outcome, number in rows["outcome"].value_counts().items()))
        lines += [f"  {line}" for line in format_cause_counts(rows["cause"], meanings)]
    terminal.print_markdown("\n".join(lines) + "\n")
    return DONE

"""`sweep audit`: simulate rollouts again in variants of the simulation, and count flipped outcomes."""

import argparse
import sys

from sweep.cli.arguments import add_folder, add_where, parse_names
from sweep.cli.command import Command, Section
from sweep.cli.exits import DONE
from sweep.core import terminal
from sweep.core.arguments import Arguments
from sweep.core.errors import InputError

COMMAND = Command(
    Section.CHECK,
    "simulate rollouts again in other ways, such as at half the time step, and count flipped outcomes",
)


def add_arguments(parser: Arguments) -> None:
    """Add the arguments of `sweep audit`: folder, number of rollouts, and variants of the simulation."""
    add_folder(parser)
    parser.add_argument("--points", type=int, default=32, help="number of rollouts of each kind, drawn at random (32)")
    parser.add_argument(
        "--ways", help="variants separated by commas: again, half_step, float64, other_engine, solid (default: all)"
    )
    add_where(parser)


def run(args: argparse.Namespace) -> int:
    """Simulate rows near the boundary, and successes elsewhere, in other variants; print how many flip."""
    from sweep.cli.run_progress import report_progress
    from sweep.report import tables
    from sweep.runs import audit, device_choice, results

    if args.points < 1:
        raise InputError(f"--points = {args.points} is not allowed: at least 1")
    found = results.read_results(args.dir, args.where)
    device_choice.choose_device_for_folder(args.dir)
    ways = parse_names(args.ways) or []
    most = 2 * args.points * len(ways or found.exp.system.audit_variants)
    with report_progress("audit", most, f"{found.exp.scenario} in other ways") as report:
        audit.run_audit(found, args.points, ways, report, lambda line: print(f"sweep: {line}", file=sys.stderr))
    terminal.print_markdown(tables.markdown_table(audit.outcome_flip_table(found)) + "\n")
    return DONE

"""`sweep audit`: simulate rollouts again in variants of the simulation, and count flipped outcomes."""

import argparse
import sys

from sweep.cli.arguments import add_folder, add_where, parse_comma_separated_names
from sweep.cli.command import Command, Section
from sweep.cli.exits import DONE
from sweep.core import terminal
from sweep.core.arguments import Arguments
from sweep.core.errors import InputError

MAX_ENGINE_ROWS = 10_000  # unless --most says otherwise
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
    parser.add_argument(
        "--engines",
        help="simulate the rows on these engines, separated by commas, or on `all`; store whether they agree",
    )
    parser.add_argument(
        "--most", type=int, metavar="N", help=f"with --engines: at most N rows, at random ({MAX_ENGINE_ROWS:,})"
    )
    add_where(parser)


def run(args: argparse.Namespace) -> int:
    """Simulate rows again in other variants, or on other engines; print how many outcomes differ."""
    from sweep.cli.run_progress import report_progress
    from sweep.report import tables
    from sweep.runs import audit, device_choice, results

    if args.engines:
        return run_on_engines(args)
    if args.most is not None:
        raise InputError("--most is not allowed without --engines: --points limits the rows of each kind")
    if args.points < 1:
        raise InputError(f"--points = {args.points} is not allowed: at least 1")
    found = results.read_results(args.dir, args.where)
    device_choice.choose_device_for_folder(args.dir)
    ways = parse_comma_separated_names(args.ways) or []
    most = 2 * args.points * len(ways or found.exp.system.audit_variants)
    with report_progress("audit", most, f"{found.exp.scenario} in other ways") as report:
        audit.run_audit(found, args.points, ways, report, lambda line: print(f"sweep: {line}", file=sys.stderr))
    terminal.print_markdown(tables.markdown_table(audit.outcome_flip_table(found)) + "\n")
    return DONE


def run_on_engines(args: argparse.Namespace) -> int:
    """Simulate rows on other engines; print on how many all agree, and where the others lie."""
    from sweep.analysis.stats import format_percent
    from sweep.cli.run_progress import report_progress
    from sweep.report import tables
    from sweep.runs import device_choice, engine_audit, results

    if args.ways:
        raise InputError("--ways is not allowed with --engines: they are two audits")
    most = MAX_ENGINE_ROWS if args.most is None else args.most
    if most < 1:
        raise InputError(f"--most = {most} is not allowed: at least 1")
    found, engines = results.read_results(args.dir, args.where), parse_comma_separated_names(args.engines) or []
    device_choice.choose_device_for_folder(args.dir)
    many = len(found.exp.system.engine_names if engines == [engine_audit.EVERY_ENGINE] else engines)
    with report_progress("audit", many * min(most, len(found.rows)), f"{found.exp.scenario} on engines") as report:
        engine_audit.run_engine_audit(
            found, engines, most, report, lambda line: print(f"sweep: {line}", file=sys.stderr)
        )
    found = results.read_results(args.dir, args.where)
    outcomes, rate = engine_audit.read_engine_outcomes(found), engine_audit.agreement_rate(found)
    interval = f" ({format_percent(rate.low)} to {format_percent(rate.high)})" if rate.has_interval else ""
    print(f"all engines agree on {rate.successes:,} of {rate.total:,} rows: {format_percent(rate.share)}{interval}")
    terminal.print_markdown(tables.markdown_table(engine_audit.engine_outcome_table(outcomes)) + "\n")
    if len(region := engine_audit.disagreement_region(found)):
        terminal.print_markdown(f"Where they do not agree:\n\n{tables.markdown_table(region, found.exp)}\n")
    return DONE

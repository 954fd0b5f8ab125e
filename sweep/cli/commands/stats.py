"""`sweep stats`: print the statistics of a study."""

import argparse

from sweep.cli.arguments import add_folder, add_where
from sweep.cli.command import Command, Section
from sweep.cli.exits import DONE
from sweep.core import terminal
from sweep.core.arguments import Arguments
from sweep.core.errors import InputError

COMMAND = Command(Section.READ, "print rates, volume, margins, tolerance and sensitivity of a study")


def add_arguments(parser: Arguments) -> None:
    """Add the arguments of `sweep stats`: folder, selection of rows, and what is estimated."""
    add_folder(parser)
    add_where(parser)
    parser.add_argument("--level", type=float, default=0.9, help="probability of success for the tolerance (0.9)")
    parser.add_argument(
        "--figure", help="compute Sobol indices or elementary effects of this column instead of success"
    )


def run(args: argparse.Namespace) -> int:
    """Print the statistics of a study."""
    from sweep.analysis.axis_effects import check_axis_effects
    from sweep.cli.rows import read_matching_rows
    from sweep.core.expressions import find_column
    from sweep.report import statistics
    from sweep.runs import results
    from sweep.study import design_kinds
    from sweep.study.columns import metric_columns

    exp = results.load_experiment(args.dir)
    empty = results.make_empty_row_table(args.dir, exp)
    figures = [find_column(empty, args.figure)] if args.figure else []
    measured = () if exp.study.is_adaptive else metric_columns(empty)  # a search may lead by any of them
    rows = read_matching_rows(args.dir, args.where, [c for c in empty.columns if c not in measured] + figures)
    if any(one.are_equal for one in check_axis_effects(rows, exp).values()):  # in what is read so far: metrics decide
        rows = read_matching_rows(args.dir, args.where)
    if not 0 < args.level < 1:
        raise InputError(f"--level = {args.level:g} is not allowed: between 0 and 1")
    if args.figure and not exp.study.design.sensitivity.needs_special_design:
        kinds = " or ".join(design_kinds.list_kinds(lambda kind: kind.sensitivity.needs_special_design))
        raise InputError(f"--figure is for sensitivity: it needs a study with study.design.kind={kinds}")
    terminal.print_markdown(
        statistics.render_statistics(rows, exp, args.level, args.figure),
        required=("share", "low", "high"),
        is_paged=True,
    )
    return DONE

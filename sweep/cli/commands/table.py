"""`sweep table`: print the rows of a study."""

import argparse
import sys
from collections.abc import Iterator
from typing import TYPE_CHECKING

from sweep.cli.arguments import add_folder, add_output, add_where, parse_comma_separated_names
from sweep.cli.command import Command, Section
from sweep.cli.exits import DONE
from sweep.core import terminal
from sweep.core.arguments import Arguments
from sweep.core.errors import InputError

if TYPE_CHECKING:
    import pandas as pd

    from sweep.config.experiment import Experiment

COMMAND = Command(Section.READ, "print the rows of a study as a table")


def add_arguments(parser: Arguments) -> None:
    """Add the arguments of `sweep table`: folder, selection of rows and columns, and format."""
    add_folder(parser)
    parser.add_argument(
        "--format",
        choices=("csv", "markdown", "latex", "parquet"),
        default="markdown",
        help="format of the table (markdown)",
    )
    add_where(parser, "only rows that match, such as 'friction > 0.8 and outcome == \"failure\"'")
    parser.add_argument("--columns", help="only these columns, separated by commas")
    add_output(parser, "write to this file instead of the standard output")


def run(args: argparse.Namespace) -> int:
    """Print or write rows as CSV, Markdown, LaTeX or Parquet."""
    from sweep.cli.rows import read_matching_rows, save_output
    from sweep.report import tables
    from sweep.runs import results

    if args.format == "parquet" and not args.output:
        raise InputError("--format parquet needs a file: -o FILE")
    exp = results.load_experiment(args.dir)
    empty, names = results.make_empty_row_table(args.dir, exp), parse_comma_separated_names(args.columns)
    chosen = tables.choose_columns(empty, args.format, names)
    if args.format in ("csv", "parquet"):
        write_rows(args, exp, empty[chosen])
        return DONE
    rows = read_matching_rows(args.dir, args.where, [*chosen, "replicate"])  # by which a page chooses columns
    content = tables.render_table(rows, args.format, names, exp)
    if args.output:
        save_output(args.output, content)
    elif args.format != "markdown":  # data for another program, whose lines must stay whole
        sys.stdout.write(content.decode())
    else:
        kept, elsewhere = ("outcome", "cause"), "use `--columns` to choose columns, or -o FILE for all"
        terminal.print_markdown(content.decode(), kept, elsewhere, is_paged=True)
    return DONE


def write_rows(args: argparse.Namespace, exp: "Experiment", empty: "pd.DataFrame") -> None:
    """Write rows of a study as CSV or Parquet, reading the folder piece by piece to limit memory.

    Args:
        args: Arguments of the subcommand.
        exp: Experiment of the folder.
        empty: A table without rows that has the columns to write, see `results.make_empty_row_table`.
    """
    from sweep.cli.rows import save_output, warn_of_no_match
    from sweep.report import tables
    from sweep.runs import results

    def parts() -> Iterator["pd.DataFrame"]:
        total, matching = 0, 0
        for rows, number in results.iterate_matching_rows(args.dir, exp, [*map(str, empty)], args.where):
            yield rows
            total, matching = total + number, matching + len(rows)
        if not matching:
            warn_of_no_match(args.dir, args.where, total)

    if args.format == "parquet":
        save_output(args.output, tables.iter_parquet_bytes(parts(), empty))
        return
    pieces = (tables.csv_bytes(rows, header=not k) for k, rows in enumerate(parts()))
    if args.output:
        save_output(args.output, pieces)
    else:
        sys.stdout.writelines(piece.decode() for piece in pieces)

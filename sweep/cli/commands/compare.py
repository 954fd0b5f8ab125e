"""`sweep compare`: compare the same points in two or more folders."""

import argparse
import sys
from pathlib import Path

from sweep.cli.arguments import add_output, parse_comma_separated_names
from sweep.cli.command import Command, Section
from sweep.cli.exits import DONE, UNEXPECTED
from sweep.core import terminal
from sweep.core.arguments import Arguments
from sweep.core.errors import InputError

COMMAND = Command(
    Section.READ,
    "compare the same points in two folders: which outcomes differ, and where",
    "sweep compare results/before results/after --tolerance 0.01 --figures 0.1",
)


def add_arguments(parser: Arguments) -> None:
    """Add the arguments of `sweep compare`: folders, pairing of rows, tolerances, and the sequential test."""
    parser.add_argument(
        "a", type=Path, metavar="A", help="reference folder; each of its rows needs a row of the same point in B"
    )
    parser.add_argument(
        "b",
        type=Path,
        nargs="+",
        metavar="B",
        help="folder to compare, such as of another engine, version or controller",
    )
    parser.add_argument("--a", dest="where_a", metavar="CONDITION", help="only rows of A that match")
    parser.add_argument("--b", dest="where_b", metavar="CONDITION", help="only rows of B that match")
    parser.add_argument(
        "--by", metavar="NAMES", help="columns whose values are equal within a pair (default: point_id)"
    )
    parser.add_argument("--regions", metavar="NAMES", help="also compare by region: each parameter is cut into thirds")
    parser.add_argument(
        "--tolerance", type=float, default=0.0, help="largest tolerated share of pairs whose outcomes differ"
    )
    parser.add_argument(
        "--figures", type=float, metavar="SHARE", help="largest tolerated relative change (median) of a metric"
    )
    parser.add_argument(
        "--histories",
        type=float,
        metavar="SHARE",
        default=1e-3,
        help="if both folders keep time series: largest difference that counts as equal, over a column's range (0.001)",
    )
    add_output(parser, "write the pairs that differ as CSV")
    parser.add_argument(
        "--anytime",
        action="store_true",
        help="decide which folder succeeds more often; valid at any time, however often you look",
    )
    parser.add_argument("--level", type=float, help="confidence of --anytime (0.95)")
    parser.add_argument(
        "--most",
        type=int,
        metavar="N",
        help="with --anytime: simulate up to N draws in both folders until the test decides",
    )


def run(args: argparse.Namespace) -> int:
    """Compare a folder with others; exit code 4 if outcomes or metrics differ beyond the tolerance."""
    import pandas as pd

    from sweep.analysis import compare
    from sweep.cli.rows import read_matching_rows, save_output
    from sweep.report import comparison
    from sweep.runs import results

    if not 0 <= args.tolerance <= 1:
        raise InputError(f"--tolerance = {args.tolerance:g} is not allowed: a share from 0 to 1")
    if args.figures is not None and not args.figures >= 0:
        raise InputError(f"--figures = {args.figures:g} is not allowed: at least 0")
    if not args.histories >= 0:
        raise InputError(f"--histories = {args.histories:g} is not allowed: at least 0")
    for name in ("most", "level"):
        if (value := getattr(args, name)) is not None and not args.anytime:
            raise InputError(f"--{name} = {value:g} is for --anytime")
    if args.anytime:
        from sweep.cli import anytime
        from sweep.runs import device_choice

        device_choice.choose_device_for_folder(args.a)
        print(anytime.compare_folders_sequentially(args, parse_comma_separated_names(args.by)))
        return DONE
    a, differ, broken = read_matching_rows(args.a, args.where_a), [], []
    for number, folder in enumerate(args.b):
        b = read_matching_rows(folder, args.where_b)
        pairs = compare.pair_rows(a, b, parse_comma_separated_names(args.by))
        if len(args.b) > 1:
            print(f"{chr(10) if number else ''}{args.a} and {folder}")
        unit = compare.pair_sampling_unit_ids(pairs, results.load_experiment(args.a))
        text = comparison.comparison_text(pairs, len(a), len(b), parse_comma_separated_names(args.regions), unit)
        required = ("pairs", "flips", "only A succeeds", "only B succeeds", "outcome", "outcome (B)")
        terminal.print_markdown(text + "\n", required)
        if line := comparison.first_difference_text(args.a, folder, args.histories):
            print(line)
        differ.append(compare.changed_pairs(pairs).assign(**({"B": str(folder)} if len(args.b) > 1 else {})))
        broken += comparison.list_tolerance_violations(pairs, len(a), args.tolerance, args.figures)
    if args.output:
        save_output(args.output, pd.concat(differ).to_csv(index=False).encode())
    for line in broken:
        print(f"sweep: {line}", file=sys.stderr)
    return UNEXPECTED if broken else DONE

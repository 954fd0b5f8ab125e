"""`sweep league`: rank several policies that ran on the same points."""

import argparse
from pathlib import Path

from sweep.cli.arguments import add_output, add_where, parse_comma_separated_names
from sweep.cli.command import Command, Section
from sweep.cli.exits import DONE
from sweep.core.arguments import Arguments
from sweep.core.errors import InputError

COMMAND = Command(
    Section.READ,
    "rank several policies on the same points: which is better than which, with statements that hold together",
    "sweep league results/a results/b results/c --picture league.svg",
)


def add_arguments(parser: Arguments) -> None:
    """Add the arguments of `sweep league`: folders or axis of policies, conditions, and sequential comparison."""
    parser.add_argument("dirs", type=Path, nargs="+", metavar="DIR", help="folder of each policy; one with --axis")
    parser.add_argument(
        "--axis", metavar="NAME", help="axis of one folder whose values are the policies, such as controller"
    )
    parser.add_argument("--by", metavar="NAMES", help="also rank at each value of these columns, or at thirds of them")
    add_where(parser)
    parser.add_argument("--level", type=float, default=0.95, help="confidence of all statements together (0.95)")
    parser.add_argument(
        "--anytime", action="store_true", help="verdicts that are valid at any time, however often you look"
    )
    parser.add_argument("--best", action="store_true", help="with --anytime: stop when the best policy is known")
    parser.add_argument(
        "--most",
        type=int,
        metavar="N",
        help="with --anytime: simulate up to N draws of each policy whose pairs are not decided",
    )
    parser.add_argument("--picture", type=Path, metavar="FILE", help="draw rates and verdicts")
    parser.add_argument(
        "--page", type=Path, metavar="FILE.html", help="write a page with a sortable table, maps and all pairs"
    )
    add_output(parser, "write the pairs as CSV")


def run(args: argparse.Namespace) -> int:
    """Print the ranking of policies and all pairs of them, or compare policies sequentially (`--anytime`)."""
    from sweep.cli import policy_race
    from sweep.cli.rows import save_output
    from sweep.core import terminal
    from sweep.core.plot_style import save_figure
    from sweep.report import league as report

    if not 0.5 <= args.level < 1:
        raise InputError(f"--level = {args.level:g} is not allowed: at least 0.5 and below 1")
    for name in ("best", "most"):
        if getattr(args, name) and not args.anytime:
            raise InputError(f"--{name} is for --anytime")
    if args.anytime:
        for name in ("picture", "page", "output", "by"):
            if getattr(args, name):
                raise InputError(f"--{name} is not allowed with --anytime, which only decides pairs")
        print(policy_race.race_policies(args), end="")
        return DONE
    read, unit, exp = policy_race.read_policy_outcomes(args)
    league, by = policy_race.bin_conditions(read, parse_comma_separated_names(args.by) or [])
    table, pairs = report.standings_and_pair_table(league, args.level)
    text = report.format_league(league, table, pairs, args.level, unit, by)
    terminal.print_markdown(text, required=("policy", "share", "verdict", "a", "b"))
    if args.picture:
        save_figure(report.draw_league(table, pairs), args.picture)
    if args.page:
        from sweep.report import league_page

        content = league_page.LeagueContent(read, table, pairs, args.level, unit)
        folders = [] if args.axis else args.dirs
        print(league_page.write_league_page(args.page, content, exp, args.dirs[0], folders))
    if args.output:
        save_output(args.output, pairs.to_csv(index=False).encode())
    return DONE

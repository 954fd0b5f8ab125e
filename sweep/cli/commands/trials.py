"""`sweep trials`: compare real trials with the simulated rows of a study."""

import argparse
from pathlib import Path

from sweep.cli.arguments import add_output
from sweep.cli.command import Command, Section
from sweep.cli.exits import DONE
from sweep.core.arguments import Arguments
from sweep.core.errors import InputError

COMMAND = Command(
    Section.CHECK,
    "compare real trials with simulated rows: calibration, correlation, and which beliefs the trials move",
    "sweep trials trials.csv results/draws --picture reliability.svg",
)


def add_arguments(parser: Arguments) -> None:
    """Add the arguments of `sweep trials`: file of real trials, folder, and assumed error rate of the simulation."""
    parser.add_argument(
        "file", type=Path, metavar="FILE.csv", help="a line for each trial: columns of axes, and outcome"
    )
    parser.add_argument("dir", type=Path, metavar="DIR", help="folder of a study whose axes the conditions are")
    parser.add_argument(
        "--error-rate",
        type=float,
        default=0.05,
        metavar="P",
        help="probability that a trial ends otherwise than the simulation with the true parameters (0.05)",
    )
    parser.add_argument("--picture", type=Path, metavar="FILE", help="draw the reliability curve")
    add_output(parser, "write the trials with their predicted rates as CSV")


def run(args: argparse.Namespace) -> int:
    """Print how well predicted success rates fit real trials, and the parameter distributions before and after them."""
    from sweep.cli import real_trials
    from sweep.cli.rows import save_output
    from sweep.core import terminal

    if not 0 < args.error_rate < 0.5:
        raise InputError(f"--error-rate = {args.error_rate:g} is not allowed: above 0 and below 0.5")
    found = real_trials.compare_trials_with_simulation(args.file, args.dir, args.error_rate)
    terminal.print_markdown(real_trials.format_trials_comparison(found))
    if args.picture:
        real_trials.save_reliability_plot(found, args.picture)
    if args.output:
        save_output(args.output, found.trials.to_csv(index=False).encode())
    return DONE

"""`sweep power`: how many rollouts a question needs."""

import argparse
from pathlib import Path

from sweep.cli.arguments import add_output
from sweep.cli.command import Command, Section
from sweep.cli.exits import DONE
from sweep.core.arguments import Arguments

COMMAND = Command(
    Section.LOOK_UP,
    "compute how many rollouts a rate, a comparison, a rare failure or a certified region needs",
    "sweep power difference 0.9 0.8 --correlation 0.5",
)
QUESTIONS = ("rate", "difference", "rare", "region")


def add_arguments(parser: Arguments) -> None:
    """Add the arguments of `sweep power`: question, expected probabilities, goal, and folders of a pilot study."""
    parser.description = (
        "Compute how many rollouts answer a question. The expected probabilities are guesses, or come from a pilot "
        "study, whose independent units are then drawn again."
    )
    parser.add_argument(
        "question",
        choices=QUESTIONS,
        help="rate: narrow interval of a success rate; difference: which of two policies is better; rare: interval of "
        "a small failure probability; region: certify a region",
    )
    parser.add_argument(
        "expected",
        nargs="*",
        type=float,
        metavar="P",
        help="rate: success rate; difference: both success rates; rare: failure probability; region: failure "
        "probability within the region",
    )
    parser.add_argument(
        "--pilot", nargs="+", type=Path, metavar="DIR", help="folder of a pilot study; two for a difference"
    )
    parser.add_argument("--half-width", type=float, metavar="W", help="rate: largest half-width of the interval (0.02)")
    parser.add_argument(
        "--relative", type=float, metavar="W", help="rare: largest half-width, as a share of the probability (0.5)"
    )
    parser.add_argument(
        "--correlation", type=float, metavar="R", help="difference: correlation of the outcomes of a pair (0)"
    )
    parser.add_argument(
        "--unpaired", action="store_true", help="difference: the policies run on different draws, not on the same"
    )
    parser.add_argument("--failures", type=float, metavar="P", help="region: failure probability to certify (0.01)")
    parser.add_argument("--share", type=float, metavar="S", help="region: share of the draws that fall into it (1)")
    parser.add_argument(
        "--power", type=float, default=0.9, help="probability that the study meets its goal (0.9)", metavar="P"
    )
    parser.add_argument("--level", type=float, default=0.95, help="confidence level (0.95)")
    parser.add_argument(
        "--seconds", type=float, metavar="S", help="seconds per rollout, for the duration (default: the pilot's)"
    )
    parser.add_argument("--picture", type=Path, metavar="FILE", help="draw the goal by the number of rollouts")
    add_output(parser, "write the answer as JSON")


def run(args: argparse.Namespace) -> int:
    """Print how many rollouts a study needs, a table of smaller and larger studies, and the expected duration."""
    import json

    from sweep.cli import study_size
    from sweep.cli.rows import save_output
    from sweep.core import terminal

    answer = study_size.compute_study_size(args)
    terminal.print_markdown(study_size.format_size_estimate(answer))
    if args.picture:
        study_size.save_size_plot(answer, args.picture)
    if args.output:
        save_output(args.output, f"{json.dumps(study_size.size_estimate_json_values(answer), indent=1)}\n".encode())
    return DONE

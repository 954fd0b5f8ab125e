"""`sweep certify`: find a region of parameters in which failures are guaranteed to be rare."""

import argparse

from sweep.cli.arguments import add_folder, add_output
from sweep.cli.command import Command, Section
from sweep.cli.exits import DONE, UNEXPECTED
from sweep.core.arguments import Arguments

COMMAND = Command(
    Section.READ,
    "find the largest region of drawn parameters in which failures are guaranteed to be rare",
    "sweep certify results/draws --failures 1e-2 --confidence 0.95 --rollouts 4096",
)


def add_arguments(parser: Arguments) -> None:
    """Add the arguments of `sweep certify`: folder, guarantee, and shape of the region."""
    add_folder(parser)
    parser.add_argument(
        "--failures", type=float, default=1e-2, help="largest failure probability within the region (0.01)"
    )
    parser.add_argument("--confidence", type=float, default=0.95, help="confidence of the guarantee (0.95)")
    parser.add_argument(
        "--shape", choices=("box", "ellipsoid", "score"), default="box", help="shape of the region (box)"
    )
    parser.add_argument(
        "--rollouts", type=int, metavar="N", help="test with N fresh draws (default: test with half of the rows)"
    )
    parser.add_argument(
        "--engines-agree",
        action="store_true",
        help="count a row as a success only if it succeeds on all engines of `sweep audit --engines`",
    )
    add_output(parser, "write the certificate as JSON")


def run(args: argparse.Namespace) -> int:
    """Certify a region of parameters with few failures, and print its guarantee; exit code 4 if there is none."""
    import json

    from sweep.cli import certification
    from sweep.cli.rows import save_output
    from sweep.runs import device_choice

    device_choice.choose_device_for_folder(args.dir)
    text, found = certification.certify_region(args)
    print(text)
    if args.output:
        save_output(args.output, f"{json.dumps(found, indent=1)}\n".encode())
    return DONE if found["certified"] else UNEXPECTED

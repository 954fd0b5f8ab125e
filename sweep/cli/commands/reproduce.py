"""`sweep reproduce`: simulate rows of a crate again on this machine and compare them."""

import argparse
from pathlib import Path

from sweep.cli.command import Command, Section
from sweep.core.arguments import Arguments
from sweep.core.errors import InputError

COMMAND = Command(
    Section.CHECK,
    "simulate rows of a crate again on this machine and compare them",
    "sweep reproduce walk_map.zip --rows 50",
)


def add_arguments(parser: Arguments) -> None:
    """Add the arguments of `sweep reproduce`: crate (archive of a study), choice of rows, and tolerance."""
    parser.add_argument("crate", type=Path, help="folder or archive that `sweep export DIR --crate` wrote")
    parser.add_argument("--trust", action="store_true", help="allow code of the crate to run, such as its controller")
    parser.add_argument("--rows", type=int, default=20, help="number of rows, drawn at random (20)")
    parser.add_argument("--seed", type=int, default=0, help="seed of the random choice (0)")
    other = "relative tolerance of metrics in rows of other machines or versions (0.001)"
    parser.add_argument("--tolerance", type=float, default=1e-3, help=other)


def run(args: argparse.Namespace) -> int:
    """Simulate rows of a crate (archive of a study) again; exit code 4 if results changed. Raises `InputError`.

    A crate that has code runs only with `--trust`; without it the code is listed.
    """
    from sweep.cli.simulated_again import report_resimulation
    from sweep.report import crate
    from sweep.runs import repair, results

    if args.rows < 1:
        raise InputError(f"--rows = {args.rows} is not allowed: at least 1")
    if not args.tolerance >= 0:
        raise InputError(f"--tolerance = {args.tolerance:g} is not allowed: at least 0")
    if not 0 <= args.seed < 2**32:
        raise InputError(f"--seed = {args.seed} is not allowed: at least 0 and below 2^32")
    with crate.unpack_crate(args.crate) as folder:
        if (code := crate.list_code_files(folder)) and not args.trust:
            print("\n".join(code))
            raise InputError(f"{args.crate} contains code, listed above: read it, then give --trust to run it")
        with crate.use_crate_project(folder):
            if problems := repair.verify_folder(folder / crate.STUDY_FOLDER)[0]:
                raise InputError(problems[0])
            found = results.read_results(folder / crate.STUDY_FOLDER)
            return report_resimulation(found, args.rows, args.seed, args.tolerance)

"""`sweep export`: export a study for a paper, or as an RO-Crate."""

import argparse
import os
from contextlib import nullcontext
from pathlib import Path

from sweep.cli.arguments import add_folder, add_where
from sweep.cli.command import Command, Section
from sweep.cli.exits import DONE
from sweep.core.arguments import Arguments
from sweep.core.errors import InputError

COMMAND = Command(Section.SHARE, "export a study for a LaTeX paper, or as an RO-Crate for archives")
LICENSE = "https://spdx.org/licenses/CC-BY-4.0"


def add_arguments(parser: Arguments) -> None:
    """Add the arguments of `sweep export`: folder, options of the LaTeX export, and options of the crate."""
    add_folder(parser)
    parser.add_argument("--paper", type=Path, metavar="FOLDER", help="write LaTeX tables, figures, numbers and data")
    parser.add_argument(
        "--crate", type=Path, metavar="FOLDER", help="write an RO-Crate: rows, configuration, pictures and provenance"
    )
    parser.add_argument("--zip", action="store_true", help="write the crate as FOLDER.zip")
    parser.add_argument("--license", default=LICENSE, metavar="ADDRESS", help="licence of the crate's data (CC-BY-4.0)")
    add_where(parser)
    parser.add_argument("--serif", action="store_true", help="use a serif font in figures")
    parser.add_argument("--author", default="", metavar="NAME", help="name of the person who ran the study")


def run(args: argparse.Namespace) -> int:
    """Export a study for a paper, or as a crate."""
    from sweep.report import crate, paper
    from sweep.runs import results, store

    if bool(args.paper) == bool(args.crate):
        raise InputError("export needs either --paper FOLDER or --crate FOLDER")
    if args.crate:
        if args.where or args.serif:
            raise InputError("--where and --serif need --paper: a crate contains the whole study")
        store.read_study(args.dir)  # before it is held, which would make it
        # nothing is added while it is copied, nor ever to what cannot be written
        with store.lock_folder(args.dir) if os.access(args.dir, os.W_OK) else nullcontext():
            print(crate.write_crate(results.read_results(args.dir), args.crate, args.license, args.zip, args.author))
        return DONE
    if args.zip or args.author or args.license != LICENSE:
        raise InputError("--zip, --author and --license need --crate")
    for path in paper.write_paper(results.read_results(args.dir, args.where), args.paper, args.serif):
        print(path)
    return DONE

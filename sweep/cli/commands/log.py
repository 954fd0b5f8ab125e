"""`sweep log`: store a study as a run of an experiment tracker."""

import argparse
import tempfile
from functools import partial
from pathlib import Path

from sweep.cli.arguments import add_folder, add_where
from sweep.cli.command import Command, Section
from sweep.cli.exits import DONE
from sweep.core.arguments import Arguments
from sweep.core.errors import InputError

COMMAND = Command(
    Section.SHARE,
    "store a study as a run of MLflow, Weights & Biases or TensorBoard",
    "MLFLOW_TRACKING_URI=http://localhost:5000 sweep log results/walk_map --mlflow",
)


def add_arguments(parser: Arguments) -> None:
    """Add the arguments of `sweep log`: folder and trackers."""
    parser.description = (
        "Store parameters, metrics and page of a study as a run of an experiment tracker. MLflow and Weights & Biases "
        "read their server, experiment and project from their own environment variables."
    )
    add_folder(parser)
    parser.add_argument("--mlflow", action="store_true", help="store a run of MLflow (extra mlflow)")
    parser.add_argument("--wandb", action="store_true", help="store a run of Weights & Biases (extra wandb)")
    parser.add_argument(
        "--tensorboard", type=Path, metavar="FOLDER", help="write a run of TensorBoard to FOLDER (extra tensorboard)"
    )
    add_where(parser)


def run(args: argparse.Namespace) -> int:
    """Store the study as a run of each tracker that the user names. Raises `InputError`."""
    from sweep.report import page, trackers
    from sweep.runs import results

    wanted = [name for name in trackers.MODULES if getattr(args, name)]
    if not wanted:
        raise InputError("log needs a tracker: --mlflow, --wandb or --tensorboard FOLDER")
    packages = {name: trackers.import_tracker(name) for name in wanted}  # before the page, which takes seconds
    found = results.read_results(args.dir, args.where, with_bookkeeping=False)
    study = trackers.describe_tracked_study(found)
    with tempfile.TemporaryDirectory() as folder:
        written = page.write_page(found, Path(folder) / "report.html")
        store = {
            "mlflow": trackers.log_study_to_mlflow,
            "wandb": trackers.log_study_to_wandb,
            "tensorboard": partial(trackers.log_study_to_tensorboard, folder=args.tensorboard),
        }
        for name, package in packages.items():
            try:
                print(store[name](package, study, written))
            except Exception as error:  # trackers raise errors of their own for a wrong server, project or key
                raise InputError(f"--{name}: {(str(error) or type(error).__name__).splitlines()[0]}") from error
    return DONE

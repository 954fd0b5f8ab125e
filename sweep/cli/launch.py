"""`sweep run` as a Hydra application: compose the configuration, or explain in one line why it is wrong."""

import os
import sys
from collections.abc import Callable
from pathlib import Path
from typing import NoReturn

import hydra
from hydra.errors import HydraException
from omegaconf import DictConfig
from omegaconf.errors import OmegaConfBaseException

from sweep.cli.exits import BAD_INPUT, DONE, FAULT
from sweep.config import experiment
from sweep.config.experiment import Experiment
from sweep.config.hydra_sources import make_hydra_parser
from sweep.core.arguments import list_flags, make_usage_error
from sweep.core.errors import Fault, InputError

HYDRA_ACTIONS = ("run", "multirun", "cfg", "info", "shell_completion")  # of what Hydra does
COMPLETION_QUERIES = ("install=", "uninstall=", "query=")  # what its completion is told


def launch_hydra(overrides: list[str], work: Callable[[Experiment], int], run_flags: list[str]) -> int:
    """Compose the configuration of `overrides` with Hydra and call `work` on it; return the exit code, the largest of a
    multirun.

    Raises `InputError`; for an unknown flag it names the closest of Hydra's and of our own `run_flags`.
    """
    if not any(one.startswith(("-", "hydra", "+hydra", "~hydra")) for one in overrides):
        return work(experiment.compose(overrides))  # Hydra's application would compose it twice
    check_run_arguments(overrides, run_flags)
    experiment.register_schemas()
    codes = [DONE]

    @hydra.main(
        version_base=experiment.HYDRA_VERSION,
        config_path=f"pkg://{experiment.CONFIG_MODULE}",
        config_name=experiment.primary_config(overrides),
    )
    def job(composed: DictConfig) -> None:
        try:
            codes.append(work(experiment.build_experiment(experiment.resolve_interpolations(composed))))
        # Hydra would add lines of its own, and give up a multirun's other jobs
        except Fault as error:
            print(f"sweep: {error}", file=sys.stderr)
            codes.append(FAULT)
        except (InputError, OmegaConfBaseException) as error:
            line = str(error) if isinstance(error, InputError) else experiment.format_error(error, overrides)
            print(f"sweep: {line}", file=sys.stderr)
            codes.append(BAD_INPUT)

    before = sys.argv
    sys.argv = ["sweep run", *overrides]
    os.environ["HYDRA_FULL_ERROR"] = "1"  # let errors through to here, where they become one line
    try:
        experiment.check_overrides(overrides)
        job()
    except (HydraException, OmegaConfBaseException, OverflowError, RecursionError) as error:
        raise InputError(experiment.format_error(error, overrides)) from None
    finally:
        sys.argv = before
    return max(codes)


def check_run_arguments(overrides: list[str], run_flags: list[str]) -> None:
    """Raise `InputError` for arguments of `sweep run` for which Hydra would print its usage."""
    parser = make_hydra_parser()

    def error(message: str) -> NoReturn:
        raise make_usage_error(message, "sweep run", [*list_flags(parser), *run_flags])

    parser.error = error
    args = parser.parse_args(overrides)
    if len(both := [flag for flag in HYDRA_ACTIONS if getattr(args, flag)]) > 1:
        raise InputError(f"--{both[0]} and --{both[1].replace('_', '-')} are not allowed together")
    if args.resolve and not args.cfg:
        raise InputError("--resolve is for --cfg")
    if args.shell_completion and not any(one.startswith(COMPLETION_QUERIES) for one in args.overrides):
        raise InputError(
            f"--shell-completion needs {', '.join(COMPLETION_QUERIES)} and a shell: `sweep completion` is simpler"
        )
    if (file := args.experimental_rerun) and not Path(file).is_file():
        raise InputError(f"--experimental-rerun = {file} is not a file")

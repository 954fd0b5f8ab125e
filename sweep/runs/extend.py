"""Extension of a stored study by more draws or replicates, without changing existing rows."""

from pathlib import Path
from typing import Any

from sweep.config.experiment import Experiment, build_experiment
from sweep.core.errors import InputError
from sweep.runs import runner, store
from sweep.study import design_kinds


def count_draws(exp: Experiment) -> int:
    """Return the study's number of draws, or its number of replicates if its design draws nothing."""
    return exp.study.design.num if exp.study.design.num else exp.study.replicates


def check_extendable(exp: Experiment, folder: Path) -> None:
    """Check that a study can be extended by more draws or replicates.

    Args:
        exp: Experiment of the study.
        folder: Its folder, for the message.

    Raises:
        InputError: Its points are listed in a file or refined, its design cannot add draws, or it has neither draws
            nor replicates.
    """
    if exp.study.points or exp.study.is_refined:
        raise InputError(f"{folder} cannot be extended: its points come from a file, or a search chooses them")
    if exp.study.design.num and not exp.study.design.can_add_draws:
        allowed = " or ".join(design_kinds.list_kinds(lambda kind: kind.can_add_draws))
        raise InputError(
            f"{folder} cannot be extended: study.design.kind = {exp.study.design.kind} (allowed: {allowed})"
        )
    if not exp.study.design.num and exp.study.replicates < 2:
        raise InputError(f"{folder} cannot be extended: it has neither draws nor replicates")


def extend_study(exp: Experiment, folder: Path, count: int, progress: runner.ProgressCallback) -> Experiment:
    """Extend a stored study to a larger number of draws or replicates, and simulate the rollouts that its folder lacks.

    Args:
        exp: Experiment of the study.
        folder: Its folder.
        count: New number of draws, or of replicates if the design draws nothing.
        progress: Receives the rows of every finished batch.

    Returns:
        The experiment of the extended study.

    Raises:
        InputError: The rows in the folder are from other code or another study.
    """
    study: dict[str, Any] = dict(exp.values["study"])
    study |= {"design": {**study["design"], "num": count}} if exp.study.design.num else {"replicates": count}
    extended = build_experiment({**exp.values, "study": study, "out": str(folder)})
    with store.lock_folder(folder):
        runner.repair_folder(extended, folder)
        runner.run_job(runner.prepare_job(extended, folder, runner.select_points_to_simulate(extended)), progress)
    return extended

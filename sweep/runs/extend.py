"""More draws of a study that is there: the same draws as before, and others after them."""

from pathlib import Path
from typing import Any

from sweep.core.errors import InputError
from sweep.runs import runner, store
from sweep.study.config import Experiment, experiment

GROWING = ("monte_carlo", "sobol")  # designs whose first draws stay as more come


def count_draws(exp: Experiment) -> int:
    """How many draws the study has, or replicates where nothing is drawn."""
    return exp.study.design.num if exp.study.design.num else exp.study.replicates


def check_extendable(exp: Experiment, folder: Path) -> None:
    """Raise `InputError` where a study has no draws or replicates that can become more."""
    if exp.study.points or exp.study.is_refined:
        raise InputError(f"{folder} cannot grow: its points are listed in a file, or chosen by what was found")
    if exp.study.design.num and exp.study.design.kind not in GROWING:
        allowed = " or ".join(GROWING)
        raise InputError(f"{folder} cannot grow: study.design.kind = {exp.study.design.kind} (allowed: {allowed})")
    if not exp.study.design.num and exp.study.replicates < 2:
        raise InputError(f"{folder} cannot grow: it has neither draws nor replicates")


def grow(exp: Experiment, folder: Path, count: int, progress: runner.Progress) -> Experiment:
    """Simulate what `folder` lacks of so many draws, or replicates, of its study; the study as it is then.

    The code must be that of the rows that are there. Raises `InputError`.
    """
    own: dict[str, Any] = dict(exp.values["study"])
    own |= {"design": {**own["design"], "num": count}} if exp.study.design.num else {"replicates": count}
    more = experiment({**exp.values, "study": own, "out": str(folder)})
    with store.lock_folder(folder):
        runner.repair_folder(more, folder)
        runner.run(runner.prepare_job(more, folder, runner.select_points(more)), progress)
    return more

"""Whether a command simulates on the CPU of a machine with a GPU, which is told to JAX before it has begun."""

import re
from pathlib import Path

from sweep.core.errors import InputError
from sweep.core.files import path_in
from sweep.engines import devices
from sweep.study.config import Experiment

ON_CPU = re.compile(r"(\d+ x )?cpu\b")  # how the devices of a folder begin where they are cores


def choose_device_for_run(exp: Experiment) -> None:
    """What a folder has rows of goes on where these are from; else few rollouts go to the CPU, where they end sooner.

    Of how many rollouts rounds and files of points are is not known before they have run.
    """
    study = exp.study
    if (exp.out or not study.single) and _rows(exp.folder):
        choose_device_for_folder(exp.folder)
    elif not study.points and not study.is_sequential and study.max_rollouts <= exp.system.cpu_threshold(exp.settings):
        devices.prefer_cpu(f"where {'a rollout ends' if study.max_rollouts == 1 else 'few rollouts end'} sooner")


def choose_device_for_folder(folder: Path) -> None:
    """Rollouts of a folder again, or more of them, go to the CPU if its rows are from one."""
    if all(map(ON_CPU.match, found := _rows(folder))) and found:
        devices.prefer_cpu(f"as the rows of {folder} were")


def _rows(folder: Path) -> list[str]:
    """The devices that rows of a folder are from; none where there are no rows, or it is damaged."""
    from sweep.runs import store  # whose libraries one rollout has no need of

    try:
        return store.read_study(folder)["devices"] if path_in(folder, store.STUDY).exists() else []
    except InputError:
        return []

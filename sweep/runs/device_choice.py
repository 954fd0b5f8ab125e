"""Choice between CPU and GPU for a command, before JAX starts."""

import re
from pathlib import Path

from sweep.backends import devices
from sweep.config.experiment import Experiment
from sweep.core.errors import InputError
from sweep.core.files import path_inside_folder

CPU_NAME = re.compile(r"(\d+ x )?cpu\b")  # matches the name of a CPU in study.yaml


def choose_device_for_run(exp: Experiment) -> None:
    """Choose CPU or GPU for a run: the device of the folder's existing rows, else the CPU for small runs.

    Studies in rounds and studies of a table of points keep JAX's default, as their size is not known beforehand.
    """
    study = exp.study
    if (exp.out or not study.single) and _row_devices(exp.folder):
        choose_device_for_folder(exp.folder)
    elif (
        not study.points
        and not study.is_sequential
        and study.max_rollouts <= exp.system.max_rollouts_for_cpu(exp.settings)
    ):
        devices.prefer_cpu(f"where {'a rollout ends' if study.max_rollouts == 1 else 'few rollouts end'} sooner")


def choose_device_for_folder(folder: Path) -> None:
    """Choose the CPU if all rows of a folder were simulated on a CPU; else keep JAX's default device."""
    names = _row_devices(folder)
    if names and all(map(CPU_NAME.match, names)):
        devices.prefer_cpu(f"as the rows of {folder} were")


def _row_devices(folder: Path) -> list[str]:
    """Return the names of the devices that simulated a folder's rows; empty without rows, or where it is damaged."""
    from sweep.runs import store  # slow to import, and a single rollout does not need it

    try:
        return store.read_study(folder)["devices"] if path_inside_folder(folder, store.STUDY_FILE).exists() else []
    except InputError:
        return []

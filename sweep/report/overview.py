"""Table of study folders for `sweep list results/`, one line each."""

from datetime import datetime
from pathlib import Path

import pandas as pd

from sweep.analysis.stats import format_percent, success_rate
from sweep.config.experiment import flatten_values
from sweep.core.errors import InputError
from sweep.core.files import path_inside_folder, printable_name
from sweep.report.headline import probability_of_failure
from sweep.runs import store
from sweep.runs.results import load_experiment
from sweep.study.design_kinds import is_adaptive_kind


def overview_text(folders: list[Path]) -> str:
    """Return a table of the studies in `folders` or directly below them. Raises `InputError` for a folder without
    any."""
    found = [one for folder in folders for one in find_study_folders(folder)]
    return pd.DataFrame([describe_folder(folder) for folder in found]).to_markdown(index=False, disable_numparse=True)


def find_study_folders(folder: Path) -> list[Path]:
    """Return the folder itself if it holds a study, else the study folders directly in it. Raises `InputError` without
    any."""
    places = [folder / store.STUDY_FILE, *sorted(folder.glob(f"*/{store.STUDY_FILE}"))]
    if found := [file.parent for file in places if file.exists()]:
        return found[:1] if found[0] == folder else found
    raise InputError(f"{folder} holds no study: a folder with {store.STUDY_FILE} is one")


def describe_folder(folder: Path) -> dict[str, str]:
    """Summarize a results folder: study, rollouts done and planned, success rate or failure probability, code, last
    change."""
    name = printable_name(folder)
    empty = dict.fromkeys(("study", "rollouts", "succeed", "invalid", "commit", "date"), "")
    try:
        stored = store.read_study(folder)
        outcome = read_outcomes(folder)
    except InputError as error:
        return {"folder": name, **empty, "study": printable_name(str(error).split(":")[0].removeprefix(f"{folder}/"))}
    found, config = success_rate(outcome), flatten_values(stored["config"])
    succeed = format_percent(found.share) if found.valid_count else ""
    invalid = format_percent(found.invalid_share)
    if config.get("study.resolution") or config.get("study.budget"):  # most rollouts lie next to the boundary
        succeed = f"{found.successes:,} rollouts" if found.valid_count else ""
    if is_adaptive_kind(config.get("study.design.kind")) and config.get("study.design.num"):
        succeed = read_failure_probability(folder) if found.total else ""
        invalid = f"{found.invalid:,}"  # of the placed rollouts, of which no share is a rate
    changed_s = path_inside_folder(folder, store.STUDY_FILE).stat().st_mtime
    return {
        "folder": name,
        "study": str(config.get("study.name") or config.get("scenario.name", "")),
        "rollouts": f"{found.total:,} of {stored['rollouts']:,}",
        "succeed": succeed,
        "invalid": invalid,
        "commit": stored["commit"] or stored["code"],
        "date": f"{datetime.fromtimestamp(changed_s):%Y-%m-%dT%H:%M}",
    }


def read_failure_probability(folder: Path) -> str:
    """Return the failure probability of a study that searches for failures as text, or why it is unknown."""
    try:
        return probability_of_failure(store.read_rows(folder), load_experiment(folder))
    except InputError as error:
        return f"P(failure) is not known: {printable_name(str(error).rpartition(': ')[2])}"


def read_outcomes(folder: Path) -> pd.Series:
    """Return the outcomes of a folder's finished rows. Raises `InputError` if a file of rows is damaged."""
    if not store.list_current_parts(folder):
        return pd.Series([], dtype=object)
    return store.read_rows(folder, ["outcome"])["outcome"]

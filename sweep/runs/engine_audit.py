"""Audit of a study on several engines for `sweep audit --engines`: whether each row's outcome depends on the simulator.

Each other engine simulates the same points in a study of its own below the folder's `audit/`, which a repeated command
continues. Whether all engines agree becomes the column `engines_agree` of the study's rows.
"""

from pathlib import Path

import numpy as np
import pandas as pd

from sweep.analysis.sample import pooled_success_rate
from sweep.analysis.stats import SuccessRate
from sweep.contract.system import AuditVariant
from sweep.core.errors import InputError, require_choice
from sweep.core.files import path_inside_folder
from sweep.core.outcomes import FAILURE, INVALID, SUCCESS
from sweep.runs import runner, store
from sweep.runs.audit import (
    AUDIT_FOLDER,
    apply_stored_engine_settings,
    select_point_columns,
    simulate_audit_variant,
)
from sweep.runs.results import Results
from sweep.study.columns import VERDICT_COLUMNS
from sweep.study.study import Logger

FOLDER_PREFIX, EVERY_ENGINE = "engine_", "all"
(AGREE,) = VERDICT_COLUMNS
YES, NO = "yes", "no"
OUTCOME_ON = "outcome on "  # start of the columns with the outcome on each engine, before its name


def run_engine_audit(
    results: Results,
    engines: list[str],
    most: int,
    progress: runner.ProgressCallback,
    on_message: Logger | None = None,
) -> None:
    """Simulate finished rows on other engines, and store whether all engines agree on each.

    Args:
        results: Finished rows of a study.
        engines: Names of engines; `all` stands for all that can simulate the rows on this machine.
        most: Largest number of rows. They are the first by `point_id`, which is as good as random, so that a larger
            number adds rows to those that are there.
        progress: Receives the rows of every finished batch.
        on_message: Receives a line on each engine that is left out.

    Raises:
        InputError: An engine is unknown or cannot simulate these rows, or there is no other engine.
    """
    exp = apply_stored_engine_settings(results)
    allowed, own = exp.system.engine_names, exp.settings.name
    is_every = engines == [EVERY_ENGINE]
    for name in () if is_every else engines:
        require_choice(name, (*allowed, EVERY_ENGINE), f"--engines {name}")
    others = [name for name in (allowed if is_every else dict.fromkeys(engines)) if name != own]
    if not others:
        raise InputError(f"--engines {','.join(engines)} is not allowed: the rows are by {own}; name another engine")
    chosen = results.rows.iloc[first_rows_by_point_id(results.rows["point_id"], most)]
    points = select_point_columns(chosen)
    path_inside_folder(results.folder, AUDIT_FOLDER).mkdir(exist_ok=True)
    outcomes = chosen.set_index("point_id")[["outcome"]].rename(columns={"outcome": own})
    for name in others:
        variant = AuditVariant(f"on {name}", lambda settings, name=name: exp.system.select_engine(settings, name))
        folder = engine_study_folder(results.folder, name)
        refusal = simulate_audit_variant(exp, variant, points, folder, progress)
        if refusal and not is_every:
            raise refusal
        if refusal:
            if on_message:
                on_message(f"audit: {name} is left out: {refusal}")
            continue
        outcomes[name] = read_outcomes_by_point(folder).reindex(outcomes.index)
    if outcomes.shape[1] < 2:
        raise InputError(f"no engine but {own} can simulate these rows")
    with store.lock_folder(results.folder):
        store.write_verdicts(results.folder, judge_agreement(outcomes))


def engine_study_folder(folder: Path, engine: str) -> Path:
    """Return the folder of the study that simulates audited rows on another engine.

    Args:
        folder: Folder of the audited study.
        engine: Name of the other engine.
    """
    return path_inside_folder(folder, f"{AUDIT_FOLDER}/{FOLDER_PREFIX}{engine}")


def read_outcomes_by_point(folder: Path) -> pd.Series:
    """Read the outcome of each row of a study, by `point_id`."""
    return store.read_rows(folder, ["point_id", "outcome"]).set_index("point_id")["outcome"]


def first_rows_by_point_id(ids: pd.Series, most: int) -> np.ndarray:
    """Return the positions of the rows whose point ids come first in alphabetical order.

    Args:
        ids: `point_id` of each row (n).
        most: Number of rows to take at most.

    Returns:
        Positions (m), increasing.
    """
    return np.sort(np.argsort(ids.to_numpy(dtype=str), kind="stable")[:most])


def judge_agreement(outcomes: pd.DataFrame) -> pd.Series:
    """Return whether all engines agree on each row.

    Args:
        outcomes: Outcome of each row (n, engines), by engine.

    Returns:
        `yes` where all are a success or all a failure, else `no`, (n,) with the index of `outcomes`.
    """
    first = outcomes.iloc[:, 0]
    agree = outcomes.eq(first, axis=0).all(axis=1) & (first != INVALID)
    return pd.Series(np.where(agree, YES, NO), outcomes.index, name=AGREE)


def read_engine_outcomes(results: Results) -> pd.DataFrame:
    """Return the outcomes of audited rows on each engine.

    Args:
        results: Finished rows of a study with the column `engines_agree`.

    Returns:
        The audited rows of the study, with a column `outcome on ENGINE` for each engine whose study has all of them.
    """
    audited = audited_rows(results)
    if audited.empty:
        return audited
    own = apply_stored_engine_settings(results).settings.name
    table = audited.assign(**{f"{OUTCOME_ON}{own}": audited["outcome"]})
    for name in results.exp.system.engine_names:
        folder = engine_study_folder(results.folder, name)
        if name == own or not path_inside_folder(folder, store.STUDY_FILE).exists():
            continue
        if not store.finished_batches(folder):
            continue
        again = read_outcomes_by_point(folder)
        if audited["point_id"].isin(again.index).all():
            table[f"{OUTCOME_ON}{name}"] = again.reindex(audited["point_id"]).to_numpy()
    return table


def audited_rows(results: Results) -> pd.DataFrame:
    """Return the rows of a study that were simulated on several engines; none if the study was not audited so."""
    return results.rows[results.rows[AGREE] != ""] if AGREE in results.rows else results.rows.iloc[:0]


def outcome_columns(outcomes: pd.DataFrame) -> list[str]:
    """Return the columns `outcome on ENGINE` of a table from `read_engine_outcomes`, or of one made from it."""
    return [name for name in map(str, outcomes) if name.startswith(OUTCOME_ON)]


def agreement_rate(results: Results) -> SuccessRate:
    """Return the share of audited rows on which all engines agree; with an interval only if rows are a random sample.

    Args:
        results: Finished rows of a study with the column `engines_agree`.
    """
    audited = audited_rows(results)
    agreed = audited.assign(outcome=np.where(audited[AGREE] == YES, SUCCESS, FAILURE))
    return pooled_success_rate(agreed, results.exp)


def engine_outcome_table(outcomes: pd.DataFrame) -> pd.DataFrame:
    """Count the combinations of outcomes on all engines, the most frequent first.

    Args:
        outcomes: Audited rows, from `read_engine_outcomes`.

    Returns:
        A row for each combination: the outcome on each engine, `rollouts`, and `engines_agree`.
    """
    columns = outcome_columns(outcomes)
    counted = outcomes.groupby([*columns, AGREE], observed=True).size().rename("rollouts").reset_index()
    return counted.sort_values("rollouts", ascending=False, ignore_index=True)[[*columns, "rollouts", AGREE]]


def disagreement_region(results: Results) -> pd.DataFrame:
    """Return the range along each numeric parameter of the rows on which engines do not agree.

    Args:
        results: Finished rows of a study with the column `engines_agree`.

    Returns:
        A row for each parameter (`axis`): `from` and `to` of these rows, and of all audited rows.
    """
    audited = audited_rows(results)
    disagreed = audited[audited[AGREE] == NO]
    lines = [
        (c, disagreed[c].min(), disagreed[c].max(), audited[c].min(), audited[c].max()) for c in results.numeric_columns
    ]
    return pd.DataFrame(lines if len(disagreed) else [], columns=["axis", "from", "to", "audited from", "audited to"])

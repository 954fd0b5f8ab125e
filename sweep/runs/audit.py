"""Audit of a study for `sweep audit`: simulate rollouts again in variants of the simulation and count changed outcomes.

Rollouts next to the boundary, and as many successes elsewhere, are simulated again in variants that should make no
difference, such as half the time step. Each variant is a study of its own in the folder's `audit/`, so it can be
interrupted, inspected and replayed like any other.
"""

from collections.abc import Iterator
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from sweep.analysis import compare
from sweep.config.experiment import Experiment, build_experiment
from sweep.contract.system import AuditVariant
from sweep.core.errors import InputError
from sweep.core.files import path_inside_folder
from sweep.runs import runner, store
from sweep.runs.results import Results
from sweep.study.study import Logger, parameter_columns, replace_settings

AUDIT_FOLDER = "audit"


def run_audit(
    results: Results,
    count: int,
    variants: list[str],
    progress: runner.ProgressCallback,
    on_message: Logger | None = None,
) -> None:
    """Simulate a sample of finished rollouts again in variants, such as half the time step, and store their rows.

    Args:
        results: Finished rows of a study.
        count: Largest number of rollouts of each sample, see `stratum_masks`.
        variants: Names of the variants to simulate. If empty, all variants of the system, without those that cannot
            simulate these rollouts.
        progress: Receives the rows of every finished batch.
        on_message: Receives a line on each variant that is left out.

    Raises:
        InputError: A variant is unknown or cannot simulate these rollouts, or there are no rollouts to audit.
    """
    available = results.exp.system.audit_variants
    for variant in variants:
        if variant not in available:
            raise InputError(f"--ways {variant} is unknown (allowed: {', '.join(available)})")
    exp = apply_stored_engine_settings(results)
    shuffled = [np.random.default_rng(0).permutation(np.flatnonzero(mask)) for mask in stratum_masks(results).values()]
    chosen = np.concatenate([rows[:count] for rows in shuffled])
    if not len(chosen):
        raise InputError(
            f"{results.folder} has nothing to audit: no neighbouring points have different outcomes, and none succeeds"
        )
    points = select_point_columns(results.rows.iloc[np.sort(chosen)])
    folder = path_inside_folder(results.folder, AUDIT_FOLDER)
    folder.mkdir(exist_ok=True)
    for name in variants or available:
        refusal = simulate_audit_variant(exp, available[name], points, path_inside_folder(folder, name), progress)
        if refusal and variants:
            raise refusal
        if refusal and on_message:
            on_message(f"audit: {name} is left out: {refusal}")


def simulate_audit_variant(
    exp: Experiment, variant: AuditVariant, points: pd.DataFrame, folder: Path, progress: runner.ProgressCallback
) -> InputError | None:
    """Simulate points again in a variant, as far as the variant's folder lacks them.

    Args:
        exp: Experiment of the rows, with their engine settings.
        variant: What differs.
        points: Points, from `select_point_columns`.
        folder: Folder of the variant's study.
        progress: Receives the rows of every finished batch.

    Returns:
        Why the variant cannot simulate these points, which some engines find only when they compile; else None.
    """
    try:
        study, table = make_variant_study(exp, variant, points, folder)
    except InputError as refusal:
        return refusal
    with store.lock_folder(folder):
        runner.repair_folder(study, folder)
        try:
            runner.run_job(runner.prepare_job(study, folder, table), progress)
        except InputError as refusal:
            return refusal
    return None


def select_point_columns(rows: pd.DataFrame) -> pd.DataFrame:
    """Return the points of finished rows: parameters, except those of the engine, and what identifies a rollout."""
    parameters = [c for c in rows if "." in str(c) and not str(c).startswith("engine.")]
    return rows[[*parameters, "replicate", "stream", "point_id"]].reset_index(drop=True)


def make_variant_study(
    exp: Experiment, variant: AuditVariant, points: pd.DataFrame, folder: Path
) -> tuple[Experiment, pd.DataFrame]:
    """Make the study that simulates points again in a variant.

    Args:
        exp: Experiment of the rows, with their engine settings.
        variant: What differs.
        points: Points, from `select_point_columns`.
        folder: Folder of the new study.

    Returns:
        The study, and its points.

    Raises:
        InputError: The variant cannot simulate these points.
    """
    settings = replace(variant.change(exp.settings), width=0)  # the engine chooses a width for the few rollouts
    changed = {}
    for path, change in variant.columns.items():
        column = f"world.{path}" if f"world.{path}" in points else path
        values = (
            points[column]
            if column in points
            else pd.Series(exp.system.nominal_parameter_value(path, settings), points.index)
        )
        changed[column] = values.map(change)
    study = {**exp.values["study"], "keep": []}
    variant_exp = build_experiment({**exp.values, "study": study, "engine": asdict(settings), "out": str(folder)})
    table = points.assign(**changed)
    variant_exp.system.check(table, settings)
    return variant_exp, table


def apply_stored_engine_settings(results: Results) -> Experiment:
    """Return the experiment of a study with the engine settings of its stored rows.

    Raises:
        InputError: Rows differ in their engine settings.
    """
    engine = [c for c in parameter_columns(results.rows) if c.startswith("engine.")]
    for column in engine:
        if results.rows[column].nunique() > 1:
            raise InputError(f"{column} differs between rows: choose some with --where '{column} == ...'")
    values: dict[str, Any] = {c: results.rows[c].iloc[0] for c in engine}
    return replace(results.exp, settings=replace_settings(results.exp.settings, values))


def stratum_masks(results: Results) -> dict[str, np.ndarray]:
    """Return the masks (rows,) that an audit samples from: rows next to the boundary of success, other successes."""
    near, succeeds = boundary_mask(results), (results.rows["outcome"] == "success").to_numpy()
    return {"next to the boundary": near, "successes elsewhere": succeeds & ~near}


def boundary_mask(results: Results) -> np.ndarray:
    """Return the mask of rows that have a neighbour in parameter space with the opposite outcome (success or failure).

    The neighbours of a row are the 2 d nearest rows along d numeric parameters, among valid rows with the same
    categorical values and replicate. On a grid these are the adjacent points.

    Args:
        results: Finished rows of a study.

    Returns:
        Mask (rows,), False everywhere where no numeric parameter varies.
    """
    from scipy.spatial import KDTree

    rows, axes = results.rows, results.numeric_columns
    near = np.zeros(len(rows), dtype=bool)
    if not axes:
        return near
    replicate = rows["replicate"] % results.exp.study.replicates
    valid = (rows["outcome"] != "invalid").to_numpy()
    ranks = rows[axes].rank(method="dense")
    # drawn points instead of a grid: scale the ranks so that all parameters count alike
    if np.prod(ranks.max().to_numpy()) > 2 * len(rows):
        ranks = ranks / ranks.max() * len(rows) ** (1 / len(axes))
    for _, index in rows[valid].groupby([*results.categorical_columns, replicate[valid]]).indices.items():
        members = np.flatnonzero(valid)[index]
        if len(members) > 1:
            succeeds = (rows["outcome"].iloc[members] == "success").to_numpy()
            positions = ranks.iloc[members].to_numpy()
            _, nearest = KDTree(positions).query(positions, k=min(2 * len(axes) + 1, len(members)))
            near[members] = (succeeds[nearest] != succeeds[:, None]).any(axis=1)
    return near


def iter_audited_variants(results: Results) -> Iterator[tuple[str, pd.DataFrame]]:
    """Yield each variant of an audit's simulation, with a table that pairs stored rollouts with those simulated again.

    The table is that of `compare.pair_rows`, paired by `point_id`.
    """
    folder = path_inside_folder(results.folder, AUDIT_FOLDER)
    for variant in results.exp.system.audit_variants:
        if path_inside_folder(folder, f"{variant}/{store.STUDY_FILE}").exists() and store.finished_batches(
            folder / variant
        ):
            audited = store.read_rows(folder / variant)
            before = results.rows[results.rows["point_id"].isin(audited["point_id"])]
            if before.empty:  # `where` chose none of the audited rows
                continue
            yield variant, compare.pair_rows(before, audited, ["point_id"])


def outcome_flip_table(results: Results) -> pd.DataFrame:
    """Count the outcomes that changed between success and failure, for each variant and sample of an audit.

    Args:
        results: Finished rows of a study, with an audit in its folder.

    Returns:
        A row for each variant (`simulated`) and sample (`drawn`, out of `of` rows): audited `rollouts`, those `invalid`
        in either simulation, `flips` among the others, their `share` and its exact 95 % interval `low` to `high`.
    """
    lines, audited = [], dict(iter_audited_variants(results))
    masks = stratum_masks(results) if audited else {}  # which takes a minute of a million rows
    members = {kind: set(results.rows.loc[member, "point_id"]) for kind, member in masks.items()}
    for variant, pairs in audited.items():
        for kind, points in members.items():
            sample = pairs[pairs["point_id"].isin(points)]
            if sample.empty:
                continue
            flips = compare.count_flips(sample, np.arange(len(sample)))  # rows were drawn at random
            share = flips.flip_count / flips.tested_pairs if flips.tested_pairs else np.nan
            counts = len(points), flips.pairs, flips.pairs - flips.tested_pairs, flips.flip_count
            description = results.exp.system.audit_variants[variant].description
            lines.append((description, kind, *counts, share, flips.low, flips.high))
    columns = ["simulated", "drawn", "of", "rollouts", "invalid", "flips", "share", "low", "high"]
    return pd.DataFrame(lines, columns=columns)

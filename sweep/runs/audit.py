"""`sweep audit`: do the boundary of success, and success away from it, belong to the robot or to the simulation?

Rollouts next to the boundary, and as many successes elsewhere, are simulated again in other ways that should make no
difference. Each way is a study of its own in the folder's `audit/`, so it can be interrupted, looked at and replayed
like any other.
"""

from collections.abc import Iterator
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from sweep.analysis import compare
from sweep.core.errors import InputError
from sweep.core.files import path_in
from sweep.runs import runner, store
from sweep.runs.results import Results
from sweep.study.config import Experiment, experiment
from sweep.study.study import Logger, parameter_columns, replace_settings
from sweep.systems.base import AuditVariant

AUDIT = "audit"


def run(
    results: Results, count: int, variants: list[str], progress: runner.Progress, say: Logger | None = None
) -> None:
    """Simulate rollouts again in all `ways`, up to `number` of each of the `samples`. Raises `InputError`.

    Without any in all that there are; those in which they cannot be simulated are then left out, and `say` is told why.
    """
    known = results.exp.system.audit_variants
    for way in variants:
        if way not in known:
            raise InputError(f"--ways {way} is unknown (allowed: {', '.join(known)})")
    exp = with_row_settings(results)
    shuffled = [np.random.default_rng(0).permutation(np.flatnonzero(one)) for one in sample_masks(results).values()]
    chosen = np.concatenate([one[:count] for one in shuffled])
    if not len(chosen):
        raise InputError(f"{results.folder} has nothing to audit: no two neighbouring points differ, and none succeeds")
    points = results.rows.iloc[np.sort(chosen)]
    kept = [c for c in points if "." in str(c) and not str(c).startswith("engine.")]
    points = points[[*kept, "replicate", "stream", "point_id"]].reset_index(drop=True)
    folder = path_in(results.folder, AUDIT)
    folder.mkdir(exist_ok=True)
    for name in variants or known:
        try:
            again, table = _again(exp, known[name], points, path_in(folder, name))
        except InputError as error:
            if variants:
                raise
            if say:
                say(f"audit: {name} is left out: {error}")
            continue
        with store.lock_folder(again.folder):
            runner.repair_folder(again, again.folder)
            runner.run(runner.prepare_job(again, again.folder, table), progress)


def _again(exp: Experiment, way: AuditVariant, points: pd.DataFrame, folder: Path) -> tuple[Experiment, pd.DataFrame]:
    """The study in another way, and its points. Raises `InputError` where they cannot be simulated in it."""
    settings = replace(way.change(exp.settings), width=0)  # so few rollouts have a width of their own
    changed = {}
    for path, change in way.columns.items():
        column = f"world.{path}" if f"world.{path}" in points else path
        values = points[column] if column in points else pd.Series(exp.system.nominal(path, settings), points.index)
        changed[column] = values.map(change)
    study = {**exp.values["study"], "keep": []}
    again = experiment({**exp.values, "study": study, "engine": asdict(settings), "out": str(folder)})
    table = points.assign(**changed)
    again.system.check(table, settings)
    return again, table


def with_row_settings(results: Results) -> Experiment:
    """The study's experiment with the engine settings of all its rows. Raises `InputError` where they differ."""
    engine = [c for c in parameter_columns(results.rows) if c.startswith("engine.")]
    for column in engine:
        if results.rows[column].nunique() > 1:
            raise InputError(f"{column} differs between rows: choose some with --where '{column} == ...'")
    values: dict[str, Any] = {c: results.rows[c].iloc[0] for c in engine}
    return replace(results.exp, settings=replace_settings(results.exp.settings, values))


def sample_masks(results: Results) -> dict[str, np.ndarray]:
    """Which rows may be drawn, by the words for them: those next to the boundary, and successes elsewhere."""
    near, wins = boundary_mask(results), (results.rows["outcome"] == "success").to_numpy()
    return {"next to the boundary": near, "successes elsewhere": wins & ~near}


def boundary_mask(results: Results) -> np.ndarray:
    """Which rows succeed while a neighbour fails, or the other way round.

    The neighbours of a row are the 2 d nearest ones along d parameters, among valid rows of equal names and replicate:
    on a grid those next to it.
    """
    from scipy.spatial import KDTree

    rows, axes = results.rows, results.numeric
    near = np.zeros(len(rows), dtype=bool)
    if not axes:
        return near
    again = rows["replicate"] % results.exp.study.replicates
    valid = (rows["outcome"] != "invalid").to_numpy()
    place = rows[axes].rank(method="dense")
    if np.prod(place.max().to_numpy()) > 2 * len(
        rows
    ):  # drawn points, not a grid: no parameter counts for more than another
        place = place / place.max() * len(rows) ** (1 / len(axes))
    for _, index in rows[valid].groupby([*results.categorical, again[valid]]).indices.items():
        own = np.flatnonzero(valid)[index]
        if len(own) > 1:
            win = (rows["outcome"].iloc[own] == "success").to_numpy()
            at = place.iloc[own].to_numpy()
            _, nearest = KDTree(at).query(at, k=min(2 * len(axes) + 1, len(own)))
            near[own] = (win[nearest] != win[:, None]).any(axis=1)
    return near


def iter_audited_variants(results: Results) -> Iterator[tuple[str, pd.DataFrame]]:
    """The ways that `results` were audited in, with the pairs of rollouts before and again."""
    folder = path_in(results.folder, AUDIT)
    for way in results.exp.system.audit_variants:
        if path_in(folder, f"{way}/{store.STUDY}").exists() and store.finished_batches(folder / way):
            again = store.read_rows(folder / way)
            before = results.rows[results.rows["point_id"].isin(again["point_id"])]
            if before.empty:  # other rows were chosen than those that were audited
                continue
            yield way, compare.pair_rows(before, again, ["point_id"])


def flip_table(results: Results) -> pd.DataFrame:
    """Flips in each way among each sample, with the exact 95 % interval of their share."""
    lines = []
    members = {kind: set(results.rows.loc[member, "point_id"]) for kind, member in sample_masks(results).items()}
    for way, pairs in iter_audited_variants(results):
        for kind, points in members.items():
            of_kind = pairs[pairs["point_id"].isin(points)]
            if of_kind.empty:
                continue
            found = compare.count_flips(of_kind, np.arange(len(of_kind)))  # rows were drawn at random
            share = found.flip_count / found.tested_pairs if found.tested_pairs else np.nan
            counts = len(points), found.pairs, found.pairs - found.tested_pairs, found.flip_count
            words = results.exp.system.audit_variants[way].description
            lines.append((words, kind, *counts, share, found.low, found.high))
    columns = ["simulated", "drawn", "of", "rollouts", "invalid", "flips", "share", "low", "high"]
    return pd.DataFrame(lines, columns=columns)

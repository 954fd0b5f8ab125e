"""`sweep audit`: does the boundary of success belong to the robot or to the simulation?

Rollouts next to the boundary are simulated again in other ways that should make no difference. Each way is a study of
its own in the folder's `audit/`, so it can be interrupted, looked at and replayed like any other.
"""

from collections.abc import Callable, Iterator
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import yaml

from sweep.analysis import compare
from sweep.analysis.results import Results
from sweep.core.errors import InputError
from sweep.core.files import write_whole
from sweep.engines.settings import EngineSettings
from sweep.runs import runner, store
from sweep.study.config import Experiment, experiment
from sweep.study.study import parameter_columns, with_settings

AUDIT, ABOUT = "audit", "about.yaml"
WAYS: dict[str, tuple[str, Callable[[EngineSettings], EngineSettings]]] = {
    "again": ("as before, in batches of another width", lambda s: s),
    "half_step": (
        "half the time step",
        lambda s: replace(s, time_step=s.time_step / 2, native_time_step=s.native_time_step / 2),
    ),
    "float64": ("in double precision", lambda s: replace(s, precision="float64")),
    "other_engine": ("on the other engine", lambda s: replace(s, name="native" if s.name == "mjx" else "mjx")),
}


def run(results: Results, number: int, ways: list[str], progress: runner.Progress) -> None:
    """Simulate `number` rollouts next to the boundary again, each in all `ways`. Raises `InputError`."""
    for way in ways:
        if way not in WAYS:
            raise InputError(f"--ways {way} is unknown (allowed: {', '.join(WAYS)})")
    one = one_engine(results)
    near = np.flatnonzero(boundary(results))
    if not len(near):
        raise InputError(f"{results.folder} has no boundary: no two neighbouring points differ in success")
    chosen = np.random.default_rng(0).permutation(near)[:number]
    points = results.rows.iloc[np.sort(chosen)]
    kept = [c for c in points if "." in str(c) and not str(c).startswith("engine.")]
    points = points[[*kept, "replicate", "stream", "point_id"]].reset_index(drop=True)
    folder = results.folder / AUDIT
    folder.mkdir(exist_ok=True)
    about = {"where": results.where, "boundary": len(near), "chosen": len(points)}
    write_whole(folder / ABOUT, yaml.safe_dump(about).encode())
    for way in ways:
        settings = replace(WAYS[way][1](one.settings), width=0)  # so few rollouts have a width of their own
        values = {**one.values, "engine": asdict(settings), "out": str(folder / way)}
        exp = experiment(values)
        with store.locked(folder / way):
            runner.mend(exp, folder / way)
            runner.run(runner.lay_out(exp, folder / way, points), progress)


def one_engine(results: Results) -> Experiment:
    """The study's experiment with the engine settings of all its rows. Raises `InputError` where they differ."""
    engine = [c for c in parameter_columns(results.rows) if c.startswith("engine.")]
    for column in engine:
        if results.rows[column].nunique() > 1:
            raise InputError(f"{column} differs between rows: choose some with --where '{column} == ...'")
    values: dict[str, Any] = {c: results.rows[c].iloc[0] for c in engine}
    return replace(results.exp, settings=with_settings(results.exp.settings, values))


def boundary(results: Results) -> np.ndarray:
    """Which rows succeed while a neighbour fails, or the other way round.

    The neighbours of a row are the 2 d nearest ones along d parameters, among valid rows of equal names and replicate:
    on a grid those next to it.
    """
    from scipy.spatial import KDTree

    rows, axes = results.rows, results.numeric
    if not axes:
        raise InputError(f"{results.folder} has no boundary: no number is varied")
    near = np.zeros(len(rows), dtype=bool)
    again = rows["replicate"] % results.exp.study.replicates
    valid = (rows["outcome"] != "invalid").to_numpy()
    place = rows[axes].rank(method="dense")
    if np.prod(place.max().to_numpy()) > 2 * len(
        rows
    ):  # drawn points, not a grid: no parameter counts for more than another
        place = place / place.max() * len(rows) ** (1 / len(axes))
    for _, index in rows[valid].groupby([*results.named, again[valid]]).indices.items():
        own = np.flatnonzero(valid)[index]
        if len(own) > 1:
            win = (rows["outcome"].iloc[own] == "success").to_numpy()
            at = place.iloc[own].to_numpy()
            _, nearest = KDTree(at).query(at, k=min(2 * len(axes) + 1, len(own)))
            near[own] = (win[nearest] != win[:, None]).any(axis=1)
    return near


def done(results: Results) -> Iterator[tuple[str, pd.DataFrame]]:
    """The ways that `results` were audited in, with the pairs of rollouts before and again."""
    folder = results.folder / AUDIT
    for way in WAYS:
        if (folder / way / store.STUDY).exists() and store.finished(folder / way):
            again = store.read_rows(folder / way)
            before = results.rows[results.rows["point_id"].isin(again["point_id"])]
            if before.empty:  # other rows were chosen than those that were audited
                continue
            yield way, compare.pair(before, again, ["point_id"])


def about(folder: Path) -> dict[str, Any]:
    """How the points of an audit were chosen; empty where there is none."""
    path = folder / AUDIT / ABOUT
    return yaml.safe_load(path.read_text()) if path.exists() else {}


def table(results: Results) -> pd.DataFrame:
    """Flips in each way, with the exact 95 % interval of their share of the boundary's points."""
    lines = []
    for way, pairs in done(results):
        found = compare.flips(pairs)
        low, high = found.interval()
        lines.append((WAYS[way][0], found.pairs, found.pairs - found.tested, found.flipped,
                      found.flipped / found.tested if found.tested else np.nan, low, high))  # fmt: skip
    return pd.DataFrame(lines, columns=["simulated", "rollouts", "invalid", "flips", "share", "low", "high"])

"""A study's folder: what it is, its points, one file per finished batch. Every file appears whole or not at all."""

import os
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import filelock
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import yaml

from sweep.parameters import InputError

STUDY, POINTS, PARTS, LOG = "study.yaml", "points.parquet", "parts", "log.txt"
# a row: its axes (dotted names), its place in the plan, its figures, how they are judged, and what differs between runs
PLAN = ("replicate", "stream", "point_id", "group", "batch", "slot", "width", "run_id")
LABELS = ("outcome", "cause", "stage", "t_cause_s")
TIMING = ("wall_s",)


@contextmanager
def locked(folder: Path) -> Iterator[None]:
    """Hold `folder` for this process, making it where missing. Raises `InputError` where another process has it."""
    (folder / PARTS).mkdir(parents=True, exist_ok=True)
    try:
        with filelock.FileLock(folder / ".lock", timeout=0):
            yield
    except filelock.Timeout:
        raise InputError(f"{folder} is in use by another sweep process") from None


def _write(path: Path, write: Callable[[Path], object]) -> None:
    """`write` into a hidden file, then put it in its place at once."""
    hidden = path.parent / f".{path.name}.tmp"
    write(hidden)
    os.replace(hidden, path)


def write_study(folder: Path, content: Mapping[str, Any]) -> None:
    """What the folder holds: configuration, versions, device."""
    text = yaml.safe_dump(dict(content), sort_keys=False, allow_unicode=True)
    _write(folder / STUDY, lambda p: p.write_text(text))


def read_study(folder: Path) -> dict[str, Any]:
    """Content of study.yaml. Raises `InputError` where `folder` is not a study's."""
    try:
        return yaml.safe_load((folder / STUDY).read_text())
    except OSError:
        raise InputError(f"{folder} is not a folder of results: it has no {STUDY}") from None


def write_points(folder: Path, points: pd.DataFrame) -> None:
    """The plan: one row per rollout, with its group, batch and slot."""
    _write(folder / POINTS, lambda p: _to_parquet(points, p))


def read_points(folder: Path) -> pd.DataFrame:
    """The plan, empty where nothing is planned yet."""
    path = folder / POINTS
    return pd.read_parquet(path) if path.exists() else pd.DataFrame()


def _to_parquet(frame: pd.DataFrame, path: Path) -> None:
    pq.write_table(pa.Table.from_pandas(frame, preserve_index=False), path, compression="zstd")


def write_part(folder: Path, batch: int, rows: pd.DataFrame) -> None:
    """The finished rows of one batch."""
    _write(folder / PARTS / f"part-{batch:06d}.parquet", lambda p: _to_parquet(rows, p))


def finished(folder: Path) -> set[int]:
    """Numbers of the batches that are on disk."""
    return {int(p.stem.removeprefix("part-")) for p in (folder / PARTS).glob("part-*.parquet")}


def read_part(folder: Path, batch: int) -> pd.DataFrame:
    """The rows of one finished batch."""
    return pd.read_parquet(folder / PARTS / f"part-{batch:06d}.parquet")


def read_rows(folder: Path) -> pd.DataFrame:
    """All finished rows, in the order of their batches. Raises `InputError` where there are none."""
    read_study(folder)
    batches = sorted(finished(folder))
    if not batches:
        raise InputError(f"{folder} has no finished rollouts yet")
    return pd.concat([read_part(folder, batch) for batch in batches], ignore_index=True)


def figure_columns(rows: pd.DataFrame) -> list[str]:
    """What was measured: all but the axes, the plan, the labels and the timing."""
    return [c for c in rows.columns if "." not in c and c not in (*PLAN, *LABELS, *TIMING)]


def find_row(rows: pd.DataFrame, point: str, folder: Path) -> pd.Series:
    """The row named by its number or by the beginning of its point id. Raises `InputError`."""
    if point.isdecimal() and int(point) < len(rows):
        return rows.iloc[int(point)]
    found = rows[rows["point_id"].str.startswith(point)]
    if len(found) != 1:
        problem = "is not a point" if found.empty else f"means {len(found)} points"
        raise InputError(f"{point} {problem} of {folder}: give a row from 0 to {len(rows) - 1} or a point_id")
    return found.iloc[0]


def log(folder: Path, message: str) -> None:
    """Append one dated line to the log."""
    with (folder / LOG).open("a") as file:
        file.write(f"{time.strftime('%Y-%m-%dT%H:%M:%S%z')} {message}\n")

"""A study's folder: what it is, its points, one file per finished batch. Every file appears whole or not at all."""

import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import filelock
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import yaml

from sweep.core.errors import Fault, InputError
from sweep.core.files import reason, write_whole

pa.set_memory_pool(pa.system_memory_pool())  # a million rows are read in 2 s of a processor; in 8 s by Arrow's own pool
STUDY, POINTS, PARTS, LOG = "study.yaml", "points.parquet", "parts", "log.txt"


@contextmanager
def locked(folder: Path) -> Iterator[None]:
    """Hold `folder` for this process, making it where missing and clearing what a killed one left half-written.

    Raises `InputError` where it cannot be written or another process has it.
    """
    held = filelock.FileLock(folder / ".lock", timeout=0)
    try:
        (folder / PARTS).mkdir(parents=True, exist_ok=True)
        held.acquire()
        for left in (*folder.glob(".*.tmp"), *(folder / PARTS).glob(".*.tmp")):
            left.unlink(missing_ok=True)
    except filelock.Timeout:
        raise InputError(f"{folder} is in use by another sweep process: wait for it, or give out=DIR") from None
    except OSError as error:
        raise InputError(f"out = {folder} cannot be written: {reason(error)}") from None
    try:
        yield
    finally:
        held.release()


def write_study(folder: Path, content: Mapping[str, Any]) -> None:
    """What the folder holds: configuration, versions, device."""
    text = yaml.safe_dump(dict(content), sort_keys=False, allow_unicode=True)
    write_whole(folder / STUDY, lambda p: p.write_text(text))


def read_study(folder: Path) -> dict[str, Any]:
    """Content of study.yaml. Raises `InputError` where `folder` is not a study's."""
    try:
        content = yaml.safe_load((folder / STUDY).read_bytes())
    except (FileNotFoundError, NotADirectoryError):
        raise InputError(f"{folder} is not a folder of results: it has no {STUDY}") from None
    except (OSError, yaml.YAMLError):
        content = None
    if not isinstance(content, dict):
        raise InputError(f"{folder / STUDY} is damaged: restore it, or give out=DIR; the parts can be read without it")
    return content


def write_points(folder: Path, points: pd.DataFrame) -> None:
    """The plan: one row per rollout, with its group, batch and slot."""
    write_whole(folder / POINTS, lambda p: _to_parquet(points, p))


def read_points(folder: Path) -> pd.DataFrame:
    """The plan, empty where nothing is planned yet. Raises `InputError`."""
    path = folder / POINTS
    return _from_parquet(path, "restore it, or give out=DIR").to_pandas() if path.exists() else pd.DataFrame()


def _to_parquet(frame: pd.DataFrame, path: Path) -> None:
    table = pa.Table.from_pandas(frame, preserve_index=False)
    pq.write_table(table, path, compression="zstd", write_page_checksum=True)


def _from_parquet(path: Path, remedy: str) -> pa.Table:
    try:
        return pq.ParquetFile(path, page_checksum_verification=True).read()
    except (OSError, pa.ArrowException) as error:
        raise InputError(f"{path} is damaged ({str(error).splitlines()[0]}): {remedy}") from None


def part(folder: Path, batch: int) -> Path:
    """The file of one batch."""
    return folder / PARTS / f"part-{batch:06d}.parquet"


def write_part(folder: Path, batch: int, rows: pd.DataFrame) -> None:
    """The finished rows of one batch."""
    write_whole(part(folder, batch), lambda p: _to_parquet(rows, p))


def finished(folder: Path) -> set[int]:
    """Numbers of the batches that are on disk."""
    return {int(p.stem.removeprefix("part-")) for p in (folder / PARTS).glob("part-*.parquet")}


def read_part(folder: Path, batch: int) -> pd.DataFrame:
    """The rows of one finished batch. Raises `InputError` where its file is damaged."""
    return _part_table(folder, batch).to_pandas()


def _part_table(folder: Path, batch: int) -> pa.Table:
    return _from_parquet(part(folder, batch), "`sweep run` as before simulates it again")


def discard_damaged(folder: Path) -> list[str]:
    """Remove the parts that cannot be read; a line for each. Raises `InputError` where one is not of this plan."""
    planned = read_points(folder)
    ids = {batch: rows.tolist() for batch, rows in planned.groupby("batch")["point_id"]} if len(planned) else {}
    lines = []
    for batch in sorted(finished(folder)):
        try:
            found = read_part(folder, batch)
        except InputError as error:
            part(folder, batch).unlink()
            lines.append(str(error))
            continue
        if "point_id" not in found or found["point_id"].tolist() != ids.get(batch):
            raise InputError(
                f"{part(folder, batch)} holds other points than {POINTS} plans: move it away, or give out=DIR"
            )
    return lines


def read_rows(folder: Path) -> pd.DataFrame:
    """All finished rows, in the order of their batches. Raises `InputError` where there are none."""
    read_study(folder)
    batches = sorted(finished(folder))
    if not batches:
        raise InputError(f"{folder} has no finished rollouts yet")
    # into pandas once, column by column: a million rows take seconds and little more memory than they need
    table = pa.concat_tables([_part_table(folder, batch) for batch in batches], promote_options="permissive")
    return table.to_pandas(split_blocks=True, self_destruct=True)


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
    """Append one dated line to the log. Raises `Fault`."""
    try:
        with (folder / LOG).open("a") as file:
            file.write(f"{time.strftime('%Y-%m-%dT%H:%M:%S%z')} {message}\n")
    except OSError as error:
        raise Fault(f"{folder / LOG} cannot be written: {reason(error)}") from None

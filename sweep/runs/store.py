"""Files of a study's folder: description, points, finished rows, log. Every file is written whole or not at all.

The manifest says which files count, see `manifest`.
"""

import contextlib
import json
import os
import time
from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import filelock
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import yaml

from sweep.core import files, project
from sweep.core.errors import Fault, InputError
from sweep.core.files import path_in
from sweep.core.yaml_check import check_yaml
from sweep.runs import manifest
from sweep.runs.manifest import PARTS, POINTS, SUBFOLDERS, Entry
from sweep.runs.plan_check import plan_differences

# reads a million rows in 2 s of CPU time; Arrow's own pool takes 8 s
pa.set_memory_pool(pa.system_memory_pool())
STUDY, LOG, LOCK = "study.yaml", "log.txt", ".lock"
HISTORIES, LAST_STATES = manifest.HISTORIES, manifest.LAST_STATES
FORMAT = 2  # of the folder
CHECK = "# sha256 of the lines above: "
METADATA_KEY = b"sweep"  # of the Parquet metadata with a part's study, thresholds and batches


class DamagedFile(InputError):
    """A file is lost or has changed since it was written; `sweep run` repairs it."""


def refuse_foreign_folder(folder: Path) -> None:
    """Raise `InputError` where `folder` holds files but no results."""
    try:
        names = sorted(path.name for path in folder.iterdir() if not path.name.startswith("."))
    except FileNotFoundError:
        return
    except OSError as error:
        raise InputError(f"out = {folder} cannot be written: {files.os_error_text(error)}") from None
    if names and PARTS not in names:
        raise InputError(f"out = {folder} holds {names[0]} and no results: give a new folder, or an empty one")


@contextlib.contextmanager
def lock_folder(folder: Path) -> Iterator[None]:
    """Lock a study's folder for this process; create it if missing and delete what a killed process left half-written.

    Raises:
        InputError: The folder cannot be written, or another process holds its lock.
    """
    lock = filelock.FileLock(path_in(folder, LOCK), timeout=0)
    subfolders = [path_in(folder, name) for name in SUBFOLDERS]
    try:
        path_in(folder, PARTS).mkdir(parents=True, exist_ok=True)
        lock.acquire()
        for directory in (folder, *subfolders):
            for unfinished in directory.glob(f"{files.HIDDEN}*"):
                unfinished.unlink(missing_ok=True)
    except filelock.Timeout:
        raise InputError(f"{folder} is in use by another sweep process: wait for it, or give out=DIR") from None
    except OSError as error:
        raise InputError(f"out = {folder} cannot be written: {files.os_error_text(error)}") from None
    try:
        yield
    finally:
        lock.release()


def write_study(folder: Path, content: Mapping[str, Any]) -> None:
    """Write `study.yaml`: configuration, versions, devices. Raises `Fault` if the disk refuses it."""
    text = yaml.safe_dump({"format": FORMAT, **content}, sort_keys=False, allow_unicode=True)
    files.write_atomically(path_in(folder, STUDY), f"{text}{CHECK}{files.digest(text.encode())}\n".encode())


def read_study(folder: Path) -> dict[str, Any]:
    """Return the content of `study.yaml`.

    Raises:
        DamagedFile: The folder is not a study's, or the file has changed.
        InputError: The folder has another format.
    """
    path = path_in(folder, STUDY)
    damaged = DamagedFile(f"{path} is damaged: `sweep run` as before mends it")
    try:
        text, check, given = path.read_bytes().rpartition(CHECK.encode())
        if check and given != f"{files.digest(text)}\n".encode():
            raise damaged
        body = (text if check else given).decode()
        check_yaml(body, str(path), numbers=False)  # a dump has no ambiguous numbers
        content = yaml.load(body, project.LOADER)
    except (FileNotFoundError, NotADirectoryError):
        raise DamagedFile(f"{folder} is not a folder of results: it has no {STUDY}") from None
    except InputError:
        raise
    except (OSError, ValueError, RecursionError, yaml.YAMLError):
        raise damaged from None
    if isinstance(content, dict) and not check and "labelled" in content:
        content = {"format": 1, **content}
    elif not isinstance(content, dict) or not check:
        raise damaged
    if content["format"] != FORMAT:
        by = f"format {content['format']}, of version {content.get('commit') or content.get('code')}"
        raise InputError(f"{folder} has {by}; this one reads {FORMAT}: give out=DIR")
    return content


def digest(values: Any) -> str:
    """Return a digest of plain values, 16 hexadecimal digits."""
    return files.digest(json.dumps(values, sort_keys=True).encode())[:16]


def write_points(folder: Path, points: pd.DataFrame) -> None:
    """Write the plan of a folder: all points with group, batch and slot. Raises `Fault` if the disk refuses it."""
    content = _to_parquet(pa.Table.from_pandas(points, preserve_index=False), {})
    entry = Entry(POINTS, len(content), files.digest(content))
    # listed before it is written: any listed plan counts as sound, so a kill in between does no harm
    if entry not in manifest.read(folder):
        manifest.add(folder, entry)
    files.write_atomically(path_in(folder, POINTS), content)


def read_points(folder: Path) -> pd.DataFrame:
    """Return the plan of a folder: all points with group, batch and slot; empty where nothing is planned yet.

    Raises:
        DamagedFile: The file has changed since it was listed.
    """
    path = path_in(folder, POINTS)
    if not path.exists():
        return pd.DataFrame()
    content = read_buffer(path)
    if not any(entry.file == POINTS and not entry.find_problem(content) for entry in manifest.read(folder)):
        raise DamagedFile(f"{path} is damaged: `sweep run` as before mends it")
    return parse_parquet(path, content).to_pandas()


def parse_parquet(path: Path, content: pa.Buffer, columns: list[str] | None = None) -> pa.Table:
    """Parse the content of a Parquet file.

    Args:
        path: Path of the file, for the message.
        content: The bytes of the file.
        columns: Names of the columns to read; None for all.

    Raises:
        InputError: The content is not a Parquet file, or lacks a column.
    """
    try:
        return pq.read_table(content, columns=columns)
    except (pa.ArrowException, OSError, KeyError) as error:
        raise InputError(f"{path} is no table that can be read: {str(error).splitlines()[0]}") from None


def read_buffer(path: Path) -> pa.Buffer:
    """Return the bytes of a file in a buffer that Arrow owns. Raises `OSError`.

    Were Python the owner, a thread of Arrow could release them while the interpreter shuts down, which then aborts.
    """
    with pa.OSFile(os.fsencode(path)) as file:
        return file.read_buffer()


def _to_parquet(table: pa.Table, about: Mapping[str, Any]) -> bytes:
    table = table.replace_schema_metadata({**(table.schema.metadata or {}), METADATA_KEY: json.dumps(about).encode()})
    sink = pa.BufferOutputStream()
    pq.write_table(table, sink, compression="zstd")
    return sink.getvalue().to_pybytes()


def write_part(folder: Path, rows: pd.DataFrame, study: str, labels: str) -> Entry:
    """Write finished rows of one or more batches to a part, which counts once it is listed in the manifest.

    Args:
        folder: Folder of the study.
        rows: The finished rows.
        study: Digest of the study, see `runner.study_id`.
        labels: Digest of the thresholds that judged the rows, see `runner.labels_id`.

    Returns:
        Its entry for `manifest.add`.

    Raises:
        Fault: The disk refuses the write.
    """
    return write_table(folder, pa.Table.from_pandas(rows, preserve_index=False), study, labels)


def write_table(folder: Path, table: pa.Table, study: str, labels: str) -> Entry:
    """Write an Arrow table of finished rows to a part; see `write_part`."""
    batches, ids = (tuple(sorted(table[name].unique().to_pylist())) for name in ("batch", "run_id"))
    return _write_listed(folder, f"{PARTS}/part-{batches[0]:06d}", table, Entry("", 0, "", batches, study, labels, ids))


def write_recording(folder: Path, name: str, rows: pd.DataFrame, study: str) -> Entry:
    """Write a file that goes with the parts, such as time histories; it counts once it is listed in the manifest.

    Args:
        folder: Folder of the study.
        name: Path below `folder`, to which a digest and the suffix are added.
        rows: Content.
        study: Digest of the study.

    Returns:
        Its entry for `manifest.add`.

    Raises:
        Fault: The disk refuses the write.
    """
    return _write_listed(folder, name, pa.Table.from_pandas(rows, preserve_index=False), Entry("", 0, "", study=study))


def _write_listed(folder: Path, name: str, table: pa.Table, about: Entry) -> Entry:
    metadata = {"study": about.study, "labels": about.labels, "batches": about.batches, "run_ids": about.run_ids}
    content = _to_parquet(table, metadata)
    sha256 = files.digest(content)
    entry = replace(about, file=f"{name}-{sha256[:12]}.parquet", length=len(content), sha256=sha256)
    with contextlib.suppress(OSError):  # reported when the file itself is written
        path_in(folder, entry.file).parent.mkdir(exist_ok=True)
    files.write_atomically(path_in(folder, entry.file), content)
    return entry


def list_recordings(folder: Path, subfolder: str) -> list[Entry]:
    """Return the listed files of a subfolder; of files with one name, as after a repeated batch, the last.

    Args:
        folder: Folder of the study.
        subfolder: `HISTORIES` or `LAST_STATES`.

    Raises:
        InputError: The manifest is damaged.
    """
    listed = (entry for entry in manifest.read(folder) if entry.file.startswith(f"{subfolder}/"))
    return list({entry.file.rpartition("-")[0]: entry for entry in listed}.values())


def current_parts(folder: Path) -> list[Entry]:
    """Return the parts that hold a folder's rows: listed in its manifest, and judged by its present thresholds.

    Raises:
        InputError: The manifest is missing or damaged.
    """
    if not path_in(folder, STUDY).exists():
        return []
    if not path_in(folder, manifest.MANIFEST).exists() and any(path_in(folder, PARTS).glob("*.parquet")):
        raise InputError(f"{folder / manifest.MANIFEST} is missing: `sweep run` as before mends it")
    return manifest.select_current_parts(manifest.read(folder), read_study(folder)["labels"])


def finished_batches(folder: Path) -> set[int]:
    """Return the numbers of the batches that are on disk. Raises `InputError` where the manifest is damaged."""
    return {batch for entry in current_parts(folder) for batch in entry.batches}


def read_part(folder: Path, entry: Entry) -> pd.DataFrame:
    """Return the rows of one part.

    Args:
        folder: Folder of the study.
        entry: The part's entry in the manifest.

    Raises:
        InputError: The file is missing or not as listed.
    """
    return read_table(folder, entry).to_pandas()


def read_table(folder: Path, entry: Entry, columns: list[str] | None = None) -> pa.Table:
    """Return the rows of one part as an Arrow table; see `read_part`."""
    path = path_in(folder, entry.file)
    try:
        content = read_buffer(path)
        problem = entry.find_problem(content)
    except OSError as error:
        content, problem = None, files.os_error_text(error)
    if content is None or problem:
        raise InputError(f"{path} is damaged ({problem}): `sweep run` as before simulates it again")
    return parse_parquet(path, content, columns)


def read_rows(folder: Path) -> pd.DataFrame:
    """Return all finished rows of a folder, in the order of their batches.

    Raises:
        InputError: No batch is finished, a file is damaged, or rows are not those of the plan.
    """
    read_study(folder)
    if not (parts := read_parts(folder)):
        raise InputError(f"{folder} has no finished rollouts yet")
    # converted to pandas once, column by column: a million rows take seconds and little extra memory
    table = pa.concat_tables(parts, promote_options="permissive")
    del parts  # they would keep all columns in memory
    rows = table.to_pandas(self_destruct=True)
    planned = read_points(folder)  # after the parts: a running command plans its batches before it finishes them
    if planned.empty:
        raise DamagedFile(f"{folder / POINTS} is lost: `sweep run` as before mends it")
    if problems := plan_differences(planned, rows, rows["batch"].unique()):
        raise InputError(f"{folder} does not hold the rows of its {POINTS}: {problems[0]}; `sweep verify` names all")
    return rows


def read_parts(folder: Path, columns: list[str] | None = None) -> list[pa.Table]:
    """Read all parts of a folder, in the order of their batches.

    If a running command merges parts meanwhile, the new ones are read instead.

    Args:
        folder: Folder of the study.
        columns: Columns to read; None for all.

    Returns:
        One Arrow table a part.

    Raises:
        InputError: A file is damaged.
    """
    while True:
        parts = current_parts(folder)
        try:
            return [read_table(folder, entry, columns) for entry in parts]
        except InputError:
            if current_parts(folder) == parts:
                raise


def find_row(rows: pd.DataFrame, point: str, folder: Path) -> pd.Series:
    """Find a row by its number or by the beginning of its point id.

    Args:
        rows: Finished rows of the folder.
        point: Row number from 0, or the beginning of a point id.
        folder: The folder, for the message.

    Raises:
        InputError: No row, or more than one, is meant.
    """
    number = int(point) if point.isdecimal() and len(point) < 9 else None  # no study has so many rows
    if number is not None and number < len(rows):
        return rows.iloc[number]
    matches = rows[rows["point_id"].str.startswith(point) & (number is None)]
    if len(matches) != 1:
        problem = "is not a point" if matches.empty else f"means {len(matches)} points"
        raise InputError(f"{point} {problem} of {folder}: give a row from 0 to {len(rows) - 1} or a point_id")
    return matches.iloc[0]


def log(folder: Path, message: str) -> None:
    """Append a line with the present time to a folder's log.

    Args:
        folder: Folder of the study.
        message: The line.

    Raises:
        Fault: The disk refuses the write.
    """
    try:
        with path_in(folder, LOG).open("a", encoding="utf-8") as file:
            file.write(f"{time.strftime('%Y-%m-%dT%H:%M:%S%z')} {message}\n")
    except OSError as error:
        raise Fault(f"{folder / LOG} cannot be written: {files.os_error_text(error)}") from None

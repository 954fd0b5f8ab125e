"""A study's folder: what it is, its points, its finished rows. A file appears whole or not at all, see `manifest`."""

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

pa.set_memory_pool(pa.system_memory_pool())  # a million rows are read in 2 s of a processor; in 8 s by Arrow's own pool
STUDY, LOG, LOCK = "study.yaml", "log.txt", ".lock"
HISTORIES, LAST_STATES = manifest.HISTORIES, manifest.LAST_STATES
FORMAT = 2  # of the folder
CHECK = "# sha256 of the lines above: "
METADATA_KEY = b"sweep"  # key of a part's own account of itself


class DamagedFile(InputError):
    """A file is lost or not as it was written; `sweep run` mends it."""


def refuse_foreign_folder(folder: Path) -> None:
    """Raise `InputError` where `folder` holds other files and no results, which come with a folder of parts."""
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
    """Hold `folder` for this process, making it where missing and clearing what a killed one left half-written.

    Raises `InputError` where it cannot be written or another process has it.
    """
    held = filelock.FileLock(path_in(folder, LOCK), timeout=0)
    places = [path_in(folder, name) for name in SUBFOLDERS]
    try:
        path_in(folder, PARTS).mkdir(parents=True, exist_ok=True)
        held.acquire()
        for place in (folder, *places):
            for left in place.glob(f"{files.HIDDEN}*"):
                left.unlink(missing_ok=True)
    except filelock.Timeout:
        raise InputError(f"{folder} is in use by another sweep process: wait for it, or give out=DIR") from None
    except OSError as error:
        raise InputError(f"out = {folder} cannot be written: {files.os_error_text(error)}") from None
    try:
        yield
    finally:
        held.release()


def write_study(folder: Path, content: Mapping[str, Any]) -> None:
    """What the folder holds: configuration, versions, devices. Raises `Fault`."""
    text = yaml.safe_dump({"format": FORMAT, **content}, sort_keys=False, allow_unicode=True)
    files.write_atomically(path_in(folder, STUDY), f"{text}{CHECK}{files.digest(text.encode())}\n".encode())


def read_study(folder: Path) -> dict[str, Any]:
    """Content of study.yaml. Raises `InputError` where `folder` is not a study's, or one of another format."""
    path = path_in(folder, STUDY)
    damaged = DamagedFile(f"{path} is damaged: `sweep run` as before mends it")
    try:
        text, check, given = path.read_bytes().rpartition(CHECK.encode())
        if check and given != f"{files.digest(text)}\n".encode():
            raise damaged
        body = (text if check else given).decode()
        check_yaml(body, str(path), numbers=False)  # what was dumped has none that are ambiguous
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
    """Of plain values; short."""
    return files.digest(json.dumps(values, sort_keys=True).encode())[:16]


def write_points(folder: Path, points: pd.DataFrame) -> None:
    """The plan: one row per rollout, with its group, batch and slot. Raises `Fault`."""
    content = _to_parquet(pa.Table.from_pandas(points, preserve_index=False), {})
    entry = Entry(POINTS, len(content), files.digest(content))
    if entry not in manifest.read(folder):  # any plan that was listed is sound, so that a kill in between does no harm
        manifest.add(folder, entry)
    files.write_atomically(path_in(folder, POINTS), content)


def read_points(folder: Path) -> pd.DataFrame:
    """The plan, empty where nothing is planned yet. Raises `InputError`."""
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
        path: Where it is from, for the message.
        content: The bytes of the file.
        columns: Names of the columns to read; None for all.

    Raises:
        InputError: It is no Parquet file, or has no such columns.
    """
    try:
        return pq.read_table(content, columns=columns)
    except (pa.ArrowException, OSError, KeyError) as error:
        raise InputError(f"{path} is no table that can be read: {str(error).splitlines()[0]}") from None


def read_buffer(path: Path) -> pa.Buffer:
    """The bytes of a file, held by Arrow. Raises `OSError`.

    Of bytes held by Python a thread of Arrow may let go while the interpreter ends, which then aborts.
    """
    with pa.OSFile(os.fsencode(path)) as file:
        return file.read_buffer()


def _to_parquet(table: pa.Table, about: Mapping[str, Any]) -> bytes:
    table = table.replace_schema_metadata({**(table.schema.metadata or {}), METADATA_KEY: json.dumps(about).encode()})
    sink = pa.BufferOutputStream()
    pq.write_table(table, sink, compression="zstd")
    return sink.getvalue().to_pybytes()


def write_part(folder: Path, rows: pd.DataFrame, study: str, labels: str) -> Entry:
    """Finished rows of one or more batches, as a file that counts when `manifest.add` lists it. Raises `Fault`.

    `study` and `labels` are digests of what the rows have in common and of the thresholds that judged them.
    """
    return write_table(folder, pa.Table.from_pandas(rows, preserve_index=False), study, labels)


def write_table(folder: Path, table: pa.Table, study: str, labels: str) -> Entry:
    """As `write_part`, from Arrow's form."""
    batches, ids = (tuple(sorted(table[name].unique().to_pylist())) for name in ("batch", "run_id"))
    return _written(folder, f"{PARTS}/part-{batches[0]:06d}", table, Entry("", 0, "", batches, study, labels, ids))


def write_recording(folder: Path, name: str, rows: pd.DataFrame, study: str) -> Entry:
    """A file that goes with the parts, which counts when it is listed; `name` without its digest. Raises `Fault`."""
    return _written(folder, name, pa.Table.from_pandas(rows, preserve_index=False), Entry("", 0, "", study=study))


def _written(folder: Path, name: str, table: pa.Table, about: Entry) -> Entry:
    told = {"study": about.study, "labels": about.labels, "batches": about.batches, "run_ids": about.run_ids}
    content = _to_parquet(table, told)
    sha256 = files.digest(content)
    entry = replace(about, file=f"{name}-{sha256[:12]}.parquet", length=len(content), sha256=sha256)
    with contextlib.suppress(OSError):  # said of the file
        path_in(folder, entry.file).parent.mkdir(exist_ok=True)
    files.write_atomically(path_in(folder, entry.file), content)
    return entry


def list_recordings(folder: Path, subfolder: str) -> list[Entry]:
    """The listed files of a place beside the parts; of several of one name the last, as of a batch done again.

    Raises `InputError`.
    """
    listed = (entry for entry in manifest.read(folder) if entry.file.startswith(f"{subfolder}/"))
    return list({entry.file.rpartition("-")[0]: entry for entry in listed}.values())


def current_parts(folder: Path) -> list[Entry]:
    """The parts that hold a folder's rows: those of its manifest, judged by its thresholds. Raises `InputError`."""
    if not path_in(folder, STUDY).exists():
        return []
    if not path_in(folder, manifest.MANIFEST).exists() and any(path_in(folder, PARTS).glob("*.parquet")):
        raise InputError(f"{folder / manifest.MANIFEST} is missing: `sweep run` as before mends it")
    return manifest.select_current_parts(manifest.read(folder), read_study(folder)["labels"])


def finished_batches(folder: Path) -> set[int]:
    """Numbers of the batches that are on disk. Raises `InputError`."""
    return {batch for entry in current_parts(folder) for batch in entry.batches}


def read_part(folder: Path, entry: Entry) -> pd.DataFrame:
    """The rows of one part. Raises `InputError` where its file is not what is listed."""
    return read_table(folder, entry).to_pandas()


def read_table(folder: Path, entry: Entry, columns: list[str] | None = None) -> pa.Table:
    """As `read_part`, in Arrow's form; of all columns or of some."""
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
    """All finished rows, in the order of their batches.

    Raises `InputError` where there are none, and where they are not those of the plan.
    """
    read_study(folder)
    if not (parts := read_parts(folder)):
        raise InputError(f"{folder} has no finished rollouts yet")
    # into pandas once, column by column: a million rows take seconds and little more memory than they need
    table = pa.concat_tables(parts, promote_options="permissive")
    del parts  # which would hold all columns
    rows = table.to_pandas(self_destruct=True)
    planned = read_points(folder)  # after the parts: a run that goes on plans its batches before it finishes them
    if planned.empty:
        raise DamagedFile(f"{folder / POINTS} is lost: `sweep run` as before mends it")
    if problems := plan_differences(planned, rows, rows["batch"].unique()):
        raise InputError(f"{folder} does not hold the rows of its {POINTS}: {problems[0]}; `sweep verify` names all")
    return rows


def read_parts(folder: Path, columns: list[str] | None = None) -> list[pa.Table]:
    """All parts, in the order of their batches, also where a run puts them together meanwhile. Raises `InputError`."""
    while True:
        parts = current_parts(folder)
        try:
            return [read_table(folder, entry, columns) for entry in parts]
        except InputError:
            if current_parts(folder) == parts:
                raise


def find_row(rows: pd.DataFrame, point: str, folder: Path) -> pd.Series:
    """The row named by its number or by the beginning of its point id. Raises `InputError`."""
    number = int(point) if point.isdecimal() and len(point) < 9 else None  # no study has so many rows
    if number is not None and number < len(rows):
        return rows.iloc[number]
    found = rows[rows["point_id"].str.startswith(point) & (number is None)]
    if len(found) != 1:
        problem = "is not a point" if found.empty else f"means {len(found)} points"
        raise InputError(f"{point} {problem} of {folder}: give a row from 0 to {len(rows) - 1} or a point_id")
    return found.iloc[0]


def log(folder: Path, message: str) -> None:
    """Append one dated line to the log. Raises `Fault`."""
    try:
        with path_in(folder, LOG).open("a", encoding="utf-8") as file:
            file.write(f"{time.strftime('%Y-%m-%dT%H:%M:%S%z')} {message}\n")
    except OSError as error:
        raise Fault(f"{folder / LOG} cannot be written: {files.os_error_text(error)}") from None

"""Files of a study's folder: description, points, finished rows, log. Each file is written atomically.

The manifest says which files count, see `manifest`.
"""

import contextlib
import json
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import filelock
import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import yaml

from sweep.core import files, project
from sweep.core.errors import Fault, InputError
from sweep.core.files import path_inside_folder
from sweep.core.yaml_check import check_yaml
from sweep.runs import manifest
from sweep.runs.manifest import PARTS_FOLDER, POINTS_FILE, SUBFOLDERS, ManifestEntry
from sweep.runs.parquet import check_decompressed_size, column_names, decoded_schema, read_parquet
from sweep.runs.points_check import KEY_COLUMNS, PointsByBatch
from sweep.study.columns import VERDICT_COLUMNS
from sweep.study.size_limits import MAX_STUDY_ROLLOUTS

# reads a million rows in 2 s of CPU time; Arrow's own pool takes 8 s
pa.set_memory_pool(pa.system_memory_pool())
STUDY_FILE, LOG_FILE, LOCK_FILE = project.STUDY_FILE, "log.txt", ".lock"
HISTORIES_FOLDER, LAST_STATES_FOLDER = manifest.HISTORIES_FOLDER, manifest.LAST_STATES_FOLDER
VERDICTS_FOLDER = manifest.VERDICTS_FOLDER
FOLDER_FORMAT = 2  # of the folder
MAX_STUDY_FILE_BYTES = 2**24  # bytes of study.yaml
FEW_SURPLUS_ROWS = 10_000  # rows beyond the plan that are read, so that messages can name some
COLUMNS_PER_JOIN = 16  # columns that are joined from all parts at once
# of study.yaml, beside the format
STUDY_KEYS = {"config": dict, "rollouts": int, "labels": str, "stages": dict, "devices": list, "code": str,
              "commit": str, "versions": dict}  # fmt: skip
CHECKSUM_PREFIX = project.CHECKSUM_PREFIX
METADATA_KEY = b"sweep"  # of the Parquet metadata with a part's study, thresholds and batches


class DamagedFileError(InputError):
    """Error: a stored file is missing or has changed since it was written; `sweep run` repairs it."""


def refuse_foreign_folder(folder: Path) -> None:
    """Raise `InputError` if `folder` contains files but no results."""
    try:
        names = sorted(path.name for path in folder.iterdir() if not path.name.startswith("."))
    except FileNotFoundError:
        return
    except OSError as error:
        raise InputError(f"out = {folder} cannot be written: {files.os_error_text(error)}") from None
    if names and PARTS_FOLDER not in names:
        raise InputError(f"out = {folder} holds {names[0]} and no results: give a new folder, or an empty one")


@contextlib.contextmanager
def lock_folder(folder: Path) -> Iterator[None]:
    """Context that locks a study's folder for this process, after creating it if necessary and removing unfinished
    files.

    Raises:
        InputError: The folder cannot be written, or another process holds its lock.
    """
    lock = filelock.FileLock(path_inside_folder(folder, LOCK_FILE), timeout=0)
    subfolders = [path_inside_folder(folder, name) for name in SUBFOLDERS]
    try:
        path_inside_folder(folder, PARTS_FOLDER).mkdir(parents=True, exist_ok=True)
        files.separate_hard_link(path_inside_folder(folder, LOCK_FILE))  # the lock empties the file
        lock.acquire()
        for directory in (folder, *subfolders):
            for unfinished in directory.glob(f"{files.UNFINISHED_PREFIX}*"):
                unfinished.unlink(missing_ok=True)
    except filelock.Timeout:
        raise InputError(f"{folder} is in use by another sweep process: wait for it, or give out=DIR") from None
    except OSError as error:
        raise InputError(f"out = {folder} cannot be written: {files.os_error_text(error)}") from None
    try:
        yield
    finally:
        lock.release()


def is_folder_locked(folder: Path) -> bool:
    """Return whether a process holds the lock of a study's folder, as a run does."""
    path = path_inside_folder(folder, LOCK_FILE)
    if not path.exists():
        return False
    try:
        with filelock.FileLock(path, timeout=0):
            return False
    except filelock.Timeout:
        return True
    except OSError:  # the folder cannot be written, which a run needs
        return False


def write_study(folder: Path, content: Mapping[str, Any]) -> None:
    """Write `study.yaml`: configuration, versions, devices. Raises `Fault` if the disk fails."""
    text = yaml.safe_dump({"format": FOLDER_FORMAT, **content}, sort_keys=False, allow_unicode=True)
    files.write_atomically(
        path_inside_folder(folder, STUDY_FILE), f"{text}{CHECKSUM_PREFIX}{files.digest(text.encode())}\n".encode()
    )


def read_study(folder: Path) -> dict[str, Any]:
    """Return the content of `study.yaml`.

    Raises:
        DamagedFileError: The folder is not a study's, or the file has changed.
        InputError: The folder has another format.
    """
    path = path_inside_folder(folder, STUDY_FILE)
    damaged = DamagedFileError(f"{path} is damaged: repeat the same `sweep run` to repair it")
    try:
        text, check, given = files.read_bytes_limited(path, MAX_STUDY_FILE_BYTES).rpartition(CHECKSUM_PREFIX.encode())
        if check and given != f"{files.digest(text)}\n".encode():
            raise damaged
        body = (text if check else given).decode()
        check_yaml(body, str(path), numbers=False)  # a dump has no ambiguous numbers
        content = yaml.load(body, project.YAML_LOADER)
    except (FileNotFoundError, NotADirectoryError):
        raise DamagedFileError(f"{folder} is not a folder of results: it has no {STUDY_FILE}") from None
    except InputError:
        raise
    except (OSError, ValueError, RecursionError, yaml.YAMLError):
        raise damaged from None
    if isinstance(content, dict) and not check and "labelled" in content:
        content = {"format": 1, **content}
    elif not isinstance(content, dict) or not check:
        raise damaged
    if content.get("format") != FOLDER_FORMAT:
        by = f"format {content.get('format')}, of version {content.get('commit') or content.get('code')}"
        raise InputError(f"{folder} has {by}; this one reads {FOLDER_FORMAT}: give out=DIR")
    for key, kind in STUDY_KEYS.items():
        if not isinstance(value := content.get(key), kind):
            raise InputError(f"{path} is not allowed: {key} = {str(value)[:100]!r}")
    lists = {"stages": [*content["stages"].values()], "devices": [content["devices"]]}
    for key, every in lists.items():
        if not all(isinstance(one, list) and all(isinstance(name, str) for name in one) for one in every):
            raise InputError(f"{path} is not allowed: {key} = {str(content[key])[:100]!r}")
    return content


def count_planned_rollouts(folder: Path) -> int:
    """Return how many rollouts `study.yaml` plans, which bounds the size of a folder's files.

    Where it is lost or damaged, return the most that a study may have.
    """
    try:
        return min(read_study(folder)["rollouts"], MAX_STUDY_ROLLOUTS)
    except DamagedFileError:
        return MAX_STUDY_ROLLOUTS


def digest_values(values: Any) -> str:
    """Return a digest of plain values as 16 hexadecimal digits."""
    return files.digest(json.dumps(values, sort_keys=True).encode())[:16]


def write_points(folder: Path, points: pd.DataFrame) -> None:
    """Write the points of a study with group (program), batch and slot (place in it). Raises `Fault` on disk errors."""
    content = _to_parquet(pa.Table.from_pandas(points, preserve_index=False), {})
    entry = ManifestEntry(POINTS_FILE, len(content), files.digest(content))
    # listed before it is written: any listed points table counts as sound, so a kill in between does no harm
    if entry not in manifest.read_manifest(folder):
        manifest.append_entries(folder, entry)
    files.write_atomically(path_inside_folder(folder, POINTS_FILE), content)


def has_intact_points_file(folder: Path, entries: Sequence[ManifestEntry], planned: int) -> bool:
    """Return whether a folder holds the table of planned points just as its manifest lists it.

    Args:
        folder: Results folder of a study.
        entries: Entries of its manifest.
        planned: How many rollouts the study plans.
    """
    path = path_inside_folder(folder, POINTS_FILE)
    try:
        length = path.stat().st_size
        listed = [entry for entry in entries if entry.file == POINTS_FILE and entry.length == length]
        if not listed or length > listed[0].max_file_size(planned):
            return False
        return files.digest_file(path) in {entry.sha256 for entry in listed}
    except OSError:
        return False


def read_points(folder: Path, columns: Sequence[str] | None = None) -> pd.DataFrame:
    """Read the table of the points that a study plans to simulate, a row for each rollout.

    Args:
        folder: Results folder of a study.
        columns: Names of the columns to read; None for all.

    Returns:
        A row for each planned rollout; an empty table where nothing is planned yet.

    Raises:
        InputError: The points table is damaged, or not allowed.
    """
    path = path_inside_folder(folder, POINTS_FILE)
    if not path.exists():
        return pd.DataFrame()
    planned = count_planned_rollouts(folder)
    if not has_intact_points_file(folder, manifest.read_manifest(folder), planned):
        raise DamagedFileError(f"{path} is damaged: repeat the same `sweep run` to repair it")
    return read_parquet(path, columns, has_row_names=True, max_rows=planned).to_pandas()


def to_pandas(table: pa.Table) -> pd.DataFrame:
    """Convert an Arrow table to a read-only pandas table, without copies if possible; the Arrow table is consumed."""
    return table.to_pandas(self_destruct=True, split_blocks=True)


def _to_parquet(table: pa.Table, about: Mapping[str, Any]) -> bytes:
    if not table.schema.metadata:  # as it was read; what pandas adds is of types only
        described = pa.Table.from_pandas(table.schema.empty_table().to_pandas(), preserve_index=False)
        table = table.replace_schema_metadata(described.schema.metadata)
    table = table.replace_schema_metadata({**(table.schema.metadata or {}), METADATA_KEY: json.dumps(about).encode()})
    sink = pa.BufferOutputStream()
    pq.write_table(table, sink, compression="zstd")
    return sink.getvalue().to_pybytes()


def write_part(folder: Path, rows: pd.DataFrame, study: str, labels: str) -> ManifestEntry:
    """Write finished rows of one or more batches to a file, which counts once the manifest lists it.

    Args:
        folder: Folder of the study.
        rows: The finished rows.
        study: Digest of the study, see `runner.study_id`.
        labels: Digest of the thresholds that judged the rows, see `runner.labels_id`.

    Returns:
        Its entry for `manifest.append_entries`.

    Raises:
        Fault: The disk refuses the write.
    """
    return write_table(folder, pa.Table.from_pandas(rows, preserve_index=False), study, labels)


def write_table(folder: Path, table: pa.Table, study: str, labels: str) -> ManifestEntry:
    """Write an Arrow table of finished rows to a file, which counts once the manifest lists it."""
    batches, ids = (tuple(sorted(table[name].unique().to_pylist())) for name in ("batch", "run_id"))
    return _write_listed(
        folder, f"{PARTS_FOLDER}/part-{batches[0]:06d}", table, ManifestEntry("", 0, "", batches, study, labels, ids)
    )


def write_recording(folder: Path, name: str, rows: pd.DataFrame, study: str) -> ManifestEntry:
    """Write a recording, such as time series, to a file, which counts once the manifest lists it.

    Args:
        folder: Folder of the study.
        name: Path below `folder`, to which a digest and the suffix are added.
        rows: Content.
        study: Digest of the study.

    Returns:
        Its entry for `manifest.append_entries`.

    Raises:
        Fault: The disk refuses the write.
    """
    return _write_listed(
        folder, name, pa.Table.from_pandas(rows, preserve_index=False), ManifestEntry("", 0, "", study=study)
    )


def _write_listed(folder: Path, name: str, table: pa.Table, about: ManifestEntry) -> ManifestEntry:
    metadata = {"study": about.study, "labels": about.labels, "batches": about.batches, "run_ids": about.run_ids}
    content = _to_parquet(table, metadata)
    sha256 = files.digest(content)
    entry = replace(about, file=f"{name}-{sha256[:12]}.parquet", length=len(content), sha256=sha256)
    with contextlib.suppress(OSError):  # reported when the file itself is written
        path_inside_folder(folder, entry.file).parent.mkdir(exist_ok=True)
    files.write_atomically(path_inside_folder(folder, entry.file), content)
    return entry


def write_verdicts(folder: Path, verdicts: pd.Series) -> None:
    """Store verdicts on finished rows, in place of earlier ones. They hold for the folder's present thresholds.

    Args:
        folder: Folder of the study, locked by the caller.
        verdicts: Words by `point_id`; the name of the series is that of the column, one of `VERDICT_COLUMNS`.

    Raises:
        Fault: The disk refuses the write.
    """
    stored = read_study(folder)
    about = ManifestEntry("", 0, "", study=read_study_digest(folder), labels=stored["labels"])
    table = pa.Table.from_pandas(verdicts.rename_axis("point_id").reset_index(), preserve_index=False)
    manifest.append_entries(folder, _write_listed(folder, f"{VERDICTS_FOLDER}/{verdicts.name}", table, about))


def read_verdicts(folder: Path) -> pd.Series | None:
    """Return the verdicts on finished rows by `point_id`; None if there are none for the folder's present thresholds.

    Args:
        folder: Folder of the study.

    Raises:
        InputError: The file is damaged.
    """
    labels = read_study(folder)["labels"]
    listed = [entry for entry in list_recordings(folder, VERDICTS_FOLDER) if entry.labels == labels]
    if not listed:
        return None
    rows = to_pandas(read_table(folder, listed[-1]))
    return rows.set_index("point_id")[VERDICT_COLUMNS[0]]


def read_study_digest(folder: Path) -> str:
    """Read the digest of the study whose rows a folder holds; empty without rows."""
    return next((entry.study for entry in list_current_parts(folder)), "")


def list_recordings(folder: Path, subfolder: str) -> list[ManifestEntry]:
    """Return the valid recordings of a subfolder; of several with one name, as after a repeated batch, the last.

    Args:
        folder: Folder of the study.
        subfolder: `HISTORIES_FOLDER`, `LAST_STATES_FOLDER` or `VERDICTS_FOLDER`.

    Raises:
        InputError: The manifest is damaged.
    """
    listed = (entry for entry in manifest.read_manifest(folder) if entry.file.startswith(f"{subfolder}/"))
    return list({entry.file.rpartition("-")[0]: entry for entry in listed}.values())


def list_current_parts(folder: Path) -> list[ManifestEntry]:
    """Return the files that hold a folder's current rows: listed in its manifest and labelled by its present
    thresholds.

    Raises:
        InputError: The manifest is missing or damaged.
    """
    if not path_inside_folder(folder, STUDY_FILE).exists():
        return []
    if not path_inside_folder(folder, manifest.MANIFEST_FILE).exists() and any(
        path_inside_folder(folder, PARTS_FOLDER).glob("*.parquet")
    ):
        raise InputError(f"{folder / manifest.MANIFEST_FILE} is missing: repeat the same `sweep run` to repair it")
    return manifest.select_current_parts(manifest.read_manifest(folder), read_study(folder)["labels"])


def finished_batches(folder: Path) -> set[int]:
    """Return the numbers of the batches that are on disk. Raises `InputError` where the manifest is damaged."""
    return {batch for entry in list_current_parts(folder) for batch in entry.batches}


def count_rollouts(folder: Path) -> tuple[int, int]:
    """Return how many rollouts are planned, and how many of them are in finished batches. Raises `InputError`."""
    planned = read_points(folder, ["batch"])
    if planned.empty:
        return 0, 0
    return len(planned), int(planned["batch"].isin(finished_batches(folder)).sum())


def read_part(folder: Path, entry: ManifestEntry, planned: int | None = None) -> pd.DataFrame:
    """Return the finished rows in one file of a study's folder.

    Args:
        folder: Folder of the study.
        entry: The part's entry in the manifest.
        planned: How many rollouts the study plans; None reads it, which takes time in a loop.

    Raises:
        InputError: The file is missing or not as listed.
    """
    return read_table(folder, entry, planned=planned).to_pandas()


def last_rollout_wall_time_s(folder: Path) -> float | None:
    """Return the wall time of a rollout (s) in the last batch of a folder; None where it is unknown."""
    try:
        done = list_current_parts(folder)
        return float(read_part(folder, done[-1])["wall_s"].iloc[-1]) if done else None
    except (InputError, KeyError):  # damaged, or of an earlier layout
        return None


def read_table(
    folder: Path, entry: ManifestEntry, columns: Sequence[str] | None = None, planned: int | None = None
) -> pa.Table:
    """Read a file that the manifest lists as an Arrow table.

    Args:
        folder: Results folder of a study.
        entry: Its entry in the manifest.
        columns: Names of the columns to read; None for all. Those that the file lacks are left out.
        planned: How many rollouts the study plans; None reads it, which takes time in a loop.

    Raises:
        InputError: The file is not what is listed, or not allowed.
    """
    path = path_inside_folder(folder, entry.file)
    planned = count_planned_rollouts(folder) if planned is None else planned
    try:
        problem = entry.find_file_mismatch(path, planned)
    except OSError as error:
        problem = files.os_error_text(error)
    if problem:
        raise InputError(f"{path} is damaged ({problem}): repeat the same `sweep run` to simulate it again")
    is_part = bool(entry.batches)
    return read_parquet(path, columns, is_part, planned + FEW_SURPLUS_ROWS if is_part else None)


def read_rows(folder: Path, columns: Sequence[str] | None = None) -> pd.DataFrame:
    """Read finished rows, in the order of their batches.

    Args:
        folder: Results folder of a study.
        columns: Names of the columns to read, in this order; None for all. No other columns are decoded, except for
            the two that place a row in its batch.

    Raises:
        InputError: There are no rows, they are not those of the points table, or a column is unknown.
    """
    tables: list[pa.Table] = []
    total = 0
    size = sum(entry.length for entry in list_current_parts(folder))
    for part in iterate_parts(folder, columns):
        total += part.nbytes
        check_decompressed_size(folder, total, size)
        tables.append(part)
        del part
    names = [*dict.fromkeys(name for one in tables for name in one.column_names)]
    if columns is not None:
        if unknown := [name for name in columns if name not in names]:
            raise InputError(f"column {unknown[0]} is unknown in {folder}")
        names = [*dict.fromkeys(columns)]
    return _join_parts(tables, names)


def _join_parts(tables: list[pa.Table], names: Sequence[str]) -> pd.DataFrame:
    """Join tables to a table of pandas with columns `names`, in which few columns are in memory twice.

    `tables` is emptied meanwhile.
    """
    frames = []
    for first in range(0, len(names), COLUMNS_PER_JOIN):
        some = names[first : first + COLUMNS_PER_JOIN]
        parts = [one.select([name for name in some if name in one.column_names]) for one in tables]
        frames.append(pa.concat_tables(parts, promote_options="permissive").select(some).to_pandas())
        del parts
        tables[:] = [one.drop_columns([name for name in some if name in one.column_names]) for one in tables]
        pa.default_memory_pool().release_unused()
    return pd.concat(frames, axis=1)


def iterate_parts(folder: Path, columns: Sequence[str] | None = None) -> Iterator[pa.Table]:
    """Yield finished rows file by file, in the order of their batches; a run may merge files meanwhile.

    Args:
        folder: Results folder of a study.
        columns: Names of the columns to read beside `batch` and `slot`; None for all. Those that a part lacks are left
            out of it.

    Raises:
        InputError: There are no rows, a part is damaged, or its rows are not those of the points table.
    """
    read_study(folder)
    verdicts = read_verdicts(folder) if columns is None or {*columns}.intersection(VERDICT_COLUMNS) else None
    named = ["point_id"] if verdicts is not None else []
    wanted = None if columns is None else [*dict.fromkeys([*columns, *named, *KEY_COLUMNS])]
    parts = list_current_parts(folder)
    if not parts:
        raise InputError(f"{folder} has no finished rollouts yet")
    points, todo = _read_points_table(folder, wanted), {batch for entry in parts for batch in entry.batches}
    while todo:
        entry = parts[0]
        try:
            table = read_table(folder, entry, wanted, len(points.rows))
        except InputError:
            now = [one for one in list_current_parts(folder) if todo.intersection(one.batches)]
            if now == parts:
                raise
            parts, points = now, _read_points_table(folder, wanted)
            continue
        planned = [name for name in points.rows.columns if name in table.column_names]
        if problems := points.row_differences(to_pandas(table.select(planned)), entry.batches):
            raise InputError(
                f"{folder} does not hold the rows of its {POINTS_FILE}: {problems[0]}; `sweep verify` names all"
            )
        if not todo.issuperset(entry.batches):  # a run has merged parts meanwhile: some rows were yielded before
            table = table.filter(pa.array(np.isin(table["batch"].to_numpy(), sorted(todo))))
        todo.difference_update(entry.batches)
        parts = parts[1:]
        if verdicts is not None:
            own = pd.Series(table["point_id"].to_pandas()).map(verdicts).fillna("")
            table = table.append_column(str(verdicts.name), pa.array(own, pa.string()))
        yield table


def _read_points_table(folder: Path, columns: Sequence[str] | None) -> PointsByBatch:
    # after the parts are listed: a run that goes on plans its batches before it finishes them
    planned = read_points(folder, columns)
    if planned.empty:
        raise DamagedFileError(f"{folder / POINTS_FILE} is missing: repeat the same `sweep run` to repair it")
    return PointsByBatch(planned, str(folder / POINTS_FILE))


def list_columns(folder: Path) -> list[str]:
    """List the columns that finished rows have, without reading rows.

    Raises:
        InputError: There are no rows yet, or a part is damaged.
    """
    return [*map(str, read_column_types(folder))]


def read_column_types(folder: Path) -> pd.DataFrame:
    """Return an empty table with the columns and types of the finished rows, without reading rows.

    Args:
        folder: Results folder of a study.

    Raises:
        InputError: There are no rows yet, or a part is damaged.
    """
    if not (parts := list_current_parts(folder)):
        raise InputError(f"{folder} has no finished rollouts yet")
    schemas = []
    for entry in parts:
        path = path_inside_folder(folder, entry.file)
        try:
            metadata = pq.read_metadata(path)
            column_names(path, metadata)
            schemas.append(decoded_schema(metadata.schema.to_arrow_schema()))
        except (pa.ArrowException, OSError):
            raise InputError(f"{path} is damaged: repeat the same `sweep run` to simulate it again") from None
    try:
        types = pa.unify_schemas(schemas, promote_options="permissive")
    except pa.ArrowException as error:
        raise InputError(f"{folder} is damaged: its parts differ in a column: {str(error).splitlines()[0]}") from None
    for k, field in enumerate(types):
        if pa.types.is_integer(field.type) and any(field.name not in schema.names for schema in schemas):
            types = types.set(k, field.with_type(pa.float64()))  # pandas has no whole number for a missing one
    if (verdicts := read_verdicts(folder)) is not None:
        types = types.append(pa.field(str(verdicts.name), pa.string()))
    return types.empty_table().to_pandas()


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


def append_to_log(folder: Path, message: str) -> None:
    """Append a line with the present time to a folder's log.

    Args:
        folder: Folder of the study.
        message: The line.

    Raises:
        Fault: The disk refuses the write.
    """
    path = path_inside_folder(folder, LOG_FILE)
    files.separate_hard_link(path)
    try:
        with path.open("a", encoding="utf-8") as file:
            file.write(f"{time.strftime('%Y-%m-%dT%H:%M:%S%z')} {message}\n")
    except OSError as error:
        raise Fault(f"{folder / LOG_FILE} cannot be written: {files.os_error_text(error)}") from None

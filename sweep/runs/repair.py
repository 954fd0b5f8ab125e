"""Check of a study's folder against its manifest and points table, and repair of damaged parts."""

import json
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq

from sweep.core import files
from sweep.core.errors import InputError
from sweep.core.files import path_inside_folder, printable_name
from sweep.runs import manifest, store
from sweep.runs.manifest import ManifestEntry
from sweep.runs.parquet import read_parquet
from sweep.runs.points_check import PointsByBatch

SMALL_PART_ROWS, MAX_PART_ROWS = (
    4096,
    32768,
)  # rows: smaller parts than the first are merged, into parts of at most the second
MIN_MERGED_PARTS = 8  # least number of parts that are merged


def verify_folder(folder: Path) -> tuple[list[str], list[str], int]:
    """Check every file of a study's folder; return lines on damaged and unlisted files, and the number of sound ones.

    Returns:
        A line for each damaged or missing file, a line for each file that is not listed and thus ignored, and the count
        of sound parts.

    Raises:
        InputError: `folder` is not a study's.
    """
    entries, damaged = manifest.parse_manifest(folder)
    problems = [f"{folder / manifest.MANIFEST_FILE} is damaged in line {number}" for number in damaged]
    try:
        store.read_study(folder)
    except store.DamagedFileError as error:
        if not path_inside_folder(folder, store.PARTS_FOLDER).is_dir():
            raise
        problems.append(str(error))
    points = _read_sound_points(folder, entries)
    if points is None:
        problems.append(f"{folder / store.POINTS_FILE} is lost or damaged")
    planned = store.count_planned_rollouts(folder)
    parts = {folder / entry.file: _find_problem(folder, entry, planned, points) for entry in entries if entry.batches}
    recordings = {
        folder / entry.file: _find_problem(folder, entry, planned) for entry in entries if _is_recording(entry)
    }
    problems += [f"{path} is damaged ({problem})" for path, problem in {**parts, **recordings}.items() if problem]
    sound = list(parts.values()).count(None)
    unlisted = [
        f"{printable_name(path)} is not in {manifest.MANIFEST_FILE}: ignored"
        for path in _unlisted_files(folder, entries)
    ]
    return problems, unlisted, sound


def repair_files(folder: Path, study: str, labels: str) -> list[str]:
    """Repair a study's folder: drop damaged files from the manifest, add valid unlisted files, rebuild lost points.

    The caller holds the folder's lock.

    Args:
        folder: Folder of the study.
        study: Digest of the study; parts of another study are ignored.
        labels: Digest of the thresholds; parts judged by others are removed.

    Returns:
        A line for each repair.

    Raises:
        Fault: The disk refuses a write.
    """
    entries, damaged = manifest.parse_manifest(folder)
    lines = [f"{folder / manifest.MANIFEST_FILE} is damaged in line {number}: rebuilt" for number in damaged]
    kept = [entry for entry in entries if entry.file == store.POINTS_FILE]
    # parts of a killed `relabel`, then damaged files; deleted below
    dropped = [entry for entry in entries if entry.batches and entry.labels != labels]
    points, planned = _read_sound_points(folder, entries), store.count_planned_rollouts(folder)
    for entry in (*manifest.select_current_parts(entries, labels), *filter(_is_recording, entries)):
        if problem := _find_problem(folder, entry, planned, points):
            again = "audit --engines" if entry.file.startswith(f"{manifest.VERDICTS_FOLDER}/") else "replay"
            remedy = "its rollouts are simulated again" if entry.batches else f"`sweep {again}` makes it again"
            lines.append(f"{folder / entry.file} is damaged ({problem}): {remedy}")
            dropped.append(entry)
        else:
            kept.append(entry)
    points, has_lost_lines = _read_sound_points(folder, kept), bool(damaged) or not entries
    for path in _unlisted_files(folder, entries):
        entry = _entry_from_metadata(folder, path, planned)
        entry = entry if entry and entry.study == study else None
        if entry and (
            has_lost_lines if _is_recording(entry) else entry.labels == labels and _belongs(folder, entry, kept, points)
        ):
            kept.append(entry)
            lines.append(f"{printable_name(path)} was not in {manifest.MANIFEST_FILE}: listed")
        elif entry and set(entry.batches) <= {b for listed in kept for b in listed.batches}:
            path.unlink()  # its rows are in another part: a worker or a merge came too late
        else:
            lines.append(f"{printable_name(path)} does not belong to this study: ignored")
    if damaged or kept != entries:
        manifest.rewrite_manifest(folder, kept)
    for entry in dropped:
        path_inside_folder(folder, entry.file).unlink(missing_ok=True)
    parts = [entry for entry in kept if entry.batches]
    if points is None and (parts or path_inside_folder(folder, store.POINTS_FILE).exists()):
        lines.append(f"{folder / store.POINTS_FILE} was missing or damaged: rebuilt from the parts")
        path_inside_folder(folder, store.POINTS_FILE).unlink(missing_ok=True)
        if parts:
            store.write_points(folder, rebuild_points(folder, parts))
    return lines


def rebuild_points(folder: Path, parts: Sequence[ManifestEntry]) -> pd.DataFrame:
    """Return the points table, rebuilt from the leading columns of finished rows."""
    planned = store.count_planned_rollouts(folder)
    rows = pd.concat([store.read_part(folder, entry, planned) for entry in parts], ignore_index=True)
    return rows[list(rows.columns[: rows.columns.get_loc("run_id")])]


def _read_sound_points(folder: Path, listed: Sequence[ManifestEntry]) -> PointsByBatch | None:
    """Return the points table, or None where it is damaged or lacks batches of the listed parts."""
    path = path_inside_folder(folder, store.POINTS_FILE)
    planned = store.count_planned_rollouts(folder)
    if not store.has_intact_points_file(folder, listed, planned):
        return None
    points = PointsByBatch(store.to_pandas(read_parquet(path, max_rows=planned)), str(path))
    return points if {b for e in listed for b in e.batches} <= points.batches() else None


def _find_problem(folder: Path, entry: ManifestEntry, planned: int, points: PointsByBatch | None = None) -> str | None:
    """Describe what is wrong with a listed file, or return None; with a points table, its rows are compared too."""
    path = path_inside_folder(folder, entry.file)
    try:
        problem = entry.find_file_mismatch(path, planned)
    except OSError as error:
        return files.os_error_text(error)
    if problem or points is None or not entry.batches:
        return problem
    try:
        columns, most = list(points.rows.columns), planned + store.FEW_SURPLUS_ROWS
        rows = store.to_pandas(read_parquet(path, columns, max_rows=most))
    except InputError as error:
        return str(error)
    return "; ".join(points.row_differences(rows, entry.batches)) or None


def _unlisted_files(folder: Path, entries: Sequence[ManifestEntry]) -> Iterator[Path]:
    listed = {entry.file for entry in entries}
    for place in store.SUBFOLDERS:
        for path in sorted(path_inside_folder(folder, place).glob("*")):
            if f"{place}/{path.name}" not in listed and not path.name.startswith(files.UNFINISHED_PREFIX):
                yield path


def _is_recording(entry: ManifestEntry) -> bool:
    return not entry.batches and entry.file != store.POINTS_FILE


def _entry_from_metadata(folder: Path, path: Path, planned: int) -> ManifestEntry | None:
    """Return the entry of a part that is not listed, from its own metadata; None where it is no part or was changed."""
    try:
        path = path_inside_folder(folder, path.relative_to(folder))
        about = json.loads(pq.read_schema(path).metadata[store.METADATA_KEY])
        place = {"file": f"{path.parent.name}/{path.name}", "length": path.stat().st_size}
        entry = manifest.entry_from_json({**about, **place, "sha256": ""})
        if path.stat().st_size > entry.max_file_size(planned):
            return None
        sha256 = files.digest_file(path)
        return replace(entry, sha256=sha256) if path.stem.endswith(f"-{sha256[:12]}") else None
    except (OSError, ValueError, KeyError, TypeError, RecursionError, pa.ArrowException):  # `InputError` among them
        return None


def _belongs(folder: Path, entry: ManifestEntry, kept: Sequence[ManifestEntry], points: PointsByBatch | None) -> bool:
    """Whether a part that is not listed belongs to the points table and holds no batch of a listed part.

    Without a points table, none of its points may be in a listed part.
    """
    if set(entry.batches) & {batch for listed in kept for batch in listed.batches}:
        return False
    rows = store.read_part(folder, entry)
    if points is not None:
        return points.select_batches(entry.batches)[0]["point_id"].tolist() == rows["point_id"].tolist()
    parts = [listed for listed in kept if listed.batches]
    return not parts or not rows["point_id"].isin(rebuild_points(folder, parts)["point_id"]).any()


def remove_parts(folder: Path, entries: Sequence[ManifestEntry]) -> None:
    """Remove files of rows from the manifest (list of valid files) and delete them. Raises `Fault` on disk errors."""
    manifest.rewrite_manifest(folder, [entry for entry in manifest.read_manifest(folder) if entry not in entries])
    for entry in entries:
        path_inside_folder(folder, entry.file).unlink(missing_ok=True)


def merge_small_parts(folder: Path, planned: pd.DataFrame) -> None:
    """Merge small neighbouring files of rows, since many files are slow to read.

    A process killed at any moment leaves all rows listed, and at most files that `repair_files` removes.

    Args:
        folder: Folder of the study.
        planned: Its assigned points.

    Raises:
        Fault: The disk refuses a write.
    """
    parts = store.list_current_parts(folder)
    merged = {}
    for run in _mergeable_runs(parts, planned):
        if len(run) >= MIN_MERGED_PARTS:
            table = pa.concat_tables([store.read_table(folder, entry, planned=len(planned)) for entry in run])
            merged[run[0].file] = store.write_table(folder, table, run[0].study, run[0].labels)
            merged |= dict.fromkeys((entry.file for entry in run[1:]), None)
    if merged:
        listed = manifest.read_manifest(folder)
        points = [entry for entry in listed if entry.file == store.POINTS_FILE]
        kept = [merged.get(entry.file, entry) for entry in parts]
        recordings = filter(_is_recording, listed)
        manifest.rewrite_manifest(folder, [*points[-1:], *recordings, *(entry for entry in kept if entry)])
        for file in merged:
            path_inside_folder(folder, file).unlink(missing_ok=True)


def _mergeable_runs(parts: Sequence[ManifestEntry], planned: pd.DataFrame) -> Iterator[list[ManifestEntry]]:
    """Yield runs of small parts whose batches are neighbours and share a group, up to MAX_PART_ROWS rows a run."""
    batches = planned.groupby("batch")["group"].agg(["first", "size"])
    place = {batch: k for k, batch in enumerate(batches.index)}
    run: list[ManifestEntry] = []
    total = 0
    for entry in parts:
        size = int(batches.loc[list(entry.batches), "size"].sum())
        group = batches["first"][entry.batches[0]]
        follows = run and place[entry.batches[0]] == place[run[-1].batches[-1]] + 1
        follows = follows and group == batches["first"][run[-1].batches[0]] and total + size <= MAX_PART_ROWS
        if run and (not follows or size >= SMALL_PART_ROWS):
            yield run
            run, total = [], 0
        if size < SMALL_PART_ROWS:
            run.append(entry)
            total += size
    if run:
        yield run

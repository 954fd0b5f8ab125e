"""Is a folder what it was when it was written? What is not is named, and mended where the rest of it tells how."""

import json
from collections.abc import Iterator, Sequence
from pathlib import Path

import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq

from sweep.core import files
from sweep.core.errors import InputError
from sweep.core.files import path_in
from sweep.runs import manifest, store
from sweep.runs.manifest import Entry
from sweep.runs.plan_check import plan_differences

SMALL, LARGE = 4096, 32768  # rows: parts with fewer are put together into parts with at most so many
FEW = 8  # parts are not worth it


def verify(folder: Path) -> tuple[list[str], list[str], int]:
    """What is damaged or missing in `folder`, what is there and does not count, and how many parts are sound.

    Raises `InputError` where `folder` is not a study's.
    """
    entries, damaged = manifest.parse(folder)
    problems = [f"{folder / manifest.MANIFEST} is damaged in line {number}" for number in damaged]
    try:
        store.read_study(folder)
    except store.DamagedFile as error:
        if not path_in(folder, store.PARTS).is_dir():
            raise
        problems.append(str(error))
    planned = _planned(folder, entries)
    if planned is None:
        problems.append(f"{folder / store.POINTS} is lost or damaged")
    parts = {folder / entry.file: _problem(folder, entry, planned) for entry in entries if entry.batches}
    others = {folder / entry.file: _problem(folder, entry) for entry in entries if _is_beside(entry)}
    problems += [f"{path} is damaged ({problem})" for path, problem in {**parts, **others}.items() if problem]
    sound = list(parts.values()).count(None)
    strangers = [f"{path} is not in {manifest.MANIFEST}: ignored" for path in _unlisted(folder, entries)]
    return problems, strangers, sound


def repair_files(folder: Path, study: str, labels: str) -> list[str]:
    """Drop what is damaged from the manifest, list sound parts that it lacks, and rebuild a lost plan; a line for each.

    Only parts of the study and the labels with these digests count. Called by who holds the lock. Raises `Fault`.
    """
    entries, damaged = manifest.parse(folder)
    lines = [f"{folder / manifest.MANIFEST} is damaged in line {number}: rebuilt" for number in damaged]
    kept = [entry for entry in entries if entry.file == store.POINTS]
    left = [entry for entry in entries if entry.batches and entry.labels != labels]  # by a relabelling that was killed
    planned = _planned(folder, entries)
    for entry in (*manifest.select_current_parts(entries, labels), *filter(_is_beside, entries)):
        if problem := _problem(folder, entry, planned):
            remedy = "its rollouts are simulated again" if entry.batches else "`sweep replay` shows its rollouts again"
            lines.append(f"{folder / entry.file} is damaged ({problem}): {remedy}")
            left.append(entry)
        else:
            kept.append(entry)
    planned, lost = _planned(folder, kept), bool(damaged) or not entries
    for path in _unlisted(folder, entries):
        found = _own(folder, path)
        found = found if found and found.study == study else None
        beside = found and _is_beside(found)
        if found and (lost if beside else found.labels == labels and _fits(folder, found, kept, planned)):
            kept.append(found)
            lines.append(f"{path} was not in {manifest.MANIFEST}: listed")
        elif found and set(found.batches) <= {b for entry in kept for b in entry.batches}:
            path.unlink()  # its rows are in another part: a worker or a merger was too late
        else:
            lines.append(f"{path} is not of this study as it is: ignored")
    if damaged or kept != entries:
        manifest.rewrite(folder, kept)
    for entry in left:
        path_in(folder, entry.file).unlink(missing_ok=True)
    parts = [entry for entry in kept if entry.batches]
    if planned is None and (parts or path_in(folder, store.POINTS).exists()):
        lines.append(f"{folder / store.POINTS} was lost or damaged: rebuilt from the parts")
        path_in(folder, store.POINTS).unlink(missing_ok=True)
        if parts:
            store.write_points(folder, rebuild_plan(folder, parts))
    return lines


def rebuild_plan(folder: Path, parts: Sequence[Entry]) -> pd.DataFrame:
    """The planned rows that `parts` hold."""
    rows = pd.concat([store.read_part(folder, entry) for entry in parts], ignore_index=True)
    return rows[list(rows.columns[: rows.columns.get_loc("run_id")])]


def _planned(folder: Path, listed: Sequence[Entry]) -> pd.DataFrame | None:
    """The plan, if it is sound and has all that is listed."""
    path = path_in(folder, store.POINTS)
    if not path.exists() or not any(e.file == store.POINTS and not _problem(folder, e) for e in listed):
        return None
    planned = store.parse_parquet(path, store.read_buffer(path)).to_pandas()
    return planned if {b for e in listed for b in e.batches} <= set(planned["batch"]) else None


def _problem(folder: Path, entry: Entry, planned: pd.DataFrame | None = None) -> str | None:
    """What is wrong with a listed file; the rows of a part are compared with those `planned`, if these are known."""
    path = path_in(folder, entry.file)
    try:
        content = store.read_buffer(path)
    except OSError as error:
        return files.os_error_text(error)
    if (problem := entry.find_problem(content)) or planned is None or not entry.batches:
        return problem
    try:
        rows = store.parse_parquet(path, content, list(planned.columns)).to_pandas()
    except InputError as error:
        return str(error)
    return "; ".join(plan_differences(planned, rows, entry.batches)) or None


def _unlisted(folder: Path, entries: Sequence[Entry]) -> Iterator[Path]:
    listed = {entry.file for entry in entries}
    for place in store.SUBFOLDERS:
        for path in sorted(path_in(folder, place).glob("*")):
            if f"{place}/{path.name}" not in listed and not path.name.startswith(files.HIDDEN):
                yield path


def _is_beside(entry: Entry) -> bool:
    return not entry.batches and entry.file != store.POINTS


def _own(folder: Path, path: Path) -> Entry | None:
    """What a part that is not listed says of itself; None where it is not one, or not as it was written."""
    try:
        content = store.read_buffer(path_in(folder, path.relative_to(folder)))
        sha256 = files.digest(content)
        if not path.stem.endswith(f"-{sha256[:12]}"):
            return None
        about = json.loads(pq.read_schema(content).metadata[store.METADATA_KEY])
    except (OSError, ValueError, KeyError, TypeError, pa.ArrowException):  # `InputError` among them
        return None
    name = f"{path.parent.name}/{path.name}"
    return Entry(
        name, len(content), sha256, tuple(about["batches"]), about["study"], about["labels"], tuple(about["run_ids"])
    )


def _fits(folder: Path, found: Entry, kept: Sequence[Entry], planned: pd.DataFrame | None) -> bool:
    """Whether the rows of `found` are planned, or not known otherwise where there is no plan, and in no part yet."""
    if set(found.batches) & {batch for entry in kept for batch in entry.batches}:
        return False
    rows = store.read_part(folder, found)
    if planned is not None:
        here = planned[planned["batch"].isin(found.batches)].sort_values(["batch", "slot"])
        return here["point_id"].tolist() == rows["point_id"].tolist()
    parts = [entry for entry in kept if entry.batches]
    return not parts or not rows["point_id"].isin(rebuild_plan(folder, parts)["point_id"]).any()


def remove_parts(folder: Path, entries: Sequence[Entry]) -> None:
    """Remove parts that count no longer. Raises `Fault`."""
    manifest.rewrite(folder, [entry for entry in manifest.read(folder) if entry not in entries])
    for entry in entries:
        path_in(folder, entry.file).unlink(missing_ok=True)


def merge_small_parts(folder: Path, planned: pd.DataFrame) -> None:
    """Put small parts that follow each other together: ten thousand files are slow to read. Raises `Fault`.

    Killed at any moment it leaves all rows where the manifest says, and perhaps files that `mend` removes.
    """
    parts = store.current_parts(folder)
    merged = {}
    for run in _runs(parts, planned):
        if len(run) >= FEW:
            table = pa.concat_tables([store.read_table(folder, entry) for entry in run])
            merged[run[0].file] = store.write_table(folder, table, run[0].study, run[0].labels)
            merged |= dict.fromkeys((entry.file for entry in run[1:]), None)
    if merged:
        listed = manifest.read(folder)
        plan = [entry for entry in listed if entry.file == store.POINTS]
        kept = [merged.get(entry.file, entry) for entry in parts]
        beside = filter(_is_beside, listed)
        manifest.rewrite(folder, [*plan[-1:], *beside, *(entry for entry in kept if entry)])
        for file in merged:
            path_in(folder, file).unlink(missing_ok=True)


def _runs(parts: Sequence[Entry], planned: pd.DataFrame) -> Iterator[list[Entry]]:
    """Small parts that follow each other in the plan, of one group and thus of the same columns, up to LARGE rows."""
    batches = planned.groupby("batch")["group"].agg(["first", "size"])
    place = {batch: k for k, batch in enumerate(batches.index)}
    run: list[Entry] = []
    total = 0
    for entry in parts:
        size = int(batches.loc[list(entry.batches), "size"].sum())
        group = batches["first"][entry.batches[0]]
        follows = run and place[entry.batches[0]] == place[run[-1].batches[-1]] + 1
        follows = follows and group == batches["first"][run[-1].batches[0]] and total + size <= LARGE
        if run and (not follows or size >= SMALL):
            yield run
            run, total = [], 0
        if size < SMALL:
            run.append(entry)
            total += size
    if run:
        yield run

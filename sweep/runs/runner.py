"""Running of a study: from an experiment to finished rows in its folder, and from a row back to its rollout."""

import socket
import time
from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache, partial
from pathlib import Path
from typing import Any
from uuid import uuid4

import numpy as np
import pandas as pd

from sweep.config.experiment import Experiment, build_experiment, flatten_values
from sweep.contract.engine import Engine
from sweep.core import provenance, user_code
from sweep.core.errors import Fault, InputError
from sweep.core.expressions import condition_mask
from sweep.core.files import path_inside_folder
from sweep.core.outcomes import INVALID
from sweep.runs import manifest, repair, store, time_series
from sweep.runs.batches import (
    Batch,
    allocate_delay_buffers,
    assign_batches,
    clear_engine_cache,
    halve_batches,
    make_batch,
    make_engine,
    make_nominal_batch,
    point_membership_mask,
)
from sweep.runs.manifest import ManifestEntry
from sweep.study import design_kinds
from sweep.study.clusters import DispatchFunction
from sweep.study.columns import metric_columns
from sweep.study.study import Logger, attach_axis_names, make_points

# Keys that may differ between runs into one folder: they choose points, or judge rows. The distribution that draws
# follow may not change, and of a design only settings that let it grow.
MUTABLE_KEYS = ("study.axes.", "study.points", "study.where",
                "study.replicates", "study.resolution", "study.level", "study.budget", "study.audit",
                "study.invalid_max", "study.replays", "study.expect", "study.theory", "scenario.expect", "outcome",
                "cluster", "out")  # fmt: skip
PROGRESS_COLUMNS = ["outcome", "wall_s"]
ProgressCallback = Callable[[pd.DataFrame], None]  # receives these columns of every finished batch


@dataclass
class RunRecord:
    """Facts about a run that `study.yaml` stores, collected as engines are made and batches finish."""

    stages: dict[int, list[str]] = field(default_factory=dict)  # of the plan, by group
    devices: list[str] = field(default_factory=list)


@dataclass(frozen=True)
class Job:
    """Batches to simulate in a study's folder, with the points of all its batches."""

    exp: Experiment
    folder: Path
    table: pd.DataFrame  # all points of the folder, with group, batch, slot and width
    wanted_batches: set[int]  # numbers of the batches that this run asks for
    unassigned_points: int = 0  # number of the study's points that have no batch

    @cached_property
    def study_digest(self) -> str:
        """Digest of what all rows of the folder share: configuration and code."""
        return study_id(self.exp.values)

    @cached_property
    def labels_digest(self) -> str:
        """Digest of the thresholds that judge rows as success or failure."""
        return labels_id(self.exp.values)

    def missing_batches(self) -> list[int]:
        """Return the numbers of wanted batches that are not on disk."""
        return sorted(self.wanted_batches - store.finished_batches(self.folder))

    @cached_property
    def _places(self) -> dict[int, np.ndarray]:
        """Positions of each batch's rows in the table, found once for all batches."""
        return self.table.groupby("batch").indices  # pyright: ignore[reportReturnType]

    def points_of_batches(self, batches: list[int]) -> pd.DataFrame:
        """Return the points of the given batches, in the order of the points table."""
        if self.wanted_batches == {*batches} and self.table["batch"].nunique() == len(
            batches
        ):  # no copy of millions of rows
            return self.table
        places = [self._places[number] for number in batches]
        return self.table.take(np.sort(np.concatenate([np.zeros(0, dtype=int), *places])))


def select_points_to_simulate(
    exp: Experiment,
    where: str | None = None,
    limit: int | None = None,
    on_message: Logger | None = None,
    with_ids: bool = True,
) -> pd.DataFrame:
    """Return the points of a study that a run should simulate.

    Args:
        exp: Experiment of the study.
        where: Condition on axes and parameters that chooses points; None for all.
        limit: Largest number of points; None for all.
        on_message: Receives a line where points are left out because they equal others.
        with_ids: Whether the points are to be simulated, see `make_points`. A condition may name ids, and has them.

    Returns:
        A row for each rollout.

    Raises:
        InputError: No point matches, or the study's axes are not allowed.
    """
    table = make_points(
        exp.study, exp.system, exp.settings, on_message=on_message, with_ids=with_ids or where is not None
    )
    if where is not None:
        table = table[condition_mask(attach_axis_names(table, exp.study.axes), where)]
    table = table.iloc[:limit]
    if table.empty:
        raise InputError(f"no point of {exp.study.name} matches the selection")
    return table.reset_index(drop=True)


def count_unassigned_points(exp: Experiment, table: pd.DataFrame, wanted: pd.DataFrame) -> int:
    """Count the points of a study that are in no batch yet, for instance because of `--limit`.

    Args:
        exp: Experiment of the study.
        table: Points that have a batch.
        wanted: Points of this run.

    Returns:
        The count; 0 where rounds decide the points, or their file is gone.
    """
    if exp.study.is_sequential or (exp.study.points and not Path(exp.study.points).is_file()):
        return 0
    if not exp.study.points and len(wanted) == exp.study.max_rollouts:
        return 0
    return int((~point_membership_mask(make_points(exp.study, exp.system, exp.settings), table)).sum())


def prepare_job(exp: Experiment, folder: Path, wanted: pd.DataFrame) -> Job:
    """Assign the wanted points to batches of a study's folder without writing; existing batches keep their points.

    Args:
        exp: Experiment of the study.
        folder: Its folder; may be missing or empty.
        wanted: Points to simulate, a row for each rollout.

    Returns:
        A job whose wanted batches are those with a wanted point.

    Raises:
        InputError: The folder holds another study, or too many time histories would be kept.
    """
    planned = store.read_points(folder)
    if len(planned):
        require_same_study(store.read_study(folder), exp, folder)
        if differ := set(planned.columns) ^ {*wanted.columns, "group", "batch", "slot", "width"}:
            raise InputError(f"{folder} holds a study with other axes ({', '.join(sorted(differ))}): give out=DIR")
    every = pd.concat([planned, wanted], ignore_index=True) if len(planned) else wanted  # no copy of millions of rows
    buffered = allocate_delay_buffers(exp, every)
    table = assign_batches(buffered, planned, wanted)
    time_series.check_history_size(buffered, table)
    unplanned = count_unassigned_points(exp, table, wanted)  # by the points' ids, which are not those with a buffer
    chosen = table["batch"][point_membership_mask(table, wanted)] if len(planned) else table["batch"]
    return Job(buffered, folder, table, set(chosen.unique().tolist()), unplanned)


def repair_folder(exp: Experiment, folder: Path) -> list[str]:
    """Repair a study's folder before a run, as far as the experiment and the remaining files allow.

    Args:
        exp: Experiment that is to run in the folder.
        folder: The folder, locked by the caller.

    Returns:
        A line for each repair.

    Raises:
        InputError: The folder holds another study.
    """
    study, labels, stored = study_id(exp.values), labels_id(exp.values), None
    entries, _ = manifest.parse_manifest(folder)
    try:
        stored = store.read_study(folder)
        labels = stored["labels"]
        if entries:
            require_same_study(stored, exp, folder)
    except store.DamagedFileError:
        if any(entry.batches and (entry.study, entry.labels) != (study, labels) for entry in entries):
            raise InputError(
                f"{folder / store.STUDY_FILE} is lost or damaged, and the rows are of another study, version or "
                "thresholds than those asked for: give the same, or out=DIR"
            ) from None
    lines = repair.repair_files(folder, study, labels)
    planned = store.read_points(folder)
    if stored is None and len(planned):
        job, record = Job(allocate_delay_buffers(exp, planned), folder, planned, set()), RunRecord()
        for group, rows in planned.groupby("group"):
            start = make_nominal_batch(job.exp, rows, int(rows["width"].iloc[0]))
            record.stages[int(group)] = list(make_engine(job.exp, start).stages)  # pyright: ignore[reportArgumentType]
        write_study_file(job, record)
        lines.append(f"{folder / store.STUDY_FILE} was missing or damaged: written again")
    return lines


def require_same_study(stored: Mapping[str, Any], exp: Experiment, folder: Path) -> None:
    """Raise `InputError` if settings or code of the experiment differ from those of the rows in a folder.

    Args:
        stored: Content of the folder's `study.yaml`.
        exp: Experiment that is to run in the folder.
        folder: The folder, for the message.

    Raises:
        InputError: Settings that all rows share, or the version of the code, differ.
    """
    there, here = immutable_settings(stored["config"]), immutable_settings(exp.values)
    is_other_version = stored["code"] != provenance.code_version()
    # another version may have other parameters, so only common keys are compared
    for key in sorted({*there} & {*here} if is_other_version else {*there, *here}):
        if there.get(key) != here.get(key):
            raise InputError(
                f"{folder} holds another study: {key} is {there.get(key)} there and {here.get(key)} here; give out=DIR"
            )
    if is_other_version:
        raise InputError(
            f"{folder} was simulated by another version of the code or of its libraries "
            f"({stored['commit'] or stored['code']}): remove it or give out=DIR"
        )


def describe_changed_axes(exp: Experiment, folder: Path) -> list[str]:
    """Return a note for each axis whose listed values differ between a folder and the study that will run in it.

    The folder then holds the points of both.

    Args:
        exp: Experiment that is to run in the folder.
        folder: The folder; may be empty.
    """
    if store.read_points(folder).empty:
        return []
    there, here = (flatten_values(v["study"]["axes"]) for v in (store.read_study(folder)["config"], exp.values))
    return [
        f"note: study.axes.{key} was {there.get(key)} in {folder} and is {here.get(key)} now: "
        "what it has stays and what it lacks is added; out=DIR keeps them apart"
        for key in sorted({*there, *here})
        if there.get(key) != here.get(key) and key.rpartition(".")[2] in ("values", "from", "to", "num")
    ]


def immutable_settings(values: Mapping[str, Any]) -> dict[str, Any]:
    """Return the settings, by dotted path, that may not change between runs into one folder."""
    growing = design_kinds.find_kind(values["study"]["design"]["kind"]).growing_settings
    return {
        key: value
        for key, value in flatten_values(values).items()
        if not (key.startswith(MUTABLE_KEYS) or key in {f"study.design.{name}" for name in growing})
        or ".distribution" in key
        or key.endswith(".relative")
    }


def study_id(values: Mapping[str, Any]) -> str:
    """Return the digest of what all rows of a folder share: configuration and code."""
    return store.digest_values([immutable_settings(values), provenance.code_version()])


def labels_id(values: Mapping[str, Any]) -> str:
    """Return the digest of the thresholds and code that judge rows as success or failure."""
    return store.digest_values([values["outcome"], provenance.code_version()])


def run_job(job: Job, progress: ProgressCallback, dispatch: DispatchFunction = map) -> Job:
    """Simulate the missing batches of a job; each batch is stored as soon as it is done.

    Batches that do not fit into a device's memory are assigned anew, at half the width.

    Args:
        job: The job, from `prepare_job`.
        progress: Receives the columns `PROGRESS_COLUMNS` of every finished batch.
        dispatch: Maps a function over batch numbers, in this process or on workers, in the order of completion.

    Returns:
        The job with the batches as they were simulated.

    Raises:
        Fault: Disk, memory or workers fail.
    """
    folder, exp, record = job.folder, job.exp, RunRecord()
    if path_inside_folder(folder, store.STUDY_FILE).exists():
        stored = store.read_study(folder)
        record = RunRecord(stored["stages"], stored["devices"])
        if stored["labels"] != job.labels_digest:
            relabel_folder(folder, exp.values["outcome"])
    write_study_file(job, record)
    while missing := job.missing_batches():
        store.write_points(folder, job.table)
        out_of_memory: list[FinishedBatch] = []  # batches that did not fit into memory
        work = partial(simulate_on_worker, folder.resolve(), uuid4().hex, provenance.code_version())
        for done in dispatch(work, iter_batches(job, missing, record, out_of_memory)):
            if done.entry is None:
                out_of_memory.append(done)
                continue
            rows = add_batch_to_manifest(job, done, done.entry)
            if done.device not in record.devices:
                record.devices.append(done.device)
                write_study_file(job, record)
            where = f"{done.host}, {done.device}"
            store.append_to_log(
                folder, f"batch {done.batch}: {len(rows)} rollouts, {rows['wall_s'].sum():.1f} s on {where}"
            )
            progress(rows)
        if out_of_memory:
            job = halve_batch_width(job, out_of_memory)
    repair.merge_small_parts(folder, job.table)
    return job


def add_batch_to_manifest(job: Job, done: "FinishedBatch", entry: ManifestEntry) -> pd.DataFrame:
    """Add the file of rows that a worker wrote to the manifest, so that its rows count; return outcomes and wall times.

    Args:
        job: The job.
        done: What the worker reports.
        entry: Entry of its part.

    Returns:
        The columns `PROGRESS_COLUMNS` of its rows.

    Raises:
        Fault: The part is not in this folder, or is of another study or other thresholds.
    """
    if not all(path_inside_folder(job.folder, one.file).exists() for one in (entry, *done.recordings)):
        raise Fault(
            f"{done.host} wrote batch {done.batch} to {job.folder.resolve()}, which does not exist on this machine"
        )
    if (entry.study, entry.labels) != (job.study_digest, job.labels_digest) or {
        one.study for one in done.recordings
    } - {job.study_digest}:
        raise Fault(f"{done.host} simulated batch {done.batch} of another study, or judged it by other thresholds")
    rows = store.read_table(job.folder, entry, PROGRESS_COLUMNS, len(job.table)).to_pandas()
    manifest.append_entries(job.folder, *limit_last_state_recordings(job.folder, done.recordings), entry)
    return rows


def limit_last_state_recordings(folder: Path, recordings: tuple[ManifestEntry, ...]) -> list[ManifestEntry]:
    """Keep the final states of at most `MAX_INVALID_ROWS` invalid rows of a folder; return the recordings that remain.

    Workers do not know of each other, so together they may record too many.
    """
    last = [entry for entry in recordings if entry.file.startswith(f"{store.LAST_STATES_FOLDER}/")]
    room = time_series.MAX_INVALID_ROWS - len(store.list_recordings(folder, store.LAST_STATES_FOLDER)) if last else 0
    for entry in last[room:]:
        path_inside_folder(folder, entry.file).unlink(missing_ok=True)
    return [entry for entry in recordings if entry not in last[room:]]


def iter_batches(
    job: Job, missing: list[int], record: RunRecord, out_of_memory: Collection["FinishedBatch"]
) -> Iterator[int]:
    """Yield the numbers of missing batches; compile the engine of each group (batches of one program) before its first.

    An impossible plan is thus refused here, before a worker sees it.

    Args:
        job: The job.
        missing: Numbers of the batches.
        record: Receives the stages of each group; written to `study.yaml`.
        out_of_memory: Batches that did not fit, which grows meanwhile; others of their group and width are skipped.
    """
    for _, rows in job.points_of_batches(missing).groupby(["group", "width"], sort=False):
        group, width = (int(rows[name].iloc[0]) for name in ("group", "width"))
        start = make_nominal_batch(job.exp, rows, width)
        engine = make_engine(job.exp, start)
        record.stages[group] = list(engine.stages)
        write_study_file(job, record)
        how = f"{start.settings}, {engine.dynamics} dynamics"
        store.append_to_log(job.folder, f"group {group}: {how}, {len(rows)} rollouts of {engine.duration:g} s")
        for number in rows["batch"].unique().tolist():
            if not (out_of_memory and rows["batch"].isin([done.batch for done in out_of_memory]).any()):
                yield number


def halve_batch_width(job: Job, out_of_memory: list["FinishedBatch"]) -> Job:
    """Return the job with batches that were too large for memory reassigned at half the width.

    These are all unfinished batches of the group and width of a batch that ran out of memory.
    """
    crowded = job.points_of_batches([done.batch for done in out_of_memory])[["group", "width"]].drop_duplicates()
    left = job.table[~job.table["batch"].isin(store.finished_batches(job.folder))]
    batches = left.merge(crowded, on=["group", "width"])["batch"].unique().tolist()
    table = halve_batches(job.table, batches, out_of_memory[0].devices)
    for done in out_of_memory:
        store.append_to_log(
            job.folder, f"batch {done.batch}: too little memory on {done.host}, {done.device}; half the width"
        )
    asked = job.table["batch"].isin(job.wanted_batches)
    return replace(job, table=table, wanted_batches=set(table.loc[asked, "batch"]))


@dataclass(frozen=True)
class FinishedBatch:
    """Report of a worker on a batch whose rows it has written."""

    batch: int
    host: str
    device: str
    devices: int  # number of devices that share a batch
    entry: ManifestEntry | None  # of its part; None where the device's memory is too small
    recordings: tuple[ManifestEntry, ...] = ()  # files with histories and last states


def simulate_on_worker(folder: Path, version: str, code: str, number: int) -> FinishedBatch:
    """Simulate one batch of a study's folder in a worker process, and write its rows to a file.

    The rows count once the command that sent the batch lists them in the manifest.

    Args:
        folder: Folder of the study.
        version: Name of the folder's present plan, so that a worker reads it once.
        code: Version of the code that the command runs.
        number: Number of the batch.

    Returns:
        What was written; no entry where the device's memory is too small.

    Raises:
        InputError: The worker runs another version of the code.
        Fault: The part cannot be written.
    """
    host = socket.gethostname()
    if (here := provenance.code_version()) != code:
        raise InputError(f"worker {host} has another version of the code or of its libraries: {here}, not {code}")
    job = _read_job(folder, version)
    rows = job.points_of_batches([number])
    start = make_nominal_batch(job.exp, rows, int(rows["width"].iloc[0]))
    engine = make_engine(job.exp, start)
    entry, beside = None, ()
    try:
        finished, table = simulate_batch(job.exp, engine, rows)
        # labelled by the thresholds that judged the rows, even if the command has others by now
        entry = store.write_part(folder, finished, job.study_digest, job.labels_digest)
        beside = time_series.write_recordings(
            folder, job.study_digest, number, table, last_states_of_invalid_rows(job, engine, rows, finished)
        )
    except MemoryError:
        pass
    finally:
        for line in user_code.take_printed_lines(with_tracebacks=True):
            store.append_to_log(folder, line)
    if entry is None:  # outside the handler, whose exception keeps the arrays alive
        clear_engine_cache()
    return FinishedBatch(number, host, job.exp.system.device(start.settings), engine.devices, entry, beside)


def last_states_of_invalid_rows(
    job: Job, engine: Engine, rows: pd.DataFrame, finished: pd.DataFrame
) -> list[pd.DataFrame]:
    """Return the states in the last second of a batch's invalid rollouts, for at most a few rollouts of a folder.

    Args:
        job: The job.
        engine: Engine of the batch, which is simulated again if it has invalid rows.
        rows: Points of the batch.
        finished: Its finished rows.

    Returns:
        A table for each recorded row, see `time_series.record_ends_of_invalid_rollouts`.
    """
    if not (finished["outcome"] == INVALID).any():
        return []
    room = time_series.MAX_INVALID_ROWS - len(
        list(path_inside_folder(job.folder, store.LAST_STATES_FOLDER).glob("*.parquet"))
    )
    try:
        return (
            time_series.record_ends_of_invalid_rollouts(job.exp, engine, make_batch(job.exp, rows), finished, room)
            if room > 0
            else []
        )
    except MemoryError:  # last states are optional; the rows are finished
        return []


@lru_cache(maxsize=1)
def _read_job(folder: Path, version: str) -> Job:
    table = store.read_points(folder)
    return Job(
        allocate_delay_buffers(build_experiment(store.read_study(folder)["config"]), table), folder, table, set()
    )


def write_study_file(job: Job, record: RunRecord) -> None:
    """Write `study.yaml`: configuration, number of rollouts, versions, and the facts recorded so far."""
    about = {"config": job.exp.values, "rollouts": len(job.table) + job.unassigned_points, "labels": job.labels_digest}
    there = {"stages": record.stages, "devices": record.devices, **provenance.version_record()}
    store.write_study(job.folder, about | there)


def simulate_batch(exp: Experiment, engine: Engine, rows: pd.DataFrame) -> tuple[pd.DataFrame, pd.DataFrame | None]:
    """Simulate the points of one batch and label their outcomes.

    Args:
        exp: Experiment of the study.
        engine: Engine of the batch's group.
        rows: Points of the batch.

    Returns:
        Finished rows: points, metrics, outcome, and wall time per rollout (s); and the time histories that the study
        keeps of them, or None.
    """
    task, slots, samples = make_batch(exp, rows), time_series.find_recorded_slots(exp, rows), None
    watched = time_series.make_time_series_request(exp, task.settings)
    start = time.perf_counter()
    if len(slots):
        figures, samples = engine.run_with_time_series(task.world, task.belief, task.streams, slots, watched)
    else:
        figures = engine.run(task.world, task.belief, task.streams)
    wall = time.perf_counter() - start
    columns = {name: np.asarray(values, dtype=float)[: len(rows)] for name, values in figures.items()}
    labels = exp.system.judge(columns, exp.thresholds, engine.stages)
    done = rows.reset_index(drop=True).assign(run_id=exp.system.run_id(task.settings))
    finished = pd.concat([done, pd.DataFrame(columns), pd.DataFrame(labels)], axis=1).assign(wall_s=wall / len(rows))
    if samples is None:
        return finished, None
    return finished, time_series.histories_table(finished, slots, samples, watched, task.settings.control_period)


def prepare_single_batch(exp: Experiment) -> tuple[Experiment, pd.DataFrame]:
    """Assign the points of a study that is not stored to batches; return experiment and points.

    Returns:
        The experiment with a batch width and delay buffers, and the points with their batch.

    Raises:
        InputError: The nominal plan is impossible.
    """
    exp = replace(exp, settings=replace(exp.settings, width=exp.settings.width or 1))
    table = assign_batches(exp, pd.DataFrame(), select_points_to_simulate(exp))
    return allocate_delay_buffers(exp, table), table


def run_single_batch(exp: Experiment) -> pd.DataFrame:
    """Simulate all points of a study in one batch that is not stored; return the finished rows.

    Raises:
        Fault: The batch does not fit into the device's memory.
    """
    exp, table = prepare_single_batch(exp)
    start = make_nominal_batch(exp, table, exp.settings.width)
    try:
        return simulate_batch(exp, make_engine(exp, start), table)[0]
    except MemoryError:
        raise Fault("a rollout does not fit in the memory of the device") from None


def relabel_folder(folder: Path, outcome: Mapping[str, Any]) -> None:
    """Label all stored rows of a folder again by other thresholds, without simulating.

    New parts are written beside the old ones and count once study.yaml has their digest: all rows are judged anew, or
    none.

    Args:
        folder: Folder of the study, locked by the caller.
        outcome: The thresholds.
    """
    stored = store.read_study(folder)
    config = {**stored["config"], "outcome": dict(outcome)}
    exp, labels = build_experiment(config), labels_id(config)
    before = store.list_current_parts(folder)
    if labels == stored["labels"]:
        return
    unfinished = [e for e in manifest.read_manifest(folder) if e.batches and e not in before]  # of a killed `relabel`
    repair.remove_parts(folder, unfinished)
    for entry in before:
        rows = store.read_part(folder, entry, stored["rollouts"])
        figures = {name: rows[name].to_numpy() for name in metric_columns(rows)}
        judged = exp.system.judge(figures, exp.thresholds, tuple(stored["stages"][int(rows["group"].iloc[0])]))
        manifest.append_entries(folder, store.write_part(folder, rows.assign(**judged), entry.study, labels))
    store.write_study(folder, {**stored, "config": config, "labels": labels})
    repair.remove_parts(folder, before)


def load_stored_rollout(folder: Path, point: str) -> tuple[Batch, int, pd.Series]:
    """Return the batch of a stored rollout, its position there and its row, from which to simulate it again.

    On the same device the same batch gives the same bits.

    Args:
        folder: Folder of the study.
        point: Row number, or the beginning of a point id.

    Returns:
        The batch, the row's slot in it, and the row.

    Raises:
        InputError: No row, or more than one, is meant.
    """
    table = store.read_points(folder)
    row = store.find_row(store.read_rows(folder), point, folder)
    exp = allocate_delay_buffers(build_experiment(store.read_study(folder)["config"]), table)
    return make_batch(exp, table[table["batch"] == row["batch"]]), int(row["slot"]), row

"""From an experiment to finished rows on disk, and from a row on disk back to its rollout."""

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

from sweep.core import provenance
from sweep.core.errors import Fault, InputError
from sweep.core.expressions import mask
from sweep.core.files import path_in
from sweep.core.outcomes import INVALID
from sweep.engines.base import Engine
from sweep.runs import manifest, repair, store, time_series
from sweep.runs.batches import (
    Batch,
    assign_batches,
    forget_engine,
    halve_batches,
    isin_points,
    make_batch,
    make_engine,
    make_nominal_batch,
    with_delay_buffer,
)
from sweep.runs.manifest import Entry
from sweep.study.clusters import Dispatch
from sweep.study.columns import figure_columns
from sweep.study.config import Experiment, experiment, values_by_path
from sweep.study.study import Logger, name_axes, points

# Keys that may differ between runs into one folder: they choose points, or judge rows. The distribution that draws
# follow may not change.
MUTABLE_KEYS = ("study.axes.", "study.design.num", "study.design.runs", "study.points", "study.where",
                "study.replicates", "study.resolution", "study.level", "study.budget", "study.audit",
                "study.invalid_max", "study.expect", "study.theory", "scenario.expect", "outcome", "cluster",
                "out")  # fmt: skip
PROGRESS_COLUMNS = ["outcome", "wall_s"]
Progress = Callable[[pd.DataFrame], None]  # told these columns of every finished batch


@dataclass
class RunRecord:
    """What is known only when engines are made and batches are done."""

    stages: dict[int, list[str]] = field(default_factory=dict)  # of the plan, by group
    devices: list[str] = field(default_factory=list)


@dataclass(frozen=True)
class Job:
    """A study laid out in its folder: all planned rows, and those that this run asks for."""

    exp: Experiment
    folder: Path
    table: pd.DataFrame
    wanted: set[int]  # batches
    unplanned: int = 0  # rollouts of the study that are in neither

    @cached_property
    def study(self) -> str:
        """Digest of what all rows of the folder share: configuration and code."""
        return study_id(self.exp.values)

    @cached_property
    def labels(self) -> str:
        """Digest of how the rows are judged."""
        return labels_id(self.exp.values)

    def missing(self) -> list[int]:
        """Batches that are asked for and not on disk."""
        return sorted(self.wanted - store.finished_batches(self.folder))

    @cached_property
    def _places(self) -> dict[int, np.ndarray]:
        """Where each batch is in the table, which would else be gone through for each of them."""
        return self.table.groupby("batch").indices  # pyright: ignore[reportReturnType]

    def rows(self, batches: list[int]) -> pd.DataFrame:
        """Planned rows of `batches`, in the table's order."""
        places = [self._places[number] for number in batches]
        return self.table.take(np.sort(np.concatenate([np.zeros(0, dtype=int), *places])))


def select_points(
    exp: Experiment, where: str | None = None, limit: int | None = None, say: Logger | None = None
) -> pd.DataFrame:
    """The study's points that match `where`, at most `limit` of them. Raises `InputError` where none is left."""
    table = points(exp.study, exp.system, exp.settings, say=say)
    table = table[mask(name_axes(table, exp.study.axes), where)].iloc[:limit]
    if table.empty:
        raise InputError(f"no point of {exp.study.name} is left to run")
    return table.reset_index(drop=True)


def count_unplanned(exp: Experiment, table: pd.DataFrame, wanted: pd.DataFrame) -> int:
    """How many of the study's points `table` leaves out, as after `--limit`; 0 where they are not known beforehand.

    None are, without a look at each of a million points, where all that the study can have are `wanted`.
    """
    if exp.study.is_sequential or (exp.study.points and not Path(exp.study.points).is_file()):
        return 0
    if not exp.study.points and len(wanted) == exp.study.max_rollouts:
        return 0
    return int((~isin_points(points(exp.study, exp.system, exp.settings), table)).sum())


def prepare_job(exp: Experiment, folder: Path, wanted: pd.DataFrame) -> Job:
    """Plan `wanted` in `folder`, keeping what is planned there. Writes nothing. Raises `InputError`."""
    planned = store.read_points(folder)
    if len(planned):
        refuse_other_study(store.read_study(folder), exp, folder)
        if differ := set(planned.columns) ^ {*wanted.columns, "group", "batch", "slot", "width"}:
            raise InputError(f"{folder} holds a study with other axes ({', '.join(sorted(differ))}): give out=DIR")
    every = pd.concat([planned, wanted], ignore_index=True)
    exp = with_delay_buffer(exp, every)
    table = assign_batches(exp, planned, wanted)
    time_series.check_size(exp, table)
    return Job(
        exp, folder, table, set(table.loc[isin_points(table, wanted), "batch"]), count_unplanned(exp, table, wanted)
    )


def repair_folder(exp: Experiment, folder: Path) -> list[str]:
    """Make `folder`, which is locked, whole again, as far as `exp` and what is left of it tell; a line for each repair.

    Raises `InputError` where it holds another study.
    """
    study, labels, stored = study_id(exp.values), labels_id(exp.values), None
    entries, _ = manifest.parse(folder)
    try:
        stored = store.read_study(folder)
        labels = stored["labels"]
        if entries:
            refuse_other_study(stored, exp, folder)
    except store.DamagedFile:
        if any(entry.batches and (entry.study, entry.labels) != (study, labels) for entry in entries):
            raise InputError(
                f"{folder / store.STUDY} is lost or damaged, and the rows are of another study, version or thresholds "
                "than those asked for: give the same, or out=DIR"
            ) from None
    lines = repair.repair_files(folder, study, labels)
    planned = store.read_points(folder)
    if stored is None and len(planned):
        job, found = Job(with_delay_buffer(exp, planned), folder, planned, set()), RunRecord()
        for group, rows in planned.groupby("group"):
            start = make_nominal_batch(job.exp, rows, int(rows["width"].iloc[0]))
            found.stages[int(group)] = list(make_engine(job.exp, start).stages)  # pyright: ignore[reportArgumentType]
        write_description(job, found)
        lines.append(f"{folder / store.STUDY} was lost or damaged: written anew")
    return lines


def refuse_other_study(stored: Mapping[str, Any], exp: Experiment, folder: Path) -> None:
    """Raise `InputError` where a folder holds rows that would not belong with those of `exp`."""
    there, here = immutable_settings(stored["config"]), immutable_settings(exp.values)
    newer = stored["code"] != provenance.code_version()  # which may have parameters that the other does not
    for key in sorted({*there} & {*here} if newer else {*there, *here}):
        if there.get(key) != here.get(key):
            raise InputError(
                f"{folder} holds another study: {key} is {there.get(key)} there and {here.get(key)} here; give out=DIR"
            )
    if newer:
        raise InputError(
            f"{folder} was simulated by another version of the code or of its libraries "
            f"({stored['commit'] or stored['code']}): remove it or give out=DIR"
        )


def describe_changed_axes(exp: Experiment, folder: Path) -> list[str]:
    """A line for each axis whose listed values were others in `folder`, which is to hold the points of both."""
    if store.read_points(folder).empty:
        return []
    there, here = (values_by_path(v["study"]["axes"]) for v in (store.read_study(folder)["config"], exp.values))
    return [
        f"note: study.axes.{key} was {there.get(key)} in {folder} and is {here.get(key)} now: "
        "what it has stays and what it lacks is added; out=DIR keeps them apart"
        for key in sorted({*there, *here})
        if there.get(key) != here.get(key) and key.rpartition(".")[2] in ("values", "from", "to", "num")
    ]


def immutable_settings(values: Mapping[str, Any]) -> dict[str, Any]:
    """What may not change between runs into one folder, by dotted path."""
    whole = values["study"]["design"]["kind"] == "latin_hypercube"  # one draw more changes all of them
    return {
        key: value
        for key, value in values_by_path(values).items()
        if not key.startswith(MUTABLE_KEYS)
        or ".distribution" in key
        or key.endswith(".relative")
        or (whole and key == "study.design.num")
    }


def study_id(values: Mapping[str, Any]) -> str:
    """Digest of what all rows of a folder share: configuration and code."""
    return store.digest([immutable_settings(values), provenance.code_version()])


def labels_id(values: Mapping[str, Any]) -> str:
    """Digest of how rows are judged: thresholds and code."""
    return store.digest([values["outcome"], provenance.code_version()])


def run(job: Job, progress: Progress, dispatch: Dispatch = map) -> Job:
    """Simulate what is missing, here or as `dispatch` hands it out; a batch is on disk as soon as it is done.

    Where a device's memory is too small, the batches that it cannot hold are planned anew at half the width; the job
    as it ended. Raises `Fault` where disk, memory or workers fail.
    """
    folder, exp, found = job.folder, job.exp, RunRecord()
    if path_in(folder, store.STUDY).exists():
        stored = store.read_study(folder)
        found = RunRecord(stored["stages"], stored["devices"])
        if stored["labels"] != job.labels:
            relabel(folder, exp.values["outcome"])
    write_description(job, found)
    while missing := job.missing():
        store.write_points(folder, job.table)
        tight: list[FinishedBatch] = []  # batches that found too little memory
        work = partial(simulate_on_worker, folder.resolve(), uuid4().hex, provenance.code_version())
        for done in dispatch(work, iter_batches(job, missing, found, tight)):
            if done.entry is None:
                tight.append(done)
                continue
            rows = accept_part(job, done, done.entry)
            if done.device not in found.devices:
                found.devices.append(done.device)
                write_description(job, found)
            where = f"{done.host}, {done.device}"
            store.log(folder, f"batch {done.batch}: {len(rows)} rollouts, {rows['wall_s'].sum():.1f} s on {where}")
            progress(rows)
        if tight:
            job = halve_width(job, tight)
    repair.merge_small_parts(folder, job.table)
    return job


def accept_part(job: Job, done: "FinishedBatch", entry: Entry) -> pd.DataFrame:
    """What is told of the rows that a worker wrote; from now on they count.

    Raises `Fault` where they are not those asked for.
    """
    if not all(path_in(job.folder, one.file).exists() for one in (entry, *done.recordings)):
        raise Fault(f"{done.host} wrote batch {done.batch} to {job.folder.resolve()}, which is not seen here")
    if (entry.study, entry.labels) != (job.study, job.labels) or {one.study for one in done.recordings} - {job.study}:
        raise Fault(f"{done.host} simulated batch {done.batch} of another study, or judged it by other thresholds")
    rows = store.read_table(job.folder, entry, PROGRESS_COLUMNS).to_pandas()
    manifest.add(job.folder, *limit_last_states(job.folder, done.recordings), entry)
    return rows


def limit_last_states(folder: Path, beside: tuple[Entry, ...]) -> list[Entry]:
    """Those of `beside` that are to be kept: workers that do not know of each other may find too many invalid rows."""
    last = [entry for entry in beside if entry.file.startswith(f"{store.LAST_STATES}/")]
    room = time_series.INVALID_ROWS - len(store.list_recordings(folder, store.LAST_STATES)) if last else 0
    for entry in last[room:]:
        path_in(folder, entry.file).unlink(missing_ok=True)
    return [entry for entry in beside if entry not in last[room:]]


def iter_batches(
    job: Job, missing: list[int], record: RunRecord, out_of_memory: Collection["FinishedBatch"]
) -> Iterator[int]:
    """`missing` batches, each group described before its first; those in the group and width of `tight` are left out.

    An impossible plan is thus refused here, before a worker sees it.
    """
    for _, rows in job.rows(missing).groupby(["group", "width"], sort=False):
        group, width = (int(rows[name].iloc[0]) for name in ("group", "width"))
        start = make_nominal_batch(job.exp, rows, width)
        engine = make_engine(job.exp, start)
        record.stages[group] = list(engine.stages)
        write_description(job, record)
        how = f"{start.settings}, {engine.dynamics} dynamics"
        store.log(job.folder, f"group {group}: {how}, {len(rows)} rollouts of {engine.duration:g} s")
        for number in rows["batch"].unique().tolist():
            if not (out_of_memory and rows["batch"].isin([done.batch for done in out_of_memory]).any()):
                yield number


def halve_width(job: Job, out_of_memory: list["FinishedBatch"]) -> Job:
    """`job` with the missing batches in the group and width of `tight` planned anew, at half the width."""
    crowded = job.rows([done.batch for done in out_of_memory])[["group", "width"]].drop_duplicates()
    left = job.table[~job.table["batch"].isin(store.finished_batches(job.folder))]
    batches = left.merge(crowded, on=["group", "width"])["batch"].unique().tolist()
    table = halve_batches(job.table, batches, out_of_memory[0].devices)
    for done in out_of_memory:
        store.log(job.folder, f"batch {done.batch}: too little memory on {done.host}, {done.device}; half the width")
    asked = job.table["batch"].isin(job.wanted)
    return replace(job, table=table, wanted=set(table.loc[asked, "batch"]))


@dataclass(frozen=True)
class FinishedBatch:
    """What a worker tells of a batch; its rows are on disk."""

    batch: int
    host: str
    device: str
    devices: int  # that share a batch
    entry: Entry | None  # None where there was too little memory
    recordings: tuple[Entry, ...] = ()  # histories and last states


def simulate_on_worker(folder: Path, version: str, code: str, number: int) -> FinishedBatch:
    """Simulate one batch of the study in `folder`. `version` names its present plan.

    The rows count when the command that asked for them lists them. Raises `InputError` where the worker's code is not
    `code`, `Fault` where the part cannot be written.
    """
    host = socket.gethostname()
    if (here := provenance.code_version()) != code:
        raise InputError(f"worker {host} has another version of the code or of its libraries: {here}, not {code}")
    job = _plan_of(folder, version)
    rows = job.rows([number])
    start = make_nominal_batch(job.exp, rows, int(rows["width"].iloc[0]))
    engine = make_engine(job.exp, start)
    entry, beside = None, ()
    try:
        finished, table = simulate_batch(job.exp, engine, rows)
        # by what the rows were judged by, whatever the command believes by now
        entry = store.write_part(folder, finished, job.study, job.labels)
        beside = time_series.write(
            folder, job.study, number, table, last_states_of_invalid_rows(job, engine, rows, finished)
        )
    except MemoryError:
        pass
    if entry is None:  # after the handler, whose error holds on to the arrays
        forget_engine()
    return FinishedBatch(number, host, job.exp.system.device(start.settings), engine.devices, entry, beside)


def last_states_of_invalid_rows(
    job: Job, engine: Engine, rows: pd.DataFrame, finished: pd.DataFrame
) -> list[pd.DataFrame]:
    """The last states of a batch's invalid rows, as long as the folder has few of them, listed yet or not."""
    if not (finished["outcome"] == INVALID).any():
        return []
    room = time_series.INVALID_ROWS - len(list(path_in(job.folder, store.LAST_STATES).glob("*.parquet")))
    try:
        return (
            time_series.simulate_last_states(job.exp, engine, make_batch(job.exp, rows), finished, room)
            if room > 0
            else []
        )
    except MemoryError:  # the rows are there all the same
        return []


@lru_cache(maxsize=1)
def _plan_of(folder: Path, version: str) -> Job:
    table = store.read_points(folder)
    return Job(with_delay_buffer(experiment(store.read_study(folder)["config"]), table), folder, table, set())


def write_description(job: Job, record: RunRecord) -> None:
    """Write what the folder holds: study.yaml."""
    about = {"config": job.exp.values, "rollouts": len(job.table) + job.unplanned, "labels": job.labels}
    there = {"stages": record.stages, "devices": record.devices, **provenance.version_record()}
    store.write_study(job.folder, about | there)


def simulate_batch(exp: Experiment, engine: Engine, rows: pd.DataFrame) -> tuple[pd.DataFrame, pd.DataFrame | None]:
    """The finished rows of one batch: points, figures, outcome, and the wall time of a rollout (s); and histories."""
    task, slots, samples = make_batch(exp, rows), time_series.recorded_slots(exp, rows), None
    watched = time_series.make_watch(exp, task.settings)
    start = time.perf_counter()
    if len(slots):
        figures, samples = engine.histories(task.world, task.belief, task.streams, slots, watched)
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
    """One batch that is not stored, such as a nominal rollout. Raises `InputError` where its plan is impossible."""
    exp = replace(exp, settings=replace(exp.settings, width=exp.settings.width or 1))
    table = assign_batches(exp, pd.DataFrame(), select_points(exp))
    return with_delay_buffer(exp, table), table


def run_single_batch(exp: Experiment) -> pd.DataFrame:
    """Rows of one batch that is not stored. Raises `Fault` where the device cannot hold them."""
    exp, table = prepare_single_batch(exp)
    start = make_nominal_batch(exp, table, exp.settings.width)
    try:
        return simulate_batch(exp, make_engine(exp, start), table)[0]
    except MemoryError:
        raise Fault("a rollout does not fit in the memory of the device") from None


def relabel(folder: Path, outcome: Mapping[str, Any]) -> None:
    """Derive the outcomes of all stored rows from their figures by the thresholds `outcome`, without simulating.

    The new rows lie beside the old ones until study.yaml names their labels: all are judged anew, or none.
    """
    stored = store.read_study(folder)
    config = {**stored["config"], "outcome": dict(outcome)}
    exp, labels = experiment(config), labels_id(config)
    before = store.current_parts(folder)
    if labels == stored["labels"]:
        return
    repair.remove_parts(
        folder, [e for e in manifest.read(folder) if e.batches and e not in before]
    )  # of one that was killed
    for entry in before:
        rows = store.read_part(folder, entry)
        figures = {name: rows[name].to_numpy() for name in figure_columns(rows)}
        judged = exp.system.judge(figures, exp.thresholds, tuple(stored["stages"][int(rows["group"].iloc[0])]))
        manifest.add(folder, store.write_part(folder, rows.assign(**judged), entry.study, labels))
    store.write_study(folder, {**stored, "config": config, "labels": labels})
    repair.remove_parts(folder, before)


def load_point(folder: Path, point: str) -> tuple[Batch, int, pd.Series]:
    """The batch that `point` (a row number or the start of a point id) was simulated in, its slot, its row.

    Running the same batch again on the same device gives the same bits. Raises `InputError`.
    """
    table = store.read_points(folder)
    row = store.find_row(store.read_rows(folder), point, folder)
    exp = with_delay_buffer(experiment(store.read_study(folder)["config"]), table)
    return make_batch(exp, table[table["batch"] == row["batch"]]), int(row["slot"]), row

"""Run an experiment whose configuration is checked: runner, progress and summary of `sweep run`."""

import sys
import time
from collections.abc import Iterable
from dataclasses import dataclass, replace
from pathlib import Path

import pandas as pd

from sweep.analysis import power, rare
from sweep.analysis.expectations import unmet_expectations
from sweep.analysis.sample import drop_repeated_rollouts, pooled_success_rate
from sweep.analysis.stats import format_cause_counts, success_rate
from sweep.cli import live_page
from sweep.cli.exits import DONE, INVALID, UNEXPECTED
from sweep.cli.run_progress import report_progress
from sweep.config.experiment import Experiment, build_experiment, compose_values
from sweep.core import terminal
from sweep.core.errors import Fault, InputError
from sweep.core.files import path_inside_folder
from sweep.core.progress import (
    format_compile_estimate,
    format_last_duration,
    format_running_parts,
    show_elapsed_time,
    show_progress_counts,
    store_step_duration,
)
from sweep.report import tables
from sweep.report.headline import study_headline
from sweep.runs import adaptive_rounds, axis_check, axis_effects, refine, results, runner, store, time_series
from sweep.runs.batches import make_engine
from sweep.runs.batches import make_nominal_batch as nominal_batch
from sweep.runs.nominal_levels import FailingLevel, find_failing_levels
from sweep.runs.results import Results
from sweep.runs.unsearched_values import describe_values_outside_tuned_range
from sweep.study.clusters import WorkerStatus, connect_lazily
from sweep.study.study import attach_axis_names, parameter_columns, unit_of_column, validate_expectations
from sweep.systems import find_kind_by_config_keys

JITTER_STUDY = ["study=any_jitter"]  # sixteen rollouts that differ by 1e-6
MAX_CHANGED_SHARE = 0.2  # share of them that may end otherwise than the scenario expects


@dataclass(frozen=True)
class RunFlags:
    """Flags of `sweep run` that Hydra does not receive, such as `--check`."""

    dry_run: bool = False
    check: bool = False
    limit: int | None = None
    where: str | None = None
    report: bool = False


def execute_experiment(exp: Experiment, flags: RunFlags) -> int:
    """Run an experiment as a study or a single rollout, print its summary, and return the exit code.

    Args:
        exp: checked experiment.
        flags: flags of the command line.

    Returns:
        Exit code, see `sweep run --help`.

    Raises:
        InputError: flags do not fit the experiment, or the folder belongs to another study.
    """
    if exp.study.single:
        for flag, value in (("--limit", flags.limit), ("--where", flags.where)):
            if value is not None:
                raise InputError(f"{flag} = {value} selects points of a study: give study=NAME, or leave it out")
        if flags.check:
            raise InputError("--check tests the axes of a study: give study=NAME")
        if flags.report:
            raise InputError("--report writes the page of a study: give study=NAME")
    if exp.study.single and not exp.out:
        return execute_single_rollout(exp, flags)
    folder = exp.folder
    if not flags.check:  # which writes nothing
        store.refuse_foreign_folder(folder)
    whole = flags.where is None and flags.limit is None
    # ids tell which points a folder has, or which are left out; nothing else of a dry run needs them
    with_ids = not flags.dry_run or not whole or bool(exp.study.where or exp.study.points)
    with_ids = with_ids or not store.read_points(folder, ["batch"]).empty
    first = runner.select_points_to_simulate(
        exp, flags.where, flags.limit, lambda line: print(f"sweep: {line}", file=sys.stderr), with_ids
    )
    if not flags.check:  # which judges nothing by outcomes
        validate_expectations(exp.study, exp.system, first)
    if exp.study.is_refined:
        refine.check_refinable(exp.study, first)
    if line := exp.study.design.precision_warning:
        print(f"sweep: {line}", file=sys.stderr)
    if flags.dry_run:
        job = runner.prepare_job(exp, folder, first)
        for line in runner.describe_changed_axes(exp, folder):
            print(f"sweep: {line}", file=sys.stderr)
        # without earlier points the table of the job has them, with their width
        points = job.table if len(job.table) == len(first) else first.assign(width=job.table["width"].iloc[0])
        with show_elapsed_time("tracing which axes enter the simulation"):
            ineffective = axis_effects.describe_unread_axes(exp, points)
        unsearched = describe_values_outside_tuned_range(exp, first)
        lines = [describe_dry_run(job), *unsearched, *ineffective, *map(str, find_failing_axis_levels(exp))]
        terminal.print_markdown("\n".join(lines) + "\n")
        return DONE
    if flags.check:
        return check_axes_and_repeatability(exp, first)

    def say(line: str) -> None:
        print(f"sweep: {line}", file=sys.stderr)
        store.append_to_log(folder, line)

    watched = WorkerStatus(say)
    with store.lock_folder(folder), connect_lazily(exp.cluster, watched) as dispatch:
        for line in runner.repair_folder(exp, folder):
            say(line)
        page_process = live_page.start_page_process(folder) if flags.report else None
        done, start, to_do = 0, time.perf_counter(), iterate_study_jobs(exp, folder, first, whole)
        for line in runner.describe_changed_axes(exp, folder):
            say(line)
        failing = None
        for job in to_do:
            todo = len(job.points_of_batches(job.missing_batches()))
            if todo and failing is None:
                failing = find_failing_axis_levels(exp)
            with report_progress(exp.study.name, todo, describe_compiled_program(exp), watched) as report:
                job = runner.run_job(job, report, dispatch)
            done += todo
        seconds = time.perf_counter() - start
        if not done:
            print("no rollouts left to run", file=sys.stderr)
        else:
            print(f"{done} rollouts in {seconds:.1f} s ({done / seconds:.1f} a second)", file=sys.stderr)
        rows, stored = attach_axis_names(store.read_rows(folder), exp.study.axes), store.read_study(folder)
        size, used = stored["rollouts"], stored["devices"]
        complete = len(rows) == size and (whole or not exp.study.is_sequential)
    if len(used) > 1:
        print(
            f"sweep: rows come from {' and '.join(used)}; equal rollouts may differ in the last bit between them",
            file=sys.stderr,
        )
    with show_elapsed_time("looking for axes without an effect"):
        ineffective = axis_effects.describe_ineffective_axes(exp, rows)
    notes = (*describe_values_outside_tuned_range(exp, first), *ineffective, *(failing or ()))
    terminal.print_markdown("\n".join([summarize_study(exp, rows), *(f"  {line}" for line in notes)]) + "\n")
    if exp.study.is_refined:
        print("\n".join(f"refined: {one}" for one in refine.summarize_panels(exp, rows)))
    if exp.study.is_adaptive and complete:
        print(rare.estimate_failure_probability(rows, exp))
    print(f"{len(rows)} of {size} planned rollouts are in {folder}")
    if complete and exp.study.replays:
        record_study_replays(exp, folder, rows)
    if page_process:
        page_process.wait()  # which may write a page without the replays
        print(write_study_page(folder))
    return report_unmet_expectations(exp, rows, complete)


def record_study_replays(exp: Experiment, folder: Path, rows: pd.DataFrame) -> None:
    """Record replays of the most informative rollouts that have none yet, and print what they took.

    A study whose replays cannot be recorded is complete all the same: the reason is printed.

    Args:
        exp: Experiment of the study.
        folder: Its folder.
        rows: All its rows, with the names of their axes.
    """
    if exp.cluster.is_remote:  # this machine may have no device of the workers' kind
        print(
            f"sweep: no replays are recorded on a cluster: sweep report {folder} --replays {exp.study.replays}",
            file=sys.stderr,
        )
        return
    from sweep.report import recording  # imports Matplotlib, which no run waits for before its end

    start = time.perf_counter()
    sys.stdout.flush()  # the summary, before some seconds of simulation
    chosen, copies = drop_repeated_rollouts(rows, exp)
    recorded = Results(folder, store.read_study(folder), exp, chosen, None, len(rows), copies)

    def words(done: int, total: int) -> str:
        return f"{done} of {total} replays recorded; study.replays=0 records none"

    try:
        with store.lock_folder(folder), show_progress_counts(words, 0, exp.study.replays) as report:
            number = recording.record_replays(recorded, report)
    except (InputError, Fault, MemoryError) as error:
        print(f"sweep: no replays recorded: {error or 'not enough memory'}", file=sys.stderr)
        return
    if number:
        print(f"{number} replays recorded in {time.perf_counter() - start:.1f} s (study.replays)", file=sys.stderr)


def write_study_page(folder: Path) -> Path:
    """Write the page of a study into its folder, as `sweep report` does, and return its path."""
    from sweep.report import page  # imports Matplotlib, see above

    return page.write_page(
        results.read_results(folder, with_bookkeeping=False), path_inside_folder(folder, "report.html")
    )


def find_failing_axis_levels(exp: Experiment) -> list[FailingLevel]:
    """List the names on categorical axes, such as gaits, whose nominal rollout fails; prints progress while it
    simulates."""
    with show_elapsed_time(f"simulating the nominal rollout of each name that {exp.study.name} lists"):
        return find_failing_levels(exp)


def check_axes_and_repeatability(exp: Experiment, points: pd.DataFrame) -> int:
    """Check by simulation whether every axis has an effect and rollouts are repeatable; exit code 4 if not."""

    def words(done: int) -> str:
        return f"{exp.study.name}: {done} rollouts simulated to check that its axes have an effect"

    with show_progress_counts(words, 0) as told:
        found = axis_check.run_axis_check(exp, points, told)
    for line in found.format_lines(exp):
        print(f"sweep: {line}", file=sys.stderr)
    dead = len({one.column for one in found.inactive if one.is_entire_axis})
    print(f"{exp.study.name}: {found.axes - dead} of {found.axes} axes have an effect (in {found.rollouts} rollouts)")
    return DONE if found.is_sound else UNEXPECTED


def iterate_study_jobs(exp: Experiment, folder: Path, first: pd.DataFrame, whole: bool) -> Iterable[runner.Job]:
    """Yield the jobs (batches to simulate) of a study: one for each round if results decide what runs next, or one."""
    if whole and exp.study.is_refined:
        return refine.iter_jobs(exp, folder, first)
    return (
        adaptive_rounds.iter_jobs(exp, folder)
        if whole and exp.study.is_adaptive
        else [runner.prepare_job(exp, folder, first)]
    )


def execute_single_rollout(exp: Experiment, flags: RunFlags) -> int:
    """Simulate one nominal rollout and print its outcome and metrics.

    On the native engine, whose last bits differ between hosts, expectations are judged by jittered rollouts.
    """
    if exp.study.keep:
        raise InputError("study.keep stores time series in a study's folder: give study=NAME or out=DIR")
    validate_expectations(exp.study, exp.system)
    if flags.dry_run:
        runner.prepare_single_batch(exp)
        print(
            f"{exp.scenario}: 1 rollout on {exp.settings.name}, "
            f"{format_compile_estimate(describe_compiled_program(exp))}"
        )
        return DONE
    what, start = describe_compiled_program(exp), time.perf_counter()

    def words() -> str:
        return f"compiling {what}, then simulating{format_last_duration(what)}{format_running_parts(what)}"

    with show_elapsed_time(words):
        rows = runner.run_single_batch(exp)
    store_step_duration(what, time.perf_counter() - start)
    terminal.print_markdown(tables.rollout_table(exp, rows.iloc[0]))
    if exp.study.expect and exp.settings.name == "native" and (other := add_parameter_jitter(exp)):
        with show_elapsed_time(
            f"simulating {exp.scenario} {other.study.max_rollouts} times to judge its expectations on the native engine"
        ):
            exp, rows = other, runner.run_single_batch(other)
        print(f"sweep: with perturbations of 1e-6, {pooled_success_rate(rows, exp)}", file=sys.stderr)
    return report_unmet_expectations(exp, rows, complete=True)


def add_parameter_jitter(exp: Experiment) -> Experiment | None:
    """Return the experiment with small random errors on its parameters (study `jitter`); None for other systems than
    the hexapod."""
    values = compose_values(JITTER_STUDY)
    if find_kind_by_config_keys(values) is not find_kind_by_config_keys(exp.values):
        return None
    of = build_experiment({**exp.values, "study": {**values["study"], "name": f"{exp.scenario}_jitter"}})
    expect = tuple(
        replace(
            one, at_least=max(0.0, one.at_least - MAX_CHANGED_SHARE), at_most=min(1.0, one.at_most + MAX_CHANGED_SHARE)
        )
        for one in exp.study.expect
    )
    return replace(
        of, study=replace(of.study, expect=expect), settings=replace(of.settings, width=of.study.max_rollouts)
    )


def report_unmet_expectations(exp: Experiment, rows: pd.DataFrame, complete: bool) -> int:
    """Print a line for each unmet expectation of a study, and return the exit code."""
    found = success_rate(rows["outcome"])
    if found.invalid_share > exp.study.invalid_max:
        allowed = f"{exp.study.invalid_max:.1%} allowed"
        print(f"sweep: {found.invalid} of {found.total} rollouts are invalid, {allowed}", file=sys.stderr)
        return INVALID
    if exp.study.expect and not complete:
        print("sweep: expectations are checked when the whole study is done", file=sys.stderr)
        return DONE
    lines = unmet_expectations(exp.study.expect, rows, exp)
    for line in lines:
        print(f"sweep: {line}", file=sys.stderr)
    return UNEXPECTED if lines else DONE


def summarize_study(exp: Experiment, rows: pd.DataFrame) -> str:
    """Summarise a study as text: headline, causes, and success rates by categorical parameter.

    Repeated noise-free rollouts count once.
    """
    rows, copies = drop_repeated_rollouts(rows, exp)
    lines = [f"{exp.study.name}: {study_headline(rows, exp)}"]
    lines += [f"  {line}" for line in format_cause_counts(rows["cause"], exp.system.cause_meanings(exp.thresholds))]
    lines += [f"  {copies}"] if copies else []
    for column in parameter_columns(rows):
        if rows[column].dtype.kind != "f" and rows[column].nunique() > 1 and not exp.study.is_adaptive:
            lines += [f"  {column} = {value}: {pooled_success_rate(part, exp)}" for value, part in rows.groupby(column)]
    return "\n".join(lines)


def describe_dry_run(job: runner.Job) -> str:
    """Describe what a run would do: rollouts, batches, memory, and the time if an earlier batch is known."""
    missing = job.points_of_batches(job.missing_batches())
    first_rows = ~missing["batch"].duplicated().to_numpy()  # of each batch
    sizes = missing.loc[first_rows, ["group", "width"]].groupby(["group", "width"]).size()
    parts = [f"{count} batch{'es' * (count > 1)} of {width}" for (_, width), count in sizes.items()]  # pyright: ignore[reportGeneralTypeIssues]
    text = f"{job.exp.study.name}: {len(missing)} of {len(job.table)} rollouts to run ({', '.join(parts) or 'none'})"
    if len(missing):
        text += f"{describe_memory_per_rollout(job, missing)}, {describe_expected_duration(job, missing)}, "
        text += format_compile_estimate(describe_compiled_program(job.exp))
    if count := time_series.check_history_size(job.exp, job.table):
        kept, columns = min(job.exp.study.keep_rows, len(job.table)), ", ".join(job.exp.study.keep)
        text += f"\ntime series of {kept} rollouts ({columns}): about {4 * count / 2**20:.1f} MiB before compression"
    if width := power.describe_expected_half_width(job.exp.study):
        text += f"\n{width}"
    return f"{text}\n{axes_table(job.exp)}" if job.exp.study.axes and not job.exp.study.points else text


def describe_memory_per_rollout(job: runner.Job, missing: pd.DataFrame) -> str:
    """Describe the memory that one rollout needs, as text."""
    start = nominal_batch(job.exp, missing.iloc[:1], int(missing["width"].iloc[0]))
    size = make_engine(job.exp, start).rollout_bytes()
    return f", {size / 1024:.1f} KiB of memory per rollout" if size else ""


def describe_expected_duration(job: runner.Job, missing: pd.DataFrame) -> str:
    """Describe how long `missing` rollouts will take, from the last batch of this or a similar study."""
    beside = sorted(job.folder.parent.glob(f"*/{store.STUDY_FILE}"), key=lambda p: p.stat().st_mtime, reverse=True)
    for folder in (job.folder, *(path.parent for path in beside)):
        if (seconds := seconds_per_rollout(folder, job)) is not None:
            return f"about {len(missing) * seconds:.0f} s at the speed of {folder}"
    return f"time unknown until a first batch has run; try --limit {missing['width'].iloc[0]}"


def seconds_per_rollout(folder: Path, job: runner.Job) -> float | None:
    """Wall time per rollout (s) in the last batch of `folder`; None unless scenario, engine and device are the same."""
    try:
        stored = store.read_study(folder)
        config, exp = stored["config"], job.exp
        same = (config["scenario"]["name"], config["engine"]["name"]) == (exp.scenario, exp.settings.name)
        same &= exp.system.device(exp.settings) in stored["devices"]
    except (InputError, KeyError):  # damaged, or of an earlier layout
        return None
    return store.last_rollout_wall_time_s(folder) if same else None


def axes_table(exp: Experiment) -> str:
    """Return a Markdown table of the study's axes: parameter, side (world or belief), values, unit, nominal value."""
    lines = [
        [
            axis.name,
            axis.path or "",
            axis.side if axis.path else "",
            str(axis),
            unit_of_column(axis.path, exp.system, exp.settings) if axis.path else "",
            exp.system.nominal_parameter_value(axis.path, exp.settings) if axis.path else "",
        ]
        for axis in exp.study.axes
    ]
    table = pd.DataFrame(lines, columns=["axis", "parameter", "side", "values", "unit", "nominal"])
    return table.to_markdown(index=False, disable_numparse=True)


def describe_compiled_program(exp: Experiment) -> str:
    """Describe the program that is compiled before the first batch: system, engine and device."""
    kind = exp.settings.name if exp.study.single else f"batches of {exp.study.name} on {exp.settings.name}"
    return f"{exp.scenario} for {kind}"

"""Simulate what `sweep view` shows, one rollout or two side by side, and play it in MuJoCo's viewer."""

import os
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pandas as pd

from sweep.config.experiment import Experiment, compose
from sweep.contract.engine import Trace
from sweep.contract.trace_frames import count_finite_frames
from sweep.core import provenance
from sweep.core.errors import InputError
from sweep.core.progress import show_elapsed_time
from sweep.report import replays
from sweep.report.page.replay_data import ShownReplay, read_shown_replays
from sweep.runs import batches, device_choice, results, runner, store
from sweep.runs.results import Results

VIEWER_FRAME_RATE, LOOP_PAUSE_S = 60.0, 1.0  # frames per second in MuJoCo's viewer, and s before it begins again


def play_in_viewer(trace: Trace) -> None:
    """Play the trace in MuJoCo's viewer in a loop until its window is closed."""
    import mujoco.viewer

    data, frames = mujoco.MjData(trace.model), count_finite_frames(trace)
    with mujoco.viewer.launch_passive(trace.model, data) as window:
        while window.is_running():
            start = time.perf_counter()
            for k in range(frames):
                if not window.is_running():
                    return
                data.qpos[:], data.time = trace.qpos[k], trace.time[k]
                mujoco.mj_forward(trace.model, data)
                window.sync()
                time.sleep(max(0.0, trace.time[k] - (time.perf_counter() - start)))
            time.sleep(LOOP_PAUSE_S)


def list_file_names(folder: str) -> list[str]:
    """Return the names of the files in a folder; empty if the folder does not exist."""
    return os.listdir(folder) if os.path.isdir(folder) else []


def record_traces(target: list[str]) -> Iterator[Trace]:
    """Simulate the rollouts that the user names and record traces at a frame rate for smooth playback. Raises
    `InputError`."""
    if store.STUDY_FILE in list_file_names(target[0]):
        found, at = find_point_row(*parse_folder_and_point(target))
        device_choice.choose_device_for_folder(found.folder)
        again = replays.resimulate_rows(
            found.exp, found.rows.iloc[[at]], store.read_points(found.folder), VIEWER_FRAME_RATE
        )
    else:
        exp, planned = compose_single_rollout(target)
        again = replays.resimulate_rows(exp, planned, planned, VIEWER_FRAME_RATE)
    return (trace for _, trace, _ in again)


def read_results_and_replays(target: list[str], beside: list[str]) -> tuple[Results, list[ShownReplay]]:
    """Read a study's results and its replays, beginning with the rollouts that the user names. Raises `InputError`."""
    folder, point = parse_folder_and_point(target)
    found, first = find_point_row(folder, point)
    wanted = [(found, first, "")]
    if beside:
        other = beside[0] if store.STUDY_FILE in list_file_names(beside[0]) else folder
        named = beside[-1] if len(beside) > 1 or other == folder else str(found.rows["point_id"].iloc[first])
        wanted.append((*find_point_row(other, named), "" if other == folder else str(other)))
    shown = []
    for of, at, title in wanted:
        row = of.rows.iloc[at]
        if not replays.replay_path(of.folder, row).exists():
            device_choice.choose_device_for_folder(of.folder)
            with show_elapsed_time(f"simulating {row['point_id']} of {of.folder} again"):
                replays.make_replays(of, of.rows.iloc[[at]].assign(why=""))
        if not (kept := replays.read_replay(of.folder, row)):
            raise InputError(
                f"{row['point_id']} of {of.folder} has another outcome on this machine, or ends at once: "
                "sweep replay shows how"
            )
        shown.append(ShownReplay(at if of.folder == found.folder else -1, row, kept, title))
    seen = {one.row["point_id"] for one in shown}
    return found, [*shown, *(one for one in read_shown_replays(found) if one.row["point_id"] not in seen)]


def parse_folder_and_point(target: list[str]) -> tuple[str, str]:
    """Parse two arguments into a results folder and a point of it. Raises `InputError` if there are not two."""
    if len(target) != 2:
        raise InputError(f"{target[0]} is a study: add a row number, or the beginning of a point_id")
    return target[0], target[1]


def find_point_row(folder: str, point: str) -> tuple[Results, int]:
    """Read a results folder, and find the row index of a point in it. Raises `InputError`."""
    found = results.read_results(Path(folder))
    row = store.find_row(store.read_rows(Path(folder)), point, Path(folder))
    return found, int((found.rows["point_id"] == row["point_id"]).to_numpy().argmax())


def simulate_configuration(overrides: list[str], beside: list[str]) -> tuple[Results, list[ShownReplay]]:
    """Simulate one rollout of a configuration, and optionally a second one with other values. Raises `InputError`."""
    rows, shown = [], []
    exp, stages = None, {}
    for words in [overrides, [*overrides, *beside]][: 1 + bool(beside)]:
        one, planned = compose_single_rollout(words)
        exp = exp or one
        with show_elapsed_time(f"simulating {' '.join(words)}"):
            found = next(replays.resimulate_rows(one, planned, planned), None)
        if found is None:
            raise InputError(f"{one.scenario} cannot be shown")
        row, trace, labels = found
        row = pd.concat([row, pd.Series({**labels, **trace.metrics, "wall_s": 0.0})])
        if not len(trace.time):
            raise InputError(f"{one.scenario} ends at once: {row['cause']}")
        stages[str(len(rows))] = list(trace.stages)
        shown.append(
            ShownReplay(
                len(rows),
                row,
                replays.replay_content(row, trace),
                " ".join(words[len(overrides) :]) or one.scenario,
            )
        )
        rows.append(row)
    assert exp is not None
    about = {
        "config": exp.values,
        "rollouts": len(rows),
        "stages": stages,
        "devices": [exp.system.device(exp.settings)],
        **provenance.version_record(),
    }
    table = pd.DataFrame(rows).infer_objects().reset_index(drop=True)
    return Results(Path(exp.scenario), about, exp, table, None, len(rows)), shown


def compose_single_rollout(overrides: list[str]) -> tuple[Experiment, pd.DataFrame]:
    """Compose the experiment of a single rollout and its one-row table of points. Raises `InputError` for a study."""
    exp = compose(overrides)
    if not exp.study.single:
        raise InputError(f"{exp.study.name} is a study: run it, then sweep view DIR ID shows one of its rows")
    device_choice.choose_device_for_run(exp)
    exp = replace(exp, settings=replace(exp.settings, width=exp.settings.width or 1))
    return exp, batches.assign_batches(exp, pd.DataFrame(), runner.select_points_to_simulate(exp))

"""`sweep replay DIR POINT`: simulate one stored rollout again and show it."""

import argparse
from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.backend_bases import FigureCanvasBase
from tabulate import tabulate

from sweep.config.experiment import build_experiment
from sweep.contract.engine import Trace, same_bits
from sweep.contract.engine_settings import EngineSettings
from sweep.contract.system import judge_rollout
from sweep.core.arguments import Arguments
from sweep.core.files import write_atomically
from sweep.core.parameters import InputError
from sweep.core.plot_style import save_figure
from sweep.core.progress import show_counts, show_wait
from sweep.engines.states import available_columns
from sweep.models import scene
from sweep.models.case import Case
from sweep.replay.mcap import write_mcap
from sweep.replay.plots import PLOTS
from sweep.replay.rendering import VIDEO_RATE, require_ffmpeg, write_png, write_video
from sweep.replay.sampling import frames_at_rate
from sweep.runs import device_choice, results, store
from sweep.runs.batches import make_engine, make_nominal_batch, with_delay_buffer
from sweep.runs.runner import load_point
from sweep.study.columns import LABELS
from sweep.study.study import parameter_columns

FORMAT_OPTIONS = ("mcap", "states", "model", "plot", "png", "video")  # options that a system may not support


@dataclass(frozen=True)
class Replay:
    """A stored rollout and its replay."""

    stored: pd.Series  # row of the stored rollout
    again: Mapping[str, Any]  # metrics and outcome of the new rollout
    trace: Trace  # states, forces, torques and stages of the new rollout over time
    settings: EngineSettings  # settings of the engine
    config: dict[str, Any]  # resolved configuration of the study, and the point's own values
    other_run: str | None  # a note where code, libraries or device differ from those of the stored row


def main(args: list[str]) -> int:
    """Run `sweep replay` with the arguments after the verb; return the exit status. Raises `InputError`."""
    options = _parser().parse_args(args)
    _check_options(options)
    system = results.load_experiment(options.folder).system
    for name in FORMAT_OPTIONS:
        if getattr(options, name) and name not in system.replay_formats:
            shown = ", ".join(f"--{one}" for one in sorted(system.replay_formats))
            raise InputError(
                f"--{name} is not allowed: rollouts of this system are shown by {shown}, and what study.keep keeps"
            )
    device_choice.choose_device_for_folder(options.folder)
    with show_wait(f"simulating {options.point} of {options.folder} in its batch"):
        result = replay(options.folder, options.point)
    print(format_comparison(result))
    for path in (options.mcap, options.video, options.output, options.states, options.model):
        if path is not None:
            path.parent.mkdir(parents=True, exist_ok=True)
    if options.mcap:
        outcome = {"point_id": result.stored["point_id"], **result.again}
        write_mcap(options.mcap, result.trace, result.config, outcome)
    if options.states:
        write_atomically(options.states, partial(state_table(result.trace).to_parquet, index=False))
    if options.model:
        write_atomically(options.model, model_xml(result.trace.world, result.settings).encode())
    for name in options.plot:
        beside = options.output.with_stem(f"{options.output.stem}-{name}")
        save_figure(PLOTS[name](result.trace), beside if len(options.plot) > 1 else options.output)
    came = str(result.again["cause"] or result.again["outcome"]).replace("_", " ")
    if options.png:
        write_png(options.png, result.trace, came)
    if options.video:
        pictures = len(frames_at_rate(result.trace, VIDEO_RATE))
        with show_counts(lambda done, of: f"{done} of {of} pictures drawn", 0, pictures) as report:
            write_video(options.video, result.trace, f"row {result.stored.name}", came, report)
    return 0


def replay(folder: Path, point: str) -> Replay:
    """Simulate a stored rollout again and record its trace.

    Its whole batch runs, because equal bits need equal neighbours in equal slots.

    Args:
        folder: Folder of the study.
        point: Row number, or the beginning of a point id.

    Returns:
        The stored row, the new one, and the trace.

    Raises:
        InputError: No row, or more than one, is meant; or the folder is damaged.
    """
    task, slot, row = load_point(folder, point)
    table, stored = store.read_points(folder), store.read_study(folder)
    config = stored["config"]
    exp = with_delay_buffer(build_experiment(config), table)
    start = make_nominal_batch(exp, table.loc[table["batch"] == row["batch"]], len(task.streams))
    engine = make_engine(exp, start)
    trace = engine.trace(task.world, task.belief, task.streams, slot)
    again = {**judge_rollout(exp.system, trace.metrics, exp.thresholds, engine.stages), **trace.metrics}
    values = {name: row[name] for name in (*parameter_columns(table), "replicate", "stream")}
    other_run = None
    if str(row["run_id"]) != exp.system.run_id(task.settings):
        then, here = " or ".join(stored["devices"]), exp.system.device(task.settings)
        other_run = f"the row was simulated with other code or libraries, or on another device ({then}; here {here})"
    return Replay(row, again, trace, task.settings, {**config, "point": values}, other_run)


def state_table(trace: Trace) -> pd.DataFrame:
    """Return a trace as a table: a row for each control tick, a column for each number of the state."""
    record = {name: np.moveaxis(getattr(trace, name), 0, -1) for name in ("qpos", "qvel", "joint_torque", "foot_force")}
    columns = {name: np.asarray(column(record)) for name, column in available_columns(trace.world).items()}
    return pd.DataFrame({"time_s": trace.time, "stage": [trace.stages[k] for k in trace.stage], **columns})


def model_xml(world: Case, settings: EngineSettings) -> str:
    """Return the world's MuJoCo model as MJCF, to six digits.

    The contact of the `mjx` engine is its own and not part of the model.

    Args:
        world: The simulated case.
        settings: Settings of the engine, which give the time step.
    """
    if settings.name == "native":
        spec = scene.native_spec(world, settings.native_time_step, settings.solid)
    else:
        spec = scene.build_spec(world)
        spec.option.timestep = settings.step
    spec.compile()
    return spec.to_xml()


def format_comparison(result: Replay) -> str:
    """Return a text with the stored outcome beside the new one, and all metrics that differ."""
    stored, again = result.stored, result.again
    figures = [name for name in result.trace.metrics if name in stored]
    changed = [name for name in figures if not same_bits(stored[name], again[name])]
    rows = [(name, _format_value(stored[name]), _format_value(again[name])) for name in (*LABELS[:4], *changed)]
    lines = [
        f"point {stored['point_id']}",
        tabulate(rows, headers=("", "stored", "replayed"), disable_numparse=True),
        f"{len(figures) - len(changed)} of {len(figures)} metrics are equal to the last bit",
    ]
    if result.other_run:
        lines.append(f"{result.other_run}: bits may differ")
    return "\n".join(lines)


def _format_value(value: Any) -> str:
    return value if isinstance(value, str) else f"{value:.9g}"


def _parser() -> Arguments:
    parser = Arguments(prog="sweep replay", description="Simulate one stored rollout again and show it.")
    parser.add_argument("folder", metavar="DIR", type=Path, help="result folder of a study")
    parser.add_argument("point", metavar="POINT", help="row number, or the beginning of a point_id")
    parser.add_argument("--mcap", metavar="FILE", type=Path, help="write a trace for Foxglove, and a layout beside it")
    parser.add_argument("--states", metavar="FILE", type=Path, help="write every tick's state as a Parquet table")
    parser.add_argument("--model", metavar="FILE", type=Path, help="write the MuJoCo model of these states as XML")
    parser.add_argument("--png", metavar="DIR", type=Path, help="write a few pictures")
    parser.add_argument("--video", metavar="FILE", type=Path, help="write an MP4 in real time")
    parser.add_argument("--plot", metavar="NAME", nargs="+", choices=PLOTS, default=[], help=", ".join(PLOTS))
    parser.add_argument("-o", "--output", metavar="FILE", type=Path, help="file of the plots (png, svg, pdf)")
    return parser


def _check_options(options: argparse.Namespace) -> None:
    """Refuse options that would fail after the simulation."""
    if bool(options.plot) != (options.output is not None):
        raise InputError("--plot NAME ... and -o FILE go together")
    kinds = FigureCanvasBase.get_supported_filetypes()
    if options.output and options.output.suffix[1:] not in kinds:
        raise InputError(f"-o {options.output} is not allowed: a file that ends in {', '.join(sorted(kinds))}")
    for option, ending in (("states", ".parquet"), ("model", ".xml")):
        path = getattr(options, option)
        if path and path.suffix != ending:
            raise InputError(f"--{option} {path} is not allowed: a file that ends in {ending[1:]}")
    if options.video:
        if options.video.suffix != ".mp4":
            raise InputError(f"--video {options.video} is not allowed: a file that ends in mp4")
        require_ffmpeg()

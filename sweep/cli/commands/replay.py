"""`sweep replay`: simulate one stored rollout again and record it."""

import argparse
import time
from functools import partial
from importlib.util import find_spec
from pathlib import Path

from sweep.cli.command import Command, Section
from sweep.cli.exits import DONE
from sweep.core.arguments import Arguments
from sweep.core.errors import InputError
from sweep.core.files import write_atomically

COMMAND = Command(Section.WATCH, "simulate one rollout of a study again and record it")
# names of the plots that a system may have, which are slow to import
REPLAY_PLOTS = ("torques", "joints", "base", "feet", "margin", "paths", "ball", "flywheel", "forces")
FORMAT_OPTIONS = ("mcap", "states", "model", "plot", "png", "video")  # options that a system may not support


def add_arguments(parser: Arguments) -> None:
    """Add the arguments of `sweep replay`: stored rollout, and files to write."""
    parser.description = "Simulate one stored rollout again and show it."
    parser.add_argument("folder", metavar="DIR", type=Path, help="result folder of a study")
    parser.add_argument("point", metavar="POINT", help="row number, or the beginning of a point_id")
    parser.add_argument("--mcap", metavar="FILE", type=Path, help="write a trace for Foxglove, and a layout beside it")
    parser.add_argument("--states", metavar="FILE", type=Path, help="write every tick's state as a Parquet table")
    parser.add_argument("--model", metavar="FILE", type=Path, help="write the MuJoCo model of these states as XML")
    parser.add_argument("--png", metavar="DIR", type=Path, help="write a few pictures")
    parser.add_argument("--video", metavar="FILE", type=Path, help="write an MP4 in real time")
    names = ", ".join(REPLAY_PLOTS)
    parser.add_argument("--plot", metavar="NAME", nargs="+", choices=REPLAY_PLOTS, default=[], help=names)
    parser.add_argument("-o", "--output", metavar="FILE", type=Path, help="file of the plots (png, svg, pdf)")


def run(args: argparse.Namespace) -> int:
    """Simulate the rollout, compare it with its row, and write what is asked for. Raises `InputError`."""
    check_options(args)
    from sweep.contract.trace_frames import frames_at_rate
    from sweep.core.plot_style import save_figure
    from sweep.core.progress import show_elapsed_time, show_progress_counts
    from sweep.replay.rendering import VIDEO_RATE, write_png, write_video
    from sweep.replay.replay import format_comparison_with_stored, replay_rollout, state_table
    from sweep.runs import device_choice, results

    system = results.load_experiment(args.folder).system
    for name in FORMAT_OPTIONS:
        if getattr(args, name) and name not in system.replay_formats:
            shown = ", ".join(f"--{one}" for one in sorted(system.replay_formats))
            raise InputError(
                f"--{name} is not allowed: rollouts of this system are shown by {shown}, and what study.keep keeps"
            )
    device_choice.choose_device_for_folder(args.folder)
    with show_elapsed_time(f"simulating {args.point} of {args.folder} in its batch"):
        result = replay_rollout(args.folder, args.point)
    print(format_comparison_with_stored(result))
    for path in (args.mcap, args.video, args.output, args.states, args.model):
        if path is not None:
            path.parent.mkdir(parents=True, exist_ok=True)
    if args.mcap:
        from sweep.replay.mcap import write_mcap

        outcome = {"point_id": result.stored["point_id"], **result.again}
        write_mcap(args.mcap, result.trace, result.config, outcome)
    if args.states:
        write_atomically(args.states, partial(state_table(system, result.trace).to_parquet, index=False))
    if args.model:
        write_atomically(args.model, system.model_xml(result.trace, result.settings).encode())
    for name in args.plot:
        beside = args.output.with_stem(f"{args.output.stem}-{name}")
        save_figure(system.replay_plots[name](result.trace), beside if len(args.plot) > 1 else args.output)
    came = str(result.again["cause"] or result.again["outcome"]).replace("_", " ")
    if args.png:
        write_png(args.png, result.trace, came)
    if args.video:
        pictures = len(frames_at_rate(result.trace, VIDEO_RATE))
        start = time.perf_counter()
        with show_progress_counts(
            lambda done, of: format_drawn(done, of, time.perf_counter() - start), 0, pictures
        ) as report:
            write_video(args.video, result.trace, f"row {result.stored.name}", came, report)
    return DONE


def format_drawn(done: int, of: int, elapsed_s: float) -> str:
    """Format how many pictures of a video are drawn, and how long the others will take.

    Args:
        done: Pictures drawn.
        of: Pictures in all.
        elapsed_s: Time that they took, s.
    """
    left = f", about {elapsed_s * (of - done) / done:.0f} s left" if done else ""
    return f"{done} of {of} pictures drawn{left}"


def check_options(args: argparse.Namespace) -> None:
    """Refuse options that would fail after the simulation."""
    if bool(args.plot) != (args.output is not None):
        raise InputError("--plot NAME ... and -o FILE go together")
    if args.output and args.output.suffix[1:] not in (kinds := picture_formats()):
        raise InputError(f"-o {args.output} is not allowed: a file that ends in {', '.join(sorted(kinds))}")
    for option, ending in (("states", ".parquet"), ("model", ".xml")):
        path = getattr(args, option)
        if path and path.suffix != ending:
            raise InputError(f"--{option} {path} is not allowed: a file that ends in {ending[1:]}")
    if args.mcap and find_spec("foxglove") is None:
        raise InputError("--mcap is not allowed: it needs Foxglove's SDK: pip install 'insect-sweep[mcap]'")
    if args.video:
        if args.video.suffix != ".mp4":
            raise InputError(f"--video {args.video} is not allowed: a file that ends in mp4")
        from sweep.replay.rendering import require_ffmpeg

        require_ffmpeg()


def picture_formats() -> dict[str, str]:
    """Endings of picture files that Matplotlib writes, with their meanings."""
    from matplotlib.backend_bases import FigureCanvasBase

    return FigureCanvasBase.get_supported_filetypes()

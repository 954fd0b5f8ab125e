"""`sweep view`: watch one rollout, or two side by side, on the page or in MuJoCo's viewer."""

import argparse
import os
import sys
import webbrowser
from pathlib import Path

from sweep.cli.command import Command, Section
from sweep.cli.exits import DONE
from sweep.core.arguments import Arguments
from sweep.core.errors import InputError
from sweep.core.files import path_inside_folder

COMMAND = Command(Section.WATCH, "play a rollout in the browser")
EPILOG = """examples:
  sweep view scenario=pole_climb contact.friction=0.5
  sweep view results/walk_map 42
  sweep view scenario=pole_climb --with engine=native
  sweep view results/before 42 --with results/after"""
PAGES_FOLDER = Path("results") / "view"  # of rollouts that belong to no folder


def add_arguments(parser: Arguments) -> None:
    """Add the arguments of `sweep view`: one or two rollouts, and where they are shown (page or MuJoCo's viewer)."""
    parser.description = "Simulate a rollout and play it in the browser."
    parser.epilog = EPILOG
    kinds = "DIR ID | group.name=value"
    parser.add_argument("what", metavar=kinds, nargs="+", help="a row of a study, or a configuration")
    parser.add_argument(
        "--with",
        dest="beside",
        metavar=kinds,
        nargs="+",
        default=[],
        help="a second rollout to play beside it: another row, the same row of another folder, or other values",
    )
    parser.add_argument("--mujoco", action="store_true", help="show MuJoCo's own viewer instead of the page")
    parser.add_argument("-o", "--output", type=Path, metavar="FILE", help="the page's file")


def run(args: argparse.Namespace) -> int:
    """Simulate the rollouts, write their page and open it. Raises `InputError`."""
    from sweep.cli import playback
    from sweep.core.progress import show_elapsed_time
    from sweep.report import page
    from sweep.runs import store

    for name in (args.what[0], *args.beside[:-1][:1]):  # one word alone is a row of the same folder
        if "=" not in name and store.STUDY_FILE not in playback.list_file_names(name):
            raise InputError(f"{name} is neither a folder of results nor group.name=value")
    if args.mujoco:
        if not has_screen():
            raise InputError("--mujoco needs a screen: DISPLAY is not set; without --mujoco the page shows the same")
        with show_elapsed_time(f"simulating {' '.join(args.what)}"):
            trace = next(playback.record_traces(args.what), None)
        if trace is None:
            raise InputError(f"{' '.join(args.what)} cannot be shown")
        playback.play_in_viewer(trace)
        return DONE
    of_folder = store.STUDY_FILE in playback.list_file_names(args.what[0])
    found, shown = (playback.read_results_and_replays if of_folder else playback.simulate_configuration)(
        args.what, args.beside
    )
    path = args.output or (
        path_inside_folder(Path(args.what[0]), "view.html")
        if of_folder
        else PAGES_FOLDER / f"{found.exp.scenario}.html"
    )
    print(page.write_page(found, path, shown=shown, opened=1 + bool(args.beside)))
    if not (has_screen() and webbrowser.open(path.resolve().as_uri())):
        why = "no browser opens it" if has_screen() else "there is no display (DISPLAY is not set)"
        print(f"sweep: {why}: open {path} in a browser", file=sys.stderr)
    return DONE


def has_screen() -> bool:
    """Whether a display is available."""
    return sys.platform != "linux" or bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))

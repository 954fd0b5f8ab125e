"""`sweep report`: write the page of a study, or of two, and its map."""

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from sweep.cli.arguments import add_folder, add_output, add_where
from sweep.cli.command import Command, Section
from sweep.cli.exits import DONE
from sweep.core.arguments import Arguments
from sweep.core.errors import InputError
from sweep.core.files import path_inside_folder
from sweep.core.progress import LiveProgress

if TYPE_CHECKING:
    from sweep.runs.results import Results

COMMAND = Command(Section.READ, "write a page about a study (report.html) and its map (map.png, map.svg)")


def add_arguments(parser: Arguments) -> None:
    """Add the arguments of `sweep report`: folders, the map's axes, and which rollouts are simulated again."""
    add_folder(parser)
    parser.add_argument(
        "b",
        type=Path,
        nargs="?",
        metavar="B",
        help="second folder: write a page that compares the points of both",
    )
    parser.add_argument("--x", help="parameter along the horizontal axis of the map")
    parser.add_argument("--y", help="parameter along the vertical axis of the map")
    add_where(parser)
    parser.add_argument(
        "--replays",
        type=int,
        default=0,
        metavar="N",
        help="add replays of the N most informative rollouts (simulates them again)",
    )
    parser.add_argument(
        "--pictures", action="store_true", help="add pictures of representative rollouts (simulates them again)"
    )
    parser.add_argument(
        "--watch", action="store_true", help="rewrite the page as rows arrive, until the run that adds them ends"
    )
    add_output(parser, "write page and map to this folder instead of DIR")


def run(args: argparse.Namespace) -> int:
    """Write the HTML page of a study, and pictures of its map or of the overview of its draws."""
    from sweep.core.expressions import find_column
    from sweep.core.progress import show_progress_counts
    from sweep.report import maps, page, replay_selection, replays, representative
    from sweep.runs import device_choice, results

    if args.replays < 0:
        raise InputError(f"--replays = {args.replays} is not allowed: at least 0")
    if args.watch:
        if args.b or args.replays or args.pictures:
            raise InputError("--watch is not allowed with a second folder, --replays or --pictures")
        return watch_page(args)
    # what is simulated again or compared with another run is compared in all columns
    every = bool(args.b or args.replays or args.pictures)
    found, folder = results.read_results(args.dir, args.where, with_bookkeeping=every), args.output or args.dir
    if args.b:
        return write_comparison_page(args, found, folder)
    columns = tuple(find_column(found.rows, name) for name in (args.x, args.y) if name)
    if columns:
        maps.choose_map_axes(found.rows, columns)  # refuses before anything is written
    if args.pictures:
        representative.draw_pictures(found)
    if args.replays:
        device_choice.choose_device_for_folder(args.dir)
        with show_progress_counts(format_replay_progress, 0, args.replays) as report:
            replays.make_replays(found, replay_selection.choose_replays(found, args.replays), report)
    print(page.write_page(found, path_inside_folder(folder, "report.html"), chosen=columns))
    for path in save_pictures(found, folder, columns):
        print(path)
    return DONE


def watch_page(args: argparse.Namespace) -> int:
    """Rewrite the page of a study while a run adds rows to it."""
    from sweep.cli import live_page
    from sweep.core.expressions import find_column
    from sweep.report import page
    from sweep.runs import results

    path = path_inside_folder(args.output or args.dir, "report.html")

    def write(progress: LiveProgress | None) -> None:
        found = results.read_results(args.dir, args.where, with_bookkeeping=False)
        columns = tuple(find_column(found.rows, name) for name in (args.x, args.y) if name)
        page.write_page(found, path, chosen=columns, live=progress)
        print(f"{path}: {progress.text}" if progress else path, flush=True)

    live_page.watch_run(args.dir, write)
    return DONE


def format_replay_progress(done: int, total: int) -> str:
    """Print the progress of simulating rollouts again."""
    return f"{done} of {total} rollouts simulated again"


def write_comparison_page(args: argparse.Namespace, a: "Results", folder: Path) -> int:
    """Write the page that compares two folders."""
    from sweep.analysis import compare
    from sweep.cli.policy_race import shortest_distinct_folder_names
    from sweep.core.progress import show_progress_counts
    from sweep.report import page, pairs
    from sweep.runs import device_choice, results

    if args.pictures or args.x or args.y:
        raise InputError("--pictures, --x and --y are not allowed with a second folder")
    b = results.read_results(args.b, args.where)
    found, table = pairs.join_pairs(a, b)
    unit = compare.pair_sampling_unit_ids(table, a.exp)
    if args.replays:
        device_choice.choose_device_for_folder(args.dir)
        with show_progress_counts(format_replay_progress, 0, args.replays) as report:
            pairs.replay_flipped_pairs(a, b, args.replays, report)
    about = page.ComparisonPageContent(
        f"{a.name} and {b.name}" if a.name != b.name else f"{a.name}: two runs",
        pairs.pairs_headline(table, unit),
        pairs.describe_pair_origin(table, args.dir, args.b),
        list(pairs.difference_figure(found, table)),
        list(pairs.pairs_tables(table, unit)),
        pairs.split_sides(table),
        tuple(shortest_distinct_folder_names([args.dir, args.b])),
    )
    path = path_inside_folder(folder, f"report_{args.b.resolve().name}.html")
    print(page.write_page(found, path, shown=list(pairs.read_pair_replays(a, b)), pairs=about))
    return DONE


def save_pictures(results: "Results", folder: Path, chosen: tuple[str, ...]) -> list[Path]:
    """Save pictures of a study's map, or of the overview of its draws; `chosen` names the two parameters of the map."""
    from sweep.core.plot_style import plot_style, save_figure
    from sweep.report import draws, maps

    with plot_style():
        if draws.has_draws_figure(results) and not chosen:
            name, figure = "draws", draws.draw_overview(results)
        elif chosen or len(maps.independent_parameters(results.rows)) > 1:
            name, figure = "map", maps.success_map(results.rows, results.stored, chosen)
        else:
            return []
    return [save_figure(figure, path_inside_folder(folder, f"{name}.{form}"), dpi=200) for form in ("png", "svg")]

"""Commands on folders of results. Slow imports wait until a command needs them."""

import argparse
import os
import sys
from contextlib import nullcontext
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from sweep.cli.exits import DONE, UNEXPECTED
from sweep.core import terminal
from sweep.core.errors import InputError
from sweep.core.files import path_in, write_atomically

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Sequence

    import pandas as pd

    from sweep.config.experiment import Experiment
    from sweep.runs.results import Results

LICENSE = "https://spdx.org/licenses/CC-BY-4.0"


def status(args: argparse.Namespace) -> int:
    """Print how many rollouts are planned and done, and their outcomes."""
    from sweep.analysis.stats import cause_lines
    from sweep.report.headline import headline
    from sweep.runs import results, store

    stored = store.read_study(args.dir)
    _, done = store.count_rollouts(args.dir)
    print(f"{args.dir}: {done} of {stored['rollouts']} rollouts done, code {stored['commit'] or stored['code']}")
    if done:
        exp = results.load_experiment(args.dir)
        rows = store.read_rows(args.dir, None if exp.study.is_adaptive else ["outcome", "cause"])
        meanings = exp.system.cause_meanings(exp.thresholds)
        if exp.study.is_adaptive:
            print(headline(rows, exp))
        print(", ".join(f"{number} {outcome}" for outcome, number in rows["outcome"].value_counts().items()))
        for line in cause_lines(rows["cause"], meanings):
            print(f"  {line}")
    return DONE


def verify(args: argparse.Namespace) -> int:
    """Name damaged files in a folder; with `--simulate`, simulate rows again and compare them."""
    if args.simulate is not None and args.simulate < 1:
        raise InputError(f"--simulate = {args.simulate} is not allowed: at least 1")
    from sweep.runs import repair, store

    problems, others, sound = repair.verify(args.dir)
    for line in (*problems, *others):
        print(line)
    remedy = f", {len(problems)} damaged: repeat the same `sweep run` to repair it" if problems else ""
    print(f"{args.dir}: {sound} part{' is' if sound == 1 else 's are'} sound{remedy}")
    if problems:
        return UNEXPECTED
    planned, done = store.count_rollouts(args.dir)
    if done < planned:
        print(f"{args.dir}: {done} of {planned} planned rollouts are there")
    if args.simulate is None:
        return DONE
    from sweep.cli.reproduce import report_simulated_again
    from sweep.runs import results

    return report_simulated_again(results.read(args.dir), args.simulate)


def read_matching_rows(folder: Path, condition: str | None, columns: "Sequence[str] | None" = None) -> "pd.DataFrame":
    """Read the rows of a study that meet a condition.

    Args:
        folder: Folder of the study.
        condition: Condition on columns; None for all rows.
        columns: Columns to read, besides those of the condition; None for all.
    """
    from sweep.core.expressions import condition_columns, mask
    from sweep.runs import results, store
    from sweep.study.study import name_axes

    exp = results.load_experiment(folder)
    if columns is not None:
        columns = [*columns, *condition_columns(results.empty_rows(folder, exp), condition)]
    rows = name_axes(store.read_rows(folder, columns), exp.study.axes)
    found = rows[mask(rows, condition)].reset_index(drop=True) if condition else rows
    if len(found) < len(rows) and found.empty:
        warn_of_no_match(folder, condition, len(rows))
    return found


def warn_of_no_match(folder: Path, condition: str | None, number: int) -> None:
    """Say on the standard error that none of a number of rows meets a condition."""
    print(f"sweep: none of {number} rows of {folder} matches {condition!r}", file=sys.stderr)


def parse_names(text: str | None) -> list[str] | None:
    """Split a comma-separated list: `a, b` -> [`a`, `b`]."""
    return [name.strip() for name in text.split(",")] if text else None


def save_output(path: Path, content: "bytes | Iterable[bytes]") -> None:
    """Write output, whole or in pieces, to the path of `-o`; `-` is the standard output.

    Raises `InputError` where the file is part of a study's folder.
    """
    from sweep.runs import manifest, store

    named, folder = path.name in (store.STUDY, store.POINTS, manifest.MANIFEST, store.LOG), path.parent
    if not named and folder.name in store.SUBFOLDERS:
        named, folder = True, folder.parent
    if named and (folder / store.STUDY).exists():
        raise InputError(f"-o = {path} is not allowed: a study's own file")
    to = Path("/dev/stdout") if path == Path("-") else path
    write_atomically(to, content if isinstance(content, bytes) else partial(_write_pieces, pieces=content))


def _write_pieces(path: Path, pieces: "Iterable[bytes]") -> None:
    with path.open("wb") as file:
        file.writelines(pieces)


def show_table(args: argparse.Namespace) -> int:
    """Print or write rows as CSV, Markdown, LaTeX or Parquet."""
    from sweep.report import tables
    from sweep.runs import results

    if args.format == "parquet" and not args.output:
        raise InputError("--format parquet needs a file: -o FILE")
    exp = results.load_experiment(args.dir)
    empty, names = results.empty_rows(args.dir, exp), parse_names(args.columns)
    chosen = tables.choose_columns(empty, args.format, names)
    if args.format == "csv":
        write_csv_table(args, exp, chosen)
        return DONE
    rows = read_matching_rows(args.dir, args.where, [*chosen, "replicate"])  # by which a page chooses columns
    content = tables.render_table(rows, args.format, chosen if args.format == "parquet" else names, exp)
    if args.output:
        save_output(args.output, content)
    elif args.format != "markdown":  # data for another program, whose lines must stay whole
        sys.stdout.write(content.decode())
    else:
        kept, elsewhere = ("outcome", "cause"), "use `--columns` to choose columns, or -o FILE for all"
        terminal.print_markdown(content.decode(), kept, elsewhere)
    return DONE


def write_csv_table(args: argparse.Namespace, exp: "Experiment", columns: "Sequence[str]") -> None:
    """Write columns of the rows as CSV, with no more than a part of the folder in memory."""
    from sweep.report import tables
    from sweep.runs import results

    def pieces() -> "Iterator[bytes]":
        total, matching = 0, 0
        for rows, number in results.iterate_matching_rows(args.dir, exp, columns, args.where):
            yield tables.csv_bytes(rows, header=not total)
            total, matching = total + number, matching + len(rows)
        if not matching:
            warn_of_no_match(args.dir, args.where, total)

    if args.output:
        save_output(args.output, pieces())
    else:
        sys.stdout.writelines(piece.decode() for piece in pieces())


def show_statistics(args: argparse.Namespace) -> int:
    """Print the statistics of a study."""
    from sweep.core.expressions import column
    from sweep.report import statistics
    from sweep.runs import results
    from sweep.study import design_kinds
    from sweep.study.columns import metric_columns

    exp = results.load_experiment(args.dir)
    empty = results.empty_rows(args.dir, exp)
    figures = [column(empty, args.figure)] if args.figure else []
    measured = () if exp.study.is_adaptive else metric_columns(empty)  # a search may lead by any of them
    rows = read_matching_rows(args.dir, args.where, [c for c in empty.columns if c not in measured] + figures)
    if not 0 < args.level < 1:
        raise InputError(f"--level = {args.level:g} is not allowed: between 0 and 1")
    if args.figure and not exp.study.design.sensitivity.needs_own_design:
        kinds = " or ".join(design_kinds.list_kinds(lambda kind: kind.sensitivity.needs_own_design))
        raise InputError(f"--figure is for sensitivity: it needs a study with study.design.kind={kinds}")
    terminal.print_markdown(
        statistics.render_statistics(rows, exp, args.level, args.figure), required=("share", "low", "high")
    )
    return DONE


def print_replay_progress(done: int, total: int) -> str:
    """Print the progress of simulating rollouts again."""
    return f"{done} of {total} rollouts simulated again"


def draw_report(args: argparse.Namespace) -> int:
    """Write the page of a study, and its map or its overview of draws."""
    from sweep.core.expressions import column
    from sweep.core.progress import show_counts
    from sweep.report import maps, page, replay_selection, replays, representative
    from sweep.runs import device_choice, results

    if args.replays < 0:
        raise InputError(f"--replays = {args.replays} is not allowed: at least 0")
    found, folder = results.read(args.dir, args.where), args.output or args.dir
    if args.b:
        return write_pairs_page(args, found, folder)
    columns = tuple(column(found.rows, name) for name in (args.x, args.y) if name)
    if columns:
        maps.map_axes(found.rows, columns)  # refuses before anything is written
    if args.pictures:
        representative.draw_pictures(found)
    if args.replays:
        device_choice.choose_device_for_folder(args.dir)
        with show_counts(print_replay_progress, 0, args.replays) as report:
            replays.make_replays(found, replay_selection.choose_replays(found, args.replays), report)
    print(page.write_page(found, path_in(folder, "report.html"), chosen=columns))
    for path in save_pictures(found, folder, columns):
        print(path)
    return DONE


def write_pairs_page(args: argparse.Namespace, a: "Results", folder: Path) -> int:
    """Write the page that compares two folders."""
    from sweep.analysis import compare
    from sweep.core.progress import show_counts
    from sweep.report import page, pairs
    from sweep.runs import device_choice, results

    if args.pictures or args.x or args.y:
        raise InputError("--pictures, --x and --y are not allowed with a second folder")
    b = results.read(args.b, args.where)
    found, table = pairs.join_pairs(a, b)
    unit = compare.independent_unit_of_pairs(table, a.exp)
    if args.replays:
        device_choice.choose_device_for_folder(args.dir)
        with show_counts(print_replay_progress, 0, args.replays) as report:
            pairs.replay_flipped_pairs(a, b, args.replays, report)
    about = page.PairsContent(
        f"{a.name} and {b.name}" if a.name != b.name else f"{a.name}: two runs",
        pairs.pairs_headline(table, args.dir, args.b, unit),
        list(pairs.difference_figure(found, table)),
        list(pairs.pairs_tables(table, unit)),
    )
    path = path_in(folder, f"report_{args.b.resolve().name}.html")
    print(page.write_page(found, path, shown=list(pairs.read_pair_replays(a, b)), pairs=about))
    return DONE


def save_pictures(results: "Results", folder: Path, chosen: tuple[str, ...]) -> list[Path]:
    """Save the map of a study, or the overview of its draws; `chosen` are two parameters of the map."""
    from sweep.core.plot_style import plot_style, save_figure
    from sweep.report import draws, maps

    with plot_style():
        if draws.has_draws_figure(results) and not chosen:
            name, figure = "draws", draws.draw_overview(results)
        elif chosen or len(maps.independent_parameters(results.rows)) > 1:
            name, figure = "map", maps.success_map(results.rows, results.stored, chosen)
        else:
            return []
    return [save_figure(figure, path_in(folder, f"{name}.{form}"), dpi=200) for form in ("png", "svg")]


def export_results(args: argparse.Namespace) -> int:
    """Export a study for a paper, or as a crate."""
    from sweep.report import crate, paper
    from sweep.runs import results, store

    if bool(args.paper) == bool(args.crate):
        raise InputError("export needs either --paper FOLDER or --crate FOLDER")
    if args.crate:
        if args.where or args.serif:
            raise InputError("--where and --serif need --paper: a crate contains the whole study")
        store.read_study(args.dir)  # before it is held, which would make it
        # nothing is added while it is copied, nor ever to what cannot be written
        with store.lock_folder(args.dir) if os.access(args.dir, os.W_OK) else nullcontext():
            print(crate.write_crate(results.read(args.dir), args.crate, args.license, args.zip, args.author))
        return DONE
    if args.zip or args.author or args.license != LICENSE:
        raise InputError("--zip, --author and --license need --crate")
    for path in paper.write_paper(results.read(args.dir, args.where), args.paper, args.serif):
        print(path)
    return DONE


def compare_results(args: argparse.Namespace) -> int:
    """Compare a folder with others; exit code 4 if outcomes or metrics differ beyond the tolerance."""
    import pandas as pd

    from sweep.analysis import compare
    from sweep.report import comparison
    from sweep.runs import results

    if not 0 <= args.tolerance <= 1:
        raise InputError(f"--tolerance = {args.tolerance:g} is not allowed: a share from 0 to 1")
    if args.figures is not None and not args.figures >= 0:
        raise InputError(f"--figures = {args.figures:g} is not allowed: at least 0")
    for name in ("most", "level"):
        if (value := getattr(args, name)) is not None and not args.anytime:
            raise InputError(f"--{name} = {value:g} is for --anytime")
    if args.anytime:
        from sweep.cli import anytime
        from sweep.runs import device_choice

        device_choice.choose_device_for_folder(args.a)
        print(anytime.compare_anytime(args, parse_names(args.by)))
        return DONE
    a, differ, broken = read_matching_rows(args.a, args.where_a), [], []
    for number, folder in enumerate(args.b):
        b = read_matching_rows(folder, args.where_b)
        pairs = compare.pair_rows(a, b, parse_names(args.by))
        if len(args.b) > 1:
            print(f"{chr(10) if number else ''}{args.a} and {folder}")
        unit = compare.independent_unit_of_pairs(pairs, results.load_experiment(args.a))
        text = comparison.comparison_text(pairs, len(a), len(b), parse_names(args.regions), unit)
        terminal.print_markdown(text + "\n")
        differ.append(compare.changed_pairs(pairs).assign(**({"B": str(folder)} if len(args.b) > 1 else {})))
        broken += comparison.find_violations(pairs, len(a), args.tolerance, args.figures)
    if args.output:
        save_output(args.output, pd.concat(differ).to_csv(index=False).encode())
    for line in broken:
        print(f"sweep: {line}", file=sys.stderr)
    return UNEXPECTED if broken else DONE


def certify_results(args: argparse.Namespace) -> int:
    """Certify a region, print guarantee and check; exit code 4 if no region is certified."""
    import json

    from sweep.cli import certify
    from sweep.runs import device_choice

    device_choice.choose_device_for_folder(args.dir)
    text, found = certify.certify_region(args)
    print(text)
    if args.output:
        save_output(args.output, f"{json.dumps(found, indent=1)}\n".encode())
    return DONE if found["certified"] else UNEXPECTED


def audit_results(args: argparse.Namespace) -> int:
    """Simulate rows near the boundary, and successes elsewhere, in other variants; print how many flip."""
    from sweep.cli import run as app
    from sweep.report import tables
    from sweep.runs import audit, device_choice, results

    if args.points < 1:
        raise InputError(f"--points = {args.points} is not allowed: at least 1")
    found = results.read(args.dir, args.where)
    device_choice.choose_device_for_folder(args.dir)
    ways = parse_names(args.ways) or []
    most = 2 * args.points * len(ways or found.exp.system.audit_variants)
    with app.report_progress("audit", most, f"{found.exp.scenario} in other ways") as report:
        audit.run(found, args.points, ways, report, lambda line: print(f"sweep: {line}", file=sys.stderr))
    terminal.print_markdown(tables.page_table(audit.flip_table(found)) + "\n")
    return DONE


def relabel(args: argparse.Namespace) -> int:
    """Apply new thresholds or conditions to the stored metrics."""
    from sweep.report.headline import headline
    from sweep.runs import results, runner, store

    exp = results.load_experiment(args.dir)
    changes = dict(map(exp.system.parse_threshold, args.thresholds))
    if len(changes) < len(args.thresholds):
        raise InputError(f"a threshold is given twice: {' '.join(args.thresholds)}")
    with store.lock_folder(args.dir):
        runner.relabel(args.dir, {**exp.values["outcome"], **changes})
    print(headline(store.read_rows(args.dir), exp))
    return DONE

"""The commands on folders of results that have no module of their own. Heavy imports wait until one needs them."""

import argparse
import os
import sys
from contextlib import nullcontext
from pathlib import Path
from typing import TYPE_CHECKING

from sweep.cli.exits import DONE, UNEXPECTED
from sweep.core import terminal
from sweep.core.errors import InputError
from sweep.core.files import path_in, write_atomically

if TYPE_CHECKING:
    import pandas as pd

    from sweep.runs.results import Results

LICENSE = "https://spdx.org/licenses/CC-BY-4.0"


def status(given: argparse.Namespace) -> int:
    """Planned, done, and how it went so far."""
    from sweep.analysis.stats import causes
    from sweep.report.headline import headline
    from sweep.runs import results, store

    stored, planned = store.read_study(given.dir), store.read_points(given.dir)
    done = planned["batch"].isin(store.finished_batches(given.dir)).sum() if len(planned) else 0
    print(f"{given.dir}: {done} of {stored['rollouts']} rollouts done, code {stored['commit'] or stored['code']}")
    if done:
        rows, exp = store.read_rows(given.dir), results.load_experiment(given.dir)
        meanings = exp.system.cause_meanings(exp.thresholds)
        if exp.study.is_adaptive:
            print(headline(rows, exp))
        print(", ".join(f"{number} {outcome}" for outcome, number in rows["outcome"].value_counts().items()))
        for line in causes(rows["cause"], meanings):
            print(f"  {line}")
    return DONE


def verify(args: argparse.Namespace) -> int:
    """Name what is damaged in a folder; with `--simulate`, simulate rows again and compare them."""
    if args.simulate is not None and args.simulate < 1:
        raise InputError(f"--simulate = {args.simulate} is not allowed: at least 1")
    from sweep.runs import repair, store

    problems, others, sound = repair.verify(args.dir)
    for line in (*problems, *others):
        print(line)
    remedy = f", {len(problems)} damaged: `sweep run` as before mends it" if problems else ""
    print(f"{args.dir}: {sound} part{' is' if sound == 1 else 's are'} sound{remedy}")
    if problems:
        return UNEXPECTED
    planned, done = store.read_points(args.dir), store.finished_batches(args.dir)
    if len(planned) and (there := int(planned["batch"].isin(done).sum())) < len(planned):
        print(f"{args.dir}: {there} of {len(planned)} planned rollouts are there")
    if args.simulate is None:
        return DONE
    from sweep.cli.reproduce import report_simulated_again
    from sweep.runs import results

    return report_simulated_again(results.read(args.dir), args.simulate)


def matching(folder: Path, condition: str | None) -> "pd.DataFrame":
    """Rows of a study that match `condition`."""
    from sweep.core.expressions import mask
    from sweep.runs import results, store
    from sweep.study.study import name_axes

    rows = name_axes(store.read_rows(folder), results.load_experiment(folder).study.axes)
    found = rows[mask(rows, condition)].reset_index(drop=True) if condition else rows
    if len(found) < len(rows) and found.empty:
        print(f"sweep: none of {len(rows)} rows of {folder} matches {condition!r}", file=sys.stderr)
    return found


def names(text: str | None) -> list[str] | None:
    """A list of names as it is given: `a, b` -> [`a`, `b`]."""
    return [name.strip() for name in text.split(",")] if text else None


def save(path: Path, content: bytes) -> None:
    """Write what `-o` asks for; `-` is the standard output.

    Raises `InputError` where it is a file that a folder's rows are read from, or its log.
    """
    from sweep.runs import manifest, store

    named, folder = path.name in (store.STUDY, store.POINTS, manifest.MANIFEST, store.LOG), path.parent
    if not named and folder.name in store.PLACES:
        named, folder = True, folder.parent
    if named and (folder / store.STUDY).exists():
        raise InputError(f"-o = {path} is not allowed: a study's own file")
    write_atomically(Path("/dev/stdout") if path == Path("-") else path, content)


def show_table(given: argparse.Namespace) -> int:
    """Rows as csv, markdown, latex or parquet."""
    from sweep.report import tables
    from sweep.runs import results

    if given.format == "parquet" and not given.output:
        raise InputError("--format parquet needs a file: -o FILE")
    exp = results.load_experiment(given.dir)
    content = tables.render(matching(given.dir, given.where), given.format, names(given.columns), exp)
    if given.output:
        save(given.output, content)
    else:
        kept, elsewhere = ("outcome", "cause"), "`--columns` chooses others, a file has all"
        terminal.print_markdown(content.decode(), kept, elsewhere)
    return DONE


def show_statistics(given: argparse.Namespace) -> int:
    """What the rows say in numbers."""
    from sweep.core.expressions import column
    from sweep.report import statistics
    from sweep.runs import results

    rows = matching(given.dir, given.where)
    if given.figure:
        column(rows, given.figure)
    if not 0 < given.level < 1:
        raise InputError(f"--level = {given.level:g} is not allowed: between 0 and 1")
    exp = results.load_experiment(given.dir)
    if given.figure and exp.study.design.kind not in ("saltelli", "morris"):
        raise InputError("--figure is for sensitivity: it needs a study with study.design.kind=saltelli or morris")
    terminal.print_markdown(statistics.render(rows, exp, given.level, given.figure), kept=("share", "low", "high"))
    return DONE


def again(done: int, of: int) -> str:
    """How many rollouts are simulated once more, in words."""
    return f"{done} of {of} rollouts simulated again"


def draw_report(given: argparse.Namespace) -> int:
    """The page, and the success map where there are two parameters to draw it over."""
    from sweep.core.expressions import column
    from sweep.core.progress import show_counts
    from sweep.report import chosen, maps, page, replays, typical
    from sweep.runs import device_choice, results

    if given.replays < 0:
        raise InputError(f"--replays = {given.replays} is not allowed: at least 0")
    found, folder = results.read(given.dir, given.where), given.output or given.dir
    if given.b:
        return draw_pairs(given, found, folder)
    columns = tuple(column(found.rows, name) for name in (given.x, given.y) if name)
    if columns:
        maps.map_axes(found.rows, columns)  # refuses before anything is written
    if given.pictures:
        typical.draw(found)
    if given.replays:
        device_choice.choose_device_for_folder(given.dir)
        with show_counts(again, 0, given.replays) as report:
            replays.make(found, chosen.chosen(found, given.replays), report)
    print(page.write(found, path_in(folder, "report.html"), chosen=columns))
    for path in pictures(found, folder, columns):
        print(path)
    return DONE


def draw_pairs(given: argparse.Namespace, a: "Results", folder: Path) -> int:
    """The page of the same points in two folders."""
    from sweep.core.progress import show_counts
    from sweep.report import page, pairs
    from sweep.runs import device_choice, results

    if given.pictures or given.x or given.y:
        raise InputError("--pictures, --x and --y are of one study")
    b = results.read(given.b, given.where)
    found, table = pairs.joined(a, b)
    if given.replays:
        device_choice.choose_device_for_folder(given.dir)
        with show_counts(again, 0, given.replays) as report:
            pairs.simulated(a, b, given.replays, report)
    about = page.Pairs(
        f"{a.name} and {b.name}" if a.name != b.name else f"{a.name} twice",
        pairs.headline(table, given.dir, given.b),
        list(pairs.exhibits(found, table)),
        list(pairs.tables(table)),
    )
    path = path_in(folder, f"report_{given.b.resolve().name}.html")
    print(page.write(found, path, shown=list(pairs.shown(a, b)), pairs=about))
    return DONE


def pictures(found: "Results", folder: Path, chosen: tuple[str, ...]) -> list[Path]:
    """The map of a study of conditions, or of the two parameters that are `chosen`; for draws the picture of draws."""
    from sweep.core.plot_style import plot_style, save_figure
    from sweep.report import draws, maps

    with plot_style():
        if draws.shown(found) and not chosen:
            name, figure = "draws", draws.draw(found)
        elif chosen or len(maps.independent(found.rows)) > 1:
            name, figure = "map", maps.success_map(found.rows, found.stored, chosen)
        else:
            return []
    return [save_figure(figure, path_in(folder, f"{name}.{form}"), dpi=200) for form in ("png", "svg")]


def export_results(given: argparse.Namespace) -> int:
    """The bundle for a paper, or the crate."""
    from sweep.report import crate, paper
    from sweep.runs import results, store

    if bool(given.paper) == bool(given.crate):
        raise InputError("export wants one of --paper FOLDER and --crate FOLDER")
    if given.crate:
        if given.where or given.serif:
            raise InputError("--where and --serif are of --paper: a crate has the whole study")
        store.read_study(given.dir)  # before it is held, which would make it
        # nothing is added while it is copied, nor ever to what cannot be written
        with store.lock_folder(given.dir) if os.access(given.dir, os.W_OK) else nullcontext():
            print(crate.write(results.read(given.dir), given.crate, given.license, given.zip, given.author))
        return DONE
    if given.zip or given.author or given.license != LICENSE:
        raise InputError("--zip, --author and --license are of --crate")
    for path in paper.write(results.read(given.dir, given.where), given.paper, given.serif):
        print(path)
    return DONE


def compare_results(given: argparse.Namespace) -> int:
    """Flips of outcome between a folder and each of the others; exit code 4 where they are more than tolerated."""
    import pandas as pd

    from sweep.analysis import compare
    from sweep.report import comparison

    if not 0 <= given.tolerance <= 1:
        raise InputError(f"--tolerance = {given.tolerance:g} is not allowed: a share from 0 to 1")
    if given.figures is not None and not given.figures >= 0:
        raise InputError(f"--figures = {given.figures:g} is not allowed: at least 0")
    for name in ("most", "level"):
        if (value := getattr(given, name)) is not None and not given.anytime:
            raise InputError(f"--{name} = {value:g} is for --anytime")
    if given.anytime:
        from sweep.cli import anytime
        from sweep.runs import device_choice

        device_choice.choose_device_for_folder(given.a)
        print(anytime.run(given, names(given.by)))
        return DONE
    a, differ, broken = matching(given.a, given.where_a), [], []
    for number, folder in enumerate(given.b):
        b = matching(folder, given.where_b)
        pairs = compare.pair(a, b, names(given.by))
        if len(given.b) > 1:
            print(f"{chr(10) if number else ''}{given.a} and {folder}")
        terminal.print_markdown(comparison.text(pairs, len(a), len(b), names(given.regions)) + "\n")
        differ.append(compare.differences(pairs).assign(**({"B": str(folder)} if len(given.b) > 1 else {})))
        broken += comparison.broken(pairs, len(a), given.tolerance, given.figures)
    if given.output:
        save(given.output, pd.concat(differ).to_csv(index=False).encode())
    for line in broken:
        print(f"sweep: {line}", file=sys.stderr)
    return UNEXPECTED if broken else DONE


def certify_results(given: argparse.Namespace) -> int:
    """The region, what is promised of it, and a check of it; exit code 4 where none is certified."""
    import json

    from sweep.cli import certify
    from sweep.runs import device_choice

    device_choice.choose_device_for_folder(given.dir)
    text, found = certify.run(given)
    print(text)
    if given.output:
        save(given.output, f"{json.dumps(found, indent=1)}\n".encode())
    return DONE if found["certified"] else UNEXPECTED


def audit_results(given: argparse.Namespace) -> int:
    """Flips among rollouts next to the boundary and successes elsewhere, simulated again."""
    from sweep.cli import run as app
    from sweep.report import tables
    from sweep.runs import audit, device_choice, results

    if given.points < 1:
        raise InputError(f"--points = {given.points} is not allowed: at least 1")
    found = results.read(given.dir, given.where)
    device_choice.choose_device_for_folder(given.dir)
    ways = names(given.ways) or []
    most = 2 * given.points * len(ways or found.exp.system.audit_variants)
    with app.reporting("audit", most, f"{found.exp.scenario} in other ways") as report:
        audit.run(found, given.points, ways, report, lambda line: print(f"sweep: {line}", file=sys.stderr))
    terminal.print_markdown(tables.page_table(audit.table(found)) + "\n")
    return DONE


def relabel(given: argparse.Namespace) -> int:
    """New thresholds, or conditions, for stored figures."""
    from sweep.report.headline import headline
    from sweep.runs import results, runner, store

    exp = results.load_experiment(given.dir)
    changes = dict(map(exp.system.limit, given.thresholds))
    if len(changes) < len(given.thresholds):
        raise InputError(f"a threshold is given twice: {' '.join(given.thresholds)}")
    with store.lock_folder(given.dir):
        runner.relabel(given.dir, {**exp.values["outcome"], **changes})
    print(headline(store.read_rows(given.dir), exp))
    return DONE

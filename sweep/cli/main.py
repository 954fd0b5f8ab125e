"""The command line: `sweep run`, and what is done with results. Heavy imports wait until a command needs them."""

import argparse
import atexit
import errno
import gc
import io
import os
import sys
from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING

from sweep.cli import project
from sweep.cli.choices import refuse_unknown
from sweep.cli.exits import BAD_INPUT, DONE, FAULT, INTERRUPTED, UNEXPECTED
from sweep.core import terminal
from sweep.core.arguments import Arguments, flags
from sweep.core.errors import Fault, InputError
from sweep.core.files import reason, write_whole
from sweep.core.groups import GROUPS
from sweep.core.start import VERSION

if TYPE_CHECKING:
    import pandas as pd

    from sweep.runs.results import Results
    from sweep.study.config import Experiment

LICENSE = "https://spdx.org/licenses/CC-BY-4.0"
UNFIT = (errno.ENOENT, errno.EEXIST, errno.ENOTDIR, errno.EISDIR, errno.EACCES, errno.EPERM, errno.EROFS)  # of a path
BENCH = ("arrowhead", "mjx", "native")  # rows of `sweep bench`
WHOLE = {  # commands that parse their own arguments: the modules with their `main`, and what they do
    "view": ("sweep.cli.view", "watch a rollout on its page"),
    "replay": ("sweep.trace.replay", "record one rollout of a study again"),
    "tune": ("sweep.cli.tune", "search the numbers of a plan"),
    "export-model": ("sweep.cli.export_model", "the robot as an own model"),
    "formula": ("sweep.cli.formula", "evaluate a closed-form result of the sources"),
}
RUN_HELP = f"""groups: {", ".join(GROUPS)}
  sweep list               their choices
  sweep describe robot     their parameters: unit, meaning, bounds, default
  sweep run --cfg job      the whole configuration
  sweep run --multirun     a run for each of robot=base,circular
examples:
  sweep run scenario=walk_slope contact.friction=0.2 robot=three_link
  sweep run study=walk_map study.axes.friction.num=65 out=results/fine
  sweep run study=my/study.yaml --dry-run
exit codes:
  0 done, 2 bad input, 3 too many invalid rollouts, 4 an expectation is not met, 5 disk, memory or workers failed,
  130 interrupted"""


def main(argv: list[str] | None = None) -> int:
    """Run one command; the exit code says how it went.

    0 done, 2 bad input, 3 invalid rows, 4 expectation not met, 5 disk, memory or workers failed, 130 interrupted.
    """
    gc.set_threshold(50_000)  # imports and tracing make a million objects, none in vain: 10 % of a start
    atexit.register(gc.freeze)  # nor are they looked through at the end, which takes as long again
    args = list(sys.argv[1:] if argv is None else argv)
    for stream in (sys.stdout, sys.stderr):  # a terminal without our letters shows others instead
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")
    try:
        if args and args[0] == "run":
            return run(args[1:])
        if args and args[0] in WHOLE:
            return import_module(WHOLE[args[0]][0]).main(args[1:])
        given = parser().parse_args(args)
        return given.command(given)
    except InputError as error:
        print(f"sweep: {error}", file=sys.stderr)
        return BAD_INPUT
    except Fault as error:
        print(f"sweep: {error}", file=sys.stderr)
        return FAULT
    except KeyboardInterrupt:
        print("sweep: interrupted; what is on disk stays, the same command finishes the rest", file=sys.stderr)
        return INTERRUPTED
    except BrokenPipeError:  # the reader, such as `head`, has seen enough
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return DONE
    except OSError as error:
        name = error.filename2 or error.filename  # of a copy the target
        print(f"sweep: {f'{name}: ' if name else ''}{reason(error)}", file=sys.stderr)
        return BAD_INPUT if error.errno in UNFIT else FAULT  # such as a full disk


def parser() -> Arguments:
    """Commands and their arguments."""
    top = Arguments(prog="sweep", description="Batch experiments with six-legged robots.")
    top.add_argument("--version", action="version", version=f"sweep {VERSION}")
    commands = top.add_subparsers(required=True, metavar="command")

    def command(
        name: str, action: Callable[[argparse.Namespace], int], text: str, example: str = ""
    ) -> argparse.ArgumentParser:
        raw, epilog = argparse.RawDescriptionHelpFormatter, f"example:\n  {example}" if example else None
        sub = commands.add_parser(name, help=text, description=text, epilog=epilog, formatter_class=raw)
        sub.set_defaults(command=action)
        return sub

    def of_results(
        name: str, action: Callable[[argparse.Namespace], int], text: str, example: str = ""
    ) -> argparse.ArgumentParser:
        sub = command(name, action, text, example)
        sub.add_argument("dir", type=Path, help="folder of a study, such as results/walk_map")
        return sub

    command("run", lambda _: DONE, "simulate a scenario, or every point of a study; see `sweep run --help`")
    new = command("init", project.init, "make a project: a folder for studies, robots and modules of your own")
    new.add_argument("dir", help="a new or empty folder")
    new.add_argument("--model", action="store_true", help="for a model and a controller of your own, docs/own_model.md")
    choices = command("list", project.show, "scenarios, studies, robots and the other groups; or folders of results")
    choices.add_argument("dir", type=Path, nargs="*", help="folders of studies, such as results/: a line for each")
    about = command(
        "describe",
        project.describe,
        "parameters: unit, meaning, bounds, default",
        "sweep describe robot; sweep describe drive.torque_limit",
    )
    about.add_argument("name", nargs="?", help="a group, obstacle=ball, or a parameter; all of them without")
    words = command("completion", project.completion, "completion for bash", 'eval "$(sweep completion)"  # in .bashrc')
    words.add_argument("--line", help=argparse.SUPPRESS)
    words.set_defaults(flags=lambda: flags_of(commands))
    of_results("status", status, "how far a study is")
    of_results("verify", verify, "which files of a study are damaged, missing or no part of it")
    table = of_results("table", show_table, "the rows of a study as a table")
    table.add_argument("--format", choices=("csv", "markdown", "latex", "parquet"), default="markdown")
    table.add_argument("--where", help="only rows that match, such as 'friction > 0.8 and outcome == \"failure\"'")
    table.add_argument("--columns", help="only these columns, separated by commas")
    table.add_argument("-o", "--output", type=Path, help="write to this file instead of the standard output")
    stats = of_results("stats", show_statistics, "rates, volume, margins, tolerance and sensitivity of a study")
    stats.add_argument("--where", help="only rows that match")
    stats.add_argument("--level", type=float, default=0.9, help="probability of success for the tolerance (0.9)")
    stats.add_argument("--figure", help="Sobol indices or elementary effects of this column instead of success")
    report = of_results("report", draw_report, "a page about the study, report.html, and its map, map.png and map.svg")
    report.add_argument(
        "b",
        type=Path,
        nargs="?",
        metavar="B",
        help="another folder: a page of the points of both, and where they differ",
    )
    report.add_argument("--x", help="parameter along the map")
    report.add_argument("--y", help="parameter up the map")
    report.add_argument("--where", help="only rows that match")
    report.add_argument(
        "--replays", type=int, default=0, metavar="N", help="simulate the N most telling rollouts again"
    )
    report.add_argument("--pictures", action="store_true", help="simulate typical rollouts again for their pictures")
    report.add_argument("-o", "--output", type=Path, help="folder for page and map instead of DIR")
    export = of_results("export", export_results, "a study for others' programs")
    export.add_argument("--paper", type=Path, metavar="FOLDER", help="LaTeX tables, figures, numbers, data")
    export.add_argument(
        "--crate", type=Path, metavar="FOLDER", help="an RO-Crate: rows, configuration, pictures, how they were made"
    )
    export.add_argument("--zip", action="store_true", help="the crate as FOLDER.zip, as archives take it")
    export.add_argument("--license", default=LICENSE, metavar="ADDRESS", help="licence of the crate's data (CC-BY-4.0)")
    export.add_argument("--where", help="only rows that match")
    export.add_argument("--serif", action="store_true", help="letters of figures with serifs")
    again = command(
        "reproduce",
        reproduce,
        "simulate rows of a crate again, here: what is equal, what ends otherwise",
        "sweep reproduce walk_map.zip --rows 50",
    )
    again.add_argument("crate", type=Path, help="what `sweep export DIR --crate` wrote: a folder or an archive")
    again.add_argument("--rows", type=int, default=20, help="how many, drawn at random (20)")
    again.add_argument("--seed", type=int, default=0, help="of their draw (0)")
    again.add_argument("--tolerance", type=float, default=1e-3, help="relative, within which figures are alike (0.001)")
    export.add_argument("--author", default="", metavar="NAME", help="who ran the study, for the crate")
    compare = command(
        "compare",
        compare_results,
        "the same points in two folders: which outcomes differ, and where",
        "sweep compare results/before results/after --tolerance 0.01 --figures 0.1",
    )
    compare.add_argument(
        "a", type=Path, metavar="A", help="folder of the reference; each of its rows needs its pair in B"
    )
    compare.add_argument("b", type=Path, nargs="+", metavar="B", help="folder of another engine, version or controller")
    compare.add_argument("--a", dest="where_a", metavar="CONDITION", help="only rows of A that match")
    compare.add_argument("--b", dest="where_b", metavar="CONDITION", help="only rows of B that match")
    compare.add_argument("--by", metavar="NAMES", help="columns that are equal in a pair (default: point_id)")
    compare.add_argument("--regions", metavar="NAMES", help="parameters whose thirds are compared one by one")
    compare.add_argument("--tolerance", type=float, default=0.0, help="largest share of pairs whose outcome may differ")
    compare.add_argument("--figures", type=float, metavar="SHARE", help="largest typical relative change of a figure")
    compare.add_argument("-o", "--output", type=Path, help="write the pairs that differ as CSV")
    compare.add_argument(
        "--anytime", action="store_true", help="which succeeds more often: evidence that holds however often one looks"
    )
    compare.add_argument("--level", type=float, help="how sure --anytime has to be (0.95)")
    compare.add_argument(
        "--most",
        type=int,
        metavar="N",
        help="with --anytime: simulate more draws in both, up to N, until it is decided",
    )
    sure = of_results(
        "certify",
        certify_results,
        "the largest region of drawn parameters in which failures are promised to be rare",
        "sweep certify results/draws --failures 1e-2 --confidence 0.95 --rollouts 4096",
    )
    sure.add_argument("--failures", type=float, default=1e-2, help="largest probability of failing in it (0.01)")
    sure.add_argument("--confidence", type=float, default=0.95, help="that the promise holds (0.95)")
    sure.add_argument("--shape", choices=("box", "ellipsoid", "score"), default="box", help="of the region (box)")
    sure.add_argument(
        "--rollouts", type=int, metavar="N", help="simulate N fresh draws to test with; else half of the rows do"
    )
    sure.add_argument("-o", "--output", type=Path, help="write the certificate as JSON")
    audit = of_results(
        "audit", audit_results, "rollouts at the boundary and successes again: at half the time step, in other ways"
    )
    audit.add_argument("--points", type=int, default=32, help="how many of each, drawn at random (32)")
    audit.add_argument(
        "--ways", help="separated by commas: again, half_step, float64, other_engine, solid; without it all"
    )
    audit.add_argument("--where", help="only rows that match")
    judge = of_results(
        "relabel",
        relabel,
        "judge stored rollouts by other thresholds, without simulating",
        "sweep relabel results/walk_map 'slip_max_m<0.02' 'tilt_max_deg<15'",
    )
    wanted = "such as 'slip_max_m<0.02'; of an own model a condition, 'goal=travelled_m >= 1'"
    judge.add_argument("thresholds", nargs="+", metavar="'KEY<VALUE'", help=wanted)
    bench = command("bench", show_speed, "how fast the walking map is simulated here, by engine and dynamics")
    bench.add_argument("--rollouts", type=int, default=0, help="of each row; 0: one batch")
    bench.add_argument("--width", type=int, default=0, help="rollouts in a batch; 0: the device's best")
    bench.add_argument("--rows", nargs="+", choices=BENCH, default=list(BENCH), help="which of them")
    for name, (_, text) in WHOLE.items():
        command(name, lambda _: DONE, f"{text}; see `sweep {name} --help`")
    return top


def run(argv: list[str]) -> int:
    """`sweep run`: our own flags are taken out, the rest is Hydra's."""
    given, overrides = run_parser().parse_known_args(argv)
    if given.limit is not None and given.limit < 1:
        raise InputError(f"--limit = {given.limit} is not allowed: at least 1")
    for group in GROUPS:
        if len(chosen := [one for one in overrides if one.startswith(f"{group}=")]) > 1:
            raise InputError(f"{group} is chosen twice: {' '.join(chosen)}")
    refuse_unknown(overrides)
    os.environ.setdefault("MUJOCO_GL", "disable")  # a run opens no window; to look for a library takes a tenth second
    from sweep.cli.launch import launch  # takes a second to import
    from sweep.engines import devices

    if given.points is not None:
        if not Path(given.points).is_file():
            raise InputError(f"--points = {given.points} is not a file")
        quoted = given.points.replace("\\", "\\\\").replace("'", "\\'")
        overrides.append(f"study.points='{quoted}'")

    several = any(one.startswith(("-m", "--m")) for one in overrides)  # Hydra's --multirun: one process, one choice

    def work(exp: "Experiment") -> int:
        from sweep.runs import place

        if exp.cluster.kind == "local" and not several:
            place.of_run(exp)
        if exp.settings.name == "mjx" and not given.dry_run and not exp.cluster.elsewhere:
            devices.begin()
        from sweep.cli.run import Flags, execute  # takes another, which what is wrong need not wait for

        return execute(exp, Flags(given.dry_run, given.check, given.limit, given.where))

    return launch(overrides, work, flags(run_parser()))


def run_parser() -> Arguments:
    """Our own flags of `sweep run`, and its help."""
    own = Arguments(
        prog="sweep run",
        others=lambda _: True,  # Hydra's
        allow_abbrev=False,
        formatter_class=argparse.RawDescriptionHelpFormatter,
        usage="sweep run [group=choice ...] [group.name=value ...] [flags]",
        description="Without a study: one nominal rollout of a scenario. With one: every point of it, into "
        "results/STUDY.",
        epilog=RUN_HELP,
    )
    own.add_argument("--version", action="version", version=f"sweep {VERSION}")
    own.add_argument("--dry-run", action="store_true", help="only say how many rollouts, in which batches")
    own.add_argument("--check", action="store_true", help="only try whether each axis acts; 4 if one does not")
    own.add_argument("--limit", type=int, metavar="N", help="only the first N points of the study")
    own.add_argument("--where", metavar="CONDITION", help="only points that match, such as 'friction > 0.8'")
    own.add_argument("--points", metavar="FILE.csv", help="points from a table whose columns are parameters")
    return own


def flags_of(commands: "argparse._SubParsersAction[Arguments]") -> dict[str, list[str]]:
    """The commands and their flags."""
    parsers = {**commands.choices, "run": run_parser()}
    return {name: [flag for flag in flags(sub) if flag.startswith("--")] for name, sub in parsers.items()}


def show_speed(args: argparse.Namespace) -> int:
    """`sweep bench`: a line as soon as it is measured, then all as a table."""
    from tabulate import tabulate

    from sweep.cli import bench
    from sweep.study.config import compose

    for name in ("rollouts", "width"):
        if getattr(args, name) < 0:
            raise InputError(f"--{name} = {getattr(args, name)} is not allowed: at least 0")
    lines = []
    nominal = compose(["scenario=walk_tripod"]).case
    for line in bench.table(nominal, args.rollouts, args.width, tuple(args.rows)):
        print(f"{line['engine']} {line['dynamics']}: {line['env-steps/s']:.4g} env-steps/s", file=sys.stderr)
        lines.append(line)
    print(bench.MEASURED)
    print(tabulate(lines, headers="keys", tablefmt="github", floatfmt=".4g", missingval=""))
    return DONE


def status(given: argparse.Namespace) -> int:
    """Planned, done, and how it went so far."""
    from sweep.analysis.stats import causes
    from sweep.runs import results, store

    stored, planned = store.read_study(given.dir), store.read_points(given.dir)
    done = planned["batch"].isin(store.finished(given.dir)).sum() if len(planned) else 0
    print(f"{given.dir}: {done} of {stored['rollouts']} rollouts done, code {stored['commit'] or stored['code']}")
    if done:
        rows, meanings = store.read_rows(given.dir), results.kept(given.dir).system.causes
        print(", ".join(f"{number} {outcome}" for outcome, number in rows["outcome"].value_counts().items()))
        for line in causes(rows["cause"], meanings):
            print(f"  {line}")
    return DONE


def verify(given: argparse.Namespace) -> int:
    """Which files of a folder are not as they were written."""
    from sweep.runs import repair

    problems, others, sound = repair.verify(given.dir)
    for line in (*problems, *others):
        print(line)
    remedy = f", {len(problems)} damaged: `sweep run` as before mends it" if problems else ""
    print(f"{given.dir}: {sound} part{' is' if sound == 1 else 's are'} sound{remedy}")
    return UNEXPECTED if problems else DONE


def matching(folder: Path, condition: str | None) -> "pd.DataFrame":
    """Rows of a study that match `condition`."""
    from sweep.core.expressions import mask
    from sweep.runs import store

    rows = store.read_rows(folder)
    found = rows[mask(rows, condition)].reset_index(drop=True) if condition else rows
    if len(found) < len(rows) and found.empty:
        print(f"sweep: none of {len(rows)} rows of {folder} matches {condition!r}", file=sys.stderr)
    return found


def names(text: str | None) -> list[str] | None:
    """`a, b` -> [`a`, `b`]."""
    return [name.strip() for name in text.split(",")] if text else None


def show_table(given: argparse.Namespace) -> int:
    """Rows as csv, markdown, latex or parquet."""
    from sweep.report import tables
    from sweep.runs import results

    if given.format == "parquet" and not given.output:
        raise InputError("--format parquet needs a file: -o FILE")
    exp = results.kept(given.dir)
    content = tables.render(matching(given.dir, given.where), given.format, names(given.columns), exp)
    if given.output:
        write_output(given.output, content)
    else:
        kept, elsewhere = ("outcome", "cause"), "`--columns` chooses others, a file has all"
        terminal.show(content.decode(), kept, elsewhere)
    return DONE


def write_output(path: Path, content: bytes) -> None:
    """What a command was asked to write, whole. Raises `OSError` where there is no place for it."""
    if not path.parent.is_dir() or path.is_dir():
        missing = errno.EISDIR if path.is_dir() else errno.ENOENT
        raise OSError(missing, os.strerror(missing), str(path))
    write_whole(path, content)


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
    exp = results.kept(given.dir)
    if given.figure and exp.study.design.kind not in ("saltelli", "morris"):
        raise InputError("--figure is for sensitivity: it needs a study with study.design.kind=saltelli or morris")
    terminal.show(statistics.render(rows, exp, given.level, given.figure), kept=("share", "low", "high"))
    return DONE


def again(done: int, of: int) -> str:
    """How many rollouts are simulated once more, in words."""
    return f"{done} of {of} rollouts simulated again"


def draw_report(given: argparse.Namespace) -> int:
    """The page, and the success map where there are two parameters to draw it over."""
    from sweep.core.expressions import column
    from sweep.core.waiting import counting
    from sweep.report import chosen, maps, page, replays, typical
    from sweep.runs import place, results

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
        place.like_rows_of(given.dir)
        with counting(again, 0, given.replays) as report:
            replays.make(found, chosen.chosen(found, given.replays), report)
    print(page.write(found, folder / "report.html", chosen=columns))
    for path in pictures(found, folder, columns):
        print(path)
    return DONE


def draw_pairs(given: argparse.Namespace, a: "Results", folder: Path) -> int:
    """The page of the same points in two folders."""
    from sweep.core.waiting import counting
    from sweep.report import page, pairs
    from sweep.runs import place, results

    if given.pictures or given.x or given.y:
        raise InputError("--pictures, --x and --y are of one study")
    b = results.read(given.b, given.where)
    found, table = pairs.joined(a, b)
    if given.replays:
        place.like_rows_of(given.dir)
        with counting(again, 0, given.replays) as report:
            pairs.simulated(a, b, given.replays, report)
    about = page.Pairs(
        f"{a.name} and {b.name}" if a.name != b.name else f"{a.name} twice",
        pairs.headline(table, given.dir, given.b),
        list(pairs.exhibits(found, table)),
        list(pairs.tables(table)),
    )
    path = folder / f"report_{given.b.resolve().name}.html"
    print(page.write(found, path, shown=list(pairs.shown(a, b)), pairs=about))
    return DONE


def pictures(found: "Results", folder: Path, chosen: tuple[str, ...]) -> list[Path]:
    """The map of a study of conditions, or of the two parameters that are `chosen`; for draws the picture of draws."""
    from sweep.core.letters import lettering, save
    from sweep.report import draws, maps

    with lettering():
        if draws.shown(found) and not chosen:
            name, figure = "draws", draws.draw(found)
        elif chosen or len(maps.independent(found.rows)) > 1:
            name, figure = "map", maps.success_map(found.rows, found.stored, chosen)
        else:
            return []
    return [save(figure, folder / f"{name}.{form}", dpi=200) for form in ("png", "svg")]


def export_results(given: argparse.Namespace) -> int:
    """The bundle for a paper, or the crate."""
    from sweep.report import crate, paper
    from sweep.runs import results

    if bool(given.paper) == bool(given.crate):
        raise InputError("export wants one of --paper FOLDER and --crate FOLDER")
    if given.crate:
        if given.where or given.serif:
            raise InputError("--where and --serif are of --paper: a crate has the whole study")
        print(crate.write(results.read(given.dir), given.crate, given.license, given.zip, given.author))
        return DONE
    if given.zip or given.author or given.license != LICENSE:
        raise InputError("--zip, --author and --license are of --crate")
    for path in paper.write(results.read(given.dir, given.where), given.paper, given.serif):
        print(path)
    return DONE


def reproduce(given: argparse.Namespace) -> int:
    """Rows of a crate again."""
    from sweep.cli import reproduce

    return reproduce.run(given)


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
        from sweep.runs import place

        place.like_rows_of(given.a)
        print(anytime.run(given, names(given.by)))
        return DONE
    a, differ, broken = matching(given.a, given.where_a), [], []
    for number, folder in enumerate(given.b):
        b = matching(folder, given.where_b)
        pairs = compare.pair(a, b, names(given.by))
        if len(given.b) > 1:
            print(f"{chr(10) if number else ''}{given.a} and {folder}")
        terminal.show(comparison.text(pairs, len(a), len(b), names(given.regions)) + "\n")
        differ.append(compare.differences(pairs).assign(**({"B": str(folder)} if len(given.b) > 1 else {})))
        broken += comparison.broken(pairs, len(a), given.tolerance, given.figures)
    if given.output:
        write_output(given.output, pd.concat(differ).to_csv(index=False).encode())
    for line in broken:
        print(f"sweep: {line}", file=sys.stderr)
    return UNEXPECTED if broken else DONE


def certify_results(given: argparse.Namespace) -> int:
    """The region, what is promised of it, and a check of it; exit code 4 where none is certified."""
    import json

    from sweep.cli import certify
    from sweep.runs import place

    place.like_rows_of(given.dir)
    text, found = certify.run(given)
    print(text)
    if given.output:
        write_output(given.output, f"{json.dumps(found, indent=1)}\n".encode())
    return DONE if found["certified"] else UNEXPECTED


def audit_results(given: argparse.Namespace) -> int:
    """Flips among rollouts next to the boundary and successes elsewhere, simulated again."""
    from sweep.cli import run as app
    from sweep.report import tables
    from sweep.runs import audit, place, results

    if given.points < 1:
        raise InputError(f"--points = {given.points} is not allowed: at least 1")
    found = results.read(given.dir, given.where)
    place.like_rows_of(given.dir)
    ways = names(given.ways) or []
    most = 2 * given.points * len(ways or found.exp.system.ways)
    with app.reporting("audit", most, f"{found.exp.scenario} in other ways") as report:
        audit.run(found, given.points, ways, report, lambda line: print(f"sweep: {line}", file=sys.stderr))
    terminal.show(tables.page_table(audit.table(found)) + "\n")
    return DONE


def relabel(given: argparse.Namespace) -> int:
    """New thresholds, or conditions, for stored figures."""
    from sweep.analysis.sample import pooled
    from sweep.runs import results, runner, store

    exp = results.kept(given.dir)
    changes = dict(map(exp.system.limit, given.thresholds))
    if len(changes) < len(given.thresholds):
        raise InputError(f"a threshold is given twice: {' '.join(given.thresholds)}")
    with store.locked(given.dir):
        runner.relabel(given.dir, {**exp.values["outcome"], **changes})
    print(pooled(store.read_rows(given.dir), exp))
    return DONE

"""The command line: `sweep run`, and what is done with results. Heavy imports wait until a command needs them."""

import argparse
import errno
import gc
import io
import os
import sys
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from sweep.core.errors import Fault, InputError
from sweep.core.files import write_whole

if TYPE_CHECKING:
    import pandas as pd

DONE, BAD_INPUT, UNEXPECTED, FAULT, INTERRUPTED = 0, 2, 4, 5, 130
BENCH = ("arrowhead", "mjx", "bare", "native")  # rows of `sweep bench`
GROUPS = ("scenario", "study", "robot", "obstacle", "manoeuvre", "drive", "contact", "noise", "execution", "engine",
          "outcome", "cluster")  # fmt: skip


def main(argv: list[str] | None = None) -> int:
    """Run one command; the exit code says how it went.

    0 done, 2 bad input, 3 invalid rows, 4 expectation not met, 5 disk, memory or workers failed, 130 interrupted.
    """
    gc.set_threshold(50_000)  # imports and tracing make a million objects, none in vain: 10 % of a start
    args = list(sys.argv[1:] if argv is None else argv)
    for stream in (sys.stdout, sys.stderr):  # a terminal without our letters shows others instead
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")
    # these parse their own arguments
    whole: dict[str, Callable[[list[str]], int]] = {"run": run, "replay": replay, "formula": formula}
    try:
        if args and args[0] in whole:
            return whole[args[0]](args[1:])
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
    except (FileNotFoundError, FileExistsError, NotADirectoryError, IsADirectoryError, PermissionError) as error:
        print(f"sweep: {error.filename}: {error.strerror}", file=sys.stderr)
        return BAD_INPUT
    except OSError as error:  # such as a full disk
        print(f"sweep: {error}", file=sys.stderr)
        return FAULT


def parser() -> argparse.ArgumentParser:
    """Commands and their arguments."""
    top = argparse.ArgumentParser(prog="sweep", description="Batch experiments with six-legged robots.")
    commands = top.add_subparsers(required=True, metavar="command")

    def command(name: str, action: Callable[[argparse.Namespace], int], text: str) -> argparse.ArgumentParser:
        sub = commands.add_parser(name, help=text, description=text)
        sub.set_defaults(command=action)
        return sub

    def of_results(name: str, action: Callable[[argparse.Namespace], int], text: str) -> argparse.ArgumentParser:
        sub = command(name, action, text)
        sub.add_argument("dir", type=Path, help="folder of a study, such as results/walk_map")
        return sub

    delegated = "see `sweep {} --help`"
    command("run", lambda _: DONE, "simulate a scenario, or every point of a study; " + delegated.format("run"))
    command("list", show_choices, "what can be run: scenarios, studies, robots and the other groups")
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
    stats.add_argument("--figure", help="Sobol indices of this column instead of success")
    report = of_results("report", draw_report, "a page about the study, report.html, and its map, map.png and map.svg")
    report.add_argument("--x", help="parameter along the map")
    report.add_argument("--y", help="parameter up the map")
    report.add_argument("--where", help="only rows that match")
    report.add_argument("--pictures", action="store_true", help="simulate typical rollouts again for their pictures")
    report.add_argument("-o", "--output", type=Path, help="folder for page and map instead of DIR")
    export = of_results("export", export_results, "a study for others' programs")
    export.add_argument(
        "--paper", type=Path, required=True, metavar="FOLDER", help="LaTeX tables, figures, numbers, data"
    )
    export.add_argument("--where", help="only rows that match")
    compare = command("compare", compare_results, "the same points in two folders: which outcomes differ, and where")
    compare.add_argument(
        "a", type=Path, metavar="A", help="folder of the reference; each of its rows needs its pair in B"
    )
    compare.add_argument("b", type=Path, metavar="B", help="folder of another engine, version or controller")
    compare.add_argument("--a", dest="where_a", metavar="CONDITION", help="only rows of A that match")
    compare.add_argument("--b", dest="where_b", metavar="CONDITION", help="only rows of B that match")
    compare.add_argument("--by", metavar="NAMES", help="columns that are equal in a pair (default: point_id)")
    compare.add_argument("--regions", metavar="NAMES", help="parameters whose thirds are compared one by one")
    compare.add_argument("--tolerance", type=float, default=0.0, help="largest share of pairs whose outcome may differ")
    compare.add_argument("--figures", type=float, metavar="SHARE", help="largest typical relative change of a figure")
    compare.add_argument("-o", "--output", type=Path, help="write the pairs that differ as CSV")
    audit = of_results(
        "audit", audit_results, "rollouts next to the boundary again: at half the time step, in other ways"
    )
    audit.add_argument("--points", type=int, default=32, help="how many, drawn at random (32)")
    audit.add_argument("--ways", default="again,half_step,float64,other_engine", help="separated by commas")
    audit.add_argument("--where", help="only rows that match")
    judge = of_results("relabel", relabel, "judge stored rollouts by other thresholds, without simulating")
    judge.add_argument("thresholds", nargs="+", metavar="'KEY<VALUE'", help="such as 'slip_max_m<0.02'")
    bench = command("bench", show_speed, "how fast the walking map is simulated here, by engine and dynamics")
    bench.add_argument("--rollouts", type=int, default=0, help="of each row; 0: one batch")
    bench.add_argument("--width", type=int, default=0, help="rollouts in a batch; 0: the device's best")
    bench.add_argument("--rows", nargs="+", choices=BENCH, default=list(BENCH), help="bare is physics alone")
    command("replay", lambda _: DONE, "record one rollout of a study again; " + delegated.format("replay"))
    command("formula", lambda _: DONE, "evaluate a closed-form result of the sources; " + delegated.format("formula"))
    return top


def run(argv: list[str]) -> int:
    """`sweep run`: our own flags are taken out, the rest is Hydra's."""
    from sweep.cli.run import Flags, launch

    own = argparse.ArgumentParser(prog="sweep run", add_help=False, allow_abbrev=False)
    own.add_argument("--dry-run", action="store_true")
    own.add_argument("--limit", type=int)
    own.add_argument("--where")
    own.add_argument("--points")
    given, overrides = own.parse_known_args(argv)
    if given.limit is not None and given.limit < 1:
        raise InputError(f"--limit = {given.limit} is not allowed: at least 1")
    if given.points:
        overrides.append(f"study.points='{given.points}'")
    return launch(overrides, Flags(given.dry_run, given.limit, given.where))


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
    print(tabulate(lines, headers="keys", tablefmt="github", floatfmt=".4g", missingval=""))
    return DONE


def replay(argv: list[str]) -> int:
    """`sweep replay DIR POINT`."""
    from sweep.trace import replay as recorder

    return recorder.main(argv)


def formula(argv: list[str]) -> int:
    """`sweep formula NAME key=value`."""

    return formula.main(argv)


def show_choices(_: argparse.Namespace) -> int:
    """Every configuration file with its first comment line."""
    from importlib.resources import files

    for group in GROUPS:
        print(f"{group}=")
        for file in sorted((files("sweep.conf") / group).iterdir(), key=lambda f: f.name):
            lines = file.read_text(encoding="utf-8").splitlines()
            text = next((line for line in lines if line.startswith("# ") and "@package" not in line), "#")
            print(f"  {file.name.removesuffix('.yaml'):20} {text[2:]}")
    return DONE


def status(given: argparse.Namespace) -> int:
    """Planned, done, and how it went so far."""
    from sweep.analysis.stats import causes
    from sweep.runs import store

    stored, planned = store.read_study(given.dir), store.read_points(given.dir)
    done = planned["batch"].isin(store.finished(given.dir)).sum() if len(planned) else 0
    print(f"{given.dir}: {done} of {len(planned)} rollouts done, code {stored['commit'] or stored['code']}")
    if done:
        rows = store.read_rows(given.dir)
        print(", ".join(f"{number} {outcome}" for outcome, number in rows["outcome"].value_counts().items()))
        for line in causes(rows["cause"]):
            print(f"  {line}")
    return DONE


def verify(given: argparse.Namespace) -> int:
    """Which files of a folder are not as they were written."""
    from sweep.runs import repair

    problems, others, sound = repair.verify(given.dir)
    for line in (*problems, *others):
        print(line)
    remedy = f", {len(problems)} problems: `sweep run` as before mends them" if problems else ""
    print(f"{given.dir}: {sound} parts are sound{remedy}")
    return UNEXPECTED if problems else DONE


def selected(given: argparse.Namespace) -> "pd.DataFrame":
    """Rows of a study that match `--where`."""
    return matching(given.dir, given.where)


def matching(folder: Path, condition: str | None) -> "pd.DataFrame":
    """Rows of a study that match `condition`."""
    from sweep.core.expressions import mask
    from sweep.runs import store

    rows = store.read_rows(folder)
    return rows[mask(rows, condition)].reset_index(drop=True) if condition else rows


def names(text: str | None) -> list[str] | None:
    """`a, b` -> [`a`, `b`]."""
    return [name.strip() for name in text.split(",")] if text else None


def show_table(given: argparse.Namespace) -> int:
    """Rows as csv, markdown, latex or parquet."""
    from sweep.report import tables
    from sweep.runs import store
    from sweep.study.config import experiment

    if given.format == "parquet" and not given.output:
        raise InputError("--format parquet needs a file: -o FILE")
    exp = experiment(store.read_study(given.dir)["config"])
    content = tables.render(selected(given), given.format, names(given.columns), exp)
    if given.output:
        write_output(given.output, content)
    else:
        sys.stdout.write(content.decode())
    return DONE


def write_output(path: Path, content: bytes) -> None:
    """What a command was asked to write, whole. Raises `OSError` where there is no place for it."""
    if not path.parent.is_dir() or path.is_dir():
        missing = errno.EISDIR if path.is_dir() else errno.ENOENT
        raise OSError(missing, os.strerror(missing), str(path))
    write_whole(path, content)


def show_statistics(given: argparse.Namespace) -> int:
    """What the rows say in numbers."""
    from sweep.report import statistics
    from sweep.runs import store
    from sweep.study.config import experiment

    if not 0 < given.level < 1:
        raise InputError(f"--level = {given.level:g} is not allowed: between 0 and 1")
    exp = experiment(store.read_study(given.dir)["config"])
    if given.figure and exp.study.design.kind != "saltelli":
        raise InputError("--figure is for Sobol indices, which need a study with study.design.kind=saltelli")
    sys.stdout.write(statistics.render(selected(given), exp, given.level, given.figure))
    return DONE


def draw_report(given: argparse.Namespace) -> int:
    """The page, and the success map where there are two parameters to draw it over."""
    from sweep.analysis import results
    from sweep.report import maps, page, typical

    found, folder = results.read(given.dir, given.where), given.output or given.dir
    if given.pictures:
        typical.draw(found)
    print(page.write(found, folder / "report.html"))
    chosen = tuple(name for name in (given.x, given.y) if name)
    if chosen or len(found.numeric) > 1:
        for path in maps.draw(found.rows, found.stored, folder, chosen):
            print(path)
    return DONE


def export_results(given: argparse.Namespace) -> int:
    """The bundle for a paper."""
    from sweep.analysis import results
    from sweep.report import paper

    for path in paper.write(results.read(given.dir, given.where), given.paper):
        print(path)
    return DONE


def compare_results(given: argparse.Namespace) -> int:
    """Flips of outcome between two folders; exit code 4 where they are more than tolerated."""
    from sweep.analysis import compare
    from sweep.report import comparison

    a, b = matching(given.a, given.where_a), matching(given.b, given.where_b)
    pairs = compare.pair(a, b, names(given.by))
    print(comparison.text(pairs, len(a), len(b), names(given.regions)))
    if given.output:
        write_output(given.output, compare.differences(pairs).to_csv(index=False).encode())
    broken = comparison.broken(pairs, len(a), given.tolerance, given.figures)
    for line in broken:
        print(f"sweep: {line}", file=sys.stderr)
    return UNEXPECTED if broken else DONE


def audit_results(given: argparse.Namespace) -> int:
    """Flips among rollouts next to the boundary, simulated again."""
    from sweep.analysis import results
    from sweep.cli import run as app
    from sweep.report import tables
    from sweep.runs import audit

    if given.points < 1:
        raise InputError(f"--points = {given.points} is not allowed: at least 1")
    found, ways = results.read(given.dir, given.where), names(given.ways) or []
    with app.reporting("audit", given.points * len(ways)) as report:
        audit.run(found, given.points, ways, report)
    print(tables.page_table(audit.table(found)))
    return DONE


def relabel(given: argparse.Namespace) -> int:
    """New thresholds for stored figures."""
    from sweep.analysis.stats import rate
    from sweep.runs import runner, store

    stored = store.read_study(given.dir)
    changes = dict(map(threshold, given.thresholds))
    with store.locked(given.dir):
        runner.relabel(given.dir, {**stored["config"]["outcome"], **changes})
    print(rate(store.read_rows(given.dir)["outcome"]))
    return DONE


def threshold(text: str) -> tuple[str, float]:
    """`slip_max_m<0.02` -> name and value. The sign must agree with the name: a maximum is kept below."""
    sign = next((s for s in ("<=", ">=", "<", ">", "=") if s in text), None)
    key, _, value = text.partition(sign or "=")
    try:
        number = float(value)
    except ValueError:
        raise InputError(f"{text!r} is not a threshold, such as 'slip_max_m<0.02'") from None
    if sign and sign != "=" and ("max" in key) != ("<" in sign):
        raise InputError(f"{text!r} is not allowed: {key.strip()} is a {'maximum' if 'max' in key else 'minimum'}")
    return key.strip(), number

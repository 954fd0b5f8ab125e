"""Command-line parsers of all commands, and `sweep run`. Slow imports wait until a command needs them."""

import argparse
import os
import textwrap
from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING

from sweep.cli import folders, project
from sweep.cli.choices import refuse_unknown
from sweep.cli.exits import DONE, MEANINGS
from sweep.core.arguments import Arguments, list_flags
from sweep.core.errors import InputError
from sweep.core.files import printable_name
from sweep.core.groups import GROUPS
from sweep.core.version import VERSION

if TYPE_CHECKING:
    from sweep.config.experiment import Experiment

BENCH = ("arrowhead", "mjx", "native")  # rows of `sweep bench`
WHOLE = {  # commands that parse their own arguments: the modules with their `main`, and what they do
    "view": ("sweep.cli.view", "play a rollout in the browser"),
    "replay": ("sweep.replay.replay", "simulate one rollout of a study again and record it"),
    "tune": ("sweep.cli.tune", "optimize the numbers of a plan"),
    "export-model": ("sweep.cli.export_model", "export the built-in robot as a MuJoCo model"),
    "formula": ("sweep.cli.formula", "evaluate a closed-form formula from the literature"),
}
RUN_HELP = f"""groups: {", ".join(GROUPS)}
  sweep list               their choices
  sweep describe robot     their describe parameters: unit, meaning, bounds, default
  sweep run --cfg job      the whole configuration
  sweep run --multirun     a run for each of robot=base,circular
examples:
  sweep run scenario=walk_slope contact.friction=0.2 robot=three_link
  sweep run study=walk_map study.axes.friction.num=65 out=results/fine
  sweep run study=my/study.yaml --dry-run
exit codes:
{textwrap.indent(textwrap.fill(", ".join(f"{code} {text}" for code, text in MEANINGS.items()), 110), "  ")}"""


def execute(argv: list[str]) -> int:
    """Run the command at the start of `argv` and return its exit code. Raises `InputError`."""
    if strange := [word for word in argv if word.encode(errors="ignore").decode() != word]:
        raise InputError(f"{printable_name(strange[0])} is not allowed: letters in UTF-8")
    if argv and argv[0] == "run":
        return run_command(argv[1:])
    if argv and argv[0] in WHOLE:
        return import_module(WHOLE[argv[0]][0]).main(argv[1:])
    args = parser().parse_args(argv)
    return args.command(args)


def parser() -> Arguments:
    """The parser of all commands."""
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
    new = command("init", project.init, "create a project: a folder for your own studies, robots and modules")
    new.add_argument("dir", help="a new or empty folder")
    new.add_argument(
        "--model", action="store_true", help="with an example MuJoCo model and controller, see docs/own_model.md"
    )
    choices = command(
        "list",
        project.list_choices,
        "list scenarios, studies, robots and other choices, or folders of results",
        "sweep list study map; sweep list robot; sweep list ball; sweep list results/",
    )
    wanted = "a group and words to filter its choices, or folders of results such as results/"
    choices.add_argument("what", nargs="*", help=wanted)
    about = command(
        "describe",
        project.describe,
        "describe parameters: unit, meaning, bounds, default",
        "sweep describe robot; sweep describe drive.torque_limit",
    )
    about.add_argument(
        "name",
        nargs="?",
        help="a group, a choice such as obstacle=ball, a parameter or a column (default: all parameters)",
    )
    words = command("completion", project.completion, "completion for bash", 'eval "$(sweep completion)"  # in .bashrc')
    words.add_argument("--line", help=argparse.SUPPRESS)
    words.set_defaults(flags=lambda: flags_of(commands))
    of_results("status", folders.status, "show progress and outcomes of a study")
    verify = of_results(
        "verify",
        folders.verify,
        "check the files and rows of a study for damage",
        "sweep verify results/walk_map --simulate 20",
    )
    verify.add_argument(
        "--simulate", type=int, metavar="N", help="simulate N stored rows again; exit code 4 if a metric changed"
    )
    table = of_results("table", folders.show_table, "print the rows of a study as a table")
    table.add_argument(
        "--format",
        choices=("csv", "markdown", "latex", "parquet"),
        default="markdown",
        help="format of the table (markdown)",
    )
    table.add_argument("--where", help="only rows that match, such as 'friction > 0.8 and outcome == \"failure\"'")
    table.add_argument("--columns", help="only these columns, separated by commas")
    table.add_argument("-o", "--output", type=Path, help="write to this file instead of the standard output")
    stats = of_results(
        "stats", folders.show_statistics, "print rates, volume, margins, tolerance and sensitivity of a study"
    )
    stats.add_argument("--where", help="only rows that match")
    stats.add_argument("--level", type=float, default=0.9, help="probability of success for the tolerance (0.9)")
    stats.add_argument("--figure", help="compute Sobol indices or elementary effects of this column instead of success")
    report = of_results(
        "report", folders.draw_report, "write a page about a study (report.html) and its map (map.png, map.svg)"
    )
    report.add_argument(
        "b",
        type=Path,
        nargs="?",
        metavar="B",
        help="second folder: write a page that compares the points of both",
    )
    report.add_argument("--x", help="parameter along the horizontal axis of the map")
    report.add_argument("--y", help="parameter along the vertical axis of the map")
    report.add_argument("--where", help="only rows that match")
    report.add_argument(
        "--replays",
        type=int,
        default=0,
        metavar="N",
        help="add replays of the N most informative rollouts (simulates them again)",
    )
    report.add_argument(
        "--pictures", action="store_true", help="add pictures of representative rollouts (simulates them again)"
    )
    report.add_argument("-o", "--output", type=Path, help="write page and map to this folder instead of DIR")
    export = of_results(
        "export", folders.export_results, "export a study for a LaTeX paper, or as an RO-Crate for archives"
    )
    export.add_argument("--paper", type=Path, metavar="FOLDER", help="write LaTeX tables, figures, numbers and data")
    export.add_argument(
        "--crate", type=Path, metavar="FOLDER", help="write an RO-Crate: rows, configuration, pictures and provenance"
    )
    export.add_argument("--zip", action="store_true", help="write the crate as FOLDER.zip")
    export.add_argument(
        "--license", default=folders.LICENSE, metavar="ADDRESS", help="licence of the crate's data (CC-BY-4.0)"
    )
    export.add_argument("--where", help="only rows that match")
    export.add_argument("--serif", action="store_true", help="use a serif font in figures")
    again = command(
        "reproduce",
        lazy_command("reproduce", "reproduce_crate"),
        "simulate rows of a crate again on this machine and compare them",
        "sweep reproduce walk_map.zip --rows 50",
    )
    again.add_argument("crate", type=Path, help="folder or archive that `sweep export DIR --crate` wrote")
    again.add_argument("--trust", action="store_true", help="allow code of the crate to run, such as its controller")
    again.add_argument("--rows", type=int, default=20, help="number of rows, drawn at random (20)")
    again.add_argument("--seed", type=int, default=0, help="seed of the random choice (0)")
    again.add_argument("--tolerance", type=float, default=1e-3, help="relative tolerance of metrics (0.001)")
    export.add_argument("--author", default="", metavar="NAME", help="name of the person who ran the study")
    compare = command(
        "compare",
        folders.compare_results,
        "compare the same points in two folders: which outcomes differ, and where",
        "sweep compare results/before results/after --tolerance 0.01 --figures 0.1",
    )
    compare.add_argument(
        "a", type=Path, metavar="A", help="reference folder; each of its rows needs a row of the same point in B"
    )
    compare.add_argument(
        "b",
        type=Path,
        nargs="+",
        metavar="B",
        help="folder to compare, such as of another engine, version or controller",
    )
    compare.add_argument("--a", dest="where_a", metavar="CONDITION", help="only rows of A that match")
    compare.add_argument("--b", dest="where_b", metavar="CONDITION", help="only rows of B that match")
    compare.add_argument(
        "--by", metavar="NAMES", help="columns whose values are equal within a pair (default: point_id)"
    )
    compare.add_argument("--regions", metavar="NAMES", help="also compare by region: each parameter is cut into thirds")
    compare.add_argument(
        "--tolerance", type=float, default=0.0, help="largest tolerated share of pairs whose outcomes differ"
    )
    compare.add_argument(
        "--figures", type=float, metavar="SHARE", help="largest tolerated relative change (median) of a metric"
    )
    compare.add_argument("-o", "--output", type=Path, help="write the pairs that differ as CSV")
    compare.add_argument(
        "--anytime",
        action="store_true",
        help="decide which folder succeeds more often; valid at any time, however often you look",
    )
    compare.add_argument("--level", type=float, help="confidence of --anytime (0.95)")
    compare.add_argument(
        "--most",
        type=int,
        metavar="N",
        help="with --anytime: simulate up to N draws in both folders until the test decides",
    )
    certify = of_results(
        "certify",
        folders.certify_results,
        "find the largest region of drawn parameters in which failures are guaranteed to be rare",
        "sweep certify results/draws --failures 1e-2 --confidence 0.95 --rollouts 4096",
    )
    certify.add_argument(
        "--failures", type=float, default=1e-2, help="largest failure probability within the region (0.01)"
    )
    certify.add_argument("--confidence", type=float, default=0.95, help="confidence of the guarantee (0.95)")
    certify.add_argument(
        "--shape", choices=("box", "ellipsoid", "score"), default="box", help="shape of the region (box)"
    )
    certify.add_argument(
        "--rollouts", type=int, metavar="N", help="test with N fresh draws (default: test with half of the rows)"
    )
    certify.add_argument("-o", "--output", type=Path, help="write the certificate as JSON")
    audit = of_results(
        "audit",
        folders.audit_results,
        "simulate rollouts again in other ways, such as at half the time step, and count flipped outcomes",
    )
    audit.add_argument("--points", type=int, default=32, help="number of rollouts of each kind, drawn at random (32)")
    audit.add_argument(
        "--ways", help="variants separated by commas: again, half_step, float64, other_engine, solid (default: all)"
    )
    audit.add_argument("--where", help="only rows that match")
    thresholds = of_results(
        "relabel",
        folders.relabel,
        "apply other thresholds to stored rollouts without simulating",
        "sweep relabel results/walk_map 'slip_max_m<0.02' 'tilt_max_deg<15'",
    )
    wanted = "such as 'slip_max_m<0.02'; for a MuJoCo model, a condition such as 'goal=travelled_m >= 1'"
    thresholds.add_argument("thresholds", nargs="+", metavar="'KEY<VALUE'", help=wanted)
    bench = command(
        "bench",
        lazy_command("bench", "run_bench"),
        "measure the simulation speed of this machine by engine and dynamics",
    )
    bench.add_argument("--rollouts", type=int, default=0, help="rollouts for each row of the table; 0: one batch")
    bench.add_argument("--width", type=int, default=0, help="rollouts in a batch; 0: best for the device")
    bench.add_argument("--rows", nargs="+", choices=BENCH, default=list(BENCH), help="which of them")
    for name, (_, text) in WHOLE.items():
        command(name, lambda _: DONE, f"{text}; see `sweep {name} --help`")
    return top


def lazy_command(module: str, name: str) -> Callable[[argparse.Namespace], int]:
    """Make a command whose module is imported when it is called."""
    return lambda args: getattr(import_module(f"sweep.cli.{module}"), name)(args)


def run_command(argv: list[str]) -> int:
    """Run `sweep run`: parse its own flags and leave the rest to Hydra."""
    args, overrides = run_parser().parse_known_args(argv)
    if args.limit is not None and args.limit < 1:
        raise InputError(f"--limit = {args.limit} is not allowed: at least 1")
    for group in GROUPS:
        if len(chosen := [one for one in overrides if one.startswith(f"{group}=")]) > 1:
            raise InputError(f"{group} is chosen twice: {' '.join(chosen)}")
    refuse_unknown(overrides)
    os.environ.setdefault("MUJOCO_GL", "disable")  # a run opens no window; to look for a library takes a tenth second
    from sweep.backends import devices
    from sweep.cli.launch import launch  # takes a second to import

    if args.points is not None:
        quoted = args.points.replace("\\", "\\\\").replace("'", "\\'")
        overrides.append(f"study.points='{quoted}'")

    several = any(one.startswith(("-m", "--m")) for one in overrides)  # Hydra's --multirun: one process, one choice

    def work(exp: "Experiment") -> int:
        from sweep.runs import device_choice

        if exp.cluster.kind == "local" and not several:
            device_choice.choose_device_for_run(exp)
        if exp.settings.name == "mjx" and not args.dry_run and not exp.cluster.is_remote:
            devices.start_device_search()
        from sweep.cli.run import Flags, execute  # takes another, which what is wrong need not wait for

        return execute(exp, Flags(args.dry_run, args.check, args.limit, args.where))

    return launch(overrides, work, list_flags(run_parser()))


def run_parser() -> Arguments:
    """Parser of the flags of `sweep run`, and its help."""
    own = Arguments(
        prog="sweep run",
        others=lambda _: True,  # Hydra's
        allow_abbrev=False,
        formatter_class=argparse.RawDescriptionHelpFormatter,
        usage="sweep run [group=choice ...] [group.name=value ...] [flags]",
        description="Without a study, simulate one nominal rollout of a scenario. With a study, simulate all its "
        "points into results/STUDY.",
        epilog=RUN_HELP,
    )
    own.add_argument("--version", action="version", version=f"sweep {VERSION}")
    own.add_argument(
        "--dry-run", action="store_true", help="only print the axes and the numbers of rollouts and batches"
    )
    own.add_argument(
        "--check", action="store_true", help="only check that each axis has an effect; exit code 4 if one has none"
    )
    own.add_argument("--limit", type=int, metavar="N", help="only the first N points of the study")
    own.add_argument("--where", metavar="CONDITION", help="only points that match, such as 'friction > 0.8'")
    own.add_argument("--points", metavar="FILE.csv", help="read points from a CSV file whose columns are parameters")
    return own


def flags_of(commands: "argparse._SubParsersAction[Arguments]") -> dict[str, list[str]]:
    """List the flags of each command."""
    parsers = {**commands.choices, "run": run_parser()}
    return {name: [flag for flag in list_flags(sub) if flag.startswith("--")] for name, sub in parsers.items()}

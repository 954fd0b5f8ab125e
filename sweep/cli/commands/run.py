"""`sweep run`: simulate a scenario, or every point of a study."""

import argparse
import os
import textwrap
from typing import TYPE_CHECKING

from sweep.cli.choices import refuse_unknown_choices
from sweep.cli.command import Command, Section
from sweep.cli.exits import MEANINGS
from sweep.core.arguments import Arguments, list_flags
from sweep.core.errors import InputError
from sweep.core.groups import GROUPS
from sweep.core.version import VERSION

if TYPE_CHECKING:
    from sweep.config.experiment import Experiment

COMMAND = Command(Section.SIMULATE, "simulate a scenario, or every point of a study")
EPILOG = f"""groups: {", ".join(GROUPS)}
  sweep list               their choices
  sweep describe robot     their parameters: unit, meaning, bounds, default
  sweep run --cfg job      the whole configuration
  sweep run --multirun     a run for each of robot=base,circular
examples:
  sweep run scenario=walk_slope contact.friction=0.2 robot=three_link
  sweep run study=walk_map study.axes.friction.num=65 out=results/fine
  sweep run study=my/study.yaml --dry-run
exit codes:
{textwrap.indent(textwrap.fill(", ".join(f"{code} {text}" for code, text in MEANINGS.items()), 76), "  ")}"""


def add_arguments(parser: Arguments) -> None:
    """Add the flags of `sweep run` that Hydra does not know; all other words are Hydra's."""
    parser.others = lambda _: True
    parser.allow_abbrev = False
    parser.usage = "sweep run [group=choice ...] [group.name=value ...] [flags]"
    parser.description = (
        "Without a study, simulate one nominal rollout of a scenario. With a study, simulate all its "
        "points into results/STUDY."
    )
    parser.epilog = EPILOG
    parser.add_argument("--version", action="version", version=f"sweep {VERSION}")
    parser.add_argument(
        "--dry-run", action="store_true", help="only print the axes and the numbers of rollouts and batches"
    )
    parser.add_argument(
        "--check", action="store_true", help="only check that each axis has an effect; exit code 4 if one has none"
    )
    parser.add_argument("--limit", type=int, metavar="N", help="only the first N points of the study")
    parser.add_argument("--where", metavar="CONDITION", help="only points that match, such as 'friction > 0.8'")
    parser.add_argument(
        "--report", action="store_true", help="write the page of the study, again and again as rows arrive"
    )
    parser.add_argument("--points", metavar="FILE.csv", help="read points from a CSV file whose columns are parameters")


def run(args: argparse.Namespace) -> int:
    """Compose the configuration and run it, as a single rollout or as a study. Raises `InputError`."""
    overrides: list[str] = args.overrides
    if args.limit is not None and args.limit < 1:
        raise InputError(f"--limit = {args.limit} is not allowed: at least 1")
    if args.report and (args.dry_run or args.check):
        raise InputError("--report is not allowed with --dry-run or --check, which simulate no rows")
    for group in GROUPS:
        if len(chosen := [one for one in overrides if one.startswith(f"{group}=")]) > 1:
            raise InputError(f"{group} is chosen twice: {' '.join(chosen)}")
    refuse_unknown_choices(overrides)
    os.environ.setdefault("MUJOCO_GL", "disable")  # a run opens no window; to look for a library takes a tenth second
    from sweep.backends import devices
    from sweep.cli.commands import make_parser
    from sweep.cli.launch import launch_hydra  # takes a second to import

    if args.points is not None:
        quoted = args.points.replace("\\", "\\\\").replace("'", "\\'")
        overrides.append(f"study.points='{quoted}'")

    several = any(one.startswith(("-m", "--m")) for one in overrides)  # Hydra's --multirun: one process, one choice

    def work(exp: "Experiment") -> int:
        from sweep.runs import device_choice

        if exp.cluster.kind == "local" and not several:
            device_choice.choose_device_for_run(exp)
        if exp.settings.name == "mjx" and not args.dry_run and not exp.cluster.is_remote:
            devices.search_devices_in_background()
        from sweep.cli.execution import (  # takes another, which what is wrong need not wait for
            RunFlags,
            execute_experiment,
        )

        return execute_experiment(exp, RunFlags(args.dry_run, args.check, args.limit, args.where, args.report))

    return launch_hydra(overrides, work, list_flags(make_parser("run")))

"""`sweep tune`: optimise the numbers of a plan for a robot, an obstacle and a study's draws."""

import argparse

from sweep.cli.command import Command, Section
from sweep.core.arguments import Arguments, is_positional
from sweep.core.errors import InputError

COMMAND = Command(Section.SIMULATE, "optimize the numbers of a plan")
MIN_FLAG_VALUES = {"population": 4, "generations": 1, "seed": 1}  # of the flags
MIN_MOMENTS, MAX_MOMENT_INTERVAL_S = 11, 0.05  # of a stage; as in sweep/planning/score.py, which is slow to import
EPILOG = """Margins are those of sweep/planning/kinematic_margins.py; draws are the points of the study, known to the
planner. What is found is checked on the draws of the study's next seed. With --follow numbers get slopes, by which they
follow the sizes that the study draws. With --simulate both draws are run, too, by the plan before and after, in folders
beside the file. What no number of the plan moves, such as feet on the way to an obstacle, may be moved by numbers of
the manoeuvre (--free manoeuvre.NAME): the file says with which of them its plan is to be run. With --by-rollouts every
round simulates two rollouts of each draw of the next seed, with opposite random changes of all free numbers.

examples:
  sweep tune scenario=pole_top robot=mine study=pole_sizes out=plans/mine.yaml --free 'top.*' --stages 'top.*'
  sweep tune scenario=pole_top study=pole_sizes out=plans/any.yaml --follow --simulate
  sweep tune scenario=pole_top study=pole_sizes study.design.num=512 out=plans/any.yaml --follow --by-rollouts
  sweep tune scenario=pole_top plan=plans/mine.yaml study=pole_sizes --check"""


def add_arguments(parser: Arguments) -> None:
    """Add the flags of the search by `sweep tune`; all other words are values of the configuration."""
    parser.others = is_positional
    parser.allow_abbrev = False
    parser.usage = "sweep tune [group=choice ...] [group.name=value ...] out=FILE.yaml [flags]"
    parser.description = "Optimize the numbers of a plan until its margins reach their targets in all draws of a study."
    parser.epilog = EPILOG
    parser.add_argument(
        "--free",
        action="append",
        metavar="PATTERN[=STEP]",
        help="numbers to optimize (default: all but formulas) and first step size",
    )
    parser.add_argument("--stages", action="append", metavar="PATTERN", help="stages to evaluate (default: all)")
    parser.add_argument(
        "--need", action="append", default=[], metavar="MARGIN[@STAGES]=VALUE", help="target value of a margin"
    )
    parser.add_argument("--forces", action="store_true", help="also search for contact forces that hold the robot")
    way = parser.add_mutually_exclusive_group()
    way.add_argument(
        "--gradients", action="store_true", help="optimize by gradients instead of CMA-ES, for many numbers"
    )
    way.add_argument(
        "--follow", action="store_true", help="make numbers depend linearly on the sizes that the study draws"
    )
    parser.add_argument(
        "--by-rollouts",
        action="store_true",
        help="optimize in simulation: rounds of rollouts with random changes of all numbers",
    )
    parser.add_argument(
        "--simulate", action="store_true", help="also simulate both sets of draws with the plans before and after"
    )
    parser.add_argument("--check", action="store_true", help="only print the margins of the plan as it is")
    parser.add_argument(
        "--moments",
        action="append",
        default=[],
        metavar="[STAGES=]N",
        help=f"of each stage, or of some ({MIN_MOMENTS}, and no more than {MAX_MOMENT_INTERVAL_S} s apart)",
    )
    parser.add_argument("--population", type=int, default=16, help="plans in a generation of CMA-ES (16)")
    parser.add_argument(
        "--generations",
        type=int,
        default=200,
        help="at most (200); steps of gradients, linear programs, rounds of rollouts",
    )
    parser.add_argument("--seed", type=int, default=1, help="seed of the search, at least 1")


def run(args: argparse.Namespace) -> int:
    """Search for better numbers of a plan, and write the plan's file. Raises `InputError`."""
    for flag, least in MIN_FLAG_VALUES.items():
        if getattr(args, flag) < least:
            raise InputError(f"--{flag} = {getattr(args, flag)} is not allowed: at least {least}")
    from sweep.cli.plan_search import tune_plan

    return tune_plan(args)

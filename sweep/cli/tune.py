"""`sweep tune`: search the numbers of a plan for a robot, an obstacle and draws of one's own."""

import argparse
import shlex
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import yaml
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from sweep.cli.exits import DONE, UNEXPECTED
from sweep.core.errors import InputError
from sweep.core.files import write_whole
from sweep.models import plan_table
from sweep.models.case import Case
from sweep.models.obstacles.charts import charts
from sweep.runs import tuning
from sweep.study.config import compose
from sweep.systems.hexapod import Hexapod
from sweep.tune.score import Aim, Score, stacked, worst

DIGITS = 4  # to which numbers are rounded
LEAST = {"moments": 2, "population": 4, "generations": 1, "seed": 1}  # of the flags
EPILOG = """Margins are those of sweep/tune/planned.py; draws are the points of the study, known to the planner. What is
found is checked on the draws of the study's next seed. Nothing is simulated: run the study with that plan.
examples:
  sweep tune scenario=pole_top robot=mine study=pole_sizes out=plans/mine.yaml --free 'top.*' --stages 'top.*'
  sweep tune scenario=pole_top plan=plans/mine.yaml study=pole_sizes --check"""


def main(args: list[str]) -> int:
    """Run the command with the arguments after `tune`; the exit status. Raises `InputError`."""
    given, overrides = parser().parse_known_args(args)
    for flag, least in LEAST.items():
        if getattr(given, flag) < least:
            raise InputError(f"--{flag} = {getattr(given, flag)} is not allowed: at least {least}")
    exp = compose(overrides)
    if not isinstance(exp.system, Hexapod):
        raise InputError("tune is for plans of the six-legged robot: an own model's controller has axes")
    case, where = exp.case, Path(exp.out or "")
    if not isinstance(case.manoeuvre, plan_table.Tabled):
        raise InputError(f"manoeuvre.kind = {case.manoeuvre.kind} has its numbers in no file")
    if not given.check and where.suffix != ".yaml":
        raise InputError(f"out = {exp.out or ''} is not allowed: the file of the plan, such as plans/mine.yaml")
    numbers = plan_table.numbers(plan_table.tabled(case), charts(case.obstacle))
    steps = tuning.free_numbers(numbers, given.free or ["*"])
    first, scale = np.array([numbers[path] for path in steps]), np.array(list(steps.values()))
    aims, width = [aim(text) for text in given.need], 2 if given.check else given.population
    score = Score(case, list(steps), aims, given.stages or ["*"], given.moments, given.forces, width)
    seen, others = (stacked(*tuning.draws(exp, exp.study.seed + k)) for k in (0, 1))
    if given.check:
        here, there = (score.margins(first[None], many) for many in (seen, others))
        print(table(score, {"here": of_set(here), "other draws": of_set(there)}))
        return DONE
    how = {"overrides": sorted(overrides), "free": steps, "stages": given.stages, "need": given.need,
           "moments": given.moments, "forces": given.forces, "seed": given.seed, "population": given.population,
           "generations": given.generations}  # fmt: skip
    where.parent.mkdir(parents=True, exist_ok=True)
    shown = Progress(TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn(),
                     console=Console(stderr=True))  # fmt: skip
    with shown:
        task = shown.add_task(f"{len(steps)} numbers, {len(score.stages)} stages", total=given.generations)
        best, _ = tuning.search(
            lambda many: score.lacks(score.margins(many, seen)), first, scale, how,
            where.with_name(f"{where.name}.log"),
            lambda done, least: shown.update(task, completed=done, description=f"score {least:.4g}"),
        )  # fmt: skip
    best = np.round(best, DIGITS)
    here, there = (score.margins(np.stack([first, best]), many) for many in (seen, others))
    before, after = score.lacks(here)
    told = table(score, {"before": of_set(here), "after": of_set(here, 1), "others before": of_set(there),
                         "others after": of_set(there, 1)})  # fmt: skip
    print(f"score {before:.4g} before, {after:.4g} after\n{told}")
    if not after < before:
        return UNEXPECTED
    head = [f"{len(steps)} numbers searched for by CMA-ES: score {before:.4g} before, {after:.4g} after",
            f"sweep tune {shlex.join(args)}", f"least margins over draws of seed {exp.study.seed}, and over others of "
            f"seed {exp.study.seed + 1}:", *told.splitlines()]  # fmt: skip
    write_whole(where, file_of(case, dict(zip(steps, best.tolist(), strict=True)), head).encode())
    print(where)
    return DONE


def of_set(margins: Mapping[str, np.ndarray], k: int = 0) -> dict[str, np.ndarray]:
    """Margins (draws, stages) of one of several sets of numbers."""
    return {key: value[k] for key, value in margins.items()}


def parser() -> argparse.ArgumentParser:
    """The command's own flags."""
    made = argparse.ArgumentParser(
        prog="sweep tune", allow_abbrev=False, formatter_class=argparse.RawDescriptionHelpFormatter,
        usage="sweep tune [group=choice ...] [group.name=value ...] out=FILE.yaml [flags]", epilog=EPILOG,
        description="Search the numbers of a plan, until its margins are as they should be in all draws of a study.",
    )  # fmt: skip
    made.add_argument("--free", action="append", metavar="PATTERN[=STEP]", help="numbers to search (all), first step")
    made.add_argument("--stages", action="append", metavar="PATTERN", help="stages to judge (all)")
    made.add_argument("--need", action="append", default=[], metavar="MARGIN[@STAGES]=VALUE", help="what is aimed at")
    made.add_argument("--forces", action="store_true", help="search forces that hold the robot, too")
    made.add_argument("--check", action="store_true", help="only tell the margins of the plan as it is")
    made.add_argument("--moments", type=int, default=11, help="of each stage (11)")
    made.add_argument("--population", type=int, default=16, help="plans of a generation (16)")
    made.add_argument("--generations", type=int, default=200, help="at most (200)")
    made.add_argument("--seed", type=int, default=1, help="of the search, at least 1")
    return made


def aim(text: str) -> Aim:
    """`MARGIN[@STAGES]=VALUE`. Raises `InputError`."""
    name, _, value = text.partition("=")
    margin, _, pattern = name.partition("@")
    try:
        return Aim(margin, pattern or "*", float(value))
    except ValueError:
        raise InputError(f"--need = {text} is not allowed: MARGIN=VALUE or MARGIN@STAGES=VALUE") from None


def table(score: Score, found: Mapping[str, Mapping[str, np.ndarray]]) -> str:
    """The least of each margin (m, rad/s), and where it is that of the last column."""
    lines = {name: worst(margins) for name, margins in found.items()}
    last = list(found.values())[-1]
    where = {key: score.stages[int(np.argmin(last[key].min(axis=0)))] for key in next(iter(lines.values()))}
    shown = pd.DataFrame({**lines, "in stage": where})
    return shown.rename_axis("margin").to_markdown(floatfmt=".4g")


def file_of(case: Case, changes: Mapping[str, float], head: list[str]) -> str:
    """A file of the group `plan` with these numbers, over the manoeuvre's own plan, and comments at its head."""
    other = replace(case, plan=case.plan)
    for path, value in changes.items():
        other = replace(other, plan=other.plan.changed(path, value))
    assert isinstance(case.manoeuvre, plan_table.Tabled)
    said = plan_table.differences(plan_table.own(case), plan_table.tabled(other))
    own = case.manoeuvre.own_plan
    content = {"extends": own, **said} if own else said
    text = yaml.safe_dump(content, sort_keys=False, default_flow_style=None, width=1000)
    return "".join(f"# {line}\n" for line in head) + text

"""Search the numbers of a manoeuvre's plan by CMA-ES, and check what a plan keeps, without physics.

    python tools/search_plan.py check study=pole_sizes scenario=pole_ledge_below study.design.num=64
    python tools/search_plan.py search study=... --stages 'ledge.*' --free '*.base.*=0.02' --need base=0.02 links=0.01

The draws are a study's points, known to the planner; those of the study's next seed are not searched on and tell
whether what was found holds. A manoeuvre that can be searched has its plan's numbers in a file (conf/plan), or a
`table` of named tuples and a `plan` that takes another one in its place; any number in it can be freed. Margins are
those of `sweep.metrics.planned`; plans on free bodies are played through by the tracker (`sweep.metrics.played`), with
a ball where it rolls to. Feet are where they are commanded: where that is inside the obstacle by a `deepening`, real
links are about as much farther out.
"""

import argparse
import json
import math
import shlex
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from fnmatch import fnmatchcase
from pathlib import Path
from pprint import pformat
from typing import Any, Protocol, cast

import jax
import jax.numpy as jnp
import numpy as np
import pandas as pd
import yaml

from sweep.controllers import forces
from sweep.controllers.plan import Plan
from sweep.core.errors import InputError
from sweep.metrics import played
from sweep.metrics.planned import holding, margins
from sweep.metrics.played import by_stage, play
from sweep.models import plan_table
from sweep.models.case import Case, Manoeuvre
from sweep.models.obstacles.ball import Ball
from sweep.models.obstacles.charts import charts
from sweep.models.plan_table import PlanTable, numbers
from sweep.study.config import Experiment, compose
from sweep.study.study import is_static, parameter_columns, points

Table = Any
# what is aimed at if not told; what has no aim counts for nothing
NEED = {
    "base": 0.02,
    "links": 0.003,
    "legs": 0.025,
    "body": 0.02,
    "reach": 0.01,
    "swing": 0.015,
    "rate": -6.0,
    "edge": 0.02,
    "balance": -0.002,
}
# deviations that count alike
UNIT = {"rate": 1.0, "friction": 0.02, "torque": 10.0, "balance": 0.001, "speed": 0.02}  # others 0.01 m
PERIOD, TIMES = 0.04, 1.05  # s, of a tick in which a plan on free bodies is played; its time, with that of waiting
FRICTION = 2.5  # that forces may use, so that what is lacking is known where the believed one is too little


class Tabled(Manoeuvre, Protocol):
    """A manoeuvre whose plan can be searched."""

    @property
    def table(self) -> Table:
        """The numbers of its plan."""
        ...

    @property
    def torque_share(self) -> Any:
        """Share of the torque limit that planned forces may use; of those that plan forces."""
        ...

    def plan(self, belief: Case, table: Table | None = None) -> Any:
        """The plan, of another table in the place of its own."""
        ...


def leaves(table: Table, name: str = "") -> Iterator[tuple[str, float]]:
    """Names and values of a table's numbers. Whole numbers are not free: they are legs, or choices."""
    if isinstance(table, float):
        yield name, table
    elif isinstance(table, Mapping):
        for key, value in table.items():
            yield from leaves(value, f"{name}.{key}")
    elif isinstance(table, tuple):
        keys = getattr(table, "_fields", range(len(table)))
        for key, value in zip(keys, table, strict=True):
            yield from leaves(value, f"{name}.{getattr(value, 'name', key)}")


def changed(table: Table, values: Mapping[str, Any], name: str = "") -> Table:
    """`table` with the numbers that are named in `values` replaced."""
    if isinstance(table, float):
        return values.get(name, table)
    if isinstance(table, Mapping):
        return {key: changed(value, values, f"{name}.{key}") for key, value in table.items()}
    if isinstance(table, tuple):
        keys = getattr(table, "_fields", range(len(table)))
        parts = [changed(v, values, f"{name}.{getattr(v, 'name', k)}") for k, v in zip(keys, table, strict=True)]
        return type(table)(*parts) if hasattr(table, "_fields") else tuple(parts)
    return table


def table_of(case: Case) -> Table:
    """The numbers of a case's plan; by path where they are in a file."""
    if isinstance(case.manoeuvre, plan_table.Tabled):
        return numbers(plan_table.tabled(case), charts(case.obstacle))
    return cast(Tabled, case.manoeuvre).table


def planned(belief: Case, table: Table) -> Plan:
    """The plan by other numbers."""
    if not isinstance(belief.manoeuvre, plan_table.Tabled):
        return cast(Tabled, belief.manoeuvre).plan(belief, table)
    other = PlanTable(belief.plan.text, tuple(table), tuple(table.values()))
    return belief.manoeuvre.plan(replace(belief, plan=other))


def file_of(case: Case, table: Table, head: Sequence[str]) -> str:
    """A file of the group `plan` with these numbers, over the manoeuvre's own plan, and comments at its head."""
    other = replace(case, plan=PlanTable(case.plan.text, tuple(table), tuple(table.values())))
    changes = plan_table.differences(plan_table.own(case), plan_table.tabled(other))
    name = cast(plan_table.Tabled, case.manoeuvre).own_plan
    content = yaml.safe_dump({"extends": name, **changes}, sort_keys=False, default_flow_style=None, width=1000)
    return "".join(f"# {line}\n" for line in head) + content


def draws(exp: Experiment, seed: int) -> Case:
    """What is believed in the points of the experiment's study, as arrays over them; without a study one nominal."""
    table = points(replace(exp.study, seed=seed), exp.system, exp.settings)
    columns = parameter_columns(table)
    for column in columns:
        if is_static(column, exp.system, exp.settings):
            raise InputError(f"axis {column} cannot be drawn for a plan: it changes its stages")
    _, belief = exp.system.sides({c: table[c].to_numpy(float) for c in columns})
    return jax.tree.map(lambda x: jnp.broadcast_to(jnp.asarray(x, float), (len(table),)), belief)


def judge(
    case: Case, plan: Plan, patterns: Sequence[str], moments: int, least_normal: float | None
) -> tuple[list[str], Callable[[Case, Table], dict[str, jax.Array]]]:
    """The stages to be judged, and for a belief and a table what is left at their worst moment: margins of (S,)."""
    names = plan.names
    chosen = [
        k for k, name in enumerate(names) if any(fnmatchcase(name, p) for p in patterns) and not name.endswith(".load")
    ]  # rests, in poses that others begin and end with
    number, phases = jnp.array(chosen), jnp.linspace(0, 1, moments)
    knots = jnp.linspace(0, 1, 3)
    ticks = math.ceil(TIMES * float(np.sum(plan.duration[: chosen[-1] + 1])) / PERIOD) + len(names)

    def worst(function: Callable, at: jax.Array) -> dict[str, jax.Array]:
        seen = jax.vmap(lambda k: jax.vmap(lambda u: function(k, u))(at))(number)
        return {key: jnp.min(value, axis=1) for key, value in seen._asdict().items()}

    def left(belief: Case, table: Table) -> dict[str, jax.Array]:
        manoeuvre = cast(Tabled, belief.manoeuvre)
        plan = manoeuvre.plan(belief) if table is None else planned(belief, table)
        if type(case.obstacle) is Ball:  # what leans on something, or on another ball, is taken to rest
            seen = play(belief, plan, PERIOD, ticks)
            found = by_stage(seen, len(names))._asdict()
            speed = jnp.max(jnp.linalg.norm(seen.free.velocity, axis=-1), axis=1)
            found["zmp"] = jax.ops.segment_min(played.zero_moment(seen, PERIOD), seen.stage, len(names))  # m
            found["time"] = plan.duration  # s
            found["speed"] = -jax.ops.segment_max(speed, seen.stage, len(names))  # m/s, of the fastest body, negative
            if least_normal is not None:
                bounds = forces.Bounds(FRICTION, belief.drive.torque_limit, least_normal)
                held = played.holding(belief, seen, bounds, len(names))
                found |= {key: jnp.min(value, axis=1) for key, value in held._asdict().items()}
            return {key: value[number] for key, value in found.items()}
        found = worst(lambda k, u: margins(belief, plan, k, u), phases)
        if least_normal is not None:
            bounds = forces.Bounds(FRICTION, manoeuvre.torque_share * belief.drive.torque_limit, least_normal)
            found |= worst(lambda k, u: holding(belief, plan, k, u, bounds), knots)
        return found

    return [names[k] for k in chosen], left


def show(stages: Sequence[str], found: Mapping[str, np.ndarray], whole: bool) -> None:
    """The worst of all draws, in mm where it is a length: where it is least, and of every stage if `whole`."""
    lengths = {key: 1.0 if key in UNIT else 1e3 for key in found}
    worst = {key: lengths[key] * value.min(axis=0) for key, value in found.items()}
    if whole:
        table = pd.DataFrame(worst, index=pd.Index(stages)).replace(np.inf, np.nan)
        print(table.to_string(na_rep="", float_format=lambda x: f"{x:.4g}"))
    for key, value in worst.items():
        if np.isfinite(value.min()):
            k, unit = int(np.argmin(value)), "" if key in UNIT else " mm"
            print(f"  least {key} {value[k]:.4g}{unit}: {stages[k]}, draw {int(np.argmin(found[key][:, k]))}")


def check(given: argparse.Namespace) -> int:
    """Print what the plan keeps, over the study's draws."""
    exp = compose(given.overrides)
    table = changed(table_of(exp.case), json.loads(given.start.read_text())) if given.start else None
    plan = jax.jit(lambda case: case.manoeuvre.plan(case))(exp.case)
    stages, left = judge(exp.case, plan, given.stages, given.moments, given.least_normal)
    many = draws(exp, exp.study.seed)
    found = jax.jit(lambda cases: jax.lax.map(lambda case: left(case, table), cases, batch_size=8))(many)
    show(stages, {key: np.asarray(value) for key, value in found.items()}, True)
    return 0


def needed(text: str) -> tuple[str, str, float]:
    """A margin, the pattern of the stages that need it, and how much of it they do."""
    name, _, value = text.partition("=")
    margin, _, pattern = name.partition("@")
    return margin, pattern or "*", float(value)


def search(given: argparse.Namespace) -> int:
    """Change the free numbers until every margin is as needed, or time is up."""
    import cma  # of the extra `dev`

    exp = compose(given.overrides)
    table = table_of(exp.case)
    at = dict(leaves(table)) | (json.loads(given.start.read_text()) if given.start else {})
    pairs = [(p.rpartition("=")[0], float(p.rpartition("=")[2])) for p in given.free]
    steps = {name: step for name in at for pattern, step in pairs if fnmatchcase(name, pattern)}
    free, scale = list(steps), np.array(list(steps.values()))
    need = [*((key, "*", value) for key, value in NEED.items()), *map(needed, given.need)]
    plan = jax.jit(lambda case: case.manoeuvre.plan(case))(exp.case)
    stages, left = judge(exp.case, plan, given.stages, given.moments, given.least_normal)
    first = jnp.array([at[name] for name in free])
    seen, unseen = (draws(exp, exp.study.seed + k) for k in (0, 1))

    def over(cases: Case, x: jax.Array) -> dict[str, jax.Array]:
        tabled = changed(table, at | dict(zip(free, x, strict=True)))
        return jax.vmap(lambda case: left(case, tabled))(cases)

    def score(x: jax.Array) -> jax.Array:
        """Squares of what is lacking to the needs, in the worst draw of every stage."""
        total = given.stay * jnp.sum(((x - first) / scale) ** 2)
        for key, value in over(seen, x).items():
            aims = [{stage: aim for stage in stages if fnmatchcase(stage, p)} for k, p, aim in need if k == key]
            aim = {stage: value for found in aims for stage, value in found.items()}  # the last one counts
            wanted = jnp.array([aim.get(stage, -jnp.inf) for stage in stages])
            lack = (wanted - jnp.min(value, axis=0)) / UNIT.get(key, 0.01)
            total += jnp.sum(jnp.where(jnp.isnan(lack), 1e3, jnp.maximum(lack, 0.0)) ** 2)
        return jnp.asarray(total)

    scores, tell = jax.jit(jax.vmap(score)), jax.jit(over)
    x = np.array([at[name] for name in free])
    begins = float(scores(jnp.tile(jnp.asarray(x), (given.population, 1)))[0])  # all calls have one shape
    print(f"{len(free)} numbers, {len(stages)} stages, score {begins:.4g}", flush=True)
    told = {
        "popsize": given.population,
        "seed": given.seed,
        "verbose": -9,
        "timeout": given.minutes * 60,
        "ftarget": 1e-9,
        "tolflatfitness": 50,
    }
    strategy = cma.CMAEvolutionStrategy(np.zeros(len(free)), 1.0, told)
    while not strategy.stop():
        asked = strategy.ask()
        strategy.tell(asked, np.asarray(scores(jnp.asarray(x + scale * np.array(asked)))).tolist())
        if strategy.countiter % 25 == 0:
            print(f"  {strategy.countiter}: {strategy.best.f:.4g}, step {strategy.sigma:.3g}", flush=True)
    best = dict(zip(free, np.round(x + scale * strategy.best.x, given.digits).tolist(), strict=True))
    if isinstance(exp.case.manoeuvre, plan_table.Tabled):
        said = f"{len(free)} numbers searched for by CMA-ES: score {begins:.4g} before, {strategy.best.f:.4g} after"
        head = [said, f"python tools/search_plan.py {shlex.join(sys.argv[1:])}"]
        given.output.write_text(file_of(exp.case, changed(table, at | best), head))
    else:
        given.output.write_text(json.dumps(at | best, indent=1))
    for told, cases in (("draws searched on", seen), ("draws not seen", unseen)):
        print(f"{told}:")
        found = tell(cases, jnp.array([best[name] for name in free]))
        show(stages, {key: np.asarray(value) for key, value in found.items()}, False)
    print(pformat(changed(table, at | best), width=118))
    return 0


def main(argv: list[str] | None = None) -> int:
    """Parse, do, and tell errors in one line."""
    top = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    commands = top.add_subparsers(required=True)
    for name, action in (("check", check), ("search", search)):
        sub = commands.add_parser(name, help=action.__doc__)
        sub.set_defaults(action=action)
        sub.add_argument("overrides", nargs="+", help="as of `sweep run`")
        sub.add_argument("--stages", nargs="+", default=["*"], help="patterns of the stages to judge (all)")
        sub.add_argument("--moments", type=int, default=21, help="of each stage (21)")
        sub.add_argument("--least-normal", type=float, help="plan forces, with this of every standing foot (N)")
        sub.add_argument("--start", type=Path, help="numbers found before, JSON (of plans in files: plan=FILE)")
        if name == "search":
            sub.add_argument("--free", nargs="+", required=True, metavar="PATTERN=STEP", help="numbers, first step")
            sub.add_argument("--need", nargs="+", default=[], metavar="MARGIN[@STAGES]=VALUE", help="in m, rad/s")
            sub.add_argument(
                "--stay", type=float, default=0.0, help="what a number costs that is a first step away (0)"
            )
            sub.add_argument("--population", type=int, default=24)
            sub.add_argument("--minutes", type=float, default=10)
            sub.add_argument("--seed", type=int, default=1, help="of the search")
            sub.add_argument("--digits", type=int, default=4, help="to which numbers are rounded")
            sub.add_argument("-o", "--output", type=Path, required=True, help="for what is found: plan=FILE, or JSON")
    given = top.parse_args(argv)
    try:
        return given.action(given)
    except InputError as error:
        print(f"search_plan: {error}", file=sys.stderr)
        return 2


if __name__ == "__main__":
    sys.exit(main())

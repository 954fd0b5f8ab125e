"""Optimise the numbers of a plan file for `sweep tune`: search, check on fresh draws, and write the tuned file."""

import argparse
import dataclasses
import math
import shlex
import sys
from collections.abc import Iterable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import yaml
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from sweep.analysis.stats import success_rate
from sweep.backends import devices
from sweep.cli.execution import RunFlags, execute_experiment
from sweep.cli.exits import DONE, UNEXPECTED
from sweep.cli.plan_limits import describe_limits
from sweep.cli.plan_rollouts import PlanRollouts
from sweep.config.experiment import Experiment, compose
from sweep.contract.system import split_side_prefix
from sweep.core.errors import InputError
from sweep.core.files import write_atomically
from sweep.core.provenance import plan_search_version
from sweep.models.case import Case
from sweep.planning import plan_table
from sweep.planning.plan_table import BY_COMMAND, COMMAND, ORIGIN, RANGES, SEARCHED, SLOPES, Content
from sweep.planning.score import (
    EQUAL_DEFICIT,
    MANOEUVRE,
    MarginAim,
    PlanScore,
    broadcast_over_draws,
    least_margins,
    relative_size_changes,
)
from sweep.runs import store, tuning
from sweep.study.study import make_points, parameter_columns

NUMBER_DIGITS, SLOPE_DIGITS = 4, 3  # to which numbers are rounded, and slopes
DRAW_LABELS = ("here", "other draws")
MIN_MOMENTS = 2  # moments of a stage, at least
MIN_SLOPE_EFFECT = 0.05  # first steps by which a number has to follow a size in the farthest draw, or it does not


def tune_plan(args: argparse.Namespace) -> int:
    """Optimise a plan with the arguments of `sweep tune`; return the exit code. Raises `InputError`."""
    devices.configure_jax()
    overrides: list[str] = args.overrides
    exp = compose(overrides)
    if why := exp.system.unsupported_commands.get("tune"):
        raise InputError(f"tune is not allowed: {why}")
    case, where = exp.case, Path(exp.out or "")
    if case.manoeuvre.default_plan_name is None:
        raise InputError(f"manoeuvre.kind = {case.manoeuvre.kind} has no plan file")
    if not args.check and where.suffix != ".yaml":
        raise InputError(f"out = {exp.out or ''} is not allowed: the file of the plan, such as plans/mine.yaml")
    numbers, own = plan_table.plan_values(case), tunable_manoeuvre_parameters(case)
    patterns = args.free or ["*"]
    beside = [text for text in patterns if text.startswith(f"{MANOEUVRE}.")]
    steps = tuning.parse_free_plan_numbers(
        numbers, [text for text in patterns if text not in beside], plan_table.formula_values(case)
    )
    steps |= tuning.parse_free_plan_numbers(own, beside)
    numbers |= own
    if args.follow and beside:
        raise InputError(
            f"--free = {beside[0]} is not allowed with --follow: only numbers of the plan can depend on sizes"
        )
    sizes = nominal_drawn_parameters(exp) if args.follow else {}
    if args.by_rollouts:
        return tune_plan_by_rollouts(args, exp, {path: numbers[path] for path in steps}, steps, sizes)
    method = "linear programs, to follow sizes" if args.follow else "gradients" if args.gradients else "CMA-ES"
    aims, width = [parse_margin_aim(text) for text in args.need], args.population if method == "CMA-ES" else 1
    score = PlanScore(
        case, list(steps), aims, args.stages or ["*"], parse_margin_evaluation_counts(args.moments), args.forces, width
    )
    seen, others = (broadcast_over_draws(*tuning.draw_beliefs(exp, exp.study.seed + k)) for k in (0, 1))
    first = np.array([numbers[path] for path in steps])
    if args.check:
        print(
            margins_table(
                score,
                {name: score.margins(first, draws) for name, draws in zip(DRAW_LABELS, (seen, others), strict=True)},
            )
        )
        return DONE
    sizes = select_influential_parameters(exp, score, first, seen, sizes) if sizes else {}
    how = describe_search(args, exp, steps)
    log = open_search_log(where, how)  # refuses before what is slow
    best, slopes = search_rounded_plan_numbers(score, seen, first, sizes, how, log)
    after = {name: best + relative_size_changes(draws, sizes) @ slopes.T
             for name, draws in zip(DRAW_LABELS, (seen, others), strict=True)}  # fmt: skip
    left = {f"{name} {when}": score.margins(at, draws)
            for name, draws in zip(DRAW_LABELS, (seen, others), strict=True)
            for when, at in (("before", first), ("after", after[name]))}  # fmt: skip
    ends = (left[f"{DRAW_LABELS[0]} {when}"] for when in ("before", "after"))
    was, now = (
        float(tuning.margin_deficit_cost(score.margin_deficits(x)).mean() if args.follow else score.worst_draw_score(x))
        for x in ends
    )
    told = margins_table(score, left)
    print(f"score {was:.4g} before, {now:.4g} after\n{told}")
    if not now < was:
        print(f"sweep: no better plan was found; {where} is unchanged", file=sys.stderr)
        return UNEXPECTED
    head = [f"{len(steps)} numbers searched for by {method}: score {was:.4g} before, {now:.4g} after",
            f"least margins over draws of seed {exp.study.seed}, and over "
            f"others of seed {exp.study.seed + 1}:", *told.splitlines()]  # fmt: skip
    write_tuned_plan(args, exp, head, dict(zip(steps, best.tolist(), strict=True)), slopes, sizes)
    return DONE


def tune_plan_by_rollouts(
    args: argparse.Namespace,
    exp: Experiment,
    numbers: Mapping[str, float],
    steps: Mapping[str, float],
    sizes: Mapping[str, float],
) -> int:
    """Optimise a plan in simulation, in rounds of other draws, and write its file; return the exit code.

    Args:
        args: Arguments of `sweep tune`.
        exp: Its experiment.
        numbers: Free numbers by path.
        steps: Their first steps.
        sizes: Reference values of the sizes that they follow; if empty, the numbers themselves change.

    Raises:
        InputError: A flag is of searches without simulation.
    """
    for flag in ("stages", "need", "moments", "forces", "gradients", "check"):
        if getattr(args, flag):
            raise InputError(f"--{flag} is not allowed with --by-rollouts: rollouts are simulated whole")
    where, how = Path(exp.out or ""), describe_search(args, exp, steps)
    log, rollouts, shown = open_search_log(where, how), PlanRollouts(exp, numbers, sizes), search_progress()
    with shown:
        task = shown.add_task(f"{len(numbers)} numbers", total=args.generations)

        def draw(number: int) -> tuple[pd.DataFrame, np.ndarray]:
            points = rollouts.draw_points(exp.study.seed + number)
            return points, rollouts.relative_sizes(points) if sizes else np.ones((len(points), 1))

        def tell(done: int, mean: float) -> None:
            words = f"mean score {mean:.4g}" if done else "first round of rollouts"
            shown.update(task, completed=done, description=words)

        changes = tuning.search_by_rollouts(
            draw,
            rollouts.scores,
            np.array(list(steps.values())),
            how,
            log,
            tell,
        )
    first = np.array(list(numbers.values()))
    last = exp.study.seed + args.generations - 1
    head = [f"{len(steps)} numbers searched for by {args.generations} rounds of rollouts, two of each draw of seeds "
            f"{exp.study.seed} to {last}"]  # fmt: skip
    if sizes:
        off = np.abs(rollouts.relative_sizes(rollouts.draw_points(exp.study.seed)))
        best, slopes = first, round_slopes(changes, np.array(list(steps.values())), off)
    else:
        best, slopes = np.round(first + changes[:, 0], NUMBER_DIGITS), np.zeros((len(first), 0))
    write_tuned_plan(args, exp, head, dict(zip(steps, best.tolist(), strict=True)), slopes, sizes, last + 1)
    return DONE


def describe_search(args: argparse.Namespace, exp: Experiment, steps: Mapping[str, float]) -> dict[str, Any]:
    """Return what identifies a search, so that only the same command resumes it.

    Args:
        args: Arguments of `sweep tune`.
        exp: Its experiment.
        steps: First steps of the free numbers by path.
    """
    flags = ("stages", "need", "moments", "forces", "seed", "population", "follow", "gradients", "generations",
             "by_rollouts")  # fmt: skip
    return {"overrides": sorted(args.overrides), "free": dict(steps), **{name: getattr(args, name) for name in flags},
            "config": store.digest_values(exp.values), "code": plan_search_version()}  # fmt: skip


def open_search_log(where: Path, how: Mapping[str, Any]) -> Path:
    """Return the log beside a plan's file; raises `InputError` if it belongs to another search."""
    where.parent.mkdir(parents=True, exist_ok=True)
    log = where.with_name(f"{where.name}.log")
    tuning.resume_search_log(log, how)
    return log


def write_tuned_plan(
    args: argparse.Namespace,
    exp: Experiment,
    head: Iterable[str],
    found: Mapping[str, float],
    slopes: np.ndarray,
    sizes: Mapping[str, float],
    fresh_seed: int | None = None,
) -> None:
    """Write the file of a tuned plan; with `--simulate`, simulate draws with the plan before and after.

    Args:
        args: Arguments of `sweep tune`.
        exp: Its experiment.
        head: Comments on the search, at the head of the file.
        found: Numbers by path.
        slopes: Slopes (n, k) of the numbers by the sizes.
        sizes: Reference values of the k sizes.
        fresh_seed: Seed of draws that were not searched on, by default the one after the study's.
    """
    case, where, found, paths = exp.case, Path(exp.out or ""), dict(found), list(found)
    settings = [f"{path}={found.pop(path):g}" for path in tunable_manoeuvre_parameters(case) if path in found]
    head = [*head, *(["to be run with " + " ".join(settings)] if settings else [])]
    content = add_parameter_slopes(tuned_plan_content(case, found), paths, slopes, sizes)
    searched = {
        ORIGIN: BY_COMMAND,
        COMMAND: f"sweep tune {shlex.join(args.words)}",
        RANGES: drawn_parameter_ranges(exp),
    }
    content = {SEARCHED: searched, **content}
    write_atomically(where, format_plan_file(case, content, head).encode())
    if settings:
        print(head[-1])
    if args.simulate:
        seeds = [exp.study.seed, fresh_seed or exp.study.seed + 1]
        lines = [compare_plans(args.overrides, where, settings, seed) for seed in seeds]
        lines += describe_limits(draws_folder(where, "after", seeds[-1]))
        print("\n".join(lines))
        write_atomically(where, format_plan_file(case, content, [*head, *lines]).encode())
    print(where)


def nominal_drawn_parameters(exp: Experiment) -> dict[str, float]:
    """Return the nominal values of those sizes of robot and obstacle that the study draws at random.

    Numbers follow relative changes, so sizes of zero are left out. Raises `InputError` where no size is drawn.
    """
    told = {
        split_side_prefix(column)[1] for column in parameter_columns(make_points(exp.study, exp.system, exp.settings))
    }
    at = plan_table.plan_content(exp.case).get(SLOPES, {}).get(plan_table.AT, {})
    drawn = [path for path in sorted(told) if path.partition(".")[0] in plan_table.SIZED]
    found = {path: size for path in drawn if (size := at.get(path, float(plan_table.parameter_value(exp.case, path))))}
    if not found:
        groups = " or ".join(plan_table.SIZED)
        raise InputError(
            f"--follow is not allowed: study {exp.study.name} draws no number of {groups} whose nominal value is not 0"
        )
    return found


def drawn_parameter_ranges(exp: Experiment) -> dict[str, list[float]]:
    """Return the least and the largest value of each size of robot and obstacle in the draws of a search, by path."""
    points = make_points(exp.study, exp.system, exp.settings)
    columns = {
        split_side_prefix(column)[1]: points[column]
        for column in parameter_columns(points)
        if points[column].dtype.kind == "f"
    }
    sizes = (path for path in sorted(columns) if path.partition(".")[0] in plan_table.SIZED)
    return {path: [float(f"{end(columns[path]):.6g}") for end in (min, max)] for path in sizes}


def select_influential_parameters(
    exp: Experiment, score: PlanScore, numbers: np.ndarray, draws: Case, sizes: Mapping[str, float]
) -> dict[str, float]:
    """Select the sizes of robot and obstacle whose drawn range changes some margin of the plan.

    Slopes along other sizes, such as masses without forces, would be chance and extrapolate badly. Raises `InputError`
    where no size matters.
    """
    off = relative_size_changes(draws, sizes)
    alone = 1 + np.vstack([np.diag(np.abs(off).max(axis=0)), np.zeros((max(1, len(off) - len(sizes)), len(sizes)))])
    tried = exp.system.make_world_and_belief({path: at * alone[:, k] for k, (path, at) in enumerate(sizes.items())})[1]
    lack = np.asarray(score.margin_deficits(score.margins(numbers, broadcast_over_draws(tried, len(alone)))))
    moved = ~np.isclose(lack, lack[-1], 0.0, EQUAL_DEFICIT, equal_nan=True).all(axis=1)
    if not (found := {path: at for (path, at), feels in zip(sizes.items(), moved, strict=False) if feels}):
        raise InputError(f"--follow is not allowed: no margin depends on {', '.join(sizes)}")
    return found


def search_rounded_plan_numbers(
    score: PlanScore, draws: Case, first: np.ndarray, sizes: Mapping[str, float], how: Mapping[str, Any], log: Path
) -> tuple[np.ndarray, np.ndarray]:
    """Search for the best plan numbers with a progress bar; return rounded numbers (n,), and their slopes (n, k) by k
    sizes."""
    scale, shown = np.array(list(how["free"].values())), search_progress()
    with shown:
        task = shown.add_task(f"{len(first)} numbers, {len(score.stages)} stages", total=how["generations"])

        def tell(done: int, least: float) -> None:
            shown.update(task, completed=done, description=f"score {least:.4g}")

        if how["follow"]:
            off = relative_size_changes(draws, sizes)
            score.cap_aims_at_margins(first, broadcast_over_draws(score.case, len(off)))
            slopes = tuning.fit_plan_slopes_over_sizes(
                lambda moved: score.margin_deficits(score.margins(first + moved, draws)),
                lambda moved: score.deficit_finite_differences(first + moved, draws, scale),
                scale,
                off,
                how,
                log,
                tell,
            )
            return first, round_slopes(slopes, scale, off)
        if how["gradients"]:
            best = tuning.search_by_gradients(
                lambda numbers: score.squared_deficit_gradients(numbers, draws), first, scale, how, log, tell
            )
        else:
            best, _ = tuning.search_by_cma(
                lambda many: score.worst_draw_score(score.margins(many[:, None], draws)), first, scale, how, log, tell
            )
    return np.round(best, NUMBER_DIGITS), np.zeros((len(first), 0))


def round_slopes(slopes: np.ndarray, steps: np.ndarray, off: np.ndarray) -> np.ndarray:
    """Return rounded slopes (n, k), without those that hardly move a number in the farthest draw.

    Args:
        slopes: Slopes (n, k).
        steps: First steps (n,) of the numbers.
        off: Relative changes (draws, k) of the sizes.
    """
    slight = np.abs(slopes) * np.abs(off).max(axis=0) < MIN_SLOPE_EFFECT * steps[:, None]
    return np.where(slight, 0.0, np.round(slopes, SLOPE_DIGITS))


def search_progress() -> Progress:
    """Return the progress bar of a search, on standard error."""
    return Progress(TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn(),
                    console=Console(stderr=True))  # fmt: skip


def compare_plans(overrides: list[str], file: Path, settings: list[str], seed: int) -> str:
    """Simulate fresh draws with the plan before and after tuning, and describe how many succeed with each.

    Results are stored beside the plan's file.
    """
    words, rates = [text for text in overrides if not text.startswith("out=")], {}
    for when, more in (("before", []), ("after", [f"plan={file}", *settings])):
        kept = [text for text in words if not (more and text.startswith("plan="))]
        folder = draws_folder(file, when, seed)
        execute_experiment(compose([*kept, *more, f"study.seed={seed}", f"out={folder}"]), RunFlags())
        rates[when] = success_rate(store.read_rows(folder)["outcome"])
    before, after = (f"{found.successes} of {found.valid_count}" for found in rates.values())
    return f"simulated draws of seed {seed} that succeed: {before} before, {after} after"


def draws_folder(file: Path, when: str, seed: int) -> Path:
    """Return the folder of the draws of one seed that are simulated `before` or `after` a plan file was tuned."""
    return file.with_suffix(".draws") / f"{when}-{seed}"


def parse_margin_aim(text: str) -> MarginAim:
    """Parse an option `MARGIN[@STAGES]=VALUE`, the least value that a margin should have. Raises `InputError`."""
    name, _, value = text.partition("=")
    margin, _, pattern = name.partition("@")
    try:
        if (least := float(value)) < math.inf:
            return MarginAim(margin, pattern or "*", least)
    except ValueError:
        pass
    raise InputError(f"--need = {text} is not allowed: MARGIN=VALUE or MARGIN@STAGES=VALUE, a number")


def parse_margin_evaluation_counts(texts: Iterable[str]) -> list[tuple[str, int]]:
    """Parse patterns of stage names with the number of moments at which margins are evaluated; the last matching
    pattern counts.

    Raises `InputError`.
    """
    found = []
    for text in texts:
        pattern, _, count = text.rpartition("=")
        if not count.isdecimal() or int(count) < MIN_MOMENTS:
            raise InputError(f"--moments = {text} is not allowed: N or STAGES=N, at least {MIN_MOMENTS}")
        found.append((pattern or "*", int(count)))
    return found


def tunable_manoeuvre_parameters(case: Case) -> dict[str, float]:
    """Return the numeric parameters of the manoeuvre by path, which can be tuned along with the numbers of its plan."""
    found = {f.name: getattr(case.manoeuvre, f.name) for f in dataclasses.fields(case.manoeuvre)  # pyright: ignore[reportArgumentType]
             if f.metadata.get("role") == "quantity"}  # fmt: skip
    return {f"{MANOEUVRE}.{name}": float(value) for name, value in found.items() if value is not None}


def margins_table(score: PlanScore, margins: Mapping[str, Mapping[str, np.ndarray]]) -> str:
    """Return a table with the smallest value of each margin (m or rad/s) and the stage in which it occurs."""
    lines = {name: least_margins(values) for name, values in margins.items()}
    last = list(margins.values())[-1]
    where = {key: score.stages[int(np.argmin(last[key].min(axis=0)))] for key in next(iter(lines.values()))}
    shown = pd.DataFrame({**lines, "in stage": where})
    return shown.rename_axis("margin").to_markdown(floatfmt=".4g")


def tuned_plan_content(case: Case, changes: Mapping[str, float]) -> Content:
    """Return the content of a plan file with tuned numbers; formulas whose value did not change are kept."""
    formulas = plan_table.formula_values(case)
    for path, value in changes.items():
        if round(value - formulas.get(path, math.inf), NUMBER_DIGITS):
            case = replace(case, plan=case.plan.replace_number(path, value, formulas))
    return plan_table.plan_content(case)


def add_parameter_slopes(
    content: Content, paths: Iterable[str], slopes: np.ndarray, sizes: Mapping[str, float]
) -> Content:
    """Add to a plan's content by how much each of its numbers changes with each size of robot or obstacle."""
    if not sizes:
        return content
    part = {**content.get(SLOPES, {})}
    used = zip(sizes.items(), slopes.any(axis=0), strict=True)
    part[plan_table.AT] = {**part.get(plan_table.AT, {}), **{size: at for (size, at), follows in used if follows}}
    for path, line in zip(paths, slopes.tolist(), strict=True):
        known = part.get(path, {})
        slopes_of = zip(sizes, line, strict=True)
        more = {size: round(known.get(size, 0.0) + slope, SLOPE_DIGITS) for size, slope in slopes_of if slope}
        if known or more:
            part[path] = {**known, **more}
    return {**content, SLOPES: part}


def format_plan_file(case: Case, content: Content, head: list[str]) -> str:
    """Format a tuned plan file: comments, then all differences from the manoeuvre's own plan."""
    said = plan_table.find_overrides(plan_table.default_plan_content(case), content)
    own = case.manoeuvre.default_plan_name
    whole = {"extends": own, **said} if own else said
    text = yaml.safe_dump(whole, sort_keys=False, default_flow_style=None, width=1000)
    return "".join(f"# {line}\n" for line in head) + text

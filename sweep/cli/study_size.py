"""How many rollouts a question needs, for `sweep power`: from guessed probabilities or from a pilot study."""

import argparse
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.ticker import NullFormatter

from sweep.analysis import compare, power, sampling_units
from sweep.analysis.intervals import clopper_pearson, wilson
from sweep.analysis.stats import format_percent, sum_by_independent_unit
from sweep.config.experiment import Experiment
from sweep.core.errors import InputError
from sweep.core.plot_style import COLUMN_WIDTH_IN, new_figure, save_figure
from sweep.report.tables import markdown_table
from sweep.runs import results, store
from sweep.study import design_kinds
from sweep.study.design_kinds.base import AdaptiveDesign

TABLE_FACTORS = (0.25, 0.5, 1.0, 2.0, 4.0)  # of the answer: sizes of the table
CURVE_FACTORS = np.geomspace(0.1, 4.0, 15)  # of the answer: sizes of the picture
# options of each question, with their values if they are not given; `--pilot` takes the place of probabilities
OPTIONS: dict[str, dict[str, Any]] = {
    "rate": {"half_width": 0.02},
    "difference": {"correlation": 0.0, "unpaired": False},
    "rare": {"relative": 0.5},
    "region": {"failures": 0.01, "share": 1.0},
}
NUMBERS = {"rate": 1, "difference": 2, "rare": 1, "region": 1}  # expected probabilities of each question


@dataclass(frozen=True)
class StudySizeEstimate:
    """Result of `sweep power`: the smallest study that answers a question, and what studies of other sizes reach."""

    question: str  # in words
    size: int  # independent units, or pairs of them
    unit: str  # plural
    rollouts_per_unit: float
    goal: str  # what the table's column means
    value: Callable[[int], float]  # of a study of this size, as a share
    target: float  # of the value
    method: str
    notes: tuple[str, ...] = ()
    seconds: float | None = None  # of a rollout

    @property
    def rollout_count(self) -> int:
        """Number of rollouts of the smallest sufficient study."""
        return round(self.size * self.rollouts_per_unit)

    def values(self, factors: Any) -> pd.DataFrame:
        """Return a table of studies `factors` times as large: units, rollouts, and the value of the goal."""
        sizes = sorted({max(round(self.size * factor), 2) for factor in factors})
        rollouts = [round(size * self.rollouts_per_unit) for size in sizes]
        return pd.DataFrame({self.unit: sizes, "rollouts": rollouts, self.goal: [self.value(n) for n in sizes]})


def compute_study_size(args: argparse.Namespace) -> StudySizeEstimate:
    """Compute how many rollouts the question of `sweep power` needs. Raises `InputError` for a wrong number."""
    options = select_question_options(args)
    for key in ("power", "level"):
        check_share(f"--{key}", getattr(args, key))
    if args.seconds is not None and not args.seconds > 0:
        raise InputError(f"--seconds = {args.seconds:g} is not allowed: above 0")
    if args.pilot:
        answer = size_from_pilot(args, options)
    else:
        for p in args.expected:
            check_share("P", p)
        answer = size_from_guessed_rates(args, options)
    if args.seconds is not None:
        answer = StudySizeEstimate(**{**vars(answer), "seconds": args.seconds})
    return answer


def select_question_options(args: argparse.Namespace) -> dict[str, Any]:
    """Return the options that belong to the question of `sweep power`. Raises `InputError` for those of another one."""
    every = {key: question for question, keys in OPTIONS.items() for key in keys}
    for key, question in every.items():
        if getattr(args, key) not in (None, False) and question != args.question:
            raise InputError(f"--{key.replace('_', '-')} is for `sweep power {question}`")
    own = OPTIONS[args.question]
    values = {key: own[key] if getattr(args, key) is None else getattr(args, key) for key in own}
    for key in ("half_width", "relative", "failures"):
        if key in values:
            check_share(f"--{key.replace('_', '-')}", values[key])
    if "share" in values and not 0 < values["share"] <= 1:
        raise InputError(f"--share = {values['share']:g} is not allowed: above 0 and at most 1")
    wanted = 0 if args.pilot else NUMBERS[args.question]
    if len(args.expected) != wanted:
        words = "none besides --pilot" if args.pilot else f"{wanted} expected, or --pilot"
        raise InputError(f"P = {' '.join(map(str, args.expected)) or 'none'} is not allowed: {words}")
    return values


def check_share(name: str, value: float) -> None:
    """Raise `InputError` unless a value lies between 0 and 1."""
    if not 0 < value < 1:
        raise InputError(f"{name} = {value:g} is not allowed: between 0 and 1")


def size_from_guessed_rates(args: argparse.Namespace, options: dict[str, Any]) -> StudySizeEstimate:
    """Compute the size of a study of independent rollouts from guessed probabilities of success or failure."""
    p, level, wanted = args.expected[0], args.level, args.power
    sure = f"in {format_percent(wanted)} of studies"
    if args.question == "rate":
        goal = options["half_width"]
        size = power.rollouts_for_half_width(p, goal, wanted, wilson, level)
        return StudySizeEstimate(
            f"interval of a success rate of {format_percent(p)} within ±{format_percent(goal)} {sure}",
            size, "rollouts", 1, "expected half-width", lambda n: power.expected_half_width(n, p, wilson, level),
            goal, f"exact, Wilson interval, {format_percent(level)}",
        )  # fmt: skip
    if args.question == "rare":
        goal = options["relative"]
        size = power.rollouts_for_half_width(p, goal * p, wanted, clopper_pearson, level)
        searches = " or ".join(design_kinds.list_kinds(lambda kind: issubclass(kind, AdaptiveDesign)))
        return StudySizeEstimate(
            f"interval of a failure probability of {p:g} within ±{format_percent(goal)} of it {sure}",
            size, "rollouts", 1, "expected half-width, share of the probability",
            lambda n: power.expected_half_width(n, p, clopper_pearson, level) / p,
            goal, f"exact, Clopper-Pearson interval, {format_percent(level)}",
            (f"study.design.kind={searches} estimates a small probability with far fewer rollouts",),
        )  # fmt: skip
    if args.question == "region":
        if p >= options["failures"]:
            raise InputError(f"P = {p:g} is not allowed: below --failures = {options['failures']:g}")
        given = options["share"], p, options["failures"], level
        size = power.find_smallest_sample_size(lambda n: power.certification_power(n, *given) >= wanted)
        return StudySizeEstimate(
            f"certify that at most {format_percent(options['failures'])} fail in a region with "
            f"{format_percent(options['share'])} of the draws, if {format_percent(p)} fail",
            size, "fresh draws", 1, "power", lambda n: power.certification_power(n, *given), wanted,
            f"exact, Clopper-Pearson bound, {format_percent(level)}",
            ("these draws test the region; others have to learn it (--rollouts of `sweep certify`)",),
        )  # fmt: skip
    return size_from_guessed_difference(args, options)


def size_from_guessed_difference(args: argparse.Namespace, options: dict[str, Any]) -> StudySizeEstimate:
    """Compute how many rollouts tell two policies of guessed success rates apart. Raises `InputError` if equal."""
    (a, b), level, wanted = args.expected, args.level, args.power
    if a == b:
        raise InputError(f"P = {a:g} {b:g} is not allowed: equal rates need infinitely many rollouts")
    question = f"find which of two policies is better, if {format_percent(a)} and {format_percent(b)} succeed"
    if options["unpaired"]:
        if options["correlation"]:
            raise InputError("--correlation is not allowed with --unpaired")
        size = power.find_smallest_sample_size(lambda n: power.unpaired_test_power(n, a, b, level) >= wanted, 2)
        return StudySizeEstimate(
            question, size, "rollouts of each", 2, "power", lambda n: power.unpaired_test_power(n, a, b, level), wanted,
            f"exact, score test, {format_percent(level)}",
        )  # fmt: skip
    lost, gained = power.discordant_pair_shares(a, b, options["correlation"])
    size = power.find_smallest_sample_size(lambda n: power.mcnemar_power(n, lost, gained, level) >= wanted)
    return StudySizeEstimate(
        question, size, "pairs", 2, "power", lambda n: power.mcnemar_power(n, lost, gained, level), wanted,
        f"exact, McNemar's test, {format_percent(level)}; {format_percent(lost)} of the pairs succeed only in A, "
        f"{format_percent(gained)} only in B",
        (sequential_test_note(lost, gained, level),),
    )  # fmt: skip


def sequential_test_note(lost: float, gained: float, level: float) -> str:
    """State how many pairs of rollouts the sequential test `sweep compare --anytime` needs until it decides."""
    median, most = power.pairs_until_decision(lost, gained, level)
    return (
        f"`sweep compare --anytime`, which stops by itself, takes {median:.0f} pairs (median), "
        f"{most:.0f} in nine of ten comparisons (simulated)"
    )


def size_from_pilot(args: argparse.Namespace, options: dict[str, Any]) -> StudySizeEstimate:
    """Compute the size of a study by resampling the independent units of one or two small pilot studies."""
    wanted = 2 if args.question == "difference" else 1
    if args.question not in ("rate", "difference") or len(args.pilot) != wanted:
        raise InputError("--pilot takes one folder for `sweep power rate`, two for `sweep power difference`")
    exps = [results.load_experiment(folder) for folder in args.pilot]
    rows = [store.read_rows(folder) for folder in args.pilot]
    seconds = mean_rollout_wall_time(args.pilot)
    if args.question == "rate":
        return size_from_pilot_rate(args, options["half_width"], exps[0], rows[0], seconds)
    if options["unpaired"] or options["correlation"]:
        raise InputError("--unpaired and --correlation are not allowed with --pilot, whose rows are paired")
    return size_from_pilot_difference(args, exps[0], compare.pair_rows(rows[0], rows[1]), seconds)


def mean_rollout_wall_time(folders: list[Path]) -> float | None:
    """Return the mean wall time of a rollout (s) in the last batches of folders; None where one is unknown."""
    seconds = [store.last_rollout_wall_time_s(folder) for folder in folders]
    known = [one for one in seconds if one is not None]
    return float(np.mean(known)) if len(known) == len(seconds) else None


def nonrandom_pilot_error(folder: Path) -> InputError:
    """Return the error for a pilot study whose rows are not a random sample."""
    return InputError(f"--pilot = {folder} is not allowed: its points are no random draws, so that rates have no error")


def size_from_pilot_rate(
    args: argparse.Namespace, goal: float, exp: Experiment, rows: pd.DataFrame, seconds: float | None
) -> StudySizeEstimate:
    """Compute how many units like those of a pilot study narrow the interval of its success rate enough."""
    unit = sampling_units.unit_numbers(rows, exp)
    if unit is None or exp.study.is_sequential:
        raise nonrandom_pilot_error(args.pilot[0])
    valid = (rows["outcome"] != "invalid").to_numpy()
    kind = sampling_units.independent_unit(exp.study)
    pilot = power.count_unit_successes((rows["outcome"] == "success").to_numpy()[valid], unit[valid], kind.is_even)
    size = power.units_for_half_width(pilot, goal, args.power, args.level)
    rate = pilot.won.sum() / pilot.trials.sum()
    return StudySizeEstimate(
        f"interval of the success rate of {args.pilot[0]} ({format_percent(rate)}) within ±{format_percent(goal)} "
        f"in {format_percent(args.power)} of studies",
        size, kind.plural, len(rows) / len(pilot.won), "expected half-width",
        lambda n: float(np.mean(power.simulated_half_widths(pilot, n, args.level))), goal,
        f"simulated from {len(pilot.won)} {kind.plural}, {sampling_units.interval_method(exp.study)}, "
        f"{format_percent(args.level)}",
        small_pilot_warning(len(pilot.won)), seconds,
    )  # fmt: skip


def size_from_pilot_difference(
    args: argparse.Namespace, exp: Experiment, pairs: pd.DataFrame, seconds: float | None
) -> StudySizeEstimate:
    """Compute how many units like those of two pilot studies show which of two policies is better."""
    unit = compare.pair_sampling_unit_ids(pairs, exp)
    if unit is None:
        raise nonrandom_pilot_error(args.pilot[0])
    first, second = pairs["outcome"], pairs[f"outcome{compare.SECOND_RUN_MARK}"]
    valid = ((first != "invalid") & (second != "invalid")).to_numpy()
    change = (first == "success").astype(int) - (second == "success").astype(int)
    differences = sum_by_independent_unit(change.to_numpy()[valid], unit[valid])[0].astype(int)
    if not differences.sum():
        raise InputError("--pilot: both folders succeed equally often, so that no number of rollouts tells them apart")
    size = power.find_smallest_sample_size(
        lambda n: power.simulated_sign_flip_power(differences, n, args.level) >= args.power, checked=0
    )
    mean = change[valid].mean()
    return StudySizeEstimate(
        f"find which of {args.pilot[0]} and {args.pilot[1]} is better, if the true difference is {100 * mean:.1f} "
        "percentage points as in these rows",
        size, f"{sampling_units.independent_unit(exp.study).plural} in both", 2 * len(pairs) / len(differences),
        "power", lambda n: power.simulated_sign_flip_power(differences, n, args.level), args.power,
        f"simulated from {len(differences)} units, the test of `sweep compare`, {format_percent(args.level)}",
        small_pilot_warning(len(differences)), seconds,
    )  # fmt: skip


def small_pilot_warning(units: int) -> tuple[str, ...]:
    """Return a warning if a pilot study has few independent units, else an empty tuple."""
    return (f"{units} units are few: the answer may be off by half",) if units < 100 else ()


def format_size_estimate(answer: StudySizeEstimate) -> str:
    """Format the result of `sweep power` as Markdown: rollouts, method, table of sizes, and duration."""
    table = answer.values(TABLE_FACTORS)
    table = table.loc[:, ~table.columns.duplicated()]
    shown = table.assign(**{answer.goal: [format_percent(v) for v in table[answer.goal]]})
    lines = [
        f"{answer.rollout_count:,} rollouts: {answer.question}",
        f"({answer.method})",
        "",
        markdown_table(shown),
        *(["", *answer.notes] if answer.notes else []),
        "",
        expected_duration_text(answer),
    ]
    return "\n".join(lines) + "\n"


def expected_duration_text(answer: StudySizeEstimate) -> str:
    """State how long the study takes (s) at the measured or given wall time per rollout."""
    if answer.seconds is None:
        return "duration unknown: give --pilot, or --seconds of a rollout (`sweep bench` measures them)"
    total = answer.rollout_count * answer.seconds
    return f"about {total:,.0f} s at {answer.seconds:.3g} s a rollout, without compilation"


def size_estimate_json_values(answer: StudySizeEstimate) -> dict[str, Any]:
    """Convert the result of `sweep power` to plain values for JSON."""
    return {
        "question": answer.question,
        "rollouts": answer.rollout_count,
        "size": answer.size,
        "unit": answer.unit,
        "method": answer.method,
        "goal": answer.goal,
        "seconds": None if answer.seconds is None else answer.rollout_count * answer.seconds,
        "sizes": answer.values(TABLE_FACTORS).to_dict("records"),
    }


def save_size_plot(answer: StudySizeEstimate, path: Path) -> None:
    """Draw the quantity to reach, such as power, over the number of rollouts, and mark the smallest study."""
    table = answer.values(CURVE_FACTORS)
    figure = new_figure(0.62 * COLUMN_WIDTH_IN, COLUMN_WIDTH_IN)
    ax = figure.add_subplot()
    ax.plot(table["rollouts"], 100 * table[answer.goal], color="#00649E")
    ax.axhline(100 * answer.target, color="0.6", linewidth=0.6)
    ax.plot(answer.rollout_count, 100 * answer.value(answer.size), "o", color="#D55E00")
    ax.set(xlabel="rollouts", ylabel=f"{answer.goal}, %", xscale="log")
    ax.xaxis.set_minor_formatter(NullFormatter())
    ax.set_ylim(bottom=0)
    save_figure(figure, path)

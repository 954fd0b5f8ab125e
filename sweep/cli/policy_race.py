"""Read the rows of several policies for `sweep league`, and simulate more draws until they are ranked."""

import argparse
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd

from sweep.analysis import compare, sampling_units
from sweep.analysis.compare import BINS_PER_AXIS, SECOND_RUN_MARK
from sweep.analysis.league import PairedPolicyOutcomes, PolicyRace
from sweep.analysis.stats import bin_values
from sweep.cli.anytime import next_draw_count, simulate_more_draws
from sweep.cli.rows import read_matching_rows
from sweep.config.experiment import Experiment
from sweep.core.errors import InputError
from sweep.core.expressions import find_column
from sweep.report.league import CAUSE, WON, format_race
from sweep.runs import extend, results
from sweep.study.columns import LABEL_COLUMNS
from sweep.study.study import parameter_columns, rollout_id_columns


def read_policy_outcomes(args: argparse.Namespace) -> tuple[PairedPolicyOutcomes, str, Experiment]:
    """Read the rows of all policies that `sweep league` compares, and pair those of equal points.

    Args:
        args: Arguments of the command.

    Returns:
        The outcomes, the plural of the independent unit, and the experiment of the first policy.

    Raises:
        InputError: There are fewer than two policies, or their rows do not match.
    """
    exp, rows, key = read_policy_rows(args)
    paired = pair_policy_rows(rows, key)
    league = collect_valid_policy_outcomes(paired, tuple(rows), exp)
    kind = sampling_units.independent_unit(exp.study)
    unit = "draws" if kind.is_even else kind.plural  # see `sampling_units.paired_comparison_unit_ids`
    return league, unit, exp


def bin_conditions(league: PairedPolicyOutcomes, by: list[str]) -> tuple[PairedPolicyOutcomes, list[str]]:
    """Cut the columns whose values are conditions of a league into bins.

    Args:
        league: Outcomes of the policies.
        by: Names of the columns.

    Returns:
        The outcomes with bins instead of values in these columns, and the columns.

    Raises:
        InputError: A name is no column.
    """
    columns = [find_column(league.conditions, name) for name in by]
    bins = {column: bin_values(league.conditions[column], BINS_PER_AXIS) for column in columns}
    return replace(league, conditions=league.conditions.assign(**bins)), columns


def read_policy_rows(args: argparse.Namespace) -> tuple[Experiment, dict[str, pd.DataFrame], list[str] | None]:
    """Read the rows of each policy: from a folder for each, or by the values of an axis in one folder.

    Returns:
        The experiment of the first one, rows by the name of the policy, and the columns by which rows are paired; None
        for those of `compare.pair_rows`.

    Raises:
        InputError: There are fewer than two policies.
    """
    exp = results.load_experiment(args.dirs[0])
    if not args.axis:
        if len(args.dirs) < 2:
            raise InputError("DIR: give the folder of each policy, or one folder with --axis")
        names = shortest_distinct_folder_names(args.dirs)
        read = (read_matching_rows(folder, args.where) for folder in args.dirs)
        return exp, dict(zip(names, map(select_point_and_outcome_columns, read), strict=True)), None
    if len(args.dirs) > 1:
        raise InputError("DIR: --axis ranks the values of an axis of one folder")
    rows = read_matching_rows(args.dirs[0], args.where)
    column = find_column(rows, args.axis)
    if column not in parameter_columns(rows) or rows[column].nunique() < 2:
        raise InputError(f"--axis = {args.axis} is not allowed: an axis with at least two values")
    groups = rows.groupby(column, observed=True, sort=False)
    fixed = [c for c in parameter_columns(rows) if groups[c].nunique().max() <= 1]  # that go with the policy
    key = [c for c in parameter_columns(rows) if c not in fixed or rows[c].nunique() == 1]
    parts = {format_policy_name(value): select_point_and_outcome_columns(part) for value, part in groups}
    return exp, parts, [*key, "replicate"]


def format_policy_name(value: object) -> str:
    """Write a value of an axis as the name of a policy."""
    return f"{value:g}" if isinstance(value, float) else str(value)


def shortest_distinct_folder_names(folders: Sequence[Path]) -> list[str]:
    """Return the shortest names that tell the folders apart."""
    names = [folder.name for folder in folders]
    return names if len(set(names)) == len(names) else [str(folder) for folder in folders]


def select_point_and_outcome_columns(rows: pd.DataFrame) -> pd.DataFrame:
    """Return the rows with only the columns that identify them (point, parameters) and hold their outcome."""
    known = {*rollout_id_columns(rows.columns), *parameter_columns(rows), *LABEL_COLUMNS, "replicate"}
    kept = rows[[c for c in rows if c in known]]
    kept.attrs.update(rows.attrs)
    return kept


def pair_policy_rows(rows: dict[str, pd.DataFrame], key: list[str] | None) -> pd.DataFrame:
    """Return the rows of the first policy that all others have, too, with the outcome and cause of each policy.

    Args:
        rows: Rows by the name of the policy.
        key: Columns that are equal for rows of one point; None for those of `compare.pair_rows`.

    Returns:
        The rows of the first policy that every other one has, with the outcome of policy k in column `WON`.format(k),
        and its cause in `CAUSE`.format(k).

    Raises:
        InputError: Rows have no partner, or several.
    """
    first, *others = rows.values()
    joined = first.assign(**{WON.format(0): first["outcome"], CAUSE.format(0): first["cause"]})
    for number, other in enumerate(others, 1):
        pairs = compare.pair_rows(joined, other, key)
        outcome, cause = (pairs[f"{name}{SECOND_RUN_MARK}"] for name in ("outcome", "cause"))
        kept = pairs[[c for c in pairs if not str(c).endswith(SECOND_RUN_MARK)]]
        joined = kept.assign(**{WON.format(number): outcome, CAUSE.format(number): cause})
    joined.attrs.update(first.attrs)
    return joined


def collect_valid_policy_outcomes(
    paired: pd.DataFrame, policies: tuple[str, ...], exp: Experiment
) -> PairedPolicyOutcomes:
    """Return the outcomes of all policies at the points where the rollout of every policy is valid.

    Args:
        paired: Rows of `pair_policy_rows`.
        policies: Names of the policies.
        exp: Experiment of the first one.
    """
    outcomes = paired[[WON.format(k) for k in range(len(policies))]].to_numpy()
    invalid = outcomes == "invalid"
    valid = ~invalid.any(axis=1)
    if not valid.any():
        raise InputError("no point is valid for all policies")
    unit = sampling_units.paired_comparison_unit_ids(paired, exp)
    return PairedPolicyOutcomes(
        policies,
        (outcomes == "success")[valid],
        None if unit is None else unit[valid],
        paired[valid].reset_index(drop=True),
        tuple(int(n) for n in invalid.sum(axis=0)),
    )


def race_policies(args: argparse.Namespace) -> str:
    """Compare policies sequentially and return the state as text; with `--most`, simulate more draws until decided.

    A folder grows by a batch or a quarter of its draws at a time. Folders whose policy has no open pair stay as they
    are. Raises `InputError`.
    """
    if args.most is not None and args.most < 1:
        raise InputError(f"--most = {args.most} is not allowed: at least 1")
    if args.axis:
        raise InputError("--axis is not allowed with --anytime, which needs a folder for each policy")
    exp, rows, _ = read_policy_rows(args)
    folders, names = list(args.dirs), list(rows)
    exps = [exp, *(results.load_experiment(folder) for folder in folders[1:])]
    pair_policy_rows(rows, None)  # which refuses policies of different points
    most = 0 if args.most is None else args.most  # draws
    while True:
        shares = unit_success_rates(list(rows.values()), exps)
        race = PolicyRace(len(names), args.level)
        race.add_unit_success_rates(shares)
        is_open = race.undecided_policies(args.best)
        draws = [extend.count_draws(one) for one in exps]
        behind = [k for k in np.flatnonzero(is_open) if draws[k] < most]
        if not behind:
            counts = [int(np.isfinite(one).sum()) for one in shares.T]
            unit = sampling_units.independent_unit(exp.study)
            return format_race(names, race, counts, "draws" if unit.is_even else unit.plural, args.best)
        for k in behind:
            extend.check_extendable(exps[k], folders[k])
        least = min(behind, key=lambda k: draws[k])
        number = min(next_draw_count(exps[least], folders[least]), most)
        for k in behind:
            if draws[k] < number:
                exps[k] = simulate_more_draws(exps[k], folders[k], number)
                rows[names[k]] = select_point_and_outcome_columns(read_matching_rows(folders[k], args.where))


def unit_success_rates(rows: list[pd.DataFrame], exps: list[Experiment]) -> np.ndarray:
    """Return the success rate of each policy in each independent unit (group of dependent rows).

    Args:
        rows: Rows of each policy.
        exps: Their experiments, which differ in the policy alone.

    Returns:
        Rates (u, policies) in the order of the units; NaN where a policy has no row, or an invalid one.

    Raises:
        InputError: The points are no random draws.
    """
    parts = []
    for one, exp in zip(rows, exps, strict=True):
        unit = sampling_units.paired_comparison_unit_ids(one, exp)
        if unit is None:
            raise InputError("--anytime needs random draws, or noisy replicates of one point")
        won = (one["outcome"] == "success").astype(float)
        won = won.where(one["outcome"] != "invalid")
        parts.append(won.groupby(unit).agg(lambda values: values.mean(skipna=False)))
    return pd.concat(parts, axis=1).sort_index().to_numpy()

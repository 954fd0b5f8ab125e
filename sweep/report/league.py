"""Text and figure of `sweep league`: success rates of several policies, and which of them beats which."""

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from sweep.analysis.league import (
    NOT_DECIDED,
    PairedPolicyOutcomes,
    PolicyRace,
    decided_win_matrix,
    pairwise_test_table,
    policy_success_rates,
    policy_success_rates_by_condition,
    standings,
)
from sweep.analysis.stats import format_percent
from sweep.core.plot_style import PAGE_WIDTH_IN, new_figure
from sweep.report.outcome_style import FAILURE_COLOUR, SUCCESS_COLOUR
from sweep.report.tables import markdown_table

LINE_HEIGHT_IN, MARGIN_IN = 0.2, 0.7  # of a policy in the figure, and of its axis
WON, CAUSE = "outcome of policy {}", "cause of policy {}"  # columns of paired rows
BETTER, OPEN, WORSE = "▲", "·", "▽"  # than the policy of the column


def standings_and_pair_table(league: PairedPolicyOutcomes, level: float) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Return a table of the policies, sorted by success rate, and a table that compares all pairs of them.

    Args:
        league: Outcomes of the policies.
        level: Confidence level of all verdicts together, and of all intervals together.
    """
    rates, pairs = policy_success_rates(league, level), pairwise_test_table(league, level)
    if league.unit is None:
        return rates.sort_values("share", ascending=False, kind="stable").reset_index(drop=True), pairs
    return standings(rates, decided_win_matrix(pairs, league.policies)), pairs


def format_league(
    league: PairedPolicyOutcomes, table: pd.DataFrame, pairs: pd.DataFrame, level: float, unit: str, by: list[str]
) -> str:
    """Describe the comparison of several policies as Markdown: success rates with ranks, pairs and conditions.

    Args:
        league: Outcomes of the policies.
        table: Sorted policies, see `standings_and_pair_table`.
        pairs: Pairs with their verdicts.
        level: Confidence level of all verdicts together, and of all intervals together.
        unit: Plural of the independent unit.
        by: Columns of `league.conditions` whose values are conditions.
    """
    lines = [describe_points(league, unit)]
    lines += [
        f"{number:,} points are invalid for {name} and left out for all"
        for name, number in zip(league.policies, league.invalid, strict=True)
        if number
    ]
    lines += ["", markdown_table(table), ""]
    if league.unit is not None:
        lines += [f"{count_decided_pairs(pairs)}. {describe_confidence(level)}", ""]
    shares = [c for c in ("difference", "low", "high") if c in pairs]
    lines.append(markdown_table(pairs.assign(**{c: [format_percent(v) for v in pairs[c]] for c in shares})))
    if by:
        rates = policy_success_rates_by_condition(league, by, level)
        shown = rates.assign(**{name: [format_percent(v) for v in rates[name]] for name in league.policies})
        lines += ["", f"By {', '.join(by)}:", "", markdown_table(shown)]
    return "\n".join(lines) + "\n"


def describe_points(league: PairedPolicyOutcomes, unit: str) -> str:
    """Describe on how many points policies were compared, and whether these are a random sample.

    Args:
        league: Outcomes of the policies.
        unit: Plural of the independent unit.
    """
    text = f"{len(league.policies)} policies on the same {len(league.success):,} points"
    if league.unit is None:
        return f"{text}, which were chosen and not drawn: no intervals and no verdicts"
    return f"{text} ({league.independent_unit_count:,} {unit})"


def count_decided_pairs(pairs: pd.DataFrame) -> str:
    """State how many pairs of policies are decided, for pairs with verdicts."""
    return f"{int((pairs['verdict'] != NOT_DECIDED).sum())} of {len(pairs)} pairs are decided"


def describe_confidence(level: float) -> str:
    """State which statements about a league hold together at a confidence level, and by which methods."""
    return (
        f"With {format_percent(level)} confidence all verdicts hold together (exact paired tests, Holm), as do all "
        "intervals of rates (Bonferroni) and of differences (max-t bootstrap)"
    )


def format_race(policies: list[str], race: PolicyRace, units: list[int], unit: str, only_best: bool) -> str:
    """Describe the state of a sequential comparison of policies (race) as text.

    Args:
        policies: Names of the policies.
        race: The race.
        units: Number of units of each policy.
        unit: Plural of the independent unit.
        only_best: Whether only the best policy is wanted.
    """
    wins, losses = race.better.sum(axis=1), race.better.sum(axis=0)
    open_pairs = race.number - 1 - wins - losses
    table = pd.DataFrame(
        {"policy": policies, unit: units, "beats": wins, "beaten_by": losses, "not_decided": open_pairs}
    )
    table = table.iloc[np.lexsort((losses, -wins))]
    total, pairs = race.number * (race.number - 1) // 2, int(race.better.sum())
    lines = [markdown_table(table), "", f"{pairs} of {total} pairs are decided, however often one looked"]
    left = [name for name, is_open in zip(policies, race.undecided_policies(only_best), strict=True) if is_open]
    if only_best and not left:
        lines.append(f"best: {policies[int(np.flatnonzero(~race.better.any(axis=0))[0])]}")
    elif left:
        lines.append(f"need more {unit}: {', '.join(left)}")
    return "\n".join(lines) + "\n"


def draw_league(table: pd.DataFrame, pairs: pd.DataFrame) -> Figure:
    """Draw the rates of the policies with their intervals, and a matrix of which policy beats which.

    Args:
        table: Sorted policies, see `standings_and_pair_table`.
        pairs: Pairs with their verdicts.
    """
    names = [str(name) for name in table["policy"]]
    figure = new_figure(MARGIN_IN + LINE_HEIGHT_IN * (len(names) + 1), PAGE_WIDTH_IN)
    left, right = figure.subplots(1, 2, width_ratios=[1.2, 1])
    y = np.arange(len(names))
    if "low" in table:
        ends = np.abs(table[["low", "high"]].to_numpy().T - table["share"].to_numpy())
        left.errorbar(100 * table["share"], y, xerr=100 * ends, fmt="o", color="#00649E", capsize=2, markersize=3)
    else:
        left.plot(100 * table["share"], y, "o", color="#00649E", markersize=3)
    left.set(yticks=y, yticklabels=names, xlabel="success rate, %", ylim=(len(names) - 0.5, -0.5))
    left.grid(axis="x", linewidth=0.3)
    right.set(xticks=y, yticks=y, xlim=(-0.5, len(names) - 0.5), ylim=(len(names) - 0.5, -0.5))
    right.set_xticklabels(names, rotation=90)
    right.set_yticklabels([])
    right.set_aspect("equal")
    right.set_xlabel("row is better ▲ or worse ▽ than column")
    if "verdict" in pairs:
        better = decided_win_matrix(pairs, names)
        for i, j in np.ndindex(better.shape):
            mark, colour = (
                (BETTER, SUCCESS_COLOUR) if better[i, j] else (WORSE, FAILURE_COLOUR) if better[j, i] else (OPEN, "0.4")
            )
            if i != j:
                right.text(j, i, mark, color=colour, ha="center", va="center")
    return figure

"""One sentence with the main result of a study: its success rate, or the failure probability that it searched for."""

import numpy as np
import pandas as pd

from sweep.analysis import rare
from sweep.analysis.sample import pooled_success_rate
from sweep.analysis.stats import format_percent
from sweep.config.experiment import Experiment
from sweep.core.errors import InputError, escape_control_characters
from sweep.runs.results import Results

PLACED_AT_BOUNDARY = "most rollouts were placed next to the boundary, so this is not the share of the region"


def study_headline(rows: pd.DataFrame, exp: Experiment) -> str:
    """State the main result of a study in a sentence.

    Args:
        rows: finished rows of the study, all of them or some.
        exp: its experiment.

    Returns:
        How many of the rows succeed, with an interval where they are a sample. Of a study that searches for failures
        P(failure) with its interval: its rows are no sample, so that their share of successes is no rate.
    """
    if not exp.study.is_adaptive:
        return f"{pooled_success_rate(rows, exp)}{f'; {PLACED_AT_BOUNDARY}' if exp.study.is_refined else ''}"
    return f"{probability_of_failure(rows, exp)}; {describe_adaptive_rollouts(rows)}"


def describe_setup(results: Results) -> str:
    """Name scenario, robot, manoeuvre or model, engine, design and number of rollouts in a sentence, for captions."""
    exp = results.exp
    about = {"scenario": exp.scenario, **exp.system.settings_summary(exp.settings)}
    words = ", ".join(f"{word} {value}" for word, value in about.items())
    return f"{words[0].upper()}{words[1:]}; {describe_design(results)}; n = {len(results.rows):,} rollouts."


def describe_design(results: Results) -> str:
    """Name the design of a study in a few words: how its points were chosen."""
    study = results.exp.study
    parts = ["each parameter alone" if results.is_one_at_a_time else "grid"] if results.numeric_grid_columns else []
    if study.points:
        parts = ["points from a file"]
    if study.is_refined:
        parts = ["grid refined at the boundary"]
    if study.design.num:
        parts.append(study.design.kind.replace("_", " "))
    return " of ".join(parts) or "single point"


def describe_main_failure(rows: pd.DataFrame, exp: Experiment) -> str:
    """Describe the most frequent failure: the most common cause, or the largest failure mode of an adaptive study.

    Args:
        rows: Finished rows of the study.
        exp: Its experiment.
    """
    if exp.study.is_adaptive:
        modes = rare.failure_modes(rows, exp)
        if modes.empty:
            return "no rollout failed"
        cause, share = escape_control_characters(str(modes["cause"].iloc[0])), float(modes["share"].iloc[0])
        return f"largest failure mode: {cause} ({format_percent(share)} of P(failure))"
    causes = rows.loc[rows["outcome"] == "failure", "cause"].value_counts()
    if causes.empty:
        return "no rollout failed"
    name, number, total = str(causes.index[0]), int(causes.iloc[0]), int(causes.sum())
    meaning = exp.system.cause_meanings(exp.thresholds).get(name, "unknown cause")
    share = f"{number:,} of {total:,} failures, {format_percent(number / total)}"
    return f"most frequent failure: {escape_control_characters(name)} ({share}): {meaning}"


def probability_of_failure(rows: pd.DataFrame, exp: Experiment) -> str:
    """State the failure probability of an adaptive study with its 95 % interval, or why it is unknown."""
    try:
        found = rare.estimate_failure_probability(rows, exp)
    except InputError as error:
        return f"P(failure) is not known yet: {error}"
    low, high = found.interval
    if not found.probability:
        return (
            f"P(failure) <= {high:.2g} (95 %)" if np.isfinite(high) else "P(failure) is not known: no failure was found"
        )
    interval = f"95 % interval {low:.2g} to {high:.2g}" if np.isfinite(low) else "no interval from a single run"
    caution = "" if found.is_reliable else ", NOT reliable: `sweep stats` says why"
    return f"P(failure) = {found.probability:.3g} ({interval}){caution}"


def describe_adaptive_rollouts(rows: pd.DataFrame) -> str:
    """State how many rollouts an adaptive search has simulated, and how many of them failed or are invalid."""
    failed, invalid = (int((rows["outcome"] == kind).sum()) for kind in ("failure", "invalid"))
    return f"{len(rows):,} rollouts placed where failures are expected, of which {failed:,} failed, {invalid:,} invalid"

"""Statistics of a study as titled tables: rates, volume, margins, tolerance, sensitivity."""

from collections.abc import Callable, Iterator
from contextlib import suppress
from functools import partial

import pandas as pd

from sweep.analysis import failing, push_map, rare, screening, sensitivity
from sweep.analysis.axis_effects import check_axis_effects
from sweep.analysis.sample import drop_repeated_rollouts, pooled_success_rate
from sweep.analysis.sampling_units import describe_sample_size, draw_ids, interval_method, success_rates_by_condition
from sweep.analysis.sensitivity import MIN_RARER_OUTCOMES
from sweep.analysis.stats import format_percent
from sweep.config.experiment import Experiment
from sweep.core.distinct_values import rank_distinct_values
from sweep.core.errors import InputError
from sweep.report.headline import describe_main_failure, study_headline
from sweep.report.labels import label_with_unit
from sweep.report.tables import markdown_table
from sweep.runs import refine
from sweep.runs.results import Results
from sweep.study.design_kinds.base import SensitivityMethod

PUSH_TITLE = "Push thresholds: the size at which half of the rollouts succeed, by a fit that falls with the size"
Analysis = Callable[[pd.DataFrame, Experiment, str | None], pd.DataFrame]


def statistics_sections(
    rows: pd.DataFrame, exp: Experiment, level: float = 0.9, figure: str | None = None
) -> Iterator[tuple[str, pd.DataFrame | str]]:
    """Yield title and content of all statistics that the design of the study allows."""
    rows, copies = drop_repeated_rollouts(rows, exp)
    listed, drawn = sensitivity.listed_value_axes(rows, exp), sensitivity.randomly_drawn_axes(rows, exp)
    numbers = sensitivity.numeric_axes(rows, listed)
    several = len(rows) > len(rows.drop_duplicates([a.column for a in listed])) if listed else bool(drawn)
    every = pooled_success_rate(rows, exp)
    if exp.study.is_adaptive:  # its rows are no sample of what is asked about
        yield "Probability of failure", study_headline(rows, exp)
        yield "How P(failure) was estimated", str(rare.estimate_failure_probability(rows, exp))
        if len(modes := rare.failure_modes(rows, exp)):
            yield "Failure modes by their share of P(failure)", modes
        yield from _sensitivity_tables(rows, exp)
        return
    yield "Rate of success", f"{study_headline(rows, exp)}{'; ' if copies else ''}{copies}"
    one_at_a_time = bool(numbers) and exp.study.design.is_one_at_a_time
    if one_at_a_time:
        sure = f" ({interval_method(exp.study)}, 95 %)" if exp.study.has_repeats else ""
        yield f"Rate along each axis, the others nominal{sure}", sensitivity.one_at_a_time_rates(rows, exp)
    elif drawn and exp.study.design.gives_rate:
        method = interval_method(exp.study).replace("Wilson", "Clopper-Pearson")
        volume = sensitivity.success_volume(rows, exp)
        if listed or (volume[["success", "valid"]] != [every.successes, every.valid_count]).to_numpy().any():
            yield f"Share of the draws that succeed ({method}, 95 %)", volume
    elif several and listed:
        title = f"Rate at each condition ({interval_method(exp.study)}, 95 %)"
        yield title, success_rates_by_condition(rows, exp, [a.column for a in listed])
    if exp.study.is_refined:
        yield "Refinement", "\n".join(map(str, refine.summarize_panels(exp, rows)))
    if exp.study.resolution and len(effects := refine.total_effects(exp, rows)):
        yield "Importance of parameters in the map's cells (total Sobol index)", effects
    whole = refine.add_inferred_rows(exp, rows) if exp.study.resolution else rows
    if numbers and not several and not one_at_a_time:
        found = sensitivity.grid_success_volume(whole, exp)
        share, low, high = map(format_percent, (found.share, found.low, found.high))
        text = f"{share}; {low} to {high}, counting cells on the boundary as failures or successes"
        if found.invalid:
            text += f"; the range covers both outcomes of {every.invalid_rollouts_text}"
        yield "Share of the grid's volume that succeeds", text
    ineffective = {name: pairs for name, pairs in check_axis_effects(rows, exp).items() if pairs.are_equal}
    if ineffective:
        told = [f"axis {name} changed no metric in {one.rollouts:,} rollouts" for name, one in ineffective.items()]
        yield "Axes without an effect", "\n".join(told)
    effective = [axis.column for axis in numbers if axis.name not in ineffective]
    if effective:
        margins = sensitivity.success_ranges_around_nominal(whole, exp)
        yield "Margins: distance from the nominal value up to which rollouts succeed", _select_axes(margins, effective)
    if pushes := push_map.select_push_rows(rows, exp):
        yield PUSH_TITLE, push_map.threshold_table(pushes[0])
    if effective and several:
        title = (
            f"Tolerance: the error at which the probability of success falls to {format_percent(level)} (logistic fit; "
            "95 % interval from the rates at the values tried)"
        )
        yield title, _select_axes(sensitivity.tolerated_parameter_errors(rows, exp, level), effective)
    if len(drawn) and {"success", "failure"} <= set(rows["outcome"].unique()):
        yield (
            "Regional sensitivity: differences between failing and succeeding draws",
            sensitivity.regional_sensitivity(rows, exp),
        )
        yield from _sensitivity_tables(rows, exp)
    draws, omitted = rank_distinct_values(draw_ids(rows, exp)).max(initial=-1) + 1, []
    for title, function in sensitivity_methods(exp, draws).items() if drawn else ():
        try:
            table = function(rows, exp, figure)
        except InputError as error:
            if figure or not listed:
                yield title, str(error)
            else:
                omitted.append(title)
            continue
        if function is screening.rbd_fast_indices and table["error"].isna().all():
            table = (
                f"not shown, as no error holds: it needs {MIN_RARER_OUTCOMES} draws of either outcome, "
                "and no Sobol sequence"
            )
        yield f"{title} of {figure or 'success'}", table
    if omitted:
        first = rows[listed[0].column].iloc[0]
        condition = f"`{listed[0].column}` == {first!r}" if isinstance(first, str) else f"{listed[0].name} == {first:g}"
        yield (
            "Sensitivity indices of the draws",
            f"{' and '.join(omitted)} describe the draws of one condition. Choose one, as in: "
            f"sweep stats DIR --where '{condition}'",
        )


def _select_axes(table: pd.DataFrame, columns: list[str]) -> pd.DataFrame:
    """Select the lines of a table that belong to some axes."""
    return table[table["axis"].isin(columns)] if len(table) else table


def _sensitivity_tables(rows: pd.DataFrame, exp: Experiment) -> Iterator[tuple[str, pd.DataFrame]]:
    """Yield how each drawn number is related to failure, if there are enough rows."""
    with suppress(InputError):
        yield (
            "Share of each parameter in failure (Shapley values of the Hilbert-Schmidt criterion)",
            failing.shapley_failure_shares(rows, exp),
        )


def sensitivity_methods(exp: Experiment, draws: int) -> dict[str, Analysis]:
    """Return the sensitivity methods that fit a study's design, by title.

    Args:
        exp: experiment of the study.
        draws: number of draws among its rows; replicates and grid points of a draw count once.
    """
    match exp.study.design.sensitivity:
        case SensitivityMethod.SOBOL_INDICES:
            return {"Sobol indices": sensitivity.sobol_indices}
        case SensitivityMethod.ELEMENTARY_EFFECTS:
            return {"Elementary effects (Morris)": sensitivity.elementary_effects}
        case SensitivityMethod.GIVEN_DATA if draws >= screening.MIN_DRAWS:
            return {
                "PAWN indices": screening.pawn_indices,
                "First Sobol indices (RBD-FAST)": screening.rbd_fast_indices,
            }
        case _:
            return {}


def render_statistics(rows: pd.DataFrame, exp: Experiment, level: float = 0.9, figure: str | None = None) -> str:
    """Format the statistics of a study as Markdown: the main result in two lines, then titled tables.

    Args:
        rows: rows of the study.
        exp: its experiment.
        level: probability of success for the tolerance to errors.
        figure: metric for sensitivity indices; success by default.
    """
    (_, answer), *sections = statistics_sections(rows, exp, level, figure)
    if not exp.study.is_adaptive:
        answer = f"{answer}; {describe_sample_size(drop_repeated_rollouts(rows, exp)[0], exp)}"
    parts = [f"{exp.study.name}: {answer}\n{describe_main_failure(rows, exp)}\n"]
    for title, content in sections:
        if isinstance(content, pd.DataFrame):
            content = markdown_table(content, exp)
        parts.append(f"## {title}\n\n{content}\n")
    return "\n".join(parts)


def labelled_sections(results: Results) -> Iterator[tuple[str, pd.DataFrame | str]]:
    """Yield titles and contents of a study's statistics, with labels of parameters; nothing for points from a file."""
    if results.exp.study.points:
        return
    for title, content in list(statistics_sections(results.rows, results.exp))[1:]:  # the first is the headline
        if isinstance(content, pd.DataFrame) and "axis" in content:
            content = content.assign(axis=content["axis"].map(partial(label_with_unit, exp=results.exp)))
        yield title, content

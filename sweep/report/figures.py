"""The figures of a study, for the page and for the paper, each with the numbers that it shows."""

from collections.abc import Iterator
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from sweep.analysis import compare, sensitivity
from sweep.analysis.compare import SECOND_RUN_MARK
from sweep.analysis.sample import is_random_sample
from sweep.analysis.sampling_units import confidence_interval_unit_ids, interval_method, interval_method_by_draw
from sweep.analysis.stats import bin_values, format_percent, success_rate, success_rates
from sweep.core.distinct_values import count_distinct
from sweep.core.plot_style import (
    COLUMN_WIDTH_IN,
    PAGE_WIDTH_IN,
    add_legend_below,
    limit_x_ticks,
    new_figure,
    use_integer_ticks,
)
from sweep.report import draws, sections, time_series_plots
from sweep.report.cells import clip_axes_at_zero
from sweep.report.engine_agreement import engine_figure
from sweep.report.figure import StudyFigure
from sweep.report.labels import axis_title, axis_words
from sweep.report.maps import draw_glyph_at, legend_cell
from sweep.report.outcome_style import FAILURE_COLOUR, INVALID_MARK_COLOUR, SUCCESS_COLOUR, find_style
from sweep.report.push_map import push_map_figure
from sweep.runs import audit
from sweep.runs.results import Results
from sweep.study.columns import metric_columns

EFFECT_VALUES, EFFECT_BINS, HISTOGRAM_BINS, MAX_LINES, MAX_HISTOGRAMS = 50, 20, 30, 5, 12
CLIPPED_RANGE_FACTOR = 0.5  # of the range between the 1st and 99th percentile: values farther beyond it are clipped
MIN_GLYPH_SHARE = 0.02  # of the longest bar, and a part that is no longer has no room for a glyph
MAX_REJECTED_P = 0.01  # p-value below which a fit is not drawn
ROUNDING_TOLERANCE = 1e-12  # of a value: a difference that is no distribution
STYLES = (
    ("#00649E", "-", "o"),
    ("#D55E00", "--", "s"),
    ("#009E73", ":", "^"),
    ("#8E1B5E", "-.", "D"),
    ("0.3", "-", "v"),
)


def list_figures(results: Results) -> Iterator[StudyFigure]:
    """Yield every figure that the study has data for."""
    yield from draws.draws_figure(results)
    yield from push_map_figure(results)
    yield from map_figures(results)
    yield from effects_figure(results)
    yield from causes_figure(results)
    yield from distributions_figure(results)
    yield from time_series_plots.time_series_figure(results)
    yield from audit_figure(results)
    yield from engine_figure(results)


def map_figures(results: Results) -> Iterator[StudyFigure]:
    """Yield maps of success over pairs of parameters."""
    again = summarize_audit(results)
    for number, one in enumerate(sections.list_sections(results), 1):
        table = sections.section_data(results, one)
        title = f"{axis_words(one.y, results.exp)} by {axis_words(one.x, results.exp)}"
        if "total" not in table:
            caption = f"Single rollouts{', ' + one.note if one.note else ''}."
        else:
            method = interval_method_by_draw(results.exp.study)
            sure = f", between the ends of its 95 % interval ({method})" if table["low"].notna().any() else ""
            low, high = table["total"].min(), table["total"].max()
            many = f"{low}" if low == high else f"{low} to {high}"
            caption = f"Rate of success of {many} rollouts a cell{', ' + one.note if one.note else ''}{sure}."
        left_out = describe_invalid_count(one.rows[one.rows["known"]] if one.refined else one.rows, "hatched")
        yield StudyFigure(
            f"map-{number}",
            title,
            caption + left_out + again,
            table,
            lambda one=one: sections.draw_section(results, one),
        )


def describe_invalid_count(rows: pd.DataFrame, where: str) -> str:
    """Describe how many of the rows are invalid; empty if none is."""
    found = success_rate(rows["outcome"])
    if not found.invalid:
        return ""
    return (
        f" {found.invalid} of {found.total} rollouts ({format_percent(found.invalid_share)}) are invalid and {where}."
    )


def summarize_audit(results: Results) -> str:
    """Describe how many audited rollouts ended differently when simulated again."""
    text = ""
    for drawn, table in audit.outcome_flip_table(results).groupby("drawn", sort=False):
        ways = [
            f"{one['flips']} of {one['rollouts'] - one['invalid']} {one['simulated']} "
            f"(at most {format_percent(one['high'])})"
            for one in table.to_dict("records")
        ]
        text += f" When simulated again, outcomes flip {drawn}: {'; '.join(ways)}."
    return text


def effects_figure(results: Results) -> Iterator[StudyFigure]:
    """Yield the figure of success rates along each parameter; nothing for studies in which earlier rows decided later
    points."""
    if results.exp.study.is_sequential:
        return
    by = [c for c in results.categorical_columns if count_distinct(results.rows[c], MAX_LINES) <= MAX_LINES][:1]
    if results.is_one_at_a_time:
        by, table = [], sensitivity.one_at_a_time_rates(results.rows, results.exp)
        caption = (
            "Rate of success at each value of one parameter, the others nominal, with its 95 % interval "
            f"({interval_method(results.exp.study)}); dotted: logistic fit of the error on either side of the nominal "
            f"value, unless the rates reject it (p < {MAX_REJECTED_P:g})."
            if results.exp.study.has_repeats
            else "Whether a rollout succeeds at each value of one parameter, the others nominal."
        )
    else:
        tables, in_bins = [], False
        for axis in results.numeric_columns:
            value = results.rows[axis]
            if count_distinct(value, EFFECT_VALUES) > EFFECT_VALUES:
                value, in_bins = bin_values(value, EFFECT_BINS), True
            units = confidence_interval_unit_ids(results.rows, results.exp)
            found = success_rates(results.rows.assign(value=value), [*by, "value"], unit=units).assign(axis=axis)
            if not is_random_sample(results.rows, results.exp, (axis, *by)):
                found[["low", "high"]] = np.nan
            tables.append(found)
        tables = [table for table in tables if table["total"].max() > 1]
        if not tables:
            return
        table = pd.concat(tables, ignore_index=True)
        sure = table.groupby("axis")["low"].agg(lambda low: low.notna().any())
        method = interval_method_by_draw(results.exp.study)
        interval = f", with its 95 % interval ({method})" + ("" if sure.all() else " where these are drawn")
        where = f"in {EFFECT_BINS} bins of equal width" if in_bins else "at each value"
        if in_bins and len(tables) > 1:
            where += f", or at each value where there are at most {EFFECT_VALUES},"
        caption = f"Rate of success {where} of one parameter, over all others{interval if sure.any() else ''}."
    table = table[["axis", *by, *table.columns.drop(["axis", *by])]]
    caption += describe_invalid_count(results.rows, "left out")
    yield StudyFigure("effects", "Each parameter alone", caption, table, lambda: _draw_effects(results, table, by))


def _draw_effects(results: Results, table: pd.DataFrame, by: list[str]) -> Figure:
    axes = list(dict.fromkeys(table["axis"]))
    columns = 2 if len(axes) <= 6 else 3
    figure, spots = _panels(len(axes), columns)
    title = f"{axis_words(by[0], results.exp)}: " if by else ""
    for axis, ax in zip(axes, spots, strict=True):
        own = table[table["axis"] == axis]
        parts = own.groupby(by[0], sort=False) if by else [("", own)]
        for (name, part), (colour, line, marker) in zip(parts, STYLES, strict=False):
            ax.fill_between(part["value"], part["low"], part["high"], color=colour, alpha=0.2, linewidth=0)
            ax.plot(part["value"], part["share"], line, marker=marker, ms=3, color=colour, label=f"{title}{name}")
        ax.set(xlabel=axis_title(axis, results.exp), ylabel="rate of success")
        clip_axes_at_zero(ax)
        limit_x_ticks(ax, min(len(axes), columns))
        ax.set_ylim(-0.02, 1.02)
    if by:  # below: in a panel it would lie on its lines
        add_legend_below(figure, [line for ax in spots for line in ax.get_lines()])
    if results.is_one_at_a_time and results.exp.study.has_repeats:
        _draw_fits(results, dict(zip(axes, spots, strict=True)))
    return figure


def _draw_fits(results: Results, spots: dict[str, Axes]) -> None:
    for axis, centre, rows in sensitivity.one_at_a_time_rows(
        results.rows[results.rows["outcome"] != "invalid"], results.exp
    ):
        away = rows[axis.column].to_numpy(dtype=float) - centre
        for sign in (-1, 1):
            here = sign * away >= 0
            if (most := np.abs(away[here]).max(initial=0)) > 0:
                success = rows["outcome"].to_numpy()[here] == "success"
                fit = sensitivity.fit_logistic(np.abs(away[here]), success)
                unit = confidence_interval_unit_ids(rows[here], results.exp)
                if sensitivity.goodness_of_fit_p_value(fit, np.abs(away[here]), success, unit) < MAX_REJECTED_P:
                    continue
                size = np.linspace(0, most, 50)
                spots[axis.column].plot(centre + sign * size, fit.probability(size)[0], ":", color="0.3", linewidth=1)


def causes_figure(results: Results) -> Iterator[StudyFigure]:
    """Yield the figure of causes by the stage of the plan in which they occurred."""
    failed = results.rows[results.rows["outcome"] != "success"]
    if failed.empty:
        return
    table = pd.crosstab(failed["stage"], failed["cause"])
    stages = [s for s in results.stages if s in table.index] + [s for s in table.index if s not in results.stages]
    table = table.loc[stages, list(results.occurring_causes)]
    caption = "Rollouts that did not succeed, by the stage of the plan in which the cause occurred."
    yield StudyFigure("causes", "Causes by stage", caption, table.reset_index(), lambda: _draw_causes(table))


def _draw_causes(table: pd.DataFrame) -> Figure:
    figure = new_figure(1.4 + 0.22 * len(table) + 0.06 * table.shape[1])
    ax = figure.subplots()
    left, totals = np.zeros(len(table)), table.to_numpy().sum(axis=1)
    for cause in table:
        number = table[cause].to_numpy()
        ax.barh(table.index, number, left=left, color=find_style(str(cause)).colour, edgecolor="white", linewidth=0.4)
        roomy = number > MIN_GLYPH_SHARE * totals.max()
        draw_glyph_at(ax, str(cause), (left + number / 2)[roomy], np.flatnonzero(roomy))
        left += number
    for y, total in enumerate(left):
        ax.annotate(f"{total:,.0f}", (total, y), xytext=(4, 0), textcoords="offset points", va="center")
    ax.invert_yaxis()
    use_integer_ticks(ax.xaxis)
    ax.set(xlabel="rollouts", ylabel="stage")
    ax.spines[["top", "right"]].set_visible(False)
    add_legend_below(figure, [legend_cell(str(c).replace("_", " "), find_style(str(c)).colour, str(c)) for c in table])
    return figure


def distributions_figure(results: Results) -> Iterator[StudyFigure]:
    """Yield histograms of the metrics that tell failures from successes best."""
    names = sorted(metrics_with_threshold_first(results), key=lambda c: -outcome_ks_distance(results, c))[
        :MAX_HISTOGRAMS
    ]
    if not names:
        return
    tables, clipped = [], []
    for name in names:
        low, high = histogram_range(results.rows[name])
        values = results.rows[name].clip(low, high)
        if low > results.rows[name].min() or high < results.rows[name].max():
            clipped.append(axis_words(name))
        edges = _bin_edges(values[np.isfinite(values)])
        for outcome, part in values.groupby(results.rows["outcome"]):
            number, _ = np.histogram(part[np.isfinite(part)], edges)
            bins = {"from": edges[:-1], "to": edges[1:], "rollouts": number}
            tables.append(pd.DataFrame({"figure": name, "outcome": outcome, **bins}))
    data = pd.concat(tables, ignore_index=True)
    caption = (
        "Distributions of metrics, first those that tell failures from successes best. The dashed line is the "
        "threshold beyond which a rollout fails or is invalid."
    )
    if clipped:
        caption += (
            f" The outermost bars also count the values beyond the 1st or 99th percentile of {', '.join(clipped)}."
        )
    yield StudyFigure("distributions", "Distributions", caption, data, lambda: _draw_distributions(results, data))


def outcome_ks_distance(results: Results, column: str) -> float:
    """Kolmogorov-Smirnov distance between a metric's values of failures and of successes; 0 without either."""
    values, outcome = results.rows[column].to_numpy(dtype=float), results.rows["outcome"].to_numpy()
    failed, succeeded = (np.sort(values[(outcome == one) & np.isfinite(values)]) for one in ("failure", "success"))
    if not len(failed) or not len(succeeded):
        return 0.0
    every = np.concatenate([failed, succeeded])
    shares = (np.searchsorted(part, every, side="right") / len(part) for part in (failed, succeeded))
    return float(np.abs(np.subtract(*shares)).max())


def histogram_range(values: pd.Series) -> tuple[float, float]:
    """Range of a histogram: all finite values, or those between the 1st and 99th percentile if the others would crush
    it."""
    finite = values[np.isfinite(values)].to_numpy(dtype=float)
    low, first, last, high = np.quantile(finite, [0, 0.01, 0.99, 1], method="nearest")
    room = CLIPPED_RANGE_FACTOR * (last - first)
    return float(first if first - low > room else low), float(last if high - last > room else high)


def _bin_edges(values: pd.Series) -> np.ndarray:
    """Edges of a histogram's bins; values that differ by rounding alone are drawn as one value."""
    low, high = values.min(), values.max()
    constant = high - low <= ROUNDING_TOLERANCE * max(abs(low), abs(high))
    return np.histogram_bin_edges(values, HISTOGRAM_BINS, (low - 0.5, low + 0.5) if constant else None)


def audit_figure(results: Results) -> Iterator[StudyFigure]:
    """Yield the figure of audited rollouts whose outcome changes in other variants of the simulation."""
    x_y, found = results.numeric_columns[:2], dict(audit.iter_audited_variants(results))
    if len(x_y) < 2 or not found:
        return
    columns = ["point_id", *x_y, "outcome", f"outcome{SECOND_RUN_MARK}"]
    parts = [
        pairs[columns].assign(simulated=results.exp.system.audit_variants[way].description)
        for way, pairs in found.items()
    ]
    data = pd.concat(parts, ignore_index=True)
    caption = (
        "Rollouts next to the boundary and successes elsewhere, simulated again. Dots have the same outcome, crosses "
        "another one, and grey pluses are invalid in one of the two runs."
    )
    yield StudyFigure("audit", "Audit", caption, data, lambda: _draw_audits(results, data))


def _draw_audits(results: Results, data: pd.DataFrame) -> Figure:
    x, y = results.numeric_columns[:2]
    ways = list(data.groupby("simulated", sort=False))
    figure, spots = _panels(len(ways))
    for (way, part), ax in zip(ways, spots, strict=True):
        changed = compare.outcome_change_mask(part)
        broken = (part[["outcome", f"outcome{SECOND_RUN_MARK}"]] == "invalid").any(axis=1)
        for chosen, mark, colour in (
            (~changed, ".", SUCCESS_COLOUR),
            (changed & broken, "+", INVALID_MARK_COLOUR),
            (changed & ~broken, "x", FAILURE_COLOUR),
        ):
            ax.plot(part.loc[chosen, x], part.loc[chosen, y], mark, color=colour)
        ax.set_title(str(way))
        ax.set(xlabel=axis_title(x, results.exp), ylabel=axis_title(y, results.exp))
        ax.set(xlim=_span(results.rows[x]), ylim=_span(results.rows[y]))
    return figure


def _span(values: pd.Series) -> tuple[float, float]:
    low, high = float(values.min()), float(values.max())
    start = low - 0.05 * (high - low)
    return max(start, 0.0) if low >= 0 else start, high + 0.05 * (high - low)


def metric_thresholds(results: Results) -> dict[str, float]:
    """Return the thresholds by metric, for metrics that have one."""
    given = results.exp.system.thresholds(results.exp.thresholds)
    return {name: value for name, value in given.items() if name in results.rows}


def metrics_with_threshold_first(results: Results) -> list[str]:
    """Return the names of the metrics that differ between rollouts, those with a threshold of success first."""
    judged, silent = metric_thresholds(results), results.exp.system.bookkeeping_metrics
    names = [c for c in metric_columns(results.rows) if c not in silent and results.rows[c].dtype.kind == "f"]
    names = [c for c in names if results.rows[c].max() > results.rows[c].min()]
    return sorted(names, key=lambda c: c not in judged)


def _draw_distributions(results: Results, data: pd.DataFrame) -> Figure:
    names = list(dict.fromkeys(data["figure"]))
    figure, spots = _panels(len(names), columns=3, height=1.6)
    judged = metric_thresholds(results)
    looks: dict[str, Any] = {
        "success": {"color": SUCCESS_COLOUR},
        "failure": {"color": FAILURE_COLOUR},
        "invalid": {"color": "white", "hatch": "///", "edgecolor": "black"},
    }
    for name, ax in zip(names, spots, strict=True):
        own = data[data["figure"] == name]
        low, high = own["from"].min(), own["to"].max()
        bottom = np.zeros(HISTOGRAM_BINS)
        for outcome, part in sorted(own.groupby("outcome"), key=lambda one: list(looks).index(str(one[0]))):
            look = {"align": "edge", "linewidth": 0.4, "label": outcome, **looks[str(outcome)]}
            ax.bar(part["from"], part["rollouts"], part["to"] - part["from"], bottom, **look)
            bottom += part["rollouts"].to_numpy()
        limit = judged.get(name)
        if limit is not None and low - (high - low) < limit < high + (high - low):  # else it would flatten the rest
            ax.axvline(limit, color="black", linestyle="--", linewidth=1)
        ax.set_xlabel(axis_title(name))
        limit_x_ticks(ax, min(len(names), 3))
        use_integer_ticks(ax.yaxis)
        ax.spines[["top", "right"]].set_visible(False)
    add_legend_below(figure, [one for ax in spots for one in ax.get_legend_handles_labels()[0]])
    return figure


def _panels(number: int, columns: int = 2, height: float = 2.2) -> tuple[Figure, list[Axes]]:
    """A figure as wide as a page with `number` panels."""
    columns = min(columns, number)
    lines = -(-number // columns)
    figure = new_figure(height * lines + 0.4, PAGE_WIDTH_IN if columns > 1 else COLUMN_WIDTH_IN)
    axes = figure.subplots(lines, columns, squeeze=False).ravel().tolist()
    for ax in axes[number:]:
        ax.set_visible(False)
    return figure, axes[:number]

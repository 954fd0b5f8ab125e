"""Plots of stored time series: single rollouts as thin lines, with their median and quantiles."""

from collections.abc import Iterator

import matplotlib as mpl
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure

from sweep.core.plot_style import add_legend_below, new_figure
from sweep.core.spacing import evenly_spaced_indices
from sweep.report.figure import StudyFigure
from sweep.report.labels import axis_title
from sweep.report.outcome_style import FAILURE_COLOUR, INVALID_MARK_COLOUR, SUCCESS_COLOUR
from sweep.runs import store, time_series
from sweep.runs.results import Results
from sweep.study.study import rollout_id_columns

MAX_LINES_PER_OUTCOME, MAX_PANELS = 100, 8  # that are drawn at most: of each outcome, and columns
LOW_QUANTILE, HIGH_QUANTILE = 0.1, 0.9  # quantiles that the band lies between
COLOURS = {"success": SUCCESS_COLOUR, "failure": FAILURE_COLOUR, "invalid": INVALID_MARK_COLOUR}


def load_time_series(results: Results) -> pd.DataFrame:
    """Read the stored time series of the rows, with the outcome of each rollout."""
    kept = time_series.read_histories(results.folder)
    keys = rollout_id_columns(kept.columns)
    return kept.merge(results.rows[[*keys, "outcome"]], on=keys)


def time_series_figure(results: Results) -> Iterator[StudyFigure]:
    """Yield a figure of the stored time series: single rollouts, and their median and quantiles over time.

    It shows the columns that `study.keep` names; nothing is yielded if the study stored none. At each time, the
    quantiles are over the rollouts that have not ended yet.
    """
    if not results.exp.study.keep or not store.list_recordings(results.folder, store.HISTORIES_FOLDER):
        return
    kept = load_time_series(results)
    long = kept.melt(["outcome", "time_s"], list(results.exp.study.keep), "column")
    found = long.groupby(["column", "outcome", "time_s"], sort=False)["value"]
    parts = {"low": found.quantile(LOW_QUANTILE), "median": found.median(), "high": found.quantile(HIGH_QUANTILE)}
    table = pd.DataFrame({**parts, "rollouts": found.count()}).reset_index()
    rollouts = len(kept[rollout_id_columns(kept.columns)].drop_duplicates())
    caption = (
        f"Over time: {rollouts} of {len(results.rows)} rollouts, a thin line each (at most {MAX_LINES_PER_OUTCOME} "
        "of an outcome), "
        f"their median, and the band that holds {HIGH_QUANTILE - LOW_QUANTILE:.0%} of those still under way."
    )
    yield StudyFigure("histories", "Over time", caption, table, lambda: draw_time_series(results, kept, table))


def draw_time_series(results: Results, samples: pd.DataFrame, quantiles: pd.DataFrame) -> Figure:
    """Draw a panel for each column: single rollouts, and the quantiles of each outcome."""
    columns = results.exp.study.keep[:MAX_PANELS]
    figure = new_figure(0.8 + 1.4 * len(columns))
    spots = figure.subplots(len(columns), 1, sharex=True, squeeze=False)[:, 0]
    for name, ax in zip(columns, spots, strict=True):
        for outcome, colour in COLOURS.items():
            _lines(ax, samples[samples["outcome"] == outcome], name, colour)
            of = quantiles[(quantiles["outcome"] == outcome) & (quantiles["column"] == name)].sort_values("time_s")
            ax.fill_between(of["time_s"], of["low"], of["high"], color=colour, alpha=0.2, linewidth=0)
            if len(of):
                ax.plot(of["time_s"], of["median"], color=colour, linewidth=1.5, label=outcome)
        ax.set_ylabel(axis_title(name))
        ax.autoscale_view()
    add_legend_below(figure, spots[0].get_legend_handles_labels()[0])
    spots[-1].set_xlabel(axis_title("time_s"))
    return figure


def _lines(ax: Axes, samples: pd.DataFrame, name: str, colour: str) -> None:
    """Draw evenly chosen rollouts as one image inside the figure."""
    groups = [part for _, part in samples.groupby(rollout_id_columns(samples.columns), sort=False)]
    lines = [groups[k][["time_s", name]].to_numpy() for k in evenly_spaced_indices(len(groups), MAX_LINES_PER_OUTCOME)]
    look = mpl.rcParams["lines.linewidth"] / 3
    ax.add_collection(LineCollection(lines, colors=colour, linewidths=look, alpha=0.4, rasterized=True))

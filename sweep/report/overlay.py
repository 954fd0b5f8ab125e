"""Time histories over each other: what `study.keep` kept, a line for each rollout, with median and quantiles."""

from collections.abc import Iterator

import matplotlib as mpl
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure

from sweep.core.plot_style import legend_below, new_figure
from sweep.core.spacing import evenly_spaced_indices
from sweep.report.exhibit import Exhibit
from sweep.report.labels import beside_axis
from sweep.report.looks import DOUBTFUL, FAILURE, GOOD
from sweep.runs import store, time_series
from sweep.runs.results import Results
from sweep.study.study import identity_columns

LINES, PANELS = 100, 8  # that are drawn at most: of each outcome, and columns
LOW, HIGH = 0.1, 0.9  # quantiles that the band lies between
COLOURS = {"success": GOOD, "failure": FAILURE, "invalid": DOUBTFUL}


def samples(results: Results) -> pd.DataFrame:
    """The histories of the rows at hand, with their `outcome`."""
    kept = time_series.read(results.folder)
    keys = identity_columns(kept.columns)
    return kept.merge(results.rows[[*keys, "outcome"]], on=keys)


def exhibits(results: Results) -> Iterator[Exhibit]:
    """What was kept over time: quantiles of every column at every moment, among an outcome's rollouts under way."""
    if not results.exp.study.keep or not store.list_recordings(results.folder, store.HISTORIES):
        return
    kept = samples(results)
    long = kept.melt(["outcome", "time_s"], list(results.exp.study.keep), "column")
    found = long.groupby(["column", "outcome", "time_s"], sort=False)["value"]
    parts = {"low": found.quantile(LOW), "median": found.median(), "high": found.quantile(HIGH)}
    table = pd.DataFrame({**parts, "rollouts": found.count()}).reset_index()
    rollouts = len(kept[identity_columns(kept.columns)].drop_duplicates())
    caption = (
        f"Over time: {rollouts} of {len(results.rows)} rollouts, a thin line each (at most {LINES} of an outcome), "
        f"their median, and the band that holds {HIGH - LOW:.0%} of those still under way."
    )
    yield Exhibit("histories", "Over time", caption, table, lambda: draw(results, kept, table))


def draw(results: Results, kept: pd.DataFrame, quantiles: pd.DataFrame) -> Figure:
    """A panel for each column: the `samples`, and their quantiles."""
    columns = results.exp.study.keep[:PANELS]
    figure = new_figure(0.8 + 1.4 * len(columns))
    spots = figure.subplots(len(columns), 1, sharex=True, squeeze=False)[:, 0]
    for name, ax in zip(columns, spots, strict=True):
        for outcome, colour in COLOURS.items():
            _lines(ax, kept[kept["outcome"] == outcome], name, colour)
            of = quantiles[(quantiles["outcome"] == outcome) & (quantiles["column"] == name)].sort_values("time_s")
            ax.fill_between(of["time_s"], of["low"], of["high"], color=colour, alpha=0.2, linewidth=0)
            if len(of):
                ax.plot(of["time_s"], of["median"], color=colour, linewidth=1.5, label=outcome)
        ax.set_ylabel(beside_axis(name))
        ax.autoscale_view()
    legend_below(figure, spots[0].get_legend_handles_labels()[0])
    spots[-1].set_xlabel(beside_axis("time_s"))
    return figure


def _lines(ax: Axes, kept: pd.DataFrame, name: str, colour: str) -> None:
    """Evenly chosen rollouts, as one picture inside the figure."""
    groups = [part for _, part in kept.groupby(identity_columns(kept.columns), sort=False)]
    lines = [groups[k][["time_s", name]].to_numpy() for k in evenly_spaced_indices(len(groups), LINES)]
    look = mpl.rcParams["lines.linewidth"] / 3
    ax.add_collection(LineCollection(lines, colors=colour, linewidths=look, alpha=0.4, rasterized=True))

"""Map of the rows on which all engines give the same outcome, and of those on which they do not."""

from collections.abc import Iterator

import numpy as np
import pandas as pd
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure

from sweep.analysis.stats import bin_values, format_percent
from sweep.core.distinct_values import count_distinct
from sweep.core.outcomes import FAILURE
from sweep.core.plot_style import COLUMN_WIDTH_IN, new_figure
from sweep.report.cells import axis_positions, is_evenly_spaced, label_axis_values, lay_out_cells
from sweep.report.figure import StudyFigure
from sweep.report.labels import axis_title
from sweep.report.maps import draw_cell_values
from sweep.report.outcome_style import FAILURE_COLOUR
from sweep.runs import engine_audit
from sweep.runs.results import Results

FEWEST_BINS, MOST_BINS, ROWS_PER_BIN = 4, 40, 10  # bins along an axis, and the rows that a bin of both should have


def engine_figure(results: Results) -> Iterator[StudyFigure]:
    """Yield the map of the rows of an audit on several engines; nothing if the study was not audited so."""
    x_y, found = results.numeric_columns[:2], engine_audit.read_engine_outcomes(results)
    if len(x_y) < 2 or found.empty:
        return
    engines, rate = engine_audit.outcome_columns(found), engine_audit.agreement_rate(results)
    names = " and ".join(column.removeprefix(engine_audit.OUTCOME_ON) for column in engines)
    ends = f"{format_percent(rate.low)} to {format_percent(rate.high)}"
    sure = f", 95 % interval {ends}" if rate.has_interval else ""
    caption = (
        f"The engines {names} give the same valid outcome in {rate.successes:,} of {rate.total:,} rollouts "
        f"({format_percent(rate.share)}{sure}). Colour: this share in each cell. Crosses: rollouts on which they do "
        "not agree. Dots: failures on all engines."
    )
    data = found[["point_id", *results.axes, *engines, engine_audit.AGREE]]
    yield StudyFigure("engines", "Agreement of engines", caption, data, lambda: _draw_engines(results, data))


def _draw_engines(results: Results, data: pd.DataFrame) -> Figure:
    x, y = results.numeric_columns[:2]
    bins = int(np.clip(np.sqrt(len(data) / ROWS_PER_BIN), FEWEST_BINS, MOST_BINS))
    values = {
        c: data[c] if count_distinct(data[c], MOST_BINS) <= MOST_BINS else bin_values(data[c], bins) for c in (x, y)
    }
    agree = (data[engine_audit.AGREE] == engine_audit.YES).to_numpy()
    cells, layout = lay_out_cells(data.assign(**values, value=agree.astype(float), outcome=""), x, y)
    figure = new_figure(2.6, COLUMN_WIDTH_IN)
    ax = figure.subplots()
    draw_cell_values(ax, cells, layout, cmap="cividis", vmin=0, vmax=1)
    label_axis_values(ax, layout)
    across, up = (
        data[name] if is_evenly_spaced(places) else axis_positions(cells[axis].to_numpy(), places)
        for name, axis, places in ((x, "x", layout.x), (y, "y", layout.y))
    )
    failed = agree & (data[engine_audit.outcome_columns(data)[0]] == FAILURE).to_numpy()
    for chosen, mark, colour in ((failed, ".", "0.3"), (~agree, "x", FAILURE_COLOUR)):
        ax.plot(across[chosen], up[chosen], mark, color=colour, markersize=3)
    ax.set(xlabel=axis_title(x, results.exp), ylabel=axis_title(y, results.exp))
    figure.colorbar(ScalarMappable(Normalize(0, 1), "cividis"), ax=ax, label="share on which engines agree", shrink=0.8)
    return figure

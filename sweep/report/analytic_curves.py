"""Analytic limits of a study (`study.theory`) as curves over its maps."""

import pandas as pd
from matplotlib.axes import Axes

from sweep.config.experiment import Experiment
from sweep.contract.system import split_side_prefix
from sweep.report.cells import MapCells, axis_positions
from sweep.study.analytic_limits import AnalyticParameterLimit

LINE_STYLES = ("--", "-.", ":")


def limit_curve(theory: AnalyticParameterLimit, exp: Experiment, rows: pd.DataFrame, along: str) -> pd.DataFrame:
    """Return a table of the limit that a formula predicts at each value of the column `along`; NaN where there is none.

    A parameter that the theory names has the value of the rows there where they agree on one, else the nominal value.
    """
    found = []
    for value, group in rows.groupby(along):
        agreed = group.loc[:, group.nunique() == 1].iloc[0]
        here = {split_side_prefix(str(name))[1]: one for name, one in agreed.items()}

        def value_of(path: str, rows: dict = here) -> float:
            return rows[path] if path in rows else exp.system.nominal_parameter_value(path, exp.settings)

        found.append((value, theory.compute(value_of)))
    return pd.DataFrame(found, columns=["along", "limit"])


def draw_limit_curves(ax: Axes, exp: Experiment, rows: pd.DataFrame, x: str, y: str, cells: MapCells) -> None:
    """Draw the analytic limits of both parameters of a map as labelled curves."""
    for theory, style in zip(exp.study.theory, LINE_STYLES, strict=False):
        for across, along in ((x, y), (y, x)):
            if split_side_prefix(across)[1] != theory.of or rows[along].dtype.kind not in "fi":
                continue
            found = limit_curve(theory, exp, rows, along)
            pairs = (found["limit"], found["along"]) if across == x else (found["along"], found["limit"])
            at = [axis_positions(part.to_numpy(), values) for part, values in zip(pairs, cells[:2], strict=True)]
            box = ax.axis()
            ax.plot(*at, style, color="black", linewidth=1.8, label=theory.label)
            ax.axis(box)  # the map's, however far the limit goes


def analytic_limit_metrics(exp: Experiment, rows: pd.DataFrame) -> list[str]:
    """Return the metrics that measure the quantities of the analytic limits, to be mapped beside the outcomes."""
    return list(dict.fromkeys(theory.measured for theory in exp.study.theory if theory.measured in rows))

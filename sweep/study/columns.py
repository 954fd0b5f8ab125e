"""The columns of a row: axes (dotted names), its place in the plan, its figures, how they are judged, and timing."""

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import pandas as pd

PLAN = ("replicate", "stream", "point_id", "group", "batch", "slot", "width", "run_id")
LABELS = ("outcome", "cause", "stage", "t_cause_s", "limit", "margin", "margin_of")
TIMING = ("wall_s",)  # differs between runs


def figure_columns(rows: "pd.DataFrame") -> list[str]:
    """What was measured: all but the axes, the plan, the labels and the timing."""
    return [c for c in rows.columns if "." not in c and c not in (*PLAN, *LABELS, *TIMING)]

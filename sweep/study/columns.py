"""Names of a row's columns: parameters, position in the study, metrics, outcome labels, and timing."""

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import pandas as pd

PLACEMENT_COLUMNS = ("replicate", "stream", "point_id", "group", "batch", "slot", "width", "run_id")
LABEL_COLUMNS = ("outcome", "cause", "stage", "t_cause_s", "limit", "margin", "margin_of")
ID_COLUMNS = ("point_id", "run_id")  # columns of words that files are named by
WORD_COLUMNS = (
    "outcome",
    "cause",
    "stage",
    "limit",
    "margin_of",
    "engines_agree",
)  # further columns of words; axes may have words or numbers
VERDICT_COLUMNS = ("engines_agree",)  # of later commands on stored rows; not all folders and rows have them
TIMING_COLUMNS = ("wall_s",)  # differs between runs
SPREADSHEET_FORMULA_SIGNS = "=+-@"  # signs at the start of a word that a spreadsheet computes when it opens a CSV file
COLUMN_MEANINGS = {  # of labels and of what places a row in its study
    "outcome": "success, failure, or invalid where the simulation cannot vouch for the rollout",
    "cause": "what ended a rollout that did not succeed; empty for a success",
    "stage": "stage of the plan in which the cause occurred",
    "t_cause_s": "when the cause occurred; empty where it is known at the end only",
    "limit": "threshold that was crossed, a key of `outcome`",
    "margin": "distance to the nearest threshold of a failure, in units of that threshold; negative beyond it",
    "margin_of": "threshold that `margin` is the distance to",
    "replicate": "number of the draw or repetition at a point",
    "stream": "number that the noise of the rollout is drawn from",
    "point_id": "hash of all physical inputs of the rollout",
    "group": "rows that share a compiled program",
    "batch": "number of the batch that simulated the row",
    "slot": "place of the row in its batch",
    "width": "number of rollouts in that batch",
    "run_id": "hash of how the row was simulated: rows are equal bit for bit only at an equal one",
    "engines_agree": "yes or no, after `sweep audit --engines`: whether all engines give the same valid outcome",
    "wall_s": "wall time of the row's batch, divided by its rollouts",
}


def metric_columns(rows: "pd.DataFrame") -> list[str]:
    """Return the names of the metric columns of a table: all but parameters, identifiers, outcome labels and timing."""
    others = (*PLACEMENT_COLUMNS, *LABEL_COLUMNS, *VERDICT_COLUMNS, *TIMING_COLUMNS)
    return [c for c in rows.columns if "." not in c and c not in others]

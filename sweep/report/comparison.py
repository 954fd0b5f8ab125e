"""Text of `sweep compare`: how the outcomes of paired rollouts differ."""

from pathlib import Path

import numpy as np
import pandas as pd

from sweep.analysis import compare, first_differences
from sweep.analysis.stats import format_percent
from sweep.core.errors import InputError, format_name_suggestion
from sweep.core.expressions import find_column
from sweep.report.labels import axis_words
from sweep.report.tables import markdown_table
from sweep.runs import results, store, time_series
from sweep.study.study import rollout_id_columns

MAX_LISTED = 12  # pairs and figures of a list; `--output` has them all


def comparison_text(
    pairs: pd.DataFrame, a: int, b: int, regions: list[str] | None = None, unit: np.ndarray | None = None
) -> str:
    """Describe how outcomes differ between two runs, by region of the parameters and by cause, and changes of metrics.

    Args:
        pairs: paired rows, see `compare.pair`.
        a: rows of the first run, before pairing.
        b: rows of the second run, before pairing.
        regions: parameters that divide the pairs into regions; by default the first two that are numbers.
        unit: independent unit of each pair (n,); None where pairs are no sample, so that no p-value is given.

    Raises:
        InputError: a region is not a parameter.
    """
    parts = [
        f"{len(pairs)} pairs{describe_pair_columns(pairs)}; "
        f"unpaired: {a - len(pairs)} rows of A, {b - len(pairs)} of B",
        str(compare.count_flips(pairs, unit)),
        f"{compare.bit_equal_mask(pairs).sum()} of {len(pairs)} pairs have equal metrics to the last bit",
    ]
    axes = [find_parameter_column(pairs, name) for name in regions] if regions else default_region_parameters(pairs)
    if compare.outcome_change_mask(pairs).any():
        if axes:
            parts += [
                "",
                f"By region ({', '.join(map(axis_words, axes))}):",
                markdown_table(compare.flips_by_region(pairs, axes, unit)),
            ]
        parts += ["", "What became what:", markdown_table(compare.count_cause_transitions(pairs))]
        parts += ["", "Pairs that differ:", markdown_table(compare.changed_pairs(pairs).head(MAX_LISTED))]
    drift = compare.relative_metric_changes(pairs)
    drift = drift[drift > 0].head(MAX_LISTED)
    if len(drift):
        figures = pd.DataFrame({"figure": drift.index, "typical change": [format_percent(v) for v in drift]})
        parts += ["", "Metrics that changed most:", markdown_table(figures)]
    return "\n".join(parts)


def first_difference_text(a: Path, b: Path, share: float) -> str:
    """Describe where the time series stored in two folders first differ; empty unless both have some of the same
    columns.

    Args:
        a: Reference folder.
        b: The other folder.
        share: Largest difference that counts as equal, over the range of a column.
    """
    if not all(one.is_dir() and store.list_recordings(one, store.HISTORIES_FOLDER) for one in (a, b)):
        return ""
    here, there = (time_series.read_histories(one) for one in (a, b))
    known = {*rollout_id_columns(here.columns), first_differences.TIME}
    columns = [name for name in here.columns if name in there.columns and name not in known]
    if not columns:
        return ""
    found = first_differences.find_time_series_differences(here, there, columns, share)
    if not len(found):
        return ""
    differ = found[np.isfinite(found["time_s"])].sort_values("time_s", kind="stable")
    much = f"more than {share:g} of a column's range"
    if not len(differ):
        return f"Over time: no sample of {len(found)} rollouts differs by {much} ({len(columns)} columns)"
    first = differ.iloc[0]
    tick = round(first["time_s"] / results.load_experiment(a).settings.control_period)
    return (
        f"Over time: {len(differ)} of {len(found)} rollouts differ by {much}, first in tick {tick} "
        f"({first['time_s']:g} s) in {first['column']}: {first['a']:.6g} in A, {first['b']:.6g} in B "
        f"(point {first['point_id']})"
    )


def describe_pair_columns(pairs: pd.DataFrame) -> str:
    """Describe the columns by which rows were paired, if they were chosen automatically; else empty."""
    return f" of equal {', '.join(pairs.attrs['by'])}" if pairs.attrs["by"] else ""


def find_parameter_column(pairs: pd.DataFrame, name: str) -> str:
    """Return the parameter column that a user names. Raises `InputError` for other columns."""
    found = find_column(pairs, name)
    if found not in (allowed := compare.varied_axes(pairs)):
        raise InputError(f"{name} is not a parameter{format_name_suggestion(name, allowed)}")
    return found


def default_region_parameters(pairs: pd.DataFrame) -> list[str]:
    """Return the first two varied numeric parameters, by which pairs are divided into regions."""
    return [c for c in compare.varied_axes(pairs) if pairs[c].dtype.kind in "fi" and pairs[c].nunique() > 1][:2]


def list_tolerance_violations(pairs: pd.DataFrame, a: int, tolerance: float, figures: float | None) -> list[str]:
    """List the differences that exceed the user's tolerance, one line each.

    Args:
        pairs: paired rows, see `compare.pair`.
        a: rows of the first run, each of which needs a pair.
        tolerance: largest tolerated share of pairs whose outcomes differ.
        figures: largest typical relative change of a metric; None: any.
    """
    found, lines = compare.count_flips(pairs), []
    if found.changed_share > tolerance:
        lines.append(
            f"outcomes of {format_percent(found.changed_share)} of the pairs differ, "
            f"{format_percent(tolerance)} tolerated"
        )
    if a > len(pairs):
        lines.append(f"{a - len(pairs)} of {a} rows of A have no pair in B")
    if figures is not None and len(drift := compare.relative_metric_changes(pairs)) and drift.iloc[0] > figures:
        lines.append(
            f"{drift.index[0]} typically changes by {format_percent(drift.iloc[0])}, "
            f"{format_percent(figures)} tolerated"
        )
    return lines

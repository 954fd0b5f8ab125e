"""What `sweep compare` says about pairs of rollouts."""

import pandas as pd

from sweep.analysis import compare
from sweep.analysis.stats import percent
from sweep.core.errors import InputError, suggest
from sweep.core.expressions import column
from sweep.report.labels import axis_words
from sweep.report.tables import page_table

SHOWN = 12  # pairs and figures of a list; `--output` has them all


def text(pairs: pd.DataFrame, a: int, b: int, regions: list[str] | None = None) -> str:
    """Flips, by region and by cause, and what else changed; `a` and `b` are the numbers of rows before pairing."""
    parts = [
        f"{len(pairs)} pairs{paired_by(pairs)}; {a - len(pairs)} rows of A and {b - len(pairs)} of B have none",
        str(compare.flips(pairs)),
    ]
    axes = [parameter(pairs, name) for name in regions] if regions else default_regions(pairs)
    if compare.changed(pairs).any():
        if axes:
            parts += ["", f"By region ({', '.join(map(axis_words, axes))}):", page_table(compare.regions(pairs, axes))]
        parts += ["", "What became what:", page_table(compare.causes(pairs))]
        parts += ["", "Pairs that differ:", page_table(compare.differences(pairs).head(SHOWN))]
    drift = compare.drift(pairs)
    drift = drift[drift > 0].head(SHOWN)
    if len(drift):
        figures = pd.DataFrame({"figure": drift.index, "typical change": [percent(v) for v in drift]})
        parts += ["", "Figures that changed most:", page_table(figures)]
    return "\n".join(parts)


def paired_by(pairs: pd.DataFrame) -> str:
    """In which columns they agree, if nobody said so and they do not have their points in common."""
    return f" of equal {', '.join(pairs.attrs['by'])}" if pairs.attrs["by"] else ""


def parameter(pairs: pd.DataFrame, name: str) -> str:
    """The parameter that `name` means. Raises `InputError` where it is another column."""
    found = column(pairs, name)
    if found not in (allowed := compare.axes(pairs)):
        raise InputError(f"{name} is not a parameter{suggest(name, allowed)}")
    return found


def default_regions(pairs: pd.DataFrame) -> list[str]:
    """The first two varied parameters that are numbers."""
    return [c for c in compare.axes(pairs) if pairs[c].dtype.kind in "fi" and pairs[c].nunique() > 1][:2]


def broken(pairs: pd.DataFrame, a: int, tolerance: float, figures: float | None) -> list[str]:
    """A line for each way in which the runs differ by more than is tolerated."""
    found, lines = compare.flips(pairs), []
    if found.changed > tolerance:
        lines.append(f"outcomes of {percent(found.changed)} of the pairs differ, {percent(tolerance)} tolerated")
    if a > len(pairs):
        lines.append(f"{a - len(pairs)} of {a} rows of A have no pair in B")
    if figures is not None and len(drift := compare.drift(pairs)) and drift.iloc[0] > figures:
        lines.append(f"{drift.index[0]} typically changes by {percent(drift.iloc[0])}, {percent(figures)} tolerated")
    return lines

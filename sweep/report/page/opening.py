"""What the page of a study opens with besides a map: the failure modes of a search, or a certified region."""

from dataclasses import dataclass
from itertools import combinations
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from sweep.analysis import rare
from sweep.analysis.certify import CertifiedRegion, NestedBoxes
from sweep.analysis.stats import format_percent
from sweep.core.errors import InputError
from sweep.runs.certificates import read_certificate
from sweep.runs.results import Results

MAX_OUTLINED = 4  # parameters over whose pairs a region is outlined
OUTLINE_POINTS = 80  # points along each side of the grid that a curved outline is computed on
OUTLINE_DIGITS = 5  # significant digits of an outline's points


@dataclass(frozen=True)
class DerivedColumn:
    """A column of the page that is not in the table: it names for each row the group to which it belongs, if any."""

    name: str
    names: list[str]  # of the groups
    codes: np.ndarray  # index (n,) of each row's group in `names`, -1 for none


def describe_estimate(results: Results) -> tuple[dict[str, Any], DerivedColumn] | None:
    """Describe the failure probability that an adaptive study estimates, and its failure modes.

    Args:
        results: study with its rows.

    Returns:
        Plain values, see `Estimate` in `data.js`; and the mode of each row. None for other studies, and for a search
        that is not finished.
    """
    rows, exp = results.rows, results.exp
    if not exp.study.is_adaptive:
        return None
    try:
        found = rare.estimate_failure_probability(rows, exp)
    except InputError:
        return None
    codes, modes, names = np.full(len(rows), -1), [], []
    for number, mode in enumerate(rare.list_failure_modes(rows, exp)):
        codes[mode.rows] = number
        share = float(mode.shares.sum())
        names.append(f"{number + 1}: {next(iter(mode.causes), 'failure').replace('_', ' ')}")
        causes = [{"kind": name, "share": weight / share} for name, weight in mode.causes.items()]
        modes.append(
            {"label": names[-1], "share": share, "rows": len(mode.rows), "place": mode.place, "causes": causes}
        )
    low, high = found.interval
    values = {"probability": found.probability, "low": low, "high": high}
    return {**values, "reliable": found.is_reliable, "modes": modes}, DerivedColumn("failure mode", names, codes)


def describe_region(results: Results) -> tuple[dict[str, Any], DerivedColumn] | None:
    """Describe the region of few failures that is certified for a study.

    Args:
        results: study with its rows.

    Returns:
        Plain values, see `Region` in `data.js`; and for each row whether it lies inside. None without a certificate
        for the study's parameters.
    """
    stored = read_certificate(results.folder, results.exp)
    if stored is None:
        return None
    try:
        region = CertifiedRegion.from_values(stored["region"])
        failures, confidence, share = (
            float(stored[name]) for name in ("failures_at_most", "confidence", "share_of_draws")
        )
        failed, fresh, shape = int(stored["failed"]), int(stored["rows"]), str(stored["shape"])
    except (KeyError, TypeError, ValueError):
        return None
    if not region.names or not set(region.names) <= set(results.numeric_columns):
        return None
    x = results.rows[region.names].to_numpy(dtype=float)
    inside = region.contains(x)
    text = (
        f"With {100 * confidence:.4g} % confidence, at most {100 * failures:.4g} % of the draws inside this {shape} "
        f"fail. It holds {format_percent(share)} of all draws; of {fresh:,} fresh draws in it, {failed:,} failed."
    )
    order = rank_parameters_by_effect(x, inside)[:MAX_OUTLINED]
    outlines = [
        {"x": region.names[i], "y": region.names[j], "lines": outline_region(region, x, inside, i, j)}
        for i, j in combinations(order, 2)
    ]
    is_section = not isinstance(region.score, NestedBoxes) and len(region.names) > 2
    about = {"text": text, "start": [region.names[k] for k in order[:2]], "outlines": outlines, "section": is_section}
    column = DerivedColumn("certified region", ["inside", "outside"], np.where(inside, 0, 1))
    return about, column


def rank_parameters_by_effect(x: np.ndarray, inside: np.ndarray) -> list[int]:
    """Rank parameters by how much their values differ between the inside and the outside of a region, largest first.

    Args:
        x: values (n, d) of the parameters.
        inside: whether each row (n,) lies in the region.
    """
    from scipy.stats import ks_2samp  # slow to import

    if inside.all() or not inside.any():
        return list(range(x.shape[1]))
    tests: list[Any] = [ks_2samp(column[inside], column[~inside]) for column in x.T]
    return sorted(range(len(tests)), key=lambda k: -tests[k].statistic)


def outline_region(region: CertifiedRegion, x: np.ndarray, inside: np.ndarray, i: int, j: int) -> list[list[float]]:
    """Outline a region over two of its parameters.

    Args:
        region: the region.
        x: values (n, d) of the parameters of all rows.
        inside: whether each row (n,) lies in the region.
        i: number of the parameter along the horizontal axis.
        j: number of the parameter along the vertical axis.

    Returns:
        Lines, each with x and y of its points in turn: the sides of a box; else the section through the region at the
        mean of the other parameters inside it.
    """
    if isinstance(region.score, NestedBoxes):
        (left, low), (right, high) = region.score.low[0, [i, j]], region.score.high[0, [i, j]]
        return [_rounded_points([left, low, right, low, right, high, left, high, left, low])]
    across, up = (np.linspace(x[:, k].min(), x[:, k].max(), OUTLINE_POINTS) for k in (i, j))
    grid = np.tile(x[inside].mean(axis=0) if inside.any() else x.mean(axis=0), (OUTLINE_POINTS**2, 1))
    grid[:, i], grid[:, j] = np.tile(across, OUTLINE_POINTS), np.repeat(up, OUTLINE_POINTS)
    score = region.score(grid).reshape(OUTLINE_POINTS, OUTLINE_POINTS)
    if not score.min() < region.threshold < score.max():
        return []
    contour = Figure().add_subplot().contour(across, up, score, levels=[region.threshold])
    return [_rounded_points(line.ravel()) for line in contour.allsegs[0]]


def _rounded_points(values: Any) -> list[float]:
    return [float(f"{value:.{OUTLINE_DIGITS}g}") for value in values]

"""Adaptive refinement of a map: simulate only where rollouts add information, in rounds of whole batches.

With `study.resolution`, cells of the grid whose corners differ in outcome are halved along every axis until they are
small enough. With `study.budget` and noise or draws, points whose confidence interval contains `study.level` get more
rollouts until it does not. That stopping rule looks at the data, so the interval is the anytime-valid one. The next
round depends on the stored rows only, so an interrupted refinement resumes where it stopped.
"""

import itertools
import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pandas as pd

from sweep.analysis import sensitivity
from sweep.analysis.intervals import clopper_pearson, confidence_sequence
from sweep.analysis.stats import SuccessRate, format_percent, success_rate
from sweep.config.experiment import Experiment
from sweep.core.errors import InputError
from sweep.runs import store
from sweep.runs.runner import Job, prepare_job
from sweep.study.designs import Axis, drawn_axis_names
from sweep.study.size_limits import MAX_STUDY_ROLLOUTS
from sweep.study.study import Study, make_points

MISSING_LABEL, INVALID_LABEL, FAILURE_LABEL, SUCCESS_LABEL = -2, -1, 0, 1


@dataclass(frozen=True)
class Lattice:
    """The finest grid of a refined map; each cell of the study's own grid is 2^`halvings` lattice cells wide."""

    axes: tuple[Axis, ...]
    values: tuple[np.ndarray, ...]  # along each axis
    halvings: int

    @property
    def shape(self) -> tuple[int, ...]:
        """Number of lattice points along each axis."""
        return tuple(len(v) for v in self.values)

    def indices(self, rows: pd.DataFrame) -> tuple[np.ndarray, ...]:
        """Return the lattice index (rows,) of every row's point along each axis."""
        columns = [rows[a.column].to_numpy(dtype=float) for a in self.axes]
        return tuple(np.searchsorted((v[1:] + v[:-1]) / 2, c) for v, c in zip(self.values, columns, strict=True))


def make_lattice(study: Study) -> Lattice:
    """Return the finest grid that the refinement of a study may reach.

    Args:
        study: A study with `resolution` or `budget`.

    Raises:
        InputError: The study is not a full grid of numeric axes, draws cannot be added to its design, noise lacks a
            budget, or the lattice has too many points.
    """
    listed = [a for a in study.axes if a.values is not None]
    axes = tuple(a for a in listed if not any(isinstance(v, str) for v in a.values or ()))
    if study.points or study.where or not study.design.is_full_grid or any(a.along for a in listed):
        raise InputError("refinement needs a full grid: no points, where, axes that vary alone, or axes with `with`")
    values = [np.unique(np.asarray(a.values, dtype=float)) for a in axes]
    if not axes or min(map(len, values)) < 2:
        raise InputError("refinement needs axes of numbers, with at least 2 values each")
    if study.has_repeats and not study.design.can_add_draws:
        raise InputError(
            f"refinement needs draws that can be extended: study.design.kind = {study.design.kind} has none"
        )
    if study.has_repeats and not study.budget:
        raise InputError("study.budget is missing: refinement with noise or draws stops when the budget is spent")
    halvings = 0
    if study.resolution:
        widest = max(np.diff(v).max() / (v[-1] - v[0]) for v in values)
        halvings = max(math.ceil(math.log2(widest / study.resolution) - 1e-9), 0)
    if math.prod((len(v) - 1) * 2**halvings + 1 for v in values) > MAX_STUDY_ROLLOUTS:
        raise InputError(
            f"study.resolution = {study.resolution:g} is not allowed: a grid of more than {MAX_STUDY_ROLLOUTS} points"
        )
    fine = [np.interp(np.arange((len(v) - 1) * 2**halvings + 1) / 2**halvings, np.arange(len(v)), v) for v in values]
    return Lattice(axes, tuple(np.array([float(f"{x:.12g}") for x in v]) for v in fine), halvings)


def check_refinable(study: Study, first_grid: pd.DataFrame) -> None:
    """Raise `InputError` unless the axes and settings of a study allow the refinement of its map.

    Args:
        study: The study.
        first_grid: Rollouts of its own grid, a row each.

    Raises:
        InputError: See `make_lattice`; or the budget is smaller than the first grid.
    """
    make_lattice(study)
    if 0 < study.budget < len(first_grid):
        raise InputError(
            f"study.budget = {study.budget} is not allowed: the first grid takes {len(first_grid)} rollouts"
        )


def iter_panels(study: Study, rows: pd.DataFrame) -> Iterator[tuple[dict[str, str], pd.DataFrame]]:
    """Split rows by the categorical axes into panels, each of which is refined separately.

    Args:
        study: The study.
        rows: Finished rows; may be empty.

    Yields:
        The levels of one panel by axis name, and its rows.
    """
    named = [a for a in study.axes if a.values is not None and any(isinstance(v, str) for v in a.values)]
    for names in itertools.product(*(a.values or () for a in named)):
        part = rows
        for axis, name in zip(named, names, strict=True):
            part = part[part[axis.column] == name] if len(part) else part
        yield {a.name: n for a, n in zip(named, names, strict=True)}, part


def iter_jobs(exp: Experiment, folder: Path, first_grid: pd.DataFrame) -> Iterator[Job]:
    """Yield the job (batches to simulate) of each step of map refinement; run each job before asking for the next.

    First come points that an earlier run left and the study's own grid, then the points that finished rows call for.
    All batches have one width, so that the engine compiles once.

    Args:
        exp: Experiment of the study.
        folder: Its folder, whose finished rows decide what comes next.
        first_grid: Rollouts of the study's own grid, a row each.

    Yields:
        The next job, until refinement is done.
    """
    wanted = first_grid
    if len(planned := store.read_points(folder)):
        wanted = pd.concat([planned[first_grid.columns], first_grid], ignore_index=True)
    while len(wanted):
        if len(planned := store.read_points(folder)):
            exp = replace(exp, settings=replace(exp.settings, width=int(planned["width"].iloc[-1])))
        yield prepare_job(exp, folder, wanted)
        wanted = next_refinement_points(exp, store.read_rows(folder))


def next_refinement_points(exp: Experiment, rows: pd.DataFrame) -> pd.DataFrame:
    """Return the rollouts that the refinement of a map simulates next, given the finished `rows`.

    Args:
        exp: Experiment of the study.
        rows: Finished rows.

    Returns:
        A row for each new rollout; empty where refinement is done or the budget is spent.

    Raises:
        InputError: See `make_lattice`.
    """
    study, grid = exp.study, make_lattice(exp.study)
    first = max(study.design.count_draws(len(drawn_axis_names(study.axes))), 1) * study.replicates
    tables = []
    room = study.budget - len(rows) if study.budget else math.inf
    for names, part in iter_panels(study, rows):
        counts = _count_rollouts(grid, part)
        more = np.where(select_lattice_points(study, grid, counts) & (counts.total == 0), first, 0)
        if study.has_repeats and not more.any():
            asked = _undecided_points(study, counts) & (counts.total > 0)
            more = np.where(asked, np.maximum(counts.total // 2, first), 0)
        order = np.argsort(counts.total, axis=None, kind="stable")  # points with the fewest rollouts come first
        before = np.cumsum(more.ravel()[order]) - more.ravel()[order]
        more.ravel()[order] = np.clip(room - before, 0, more.ravel()[order])
        room -= more.sum()
        if more.any():
            tables.append(_point_rollouts(exp, grid, names, counts.total + more, more > 0))
    return pd.concat(tables, ignore_index=True) if tables else pd.DataFrame()


def _point_rollouts(
    exp: Experiment, grid: Lattice, names: dict[str, str], upto: np.ndarray, asked: np.ndarray
) -> pd.DataFrame:
    """Return rollouts for the points in the mask `asked`, up to a number of `upto` at each."""
    study, most = exp.study, int(upto[asked].max())
    if study.design.num:
        draws = -(-most // study.replicates)
        study = replace(study, design=study.design.resize_to_min_draws(draws, len(drawn_axis_names(study.axes))))
    else:
        study = replace(study, replicates=most)
    at = np.nonzero(asked)
    numbers = {a.name: v[i] for a, v, i in zip(grid.axes, grid.values, at, strict=True)}
    table = make_points(study, exp.system, exp.settings, pd.DataFrame(numbers).assign(**names))
    return table[table["replicate"].to_numpy() < upto[grid.indices(table)]].reset_index(drop=True)


@dataclass(frozen=True)
class LatticeCounts:
    """Number of all, of valid and of successful rollouts at every point of a refined map's finest grid."""

    total: np.ndarray
    valid: np.ndarray
    success: np.ndarray


def _count_rollouts(grid: Lattice, rows: pd.DataFrame) -> LatticeCounts:
    arrays = [np.zeros(grid.shape, dtype=np.int64) for _ in range(3)]
    if len(rows):
        at, outcome = grid.indices(rows), rows["outcome"].to_numpy()
        for array, hit in zip(arrays, (outcome == outcome, outcome != "invalid", outcome == "success"), strict=True):
            np.add.at(array, at, hit)
    return LatticeCounts(*arrays)


def _undecided_points(study: Study, counts: LatticeCounts) -> np.ndarray:
    """Mask of the points whose interval contains the level; points with invalid rollouts only are given up."""
    low, high = confidence_sequence(counts.success, counts.valid)
    return (low <= study.level) & (study.level <= high) & (counts.valid > 0)


def label_lattice_points(study: Study, counts: LatticeCounts) -> np.ndarray:
    """Return the label of every point of the finest grid: success, failure, invalid, or missing.

    Args:
        study: The study, with its `level`.
        counts: Rollouts at every lattice point.

    Returns:
        SUCCEEDS where the rate of success is at least the level, else FAILS; INVALID where all rollouts are invalid,
        MISSING where none was simulated.
    """
    share = counts.success / np.maximum(counts.valid, 1)
    known = np.where(share >= study.level, SUCCESS_LABEL, FAILURE_LABEL)
    return np.where(counts.total == 0, MISSING_LABEL, np.where(counts.valid == 0, INVALID_LABEL, known))


def select_lattice_points(study: Study, grid: Lattice, counts: LatticeCounts) -> np.ndarray:
    """Select the grid points that bisection needs; once all are simulated, also random points that test the result.

    Args:
        study: The study.
        grid: Its lattice.
        counts: Rollouts at every lattice point.

    Returns:
        Mask of the lattice, simulated points included.
    """
    label = label_lattice_points(study, counts)
    wanted = bisect_cells(label, grid.halvings)
    if not study.audit or (wanted & (label == MISSING_LABEL)).any():
        return wanted
    return wanted | draw_audit_points(study, wanted)


def draw_audit_points(study: Study, wanted: np.ndarray) -> np.ndarray:
    """Draw `study.audit` random grid points from those that bisection skipped, to test the labels filled in there.

    Args:
        study: The study.
        wanted: Mask of the points that bisection needs.

    Returns:
        Mask of the drawn points.
    """
    order = np.random.default_rng([study.seed, 1]).permutation(wanted.size)
    chosen = np.zeros(wanted.size, dtype=bool)
    chosen[order[~wanted.ravel()[order]][: study.audit]] = True
    return chosen.reshape(wanted.shape)


def bisect_cells(labels: np.ndarray, halvings: int) -> np.ndarray:
    """Select points of the finest grid by halving cells whose corners have different outcomes.

    A cell disagrees where both a success and a failure lie in it or on its border. So a boundary that leaves a halved
    cell through a side is followed into the next cell.

    Args:
        labels: Label of every lattice point, see `label_lattice_points`.
        halvings: How often a cell of the study's own grid may be halved.

    Returns:
        Mask of the points that bisection needs so far, labelled or still MISSING.
    """
    wanted = np.zeros(labels.shape, dtype=bool)
    wanted[(slice(None, None, 2**halvings),) * labels.ndim] = True
    while not (wanted & (labels == MISSING_LABEL)).any():
        grown = wanted.copy()
        seen = np.where(wanted, labels, MISSING_LABEL)
        for size in (2**k for k in range(halvings, 0, -1)):
            cells = np.argwhere(_disagreeing_cells(seen, size)) * size
            for offset in itertools.product((0, size // 2, size), repeat=labels.ndim):
                grown[tuple((cells + offset).T)] = True
        if (grown == wanted).all():
            break
        wanted = grown
    return wanted


def _disagreeing_cells(labels: np.ndarray, size: int) -> np.ndarray:
    inside = _cell_windows(labels, size)
    axes = tuple(range(labels.ndim, 2 * labels.ndim))
    return (inside == FAILURE_LABEL).any(axis=axes) & (inside == SUCCESS_LABEL).any(axis=axes)


def _cell_windows(array: np.ndarray, size: int) -> np.ndarray:
    """Points in and on the border of every cell of `size`: (cells along each axis ..., size + 1, ...)."""
    windows = np.lib.stride_tricks.sliding_window_view(array, (size + 1,) * array.ndim)
    return windows[(slice(None, None, size),) * array.ndim]


def leaf_cells(labels: np.ndarray, halvings: int) -> tuple[np.ndarray, ...]:
    """Return the lower corners of the cells that bisection does not divide further, for each size of cell.

    Args:
        labels: Labels of the lattice points that bisection needed; MISSING elsewhere.
        halvings: How often a cell of the study's own grid may be halved.

    Returns:
        Lower corners (cells, d), as lattice indices, of the cells that are 1, 2, 4, ... lattice cells wide.
    """
    whole = np.ones([(n - 1) // 2**halvings for n in labels.shape], dtype=bool)
    corners = []
    for size in (2**k for k in range(halvings, 0, -1)):
        halved = whole & _disagreeing_cells(labels, size)
        corners.append(np.argwhere(whole & ~halved) * size)
        whole = np.kron(halved, np.ones((2,) * labels.ndim, dtype=bool))
    return (np.argwhere(whole), *reversed(corners))


def infer_cell_labels(labels: np.ndarray, halvings: int) -> np.ndarray:
    """Fill in outcome labels inside grid cells whose corners agree and that contain no other label.

    Args:
        labels: Label of every lattice point.
        halvings: How often a cell of the study's own grid may be halved.

    Returns:
        Labels with those that could be filled in; MISSING where no cell tells.
    """
    guess = labels.copy()
    for size in (2**k for k in range(1, halvings + 1)):
        inside = _cell_windows(labels, size)
        corners = inside[(..., *(slice(None, None, size),) * labels.ndim)]
        axes = tuple(range(labels.ndim, 2 * labels.ndim))
        alike = (corners.min(axis=axes) == corners.max(axis=axes)) & (corners.min(axis=axes) >= FAILURE_LABEL)
        alike &= ~_disagreeing_cells(labels, size)
        for cell in np.argwhere(alike):
            block = guess[tuple(slice(i * size, (i + 1) * size + 1) for i in cell)]
            block[block == MISSING_LABEL] = labels[tuple(cell * size)]
    return guess


@dataclass(frozen=True)
class RefinedMapPanel:
    """Result of refining one map panel: outcome labels on the finest grid, its cells, error of filled-in labels."""

    level_names: dict[str, str]  # level of each categorical axis, by axis name
    lattice: Lattice
    labels: np.ndarray  # of every lattice point, simulated or filled in; MISSING where neither
    is_simulated: np.ndarray  # mask of the simulated points
    cells: tuple[np.ndarray, ...]  # see `leaf_cells`
    rate: SuccessRate  # of success, over the rollouts
    audited: int  # number of points simulated to check the label that was filled in
    missed: int  # number of audited points with another label than the one filled in
    undecided: int  # number of points whose interval still contains the level

    @property
    def rollouts(self) -> int:
        """Number of simulated rollouts."""
        return self.rate.total

    @property
    def mislabelled_share_upper_bound(self) -> float:
        """Upper end of the exact 95 % interval of the share of points with a wrong filled-in label."""
        return float(clopper_pearson(self.missed, self.audited).high)

    def __str__(self) -> str:
        size, shape = self.labels.size, " x ".join(map(str, self.lattice.shape))
        text = f"{self.rollouts:,} rollouts, {self.rate.invalid_rollouts_text}, for a grid of {shape} points"
        text = ", ".join(self.level_names.values()) + f": {text}" if self.level_names else text
        if self.rollouts < size:
            text += f", {size / self.rollouts:.1f} times fewer"
        if missing := int((self.labels == MISSING_LABEL).sum()):
            text += f"; {missing} points are not decided"
        if self.undecided:
            text += f"; at {self.undecided} the interval still holds the level"
        if self.audited:
            text += f"; {self.missed} of {self.audited} audited points differ from the outcome of their cell"
            text += (
                f", at most {format_percent(self.mislabelled_share_upper_bound)} of the points that were not run (95 %)"
            )
        return text


def summarize_panels(exp: Experiment, rows: pd.DataFrame) -> list[RefinedMapPanel]:
    """Summarize a refined study, once for each combination of values of its listed axes.

    Args:
        exp: Experiment of the study.
        rows: Finished rows.

    Returns:
        One summary for each combination of levels of the categorical axes, in the order of `iter_panels`.
    """
    summaries, grid = [], make_lattice(exp.study)
    for names, part in iter_panels(exp.study, rows):
        counts = _count_rollouts(grid, part)
        label = label_lattice_points(exp.study, counts)
        wanted = bisect_cells(label, grid.halvings)
        seen = np.where(wanted, label, MISSING_LABEL)
        filled, cells = infer_cell_labels(seen, grid.halvings), leaf_cells(seen, grid.halvings)
        audit = draw_audit_points(exp.study, wanted) & (label >= FAILURE_LABEL) & (filled >= FAILURE_LABEL)
        missed = int((label != filled)[audit].sum())
        undecided = int(_undecided_points(exp.study, counts).sum()) if exp.study.has_repeats else 0
        known = counts.total > 0
        merged = np.where(known, label, filled)
        success = success_rate(part["outcome"])
        summaries.append(
            RefinedMapPanel(names, grid, merged, known, cells, success, int(audit.sum()), missed, undecided)
        )
    return summaries


def total_effects(exp: Experiment, rows: pd.DataFrame) -> pd.DataFrame:
    """Compute the total Sobol index of success for each listed axis, over the finest grid of a refined map.

    The rows themselves would mislead, as most of them lie next to the boundary; the lattice is even. A lattice point
    without a label counts half.

    Args:
        exp: The experiment of a study with `resolution`.
        rows: Its rows.

    Returns:
        A row for each listed axis, a number or a name: `axis`, and `total`, its total Sobol index; the largest first.
        Empty where nothing varies.
    """
    summaries, study = summarize_panels(exp, rows), exp.study
    named = [a for a in study.axes if a.values is not None and any(isinstance(v, str) for v in a.values)]
    names = [len(a.values or ()) for a in named]
    value = np.stack([np.where(one.labels < FAILURE_LABEL, 0.5, one.labels == SUCCESS_LABEL) for one in summaries])
    weights = [np.ones(n) for n in names]
    weights += [np.diff(np.concatenate([v[:1], (v[1:] + v[:-1]) / 2, v[-1:]])) for v in summaries[0].lattice.values]
    total = sensitivity.total_effects(value.reshape(*names, *value.shape[1:]), weights)
    table = pd.DataFrame({"axis": [a.column for a in (*named, *summaries[0].lattice.axes)], "total": total})
    return table.dropna().sort_values("total", ascending=False, ignore_index=True)


def add_inferred_rows(exp: Experiment, rows: pd.DataFrame) -> pd.DataFrame:
    """Return the rows with an additional row for each lattice point whose label was filled in, so that a map has no
    holes.

    Args:
        exp: Experiment of the study.
        rows: Finished rows.

    Returns:
        `rows` with `known` set to True, then the filled-in points: axes, `outcome`, `cause`, and `known` False. A
        filled-in failure has the cause of the nearest simulated failure.
    """
    from scipy.ndimage import distance_transform_edt

    parts = [rows.assign(known=True)]
    for panel, (_, part) in zip(summarize_panels(exp, rows), iter_panels(exp.study, rows), strict=True):
        guessed = ~panel.is_simulated & (panel.labels >= FAILURE_LABEL)
        if part.empty or not guessed.any():
            continue
        causes = np.full(panel.labels.shape, "", dtype=object)
        failed = part[part["outcome"] == "failure"]
        causes[panel.lattice.indices(failed)] = failed["cause"]
        if len(failed):
            nearest = distance_transform_edt(causes == "", return_distances=False, return_indices=True)
            causes = np.where(panel.labels == FAILURE_LABEL, causes[tuple(np.asarray(nearest))], "")
        at = np.nonzero(guessed)
        more = {a.column: v[i] for a, v, i in zip(panel.lattice.axes, panel.lattice.values, at, strict=True)}
        outcome = np.where(panel.labels[at] == SUCCESS_LABEL, "success", "failure")
        named = {a.column: panel.level_names[a.name] for a in exp.study.axes if a.name in panel.level_names}
        parts.append(pd.DataFrame({**more, **named, "outcome": outcome, "cause": causes[at], "known": False}))
    return pd.concat(parts, ignore_index=True)

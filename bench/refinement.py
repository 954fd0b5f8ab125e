"""Compare a refined map with the whole grid: `python bench/refinement.py REFINED GRID`."""

import sys
from pathlib import Path

import numpy as np
from scipy.ndimage import binary_dilation

from sweep.config.experiment import build_experiment
from sweep.runs import store
from sweep.runs.refine import FAILURE_LABEL, MISSING_LABEL, SUCCESS_LABEL, summarize_panels


def main(folder: Path, whole: Path) -> None:
    """Print the savings of the refined map, and where it is wrong."""
    exp = build_experiment(store.read_study(folder)["config"])
    rows = store.read_rows(folder)
    (found,) = summarize_panels(exp, rows)
    grid = store.read_rows(whole)
    truth = np.full(found.lattice.shape, MISSING_LABEL)
    truth[found.lattice.indices(grid)] = np.where(grid["outcome"] == "success", SUCCESS_LABEL, FAILURE_LABEL)
    invalid = np.zeros(found.lattice.shape, dtype=bool)
    invalid[found.lattice.indices(grid)] = grid["outcome"] == "invalid"
    compared = (found.labels >= FAILURE_LABEL) & (truth != MISSING_LABEL) & ~invalid
    wrong = compared & (found.labels != truth)
    good = truth == SUCCESS_LABEL
    edge = np.logical_and(binary_dilation(good), binary_dilation(~good))  # within one cell of the boundary
    print(found)
    print(f"whole grid: {len(grid)} rollouts ({len(grid) / len(rows):.1f} times more), {int(invalid.sum())} invalid")
    print(f"differing points: {int(wrong.sum())} of {int(compared.sum())}")
    print(f"those more than a cell away from the boundary: {int((wrong & ~edge).sum())}")


if __name__ == "__main__":
    main(*map(Path, sys.argv[1:3]))

"""Which drawn numbers matter, from whatever draws there are: no design of its own is needed. Functions of SALib."""

import numpy as np
import pandas as pd

from sweep.analysis.sampling_units import PLAIN, draw_numbers
from sweep.analysis.sensitivity import drawn, listed, measured, numeric
from sweep.core.errors import InputError
from sweep.study.config import Experiment

LEAST, MOST = 100, 20_000  # rollouts that are asked for, and that are looked at
SLICES, HARMONICS = 10, 10  # of PAWN; of RBD-FAST


def pawn(rows: pd.DataFrame, exp: Experiment, figure: str | None = None) -> pd.DataFrame:
    """PAWN indices of success, or of the column `figure`: how far its distribution moves when an axis is fixed.

    An axis is cut into ten slices of equally many draws; `median` and `largest` are Kolmogorov and Smirnov's distances
    between the values in a slice and all values. `by_chance` is the median of an axis that means nothing, as random
    numbers have it. Raises `InputError` where there are too few draws or another design (Pianosi and Wagener, 2018).
    """
    from SALib.analyze import pawn as salib

    names, x, y = _sample(rows, exp, figure, "PAWN indices need")
    chance = np.random.default_rng(0).random(len(x))
    found = salib.analyze({"num_vars": len(names) + 1, "names": [*names, ""]}, np.column_stack([x, chance]), y, SLICES)
    columns = {"axis": names, "median": found["median"][:-1], "largest": found["maximum"][:-1]}
    table = pd.DataFrame({**columns, "by_chance": found["median"][-1], "draws": len(y)})
    return table.sort_values("median", ascending=False, ignore_index=True)


def first_order(rows: pd.DataFrame, exp: Experiment, figure: str | None = None) -> pd.DataFrame:
    """First Sobol indices of success, or of the column `figure`, by RBD-FAST, with 95 % errors (bootstrap).

    The share of the variance that an axis explains alone. Raises `InputError` where there are too few draws, another
    design, or draws that are correlated (Tarantola, Gatelli and Mara, 2006).
    """
    from SALib.analyze import rbd_fast as salib

    if exp.study.design.correlation:
        raise InputError("RBD-FAST needs draws without correlation")
    names, x, y = _sample(rows, exp, figure, "RBD-FAST needs")
    found = salib.analyze({"num_vars": len(names), "names": names}, x, y, HARMONICS, seed=0)
    table = pd.DataFrame({"axis": names, "first": found["S1"], "error": found["S1_conf"], "draws": len(y)})
    return table.sort_values("first", ascending=False, ignore_index=True)


def _sample(
    rows: pd.DataFrame, exp: Experiment, figure: str | None, what: str
) -> tuple[list[str], np.ndarray, np.ndarray]:
    """Drawn axes, their numbers (n, d), and what came of them (n,), of valid rollouts."""
    names = [axis.column for axis in numeric(rows, drawn(rows, exp))]
    if exp.study.design.kind not in PLAIN or not names:
        raise InputError(f"{what} a study with draws of design.kind = {', '.join(PLAIN)}")
    if conditions := listed(rows, exp):
        raise InputError(f"{what} one grid point: choose among {', '.join(a.column for a in conditions)}")
    value = measured(rows, figure)
    if exp.study.replicates > 1:  # a draw counts once, by the mean of its valid replicates
        draws = draw_numbers(rows, exp)
        value = value.groupby(draws).transform("mean")[~pd.Series(draws).duplicated().to_numpy()]
        rows = rows.loc[value.index]
    valid = value.notna()
    if valid.sum() < LEAST or value[valid].nunique() < 2:
        raise InputError(f"{what} {LEAST} valid draws of values that vary, here: {valid.sum()}")
    chosen = rows.loc[valid, names].head(MOST)
    return names, chosen.to_numpy(float), value[valid].head(MOST).to_numpy()

"""Whether margins and reserves shrink before anything breaks: lines of errors from nominal to the first failure.

To run: `python bench/margins.py FOLDER SCENARIO [OVERRIDE ...]`, from a checkout. Each line goes from nominal into a
random direction of the normals behind the errors of `study=any_rare`; a second pass goes through the step in which it
fails. The same command goes on where it was.
"""

import sys
from pathlib import Path

import numpy as np
import pandas as pd
from scipy.special import ndtr
from scipy.stats import spearmanr

from sweep.runs import runner, store
from sweep.study.config import Experiment, compose
from sweep.study.sought import Draws
from sweep.study.study import points

LINES, FAR = 16, 6.0  # standard deviations
COARSE, FINE = 24, 5  # steps of a line; of the one of them that fails
CLIFF = 0.25  # of a margin, in units of its threshold, within a fine step
LEADS = -0.8  # Spearman's coefficient of a column and the way, up to the first failure
COLUMNS = ("margin", "friction_reserve_min", "torque_reserve_min", "reach_reserve_min_m", "edge_reserve_min_m",
           "stability_margin_min_m")  # fmt: skip


def simulated(exp: Experiment, folder: Path, u: np.ndarray) -> pd.DataFrame:
    """Rows (n,) of rollouts whose errors have the normals `u` (n, d), kept in `folder`."""
    one_noise = np.zeros(len(u), dtype=int)  # for all, so that lines are smooth
    nothing = {"weight": np.ones(len(u)), "round": np.zeros(len(u))}
    table = points(exp.study, exp.system, exp.settings, round_=Draws(ndtr(u), one_noise, nothing))
    with store.locked(folder):
        runner.mend(exp, folder)
        runner.run(runner.lay_out(exp, folder, table), lambda rows: print(f"  {len(rows)} rollouts", file=sys.stderr))
    return store.read_rows(folder).set_index("point_id").loc[table["point_id"]].reset_index()


def first(rows: pd.DataFrame) -> int:
    """Number of the first that does not succeed, or how many there are."""
    bad = (rows["outcome"] != "success").to_numpy()
    return int(np.argmax(bad)) if bad.any() else len(bad)


def lines(exp: Experiment, folder: Path) -> list[pd.DataFrame]:
    """Rows of each line up to its first failure, by `way` (standard deviations from nominal)."""
    d = len(exp.study.axes)
    towards = np.random.default_rng(0).standard_normal((LINES, d))
    towards /= np.linalg.norm(towards, axis=1, keepdims=True)
    way = np.linspace(0, FAR, COARSE + 1)
    along = (way[None, 1:, None] * towards[:, None]).reshape(-1, d)
    coarse = simulated(exp, folder, np.concatenate([np.zeros((1, d)), along]))
    every = [coarse.iloc[[0, *range(1 + k * COARSE, 1 + (k + 1) * COARSE)]].assign(way=way) for k in range(LINES)]
    ends = [first(rows) for rows in every]
    inner = [np.linspace(way[end - 1], way[end], FINE + 1)[1:-1] if 0 < end <= COARSE else [] for end in ends]
    u = [away * direction for steps, direction in zip(inner, towards, strict=True) for away in steps]
    fine = simulated(exp, folder, np.array(u)).assign(way=np.concatenate(inner))
    found, at = [], 0
    for rows, end, steps in zip(every, ends, inner, strict=True):
        part = pd.concat([rows[: end + 1], fine[at : at + len(steps)]]).sort_values("way", ignore_index=True)
        found.append(part[: first(part) + 1])
        at += len(steps)
    return found


def main(folder: str, scenario: str, *overrides: str) -> None:
    """A table in Markdown, and a line for each line."""
    exp = compose([f"scenario={scenario}", "study=any_rare", "study.design.num=1", *overrides])
    where = Path(folder) / scenario
    where.mkdir(parents=True, exist_ok=True)
    found = lines(exp, where)
    ended = [rows for rows in found if rows["outcome"].iloc[-1] != "success" and len(rows) > 2]
    falls = []
    for rows in ended:
        step = rows["margin"].clip(lower=-1.0).diff().min()
        falls.append(-step)
        last = rows.iloc[-1]
        print(
            f"{last['way']:.2f} {last['cause']} {last['limit']} fall {-step:.2f}, margin of {last['margin_of']}, "
            f"before {rows['margin_of'].iloc[-2]} {rows['margin'].iloc[-2]:.2f}"
        )
    smooth = int((np.array(falls) <= CLIFF).sum())
    print(f"\n{scenario}: {len(ended)} of {LINES} lines fail within {FAR:g}, {smooth} without cliff")
    print("| column | nominal | leads in |\n|:--|--:|--:|")
    for column in (c for c in COLUMNS if c in found[0]):
        leads = [spearmanr(rows["way"][:-1], rows[column][:-1])[0] for rows in ended if rows[column][:-1].nunique() > 1]
        print(f"| `{column}` | {found[0][column].iloc[0]:.3g} | {(np.array(leads) <= LEADS).sum()} |")


if __name__ == "__main__":
    main(*sys.argv[1:])

"""What `sweep trials` says of a simulated reality: `python bench/trials.py`.

It writes research/data/trials.json and research/figures/trials.png, which research/decisions.md cites. In the simulated
world a trial at condition c succeeds if c + x + noise < 1.2, where x and y are believed to be even from 0 to 1. Reality
has one x, or a threshold that the simulation does not know.
"""

import time

import numpy as np
import pandas as pd
import shared
from scipy.stats import norm

from sweep.analysis import trials
from sweep.core.plot_style import COLUMN_WIDTH_IN, new_figure, save_figure
from sweep.study.importance_sampling import effective_sample_size

DRAWS, SETS, NOISE = 1000, 200, 0.05  # simulated draws; sets of real trials; standard deviation
CONDITIONS = np.round(np.arange(0.2, 1.21, 0.1), 1)
FIGURE = shared.FIGURES / "trials.png"


def succeed(c: np.ndarray, x: np.ndarray, threshold: float, rng: np.random.Generator) -> np.ndarray:
    """Return which trials succeed at conditions c with parameters x."""
    return c + x + NOISE * rng.standard_normal(np.broadcast_shapes(np.shape(c), np.shape(x))) < threshold


def calibration_table(rng: np.random.Generator) -> shared.Table:
    """Return how often predictions are called wrong, if they are right and if reality differs."""
    table = [["reality", "trials", "Brier score", "expected Brier score", "called not calibrated"]]
    grid = (np.arange(2000) + 0.5) / 2000
    rates = np.array([norm.cdf((1.2 - c - grid) / NOISE).mean() for c in CONDITIONS])
    for name, threshold in (("as simulated", 1.2), ("threshold 1.1", 1.1), ("threshold 1.0", 1.0)):
        for repeats in (5, 20):
            c = np.repeat(CONDITIONS, repeats)
            found = []
            for _ in range(SETS):
                won = succeed(c, rng.random(len(c)), threshold, rng)
                found.append(trials.assess_prediction_calibration(np.repeat(rates, repeats), won))
            wrong = np.mean([one.p_value < 0.05 for one in found])
            brier, expected = (np.mean([getattr(one, key) for one in found]) for key in ("brier", "expected_brier"))
            table.append([name, f"{len(c)}", f"{brier:.3f}", f"{expected:.3f}", f"{100 * wrong:.0f} %"])
    return table


def belief_tables(rng: np.random.Generator) -> shared.Table:
    """Return what trials say of the parameters of a reality with one x."""
    table = [["true x", "trials", "x after", "its error", "x moved", "y moved", "effective draws"]]
    for x in (0.3, 0.7):
        for repeats in (1, 3):
            c = np.repeat(CONDITIONS, repeats)
            lines = []
            for _ in range(SETS):
                values = pd.DataFrame({"x": rng.random(DRAWS), "y": rng.random(DRAWS)})
                simulated = norm.cdf((1.2 - c - values[["x"]].to_numpy()) / NOISE)
                weights = trials.draw_likelihood_weights(simulated, succeed(c, np.array(x), 1.2, rng), 0.01)
                found = trials.prior_posterior_table(values, weights).set_index("parameter")
                moved = found["p_holm"] < 0.05
                lines.append(
                    (found.loc["x", "mean_after"], found.loc["x", "sd_after"], moved["x"], moved["y"],
                     effective_sample_size(weights))
                )  # fmt: skip
            mean, spread, x_moved, y_moved, effective = np.mean(np.array(lines, float), axis=0)
            error = np.sqrt(np.mean([(one[0] - x) ** 2 for one in lines]))
            shares = f"{100 * x_moved:.0f} %", f"{100 * y_moved:.0f} %"
            table.append(
                [f"{x:g}", f"{len(c)}", f"{mean:.3f} ± {spread:.3f}", f"{error:.3f}", *shares, f"{effective:.0f}"]
            )
    return table


def draw_curves(rng: np.random.Generator) -> None:
    """Draw the reliability curves of 220 trials, of a reality as simulated and of another one."""
    figure = new_figure(COLUMN_WIDTH_IN, COLUMN_WIDTH_IN)
    ax = figure.add_subplot()
    ax.plot([0, 100], [0, 100], color="0.6", linewidth=0.6)
    grid = (np.arange(2000) + 0.5) / 2000
    c = np.repeat(CONDITIONS, 20)
    rates = np.repeat([norm.cdf((1.2 - one - grid) / NOISE).mean() for one in CONDITIONS], 20)
    for threshold, label, colour in ((1.2, "as simulated", "#00649E"), (1.0, "threshold 1.0", "#D55E00")):
        curve = trials.reliability_curve(rates, succeed(c, rng.random(len(c)), threshold, rng))
        ends = np.abs(curve[["low", "high"]].to_numpy().T - curve["share"].to_numpy())
        style = {"fmt": "o-", "capsize": 2, "markersize": 3, "color": colour, "label": label}
        ax.errorbar(100 * curve["predicted"], 100 * curve["share"], yerr=100 * ends, **style)
    ax.set(xlabel="predicted success rate, %", ylabel="observed success rate, %", xlim=(0, 100), ylim=(0, 100))
    ax.legend(title="reality", frameon=False)
    save_figure(figure, FIGURE)


def main() -> None:
    """Compute and write the tables and the picture."""
    rng, start = np.random.default_rng(0), time.perf_counter()
    tables = {"calibration": calibration_table(rng), "beliefs": belief_tables(rng)}
    draw_curves(rng)
    shared.write_tables("trials", (), start, tables)


if __name__ == "__main__":
    main()

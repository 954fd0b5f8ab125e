"""Push maps with known answers: `python bench/push_thresholds.py`.

It writes research/data/push_thresholds.json and research/figures/push_thresholds.png, which research/decisions.md
cites. Success rates that are known show how often intervals and islands of `sweep.analysis.push_map` are wrong, and how
many draws an island needs. A box that a push tips over has thresholds from mechanics. The picture is the push map of
the quadruped that `sweep init --model` writes.
"""

import contextlib
import tempfile
import time
from pathlib import Path

import numpy as np
import pandas as pd
import shared

from sweep.analysis.push_map import PushRows, threshold_table
from sweep.analysis.stats import format_percent
from sweep.cli.main import main as run_command
from sweep.core.plot_style import plot_style, save_figure
from sweep.report.push_map import push_map_figure
from sweep.runs.results import read_results

SIZES, THRESHOLD, MAPS, DIRECTIONS = np.linspace(0, 16, 17), 8.3, 200, 12
WIDTHS = (0.4, 1.2)  # of the logistic fall of the success rate
ISLAND_AT, ISLAND_RATES = 12, (0.3, 0.6, 0.9)  # size of the island, and success rates there
DRAWS = (10, 20, 40, 80)  # rollouts of each size and direction
GRAVITY, MASS, LENGTH, BREADTH, HEIGHT = 9.81, 3.0, 0.12, 0.08, 0.3  # m/s^2, kg, and half sizes of the box, m
BOX = f"""<mujoco><option timestep="0.001" cone="elliptic" impratio="20"/>
<worldbody><geom name="floor" type="plane" size="0 0 1" friction="4"/>
<body name="box" pos="0 0 {HEIGHT}"><freejoint/>
<geom type="box" size="{LENGTH} {BREADTH} {HEIGHT}" mass="{MASS}" friction="4" solref="0.004 1"/></body>
<body name="wheel" pos="0 9 1"><joint name="axle"/><geom size="0.1" mass="1"/></body></worldbody>
<actuator><motor name="none" joint="axle"/></actuator></mujoco>"""
STILL = "import jax.numpy as jnp\ndef policy(belief, seen, state, key): return jnp.zeros(1), state\n"
STUDY = """system: mujoco
model: {mjcf: box.xml, controller: "still:policy", duration: 2}
push: {kick: {body: box, start: 0.2, length: 0.01}}
outcome: {fell: tilt_max_deg > 60}
study:
  replays: 0
  axes:
    impulse: {path: push.kick.impulse, from: 1, to: 7, num: 61}
    direction: {path: push.kick.direction, from: 0, to: 4.71238898, num: 4}
"""
FIGURE = shared.FIGURES / "push_thresholds.png"


def draw_map(rates: np.ndarray, draws: int, rng: np.random.Generator) -> PushRows:
    """Draw independent rollouts of all sizes and directions of a map with given success rates by size."""
    way, size = (x.ravel() for x in np.meshgrid(np.arange(DIRECTIONS), np.arange(len(SIZES)), indexing="ij"))
    way, size = np.repeat(way, draws), np.repeat(size, draws)
    success = rng.random(len(size)) < rates[size]
    return PushRows(pd.DataFrame({"direction": way}), SIZES[size], 0.0, success, np.arange(len(size)))


def interval_table(rng: np.random.Generator) -> shared.Table:
    """Return how often intervals hold the threshold, how wide they are, and how often a map has a false island."""
    table = [["rate falls over", "draws of a size", "interval holds", "its median width", "maps with a false island"]]
    for width in WIDTHS:
        rates = 1 / (1 + np.exp((SIZES - THRESHOLD) / width))
        for draws in DRAWS[:3]:
            maps = [threshold_table(draw_map(rates, draws, rng)) for _ in range(MAPS)]
            every = pd.concat(maps)
            inside = (every["low"] <= THRESHOLD) & (every["high"] >= THRESHOLD)
            false = np.mean([one["fails_at"].notna().any() for one in maps])
            span = (every["high"] - every["low"]).median()
            table.append(
                [f"{4 * width:g} sizes", f"{draws}", format_percent(inside.mean()), f"{span:g}", format_percent(false)]
            )
    return table


def island_table(rng: np.random.Generator) -> shared.Table:
    """Return the share of directions in which an island of one size is found, by its success rate and by draws."""
    table = [["success rate of the island", *(f"{draws} draws of a size" for draws in DRAWS)]]
    for rate in ISLAND_RATES:
        rates = np.where(SIZES == ISLAND_AT, rate, 1 / (1 + np.exp((SIZES - THRESHOLD) / WIDTHS[0])))
        found = []
        for draws in DRAWS:
            maps = pd.concat([threshold_table(draw_map(rates, draws, rng)) for _ in range(MAPS // 10)])
            found.append(format_percent((maps["survives_at"] == ISLAND_AT).mean()))
        table.append([f"{rate:g}", *found])
    return table


def tipping_impulse(half_base: float) -> float:
    """Return the least impulse (N s) at the centre of a box that tips it over the edge at `half_base` (m) from it."""
    reach = np.hypot(half_base, HEIGHT)
    inertia = MASS * reach**2 * 4 / 3  # about the edge
    return float(np.sqrt(2 * inertia * MASS * GRAVITY * (reach - HEIGHT)) / HEIGHT)


def box_table() -> shared.Table:
    """Return impulses that tip a box over, simulated and from the energy that its centre needs to pass the edge."""
    for name, text in {"box.xml": BOX, "still.py": STILL, "study.yaml": STUDY, "sweep.yaml": "modules: []\n"}.items():
        Path(name).write_text(text)
    run_command(["run", "study=study.yaml", "out=box"])
    (figure,) = push_map_figure(read_results(Path("box")))
    table = [["direction", "by mechanics (N s)", "simulated (N s)", "last survived, first not", "islands"]]
    for k, line in enumerate(figure.data.to_dict("records")):
        law = tipping_impulse((LENGTH, BREADTH)[k % 2])
        ends = f"{line['low']:.2f}, {line['high']:.2f}"
        islands = "none" if np.isnan(line["fails_at"]) else "some"
        table.append([f"{90 * k}°", f"{law:.2f}", f"{line['threshold']:.2f}", ends, islands])
    return table


def draw_quadruped() -> None:
    """Simulate the push map of the quadruped of `sweep init --model`, and draw it."""
    run_command(["init", "--model", "quad"])
    with contextlib.chdir("quad"):
        run_command(["run", "study=push_map", "study.replays=0", "out=map"])
        (figure,) = push_map_figure(read_results(Path("map")))
    with plot_style():
        save_figure(figure.draw(), FIGURE)


def main() -> None:
    """Compute and write the tables and the picture."""
    rng, start = np.random.default_rng(0), time.perf_counter()
    tables = {"intervals": interval_table(rng), "islands": island_table(rng)}
    with tempfile.TemporaryDirectory() as folder, contextlib.chdir(folder):
        tables["box"] = box_table()
        draw_quadruped()
    shared.write_tables("push_thresholds", ("native",), start, tables)


if __name__ == "__main__":
    main()

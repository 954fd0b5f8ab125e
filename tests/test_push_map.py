"""Push maps: thresholds with known answers, islands beyond chance, and the map of a ball that a push sets in motion."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from own_rollouts import write_texts
from scipy.stats import fisher_exact

from sweep.analysis.push_map import PushRows, fisher_p, threshold_table
from sweep.cli.main import main
from sweep.report import push_map as drawn
from sweep.runs import results

SIZES = np.linspace(0.0, 9.0, 10)
FALLING = 1 / (1 + np.exp(2 * (SIZES - 4.3)))  # 0.5 at 4.3
ISLAND = np.where(SIZES == 7, 0.8, FALLING)
SINE = """import jax.numpy as jnp
def policy(belief, seen, state, key): return jnp.zeros(1), state
"""
MODEL = """<mujoco><option timestep="0.002" gravity="0 0 0" integrator="Euler"/>
<worldbody>
  <body name="ball" pos="0 0 1"><freejoint/><geom type="box" size="0.3 0.1 0.1" mass="2"/></body>
  <body name="cart" pos="0 2 1"><joint name="rail" type="slide" axis="1 0 0"/><geom size="0.1" mass="1"/></body>
</worldbody>
<actuator><motor name="pull" joint="rail"/></actuator>
</mujoco>"""
STUDY = """system: mujoco
model: {mjcf: model.xml, controller: "still:policy", duration: 1.02}
push: {kick: {body: ball, start: 0, length: 0.02}}
outcome: {far: travelled_m > 1}
study:
  axes:
    size: {path: push.kick.impulse, from: 0.25, to: 4.75, num: 10}
    way: {path: push.kick.direction, from: 0, to: 5.75958653, num: 12}
    body: {path: push.kick.body, values: [ball, cart]}
"""


def draw_rows(rates, per_size, directions, seed, paired=False):
    """Rollouts of several directions whose success rates by size are `rates`."""
    rng = np.random.default_rng(seed)
    way, size, unit = (
        x.ravel() for x in np.meshgrid(*map(np.arange, (directions, len(SIZES), per_size)), indexing="ij")
    )
    number = rng.random((directions, 1 if paired else len(SIZES), per_size))
    number = np.broadcast_to(number, (directions, len(SIZES), per_size)).ravel()
    units = unit if paired else np.arange(len(unit))
    return PushRows(pd.DataFrame({"way": way}), SIZES[size], 0.0, number < rates[size], units)


@pytest.mark.parametrize("paired", [False, True])
def test_intervals_cover_and_islands_are_beyond_chance(paired):
    """Of 20 maps at most 5 % have an island that is none; 95 % of the thresholds lie in their intervals."""
    found = [threshold_table(draw_rows(FALLING, 30, 12, seed, paired)) for seed in range(20)]
    assert sum(one["fails_at"].notna().any() for one in found) <= 1 + 2
    every = pd.concat(found)
    inside = (every["low"] <= 4.3) & (every["high"] >= 4.3)
    assert inside.mean() > 0.95
    assert (every["high"] - every["low"]).median() <= 3
    assert abs(every["threshold"].median() - 4.3) < 0.15


@pytest.mark.parametrize("paired", [False, True])
def test_an_island_is_found_with_its_sizes(paired):
    found = threshold_table(draw_rows(ISLAND, 40, 12, 0, paired))
    assert (found["survives_at"] == 7).mean() > 0.9
    assert found["fails_at"].dropna().isin([5, 6]).all()
    assert (found["p_holm"].dropna() <= 0.05).all()


def test_fishers_test_is_that_of_scipy():
    table = np.random.default_rng(0).integers(0, 12, (20, 2))
    p = fisher_p(table[:, 0], np.full(20, 12), table[:, 1], np.full(20, 15))
    wanted = [fisher_exact([[a, 12 - a], [b, 15 - b]], "greater").pvalue for a, b in table]
    np.testing.assert_allclose(p, wanted, rtol=1e-9)


def test_single_rollouts_are_facts():
    outcomes = {
        "falls": [1, 1, 1, 0, 0, 0, 0, 0, 0, 0],
        "never": [1] * 10,
        "always": [0] * 10,
        "island": [1, 1, 0, 1, 0, 0, 0, 0, 0, 0],
    }
    success = np.array([*outcomes.values()], bool).ravel()
    way = pd.DataFrame({"way": np.repeat([*outcomes], len(SIZES))})
    found = threshold_table(PushRows(way, np.tile(SIZES, 4), 0.0, success, None)).set_index("way")
    assert dict(zip(found.index, found[["low", "threshold", "high"]].to_numpy().tolist(), strict=True)) == {
        "falls": [2, 2.5, 3], "never": [9, np.inf, np.inf], "always": [0, 0, 0], "island": [1, 2.5, 4],
    }  # fmt: skip
    assert found["fails_at"].dropna().to_dict() == {"island": 2}
    assert found["survives_at"].dropna().to_dict() == {"island": 3}


@pytest.mark.parametrize("bodies", [["ball"], pytest.param(["ball", "cart"], marks=pytest.mark.slow)])
def test_a_ball_flies_as_its_impulse_says(tmp_path, monkeypatch, capsys, bodies):
    """Without gravity a mass m travels J cos(direction) / m in a second: the push along x that moves it by 1 m."""
    monkeypatch.chdir(tmp_path)
    write_texts({"model.xml": MODEL, "still.py": SINE, "study.yaml": STUDY})
    several = [f"study.axes.body.values={bodies}"] if len(bodies) > 1 else ["~study.axes.body"]
    assert main(["run", "study=study.yaml", "out=map", "study.replays=0", *several]) == 0
    found = results.read_results(Path("map"))
    (figure,) = drawn.push_map_figure(found)
    table = figure.data.rename(columns=lambda c: c.rpartition(".")[2])
    for line in table.to_dict("records"):
        is_ball = line.get("body", "ball") == "ball"  # whose travelled_m it is
        needed = 2.0 / max(np.cos(line["direction"]), 1e-9) if is_ball else np.inf
        assert line["low"] <= needed, line
        assert needed <= line["high"] or needed > 4.75, line
    assert np.isfinite(table["threshold"]).sum() == 5
    assert table["fails_at"].isna().all()
    axes = figure.draw().axes
    assert [ax.get_title() for ax in axes if ax.name == "polar"] == [
        f"body {body}" if len(bodies) > 1 else "" for body in bodies
    ]
    capsys.readouterr()
    assert main(["stats", "map"]) == 0
    assert "## Push thresholds" in capsys.readouterr().out
    assert main(["run", "study=study.yaml", "study.axes.body.values=[ball, bal]", "out=none"]) == 2
    assert "bal" in capsys.readouterr().err

"""Terrain of own models: heights at points, seeds, a ball that rolls down, where robots start, and mistakes."""

import json
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
import pytest
from own_rollouts import prepare_batch, write_texts
from small_study import one_line

from sweep.cli.main import main
from sweep.config.experiment import compose
from sweep.runs import store
from sweep.runs.runner import select_points_to_simulate
from sweep.systems.mujoco_model.terrain_heights import NUMBERS, compute_heights

PERIOD, RADIUS, GRAVITY = 0.02, 0.1, 9.81
MODEL = f"""<mujoco><option timestep="0.002" integrator="Euler" gravity="0 0 {-GRAVITY}"/>
<worldbody>
  <geom name="floor" type="plane" size="5 5 1"/>
  <body name="ball" pos="0 0 {RADIUS}"><freejoint/><geom name="ball" size="{RADIUS}" mass="1"/></body>
  <body name="cart" pos="0 3 3"><joint name="rail" type="slide" axis="1 0 0"/><geom size="0.1" mass="1"/></body>
</worldbody>
<actuator><motor name="pull" joint="rail"/></actuator>
</mujoco>"""
STILL = """import jax.numpy as jnp
def policy(belief, seen, state, key): return jnp.zeros(1), state
"""
STUDY = """system: mujoco
model:
  {mjcf: model.xml, controller: "still:policy", duration: 0.8, terrain: {kind: slope, start: -9, resolution: 0.1}}
outcome: {far: travelled_m > 9}
study: {axes: {one: {path: model.terrain.slope, values: [-0.2, 0.0, 0.3]}}}
"""


@pytest.fixture
def here(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    write_texts({"model.xml": MODEL, "still.py": STILL, "one.yaml": STUDY})
    return tmp_path


def simulate(*more) -> tuple[list[Any], dict[str, Any]]:
    """Traces and metrics of a study's rollouts in one batch."""
    engine, batch = prepare_batch("engine.precision=float64", *more)
    found = engine.run(*batch)
    return list(engine.traces(*batch, 1)), found


def heights(kind, x, y=(0.0,), **numbers):
    """Heights (rows, columns) of a terrain at some places."""
    usual = {name: one.default for name, one in NUMBERS.items()}
    return compute_heights(kind, usual | numbers, np.array(x, float), np.array(y, float))


@pytest.mark.parametrize("engine", ["native", pytest.param("mjx", marks=pytest.mark.slow)])
def test_a_ball_rolls_down_a_slope_as_theory_says(here, engine):
    traces, _ = simulate(f"engine={engine}")
    for trace, slope in zip(traces, (-0.2, 0.0, 0.3), strict=True):
        angle = np.arctan(slope)
        above = trace.qpos[0, 2] - slope * 9 - RADIUS / np.cos(angle)
        assert -1e-3 < above < 0.05  # where it starts
        found = (trace.qvel[-1, :3] - trace.qvel[14, :3]) / (PERIOD * 25)
        down, normal = np.array([[-np.cos(angle), 0, -np.sin(angle)], [-np.sin(angle), 0, np.cos(angle)]])
        assert found @ down == pytest.approx(5 / 7 * GRAVITY * np.sin(angle), rel=0.04, abs=1e-3)
        assert abs(found @ normal) < 0.02


def test_heights_at_points_are_those_of_the_generators():
    x = [-2.0, 0.5, 0.6, 0.8, 0.95, 1.1, 1.4, 8.0]
    np.testing.assert_allclose(heights("slope", x, slope=0.5)[0], [0, 0, 0.05, 0.15, 0.225, 0.3, 0.45, 3.75])
    stairs = heights("stairs", x, rise=0.2, run=0.3, steps=3)[0]
    np.testing.assert_allclose(stairs, [0, 0.2, 0.2, 0.4, 0.4, 0.6, 0.6, 0.6])
    np.testing.assert_allclose(heights("gaps", x, gap=0.2, land=0.25, depth=0.7)[0], [0, 0, -0.7, 0, 0, -0.7, 0, 0])
    turned = heights("stairs", [0.0], x, heading=np.pi / 2, rise=0.2, run=0.3, steps=3)[:, 0]
    np.testing.assert_allclose(turned, stairs)
    field = heights("stones", np.arange(-3, 3.01, 0.05), np.arange(-3, 3.01, 0.05), land=0.4, gap=0.2, height=0.1)
    sunk = field == -0.5
    assert 0.3 < sunk.mean() < 0.6
    assert len(np.unique(field[~sunk])) > 50  # each stone has a height of its own
    assert field[~sunk].min() >= 0
    assert field[~sunk].max() < 0.1
    rough = heights("rough", [0.3, 0.4, 0.5], spacing=0.2, height=0.4, seed=2)[0]
    assert rough[1] == pytest.approx(heights("rough", np.arange(-2, 2.01, 0.2), spacing=0.2, height=0.4, seed=2)[0][12])
    assert rough[0] == pytest.approx((heights("rough", [0.2], spacing=0.2, height=0.4, seed=2)[0, 0] + rough[1]) / 2)


def test_an_image_is_a_terrain(here):
    bright = np.linspace(0, 1, 5)[None, :] * np.ones((3, 1))
    bright[0] = 1.0  # the row with the largest y
    plt.imsave("hill.png", bright, cmap="gray", vmin=0, vmax=1)
    axis = "study.axes.one={path: model.terrain.height, values: [0.0, 0.8]}"
    traces, _ = simulate("model.terrain.kind=image", "+model.terrain.file=hill.png", axis)
    field = np.asarray(traces[1].model.hfield_data).reshape(101, 101) * traces[1].model.hfield_size[0, 2]
    np.testing.assert_allclose(field[25], np.linspace(0, 0.8, 101), atol=0.8 / 255)
    np.testing.assert_allclose(field[100], 0.8)
    assert traces[1].qpos[0, 2] - traces[0].qpos[0, 2] == pytest.approx(0.4, abs=0.02)
    Path("hill.png").write_bytes(b"none")
    exp = ["run", "study=one.yaml", "model.terrain.kind=image", "+model.terrain.file=hill.png", axis, "out=bad"]
    assert main(exp) == 2


def test_rows_depend_on_the_seed_and_not_on_what_runs_beside_them(here):
    ground = ["model.terrain={kind: rough, start: 0.5, height: 0.2, resolution: 0.1}", "model.duration=0.2"]
    seeds = "study.axes.one={{path: model.terrain.seed, values: {}}}".format
    (first, *_), found = simulate(*ground, seeds([1, 2, 3]))
    energy = found["energy_gained_j"]
    assert len(set(energy)) == 3
    (alone,), again = simulate(*ground, seeds([2]))
    assert again["energy_gained_j"][0] == energy[1]
    assert not np.array_equal(first.model.hfield_data, alone.model.hfield_data)
    points = [
        compose(["study=one.yaml", *ground, *more])
        for more in (
            [seeds([1, 2])],
            ["+model.terrain.seed=2", "study.axes.one={path: model.terrain.kind, values: [rough, flat]}"],
        )
    ]
    varied, nominal = (select_points_to_simulate(exp)["point_id"] for exp in points)
    assert nominal[0] == varied[1] != varied[0]
    assert nominal[1] not in set(varied)


def test_kinds_are_an_axis_whose_rows_are_replayed(here, capsys):
    ground = ["model.terrain={kind: rough, resolution: 0.1}", "outcome.fell='base_clearance_min_m < 0.09'"]
    axis = "study.axes.one={path: model.terrain.kind, values: [stones, slope]}"
    assert main(["run", "study=one.yaml", *ground, axis, "out=all"]) == 0
    rows = store.read_rows(Path("all"))
    assert rows["base_clearance_min_m"].between(0.095, 0.11).all()
    assert main(["replay", "all", "1"]) == 0
    assert "equal to the last bit" in capsys.readouterr().out
    unused = axis.replace("kind, values: [stones, slope]", "rise, values: [0, 1]")
    assert main(["run", "study=one.yaml", *ground, unused, "--check"]) == 4
    assert "terrain of the kind rough does not use it" in capsys.readouterr().err
    assert main(["report", "all", "--replays", "1"]) == 0
    (replay,) = Path("all/replays").iterdir()
    field = next(one for one in json.loads(replay.read_text())["bodies"]["geoms"] if one["shape"] == "field")
    assert len(field["heights"]) == len(field["x"]) * len(field["y"])
    assert min(field["x"]) == pytest.approx(-1.5, abs=0.2)


def test_a_robot_starts_as_far_above_the_terrain_as_above_the_floor(here):
    walker = MODEL.replace(
        "<freejoint/>", '<freejoint/><geom name="arm" type="capsule" fromto="0 0 0 0.9 0 0.1" size="0.02"/>'
    )
    Path("model.xml").write_text(walker.replace('pos="0 0 0.1"', 'pos="0 0 0.15"'))
    axes = "study.axes.one={path: model.terrain.rise, values: [-0.3, 0.0, 0.3]}"
    stairs = ["model.terrain={kind: stairs, start: 0.6, run: 3, resolution: 0.1}", "model.duration=0.02"]
    traces, _ = simulate(*stairs, axes)
    fallen = 11 * 10 / 2 * 0.002**2 * GRAVITY
    starts = [trace.qpos[-1, 2] + fallen for trace in traces]
    # down: as on the floor; up: the arm, 0.13 m above the floor, clears the stair by the ball's 0.05 m
    np.testing.assert_allclose(starts, [0.15, 0.15, 0.15 + 0.3 - 0.13 + 0.05], atol=1e-3)


@pytest.mark.parametrize(("ground", "line"), [
    ("{kind: hills}", "model.terrain.kind = 'hills' is not allowed: one of flat, slope, stairs"),
    ("{hight: 1}", "model.terrain.hight is unknown: did you mean height?"),
    ("{height: -1}", "model.terrain.height = -1 is not allowed: at least 0"),
    ("{seed: 1.5}", "model.terrain.seed = 1.5 is not allowed: a whole number"),
    ("{resolution: 0.001}", "model.terrain.resolution = 0.001 is not allowed: 10001 x 10001 points"),
    ("{kind: image}", "model.terrain.kind = image needs model.terrain.file, a PNG file"),
    ("{kind: image, file: no.png}", "model.terrain.file = 'no.png' is not a file"),
    ("{kind: stairs, rise: 1, steps: 40}", "model.terrain.kind = stairs is not allowed with heights up to 40 m"),
    ("{geom: ball}", "model.terrain.geom: ball is unknown"),
    ("3", "model.terrain = 3 is not allowed: keys and values"),
])  # fmt: skip
def test_a_terrain_that_cannot_be_is_one_line(here, capsys, ground, line):
    assert main(["run", "study=one.yaml", f"model.terrain={ground}", "out=wrong"]) == 2
    one_line(capsys.readouterr().err, line)


@pytest.mark.parametrize(("model", "axis", "line"), [
    (("0 0 0.1", "0 0 0.1"), "model.terrain.hight", "hight is unknown: did you mean height?"),
    (('type="plane"', 'type="box"'), "model.terrain.height", "the model has no plane as its floor"),
    (('size="5 5 1"', 'size="5 5 1" euler="9 0 0"'), "model.terrain.height", "the plane floor is turned"),
    (("<worldbody>", '<worldbody><geom type="plane" size="1 1 1"/>'), "model.terrain.height", "needs the key geom"),
])  # fmt: skip
def test_a_model_that_has_no_place_for_a_terrain_is_refused(here, capsys, model, axis, line):
    Path("model.xml").write_text(MODEL.replace(*model))
    assert main(["run", "study=one.yaml", f"study.axes.one={{path: {axis}, values: [0, 1]}}", "out=wrong"]) == 2
    one_line(capsys.readouterr().err, line)

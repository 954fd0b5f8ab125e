"""`sweep run --check`: every dead axis is told and no other, with why; a controller that differs is found."""

import re
from pathlib import Path

import pandas as pd
import pytest
from fake_engine import FakeEngine

from sweep.cli.main import main
from sweep.config.experiment import compose
from sweep.systems.hexapod import iterate_case_parameters

SITES, GEOMS, BELIEFS = 400, 300, 300
SHELF = "".join(f'<geom name="g{k}" size="1" contype="0" conaffinity="0"/>' for k in range(GEOMS))
MARKS = "".join(f'<site name="s{k}"/>' for k in range(SITES))
SLIDER = f"""<mujoco><option timestep="0.002"/><worldbody>
<geom name="floor" type="plane" size="0 0 1" friction="0.5"/>{SHELF}{MARKS}
<body name="box" pos="0 0 0.1"><freejoint/><geom name="box" type="box" size=".1 .1 .1" mass="1" friction="0.4"/>
<body name="top" pos="0 0 0.1"><joint name="slide" type="slide" axis="1 0 0"/>
<geom name="top" size="0.02" mass="0.2" priority="1"/></body></body></worldbody>
<actuator><motor name="slide" joint="slide" gear="2"/></actuator></mujoco>"""
SWING = """import jax.numpy as jnp
PARAMETERS = {"reach": 1.0, "unused": 0.0, "held": 0.0}
BELIEVES = {"load": "model.body.box.mass"}
def begin(belief, key):
    return None, {"time": jnp.zeros(())}, None
def policy(belief, seen, state, key):
    held = jnp.clip(9 + belief["held"], 0, 1)  # as an actuator at its limit
    push = held * belief["load"] * belief["reach"] * jnp.sin(40 * state["time"])
    return jnp.array([push]), {"time": state["time"] + 0.02}
"""
HEAD = """system: mujoco
model: {mjcf: slider.xml, controller: "swing:policy", duration: 0.1}
outcome: {far: travelled_m > 9}
study:
  design: {grid: one_at_a_time}
  axes:
"""
LIVE = {
    "a": "path: model.body.box.mass, side: belief, values: [1, 2]",
    "b": "path: model.body.box.mass, side: world, values: [1, 2]",
    "c": "path: controller.reach, values: [1, 2]",
    "d": "path: model.geom.box.friction.slide, values: [0.2, 0.3, 0.45, 0.6, 0.9]",  # from 0.5 on
    "e": "path: model.option.timestep, values: [0.002, 0.001]",
    "f": "path: model.actuator.slide.gear.0, values: [2, 3]",
}


@pytest.fixture
def here(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for name, text in {"slider.xml": SLIDER, "swing.py": SWING, "sweep.yaml": "modules: []"}.items():
        (tmp_path / name).write_text(text)
    return tmp_path


def checked(axes, capsys, *more):
    """Exit code, what is printed, and the lines told by the axis that they are about."""
    Path("study.yaml").write_text(HEAD + "".join(f"    {name}: {{{what}}}\n" for name, what in axes.items()))
    code = main(["run", "study=study.yaml", "--check", "out=none", *more])
    out, err = capsys.readouterr()
    assert not Path("none").exists()
    found = re.findall(r"^sweep: (\S+) changes nothing(?: (on \w+))?( from \S+ to \S+)?: (.*)$", err, re.MULTILINE)
    return code, out, {f"{c} {on}".strip(): (where, why) for c, on, where, why in found}, err


@pytest.mark.slow
def test_of_a_thousand_dead_axes_none_is_unsaid(here, capsys):
    dead = [
        *(f"model.site.s{k}.pos.x" for k in range(SITES)),
        *(f"model.geom.g{k}.friction.slide" for k in range(GEOMS)),
    ]
    told = [f"belief.model.geom.g{k}.friction.roll" for k in range(BELIEFS)]
    live = [
        "belief.model.body.box.mass",
        "world.model.body.box.mass",
        "controller.reach",
        "model.geom.box.friction.slide",
    ]
    levels = {**dict.fromkeys(live, (0.7, 1.4)), **dict.fromkeys([*dead, *told], (0.1, 0.2))}
    pd.DataFrame(levels).to_csv("points.csv", index=False)
    code, out, found, err = checked({"b": LIVE["b"]}, capsys, "--points", "points.csv")
    assert code == 4, err
    assert "4 of 1004 axes have an effect" in out
    assert {c for c, (where, _) in found.items() if not where} == {*dead, *told}
    assert found["model.site.s7.pos.x"][1] == "no sensor is at the site"
    assert found["model.geom.g7.friction.slide"][1] == "geom `g7` collides with nothing"
    assert found["belief.model.geom.g7.friction.roll"][1] == "the controller's BELIEVES does not name it"


@pytest.mark.parametrize(
    ("axis", "why"),
    [
        (
            "path: model.geom.floor.friction.slide, values: [0.1, 0.3]",
            "two geoms counts: geom `box` has 0.4",
        ),
        ("path: model.geom.floor.friction.roll, values: [0.1, 0.3]", "contacts have condim 3, it needs 6"),
        ("path: controller.unused, values: [0, 1]", "it does not enter the simulation"),
        ("path: controller.held, values: [0, 1]", "no figure differs by a bit from 0 to 1"),
        ("path: model.joint.slide.range.low, values: [0, 1]", "the joint has no limits"),
        ("path: model.actuator.slide.ctrlrange.low, values: [0, 1]", "the actuator does not have these limits"),
        ("path: model.option.wind.x, values: [0, 1]", "air has neither density nor viscosity"),
        ("path: model.body.box.pos.x, values: [0, 1]", "the keyframe sets the position of a free body"),
        ("path: noise.delay, side: belief, values: [0, 1]", "sensor errors are part of the world"),
        ("path: model.option.iterations, values: [90, 100]", "no figure differs by a bit from 90 to 100"),
    ],
)
def test_a_dead_axis_is_told_with_why(here, capsys, axis, why):
    code, out, found, _ = checked({"x": axis}, capsys)
    assert (code, len(found)) == (4, 1)
    assert "0 of 1 axes have an effect" in out
    assert why in next(iter(found.values()))[1]


def test_a_part_of_an_axis_may_be_dead(here, capsys):
    code, out, found, _ = checked(LIVE, capsys)
    assert (code, len(found)) == (0, 1)
    assert "6 of 6 axes have an effect" in out
    assert found["model.geom.box.friction.slide"] == (
        " from 0.2 to 0.45",
        "the larger friction of two geoms counts: geom `floor` has 0.5",
    )


def test_what_has_priority_is_told(here, capsys):
    Path("slider.xml").write_text(SLIDER.replace('name="box" type', 'name="box" priority="2" type'))
    axes = {"x": "path: model.geom.floor.friction.slide, values: [0.1, 0.9]", "b": LIVE["b"]}
    code, out, found, _ = checked(axes, capsys)
    assert (code, list(found)) == (4, ["model.geom.floor.friction.slide"])
    assert found["model.geom.floor.friction.slide"][1] == "geom `box` has priority"
    assert "1 of 2 axes have an effect" in out


def test_a_controller_that_is_no_function_of_its_arguments_is_found(here, capsys):
    Path("impure.py").write_text(
        "import random\nimport jax.numpy as jnp\n"  # once for each program
        "def policy(belief, seen, state, key): return jnp.full(1, random.random()), state\n"
    )
    code, _, _, err = checked({"b": LIVE["b"]}, capsys, "model.controller=impure:policy")
    assert code == 4
    assert "two runs of one batch differ (" in err
    assert "the controller is not a function of its arguments" in err


def test_axes_of_the_robot_are_tried_too(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    Path("s.yaml").write_text(
        "scenario: walk_tripod\nmanoeuvre: {steps: 1}\nstudy:\n  design: {grid: one_at_a_time}\n  axes:\n"
        "    a: {path: contact.friction, side: world, values: [0.2, 0.4, 0.8]}\n"
        "    b: {path: manoeuvre.half_step_ratio, side: world, values: [0.1, 0.2]}\n"
        "    c: {path: contact.friction, side: belief, values: [0.2, 0.9]}\n"
        "    d: {path: robot.body_mass, values: [9, 10]}\n"
        "    e: {path: noise.load_noise, side: world, values: [0, 1]}\n"
    )
    assert main(["run", "study=s.yaml", "--check"]) == 4
    out, err = capsys.readouterr()
    assert "2 of 5 axes have an effect" in out
    assert "world.manoeuvre.half_step_ratio changes nothing: plans depend on the belief only" in err
    assert "belief.contact.friction changes nothing: it does not enter the simulation" in err
    assert "world.noise.load_noise changes nothing: " in err


@pytest.mark.slow
def test_axes_are_tried_on_every_engine_of_a_study(here, capsys):
    """What is finer than single precision acts in C MuJoCo alone; 200 dead axes are so on both."""
    dead = [f"model.site.s{k}.pos.x" for k in range(200)]
    levels = {
        **dict.fromkeys(dead, (0.1, 0.2)),
        "model.body.box.mass": (1, 2),
        "model.actuator.slide.gear.0": (2, 2 + 1e-10),
    }
    rows = [
        {"engine.name": engine, **{c: v[k] for c, v in levels.items()}} for engine in ("native", "mjx") for k in (0, 1)
    ]
    pd.DataFrame(rows).to_csv("points.csv", index=False)
    code, out, found, _ = checked({"b": LIVE["b"]}, capsys, "--points", "points.csv")
    assert code == 4
    assert "2 of 203 axes have an effect" in out
    assert {*found} == {*dead, "model.actuator.slide.gear.0 on mjx"}


class Differing(FakeEngine):
    """Of which a contact's stiffness is a part on mjx alone, and a step of native on native."""

    def __init__(self, settings, *rest):
        super().__init__(settings, *rest)
        self.settings = settings

    def find_inactive_parameters(self, sides, ends):
        return super().find_inactive_parameters(sides, ends) - {"contact.stiffness"}

    def run(self, world, belief, streams):
        found, native = super().run(world, belief, streams), self.settings.name == "native"
        more = self.settings.native_time_step if native else world.contact.stiffness
        return found | {"tilt_max_deg": found["tilt_max_deg"] + more}


@pytest.mark.parametrize("fake_engine", [Differing], indirect=True)
def test_what_an_engine_has_no_use_for_is_told_of_the_robot(fake_engine, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    every = [
        (path, value)
        for path, value in iterate_case_parameters(compose(["scenario=walk_tripod"]).case.robot, "robot")
        if value
    ]
    dead = {path: (value, 1.01 * value) for path, value in every if isinstance(value, float)}
    live = {"contact.friction": (0.1, 0.2)}
    half = {"contact.stiffness": (3e4, 4e4), "engine.native_time_step": (1e-3, 5e-4)}
    levels = dead | live | half
    rows = [{"engine.name": name, **{c: v[k] for c, v in levels.items()}} for name in ("native", "mjx") for k in (0, 1)]
    pd.DataFrame(rows).to_csv("points.csv", index=False)
    assert main(["run", "scenario=walk_tripod", "study=walk_map", "--points", "points.csv", "--check"]) == 4
    out, err = capsys.readouterr()
    assert f"2 of {len(dead) + 4} axes have an effect" in out
    told = re.findall(r"^sweep: (\S+) changes nothing(?: on (\w+))?: (.*)$", err, re.MULTILINE)
    assert {(c, on) for c, on, _ in told} == {*((c, "") for c in dead), *zip(half, ("native", "mjx"), strict=True)}
    assert {why for *_, why in told if not why.startswith("no figure")} == {
        "engine native uses it",
        "it does not enter the simulation",
    }


def test_a_check_needs_something_to_try(here, capsys):
    Path("study.yaml").write_text(HEAD + "    a: {path: model.body.box.mass, values: [1]}\n")
    assert main(["run", "study=study.yaml", "--check"]) == 2
    assert "varies nothing" in capsys.readouterr().err
    assert main(["run", "scenario=walk_tripod", "--check"]) == 2
    assert "--check tests the axes of a study: give study=NAME" in capsys.readouterr().err

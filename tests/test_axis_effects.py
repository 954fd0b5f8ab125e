"""Axes that have no effect are named by the dry run, the summary and the statistics."""

from pathlib import Path

import jax
import jax.numpy as jnp
import pytest

from sweep.cli.main import main
from sweep.fused.dependence import find_used_inputs

GRID = ["study=walk_map", "study.axes.friction.num=4", "study.axes.step.num=3", "study.expect=[]"]
TORQUE = "+study.axes.torque={path: drive.torque_limit, side: world, values: [90, 100]}"
CONTROLLER = """import jax.numpy as jnp
PARAMETERS = {"speed": 0.4, "forgotten": 1.0}
def policy(belief, observation, state, key): return belief["speed"] * jnp.ones(1), state
"""
MODEL = """<mujoco><worldbody><body><joint name="z" type="slide" axis="0 0 1"/><geom name="ball" size="0.1"/></body>
</worldbody><actuator><motor joint="z"/></actuator></mujoco>"""
STUDY = """system: mujoco
model: {mjcf: model.xml, controller: "forgets:policy", observe: [qpos], duration: 0.2}
outcome: {goal: duration_s > 0}
study:
  axes:
    speed: {path: controller.speed, values: [0.1, 0.2]}
    forgotten: {path: controller.forgotten, values: [1, 2]}
    load: {path: model.body.1.mass, side: belief, values: [1, 2]}
    late: {path: noise.delay, side: world, values: [0, 1]}
"""


@pytest.mark.parametrize("engine", ["mjx", "native"])
def test_the_dry_run_names_numbers_that_no_program_reads(engine, tmp_path, capsys):
    axes = {
        "mount": "{path: robot.mount_radius, values: [0.5, 0.55]}",
        "coxa": "{path: robot.coxa_mass, side: world, values: [0.1, 0.2]}",
        "slip": "{path: control.slip, values: [0.001, 0.002]}",
        "body": "{path: noise.body_position_noise, values: [0, 0.01]}",
        "mass": "{path: robot.body_mass, side: world, values: [9, 10]}",
        "inertia": "{path: drive.armature, side: world, values: [0.1, 0.2]}",
    }
    run = ["run", *GRID, f"engine={engine}", "engine.width=8", f"out={tmp_path}", "--dry-run"]
    assert main([*run, *(f"+study.axes.{name}={axis}" for name, axis in axes.items())]) == 0
    told = [line for line in capsys.readouterr().out.splitlines() if "changes no metric" in line]
    assert [line.split()[1] for line in told] == ["mount", "coxa", "slip", "body"]
    assert told[1] == "axis coxa changes no metric: world.robot.coxa_mass does not enter the simulation"


def test_the_dry_run_names_numbers_that_a_users_controller_does_not_read(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    Path("model.xml").write_text(MODEL.replace("<body>", '<body name="1">'))
    Path("forgets.py").write_text(CONTROLLER)
    Path("study.yaml").write_text(STUDY)
    assert main(["run", "study=study.yaml", "--dry-run"]) == 0
    told = [line for line in capsys.readouterr().out.splitlines() if "changes no metric" in line]
    assert [line.split()[1] for line in told] == ["forgotten", "load", "late"]


def test_an_axis_that_changes_a_metric_and_no_outcome_has_an_effect(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    Path("model.xml").write_text(MODEL)
    Path("forgets.py").write_text(CONTROLLER)
    Path("study.yaml").write_text("\n".join(line for line in STUDY.splitlines() if "mass" not in line))
    assert main(["run", "study=study.yaml", "out=out"]) == 0
    capsys.readouterr()
    assert main(["stats", "out"]) == 0
    told = [line.strip() for line in capsys.readouterr().out.splitlines() if "changed no metric" in line]
    assert [line.split()[1] for line in told] == ["forgotten", "late"]


@pytest.mark.usefixtures("fake_engine")
def test_summary_and_statistics_of_a_grid_name_an_axis_without_an_effect(tmp_path, capsys):
    assert main(["run", *GRID, TORQUE, f"out={tmp_path}"]) == 0
    line = "axis torque changed no metric in 24 rollouts"
    assert [one.strip() for one in capsys.readouterr().out.splitlines() if "changed no metric" in one] == [line]
    assert main(["stats", str(tmp_path)]) == 0
    told = capsys.readouterr().out
    assert line in told.splitlines()
    margins = told.partition("## Margins")[2].partition("\n## ")[0]
    assert "torque" not in margins
    assert "friction" in margins


@pytest.mark.usefixtures("fake_engine")
def test_the_summary_of_draws_names_an_axis_without_an_effect(tmp_path, capsys):
    axes = [f"+study.axes.{name}={{path: {path}, side: world, distribution: {{kind: uniform, from: 90, to: 100}}}}"
            for name, path in {"torque": "drive.torque_limit", "mass": "robot.body_mass"}.items()]  # fmt: skip
    drawn = "+study.axes.mu={path: contact.friction, side: world, distribution: {kind: uniform, from: 0.1, to: 1}}"
    assert main(["run", "study.name=draws", *axes, drawn, "study.design.num=8", f"out={tmp_path}"]) == 0
    told = [line.strip() for line in capsys.readouterr().out.splitlines() if "changed no metric" in line]
    assert told == [f"axis {name} changed no metric in 8 rollouts: world.{path} does not enter the simulation"
                    for name, path in (("torque", "drive.torque_limit"), ("mass", "robot.body_mass"))]  # fmt: skip


def test_inputs_are_followed_through_loops_branches_and_empty_arrays():
    def program(a, b, c, d, e, f):
        (x, _, _), _ = jax.lax.scan(lambda s, _: ((s[0] + s[1], s[1] * b, s[2] + c), None), (a, a, c), None, length=3)
        y = jax.lax.while_loop(lambda y: y < d, lambda y: y + 1.0, 0.0)
        z = jax.lax.cond(x > 0, lambda p, q: p, lambda p, q: 2 * p, e, f)
        return x + y + z + jnp.sum(f * jnp.zeros((0, 3)))

    assert find_used_inputs(program, *[1.0] * 6) == (True, True, False, True, True, False)

"""What a study of a user's own model is refused for before it starts, in one line that names the cause."""

from pathlib import Path

import pytest
from small_study import one_line, without_progress

from sweep.cli.main import main
from sweep.systems.mujoco_model.engine import print_note_once

HOLD = (
    'FIGURES = {"height_m": "last height"}\n'
    + """import jax.numpy as jnp
def policy(belief, observation, state, key): return 0.05 * jnp.ones(1), state
def measure(sofar, told): return told["qpos"][0]
def figures(belief, state, sofar): return {"height_m": sofar}
"""
)
PLUGIN = """<mujoco><extension><plugin plugin="mujoco.pid"><instance name="p">
<config key="kp" value="4"/><config key="kd" value="0.4"/></instance></plugin></extension>
<worldbody><body><joint name="z" type="slide" axis="0 0 1"/><geom type="sphere" size="0.01"/></body></worldbody>
<actuator><plugin joint="z" plugin="mujoco.pid" instance="p" ctrlrange="0 0.15"/></actuator></mujoco>"""
SLIDE = """<mujoco><option>%s</option><worldbody><geom type="plane" size="1 1 0.1"/>
<body pos="0 0 0.1"><freejoint/><geom type="sphere" size="0.05"/></body>
<body pos="0.5 0 0.1"><joint name="z" type="slide" axis="0 0 1"/><geom type="sphere" size="0.05"/></body></worldbody>
<actuator><motor joint="z"/></actuator></mujoco>"""
GLOBAL = """import numpy as np
last = np.zeros((64, 1))
def policy(seen):
    global last
    last = 0.5 * last + seen[:, :1]
    return last
"""


@pytest.fixture
def study(tmp_path, monkeypatch):
    """Writes a study of two gravities of a model and a controller; the arguments that run it."""
    monkeypatch.chdir(tmp_path)
    print_note_once.cache_clear()  # which prints a line once in a process

    def write(name: str, model: str, controller: str, axis: str) -> list[str]:
        Path("model.xml").write_text(model)
        Path(f"{name}.py").write_text(controller)
        Path("study.yaml").write_text(
            f"system: mujoco\nmodel: {{mjcf: model.xml, controller: '{name}:policy', observe: [qpos, qvel],\n"
            "  duration: 0.2}\n"
            f"outcome: {{goal: duration_s > 0}}\nstudy:\n  axes:\n    x: {{{axis}}}\n"
        )
        return ["run", "study=study.yaml", "study.expect=[]"]

    return write


GRAVITY = "path: model.option.gravity.z, side: world, values: [-9.81, -5]"


def test_a_model_that_mjx_simulates_otherwise_is_refused_with_joint_and_values(study, capsys):
    run = study("held", PLUGIN, HOLD, GRAVITY)
    assert main([*run, "engine=mjx", "out=mjx"]) == 2
    note, compiled, error = without_progress(capsys.readouterr().err).splitlines(keepends=True)
    assert "ignores the model's plugins" in note
    assert "mjx compiles model.xml (1 degrees of freedom, 0 pairs of 1 geoms that may touch)" in compiled
    one_line(error, "engine.name = mjx is not allowed: joint z accelerates by", "on C MuJoCo", "engine.cross_check=off")
    assert main([*run, "engine=mjx", "engine.cross_check=off", "out=off"]) == 0
    assert main([*run, "engine=native", "out=native"]) == 0


def test_a_controllers_own_number_is_no_axis_of_the_world(study, capsys):
    controller = HOLD.replace("import", 'PARAMETERS = {"speed": 0.1}\nimport', 1)
    run = study("fast", SLIDE % "", controller, "path: controller.speed, side: world, values: [0.1, 0.9]")
    assert main([*run, "--dry-run"]) == 2
    one_line(capsys.readouterr().err, "axis world.controller.speed varies nothing: the controller's parameters")


@pytest.mark.parametrize("engine", ["native", "mjx"])
def test_bodies_that_sleep_are_refused_in_a_line(study, capsys, engine):
    run = study("asleep", SLIDE % '<flag sleep="enable"/>', HOLD, GRAVITY)
    assert main([*run, f"engine={engine}"]) == 2
    one_line(capsys.readouterr().err, "model.mjcf = model.xml", "sleep")


def test_a_policy_that_keeps_a_state_in_a_global_is_refused(study, capsys):
    run = study("mixing", SLIDE % "", GLOBAL, GRAVITY)
    assert main([*run, "--dry-run"]) == 2
    one_line(capsys.readouterr().err, "for the same observations", "policy(belief, observation, state, key)")
    stateless = GLOBAL.replace("0.5 * last + ", "")
    assert main([*study("stateless", SLIDE % "", stateless, GRAVITY), "--dry-run"]) == 0


@pytest.mark.parametrize(("model", "engine", "data", "line"), [
    (SLIDE % "", "native", "[cfrc]", "model.data: cfrc is unknown: did you mean cfrc_ext?"),
    (SLIDE % "", "native", "[cfrc_ext]", "model.data: cfrc_ext needs an accelerometer, force or torque sensor"),
    (SLIDE % "", "kernel", "[xpos]", "engine.name = kernel is not allowed: it does not simulate arrays of mjData"),
    (PLUGIN.replace("</mujoco>", '<sensor><framelinacc objtype="body" objname="ball"/></sensor></mujoco>').replace(
        "<body>", '<body name="ball">'), "mjx", "[xpos]", "MJX computes no sensors of forces and accelerations"),
])  # fmt: skip
def test_arrays_and_sensors_that_are_not_computed_are_refused(study, capsys, model, engine, data, line):
    assert main([*study("arrays", model, HOLD, GRAVITY), f"model.data={data}", f"engine={engine}"]) == 2
    one_line(capsys.readouterr().err, line)

"""`sweep export-model`: export the built-in robot as a MuJoCo model, by files of its own, and what it cannot be."""

from pathlib import Path

import jax
import mujoco
import numpy as np
import pytest
from small_study import one_line

from sweep.cli.main import main
from sweep.config.experiment import compose
from sweep.models.scene import compile_native_model
from sweep.runs import store
from sweep.systems.hexapod.exported import make_controller

FIELDS = ("body_mass", "body_inertia", "body_pos", "body_quat", "geom_size", "geom_friction", "geom_pos", "site_pos",
          "dof_armature", "dof_damping", "actuator_biasprm", "actuator_forcerange")  # fmt: skip


@pytest.mark.parametrize("name", ["walk_tripod", "pole_climb"])
def test_what_is_exported_is_the_robot_to_its_last_digit(tmp_path, monkeypatch, name):
    monkeypatch.chdir(tmp_path)
    assert main(["export-model", f"scenario={name}", "robot.body_mass=9.87654321", "out=robot"]) == 0
    exp = compose([f"scenario={name}", "robot.body_mass=9.87654321"])
    own = compile_native_model(exp.case, exp.settings.native_time_step)
    made, read = mujoco.MjModel.from_binary_path("robot/robot.mjb"), mujoco.MjModel.from_xml_path("robot/robot.xml")
    for field in FIELDS:
        np.testing.assert_array_equal(getattr(made, field), getattr(own, field), err_msg=field)
    assert read.body_mass[1] != own.body_mass[1]  # MuJoCo's text has six digits
    np.testing.assert_array_equal(made.actuator_gainprm[:, 0], exp.case.drive.stiffness)
    assert made.opt.timestep == own.opt.timestep


@pytest.mark.parametrize(
    ("asked", "line"),
    [
        (["scenario=ball_balance"], "obstacle.kind = ball is not allowed: the obstacle may move"),
        (
            ["scenario=walk_tripod", "noise.position_noise=0.001"],
            "noise is not allowed: a MuJoCo model has noise settings of its own",
        ),
        (
            ["scenario=walk_tripod", "control.calibrate=sizes"],
            "control is not allowed: an exported controller learns nothing",
        ),
        (["scenario=stand_push"], "execution.push_impulse is not allowed: a controller cannot push the robot"),
        (["study=walk_map"], "study is not allowed: export-model exports a single scenario"),
    ],
)
def test_what_a_controller_of_an_own_model_cannot_do_is_refused(tmp_path, monkeypatch, capsys, asked, line):
    monkeypatch.chdir(tmp_path)
    assert main(["export-model", *asked, "out=robot"]) == 2
    one_line(capsys.readouterr().err, line)
    assert not Path("robot").exists()


def test_its_controller_is_one_program_whose_state_keeps_its_shape():
    exp = compose(["scenario=walk_tripod"])
    made, key = make_controller(exp.case, exp.settings, exp.thresholds), jax.random.PRNGKey(0)
    seen = jax.ShapeDtypeStruct((25 + 24 + 6 + 3 + 3 * 12 + 3 * 6 + 18,), np.float32)  # with the ends of twelve links
    _, state, _ = jax.eval_shape(made.begin, made.parameters, key)
    angles, after = jax.eval_shape(made.policy, made.parameters, seen, state, key)
    assert angles.shape == (18,)
    assert jax.tree.map(np.shape, after) == jax.tree.map(np.shape, state)
    assert set(jax.eval_shape(made.figures, made.parameters, after)) == set(made.measured)


@pytest.mark.slow
def test_its_outcomes_are_those_of_the_robots_own_engine(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    steps, frictions = [0.05, 0.12, 0.19], [0.1, 0.3, 0.8]
    axes = "+study.axes={{f: {{path: {}, {}values: {}}}, s: {{path: {}manoeuvre.half_step_ratio, values: {}}}}}"
    own = axes.format("contact.friction", "side: world, ", frictions, "", steps)
    Path("own.yaml").write_text("scenario: walk_tripod\nstudy: {name: own}\n")
    assert main(["run", "study=own.yaml", own, "engine=native", "out=own"]) == 0
    assert main(["export-model", "scenario=walk_tripod", "out=robot"]) == 0
    monkeypatch.chdir("robot")
    Path("study.yaml").write_text("scenario: own\nstudy: {name: door}\n")
    door = axes.format("model.geom.ground_contact.friction.slide", "", frictions, "controller.", steps)
    assert main(["run", "study=study.yaml", door, "out=door"]) == 0
    a, b = store.read_rows(Path("../own")), store.read_rows(Path("door"))
    a, b = a.sort_values(list(a.columns[:2])), b.sort_values(list(b.columns[:2]))
    assert set(a["outcome"]) == {"success", "failure"}
    assert list(a["outcome"]) == list(b["outcome"])
    apart = np.abs(a["distance_m"].to_numpy() - b["distance_m"].to_numpy())
    assert np.median(apart) < 1e-4
    assert apart.max() < 0.01  # which the farthest of 10,000 stayed within

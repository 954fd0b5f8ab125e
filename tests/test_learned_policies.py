"""Learned policies from a network's file and a specification: equal to a plain loop of MuJoCo, and mistakes."""

import re
from dataclasses import replace
from pathlib import Path

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import onnxruntime
import pandas as pd
import pytest
import yaml
from onnx import helper
from onnx.reference import ReferenceEvaluator
from robots import HOME, save_lstm, save_perceptron, save_trot, write_project
from small_study import one_line
from test_onnx_networks import save_graph

from sweep.analysis import first_differences
from sweep.cli.commands import policy as policy_command
from sweep.cli.main import main
from sweep.config.experiment import compose
from sweep.core.errors import InputError
from sweep.report import comparison
from sweep.runs import batches, store, time_series
from sweep.runs.runner import select_points_to_simulate
from sweep.systems.mujoco_model import batch, policy, policy_spec
from sweep.systems.mujoco_model.policy import ControllerBatch

PAGE = Path(__file__).parents[1] / "docs/howto/run_a_learned_policy.md"
GRAVITY = np.array([0.0, 0.0, -1.0])
JOYSTICK = """preset: playground
observation: [base_linear_velocity, base_angular_velocity, projected_gravity, joint_positions, joint_velocities,
              last_action, command]
commands: {velocity_x: 0.5, velocity_y: 0.0, yaw_rate: 0.1}
"""
GAIT = """
observation:
  - {term: base_angular_velocity, scale: 0.25}
  - projected_gravity
  - {term: command, scale: [2.0, 2.0, 0.25]}
  - {term: joint_positions, history: 3}
  - {term: joint_velocities, scale: 0.05, clip: [-20, 20]}
  - last_action
  - {term: phase, frequency: 2.0, offsets: [0.0, 3.14159]}
commands: {velocity_x: 0.5, velocity_y: 0.0, yaw_rate: 0.1}
action: {scale: {"*_roll": 0.1, "*": 0.3}, clip: [-0.8, 0.8]}
"""
LSTM = """
period: 0.02
joints: [lf_roll, rf_roll, lh_roll, rh_roll, lf_hip, rf_hip, lh_hip, rh_hip, lf_knee, rf_knee, lh_knee, rh_knee]
observation: {obs: [base_linear_velocity, projected_gravity, joint_positions, joint_velocities, last_action]}
recurrent: [{input: h_in, output: h_out}, {input: c_in, output: c_out, start: 0.1}]
action: {scale: 0.25, stiffness: 120, damping: {"*": 2.0}, torque_limit: 30}
"""


class PlainLoop:
    """What a user would write: MuJoCo's steps, with observations and actions of a tick by hand."""

    def __init__(self):
        self.model = mujoco.MjModel.from_xml_path("robot.xml")
        self.data = mujoco.MjData(self.model)
        mujoco.mj_resetDataKeyframe(self.model, self.data, 0)
        self.tick, self.action, self.past = 0, np.zeros(self.model.nu), None

    def turned(self, vector):
        into = np.zeros(9)
        mujoco.mju_quat2Mat(into, self.data.qpos[3:7])
        return into.reshape(3, 3).T @ vector

    def joystick(self, network):
        mujoco.mj_forward(self.model, self.data)
        linear, gyro = (self.data.sensor(name).data for name in ("local_linvel", "gyro"))
        seen = [linear, gyro, self.turned(GRAVITY), self.data.qpos[7:] - HOME, self.data.qvel[6:], self.action]
        (self.action,) = network.run(None, {"obs": np.concatenate([*seen, [0.5, 0.0, 0.1]])[None]})[0]
        self.data.ctrl = HOME + 0.5 * self.action
        mujoco.mj_step(self.model, self.data, 10)

    def gait(self, network):
        joints = self.data.qpos[7:] - HOME
        self.past = np.tile(joints, (3, 1)) if self.past is None else np.vstack([self.past[1:], joints])
        angles = 2 * np.pi * 2.0 * 0.02 * self.tick + np.array([0.0, 3.14159])
        seen = [0.25 * self.data.qvel[3:6], self.turned(GRAVITY), [1.0, 0.0, 0.025], self.past.ravel(),
                0.05 * np.clip(self.data.qvel[6:], -20, 20), self.action, np.cos(angles), np.sin(angles)]  # fmt: skip
        (action,) = network.run(None, {"obs": np.concatenate(seen)[None]})[0]
        self.action = np.clip(action, -0.8, 0.8)
        self.data.ctrl = HOME + np.tile([0.1, 0.3, 0.3], 4) * self.action
        mujoco.mj_step(self.model, self.data, 10)
        self.tick += 1

    def lstm(self, network):
        order = np.arange(self.model.nu).reshape(-1, 3).T.ravel()  # rolls, hips, knees
        joints, rates = 7 + order, 6 + order
        self.past = self.past or [np.zeros((1, 1, 16)), np.full((1, 1, 16), 0.1)]
        seen = [self.turned(self.data.qvel[:3]), self.turned(GRAVITY), self.data.qpos[joints] - HOME[order],
                self.data.qvel[rates], self.action]  # fmt: skip
        given = {"obs": np.concatenate(seen)[None], "h_in": self.past[0], "c_in": self.past[1]}
        action, *self.past = network.run(None, given)
        self.action = action[0]
        target = HOME[order] + 0.25 * self.action
        for _ in range(10):
            torque = 120 * (target - self.data.qpos[joints]) - 2.0 * self.data.qvel[rates]
            self.data.ctrl[order] = np.clip(torque, -30, 30)
            mujoco.mj_step(self.model, self.data)


def make_engine(engine, precision="float64"):
    """The engine of the nominal rollout and its batch."""
    exp = compose(["study=one", f"engine={engine}", f"engine.precision={precision}"])
    rows = select_points_to_simulate(exp)
    rows = batches.assign_batches(exp, pd.DataFrame(), rows).assign(width=1)
    task = batches.make_batch(exp, rows)
    return exp.system.make_engine(replace(task.settings, cross_check=False), task.world, task.belief, None), task


@pytest.fixture
def here(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.mark.parametrize(
    "engine", ["native", *(pytest.param(one, marks=pytest.mark.slow) for one in ("mjx", "kernel"))]
)
@pytest.mark.parametrize("shape", ["joystick", "gait", "lstm"])
def test_a_policy_runs_from_its_files_as_in_a_plain_loop(here, shape, engine):
    compare_with_plain_loop(here, shape, engine)


@pytest.mark.slow
@pytest.mark.parametrize("engine", ["mjx", "kernel"])
@pytest.mark.parametrize("shape", ["joystick", "gait", "lstm"])
def test_single_precision_stays_within_5_mm_of_a_plain_loop(here, shape, engine):
    compare_with_plain_loop(here, shape, engine, precision="float32", atol=5e-3)


@pytest.mark.slow
def test_a_recurrent_policy_runs_on_mjx_as_in_a_plain_loop(here):
    """A robot of one leg, in the air."""
    made = compare_with_plain_loop(here, "lstm", "mjx", legs=1)
    assert made._ticks._cache_size() == 1  # 50 calls compile the program once


def save_shape(shape, legs=4):
    """Save a network of the shape as walk.onnx."""
    if shape == "lstm":
        save_lstm("walk.onnx", 6 + 9 * legs, 16, 3 * legs)
    elif shape == "gait":
        save_perceptron("walk.onnx", (73, 64, 12), 0.5)
    else:
        save_trot("walk.onnx")


def compare_with_plain_loop(folder, shape, engine, legs=4, precision="float64", atol=1e-5):
    specification = {"joystick": JOYSTICK, "gait": GAIT, "lstm": LSTM}[shape]
    if legs == 1:
        specification = re.sub(r"joints: .*", "joints: [lf_roll, lf_hip, lf_knee]", specification)
    write_project(folder, specification, motors=shape == "lstm", legs=legs)
    save_shape(shape, legs)
    if shape == "lstm":
        network = ReferenceEvaluator("walk.onnx")
    else:
        network = onnxruntime.InferenceSession("walk.onnx", providers=["CPUExecutionProvider"])
    plain, places = PlainLoop(), []
    for _ in range(50):
        getattr(plain, shape)(network)
        places.append(plain.data.qpos.copy())
    assert np.abs(np.diff(places, axis=0)[:, 7:]).max() > 0.02  # it moves
    made, task = make_engine(engine, precision)
    simulated = made.trace(task.world, task.belief, task.streams, 0).qpos
    np.testing.assert_allclose(simulated, places, atol=atol, rtol=0)
    return made


STILL = "observation: [{term: constant, values: [1.0]}]\ncommands: {velocity_x: 0.0}\n"


def test_one_process_runs_the_same_network_in_either_precision(here):
    write_project(here, JOYSTICK)
    nodes = [helper.make_node("Mul", ["obs", "scale"], ["x"]), helper.make_node("MatMul", ["x", "w"], ["action"])]
    weights = {"scale": np.full(48, 0.1), "w": np.full((48, 12), 0.01)}
    save_graph(Path("walk.onnx"), nodes, {"obs": [1, 48]}, {"action": [1, 12]}, weights)
    for precision in ("float32", "float64"):
        words = ["model.duration=0.1", "study.replicates=2", "study.replays=0", "study.expect=[]"]
        assert main(["run", "study=one", f"engine.precision={precision}", *words, f"out={precision}"]) == 0


def drawn(action, weight, *words):
    """Actions (rollouts, ticks, joints) of a network that gives `weight` whatever it observes."""
    write_project(Path(), f"{STILL}action: {action}", legs=1)
    save_perceptron("walk.onnx", (1, len(weight)), weight=np.array(weight)[:, None])
    exp = compose(["study=one", "engine.precision=float64", "study.replicates=6", *words])
    rows = batches.assign_batches(exp, pd.DataFrame(), select_points_to_simulate(exp)).assign(width=6)
    task = batches.make_batch(exp, rows)
    made = exp.system.make_engine(task.settings, task.world, task.belief, None)
    traces = made.traces(task.world, task.belief, task.streams, 1)
    return np.stack([np.stack([one.columns[f"action_lf_{part}"] for part in ("roll", "hip", "knee")], axis=1)
                     for one in traces])  # fmt: skip


def test_a_stochastic_policy_draws_by_the_seed_or_runs_its_mean(here):
    mean = np.tanh([0.1, 0.2, 0.3])
    np.testing.assert_allclose(drawn("{scale: 0.01}", [0.1, 0.2, 0.3]), np.tile(mean, (6, 50, 1)), atol=1e-6)
    sampled = "{scale: 0.01, sample: true, deviation: {'*_knee': 0.0, '*': 0.5}}"
    found = drawn(sampled, [0.1, 0.2, 0.3])
    np.testing.assert_array_equal(found, drawn(sampled, [0.1, 0.2, 0.3]))
    np.testing.assert_allclose(found[..., 2], mean[2], atol=1e-6)
    np.testing.assert_allclose(found[..., :2].reshape(-1, 2).mean(axis=0), mean[:2], atol=0.1)
    np.testing.assert_allclose(found[..., :2].reshape(-1, 2).std(axis=0), 0.5, rtol=0.15)
    assert len(np.unique(found[:, 0, 0])) == 6


def test_a_discrete_policy_takes_the_likeliest_choice_or_draws_one(here):
    choices, weight = [[1, 0, 0], [0, 1, 0]], [-0.5, 0.5]
    best = drawn(f"{{scale: 0.01, choices: {choices}}}", weight)
    np.testing.assert_array_equal(best, np.tile([0.0, 1.0, 0.0], (6, 50, 1)))
    found = drawn(f"{{scale: 0.01, sample: true, choices: {choices}}}", weight)
    odds = np.exp(np.tanh(weight)) / np.exp(np.tanh(weight)).sum()
    np.testing.assert_allclose(found.reshape(-1, 3).mean(axis=0), [*odds, 0.0], atol=0.1)


def test_what_the_policy_saw_is_kept_and_the_first_difference_is_named(here, capsys, monkeypatch):
    write_project(here, JOYSTICK, more=", period: 0.02")
    save_perceptron("walk.onnx", (48, 12), 0.5)
    asked = ["run", "study=one", "model.duration=0.2", "study.keep=[observation,action]", "study.keep_rate=50"]
    assert main([*asked, "out=a"]) == 0
    assert main([*asked, "+start.joint.lf_knee.velocity=0.001", "out=b"]) == 0
    a, b = (time_series.read_histories(Path(name)) for name in "ab")
    assert [name for name in a if name.startswith("observation_command")] == [
        f"observation_command_{one}" for one in ("velocity_x", "velocity_y", "yaw_rate")]  # fmt: skip
    assert (a["observation_command_yaw_rate"] == np.float32(0.1)).all()
    np.testing.assert_array_equal(a["observation_last_action_lf_hip"][1:], a["action_lf_hip"][:-1])
    network = onnxruntime.InferenceSession("walk.onnx", providers=["CPUExecutionProvider"])
    seen = a[[name for name in a if name.startswith("observation_")]].to_numpy(float)
    (action,) = network.run(None, {"obs": seen})
    np.testing.assert_allclose(a[[name for name in a if name.startswith("action_")]], action, atol=1e-6)
    capsys.readouterr()
    assert main(["compare", "a", "a"]) == 0
    assert "Over time: no sample of 1 rollouts differs" in capsys.readouterr().out
    assert main(["compare", "a", "b", "--by", "load", "--histories", "1e-5"]) == 0
    b = b.assign(point_id=a["point_id"])
    found = first_differences.find_time_series_differences(a, b, [*a.columns[-60:]], 1e-9)
    assert found["time_s"][0] == pytest.approx(0.02)  # the first observation is that of the start
    assert found["column"][0] == "observation_joint_velocities_lf_knee"
    tables = {"a": a, "b": a.assign(action_lf_hip=a["action_lf_hip"].where(a["time_s"] < 0.05, 7.0))}
    monkeypatch.setattr(time_series, "read_histories", lambda folder: tables[folder.name])
    line = comparison.first_difference_text(Path("a"), Path("b"), 1e-3)
    assert "1 of 1 rollouts differ" in line
    assert "first in tick 3 (0.06 s) in action_lf_hip: " in line


def test_what_exporters_write_into_the_network_counts_unless_the_file_says_otherwise(here):
    names = [f"{leg}_{part}" for part in ("roll", "hip", "knee") for leg in ("lf", "rf", "lh", "rh")]
    terms = "base_lin_vel", "base_ang_vel", "projected_gravity", "joint_pos", "joint_vel", "actions", "command"
    told = {
        "joint_names": ",".join(names),
        "default_joint_pos": ",".join(["0.000"] * 4 + ["0.795"] * 4 + ["-1.590"] * 4),
        "joint_stiffness": ",".join(["90.0"] * 12),
        "joint_damping": "1.5",
        "action_scale": "0.125",
        "observation_names": ",".join(terms),
    }
    write_project(here, "preset: mjlab\naction: {damping: 2.5}\n", motors=True)
    save_perceptron("walk.onnx", (48, 12), **told)
    learned = compose(["study=one"]).system.controller.fitted_policy
    assert learned.joints == tuple(names)
    assert [one.spec.term for one in learned.inputs["obs"]][-2:] == ["last_action", "command"]
    np.testing.assert_array_equal(learned.scale, 0.125)
    np.testing.assert_array_equal(learned.offset, [0.0] * 4 + [0.795] * 4 + [-1.59] * 4)
    assert set(learned.joint_control.stiffness) == {90.0}
    assert set(learned.joint_control.damping) == {2.5}
    lengths = {"observation_history_lengths": "1,1,0,3,1,1,1"}  # 24 numbers more
    save_perceptron("walk.onnx", (72, 12), **told, **lengths)
    learned = compose(["study=one"]).system.controller.fitted_policy
    assert [one.history for one in learned.inputs["obs"]] == [1, 1, 1, 3, 1, 1, 1]
    save_perceptron("walk.onnx", (48, 12), **{**told, "observation_names": "base_lin_vel,foot_clock"})
    with pytest.raises(InputError, match=r"observation\[1\]: foot_clock is unknown"):
        compose(["study=one"])


def test_the_presets_of_playground_observe_action_and_phase_a_tick_late(here):
    write_project(here, "preset: playground_gait\ncommands: {velocity_x: 0.5}\n", more=", period: 0.02", legs=1)
    save_perceptron("walk.onnx", (23, 3), 0.1)
    made, task = make_engine("native")
    told = made.trace(task.world, task.belief, task.streams, 0).columns
    for name in ("lf_roll", "lf_hip", "lf_knee"):
        late = told[f"observation_last_action_{name}"]
        np.testing.assert_array_equal(late[:2], 0.0)
        np.testing.assert_array_equal(late[2:], told[f"action_{name}"][:-2])
    ticks = np.maximum(np.arange(len(late)) - 1, 0)
    np.testing.assert_allclose(told["observation_phase_2"], np.sin(2 * np.pi * 1.5 * 0.02 * ticks), atol=1e-9)


def test_the_tiles_of_a_gpu_have_the_controls_of_other_tiles_whatever_is_beside_a_rollout(here, monkeypatch):
    """On a CPU here: rollouts of a tile are computed together, and three of seven have the bits of three alone."""
    monkeypatch.setattr(policy, "GPU_TILE_ROLLOUTS", 4)
    write_project(here, "preset: isaaclab\ncommands: {velocity_x: 0.5, velocity_y: 0, yaw_rate: 0}\n", legs=1)
    save_perceptron("walk.onnx", (21, 16, 3), 0.3)
    made, task = make_engine("native")
    seen = np.random.default_rng(0).normal(size=(7, made._spec.state_size))
    inputs = {"delay": np.zeros(7, np.int32), "key": np.arange(14, dtype=np.uint32).reshape(7, 2)}

    def simulate(chosen, on_gpu):
        n = len(seen[chosen])
        begun = batch.make_initial_batch(made._spec, task.settings, task.world, task.belief, np.zeros(7, np.int64))
        given = jax.tree.map(lambda one: one[chosen], begun.policy_inputs | inputs)
        rollouts = ControllerBatch(made._programs, given, n, on_gpu)
        rollouts.begin_rollouts(seen[chosen], np.full(n, 3))
        controls = [np.asarray(rollouts.next_controls(jnp.asarray(seen[chosen]))) for _ in range(3)]
        return np.stack(controls), rollouts.read_observations_and_actions([n - 1, 0])

    with made._within():
        (rows, told), (tiles, told_by_tiles), (alone, _) = (
            simulate(slice(None), False), simulate(slice(None), True), simulate(slice(4, None), True)
        )  # fmt: skip
    np.testing.assert_allclose(tiles, rows, atol=1e-12)
    np.testing.assert_allclose(told_by_tiles, told, atol=1e-12)
    np.testing.assert_array_equal(tiles[:, 4:], alone)


def test_a_term_is_read_from_the_first_of_its_sensors_that_the_model_has(here):
    for name in ("local_linvel_pelvis", "local_linvel"):
        write_project(here, "preset: playground_gait\n")
        robot = Path("robot.xml").read_text()
        Path("robot.xml").write_text(robot.replace('name="local_linvel"', f'name="{name}"'))
        save_perceptron("walk.onnx", (52, 12))
        terms = compose(["study=one"]).system.controller.fitted_policy.inputs["obs"]
        assert [one.spec.sensor for one in terms[:2]] == [name, "gyro"]


@pytest.mark.parametrize(("policy", "line"), [
    ("preset: playgroud", "preset = playgroud is unknown: did you mean playground?"),
    ("observation: [joint_positions]", "walk.onnx takes 48 numbers as obs: its terms have 12 (joint_positions 12)"),
    ("observation: [joint_position]", "observation[0]: joint_position is unknown: did you mean joint_positions?"),
    ("observation: [{term: sensor, sensor: spn}]", "sensor spn is unknown: did you mean spin?"),
    ("observation: [{term: joint_positions, skale: 2}]", "observation[0]: skale is unknown: did you mean scale?"),
    ("observation: [last_action, last_action]", "last_action stands twice: give each a name of its own (key name)"),
    ("observation: {seen: [last_action]}", "observation.seen is unknown (allowed: obs)"),
    ("observation: [command]", "command needs the key commands"),
    ("preset: isaaclab\njoints: [lf_rol]", "joint lf_rol is unknown: did you mean lf_roll?"),
    ("preset: isaaclab\ndefault_pose: {'*_toe': 1}", "default_pose: *_toe fits no joint"),
    ("preset: isaaclab\ndefault_pose: {'*_hip': 1}", "default_pose has no number for joint lf_roll"),
    ("preset: isaaclab\naction: {scale: [1, 2]}", "action.scale = [1, 2] is not allowed: a number, 12 numbers"),
    ("preset: isaaclab\naction: {actuation: pd, stiffness: 1}", "joint lf_roll has an actuator of its own law"),
    ("preset: isaaclab\naction: {clip: [1, -1]}", "action.clip = [1.0, -1.0] is not allowed"),
    ("preset: isaaclab\naction: {sample: true}", "action.sample = true needs action.deviation"),
    ("preset: isaaclab\naction: {choices: [[1, 2]]}", "action.choices = [[1, 2]] is not allowed: a list of"),
    ("preset: isaaclab\nrecurrent: [{input: h, output: h}]", "recurrent input h is unknown (allowed: obs)"),
    ("preset: isaaclab\nhistory: 0", "history = 0 is not allowed: a whole number from 1 on"),
    ("preset: isaaclab\nhistory: 2", "walk.onnx takes 48 numbers as obs: its terms have 96"),
    ("preset: isaaclab\nperiod: 0.05", "model.period = 0.02 is not allowed for walk.onnx: its policy.yaml says 0.05 s"),
    ("preset: [isaaclab", "walk.policy.yaml cannot be read: line"),
])  # fmt: skip
def test_a_mistake_in_a_specification_is_one_line(here, capsys, policy, line):
    write_project(here, policy, more=", period: 0.02")
    save_perceptron("walk.onnx", (48, 12))
    assert main(["run", "study=one", "out=wrong"]) == 2
    one_line(capsys.readouterr().err, line)
    assert not Path("wrong").exists()


def test_the_first_tick_is_printed_term_by_term(here, capsys):
    write_project(here, GAIT)
    save_perceptron("walk.onnx", (73, 64, 12), 0.5)
    assert main(["policy", "check", "own", "controller.velocity_x=0.25"]) == 0
    lines = [" ".join(line.split()) for line in capsys.readouterr().out.splitlines()]
    assert "| command | x 2 0.25 | 0.5 0 0.025 |" in lines
    assert "| base_angular_velocity | rad/s x 0.25 | 0 0 0 |" in lines
    assert "| projected_gravity | | 0 0 -1 |" in lines
    network = onnxruntime.InferenceSession("walk.onnx", providers=["CPUExecutionProvider"])
    seen = np.concatenate([np.zeros(5), [-1, 0.5, 0, 0.025], np.zeros(60), [1, np.cos(3.14159), 0, np.sin(3.14159)]])
    (action,) = network.run(None, {"obs": seen[None]})[0]
    assert f"| lf_hip | {action[1]:.4g} | {0.795 + 0.3 * action[1]:.4g} | rad |" in lines
    rows = policy_command.split_term_into_rows("heights", "m", np.arange(14.0))
    assert rows == [("heights[0:12]", "m", "0 1 2 3 4 5 6 7 8 9 10 11"), ("heights[12:14]", "m", "12 13")]


def test_the_page_as_it_stands(here, monkeypatch):
    write_project(here, JOYSTICK)
    save_perceptron("walk.onnx", (48, 12), 0.1)
    Path("walk.policy.yaml").unlink()
    text = PAGE.read_text()
    init, check, run, report = (line.split()[1:] for line in re.findall(r"^    (sweep .*)$", text, re.MULTILINE))
    assert main(init) == 0
    monkeypatch.chdir("walk")
    assert main(check) == 0
    assert main([*run, "model.duration=0.1"]) == 0
    assert main(report) == 0
    rows = store.read_rows(Path("results/push_delay"))
    assert len(rows) == 6 * 5
    assert set(rows["world.noise.action_delay"]) == {0, 5, 10, 15, 20}
    (sample,) = re.findall(r"(?:^    (?!sweep).*\n)+", text, re.MULTILINE)
    spec = policy_spec.parse_policy("walk.policy.yaml", yaml.safe_load(sample), {})
    assert len(policy_spec.parse_terms("", spec.observation)) == 6


def test_a_project_has_the_folders_of_its_model_and_judges_as_its_solver_allows(here, monkeypatch):
    write_project(here, JOYSTICK)
    save_perceptron("walk.onnx", (48, 12), 0.1)
    for folder in ("scenes", "robots"):
        Path(folder).mkdir()
    Path("robot.xml").rename("robots/robot.xml")
    Path("scenes/flat.xml").write_text('<mujoco><include file="../robots/robot.xml"/><option iterations="1"/>'
                                        '<keyframe><key name="low"/></keyframe></mujoco>')  # fmt: skip
    assert main(["init", "--policy", "walk.onnx", "--mjcf", "scenes/flat.xml"]) == 0
    monkeypatch.chdir("walk")
    scenario = Path("scenarios/own.yaml").read_text()
    assert "unsolved_share >" not in scenario
    assert "  invalid: energy_gained_j > 1.32 + 0.05 * energy_j\n" in scenario
    assert "keyframe: home  # or low\n" in scenario
    system = compose(["study=push_delay"]).system
    assert (system.config.mjcf, system.model.opt.iterations) == ("scenes/flat.xml", 1)


@pytest.mark.parametrize(("words", "line"), [
    (["--policy", "walk.onnx"], "--policy and --mjcf need each other"),
    (["--policy", "robot.xml", "--mjcf", "robot.xml"], "--policy robot.xml is not allowed: a network in a file .onnx"),
    (["--policy", "run.onnx", "--mjcf", "robot.xml"], "--policy run.onnx is not a file"),
    (["--policy", "walk.onnx", "--mjcf", "robot.xml", "--preset", "isaacgym"], "--preset isaacgym is unknown"),
])  # fmt: skip
def test_a_project_that_cannot_be_made_is_one_line(here, capsys, words, line):
    write_project(here, JOYSTICK)
    save_perceptron("walk.onnx", (48, 12))
    assert main(["init", *words, "made"]) == 2
    one_line(capsys.readouterr().err, line)
    assert not Path("made").exists()


STEPS = """schedule:
  velocity_x: [[0, 0.0], [0.2, 0.0], [0.2, 1.0]]
  yaw_rate: {points: [[0.1, 0.0], [0.5, 0.4]], factor: 2}
"""


def test_commands_follow_their_schedule_and_their_errors_are_metrics(here):
    """The network gives the commands themselves as actions, and the robot stands still in the air."""
    write_project(here, "observation: [command]\ncommands: {velocity_x: 9.0, velocity_y: 0.3, yaw_rate: 9.0}\n"
                  "action: {scale: 1.0, offset: 0.0}\n", more="", legs=1)  # fmt: skip
    robot = Path("robot.xml").read_text()
    Path("robot.xml").write_text(robot.replace("<option", '<option gravity="0 0 0"', 1))
    save_perceptron("walk.onnx", (3, 3), weight=np.eye(3) * 0.01)
    Path("scenarios/own.yaml").write_text(Path("scenarios/own.yaml").read_text() + STEPS)
    made, task = make_engine("native")
    commands = np.arctanh(made.trace(task.world, task.belief, task.streams, 0).joint_target) / 0.01
    time = 0.02 * np.arange(50)
    ahead, turn = np.where(time > 0.19, 1.0, 0.0), 2 * np.interp(time, [0.1, 0.5], [0.0, 0.4])
    np.testing.assert_allclose(commands, np.stack([ahead, np.full(50, 0.3), turn], axis=1), atol=1e-6)
    found = made.run(task.world, task.belief, task.streams)
    np.testing.assert_allclose(found["velocity_error_rms_mps"], np.sqrt(np.mean(ahead**2 + 0.09)), rtol=0.05)
    np.testing.assert_allclose(found["yaw_rate_error_rms_radps"], np.sqrt(np.mean(turn**2)), rtol=0.05)
    Path("steps.csv").write_text("time, velocity_x\n0, 0\n0.2, 0\n0.2, 1\n")
    text = (
        Path("scenarios/own.yaml")
        .read_text()
        .replace("velocity_x: [[0, 0.0], [0.2, 0.0], [0.2, 1.0]]", "file: steps.csv")
    )
    Path("scenarios/own.yaml").write_text(text)
    made, task = make_engine("native")
    again = made.run(task.world, task.belief, task.streams)
    np.testing.assert_array_equal(again["velocity_error_rms_mps"], found["velocity_error_rms_mps"])


def test_an_unknown_path_is_one_line_with_the_nearest_few_of_many(here, capsys):
    write_project(here, JOYSTICK)
    save_perceptron("walk.onnx", (48, 12))
    assert main(["run", "study=one", "+noise.joint_position.white=0.1", "out=wrong"]) == 2
    one_line(
        capsys.readouterr().err, "did you mean noise.joint_positions.white? (nearest: noise.joint_positions.white, "
    )


@pytest.mark.parametrize(("schedule", "line"), [
    ("{velocity_z: [[0, 1]]}", "schedule.velocity_z is unknown"),
    ("{velocity_x: [0, 1]}", "schedule.velocity_x = [0, 1] is not allowed: a list of times (s) and values"),
    ("{velocity_x: [[1, 0], [0, 1]]}", "schedule.velocity_x is not allowed: its times begin at 0 or later"),
    ("{file: none.csv}", "schedule.file = none.csv is not a file"),
])  # fmt: skip
def test_a_mistake_in_a_schedule_is_one_line(here, capsys, schedule, line):
    write_project(here, JOYSTICK)
    save_perceptron("walk.onnx", (48, 12))
    scenario = Path("scenarios/own.yaml")
    scenario.write_text(scenario.read_text() + f"schedule: {schedule}\n")
    assert main(["run", "study=one", "out=wrong"]) == 2
    one_line(capsys.readouterr().err, line)

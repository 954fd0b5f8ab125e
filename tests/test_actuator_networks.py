"""Learned actuator networks against a plain loop of MuJoCo with ONNX's own evaluator."""

from pathlib import Path

import mujoco
import numpy as np
import pytest
from onnx import helper
from onnx.reference import ReferenceEvaluator
from own_rollouts import prepare_batch, write_texts
from robots import save_lstm, save_network
from small_study import one_line

from sweep.cli.main import main

MODEL = """<mujoco><option timestep="0.002" gravity="0 0 0" integrator="Euler"/>
<default><joint damping="0.1" axis="0 1 0"/><geom size="0.02" mass="0.3" contype="0" conaffinity="0"/></default>
<worldbody>
  <body><joint name="hip"/><geom pos="0 0 -0.2"/>
    <body pos="0 0 -0.2"><joint name="knee"/><geom pos="0 0 -0.2"/></body></body>
  <body pos="1 0 0"><joint name="free" type="slide" axis="1 0 0"/><geom/></body>
</worldbody>
<actuator><motor joint="knee" gear="2"/><motor joint="free"/><position joint="hip" kp="3" kv="0.1"/></actuator>
</mujoco>"""
TARGETS = """import jax.numpy as jnp
def begin(belief, key): return None, jnp.zeros(()), None
def policy(belief, seen, state, key):
    return jnp.stack([jnp.sin(9 * state), 0.5 + 0 * state, 0.7 * jnp.cos(5 * state)]), state + 0.02
"""
STUDY = """system: mujoco
model: {mjcf: model.xml, controller: "targets:policy", duration: 0.5}
motor: {legs: %s}
outcome: {fast: energy_j > 1e9}
study: {axes: {size: {path: motor.legs.strength, values: [1.0, 0.5]}}}
"""
LEGS = "{joints: '{hip,knee}', network: net.onnx, history: 3, spacing: 2, position_scale: 2.0, velocity_scale: 0.1, "
LEGS = LEGS.replace("'{hip,knee}'", "'[hk]*'") + "torque_scale: 5, order: velocities}"
RECURRENT = "{joints: '[hk]*', network: net.onnx, torque_scale: 5, recurrent: {h_in: h_out, c_in: c_out}}"


def save_layers_of(inputs):
    """Save a network of one hidden layer."""
    rng = np.random.default_rng(4)
    weights = {"w": rng.normal(size=(inputs, 16)), "b": 0.1 * rng.normal(size=16), "v": rng.normal(size=(16, 1)) / 4}
    nodes = [helper.make_node("Gemm", ["x", "w", "b"], ["h"]), helper.make_node("Softsign", ["h"], ["a"]),
             helper.make_node("MatMul", ["a", "v"], ["torque"])]  # fmt: skip
    save_network("net.onnx", nodes, {"x": ["n", inputs]}, {"torque": ["n", 1]}, weights)


def simulate_plain_loop(strength, recurrent):
    """Velocities (ticks, nv): torques of the hip and the knee by hand, by scales, samples and order of the study."""
    model = mujoco.MjModel.from_xml_string(MODEL)
    model.actuator_gainprm[2, 0] = 1.0  # the servo as a motor: the network's torque is all that acts
    model.actuator_biasprm[2] = 0.0
    data, network, speeds = mujoco.MjData(model), ReferenceEvaluator("net.onnx"), []
    errors, rates = np.zeros((5, 2)), np.zeros((5, 2))  # newest first; knee, hip
    memory = [{"h_in": np.zeros((1, 1, 8)), "c_in": np.zeros((1, 1, 8))} for _ in range(2)]
    for tick in range(25):
        targets = np.array([np.sin(9 * 0.02 * tick), 0.7 * np.cos(5 * 0.02 * tick)])
        for _ in range(10):
            errors = np.vstack([targets - data.qpos[[1, 0]], errors[:-1]])
            rates = np.vstack([data.qvel[[1, 0]], rates[:-1]])
            if recurrent:
                torques = []
                for k in range(2):
                    given = {"obs": np.array([[errors[0, k], rates[0, k]]]), **memory[k]}
                    torque, *after = network.run(None, given)
                    memory[k] = dict(zip(("h_in", "c_in"), after, strict=True))
                    torques.append(torque[0, 0])
            else:
                seen = np.concatenate([0.1 * rates[::2], 2.0 * errors[::2]])
                (torques,) = network.run(None, {"x": seen.T})
            torque = strength * 5 * np.ravel(torques)
            data.ctrl[:] = torque[0] / 2, 0.5, torque[1]
            mujoco.mj_step(model, data)
        speeds.append(data.qvel.copy())
    return np.array(speeds)


@pytest.fixture
def here(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    write_texts({"model.xml": MODEL, "targets.py": TARGETS, "one.yaml": STUDY % LEGS})
    return tmp_path


@pytest.mark.parametrize("engine", ["native", pytest.param("mjx", marks=pytest.mark.slow)])
@pytest.mark.parametrize("shape", ["samples", "recurrent"])
def test_torques_are_those_of_a_plain_loop(here, engine, shape):
    if recurrent := shape == "recurrent":
        save_lstm("net.onnx", 2, 8, 1)
        Path("one.yaml").write_text(STUDY % RECURRENT)
    else:
        save_layers_of(6)
    made, batch = prepare_batch(f"engine={engine}", "engine.precision=float64", "engine.cross_check=false")
    speeds = np.stack([one.qvel for one in made.traces(*batch, 1)])
    for k, strength in enumerate((1.0, 0.5)):
        wanted = simulate_plain_loop(strength, recurrent)
        assert np.abs(wanted[:, :2]).max() > 1
        np.testing.assert_allclose(speeds[k], wanted, atol=1e-8)


def test_rows_do_not_depend_on_the_batch_and_the_network_belongs_to_the_study(here, capsys):
    save_layers_of(6)
    for width in (1, 2):
        assert main(["run", "study=one.yaml", f"engine.width={width}", f"out=of{width}"]) == 0
    assert main(["compare", "of1", "of2", "--tolerance", "0"]) == 0
    save_lstm("other.onnx", 2, 8, 1)
    Path("other.onnx").rename("net.onnx")
    Path("one.yaml").write_text(STUDY % RECURRENT)
    assert main(["run", "study=one.yaml", "out=of1"]) == 2


@pytest.mark.parametrize(("legs", "line"), [
    ("{joints: '*', stall_torque: 3, no_load_speed: 9, history: 2}", "motor.legs.history is not allowed without"),
    ("{joints: 'knee', network: none.onnx}", "motor.legs.network = 'none.onnx' is not a file"),
    ("{joints: 'knee', network: net.onnx, history: 2}", "motor.legs.network: net.onnx takes 6 numbers: the samples"),
    ("{joints: 'knee', network: net.onnx, recurrent: {h: g}}", "net.onnx has x, torque: one input and one output"),
    ("{joints: 'knee', network: net.onnx, order: rates}", "motor.legs.order = rates is unknown"),
])  # fmt: skip
def test_a_network_that_cannot_be_is_one_line(here, capsys, legs, line):
    save_layers_of(6)
    Path("one.yaml").write_text(STUDY % legs)
    assert main(["run", "study=one.yaml", "out=wrong"]) == 2
    one_line(capsys.readouterr().err, line)

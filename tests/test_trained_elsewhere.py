"""A second quadruped, and a network that was fitted to a trot elsewhere: `controller: walk.onnx` through a whole study.

It is longer, heavier, and has its knees towards each other. What teaches the network is the trot of
`sweep init --model`, told of other legs; it knows its clock and how the trunk leans, and nothing else.
"""

import importlib
import re
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from sweep.cli.main import main
from sweep.runs import store

LINK, HEIGHT, MASS, STIFFNESS = 0.25, 0.37, 12.0, 300.0  # m, m, kg, N m/rad
BACK = '<default class="back_{}"><joint range="{}"/></default>'
ROBOT = [
    ('timestep="0.002" integrator="implicitfast"', 'timestep="0.001" integrator="Euler"'),
    ("0 0 0 0 0 -0.2", f"0 0 0 0 0 -{LINK}"),
    ('pos="0 0 -0.2"', f'pos="0 0 -{LINK}"'),
    ("0.22 0.08 0.05", "0.3 0.08 0.05"),
    ('mass="8"', f'mass="{MASS}"'),
    ('pos="0.2 ', 'pos="0.28 '),
    ('pos="-0.2 ', 'pos="-0.28 '),
    ('kp="200" kv="3" forcerange="-40 40"', f'kp="{STIFFNESS}" kv="5" forcerange="-60 60"'),
    ('<gyro name="spin" site="imu"/>', '<gyro name="spin" site="imu"/><clock name="clock"/>'),
    (
        '<default class="thigh">',
        BACK.format("hip", "-120 80") + BACK.format("knee", "10 150") + '<default class="thigh">',
    ),
]
TEACHER = [
    ("PERIOD, LINK = 0.02, 0.2", f"PERIOD, LINK = 0.02, {LINK}"),
    ('"height": 0.28', f'"height": {HEIGHT - 0.02}'),
    ("[side, bend - jnp.arctan2(ahead, down), knee]", "[side, FRONT * bend - jnp.arctan2(ahead, down), FRONT * knee]"),
]
OBSERVED = """import jax.numpy as jnp
def observe(told):
    time, turn = told["clock"], 4 * jnp.pi * told["clock"]
    return jnp.concatenate([jnp.minimum(time, 1.0), jnp.sin(turn), jnp.cos(turn), told["turn"][1:3]])
"""
STUDY = f"""scenario: own
study:
  axes:
    load: {{path: model.body.trunk.mass, side: world, from: {MASS / 2}, to: {2.5 * MASS}, num: 4}}
    grip: {{path: model.geom.floor.friction.slide, side: world, from: 0.1, to: 0.8, num: 4}}
"""
AXES = ["world.model.body.trunk.mass", "world.model.geom.floor.friction.slide"]


def changed(text, changes):
    for old, new in changes:
        assert old in text, old
        text = text.replace(old, new)
    return text


def robot(text):
    """The second quadruped, of the first one's MJCF."""
    text = re.sub(r'(name="[lr]h_(?:hip|knee)" class=")', r"\1back_", changed(text, ROBOT))
    bend = float(np.arccos(HEIGHT / (2 * LINK)))
    legs = " ".join(f"0 {sign * bend:.4f} {-2 * sign * bend:.4f}" for sign in (1, 1, -1, -1))
    stand = f'<key name="home" qpos="0 0 {HEIGHT} 1 0 0 0 {legs}" ctrl="{legs}"/>'
    return re.sub(r'<key name="home".*?/>', stand, text, flags=re.DOTALL)


def fitted(policy, observe, belief, hidden=256, samples=20_000):
    """Weights of a layer of random tanh and of one by least squares, and what is left (rad, root mean square)."""
    rng = np.random.default_rng(0)
    time, lean = rng.uniform(0, 3, samples), rng.uniform(-0.3, 0.3, (samples, 3))

    def one(time, lean):
        turn = jnp.concatenate([jnp.sqrt(1 - lean @ lean / 4)[None], lean / 2])
        state = {"time": time, "spin": jnp.zeros(3)}
        angles, _ = policy(belief, jnp.concatenate([turn, state["spin"]]), state, None)
        return observe({"clock": time[None], "turn": turn}), angles

    seen, angles = (np.asarray(rows, float) for rows in jax.vmap(one)(jnp.asarray(time), jnp.asarray(lean)))
    first, shift = rng.normal(0, 1, (seen.shape[1], hidden)) / seen.std(axis=0)[:, None], rng.normal(0, 1, hidden)
    shift -= seen.mean(axis=0) @ first
    features = np.hstack([np.tanh(seen @ first + shift), np.ones((samples, 1))])
    last = np.linalg.lstsq(features, angles, rcond=1e-6)[0]
    return (first, shift, last[:-1], last[-1]), np.sqrt(np.mean((features @ last - angles) ** 2))


def save(layers, file):
    onnx = pytest.importorskip("onnx")
    saved = [onnx.numpy_helper.from_array(w.astype(np.float32), name) for w, name in zip(layers, "wbvc", strict=True)]
    steps = [("Gemm", ["seen", "w", "b"], ["a"]), ("Tanh", ["a"], ["h"]), ("Gemm", ["h", "v", "c"], ["angles"])]
    sizes = {"seen": layers[0].shape[0], "angles": layers[2].shape[1]}
    into, out = (onnx.helper.make_tensor_value_info(k, onnx.TensorProto.FLOAT, ["n", n]) for k, n in sizes.items())
    graph = onnx.helper.make_graph([onnx.helper.make_node(*one) for one in steps], "policy", [into], [out], saved)
    onnx.save(onnx.helper.make_model(graph, opset_imports=[onnx.helper.make_opsetid("", 17)], ir_version=9), file)


def test_a_network_that_was_taught_a_trot_has_its_map(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert main(["init", "--model", "second"]) == 0
    monkeypatch.chdir("second")
    monkeypatch.syspath_prepend(tmp_path / "second")
    Path("quadruped.xml").write_text(robot(Path("quadruped.xml").read_text()))
    Path("taught_by.py").write_text(changed(Path("trot.py").read_text(), TEACHER))
    Path("pupil.py").write_text(OBSERVED)
    Path("studies/grip.yaml").write_text(STUDY)
    teacher, observe = importlib.import_module("taught_by"), importlib.import_module("pupil").observe
    belief = {**teacher.PARAMETERS, "load": MASS, "stiffness": STIFFNESS}
    layers, left = fitted(teacher.policy, observe, belief)
    assert left < 0.03
    save(layers, "pupil.onnx")
    asked, outcomes = ["run", "study=grip", "outcome.goal='travelled_m >= 1.2'"], {}
    for name, how in (("taught_by:policy", []), ("pupil.onnx", ["model.observe=[]"])):
        assert main([*asked, *how, f"model.controller={name}", f"out={name[:5]}"]) == 0
        outcomes[name] = store.read_rows(Path(name[:5])).set_index(AXES).sort_index()["outcome"]
        assert 9 <= (outcomes[name] == "success").sum() <= 11
    taught, pupil = outcomes.values()
    assert len(taught) == 16
    assert (taught == pupil).sum() >= 15

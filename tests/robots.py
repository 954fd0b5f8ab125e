"""Quadrupeds and networks for tests of learned policies: the shapes of public ones, with random weights."""

import re
from importlib.resources import files
from itertools import pairwise
from xml.etree import ElementTree

import numpy as np
import onnx
from onnx import TensorProto, helper, numpy_helper

HOME = np.tile([0.0, 0.795, -1.59], 4)
JOINTS = tuple(f"{leg}_{part}" for leg in ("lf", "rf", "lh", "rh") for part in ("roll", "hip", "knee"))
STUDY = """scenario: own
study:
  axes:
    load: {path: model.body.trunk.mass, side: world, values: [8.0]}
"""
SCENARIO = """system: mujoco
model: {{mjcf: robot.xml, controller: walk.onnx, duration: 1, keyframe: home, sensors: current{more}}}
outcome: {{fell: base_height_min_m < 0.1}}
"""


def quadruped(motors=False, legs=4):
    """The quadruped of `sweep init --model`, with Euler's integrator; with motors in the place of position servos."""
    text = (files("sweep.cli") / "template_model" / "quadruped.xml").read_text()
    text = text.replace('integrator="implicitfast" iterations="10" ls_iterations="20"', 'integrator="Euler"')
    sensors = '<velocimeter name="local_linvel" site="imu"/><gyro name="gyro" site="imu"/>'
    text = text.replace("<sensor>", f"<sensor>{sensors}")
    if motors:
        text = text.replace('<position kp="200" kv="3" forcerange="-40 40"/>', '<motor ctrlrange="-40 40"/>')
        text = re.sub(r"<position (name)", r"<motor \1", text)
        text = re.sub(r' ctrl="[^"]*"', "", text)
    return text if legs == 4 else with_one_leg(text)


def with_one_leg(text):
    """The robot with its first leg alone, in the air: MJX compiles it in less time."""
    root = ElementTree.fromstring(text)
    for parent in list(root.iter()):
        for one in list(parent):
            if re.match("(rf|lh|rh)_", one.get("name", "")) or one.tag == "touch":
                parent.remove(one)
    key = root.find("keyframe/key")
    key.set("qpos", " ".join(key.get("qpos").split()[:10]))
    key.attrib.pop("ctrl", None)
    ElementTree.SubElement(root.find("option"), "flag", contact="disable")
    return ElementTree.tostring(root, encoding="unicode")


def write_project(folder, policy, more="", **robot):
    """Write a project with a robot, a policy's specification, a scenario and a study."""
    for name, text in {
        "robot.xml": quadruped(**robot),
        "walk.policy.yaml": policy,
        "sweep.yaml": "modules: []",
        "scenarios/own.yaml": SCENARIO.format(more=more),
        "studies/one.yaml": STUDY,
    }.items():
        (folder / name).parent.mkdir(exist_ok=True)
        (folder / name).write_text(text)


def save_network(file, nodes, inputs, outputs, weights, kind=TensorProto.DOUBLE, **metadata):
    """Save a graph; `inputs` and `outputs` are shapes by name, `weights` arrays by name."""
    into, out = ([helper.make_tensor_value_info(k, kind, s) for k, s in one.items()] for one in (inputs, outputs))
    saved = [numpy_helper.from_array(np.asarray(one), name) for name, one in weights.items()]
    graph = helper.make_graph(nodes, "policy", into, out, saved)
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=9)
    helper.set_model_props(model, metadata)
    onnx.save(model, file)


def save_perceptron(file, sizes, size=1.0, seed=1, weight=None, **metadata):
    """Save a perceptron with tanh in every layer, whose last weights have a `size`."""
    rng, weights, nodes, last = np.random.default_rng(seed), {}, [], "obs"
    for k, (n, m) in enumerate(pairwise(sizes)):
        weights |= {f"w{k}": rng.normal(size=(m, n)) / np.sqrt(n), f"b{k}": 0.1 * rng.normal(size=m)}
        end = k == len(sizes) - 2
        if end:
            weights[f"w{k}"] *= size
        nodes.append(helper.make_node("Gemm", [last, f"w{k}", f"b{k}"], [f"a{k}"], transB=1))
        last = "action" if end else f"h{k}"
        nodes.append(helper.make_node("Tanh", [f"a{k}"], [last]))
    if weight is not None:  # of a single layer, without a bias
        weights |= {"w0": weight, "b0": np.zeros(sizes[-1])}
    save_network(file, nodes, {"obs": ["n", sizes[0]]}, {"action": ["n", sizes[-1]]}, weights, **metadata)


def save_lstm(file, inputs, hidden, outputs, seed=2):
    """Save an LSTM of one step, with `h` and `c` (1, 1, hidden) as inputs and outputs, and a linear layer."""
    rng = np.random.default_rng(seed)
    weights = {
        "w": rng.normal(size=(1, 4 * hidden, inputs)) / np.sqrt(inputs),
        "r": rng.normal(size=(1, 4 * hidden, hidden)) / np.sqrt(hidden),
        "b": 0.1 * rng.normal(size=(1, 8 * hidden)),
        "last": 0.3 * rng.normal(size=(hidden, outputs)),
        "axes": np.array([0]),
        "axis": np.array([1]),
    }
    nodes = [
        helper.make_node("Unsqueeze", ["obs", "axes"], ["sequence"]),
        helper.make_node("LSTM", ["sequence", "w", "r", "b", "", "h_in", "c_in"], ["y", "h_out", "c_out"],
                         hidden_size=hidden),
        helper.make_node("Squeeze", ["h_out", "axes"], ["hidden"]),
        helper.make_node("MatMul", ["hidden", "last"], ["action"]),
    ]  # fmt: skip
    state = [1, 1, hidden]
    shapes = {"obs": [1, inputs], "h_in": state, "c_in": state}
    save_network(file, nodes, shapes, {"action": [1, outputs], "h_out": state, "c_out": state}, weights)

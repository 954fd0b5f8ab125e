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
    """Save a perceptron with random weights and tanh in every layer; its last weights have a `size`.

    A `weight` takes the place of those of a single layer, without a bias.
    """
    rng, weights, biases = np.random.default_rng(seed), [], []
    for n, m in pairwise(sizes):
        weights.append(rng.normal(size=(m, n)) / np.sqrt(n))
        biases.append(0.1 * rng.normal(size=m))
    weights[-1] *= size
    if weight is not None:
        weights, biases = [weight], [np.zeros(sizes[-1])]
    save_layers(file, weights, biases, **metadata)


def save_trot(file):
    """Save a perceptron of 48, 128, 64 and 12 numbers that trots, for a joystick policy's observation.

    The last action carries the gait: it turns by 0.25 rad a tick in the plane of two patterns, diagonal legs apart in
    height and in swing, and the commanded speed starts it. Tilt is answered by stretching the legs on the lower side.
    The robot stays upright and a small difference of the state decays: a policy of random weights makes the robot
    tumble, where one of 1e-7 rad grows to 17 mm in a second.
    """
    law, patterns = np.zeros((12, 48)), np.zeros((12, 2))
    for leg, (front, left) in enumerate([(1, 1), (1, -1), (-1, 1), (-1, -1)]):
        hip, knee = 3 * leg + 1, 3 * leg + 2
        patterns[hip], patterns[knee] = (0.2 * front * left, -0.3 * front * left), (-0.4 * front * left, 0)
        stretch = np.zeros(48)
        stretch[[3, 4, 6, 7]] = -0.02 * left, 0.02 * front, 0.3 * front, 0.3 * left
        law[hip], law[knee] = -stretch, 2 * stretch
    turn = 1.08 * np.array([[np.cos(0.25), -np.sin(0.25)], [np.sin(0.25), np.cos(0.25)]])
    law[:, 33:45] = patterns @ turn @ np.linalg.pinv(patterns)
    law[:, 45] = 0.2 * patterns[:, 0]
    rng = np.random.default_rng(1)
    first, second = (np.linalg.qr(rng.normal(size=(n, 12)))[0] for n in (128, 64))
    layers = [first @ law, second @ first.T, second.T]
    save_layers(file, layers, [np.zeros(len(one)) for one in layers])


def save_layers(file, weights, biases, **metadata):
    """Save a perceptron with tanh in every layer."""
    saved, nodes, last = {}, [], "obs"
    for k, (weight, bias) in enumerate(zip(weights, biases, strict=True)):
        saved |= {f"w{k}": weight, f"b{k}": bias}
        nodes.append(helper.make_node("Gemm", [last, f"w{k}", f"b{k}"], [f"a{k}"], transB=1))
        last = "action" if k == len(weights) - 1 else f"h{k}"
        nodes.append(helper.make_node("Tanh", [f"a{k}"], [last]))
    shapes = {"obs": ["n", weights[0].shape[1]]}, {"action": ["n", len(biases[-1])]}
    save_network(file, nodes, *shapes, saved, **metadata)


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

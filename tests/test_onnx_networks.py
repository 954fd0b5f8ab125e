"""Networks in ONNX files, as functions of JAX: equal to what ONNX's own evaluators make of them."""

import contextlib
import itertools

import jax
import numpy as np
import onnx
import onnxruntime
import pytest
from onnx import TensorProto, helper, numpy_helper
from onnx.reference import ReferenceEvaluator

from sweep.core.errors import InputError
from sweep.systems.mujoco_model.onnx_network import read_network

RNG = np.random.default_rng(3)


def save_graph(file, nodes, inputs, outputs, weights=(), kind=TensorProto.DOUBLE, opset=20, **metadata):
    """Save a graph; `inputs` and `outputs` are shapes by name, `weights` arrays by name."""
    into, out = ([helper.make_tensor_value_info(k, kind, s) for k, s in one.items()] for one in (inputs, outputs))
    saved = [numpy_helper.from_array(np.asarray(one), name) for name, one in dict(weights).items()]
    graph = helper.make_graph(nodes, "policy", into, out, saved)
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", opset)], ir_version=10)
    helper.set_model_props(model, metadata)
    onnx.save(model, file)
    return model


def evaluate(file, given, double=True):
    with jax.enable_x64(True) if double else contextlib.nullcontext():
        return {key: np.asarray(one) for key, one in read_network(file.name, file).evaluate(given).items()}


def test_a_multilayer_perceptron_is_that_of_onnxruntime(tmp_path):
    file, sizes = tmp_path / "walk.onnx", (48, 512, 256, 128, 12)
    weights, nodes, last = {"mean": RNG.normal(size=48), "std": RNG.uniform(0.5, 2, 48)}, [], "normalized"
    nodes += [helper.make_node("Sub", ["obs", "mean"], ["centred"]),
              helper.make_node("Div", ["centred", "std"], ["normalized"])]  # fmt: skip
    for k, (n, m) in enumerate(itertools.pairwise(sizes)):
        weights |= {f"w{k}": RNG.normal(size=(m, n)) / np.sqrt(n), f"b{k}": RNG.normal(size=m)}
        nodes.append(helper.make_node("Gemm", [last, f"w{k}", f"b{k}"], [f"a{k}"], transB=1))
        last = f"h{k}" if k < 3 else "action"
        nodes.append(helper.make_node("Tanh", [f"a{k}"], [last]))
    save_graph(file, nodes, {"obs": ["n", 48]}, {"action": ["n", 12]}, weights, opset=17)
    seen = RNG.normal(size=(10_000, 48))
    (theirs,) = onnxruntime.InferenceSession(file, providers=["CPUExecutionProvider"]).run(None, {"obs": seen})
    assert np.abs(theirs).max() > 0.5
    np.testing.assert_allclose(evaluate(file, {"obs": seen})["action"], theirs, atol=1e-12)
    assert evaluate(file, {"obs": seen}, double=False)["action"].dtype == np.float32


def ints(*numbers):
    return np.array(numbers, np.int64)


ACTIVATIONS = (
    *("Celu", "Elu", "Erf", "Gelu", "HardSigmoid", "HardSwish", "LeakyRelu", "LogSoftmax", "Mish", "Relu", "Selu"),
    *("Sigmoid", "Softmax", "Softplus", "Softsign", "Swish", "Tanh", "Abs", "Neg", "Floor", "Ceil", "Round", "Sign"),
    *("Exp", "Sin", "Cos", "Tan", "Atan", "Reciprocal", "Identity"),
)
X = RNG.normal(size=(2, 6))
CASES = {
    **{name: ([X], {}, ()) for name in ACTIVATIONS},
    "Gelu/tanh": ([X], {"approximate": "tanh"}, ()),
    "Sqrt": ([X**2], {}, ()),
    "Log": ([X**2], {}, ()),
    "PRelu": ([X], {}, (np.array([0.2]),)),
    "Clip": ([X], {}, (np.array(-0.3), np.array(0.4))),
    "Pow": ([X**2], {}, (np.array(1.5),)),
    "Max": ([X], {}, (np.zeros(6), X[:1])),
    "Sum": ([X], {}, (np.ones(6), X[:1])),
    "Gemm": ([X], {"alpha": 0.5, "beta": 2.0, "transA": 1}, (RNG.normal(size=(2, 3)), np.ones(3))),
    "MatMul": ([X], {}, (RNG.normal(size=(6, 3)),)),
    "LayerNormalization": ([X], {}, (RNG.normal(size=6), RNG.normal(size=6))),
    "BatchNormalization": ([X], {}, (*RNG.normal(size=(3, 6)), RNG.uniform(1, 2, 6))),
    "Concat": ([X], {"axis": 1}, (X[:, :2],)),
    "Slice": ([X], {}, (ints(1, -1), ints(2, -9), ints(0, 1), ints(1, -2))),
    "Split/two": ([X], {"axis": 1}, (ints(2, 4),)),
    "Reshape": ([X], {}, (ints(0, -1, 2),)),
    "Flatten": ([X.reshape(2, 3, 2)], {"axis": -1}, ()),
    "Squeeze": ([X.reshape(2, 1, 6)], {}, (ints(1),)),
    "Unsqueeze": ([X], {}, (ints(0, 2),)),
    "Transpose": ([X], {"perm": [1, 0]}, ()),
    "Gather": ([X], {"axis": 1}, (ints(4, -6, 1),)),
    "Expand": ([X[:1]], {}, (ints(3, 1),)),
    "Tile": ([X], {}, (ints(2, 1),)),
    "ReduceMean": ([X], {"keepdims": 0}, (ints(-1),)),
    "ReduceL2": ([X], {}, (ints(1),)),
    "ReduceSum": ([X], {}, ()),
    "ReduceMax": ([X], {}, (ints(0),)),
}  # fmt: skip


@pytest.mark.parametrize("name", CASES)
def test_an_operator_is_that_of_onnx(tmp_path, name):
    file, (given, attributes, more) = tmp_path / "one.onnx", CASES[name]
    kind, outputs = name.partition("/")[0], ["y", "z"][: 1 + name.endswith("/two")]
    opset, names = (24 if kind == "Swish" else 20), [f"x{k}" for k in range(len(given) + len(more))]
    weights = dict(zip(names[len(given) :], more, strict=True))
    node = helper.make_node(kind, names, outputs, **attributes)
    inputs = {key: one.shape for key, one in zip(names, given, strict=False)}
    model = save_graph(file, [node], inputs, dict.fromkeys(outputs), weights, opset=opset)
    theirs = ReferenceEvaluator(model).run(None, dict(zip(names, given, strict=False)))
    ours = evaluate(file, dict(zip(names, given, strict=False)))
    for key, one in zip(outputs, theirs, strict=True):
        assert ours[key].shape == one.shape
        np.testing.assert_allclose(ours[key], one, atol=1e-6 if kind in ("Erf", "Gelu", "HardSwish") else 1e-12)


@pytest.mark.parametrize(("cell", "gates", "attributes"), [
    ("LSTM", 4, {}), ("GRU", 3, {"linear_before_reset": 1}), ("GRU", 3, {"linear_before_reset": 0}),
])  # fmt: skip
def test_a_recurrent_cell_is_that_of_onnxruntime(tmp_path, cell, gates, attributes):
    """Of 10,000 observations at a time; onnxruntime has these cells in single precision only."""
    file, n = tmp_path / "cell.onnx", 8
    weights = {"w": RNG.normal(size=(1, gates * n, 5)) / 2, "r": RNG.normal(size=(1, gates * n, n)) / 3,
               "b": RNG.normal(size=(1, 2 * gates * n))}  # fmt: skip
    state = ["h", "c"][: gates - 2]
    out = ["y", *(f"{one}_out" for one in state)]
    node = helper.make_node(cell, ["x", "w", "r", "b", "", *state], out, hidden_size=n, **attributes)
    shapes = {"x": [3, 10_000, 5], **{one: [1, 10_000, n] for one in state}}
    given = {key: RNG.normal(size=shape).astype(np.float32) for key, shape in shapes.items()}
    single = {key: one.astype(np.float32) for key, one in weights.items()}
    save_graph(file, [node], shapes, dict.fromkeys(out), single, kind=TensorProto.FLOAT)
    theirs = onnxruntime.InferenceSession(file, providers=["CPUExecutionProvider"]).run(None, given)
    ours = evaluate(file, given)
    for key, one in zip(out, theirs, strict=True):
        assert ours[key].dtype == np.float64
        np.testing.assert_allclose(ours[key], one, atol=1e-6, rtol=0)


def test_shapes_are_constants_as_exporters_compute_them(tmp_path):
    file = tmp_path / "shapes.onnx"
    nodes = [
        helper.make_node("Shape", ["x"], ["shape"]),
        helper.make_node("Constant", [], ["zero"], value_ints=[0]),
        helper.make_node("Gather", ["shape", "zero"], ["rows"], axis=0),
        helper.make_node("Constant", [], ["rest"], value_ints=[-1]),
        helper.make_node("Concat", ["rows", "rest"], ["wanted"], axis=0),
        helper.make_node("Reshape", ["x", "wanted"], ["y"]),
    ]
    save_graph(file, nodes, {"x": ["n", 2, 3]}, {"y": ["n", 6]})
    assert evaluate(file, {"x": np.ones((4, 2, 3))})["y"].shape == (4, 6)


@pytest.mark.parametrize(("node", "line"), [
    (("NonMaxSuppression", ["x"], {}), "has the operator NonMaxSuppression, which is not supported (allowed: Abs"),
    (("RandomNormalLike", ["x"], {}), "draws random numbers (RandomNormalLike): export the policy's mean action"),
    (("FusedGemm", ["x"], {"domain": "com.microsoft"}), "has the operator com.microsoft.FusedGemm, which is not"),
    (("LSTM", ["x", "x", "x"], {"direction": "bidirectional"}), "LSTM with direction is not supported"),
    (("MatMul", ["x", "x"], {}), "MatMul  cannot be computed: "),
])  # fmt: skip
def test_what_is_not_supported_is_one_line(tmp_path, node, line):
    file, (name, inputs, more) = tmp_path / "odd.onnx", node
    save_graph(file, [helper.make_node(name, inputs, ["y"], **more)], {"x": [2, 3]}, {"y": None})
    with pytest.raises(InputError) as error:
        evaluate(file, {"x": np.ones((2, 3))})
    assert line in str(error.value)

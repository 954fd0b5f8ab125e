"""ONNX operators as functions of arrays: the closed list of those that a network may use.

An operator whose arguments are all NumPy arrays is evaluated by NumPy, so that shapes and other constants are known
when JAX traces the network. Definitions: https://onnx.ai/onnx/operators.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from sweep.core.errors import InputError

Operator = Callable[..., Any]  # of a call and the arrays that go in; gives an array, or a tuple of them
SELU_DEFAULTS = 1.67326319217681884765625, 1.05070102214813232421875  # defaults of alpha and gamma
CELL_ATTRIBUTES = {
    "activations",
    "activation_alpha",
    "activation_beta",
    "clip",
    "input_forget",
    "direction",
}  # of LSTM and GRU


class OperatorCall:
    """One node of an ONNX graph: its attributes, its number of outputs, and the version of its operator set."""

    def __init__(self, name: str, attributes: Mapping[str, Any], outputs: int, opset: int):
        self.name, self.attributes, self.outputs, self.opset = name, attributes, outputs, opset

    def attribute(self, name: str, default: Any = None) -> Any:
        """Return the value of an attribute of the node, or a default."""
        return self.attributes.get(name, default)

    def attribute_or_input(self, name: str, inputs: Sequence[Any], place: int, default: Any = None) -> Any:
        """Return a parameter of an ONNX node: an attribute in older operator sets, a constant input in newer ones.

        Args:
            name: Name of the attribute.
            inputs: All inputs; None where one is left out.
            place: Index of the input.
            default: Value where there is neither.

        Returns:
            The value, as a NumPy array or what the attribute holds. Raises `InputError` if it is computed.
        """
        if name in self.attributes:
            return self.attributes[name]
        if place >= len(inputs) or inputs[place] is None:
            return default
        if not isinstance(inputs[place], np.ndarray):
            raise InputError(f"{self.name} with {name} that depends on the input is not supported")
        return inputs[place]


def _unary(function: Callable[[Any, Any], Any]) -> Operator:
    """Make an operator of one array from a function of the array's module and the array."""
    return lambda call, x: function(_module(x), x)


def _binary(function: Callable[[Any, Any, Any], Any]) -> Operator:
    return lambda call, x, y: function(_module(x, y), x, y)


def _module(*arrays: Any) -> Any:
    """NumPy, or JAX's if an array is JAX's."""
    return jnp if any(isinstance(one, jax.Array) for one in arrays) else np


def _sigmoid(xp: Any, x: Any) -> Any:
    return 0.5 * (xp.tanh(0.5 * x) + 1)


def _erf(x: Any) -> Any:
    return jax.scipy.special.erf(jnp.asarray(x))


def _accumulate(function: str) -> Operator:
    """Make an operator of any number of arrays."""

    def combine(call: OperatorCall, *arrays: Any) -> Any:
        found = arrays[0]
        for one in arrays[1:]:
            found = getattr(_module(found, one), function)(found, one)
        return found

    return combine


def _reduce(function: Callable[[Any, Any, Any, bool], Any]) -> Operator:
    """Make a reduction from a function of module, array, axes and whether axes stay."""

    def reduce(call: OperatorCall, x: Any, *axes_input: Any) -> Any:
        axes = call.attribute_or_input("axes", (x, *axes_input), 1)
        if (axes is None or not len(axes)) and call.attribute("noop_with_empty_axes", 0):
            return x
        axes = None if axes is None or not len(axes) else tuple(int(one) for one in axes)
        return function(_module(x), x, axes, bool(call.attribute("keepdims", 1)))

    return reduce


def _gelu(call: OperatorCall, x: Any) -> Any:
    if call.attribute("approximate", b"none") == b"tanh":
        return jax.nn.gelu(jnp.asarray(x), approximate=True)
    return 0.5 * x * (1 + _erf(x / math.sqrt(2)))


def _elu(call: OperatorCall, x: Any) -> Any:
    xp = _module(x)
    return xp.where(x > 0, x, call.attribute("alpha", 1.0) * xp.expm1(xp.minimum(x, 0)))


def _selu(call: OperatorCall, x: Any) -> Any:
    xp, alpha, gamma = _module(x), call.attribute("alpha", SELU_DEFAULTS[0]), call.attribute("gamma", SELU_DEFAULTS[1])
    return gamma * xp.where(x > 0, x, alpha * xp.expm1(xp.minimum(x, 0)))


def _celu(call: OperatorCall, x: Any) -> Any:
    xp, alpha = _module(x), call.attribute("alpha", 1.0)
    return xp.maximum(x, 0) + xp.minimum(0, alpha * xp.expm1(xp.minimum(x, 0) / alpha))


def _hard_sigmoid(call: OperatorCall, x: Any) -> Any:
    return _module(x).clip(call.attribute("alpha", 0.2) * x + call.attribute("beta", 0.5), 0, 1)


def _swish(call: OperatorCall, x: Any) -> Any:
    return x * _sigmoid(_module(x), call.attribute("alpha", 1.0) * x)


def _clip(call: OperatorCall, x: Any, *bounds: Any) -> Any:
    low, high = (call.attribute_or_input(name, (x, *bounds), k + 1) for k, name in enumerate(("min", "max")))
    return _module(x).clip(x, low, high)


def _gemm(call: OperatorCall, a: Any, b: Any, c: Any = 0.0) -> Any:
    a = a.T if call.attribute("transA", 0) else a
    b = b.T if call.attribute("transB", 0) else b
    return call.attribute("alpha", 1.0) * (a @ b) + call.attribute("beta", 1.0) * c


def _softmax(call: OperatorCall, x: Any) -> Any:
    if call.opset < 13:  # which flattens the array at the axis
        axis = call.attribute("axis", 1) % x.ndim
        return jax.nn.softmax(jnp.reshape(x, (math.prod(x.shape[:axis]), -1)), axis=1).reshape(x.shape)
    return jax.nn.softmax(jnp.asarray(x), axis=call.attribute("axis", -1))


def _log_softmax(call: OperatorCall, x: Any) -> Any:
    return jnp.log(_softmax(call, x))


def _layer_norm(call: OperatorCall, x: Any, scale: Any, bias: Any = 0.0) -> Any:
    xp, first = _module(x, scale), call.attribute("axis", -1) % x.ndim
    axes = tuple(range(first, x.ndim))
    centred = x - x.mean(axis=axes, keepdims=True)
    variance = (centred**2).mean(axis=axes, keepdims=True)
    return centred / xp.sqrt(variance + call.attribute("epsilon", 1e-5)) * scale + bias


def _batch_norm(call: OperatorCall, x: Any, scale: Any, bias: Any, mean: Any, variance: Any) -> Any:
    if call.attribute("training_mode", 0):
        raise InputError("BatchNormalization in training mode is not supported")
    shape = (1, -1, *(1,) * (x.ndim - 2))
    scale, bias, mean, variance = (one.reshape(shape) for one in (scale, bias, mean, variance))
    return (x - mean) / _module(variance).sqrt(variance + call.attribute("epsilon", 1e-5)) * scale + bias


def _concat(call: OperatorCall, *arrays: Any) -> Any:
    return _module(*arrays).concatenate(arrays, axis=call.attribute("axis", 1))


def _slice(call: OperatorCall, x: Any, *more: Any) -> Any:
    given = (x, *more)
    starts, ends = (np.asarray(call.attribute_or_input(name, given, k)) for name, k in (("starts", 1), ("ends", 2)))
    axes = call.attribute_or_input("axes", given, 3, range(len(starts)))
    steps = call.attribute_or_input("steps", given, 4, np.ones(len(starts), int))
    places = [slice(None)] * x.ndim
    for start, end, axis, step in zip(starts, ends, axes, steps, strict=True):
        end = None if step < 0 and end < -x.shape[axis] else int(end)  # as far as it goes
        places[axis] = slice(int(start), end, int(step))
    return x[tuple(places)]


def _split(call: OperatorCall, x: Any, *more: Any) -> Any:
    axis, sizes = call.attribute("axis", 0), call.attribute_or_input("split", (x, *more), 1)
    if sizes is None:
        size = -(-x.shape[axis] // call.outputs)
        ends = np.minimum(size * np.arange(1, call.outputs), x.shape[axis])
    else:
        ends = np.cumsum(sizes)[:-1]
    return tuple(_module(x).split(x, [int(one) for one in ends], axis=axis))


def _reshape(call: OperatorCall, x: Any, *more: Any) -> Any:
    shape = [int(one) for one in call.attribute_or_input("shape", (x, *more), 1)]
    if not call.attribute("allowzero", 0):
        shape = [x.shape[k] if one == 0 else one for k, one in enumerate(shape)]
    return x.reshape(shape)


def _flatten(call: OperatorCall, x: Any) -> Any:
    axis = call.attribute("axis", 1)
    axis = axis + x.ndim if axis < 0 else axis
    return x.reshape(math.prod(x.shape[:axis]), -1)


def _squeeze(call: OperatorCall, x: Any, *more: Any) -> Any:
    axes = call.attribute_or_input("axes", (x, *more), 1)
    return _module(x).squeeze(x, axis=None if axes is None else tuple(int(one) for one in axes))


def _unsqueeze(call: OperatorCall, x: Any, *more: Any) -> Any:
    axes = call.attribute_or_input("axes", (x, *more), 1)
    return _module(x).expand_dims(x, tuple(int(one) for one in axes))


def _transpose(call: OperatorCall, x: Any) -> Any:
    return _module(x).transpose(x, call.attribute("perm"))


def _gather(call: OperatorCall, x: Any, places: Any) -> Any:
    if not isinstance(places, np.ndarray):
        raise InputError("Gather of places that depend on the input is not supported")
    return _module(x).take(x, places.astype(int), axis=call.attribute("axis", 0))


def _expand(call: OperatorCall, x: Any, *more: Any) -> Any:
    shape = [int(one) for one in call.attribute_or_input("shape", (x, *more), 1)]
    return _module(x).broadcast_to(x, np.broadcast_shapes(x.shape, tuple(shape)))


def _tile(call: OperatorCall, x: Any, *more: Any) -> Any:
    return _module(x).tile(x, [int(one) for one in call.attribute_or_input("repeats", (x, *more), 1)])


def _cast(call: OperatorCall, x: Any, *like: Any) -> Any:
    kind = np.dtype(call.attribute("to")).kind if "to" in call.attributes else like[0].dtype.kind
    return x.astype({"f": float, "i": int, "u": int, "b": bool}[kind])  # numbers have the engine's precision


def _shape(call: OperatorCall, x: Any) -> Any:
    return np.array(x.shape[call.attribute("start", 0) : call.attribute("end")], np.int64)


def _fill(call: OperatorCall, *more: Any) -> Any:
    shape, value = call.attribute_or_input("shape", more, 0), np.ravel(call.attribute("value", np.zeros(1)))
    return np.full([int(one) for one in shape], value[0])


def _lstm(call: OperatorCall, x: Any, w: Any, r: Any, b: Any = None, lengths: Any = None, h: Any = None,
          c: Any = None, peepholes: Any = None) -> Any:  # fmt: skip
    _require_plain_cell(call, x, lengths, peepholes)
    size = r.shape[2]
    h, c = (jnp.zeros((x.shape[1], size)) if one is None else one[0] for one in (h, c))
    bias = 0.0 if b is None else b[0, : 4 * size] + b[0, 4 * size :]
    every = []
    for seen in x:
        gates = seen @ w[0].T + h @ r[0].T + bias
        enter, leave, forget, cell = (gates[:, k * size : (k + 1) * size] for k in range(4))
        c = _sigmoid(jnp, forget) * c + _sigmoid(jnp, enter) * jnp.tanh(cell)
        h = _sigmoid(jnp, leave) * jnp.tanh(c)
        every.append(h)
    return jnp.stack(every)[:, None], h[None], c[None]


def _gru(call: OperatorCall, x: Any, w: Any, r: Any, b: Any = None, lengths: Any = None, h: Any = None) -> Any:
    _require_plain_cell(call, x, lengths, None)
    size = r.shape[2]
    h = jnp.zeros((x.shape[1], size)) if h is None else h[0]
    inner, outer = (np.zeros(3 * size),) * 2 if b is None else (b[0, : 3 * size], b[0, 3 * size :])
    every = []
    for seen in x:
        new = (seen @ w[0].T + inner).reshape(-1, 3, size)
        old = (h @ r[0, : 2 * size].T + outer[: 2 * size]).reshape(-1, 2, size)
        update, reset = (_sigmoid(jnp, new[:, k] + old[:, k]) for k in range(2))
        if call.attribute("linear_before_reset", 0):
            past = reset * (h @ r[0, 2 * size :].T + outer[2 * size :])
        else:
            past = (reset * h) @ r[0, 2 * size :].T + outer[2 * size :]
        h = (1 - update) * jnp.tanh(new[:, 2] + past) + update * h
        every.append(h)
    return jnp.stack(every)[:, None], h[None]


def _require_plain_cell(call: OperatorCall, x: Any, lengths: Any, peepholes: Any) -> None:
    """Raise `InputError` for variants of a recurrent cell that are not implemented."""
    odd = {name: call.attributes[name] for name in CELL_ATTRIBUTES & {*call.attributes}}
    for name, usual in (("direction", b"forward"), ("input_forget", 0)):
        if odd.get(name) == usual:
            del odd[name]
    usual = [b"Sigmoid", b"Tanh", b"Tanh"][: 3 if call.name == "LSTM" else 2]
    if odd.get("activations") == usual:
        del odd["activations"]
    if call.attribute("layout", 0):
        odd["layout"] = 1
    if isinstance(lengths, np.ndarray) and (lengths == x.shape[0]).all():
        lengths = None
    odd |= {name: "set" for name, one in (("sequence_lens", lengths), ("P", peepholes)) if one is not None}
    if odd:
        raise InputError(f"{call.name} with {', '.join(sorted(odd))} is not supported")


OPERATORS: Mapping[str, Operator] = {
    **dict.fromkeys(("Identity", "Dropout"), lambda call, x, *more: x),
    "Add": _binary(lambda xp, x, y: x + y),
    "Sub": _binary(lambda xp, x, y: x - y),
    "Mul": _binary(lambda xp, x, y: x * y),
    "Div": _binary(lambda xp, x, y: x / y if x.dtype.kind == "f" else x // y),
    "Pow": _binary(lambda xp, x, y: xp.power(x, y)),
    "Mod": lambda call, x, y: _module(x, y).fmod(x, y) if call.attribute("fmod", 0) else _module(x, y).mod(x, y),
    "Equal": _binary(lambda xp, x, y: x == y),
    "Greater": _binary(lambda xp, x, y: x > y),
    "GreaterOrEqual": _binary(lambda xp, x, y: x >= y),
    "Less": _binary(lambda xp, x, y: x < y),
    "LessOrEqual": _binary(lambda xp, x, y: x <= y),
    "And": _binary(lambda xp, x, y: x & y),
    "Or": _binary(lambda xp, x, y: x | y),
    "Not": _unary(lambda xp, x: ~x),
    "Neg": _unary(lambda xp, x: -x),
    "Abs": _unary(lambda xp, x: abs(x)),
    "Sign": _unary(lambda xp, x: xp.sign(x)),
    "Floor": _unary(lambda xp, x: xp.floor(x)),
    "Ceil": _unary(lambda xp, x: xp.ceil(x)),
    "Round": _unary(lambda xp, x: xp.round(x)),
    "Reciprocal": _unary(lambda xp, x: 1 / x),
    "Sqrt": _unary(lambda xp, x: xp.sqrt(x)),
    "Exp": _unary(lambda xp, x: xp.exp(x)),
    "Log": _unary(lambda xp, x: xp.log(x)),
    "Sin": _unary(lambda xp, x: xp.sin(x)),
    "Cos": _unary(lambda xp, x: xp.cos(x)),
    "Tan": _unary(lambda xp, x: xp.tan(x)),
    "Atan": _unary(lambda xp, x: xp.arctan(x)),
    "Tanh": _unary(lambda xp, x: xp.tanh(x)),
    "Erf": lambda call, x: _erf(x),
    "Relu": _unary(lambda xp, x: xp.maximum(x, 0)),
    "LeakyRelu": lambda call, x: _module(x).where(x >= 0, x, call.attribute("alpha", 0.01) * x),
    "PRelu": lambda call, x, slope: _module(x, slope).where(x >= 0, x, slope * x),
    "Sigmoid": _unary(_sigmoid),
    "HardSigmoid": _hard_sigmoid,
    "HardSwish": lambda call, x: x * _module(x).clip(x / 6 + 0.5, 0, 1),
    "Swish": _swish,
    "Mish": _unary(lambda xp, x: x * xp.tanh(xp.logaddexp(x, 0.0))),
    "Softplus": _unary(lambda xp, x: xp.logaddexp(x, 0.0)),
    "Softsign": _unary(lambda xp, x: x / (1 + abs(x))),
    "Softmax": _softmax,
    "LogSoftmax": _log_softmax,
    "Elu": _elu,
    "Selu": _selu,
    "Celu": _celu,
    "Gelu": _gelu,
    "Clip": _clip,
    "Max": _accumulate("maximum"),
    "Min": _accumulate("minimum"),
    "Sum": _accumulate("add"),
    "MatMul": _binary(lambda xp, x, y: x @ y),
    "Gemm": _gemm,
    "LayerNormalization": _layer_norm,
    "BatchNormalization": _batch_norm,
    "LSTM": _lstm,
    "GRU": _gru,
    "ReduceMean": _reduce(lambda xp, x, axes, keep: xp.mean(x, axis=axes, keepdims=keep)),
    "ReduceSum": _reduce(lambda xp, x, axes, keep: xp.sum(x, axis=axes, keepdims=keep)),
    "ReduceMax": _reduce(lambda xp, x, axes, keep: xp.max(x, axis=axes, keepdims=keep)),
    "ReduceMin": _reduce(lambda xp, x, axes, keep: xp.min(x, axis=axes, keepdims=keep)),
    "ReduceProd": _reduce(lambda xp, x, axes, keep: xp.prod(x, axis=axes, keepdims=keep)),
    "ReduceL2": _reduce(lambda xp, x, axes, keep: xp.sqrt(xp.sum(x**2, axis=axes, keepdims=keep))),
    "ReduceSumSquare": _reduce(lambda xp, x, axes, keep: xp.sum(x**2, axis=axes, keepdims=keep)),
    "Where": lambda call, holds, x, y: _module(holds, x, y).where(holds, x, y),
    "Cast": _cast,
    "CastLike": _cast,
    "Concat": _concat,
    "ConstantOfShape": _fill,
    "Expand": _expand,
    "Flatten": _flatten,
    "Gather": _gather,
    "Reshape": _reshape,
    "Shape": _shape,
    "Slice": _slice,
    "Split": _split,
    "Squeeze": _squeeze,
    "Tile": _tile,
    "Transpose": _transpose,
    "Unsqueeze": _unsqueeze,
}

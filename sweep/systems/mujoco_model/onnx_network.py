"""ONNX networks as functions that JAX traces.

Numbers have the precision of the engine, whatever the file's: a network in single precision becomes one in double
precision on an engine in double precision.
"""

import functools
import importlib.util
from collections.abc import Callable, Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from sweep.core.errors import InputError
from sweep.systems.mujoco_model.onnx_operators import OPERATORS, OperatorCall

ArrayShape = tuple[int | None, ...]  # of an input or output; None for sizes that may be any
RANDOM_OPERATOR_PREFIXES = (
    "Random",
    "Multinomial",
    "Bernoulli",
)  # what the names of operators begin with that draw random numbers


class Network(NamedTuple):
    """A neural network read from a file, with its inputs and outputs."""

    name: str  # as messages call it
    inputs: Mapping[str, ArrayShape]
    outputs: Mapping[str, ArrayShape]
    metadata: Mapping[str, str]  # what the exporter wrote beside the graph
    evaluate: Callable[[Mapping[str, Any]], dict[str, Any]]  # outputs by name, of inputs by name, in their shapes

    def input_shape(self, name: str) -> tuple[int, ...]:
        """Return the shape of a network input for one rollout; free sizes are 1, except for the last axis."""
        shape = self.inputs[name]
        return tuple(-1 if one is None and k == len(shape) - 1 else (one or 1) for k, one in enumerate(shape))


def read_network(name: str, file: Path) -> Network:
    """Read a network from an ONNX file, or from the cache if the files have not changed.

    Args:
        name: The name that messages give, such as `walk.onnx`.
        file: The file; large weights may lie beside it.

    Returns:
        The network.

    Raises:
        InputError: The file is no network, or has an operator that is not supported.
    """
    changed = max(one.stat().st_mtime_ns for one in network_files(file))
    return _read(name, file, changed)


def network_files(file: Path) -> list[Path]:
    """List the file of an ONNX network and the files of its weights, which are named after it."""
    return [one for one in sorted(file.parent.glob(f"{file.name}*")) if one.is_file()]


@functools.lru_cache(maxsize=4)
def _read(name: str, file: Path, changed: int) -> Network:
    error_prefix = f"model.controller = {name}"
    if importlib.util.find_spec("onnx") is None:
        raise InputError(f"{error_prefix} needs the package onnx: pip install 'insect-sweep[onnx]'")
    import onnx

    try:
        model = onnx.load(file)
        model.graph.node[0]
    except Exception as error:  # protobuf has a class of its own for each kind of fault
        reason = "it has no nodes" if isinstance(error, IndexError) else " ".join(str(error).split())
        raise InputError(f"{error_prefix} is not a readable network: {reason}") from None
    return make_network(name, model, file.parent)


def make_network(name: str, model: Any, folder: Path) -> Network:
    """Make a network that JAX can evaluate from an ONNX model.

    Args:
        name: The name that messages give.
        model: The model, as the package `onnx` has it.
        folder: The folder of weights that are not in the model.

    Raises:
        InputError: The network has an operator that is not supported.
    """
    import onnx

    error_prefix, graph = f"model.controller = {name}", model.graph
    opset = max((one.version for one in model.opset_import if one.domain in ("", "ai.onnx")), default=1)
    constants = {one.name: _as_constant(onnx.numpy_helper.to_array(one, str(folder))) for one in graph.initializer}
    nodes = []
    for node in graph.node:
        attributes = {one.name: _attribute(one) for one in node.attribute}
        if node.op_type == "Constant":
            constants[node.output[0]] = _as_constant(np.asarray(next(iter(attributes.values()))))
            continue
        _require_operator(error_prefix, node)
        if node.op_type == "Cast":
            attributes["to"] = onnx.helper.tensor_dtype_to_np_dtype(attributes["to"])
        nodes.append((node, OperatorCall(node.op_type, attributes, len(node.output), opset)))
    inputs = {one.name: _shape(one) for one in graph.input if one.name not in constants}
    outputs = {one.name: _shape(one) for one in graph.output}

    def evaluate(given: Mapping[str, Any]) -> dict[str, Any]:
        values: dict[str, Any] = {"": None, **constants, **{key: jnp.asarray(one, float) for key, one in given.items()}}
        for node, call in nodes:
            arguments = [values[one] for one in node.input]
            try:
                found = OPERATORS[node.op_type](call, *arguments)
            except InputError as error:
                raise InputError(f"{error_prefix}: {error}") from None
            except (TypeError, ValueError, IndexError) as error:
                reason = " ".join(str(error).split())
                raise InputError(f"{error_prefix}: {node.op_type} {node.name} cannot be computed: {reason}") from None
            found = found if isinstance(found, tuple) else (found,)
            values.update(zip(node.output, found, strict=False))
            values[""] = None
        return {key: values[key] for key in outputs}

    metadata = {one.key: one.value for one in model.metadata_props}
    return Network(name, MappingProxyType(inputs), MappingProxyType(outputs), MappingProxyType(metadata), evaluate)


def vectorize_joint_network(network: Network, recurrent: Mapping[str, str], size: int) -> Callable[[Any, Any], Any]:
    """Turn a network of a single joint into a function of all joints of one rollout.

    Args:
        network: The network. It has one input and one output beside recurrent ones.
        recurrent: Outputs by the input that receives them in the next step.
        size: Number of inputs k of a joint.

    Returns:
        A function of inputs (joints, k) and memory (joints, ...) by name, which returns outputs (joints,) and the next
        memory.

    Raises:
        InputError: The network has other inputs or outputs.
    """
    into = [one for one in network.inputs if one not in recurrent]
    out = [one for one in network.outputs if one not in recurrent.values()]
    unknown = [*({*recurrent} - {*network.inputs}), *({*recurrent.values()} - {*network.outputs})]
    has = ", ".join((*network.inputs, *network.outputs))
    if len(into) != 1 or len(out) != 1 or unknown:
        raise InputError(f"{network.name} has {has}: one input and one output are allowed beside those in recurrent")
    shape = network.input_shape(into[0])
    if shape[-1] not in (-1, size):
        raise InputError(f"{network.name} takes {shape[-1]} numbers: the samples of a joint have {size}")

    def evaluate_joint(numbers: Any, memory: Mapping[str, Any]) -> tuple[Any, dict[str, Any]]:
        found = network.evaluate({into[0]: numbers.reshape(shape), **memory})
        after = {name: found[recurrent[name]].reshape(old.shape).astype(old.dtype) for name, old in memory.items()}
        return found[out[0]].reshape(()).astype(numbers.dtype), after

    return jax.vmap(evaluate_joint)


def make_stateless_policy(network: Network) -> Callable[..., Any]:
    """Make a policy without a state from a network with one input, the observation, and one output, the controls.

    Raises `InputError` where the network has other inputs or outputs.
    """
    error_prefix = f"model.controller = {network.name}"
    if len(network.inputs) != 1 or len(network.outputs) != 1:
        has = ", ".join(f"{key} {shape}" for key, shape in (*network.inputs.items(), *network.outputs.items()))
        beside = f"{Path(network.name).stem}.policy.yaml"
        raise InputError(
            f"{error_prefix} has {has}: one input and one output are allowed, or a file {beside} names them"
        )
    (into,), (out,) = network.inputs, network.outputs
    shape = network.input_shape(into)
    if any(one > 1 for one in shape[:-1]):
        raise InputError(f"{error_prefix} takes {shape[0]} rollouts at a time: allowed are any number, or 1")

    def policy(belief: Any, observation: Any, state: Any, key: Any) -> tuple[Any, Any]:
        if shape[-1] not in (-1, observation.size):
            raise InputError(
                f"{error_prefix} takes {shape[-1]} numbers: {observation.size} are observed (model.observe)"
            )
        return network.evaluate({into: observation.reshape(shape)})[out].reshape(-1), state

    return policy


def _require_operator(error_prefix: str, node: Any) -> None:
    """Raise `InputError` for a node whose operator is not on the list."""
    named = f"{node.domain}.{node.op_type}" if node.domain not in ("", "ai.onnx") else node.op_type
    if node.op_type.startswith(RANDOM_OPERATOR_PREFIXES):
        raise InputError(f"{error_prefix} draws random numbers ({named}): export the policy's mean action instead")
    if named not in OPERATORS:
        known = ", ".join(sorted([*OPERATORS, "Constant"]))
        raise InputError(f"{error_prefix} has the operator {named}, which is not supported (allowed: {known})")


def _as_constant(array: np.ndarray) -> np.ndarray:
    """Return a constant with real numbers in double precision: JAX reduces them to the engine's."""
    return array.astype(float) if array.dtype.kind not in "iub" else array


def _attribute(given: Any) -> Any:
    import onnx

    value = onnx.helper.get_attribute_value(given)
    return onnx.numpy_helper.to_array(value) if isinstance(value, onnx.TensorProto) else value


def _shape(given: Any) -> ArrayShape:
    sizes = given.type.tensor_type.shape.dim
    return tuple(one.dim_value if one.HasField("dim_value") and one.dim_value > 0 else None for one in sizes)

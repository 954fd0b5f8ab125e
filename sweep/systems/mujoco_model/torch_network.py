"""Networks in files of PyTorch, TorchScript (`walk.pt`) or `torch.export` (`walk.pt2`), as functions that JAX traces.

PyTorch converts the network to ONNX when it is first evaluated, and `onnx_network` evaluates that graph: all engines
run the same function, in their own precision. A file is never unpickled.
"""

import functools
import importlib
import importlib.util
import io
import logging
import warnings
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Any

from sweep.core.errors import InputError
from sweep.systems.mujoco_model import onnx_network
from sweep.systems.mujoco_model.onnx_network import ArrayShape, Network

SCRIPT_SUFFIXES, EXPORT_SUFFIX = (".pt", ".pth", ".jit"), ".pt2"
TORCH_SUFFIXES = (*SCRIPT_SUFFIXES, EXPORT_SUFFIX)
PACKAGES = ("torch", "onnx", "onnxscript")  # that the conversion needs
SCRIPT_OPSET = 17  # version of ONNX's operators that TorchScript is converted to


def read_torch_network(name: str, file: Path) -> Network:
    """Read a neural network from a PyTorch file, or from the cache if the file has not changed.

    Args:
        name: The name that messages give, such as `walk.pt`.
        file: The file.

    Returns:
        The network. Its outputs are `output_0`, `output_1`, ... in order. TorchScript does not say which sizes inputs
        have: they count as one row of any number.

    Raises:
        InputError: A package is missing, or the file holds no network of PyTorch.
    """
    return _read(name, file, file.stat().st_mtime_ns)


@functools.lru_cache(maxsize=4)
def _read(name: str, file: Path, changed: int) -> Network:
    error_prefix = f"model.controller = {name}"
    for package in PACKAGES:
        if importlib.util.find_spec(package) is None:
            raise InputError(f"{error_prefix} needs the package {package}: pip install 'insect-sweep[torch]'")
    torch: Any = importlib.import_module("torch")
    logging.getLogger("torch.onnx").setLevel(logging.ERROR)  # else it lists packages that it does not need
    if name.endswith(EXPORT_SUFFIX):
        load, holds = _load_export, "program of torch.export"
        how = f"torch.export.save(torch.export.export(policy, (observation,)), file='{Path(name).name}')"
    else:
        load, holds, how = _load_script, "TorchScript", f"torch.jit.script(policy).save('{Path(name).name}')"
    try:
        with warnings.catch_warnings(action="ignore"):
            network, inputs, outputs = load(torch, file)
    except Exception as error:  # of any class, by what the file is in its place
        reason = " ".join(str(error).split())[:120]
        raise InputError(f"{error_prefix} holds no {holds}: {how} writes one ({reason})") from None
    converted: dict[tuple[tuple[int, ...], ...], Network] = {}

    def evaluate(given: Mapping[str, Any]) -> dict[str, Any]:
        shapes = tuple(tuple(given[key].shape) for key in inputs)
        if shapes not in converted:
            converted[shapes] = _convert(error_prefix, name, torch, network, shapes)
        graph = converted[shapes]
        found = graph.evaluate(dict(zip(graph.inputs, (given[key] for key in inputs), strict=True)))
        return dict(zip(outputs, found.values(), strict=True))

    shapes = dict.fromkeys(outputs, ())
    return Network(name, MappingProxyType(inputs), MappingProxyType(shapes), MappingProxyType({}), evaluate)


def _load_script(torch: Any, file: Path) -> tuple[Callable[..., Any], dict[str, ArrayShape], list[str]]:
    """Load TorchScript: the module, its inputs with shapes, and its outputs."""
    module = torch.jit.load(str(file), map_location="cpu").eval()
    schema = module.forward.schema
    inputs: dict[str, ArrayShape] = {one.name: (None, None) for one in schema.arguments if one.name != "self"}
    (returned,) = schema.returns
    parts = returned.type.elements() if returned.type.kind() == "TupleType" else [returned.type]
    if odd := next((one for one in parts if one.kind() != "TensorType"), None):
        raise ValueError(f"it returns {odd}, and not tensors")
    return module, inputs, [f"output_{k}" for k in range(len(parts))]


def _load_export(torch: Any, file: Path) -> tuple[Any, dict[str, ArrayShape], list[str]]:
    """Load a program of `torch.export`: the program, its inputs with shapes, and its outputs."""
    program = torch.export.load(str(file))
    names = program.graph_signature.user_inputs
    values = {one.name: one.meta["val"] for one in program.graph.nodes if one.op == "placeholder"}
    inputs: dict[str, ArrayShape] = {
        name: tuple(size if type(size) is int else None for size in values[name].shape) for name in names
    }
    return program, inputs, [f"output_{k}" for k in range(len(program.graph_signature.user_outputs))]


def _convert(error_prefix: str, name: str, torch: Any, network: Any, shapes: Sequence[tuple[int, ...]]) -> Network:
    """Convert a network to ONNX for inputs of some shapes. Raises `InputError`."""
    onnx: Any = importlib.import_module("onnx")
    callable_network = network if name.endswith(SCRIPT_SUFFIXES) else network.module()
    dtype = next((one.dtype for one in callable_network.parameters() if one.is_floating_point()), torch.float32)
    given = tuple(torch.full(shape, 0.1, dtype=dtype) for shape in shapes)
    try:
        with torch.no_grad(), warnings.catch_warnings(action="ignore"):
            first, second = (torch.utils._pytree.tree_leaves(callable_network(*given)) for _ in range(2))
            if not all(torch.equal(*both) for both in zip(first, second, strict=True)):
                raise InputError(
                    f"{error_prefix} returns other numbers when it is called again: it keeps a state, or draws random "
                    "numbers. Save it with its state as inputs and outputs (key recurrent), and with its mean action"
                )
            if name.endswith(SCRIPT_SUFFIXES):
                written = io.BytesIO()
                torch.onnx.export(network, given, written, dynamo=False, opset_version=SCRIPT_OPSET)
                model = onnx.load_model_from_string(written.getvalue())
            else:
                model = torch.onnx.export(network, dynamo=True, verbose=False).model_proto
    except InputError:
        raise
    except Exception as error:  # of any class: wrong sizes, or an operator that ONNX does not have
        reason = " ".join(str(error).split())[:200]
        raise InputError(f"{error_prefix} cannot be evaluated for inputs {[*shapes]}: {reason}") from None
    return onnx_network.make_network(name, model, Path())

"""A controller that was trained elsewhere: a network in a file of ONNX, run by onnxruntime (extra `onnx`)."""

import functools
import importlib.util
from collections.abc import Callable
from typing import Any

import numpy as np

from sweep.core.errors import InputError

TYPES = {"tensor(float)": np.float32, "tensor(double)": np.float64}


@functools.lru_cache(maxsize=2)
def policy(name: str, file: str, changed: int) -> Callable[[np.ndarray], np.ndarray]:
    """From observations (n, k) to the network's output (n, m). Raises `InputError`.

    `name` is what users call it; `changed` tells a file from what it was before.
    """
    told = f"model.controller = {name}"
    if importlib.util.find_spec("onnxruntime") is None:
        raise InputError(f"{told} needs onnxruntime: pip install 'insect-sweep[onnx]'")
    import onnxruntime

    options = onnxruntime.SessionOptions()
    # with several threads a row's last bits depend on where it is in a batch
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    options.log_severity_level = 4  # what is wrong is told below
    try:
        session = onnxruntime.InferenceSession(file, options, providers=["CPUExecutionProvider"])
    except Exception as error:  # it has a class of its own for each kind of fault
        raise InputError(f"{told} is no network: {' '.join(str(error).split())}") from None
    into, out = session.get_inputs(), session.get_outputs()
    if len(into) != 1 or len(out) != 1 or into[0].type not in TYPES or len(into[0].shape) != 2:
        has = ", ".join(f"{one.name} {_form(one)}" for one in (*into, *out))
        raise InputError(f"{told} has {has}: one input (n, k) of numbers and one output (n, m) are wanted")
    rows, size = into[0].shape
    if rows not in (None, 1) and not isinstance(rows, str):
        raise InputError(f"{told} takes {rows} rollouts at a time: any number, or 1, is wanted")

    def of_rows(seen: np.ndarray) -> np.ndarray:
        return session.run(None, {into[0].name: seen.astype(TYPES[into[0].type])})[0]  # pyright: ignore[reportReturnType]

    def network(seen: np.ndarray) -> np.ndarray:
        if isinstance(size, int) and size != seen.shape[1]:
            raise InputError(f"{told} takes {size} numbers: {seen.shape[1]} are observed (model.observe)")
        return np.concatenate([of_rows(row[None]) for row in seen]) if rows == 1 else of_rows(seen)

    return network


def _form(value: Any) -> str:
    return f"({', '.join(str(n) for n in value.shape)}) {value.type}"

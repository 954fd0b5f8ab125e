"""Every formula against an independent numerical reference (quadrature, ODE, LP)."""

import json
from pathlib import Path

import jax
import numpy as np
import pytest

from sweep.formulas import FORMULAS, evaluate, find_formula

ORACLE = json.loads((Path(__file__).parent.parent / "data" / "oracle.json").read_text())
DOUBLE_ONLY = ("raft_ode",)


def assert_close(outputs, expected, tolerance, inputs):
    assert outputs.keys() == expected.keys()
    for name, value in expected.items():
        atol, rtol = tolerance["abs"], tolerance["rel"]
        np.testing.assert_allclose(outputs[name], value, rtol=rtol, atol=atol, err_msg=f"{name} of {inputs}")


@pytest.mark.parametrize("name", ORACLE)
def test_public_vectors(name):
    for case in ORACLE[name]["cases"]:
        assert_close(evaluate(name, case["in"]), case["out"], ORACLE[name]["tol64"], case["in"])


@pytest.mark.parametrize("name", [name for name in ORACLE if name not in DOUBLE_ONLY])
def test_public_vectors_in_single_precision(name):
    with jax.enable_x64(False):
        for case in ORACLE[name]["cases"]:
            outputs = find_formula(name).evaluate_to_arrays(case["in"])
            assert not any(value.dtype == np.float64 for value in outputs.values())
            assert_close(outputs, case["out"], ORACLE[name]["tol32"], case["in"])


@pytest.mark.parametrize("name", FORMULAS)
def test_defaults_are_a_valid_example(name):
    outputs = evaluate(name, {})
    assert list(outputs) == list(FORMULAS[name].outputs)

"""The thesis' leg against its own definitions and brute force."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sweep.formulas import NoSolution, evaluate
from sweep.formulas.thesis import thesis_fk, thesis_ik, thesis_ik_euler

LINKS = (1.0, 1.0, 2.0)
ZONE = {"OA": 1.0, "OB": 3.7071067811865475, "phimax": 0.7762790307403773}


def test_jacobian_and_determinant():
    with jax.enable_x64(True):
        angles = jnp.array([0.3, 0.8, -2.0])
        leg = thesis_fk(angles[0], angles[1], angles[2], *LINKS)
        jacobian = jax.jacfwd(lambda q: thesis_fk(q[0], q[1], q[2], *LINKS).foot)(angles)
        np.testing.assert_allclose(leg.J, jacobian, atol=1e-14)
        assert leg.det == pytest.approx(np.linalg.det(leg.J))
        np.testing.assert_allclose(thesis_ik(leg.foot, *LINKS), angles, atol=1e-12)


def test_euler_inverse_has_an_error_of_first_order():
    with jax.enable_x64(True):
        errors = []
        for steps in (50, 100, 200):
            s = jnp.linspace(0, 1, steps + 1)[:, None]
            path = jnp.array([1.7, -0.6, -1.29]) + s * jnp.array([0.2, 1.2, 0.0])
            exact = jax.jit(thesis_ik)(path, *LINKS)
            errors.append(float(jnp.abs(jax.jit(thesis_ik_euler)(exact[0], path, *LINKS) - exact).max()))
    assert errors[0] < 0.02
    np.testing.assert_allclose(np.array(errors[:-1]) / errors[1:], 2, rtol=0.1)


@pytest.mark.parametrize("z", [-2.9, -1.29, -0.5, 0.5, 1.6, 1.8, 2.5])
def test_radii_of_the_workspace_are_those_of_the_reachable_points(z):
    psi = np.linspace(0, np.pi, 4001)
    reach = np.linspace(0, 4, 4001)
    knee = np.stack([1 + np.cos(psi), np.sin(psi)])
    # The shin ends at height z on either side of the knee; feet stay outside the thigh's joint.
    height = z - knee[1]
    offset = np.sqrt(np.where(np.abs(height) <= 2, 4 - height**2, np.nan))
    radii = np.concatenate([knee[0] + offset, knee[0] - offset])
    radii = radii[radii >= 1]
    zone = evaluate("thesis_workspace", {"z": z})
    assert zone["OB"] == pytest.approx(radii.max() if z > 0 else 1 + np.sqrt(9 - z**2), abs=1e-3)
    reachable = [np.hypot(r - 1, z) >= 1 and np.hypot(r - 1, z) <= 3 and r >= 1 for r in reach]
    assert zone["OA"] >= reach[np.flatnonzero(reachable)[0]] - 2e-3
    if z > 0:
        assert zone["OA"] == pytest.approx(radii.min(), abs=1e-2)


def test_example_of_the_thesis():
    zone = evaluate("thesis_workspace", {})
    np.testing.assert_allclose([zone[name] for name in ZONE], list(ZONE.values()), rtol=1e-9)
    np.testing.assert_allclose(evaluate("thesis_fk", {})["foot"], [1.70710678, 0, -1.29289322], atol=1e-8)
    with pytest.raises(NoSolution, match="l3 greater than l2"):
        evaluate("thesis_workspace", {"z": -3.5})


@settings(max_examples=60, deadline=None)
@given(st.floats(0.02, 0.98), st.floats(-0.98, 0.98), st.floats(0, 2 * np.pi), st.sampled_from([0.6, 0.776, 1.4, 2.0]))
def test_steps_are_those_of_a_march(share, turn, heading, phimax):
    zone = {**ZONE, "phimax": phimax}
    radius, angle = ZONE["OA"] + share * (ZONE["OB"] - ZONE["OA"]), turn * phimax
    r0 = radius * np.array([np.sin(angle), np.cos(angle)])
    p = np.array([np.cos(heading), np.sin(heading)])
    length = np.linspace(0, 8, 80001)
    x, y = r0[:, None] + length * p[:, None]
    r = np.hypot(x, y)
    inside = (r >= ZONE["OA"]) & (r <= ZONE["OB"]) & (np.abs(np.arctan2(x, y)) <= phimax)
    step = evaluate("thesis_step", {"r0": r0.tolist(), "p": (2 * p).tolist(), **zone})
    exits = length[np.flatnonzero(inside[:-1] & ~inside[1:])]
    # A march may step over a corner that the line only grazes.
    assert min(abs(exits - step["support"])) < 2e-4
    assert step["support"] <= exits[0] + 2e-4
    assert step["transfer"] >= exits[-1] - 2e-4
    assert min(abs(exits - step["transfer"])) < 2e-4


def test_start_outside_is_refused():
    with pytest.raises(NoSolution, match="r0 must lie in the sector"):
        evaluate("thesis_step", {"r0": [0, 0.5], "p": [1, 0], **ZONE})

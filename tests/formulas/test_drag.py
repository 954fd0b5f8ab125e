"""The drag's one form: against quadrature, for vanishing slopes, and in its derivatives."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from sweep.formulas.drag import drag_integrals, raft_drag

SPEED = st.floats(-3, 3)
JITTED = jax.jit(drag_integrals)
INTEGRALS = jax.jit(jax.vmap(lambda u: drag_integrals(u[0], u[1], u[2], 1.0, 1.0)))
GRADIENT = jax.jit(jax.jacrev(lambda u: drag_integrals(u[0], u[1], u[2], 1.0, 1.0)))


def quadrature(c, al, be, A, B, panels=120):
    """By many panels of two Gauss nodes each way."""
    edges = np.linspace(-1, 1, panels + 1)
    node = (edges[1] - edges[0]) / 2 / np.sqrt(3)
    t = np.concatenate([(edges[1:] + edges[:-1]) / 2 - node, (edges[1:] + edges[:-1]) / 2 + node])
    x, y = A * t[:, None], B * t[None, :]
    u = c + al * x + be * y
    f = np.abs(u) * u * A * B / panels**2
    return f.sum(), (x * f).sum(), (y * f).sum()


@settings(max_examples=30, deadline=None)
@given(SPEED, SPEED, SPEED, st.floats(0.05, 2), st.floats(0.05, 2))
@example(0.0, 0.0, 0.0, 1.0, 1.0)
@example(1.0, 1.0, 0.0, 1.0, 1.0)
@example(0.5, 1e-9, -2.0, 0.7, 1.3)
def test_is_the_quadrature(c, al, be, A, B):
    with jax.enable_x64(True):
        exact = np.array(JITTED(c, al, be, A, B))
    scale = A * B * (abs(c) + abs(al) * A + abs(be) * B) ** 2
    np.testing.assert_allclose(exact, quadrature(c, al, be, A, B), atol=1e-4 * scale * max(1, A, B))


@pytest.mark.parametrize(("double", "precision"), [(True, 1e-14), (False, 1e-6)])
def test_a_vanishing_slope_keeps_its_precision(double, precision):
    c, A, B = -0.7, 1.3, 0.4
    with jax.enable_x64(double):
        slopes = jnp.logspace(-30, -5, 26)
        along, across = JITTED(c, slopes, 0.0, A, B), JITTED(c, 0.0, slopes, A, B)
    np.testing.assert_allclose(along.Ix, 8 / 3 * A**3 * B * abs(c) * np.array(slopes), rtol=precision)
    np.testing.assert_allclose(across.Iy, 8 / 3 * A * B**3 * abs(c) * np.array(slopes), rtol=precision)


@pytest.mark.parametrize("c", [0.0, 0.3, 1.0])
@pytest.mark.parametrize("al", [0.0, 0.5, 1e-20])
@pytest.mark.parametrize("be", [0.0, -0.5])
def test_gradients_are_finite_and_right(c, al, be):
    with jax.enable_x64(True):
        point = jnp.array([c, al, be])
        gradient = np.stack(GRADIENT(point))
        steps = 1e-4 * jnp.eye(3)
        ahead, behind = (np.stack(INTEGRALS(point + side * steps)) for side in (1, -1))
    np.testing.assert_allclose(gradient, (ahead - behind) / 2e-4, atol=1e-3)


def test_drag_at_rest_has_a_finite_derivative():
    parts = {"a": 1.575, "b": 1.05, "d": 0.105, "zeta0": 0.0, "k_lin": 20.0, "k_quad": 500.0}
    jacobian = jax.jit(jax.jacrev(lambda motion: raft_drag(motion[:3], motion[3:], **parts)))(jnp.zeros(6))
    assert np.isfinite(jacobian.R).all()
    assert jacobian.R[0, 0] == pytest.approx(-4 * 20 * 1.575 * 1.05)

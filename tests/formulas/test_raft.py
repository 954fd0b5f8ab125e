"""The raft: pressure, first integrals, corrected coefficients, coasting."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from raft_laws import energy, vertical_momentum
from scipy.integrate import solve_ivp

from sweep.formulas import NoSolution, evaluate
from sweep.formulas.raft_dynamics import RaftBody, integrate_dormand_prince, raft_linear, raft_ode, state_derivative

A, B, D, GAMMA = 1.575, 1.05, 0.105, 9810.0
WEIGHT = 4 * GAMMA * A * B * 0.1


def raft(**changes):
    values = {
        "a": A, "b": B, "d": D, "gamma": GAMMA, "zeta0": 0.1 - D, "k_lin": 20.0, "k_quad": 500.0,
        "P": WEIGHT, "M": WEIGHT / 9.81, "J": jnp.array([245.0, 550.0, 790.0]), "rs": jnp.array([0.02, -0.01, 0.05]),
    }  # fmt: skip
    return RaftBody(**{**values, **changes})


def state(tilt=(0.0, 0.0), z=0.005, v=(0.3, -0.2, 0.1), w=(0.05, -0.04, 0.2)):
    tilted = evaluate("raft_equilibrium", {"P": WEIGHT, "r_s": [*tilt, 0.0], "a": A, "b": B, "d": D, "gamma": GAMMA})
    a31, a32, a33 = tilted["a31"], tilted["a32"], tilted["a33"]
    rows = np.array(
        [
            [1 - a31**2 / (1 + a33), -a31 * a32 / (1 + a33), -a31],
            [-a31 * a32 / (1 + a33), 1 - a32**2 / (1 + a33), -a32],
            [a31, a32, a33],
        ]
    )
    return jnp.concatenate([jnp.array([0.0, 0.0, z]), rows.ravel(), jnp.array(v), jnp.array(w)])


def test_buoyancy_is_the_sum_of_the_water_columns():
    a31, a32, depth = 0.03, -0.02, 0.01
    a33 = np.sqrt(1 - a31**2 - a32**2)
    nodes, weights = np.polynomial.legendre.leggauss(4)
    x, y = np.meshgrid(A * nodes, B * nodes, indexing="ij")
    weight = A * B * np.outer(weights, weights)
    top = (depth - a31 * x - a32 * y) / a33
    columns = GAMMA * (top + D) * weight
    a3 = np.array([a31, a32, a33])
    moments = np.cross(np.stack([x, y, (top - D) / 2], axis=-1), a3) * columns[..., None]
    water = evaluate("hydro", {"a31": a31, "a32": a32, "depth": depth, "a": A, "b": B, "d": D, "gamma": GAMMA})
    np.testing.assert_allclose(water["F"], columns.sum() * a3, rtol=1e-12)
    np.testing.assert_allclose(water["M"], moments.sum((0, 1)), rtol=1e-9)


def test_equilibrium_is_at_rest():
    with jax.enable_x64(True):
        r_s = [0.04, -0.03, 0.06]
        start = state(tilt=r_s[:2], v=(0, 0, 0), w=(0, 0, 0))
        rest = evaluate("raft_equilibrium", {"P": WEIGHT, "r_s": r_s, "a": A, "b": B, "d": D, "gamma": GAMMA})
        a31, a32, a33, depth = rest.values()
        start = start.at[2].set(-depth).at[9:12].set(jnp.array([a31, a32, a33]))
        acceleration = jax.jit(state_derivative)(raft(rs=jnp.array(r_s)), start)[12:]
    np.testing.assert_allclose(acceleration[3:], 0, atol=1e-9)


def test_overloaded_raft_is_refused():
    with pytest.raises(NoSolution, match="must be stable"):
        evaluate("raft_equilibrium", {"P": WEIGHT, "r_s": [0, 0, 5.0]})
    assert evaluate("raft_modes", {"rs": [0, 0, 5.0]})["stable"] is False


def test_energy_and_vertical_momentum():
    with jax.enable_x64(True):
        calm, wet = raft(k_lin=0.0, k_quad=0.0), raft()
        start = state()
        free, braked = raft_ode(calm, start, 2.0).state, raft_ode(wet, start, 2.0).state
        assert energy(calm, free) == pytest.approx(float(energy(calm, start)), rel=1e-9)
        assert energy(wet, braked) < energy(wet, start) - 1
        centred = raft(k_lin=0.0, k_quad=0.0, rs=jnp.array([0.0, 0.0, 0.05]))
        end = raft_ode(centred, start, 2.0).state
        momentum = float(vertical_momentum(centred, start))
        assert vertical_momentum(centred, end) == pytest.approx(momentum, rel=1e-8)
        rotation = end[3:12].reshape(3, 3)
        np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-8)


def test_linearisation_has_the_corrected_coefficients():
    with jax.enable_x64(True):
        parts = raft(k_quad=0.0)
        matrix = np.array(raft_linear(parts).matrix)
    ab, (x_s, y_s, z_s) = A * B, np.array(parts.rs)
    stiffness = evaluate("hydro_thick", {"a": A, "b": B, "d": D, "zeta0": parts.zeta0, "gamma": GAMMA})
    expected = np.zeros((6, 12))
    expected[2, 2] = -4 * GAMMA * ab
    expected[3, 3] = WEIGHT * z_s - stiffness["k_roll"]
    expected[4, 4] = WEIGHT * z_s - stiffness["k_pitch"]
    expected[5, 3:5] = -WEIGHT * x_s, -WEIGHT * y_s
    friction = 4 * 20 * ab
    expected[0, 6] = expected[1, 7] = -friction
    expected[0, 10] = expected[4, 6] = friction * D
    expected[1, 9] = expected[3, 7] = -friction * D
    expected[3, 9] = expected[4, 10] = -friction * D**2
    expected[5, 11] = -friction * (A**2 + B**2) / 3
    np.testing.assert_allclose(matrix, expected, atol=1e-8)


def test_verdicts_on_steady_motion():
    assert evaluate("raft_tow", {"x_s": 1.5})["yaw_pole"] < 0
    assert evaluate("raft_tow", {"x_s": -1.5})["yaw_pole"] > 0
    assert evaluate("raft_modes", {})["stable"] is True
    push = {"F_x": 50.0, "F_y": -30.0, "F_z": -WEIGHT, "M_x": 20.0, "M_y": -10.0, "k_lin": 20.0}
    steady = evaluate("raft_push", push)
    stiffness = evaluate("hydro_thick", {"zeta0": 0.1 - D})
    h15 = 4 * 20 * A * B
    balance = [
        push["F_x"] + push["F_z"] * steady["pitch"] - h15 * steady["speed_x"],
        push["F_y"] - push["F_z"] * steady["roll"] - h15 * steady["speed_y"],
        push["M_x"] - stiffness["k_roll"] * steady["roll"] - h15 * D * steady["speed_y"],
        push["M_y"] - stiffness["k_pitch"] * steady["pitch"] + h15 * D * steady["speed_x"],
    ]
    np.testing.assert_allclose(balance, 0, atol=1e-9)


@pytest.mark.parametrize("h", [0.15, -0.02, 1e-6])
def test_crossing_is_the_coasting_of_the_raft(h):
    inputs = {"S": 5.5, "sigma": 3.0, "v_eps": 0.1, "mt": 600.0, "al2": 150.0, "J": 700.0, "al3": 90.0, "h": h}
    result = evaluate("crossing", inputs)

    def drag(t, s):
        _, v, _, w = s
        return [v, -150 / 600 * abs(v) * v, w, -90 / 700 * abs(w) * w]

    start = [0, result["v0"], 0, result["w0"]]
    end = solve_ivp(drag, (0, result["time"]), start, rtol=1e-11, atol=1e-13).y[:, -1]
    np.testing.assert_allclose(end[:3], [2.5, 0.1, result["yaw"]], rtol=1e-8)


def test_the_integrator_keeps_its_accuracy_and_says_where_it_does_not_arrive(double):
    start, sought = jnp.array([1.0, 0.0]), 1e-9
    swing = integrate_dormand_prince(lambda y: jnp.stack([y[1], -y[0]]), start, 10.0, sought)
    np.testing.assert_allclose(swing, [np.cos(10.0), -np.sin(10.0)], atol=100 * sought)
    assert np.isnan(integrate_dormand_prince(lambda y: y**2, jnp.ones(1), 2.0, sought)).all()  # infinite at 1

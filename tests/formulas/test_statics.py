"""Corner, pole and ladder against the balance of forces, and linear programmes over all equilibria."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import linprog

from sweep.formulas import NoSolution, evaluate

PSI, EPS, MARGIN = st.floats(0, 1.2), st.floats(0.05, 1.2), st.floats(0.02, 1)


def four_feet(psi, eps):
    """Places and outward normals of two lower and two upper feet one apart, the weight at eps from their line."""
    places = np.array([[-1, 0, 0], [1, 0, 0], [-1, 0, 1], [1, 0, 1]], float)
    side = places[:, 0]
    normals = np.stack([side * np.cos(psi), np.full(4, np.sin(psi)), np.zeros(4)], axis=1)
    tangents = np.stack([-side * np.sin(psi), np.full(4, np.cos(psi)), np.zeros(4)], axis=1)
    return places, normals, tangents, np.array([0, eps, 0])


def residual(psi, eps, forces):
    """Force and moment left over, in P."""
    places, _, _, centre = four_feet(psi, eps)
    weight = np.array([0, 0, -1])
    return np.concatenate([forces.sum(0) + weight, np.cross(places, forces).sum(0) + np.cross(centre, weight)])


def least_squeeze(psi, eps, k, sides=180):
    """Least normal force over all equilibria with polygons for friction discs."""
    places, normals, tangents, centre = four_feet(psi, eps)
    balance = np.zeros((6, 13))
    for i in range(4):
        for j, direction in enumerate((normals[i], tangents[i], np.array([0, 0, 1]))):
            balance[:, 3 * i + j] = np.concatenate([direction, np.cross(places[i], direction)])
    load = np.concatenate([[0, 0, 1], np.cross(centre, [0, 0, 1])])
    rows = []
    for i in range(4):
        for angle in np.arange(sides) * 2 * np.pi / sides:
            row = np.zeros(13)
            row[3 * i : 3 * i + 3] = -k, np.cos(angle), np.sin(angle)
            rows.append(row)
        row = np.zeros(13)
        row[3 * i], row[12] = 1, -1
        rows.append(row)
    bounds = [(0, None), (None, None), (None, None)] * 4 + [(0, None)]
    return linprog(np.eye(13)[12], np.array(rows), np.zeros(len(rows)), balance, load, bounds).fun


@settings(max_examples=40, deadline=None)
@given(PSI, EPS, MARGIN)
def test_both_schemes_balance_at_the_limit_of_friction(psi, eps, margin):
    k = np.tan(psi) + margin
    _, normals, tangents, _ = four_feet(psi, eps)
    up = np.array([0, 0, 1])
    balanced = evaluate("corner_balanced", {"psi": psi, "eps": eps, "k": k})
    equal = evaluate("corner_equalN", {"psi": psi, "eps": eps, "k": k})
    schemes = (
        (balanced["N_d"], balanced["N_u"], balanced["k_tau"], -balanced["k_tau"], balanced["k_zeta"]),
        (equal["N"], equal["N"], equal["k_tau_d"], equal["k_tau_u"], equal["k_zeta"]),
    )
    squeeze = evaluate("corner_min_squeeze", {"psi": psi, "eps": eps, "k": k})["Nhat"]
    for lower, upper, tau_lower, tau_upper, zeta in schemes:
        N, tau = np.array([lower, lower, upper, upper]), np.array([tau_lower, tau_lower, tau_upper, tau_upper])
        forces = N[:, None] * (normals + tau[:, None] * tangents + zeta * up)
        np.testing.assert_allclose(residual(psi, eps, forces), 0, atol=1e-9 * max(1, upper))
        assert max(np.hypot(tau, zeta)) == pytest.approx(k)
        assert squeeze <= max(N) * (1 + 1e-9)
    friction = evaluate("corner_least_friction", {"psi": psi, "eps": eps, "squeeze": balanced["N_u"]})
    assert friction["k"] == pytest.approx(k)


@pytest.mark.parametrize(
    ("psi", "eps", "k"),
    [(np.pi / 4, 0.4, 1.1), (0, 1.1, 1), (0.5, 0.1, 0.6), (0.5, 1.0, 0.6), (0.3, 0.5, 1.0), (1.0, 0.2, 2.5)],
)
def test_least_squeeze_is_that_of_the_linear_programme(psi, eps, k):
    squeeze = evaluate("corner_min_squeeze", {"psi": psi, "eps": eps, "k": k})["Nhat"]
    assert squeeze == pytest.approx(least_squeeze(psi, eps, k), rel=3e-4)


def test_printed_examples():
    corner = {"psi": np.pi / 4, "eps": 0.4, "k": 1.1}
    assert evaluate("corner_balanced", corner)["N_u"] == pytest.approx(3.1606, abs=1e-4)
    assert evaluate("corner_equalN", corner)["N"] == pytest.approx(2.9257, abs=1e-4)
    assert evaluate("corner_min_squeeze", corner)["Nhat"] == pytest.approx(np.sqrt(8))
    assert evaluate("corner_balanced", {"psi": 0, "eps": 1.1, "k": 1})["N_u"] == pytest.approx(np.sqrt(5.84) / 4)
    with pytest.raises(NoSolution, match=r"k = 0\.99: k must be greater than tan\(psi\)"):
        evaluate("corner_balanced", {**corner, "k": 0.99})


@settings(max_examples=40, deadline=None)
@given(st.floats(0.2, 1.9), st.floats(0.05, 1.5), st.floats(0.05, 1.5))
def test_ladder_is_the_linear_programme(phi, f1, f2):
    # N1, F1, N2, F2, chi with P = 1
    balance = [[1, 0, 0, 1, 0], [0, 1, 1, 0, 0], [0, 0, np.sin(phi), np.cos(phi), -np.cos(phi)]]
    cones = [[-f1, 1, 0, 0, 0], [-f1, -1, 0, 0, 0], [0, 0, -f2, 1, 0], [0, 0, -f2, -1, 0]]
    bounds = [(0, None), (None, None), (0, None), (None, None), (0, 1)]
    best = linprog([0, 0, 0, 0, -1], cones, np.zeros(4), balance, [1, 0, 0], bounds)
    holds = evaluate("ladder", {"phi": phi, "f1": f1, "f2": f2})
    assert holds["chi_max"] == pytest.approx(-best.fun, abs=1e-6)
    assert holds["holds_for_all"] == (np.cos(phi) > 0 and np.tan(phi) >= 1 / f1)
    if 0 < holds["chi_max"] < 1 and np.cos(phi) > 0:
        least = evaluate("ladder_lean", {"f1": f1, "f2": f2, "chi": holds["chi_max"]})
        assert least["phi"] == pytest.approx(phi, abs=1e-5)

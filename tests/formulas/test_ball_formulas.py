"""The ball: shapes by quadrature, climbing against the equation of motion, reach against its geometry."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import quad, solve_ivp
from scipy.optimize import brentq

from sweep.formulas import NoSolution, evaluate

BALL = {"m": 16.0, "M": 40.0, "R": 0.84, "rho": 1.1}
G = 9.81


def integral(name, output, T, **inputs):
    return quad(lambda tau: evaluate(name, {"T": T, "tau": tau, **inputs})[output], 0, T, limit=200)[0]


def test_shapes_have_the_integrals_that_stop_the_ball():
    assert integral("stabilise_delta", "delta", 2.0, Delta=0.3) == pytest.approx(2.0, abs=1e-6)
    assert integral("stabilise_delta", "pulse", 2.0, Delta=0.3) == pytest.approx(1.7, abs=1e-6)
    assert integral("stabilise_delta", "pulse_integral_T", 2.0, Delta=0.3) == pytest.approx(2.0, abs=1e-6)
    assert integral("lateral_mu", "mu", 2.0) == pytest.approx(3.0, abs=1e-6)


def test_overshoot_is_the_golden_ratio():
    peak = max(evaluate("stabilise_delta", {"T": 1, "tau": tau})["delta"] for tau in np.linspace(0.5, 0.7, 401))
    assert peak == pytest.approx((1 + np.sqrt(5)) / 2, abs=1e-5)


def test_ball_rate_is_that_of_the_equation_of_motion():
    m, M, R, rho = BALL.values()
    phi0, phi1, dphi, omega0 = 0.3, 1.4, 0.9, 2.0

    def momentum_balance(t, omega):
        phi = phi0 + dphi * t
        return -(G + dphi**2 * R) * m * rho * np.cos(phi) / (7 / 5 * M * R**2 + m * R**2 + m * R * rho * np.sin(phi))

    end = solve_ivp(momentum_balance, (0, (phi1 - phi0) / dphi), [omega0], rtol=1e-10, atol=1e-12).y[0, -1]
    inputs = {**BALL, "phi0": phi0, "phi1": phi1, "dphi": dphi, "omega0": omega0}
    assert evaluate("ball_omega", inputs)["omega"] == pytest.approx(end, abs=1e-8)


@given(st.floats(0.1, 1.5))
@settings(max_examples=20, deadline=None)
def test_a_climb_ends_on_a_ball_at_rest_and_a_descent_is_its_reverse(phi):
    climb = evaluate("ball_climb", {**BALL, "phi0": phi})
    move = {**BALL, "phi0": phi, "phi1": np.pi / 2}
    end = evaluate("ball_omega", {**move, "dphi": climb["dphi"], "omega0": climb["omega0"]})
    assert end["omega"] == pytest.approx(0, abs=1e-9)
    least = evaluate("ball_omega", {**move, "dphi": climb["dphi_opt"], "omega0": climb["v0_min"] / BALL["R"]})
    assert least["omega"] == pytest.approx(0, abs=1e-9)
    gain = evaluate("ball_descent", {**BALL, "phi": phi})["gain"]
    assert gain == pytest.approx(climb["v0_min"] / BALL["R"])


@pytest.mark.parametrize("k_f", [0.0, 0.3, 0.7, 1.0])
def test_largest_ball_is_the_largest_root_of_the_geometry(k_f):
    l1, l2, hhat, b = 0.52, 0.335, 1.2, 0.4

    def gap(R):
        above = (R + np.sqrt(R**2 - (1 + k_f**2) * b**2 / 4)) / (1 + k_f**2)
        foot, section = np.array([k_f * above, above - R]), np.sqrt(R**2 - b**2 / 4)
        knee = foot + l2 / section * np.array([foot[1], -foot[0]])  # the shin touches the ball
        return np.linalg.norm(knee - [R, hhat - R]) - l1

    radii = np.linspace(0.4, 6, 5000)
    signs = np.sign([gap(R) for R in radii])
    last = np.flatnonzero(np.diff(signs))[-1]
    expected = brentq(gap, radii[last], radii[last + 1], xtol=1e-13)
    found = evaluate("max_ball", {"l1": l1, "l2": l2, "hhat": hhat, "b": b, "k_f": k_f})["R"]
    assert found == pytest.approx(expected, rel=1e-9)


def test_largest_balls_of_the_book():
    size = {"l1": 0.52, "l2": 0.335, "hhat": 1.71, "b": 0.0}
    assert evaluate("max_ball", {**size, "k_f": 0})["R"] == pytest.approx(0.855)
    assert evaluate("max_ball", {**size, "k_f": 1})["R"] == pytest.approx(3 * 0.855)
    with pytest.raises(NoSolution, match="hhat must be in reach"):
        evaluate("max_ball", {**size, "hhat": 9, "k_f": 0})


def test_exact_turn_tends_to_the_printed_one_for_wide_turns():
    wide = evaluate("ball_turn", {"phi": 1e-4, "v": 1.0})
    assert wide["rho_exact"] == pytest.approx(wide["rho_approx"], rel=1e-6)
    assert evaluate("ball_turn", {"phi": -0.2})["rho_exact"] == -evaluate("ball_turn", {"phi": 0.2})["rho_exact"]
    with pytest.raises(NoSolution, match="steady turn"):
        evaluate("ball_turn", {"phi": 0.0})


@pytest.mark.parametrize(("phi", "dphi"), [(0.2, 0.5), (-0.3, 0.4), (0.5, -1.0), (0.1, 0.0)])
def test_swerve_balances_momentum(phi, dphi):
    """Robot and ball about the point of contact, which goes with the ball: (3.1.23) to (3.1.25), nothing expanded."""
    m, M, R, h, v, J_r, J_zeta, up = 16.0, 40.0, 0.84, 0.3, 0.5, 1.0, 1.5, np.array([0, 0, 1.0])
    swerve = {"m": m, "M": M, "R": R, "h": h, "v": v, "J_r": J_r, "J_zeta": J_zeta}
    found = evaluate("ball_swerve", {**swerve, "phi": phi, "dphi": dphi})
    turning = v / found["rho_phi"]

    def at(t):
        lean, way, speed = phi + dphi * t, turning * t, v + found["gain"] * dphi * t
        ahead = np.array([np.cos(way), np.sin(way), 0.0])
        aside = np.cross(up, ahead)
        centre = (h + R) * (up * np.cos(lean) + aside * np.sin(lean))
        moves = dphi * (h + R) * (aside * np.cos(lean) - up * np.sin(lean)) + speed * ahead
        own = 7 / 5 * M * R * speed * aside - J_r * dphi * ahead + J_zeta * turning * up
        return own + m * np.cross(R * up + centre, moves), m * moves, centre, speed * ahead

    step = 1e-6
    changes = (at(step)[0] - at(-step)[0]) / (2 * step)
    _, momentum, centre, goes = at(0.0)
    left = changes + np.cross(goes, momentum) - np.cross(centre, -m * G * up)
    np.testing.assert_allclose(left[:2], 0, atol=1e-7)
    spun = 2 / 5 * M * R**2 * found["omega_zeta"] + J_zeta * turning
    assert spun == pytest.approx(0, abs=1e-12)
    if dphi == 0:
        steady = evaluate("ball_turn", {"m": m, "M": M, "R": R, "h": h, "v": v, "phi": phi})
        assert found["rho_phi"] == pytest.approx(steady["rho_approx"])


def test_body_keeps_its_length_and_its_middle_the_line():
    ds, s0, Rp, a_r, eps = 0.3, -0.3, 0.9, 1.05, 0.1
    turn = evaluate("body_turn", {"ds": ds, "s0": s0, "Rp": Rp, "a_r": a_r, "eps": eps})
    front, mid, rear = (np.array(turn[name]) for name in ("d_front", "d_mid", "d_rear"))
    assert np.linalg.norm(mid - front + np.array([a_r / 2, 0])) == pytest.approx(a_r / 2)
    np.testing.assert_allclose(front + rear, 2 * mid, atol=1e-15)
    assert mid[1] / mid[0] == pytest.approx(-np.tan(eps))
    arc = Rp * np.array([np.cos(s0 + ds) - np.cos(s0), np.sin(s0 + ds) - np.sin(s0)])
    np.testing.assert_allclose(front, arc, atol=1e-12)


def test_mass_centre_follows_a_robot_with_light_legs():
    np.testing.assert_allclose(evaluate("ball_jacobian", {"m1": 1e-9, "m2": 1e-9})["D"], np.eye(3), atol=1e-8)
    share = np.array(evaluate("ball_jacobian", {})["D"])
    assert np.all((np.diag(share) > 0.5) & (np.diag(share) < 1))

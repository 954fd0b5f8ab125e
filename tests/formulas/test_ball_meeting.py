"""Balls that meet: each formula against its equation of motion, integrated."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from sweep.formulas import NoSolution, evaluate

G = 9.81
BALL = {"M": 400.0, "R": 0.84}


def test_a_ball_at_its_least_speed_comes_as_far_as_it_shall():
    m, rho, k_v, f_s, t, delta = 16.7, 1.1, 0.6, 4e-4, 20.0, 0.5
    given = {**BALL, "m": m, "rho": rho, "k_v": k_v, "f_s": f_s, "t": t, "delta": delta}
    v = evaluate("ball_approach", given)["v"]

    def motion(_, state):
        ahead = k_v * (v - state[1])  # of the mass centre
        moment = G * (m * ahead - f_s * (m + BALL["M"]))
        return state[1], moment / (7 / 5 * BALL["M"] * BALL["R"] + m * (BALL["R"] + rho))

    end = solve_ivp(motion, (0, t), [0.0, 0.0], rtol=1e-9, atol=1e-12).y[0, -1]
    assert end == pytest.approx(delta, rel=1e-6)


@pytest.mark.parametrize("zeta", [0.0, 0.2, 0.7, 0.8, 1.0, 1.4])
def test_a_ball_comes_back_as_from_a_spring_and_a_damper_that_do_not_pull(zeta):
    def motion(_, state):
        return state[1], -state[0] - 2 * zeta * state[1]

    def pulls(_, state):
        return state[0] + 2 * zeta * state[1]

    pulls.terminal, pulls.direction = True, -1
    end = solve_ivp(motion, (0, 60), [0.0, 1.0], events=pulls, rtol=1e-10, atol=1e-13, max_step=0.01).y[1, -1]
    told = evaluate("ball_impact", {"zeta": zeta, "T": 1.2, "d": 0.1})
    assert told["e"] == pytest.approx(-end, abs=1e-6)
    assert 0.5 * 1.2 * (1 + told["e"]) * told["v"] == pytest.approx(0.1)


def test_balls_with_the_least_friction_roll_as_far_as_told():
    """N and the acceleration from the two equations of the balls."""
    one, two, s, t = 35.0, -5.0, 0.02, 3.0
    mu = evaluate("balls_hold", {**BALL, "T_1": one, "T_2": two, "s": s, "t": t})["mu"]
    inertia, radius = 7 / 5 * BALL["M"] * BALL["R"], BALL["R"]
    balls = np.array([[inertia, radius * (1 + mu)], [inertia, radius * (mu - 1)]])  # times v', N
    assert 0.5 * np.linalg.solve(balls, [one, two])[0] * t**2 == pytest.approx(s)


def test_balls_that_feet_drive_apart_do_not_hold():
    with pytest.raises(NoSolution, match="T_1 must be above T_2"):
        evaluate("balls_hold", {**BALL, "T_1": -1.0, "T_2": 1.0})

"""On a free ball in simulation: without control the robot falls, with it it stands; it drives and stops the ball."""

from dataclasses import replace

import numpy as np
import pytest

from sweep.config.experiment import compose
from sweep.core.constants import GRAVITY
from sweep.engines import make_engine
from sweep.formulas.ball import ROLLING_INERTIA
from sweep.metrics.outcome import classify
from sweep.models.obstacles.ball import Ball

pytestmark = pytest.mark.slow


def outcomes(overrides: list[str], width: int = 1, known: bool = True, **groups: dict) -> dict[str, np.ndarray]:
    """Figures and outcomes of `width` rollouts with some quantities of some groups changed, known to the planner."""
    trial = compose(overrides)
    case = replace(
        trial.case, **{name: replace(getattr(trial.case, name), **values) for name, values in groups.items()}
    )
    simulation = make_engine(replace(trial.settings, width=width), trial.case, trial.case, trial.thresholds)
    figures = simulation.run(case, case if known else trial.case, np.arange(width))
    return {**figures, **classify(figures, trial.thresholds, simulation.stages)}


def test_without_control_it_falls():
    rows = outcomes(["scenario=ball_balance", "engine=native", "manoeuvre.law=none"])
    assert rows["cause"].tolist() == ["unreachable"]
    assert rows["fell_time_s"][0] < 30


@pytest.mark.parametrize("engine", ["native", "mjx"])
def test_it_recovers_from_an_offset_and_from_speed(engine):
    """Brought to rest, but not back: robot and ball have gone the same way."""
    offset, speed = np.array([0.2, 0.0]), np.array([0.0, 0.1])
    overrides = ["scenario=ball_balance", f"engine={engine}", "manoeuvre.stages=12"]
    rows = outcomes(overrides, 2, manoeuvre={"offset": offset}, obstacle={"speed": speed})
    assert rows["outcome"].tolist() == ["success"] * 2, rows["cause"]
    assert rows["obstacle_speed_mps"].max() < 0.005
    assert rows["slip_max_m"].max() < 0.01


def test_the_law_of_every_tick_brings_the_ball_back():
    overrides = ["scenario=ball_balance", "engine=native", "manoeuvre.law=tick", "manoeuvre.stages=15"]
    rows = outcomes(overrides, manoeuvre={"offset": np.array([0.2])})
    assert rows["outcome"].tolist() == ["success"]
    assert rows["obstacle_moved_m"][0] > 0.055
    assert abs(rows["obstacle_x_m"][0]) < 0.045


def test_the_observer_bears_an_error_of_the_attitude():
    """5 mrad at every tick throw off a robot whose feet follow the ball as it is seen."""
    overrides = ["scenario=ball_balance", "engine=native", "manoeuvre.law=tick", "manoeuvre.stages=3"]
    overrides += ["noise.body_orientation_noise=0.005"]
    rows = outcomes(overrides, 2, manoeuvre={"observer": np.array([0.0, 0.1])})
    assert rows["outcome"].tolist() == ["failure", "success"], rows["cause"]
    assert rows["slip_max_m"][1] < 0.01


def test_engines_agree_on_what_it_recovers_from():
    """64 starts of which about half stand, also on a ball that still rolls by then; they may differ at the boundary."""
    offset, speed = (x.ravel() for x in np.meshgrid(np.linspace(-0.3, 0.3, 8), np.linspace(0, 0.3, 8)))
    stands = {}
    for engine in ("mjx", "native"):
        overrides = ["scenario=ball_balance", f"engine={engine}", "manoeuvre.stages=6"]
        rows = outcomes(
            [*overrides, "outcome.obstacle_speed_error_max_mps=1"],
            64,
            manoeuvre={"offset": offset},
            obstacle={"speed": speed},
        )
        stands[engine] = (rows["outcome"] == "success").reshape(8, 8)
    mjx, native = stands["mjx"], stands["native"]
    assert 0.3 <= native.mean() <= 0.7
    assert (mjx == native).mean() >= 0.9
    for i, j in np.argwhere(mjx != native):
        around = native[max(i - 1, 0) : i + 2, max(j - 1, 0) : j + 2]
        assert around.any() != around.all()


@pytest.mark.parametrize("engine", ["native", "mjx"])
def test_it_drives_and_stops_the_ball(engine):
    place = np.array([1e6, 1.5])
    rows = outcomes(["scenario=ball_drive", f"engine={engine}", "manoeuvre.steps=30"], 2, manoeuvre={"place": place})
    assert rows["outcome"].tolist() == ["success"] * 2, rows["cause"]
    assert rows["obstacle_speed_mps"][0] == pytest.approx(0.13, rel=0.05)
    assert rows["obstacle_x_m"][1] == pytest.approx(1.5, abs=0.02)
    assert rows["obstacle_aside_max_m"].max() < 0.02


def test_what_a_heavy_ball_lacks_of_its_speed_adds_up():
    for gain, speed in ((0.0, 0.108), (0.05, 0.125)):
        asked = ["scenario=ball_drive", "obstacle.mass=400", f"manoeuvre.speed_integral={gain}"]
        assert outcomes(asked)["obstacle_speed_mps"][0] == pytest.approx(speed, abs=0.002)


def test_fewer_pushes_drive_slower():
    """Fig. 3.1.6: between pushes rolling friction takes speed, more than is allowed where each step pushes."""
    overrides = ["scenario=ball_drive", "engine=native", "manoeuvre.steps=40", "manoeuvre.push_every=4"]
    rows = outcomes([*overrides, "outcome.obstacle_speed_error_max_mps=0.02"])
    assert rows["outcome"].tolist() == ["success"]
    assert 0.10 < rows["obstacle_speed_mps"][0] < 0.12


@pytest.mark.parametrize("engine", ["native", "mjx"])
def test_it_comes_down_from_a_ball(engine):
    """Which stays where it was brought to rest."""
    rows = outcomes(["scenario=ball_descend", f"engine={engine}"])
    assert rows["outcome"].tolist() == ["success"], rows["cause"]
    assert 0.3 < rows["obstacle_x_m"][0] < 0.6
    assert rows["leg_gap_min_m"][0] > 0
    assert rows["slip_max_m"][0] < 0.03  # 0.035 and more where rear feet alone go on pressing the ball


@pytest.mark.parametrize("engine", ["native", "mjx"])
def test_it_gets_over_a_ball(engine):
    """2 m along with it, and walks away from it."""
    trial = compose(["scenario=ball_over", f"engine={engine}"])
    simulation = make_engine(replace(trial.settings, width=1), trial.case, trial.case, trial.thresholds)
    trace = simulation.trace(trial.case, trial.case, np.zeros(1, int), 0)
    assert classify(trace.metrics, trial.thresholds, simulation.stages)["outcome"] == "success"
    assert trace.metrics["slip_max_m"] < 0.04  # of 0.05
    begins = {name: np.flatnonzero(trace.stage == k) for k, name in enumerate(trace.stages)}
    base, ball = trace.qpos[:, 0], trace.qpos[:, -7]
    assert np.ptp(trace.qpos[trace.time < 0.4, -5]) < 2e-4  # m: it rests until it is touched
    assert ball[begins["lower"][0]] - ball[begins["calm1"][0]] == pytest.approx(2.0, abs=0.1)
    assert base[-1] - base[begins["rest"][-1]] > 0.6
    bears = np.linalg.norm(trace.foot_force, axis=-1).max(axis=1) > 1.0
    assert bears[begins["rest"][-1] :].all()  # it walks, and does not hop


@pytest.mark.parametrize("engine", ["native", "mjx"])
def test_leaning_alone_turns_the_way_of_a_ball(engine):
    """By (3.1.33), without any feedback of the way."""
    gains = ["manoeuvre.aside_gain=0", "manoeuvre.aside_gain_before=0"]
    trial = compose(["scenario=ball_turn", f"engine={engine}", *gains])
    simulation = make_engine(replace(trial.settings, width=1), trial.case, trial.case, trial.thresholds)
    trace = simulation.trace(trial.case, trial.case, np.zeros(1, int), 0)
    way = trace.qpos[trace.time > 25, 25:27]
    found = np.linalg.lstsq(np.c_[2 * way, np.ones(len(way))], np.sum(way**2, axis=1))[0]
    radius = np.sqrt(found[2] + found[:2] @ found[:2])  # of the circle through it
    assert radius == pytest.approx(trial.case.manoeuvre.radius, rel=0.04)
    assert np.degrees(np.arctan2(*trace.qvel[-1, 25:23:-1])) > 70


@pytest.mark.parametrize("engine", ["native", "mjx"])
def test_it_drives_a_ball_aside(engine):
    """(3.3.7) gives the speed that its k_l is for, less what rolling friction takes in that time."""
    trial = compose(["scenario=ball_aside", f"engine={engine}"])
    ball, aside = trial.case.obstacle_of_type(Ball), trial.case.manoeuvre
    simulation = make_engine(replace(trial.settings, width=1), trial.case, trial.case, trial.thresholds)
    trace = simulation.trace(trial.case, trial.case, np.zeros(1, int), 0)
    after = (trace.time > aside.period + 0.1) & (trace.time < aside.period + aside.coast)
    speed = trace.qvel[after, 25].mean()
    lost = ball.rolling_friction * GRAVITY * aside.period / (ROLLING_INERTIA * ball.radius)
    assert aside.speed - lost < speed < aside.speed
    assert classify(trace.metrics, trial.thresholds, simulation.stages)["outcome"] == "success"
    assert trace.metrics["slip_max_m"] < 0.005


@pytest.mark.parametrize("engine", ["native", "mjx"])
def test_feet_stand_aside_of_the_hips_of_a_wide_body(engine):
    """On a ball's own circle alone a front leg turns over as the ball has rolled."""
    at = ["robot.body_width=0.516", "obstacle.radius=0.811"]
    rows = outcomes(["scenario=ball_aside", f"engine={engine}", *at])
    assert list(rows["outcome"]) == ["success"]
    assert outcomes(["scenario=ball_aside", *at, "manoeuvre.room_ratio=0"])["outcome"][0] == "failure"


@pytest.mark.parametrize("engine", ["native", "mjx"])
def test_it_climbs_a_ball(engine):
    """Which it pushes ahead first and brings to rest under it, not by a single grip and rate of coming to the top."""
    near = {"press": np.array([1.6e-3, 1.6e-3, 2e-3]), "squeeze": np.array([3.8e-3, 3.8e-3, 3e-3])}
    braking = np.array([0.8, 1.2, 0.8])
    rows = outcomes(["scenario=ball_climb", f"engine={engine}", "manoeuvre.calm=8"], 3,
                    manoeuvre={**near, "braking": braking})  # fmt: skip
    assert rows["outcome"].tolist() == ["success"] * 3, rows["cause"]
    assert 0.3 < rows["obstacle_x_m"].min() <= rows["obstacle_x_m"].max() < 0.45
    assert rows["leg_gap_min_m"].min() > 0


def test_a_step_settles_in_which_drives_leave_their_limits():
    """Of a light robot whose front feet come to the ball: its legs stop from the limit, and no long step ends there."""
    rows = outcomes(["scenario=ball_climb", "manoeuvre.calm=8"], 3, obstacle={"mass": np.full(3, 467.0)},
                    robot={"body_mass": np.array([9.9, 10.4, 10.9]), "thigh_mass": np.full(3, 0.42),
                           "shin_mass": np.full(3, 0.456)})  # fmt: skip
    assert rows["solver_residual_over_weight"].max() < 0.01, rows["solver_stage"]
    assert "invalid" not in rows["outcome"].tolist(), rows["cause"]

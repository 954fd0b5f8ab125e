"""Calibration: it finds what the poses tell, says how well, and the robot then acts by it."""

import dataclasses

import jax
import numpy as np
import pytest

from sweep.backends import devices
from sweep.config.experiment import compose
from sweep.core.errors import InputError
from sweep.engines import make_engine, pre_rollout
from sweep.estimation.calibration import learnable_sizes

STAND = ["scenario=walk_tripod", "manoeuvre=stand", "control=calibrate"]
SENSORS = ["noise=sensors", "noise.delay=0", "noise.joint_bias=0.002", "noise.orientation_bias=0.003"]
ROBOTS, SPREAD = 64, 0.02


def wrong(case, number: int):
    """A world of robots that are up to 2 % off in what can be learned."""
    random = np.random.default_rng(0)
    off = {
        n: getattr(case.robot, n) * random.uniform(1 - SPREAD, 1 + SPREAD, number) for n in learnable_sizes(case.robot)
    }
    return dataclasses.replace(case, robot=dataclasses.replace(case.robot, **off))


def learned(*overrides):
    """Relative errors (robots, sizes) before and after calibration, and the covariance it claims."""
    case = compose([*STAND, *overrides]).case
    world = wrong(case, ROBOTS)
    over = (devices.vmap_in_axes(world), None, 0)
    calibrate = jax.vmap(lambda *of_one: pre_rollout.prepare_belief(*of_one)[2].calibration, in_axes=over)
    arrays = devices.to_jax_arrays(world), devices.to_jax_arrays(case), devices.noise_keys(np.arange(ROBOTS))
    found = jax.jit(calibrate)(*arrays)
    true = [getattr(world.robot, n) for n in learnable_sizes(case.robot)]
    pairs = [
        [np.asarray(getattr(r, n)) / t - 1 for n, t in zip(learnable_sizes(case.robot), true, strict=True)]
        for r in (case.robot, found.robot)
    ]
    return *(np.transpose(pair) for pair in pairs), np.asarray(found.covariance)


@pytest.mark.parametrize(
    ("overrides", "largest"),
    [((), 0.001), (SENSORS, 0.005), (("robot=three_link",), 0.004), (("obstacle=slope",), 0.001)],
)
def test_sizes_are_found_as_well_as_it_says(overrides, largest):
    """The errors are of the covariance that goes with them: of n sizes their weighted square is n on the mean."""
    _, after, covariance = learned(*overrides)
    assert np.sqrt(np.mean(after**2, axis=0)).max() < largest
    weighted = np.einsum("ri,rij,rj->r", after, np.linalg.inv(covariance), after)
    assert 0.6 < weighted.mean() / after.shape[1] < 1.5


def test_what_cannot_be_observed_stays_believed():
    """Without the base's place nothing tells how large the robot is, but legs that bend tell of its proportions."""
    before, after, covariance = learned("noise.position_noise=0.1", "noise.position_bias=0.05")
    thigh, shin = -2, -1
    proportion = after[:, thigh] - after[:, shin]
    assert np.std(proportion) < 0.2 * np.std(before[:, thigh] - before[:, shin])
    assert np.std(after[:, thigh]) > 0.3 * np.std(before[:, thigh])
    assert np.sqrt(covariance[:, thigh, thigh]).mean() > 0.003


def test_the_base_stands_where_it_is_told_once_the_legs_are_known():
    errors = {}
    for calibrate in ("none", "sizes"):
        exp = compose([*STAND, f"control.calibrate={calibrate}", "manoeuvre.duration=0.3", "engine=native"])
        world = wrong(exp.case, 4)
        engine = make_engine(dataclasses.replace(exp.settings, width=4), exp.case, exp.case, exp.thresholds)
        figures = engine.run(world, exp.case, np.arange(4))
        errors[calibrate] = figures["position_error_max_m"]
        if calibrate == "sizes":
            np.testing.assert_allclose(figures["learned_thigh_m"], world.robot.thigh, rtol=2e-3)
            assert np.all((figures["learned_thigh_sd_m"] > 0) & (figures["learned_thigh_sd_m"] < 1e-3))
        else:
            assert "learned_thigh_m" not in figures
    assert np.all(errors["sizes"] < 0.3 * errors["none"])


def test_who_does_not_start_on_the_floor_cannot_calibrate():
    exp = compose(["scenario=ball_balance", "engine=native", "control=calibrate"])
    with pytest.raises(InputError, match=r"control\.calibrate = sizes is not allowed: manoeuvre = ball_balance on"):
        make_engine(dataclasses.replace(exp.settings, width=1), exp.case, exp.case, exp.thresholds)

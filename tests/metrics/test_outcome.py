"""From figures to outcomes."""

import numpy as np
import pytest

from sweep.metrics.outcome import CAUSES, TIMED_CAUSES, Thresholds, classify

STAGES = ("stand", "walk", "halt")


def row(**changes):
    """A faultless rollout, but for `changes`."""
    good = {
        "finite": True, "finished": True, "end_stage": 2, "progress": 1.0, "tilt_max_deg": 1.0, "slip_max_m": 1e-3,
        "reach_shortfall_max_m": 0.0, "clearance_min_m": 0.1, "leg_gap_min_m": 0.1, "heading_error_max_deg": 0.1,
        "saturation_share_alpha": 0.0, "saturation_share_beta": 0.0, "saturation_share_gamma": 0.0,
        "solver_residual_max_n": 1.0, "energy_gain_max_j": 0.01, "imbalance_max": 0.0, "speed_mps": 0.1,
    }  # fmt: skip
    good |= {f"{cause}_time_s": np.nan for cause in TIMED_CAUSES} | {f"{cause}_stage": -1 for cause in TIMED_CAUSES}
    return {key: np.array([value]) for key, value in (good | changes).items()}


def label(thresholds=None, **changes):
    return {key: value[0] for key, value in classify(row(**changes), thresholds or Thresholds(), STAGES).items()}


def test_success_has_no_cause():
    got = label()
    assert (got["outcome"], got["cause"], got["stage"]) == ("success", "", "")
    assert np.isnan(got["t_cause_s"])


BAD = {
    "fell": {"tilt_max_deg": 25.0}, "slipped": {"slip_max_m": 2e3}, "unreachable": {"reach_shortfall_max_m": 0.01},
    "link_collision": {"clearance_min_m": -0.01}, "leg_crossing": {"leg_gap_min_m": -0.01},
    "off_course": {"heading_error_max_deg": 6.0}, "stalled": {"progress": 0.5}, "overload": {"imbalance_max": 0.05},
    "fell_off": {"ride_height_min_m": -2e3, "obstacle_moved_m": 0.0},
    "obstacle_moved": {"ride_height_min_m": 1.0, "obstacle_moved_m": 2e3},
}  # fmt: skip


@pytest.mark.parametrize("cause", BAD)
def test_every_threshold_has_its_cause(cause):
    got = label(**BAD[cause])
    assert (got["outcome"], got["cause"]) == ("failure", cause)


def test_overload_and_an_unfinished_plan_are_failures():
    assert label(Thresholds(saturation_share_max=0.2), saturation_share_beta=0.3)["cause"] == "overload"
    assert label(finished=False)["cause"] == "stalled"
    assert set(BAD) | {"overload"} == set(CAUSES)


def test_first_cause_in_time_wins():
    late, early = {"fell_time_s": 3.0, "fell_stage": 2}, {"off_course_time_s": 1.5, "off_course_stage": 1}
    got = label(**BAD["fell"], **BAD["off_course"], **BAD["stalled"], **late, **early)
    assert (got["cause"], got["stage"], got["t_cause_s"]) == ("off_course", "walk", 1.5)
    swapped = {"fell_time_s": 1.0, "fell_stage": 0}
    assert label(**BAD["fell"], **BAD["off_course"], **swapped, **early)["cause"] == "fell"


@pytest.mark.parametrize("key", ["speed_mps", "tilt_max_deg", "progress"])
def test_nan_is_invalid_and_no_success_or_failure(key):
    got = label(**{key: np.nan})
    assert (got["outcome"], got["cause"]) == ("invalid", "not_finite")


def test_doubt_beats_failure():
    assert label(solver_residual_max_n=1e4, **BAD["fell"])["cause"] == "solver"
    assert label(energy_gain_max_j=5.0)["outcome"] == "invalid"
    assert label(finite=False)["outcome"] == "invalid"


def test_relabelling_moves_the_threshold_only():
    """Looser: the cause goes, though its time is stored. Tighter: it comes without a time, after the others."""
    fell = BAD["fell"] | {"fell_time_s": 2.0, "fell_stage": 1}
    assert label(Thresholds(tilt_max_deg=30.0), **fell)["outcome"] == "success"
    tight = label(Thresholds(tilt_max_deg=0.5))
    assert (tight["outcome"], tight["cause"], tight["stage"]) == ("failure", "fell", "halt")
    assert np.isnan(tight["t_cause_s"])
    both = label(Thresholds(heading_error_max_deg=0.05), **fell)
    assert (both["cause"], both["t_cause_s"]) == ("fell", 2.0)

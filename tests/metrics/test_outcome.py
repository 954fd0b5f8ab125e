"""From figures to outcomes."""

import ast
import re
from pathlib import Path

import numpy as np
import pytest
from faultless import faultless

from sweep.config.experiment import compose
from sweep.core.errors import InputError
from sweep.core.outcomes import GOAL_MISSED
from sweep.metrics import CAUSES, METRICS
from sweep.metrics.outcome import (
    CAUSE_MEANINGS,
    COLUMN_MEANINGS,
    OutcomeThresholds,
    cause_sentence_with_threshold,
    classify,
    explain_cause,
    threshold_value,
)
from sweep.study.columns import LABEL_COLUMNS

STAGES = ("stand", "walk", "halt")
STRICT = OutcomeThresholds(slip_max_m=0.02, ride_height_min_m=0.5, obstacle_moved_max_m=3.0, saturation_share_max=0.5,
                           feet_on_target_min=6.0, end_tilt_max_deg=3.0, progress_min=0.9,
                           obstacle_speed_error_max_mps=0.01, obstacle_aside_max_m=0.02, obstacle_shift_max_m=1e-3,
                           past_centre_max_m=0.02, docking_gap_max_m=4e-3, docking_speed_max_mps=0.04,
                           second_ball_speed_max_mps=0.01, obstacle_turn_max_rad=1e-3)  # fmt: skip


def label(limits=STRICT, **changes):
    row = {key: np.array([value]) for key, value in ({**faultless(), "end_stage": 2.0} | changes).items()}
    return {key: value[0] for key, value in classify(row, limits, STAGES).items()}


def beyond(cause):
    """The figure of `cause` beyond its threshold."""
    limit = threshold_value(cause, STRICT)
    return {cause.metric: limit - 1e-3 if cause.below else limit + 1e-3}


def test_success_has_no_cause():
    got = label()
    assert tuple(got) == LABEL_COLUMNS
    assert (got["outcome"], got["cause"], got["stage"], got["limit"]) == ("success", "", "", "")
    assert np.isnan(got["t_cause_s"])


@pytest.mark.parametrize("cause", CAUSES, ids=lambda c: c.threshold or c.name)
def test_every_threshold_has_its_cause(cause):
    got = label(**beyond(cause))
    assert (got["outcome"], got["cause"], got["limit"]) == (
        "invalid" if cause.invalid else "failure", cause.name, cause.threshold
    )  # fmt: skip
    assert cause.name in CAUSE_MEANINGS
    said = cause_sentence_with_threshold(cause, STRICT)
    assert explain_cause({**got, **beyond(cause)}, STRICT).startswith(said)


def test_every_figure_that_is_judged_is_a_column_and_causes_are_told_apart():
    assert {cause.metric for cause in CAUSES} <= set(COLUMN_MEANINGS)
    timed = [cause.name for cause in CAUSES if cause.known_at == "tick"]
    assert len(timed) == len(set(timed))
    names = [name for metric in METRICS for name in metric.columns]
    assert len(names) == len(set(names))


def test_first_in_time_decides_be_it_a_failure_or_a_doubt():
    fell = {"tilt_max_deg": 25.0, "fell_time_s": 3.0, "fell_stage": 2}
    early = {"heading_error_max_deg": 6.0, "off_course_time_s": 1.5, "off_course_stage": 1}
    got = label(**fell, **early, finished=0.0)
    assert (got["cause"], got["stage"], got["t_cause_s"]) == ("off_course", "walk", 1.5)
    assert label(**{**fell, "fell_time_s": 1.0}, **early)["cause"] == "fell"
    after = {"energy_gain_ratio": 5.0, "energy_time_s": 3.5, "energy_stage": 2}
    assert label(**fell, **after)["outcome"] == "failure"  # what a fallen robot does is of no matter
    for time in (2.0, 3.0):
        got = label(**fell, **{**after, "energy_time_s": time})
        assert (got["outcome"], got["cause"], got["t_cause_s"]) == ("invalid", "energy", time)
    assert label(progress=0.5, **after)["outcome"] == "invalid"  # known at the end


def test_a_stance_that_cannot_be_held_is_known_from_the_start():
    got = label(imbalance_max=0.05, infeasible_stage=1, tilt_max_deg=25.0, fell_time_s=3.0, fell_stage=2)
    assert (got["cause"], got["stage"], got["t_cause_s"]) == ("infeasible", "walk", 0.0)


@pytest.mark.parametrize("key", ["speed_mps", "tilt_max_deg", "progress"])
def test_nan_is_invalid_and_no_success_or_failure(key):
    got = label(**{key: np.nan})
    assert (got["outcome"], got["cause"]) == ("invalid", "not_finite")


def test_relabelling_moves_the_threshold_only():
    """Looser: the cause goes, though its time is stored. Tighter: it comes without a time, after the others."""
    fell = {"tilt_max_deg": 25.0, "fell_time_s": 2.0, "fell_stage": 1}
    assert label(OutcomeThresholds(tilt_max_deg=30.0), **fell)["outcome"] == "success"
    tight = label(OutcomeThresholds(tilt_max_deg=0.5), tilt_max_deg=1.0)
    assert (tight["outcome"], tight["cause"], tight["stage"]) == ("failure", "fell", "halt")
    assert np.isnan(tight["t_cause_s"])
    both = label(OutcomeThresholds(heading_error_max_deg=0.05), heading_error_max_deg=0.1, **fell)
    assert (both["cause"], both["t_cause_s"]) == ("fell", 2.0)
    assert label(OutcomeThresholds(feet_on_target_min=3.0), feet_on_target=4)["outcome"] == "success"


def test_the_margin_is_the_least_distance_to_a_threshold():
    got = label(slip_max_m=0.015)
    assert (got["margin"], got["margin_of"]) == (pytest.approx(0.25), "slip_max_m")
    got = label(slip_max_m=0.025, clearance_min_m=-0.004)
    assert (got["outcome"], got["margin"], got["margin_of"]) == ("failure", pytest.approx(-0.25), "slip_max_m")
    assert label(clearance_min_m=0.005)["margin"] == pytest.approx(0.5)  # in units of 20 mm
    assert label(feet_on_target=5)["margin"] == -1


@pytest.mark.parametrize(
    ("figures", "limit", "margin"),
    [
        ({"feet_on_target": 6, "foot_gap_max_m": 0.015}, "feet_on_target_min", 0.25),
        ({"feet_on_target": 5, "foot_gap_max_m": 0.025}, "feet_on_target_min", -0.25),
        ({"time_use": 0.95}, "stalled", 0.3),
        ({"finished": 0, "time_use": 1.05}, "stalled", -0.3),
    ],
)
def test_a_count_has_the_margin_of_its_twin(figures, limit, margin):
    got = label(**figures)
    assert (got["margin_of"], got["margin"]) == (limit, pytest.approx(margin))
    assert (got["outcome"] == "success") == (margin > 0)


def test_a_twin_that_says_otherwise_than_the_count_is_not_heard():
    """As where fewer feet are enough."""
    got = label(OutcomeThresholds(feet_on_target_min=4.0), feet_on_target=4, foot_gap_max_m=0.3)
    assert (got["outcome"], got["margin"]) == ("success", 1.0)


@pytest.mark.parametrize(
    ("slip", "edge", "margin"), [(0.005, 0.03, 0.75), (0.005, 0.004, 0.2), (0.005, 0.0, 0.0), (0.025, 0.004, -0.25)]
)
def test_a_foot_is_no_farther_from_slipping_than_from_the_edge(slip, edge, margin):
    """But at the edge nothing has failed yet."""
    got = label(slip_max_m=slip, edge_reserve_min_m=edge)
    assert (got["margin_of"], got["margin"]) == ("slip_max_m", pytest.approx(margin))
    assert (got["outcome"] == "success") == (margin >= 0)


def test_a_manoeuvre_states_its_goal_and_outcome_may_loosen_it():
    assert compose(["scenario=pole_top"]).thresholds.feet_on_target_min == 6
    assert compose(["scenario=pole_top", "outcome.feet_on_target_min=4"]).thresholds.feet_on_target_min == 4
    assert compose(["scenario=ball_drive"]).thresholds.feet_on_target_min is None  # its goal is a motion


@pytest.mark.parametrize("wrong", ["ride_height_min_m=0.5", "obstacle_aside_max_m=0.1"])
def test_a_threshold_without_its_figure_is_refused(wrong):
    with pytest.raises(InputError, match=f"outcome.{wrong.split('=')[0]} = .* has no such metric"):
        compose(["scenario=walk_tripod", f"outcome.{wrong}"])


def test_the_page_of_success_has_every_condition_with_its_limit_and_its_test():
    root = Path(__file__).parents[2]
    conditions = (root / "research" / "causes.md").read_text()
    rows = [line.split(" | ") for line in conditions.splitlines() if line.count(" | ") == 6]
    told = {
        (name.strip("|` "), sentence, threshold.strip("`")): rest for name, _, sentence, threshold, *rest in rows[1:]
    }
    assert set(told) == {(cause.name, cause.sentence, cause.threshold) for cause in CAUSES}
    tests = {
        part.name: ast.unparse(part)
        for file in root.glob("tests/**/test_*.py")
        for part in ast.parse(file.read_text()).body
        if isinstance(part, ast.FunctionDef)
    }
    for cause in CAUSES:
        default, reason, broken_by = told[cause.name, cause.sentence, cause.threshold]
        assert cause.default is None or not cause.threshold or float(default.split()[0]) == cause.default
        assert len(reason) > 3
        test = broken_by.strip("|` ")
        tells = {cause.name, cause.threshold, cause.metric} - {"", GOAL_MISSED}
        named = any(re.search(rf"\b{name}\b", tests[test]) for name in tells)
        assert named or test == test_every_threshold_has_its_cause.__name__, (cause.name, test)

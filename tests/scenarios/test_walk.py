"""Gallop on level ground."""

import dataclasses

import numpy as np
import pytest

from sweep.config.experiment import compose
from sweep.engines import make_engine
from sweep.formulas import stepping
from sweep.metrics.outcome import OutcomeThresholds, classify

STEPS = 6


@pytest.fixture(scope="module", params=["native", pytest.param("mjx", marks=pytest.mark.slow)])
def gallop(request):
    experiment = compose(["scenario=walk_gallop", f"manoeuvre.steps={STEPS}"])
    case = experiment.case
    engine = make_engine(
        dataclasses.replace(experiment.settings, name=request.param, width=1), case, case, experiment.thresholds
    )
    return case, engine.stages, engine.run(case, case, np.zeros(1, int))


def test_level_gallop_walks_half_as_fast_as_tripod(gallop):
    """v_o = k' x*/t* with k' = 1."""
    case, stages, figures = gallop
    walk = case.manoeuvre
    x = walk.half_step_ratio * case.robot.body_length * stepping.LANDING_RATIO
    assert walk.gait == "level_gallop"
    assert figures["speed_mps"][0] == pytest.approx(x / stepping.swing_time(walk.rate), rel=0.02)
    assert classify(figures, OutcomeThresholds(), stages)["outcome"][0] == "success"


def test_standing_feet_do_not_slip(gallop):
    assert gallop[2]["slip_max_m"][0] <= 2e-3

"""Standing: a push that fells is no success however late it comes, nor is standing inside soft ground."""

from dataclasses import replace

import numpy as np
import pytest

from sweep.config.experiment import compose
from sweep.engines import make_engine
from sweep.metrics.outcome import classify

TIMES = np.array([1.0, 3.965, 1.0, 1.0])
IMPULSES = np.array([80.0, 80.0, 15.0, 15.0])
STIFFNESSES = np.array([1e6, 1e6, 1e6, 3e3])


@pytest.mark.slow
@pytest.mark.parametrize("engine", ["native", "mjx"])
def test_success_asks_how_it_stands_when_the_plan_has_ended(engine):
    trial = compose(["scenario=stand_push", f"engine={engine}"])
    case = replace(
        trial.case,
        execution=replace(trial.case.execution, push_time=TIMES, push_impulse=IMPULSES),
        contact=replace(trial.case.contact, stiffness=STIFFNESSES),
    )
    simulation = make_engine(replace(trial.settings, width=len(TIMES)), trial.case, trial.case, trial.thresholds)
    figures = simulation.run(case, trial.case, np.zeros(len(TIMES), int))
    rows = classify(figures, trial.thresholds, simulation.stages)
    assert rows["outcome"][:3].tolist() == ["failure", "failure", "success"], rows["cause"]
    assert figures["duration_s"][2] == pytest.approx(5.0, abs=0.05)  # a second after the plan
    if engine == "mjx":  # C MuJoCo has a contact stiffness of its own
        assert (rows["outcome"][3], rows["cause"][3]) == ("invalid", "sunk")

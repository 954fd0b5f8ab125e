"""Two engines with contact models of their own draw the same map."""

from dataclasses import replace

import numpy as np
import pytest

from sweep.config import compose
from sweep.engines import make
from sweep.metrics.outcome import classify

FRICTION = np.array([0.01, 0.02, 0.05, 0.1, 0.2, 0.4, 0.8, 1.2])
RATIO = np.linspace(0.04, 0.25, 8)


@pytest.fixture(scope="module")
def maps():
    """Which of 64 walks succeed, on each engine: friction by step ratio."""
    exp = compose(["scenario=walk_tripod"])
    friction, ratio = (grid.ravel() for grid in np.meshgrid(FRICTION, RATIO, indexing="ij"))
    belief = replace(exp.case, manoeuvre=replace(exp.case.manoeuvre, half_step_ratio=ratio))
    world = replace(belief, contact=replace(exp.case.contact, friction=friction))
    succeed = {}
    for name in ("mjx", "native"):
        engine = make(replace(exp.settings, name=name, width=64), exp.case, exp.case, exp.thresholds)
        figures = engine.run(world, belief, np.zeros(64, int))
        outcome = classify(figures, exp.thresholds, engine.stages)["outcome"]
        succeed[name] = (outcome == "success").reshape(8, 8)
    return succeed


@pytest.mark.slow
def test_engines_draw_the_same_map(maps):
    mjx, native = maps["mjx"], maps["native"]
    assert 0.3 <= mjx.mean() <= 0.7  # the comparison says something
    assert (mjx == native).mean() >= 0.95


@pytest.mark.slow
def test_flips_lie_next_to_the_boundary(maps):
    mjx, native = maps["mjx"], maps["native"]
    for i, j in np.argwhere(mjx != native):
        around = mjx[max(i - 1, 0) : i + 2, max(j - 1, 0) : j + 2]
        assert around.any() != around.all()

"""Two engines with contacts of their own draw the same map; two ways to the same dynamics tell the same of all."""

from dataclasses import replace
from importlib.resources import files

import numpy as np
import pytest

from sweep.config.experiment import compose
from sweep.engines import make_engine
from sweep.metrics.outcome import classify

pytestmark = pytest.mark.slow
FRICTION = np.array([0.01, 0.02, 0.05, 0.1, 0.2, 0.4, 0.8, 1.2])
RATIO = np.linspace(0.04, 0.25, 8)
SCENARIOS = sorted(file.name.removesuffix(".yaml") for file in (files("sweep.conf") / "scenario").iterdir())


def labels(exp, world, belief, width, **settings):
    """Outcome and cause of each of `width` rollouts."""
    engine = make_engine(replace(exp.settings, width=width, **settings), exp.case, exp.case, exp.thresholds)
    found = classify(engine.run(world, belief, np.zeros(width, int)), exp.thresholds, engine.stages)
    return found["outcome"], found["cause"]


@pytest.fixture(scope="module")
def maps():
    """Which of 64 walks succeed, by engine and by dynamics: friction by step ratio."""
    exp = compose(["scenario=walk_tripod"])
    friction, ratio = (grid.ravel() for grid in np.meshgrid(FRICTION, RATIO, indexing="ij"))
    belief = replace(exp.case, manoeuvre=replace(exp.case.manoeuvre, half_step_ratio=ratio))
    world = replace(belief, contact=replace(exp.case.contact, friction=friction))
    ways = {"arrowhead": {}, "mjx": {"dynamics": "mjx"}, "native": {"name": "native"}}
    found = {way: labels(exp, world, belief, 64, **settings)[0] for way, settings in ways.items()}
    return {way: (outcome == "success").reshape(8, 8) for way, outcome in found.items()}


@pytest.mark.parametrize(("other", "share"), [("native", 0.95), ("mjx", 0.99)])
def test_the_map_is_the_same(maps, other, share):
    """Rollouts that differ lie next to the boundary."""
    ours, theirs = maps["arrowhead"], maps[other]
    assert 0.3 <= ours.mean() <= 0.7  # the comparison says something
    assert (ours == theirs).mean() >= share
    for i, j in np.argwhere(ours != theirs):
        around = ours[max(i - 1, 0) : i + 2, max(j - 1, 0) : j + 2]
        assert around.any() != around.all()


@pytest.mark.parametrize("name", SCENARIOS)
def test_both_dynamics_tell_the_same_of_a_scenario(name):
    exp = compose([f"scenario={name}"])
    ours, theirs = (labels(exp, exp.case, exp.case, 1, dynamics=kind) for kind in ("arrowhead", "mjx"))
    assert (ours[0][0], ours[1][0]) == (theirs[0][0], theirs[1][0])

"""Charts: where the places are that plans name."""

import re
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import yaml

from sweep.config.experiment import compose
from sweep.controllers.plan import stage_end_stances
from sweep.core.rotations import rotate
from sweep.models.legs import LEG_PAIRS
from sweep.models.obstacles import OBSTACLES
from sweep.models.obstacles.surface import body_poses, free_start_state, surface_at

CHARTED = {kind: cls.charts for kind, cls in OBSTACLES.items() if hasattr(cls, "charts")}
SLOPE = 0.2
# sizes; where the base is and where on its chart front, middle and rear feet stand; where base and front feet go
PLANS = {
    "plane": ({"slope": SLOPE}, {"over_ground": [0, 0.5]}, ("ground", 0.5, 0, -0.5),
              {"over_ground": [0.1, 0.5]}, {"ground": [0.5, 0.7]}),
    "kerb": ({}, {"foot": [0.9, 0.5]}, ("floor", 0.4, 0.9, 1.4), {"edge": [-0.6, 0.45]}, {"top": [0.5, 0.1]}),
    "beam": ({"length": 0.8, "width": 4}, {"by_near": [-0.3, 0.5]}, ("near", 0.2, -0.3, -0.8),
             {"by_far": [-0.66, 0.5]}, {"far": [0.5, 0.1]}),
    "raft": ({}, {"by_near": [-0.9, 0.5]}, ("near", -0.4, -0.9, -1.4), {"on_deck": [-0.75, 0.5]}, {"deck": [0.5, 0.1]}),
}  # fmt: skip


@pytest.mark.parametrize("kind", PLANS)
def test_a_plan_of_a_file_finds_its_places_on_the_obstacle(kind, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "sweep.yaml").write_text("")
    (tmp_path / "scenarios").mkdir()
    head = f"# @package _global_\ndefaults:\n  - override /obstacle: {kind}\n  - override /manoeuvre: follow\n"
    sizes, base, (chart, *ahead), to, front = PLANS[kind]
    stand = {"base": base, **{pair: {chart: [0.5, x]} for pair, x in zip(LEG_PAIRS, ahead, strict=True)}}
    plan = {"start": {"stand": stand}, "on": {"step": {"base": to, "front": front}}}
    body = {"scenario": {"name": "mine"}, "obstacle": sizes, "plan": plan}
    (tmp_path / "scenarios/mine.yaml").write_text(head + yaml.safe_dump(body, sort_keys=False))
    case = compose(["scenario=mine"]).case
    with jax.enable_x64(True):
        free = free_start_state(case.obstacle)
        plan = case.manoeuvre.plan(case)  # which refuses what is out of reach
        stances = stage_end_stances(plan, free)
        below = jax.vmap(lambda feet: surface_at(case.obstacle, feet, body_poses(free)))(stances.feet)
        noses = np.asarray(rotate(stances.quat, jnp.array([1.0, 0.0, 0.0])))
    begun, ended = np.asarray(plan.start.feet), np.asarray(stances.feet)[-1]
    forward = np.array([*case.obstacle.forward, 0.0])
    np.testing.assert_allclose(below.depth, case.manoeuvre.deepening, atol=1e-5)
    assert np.all(np.asarray(below.normal)[..., 2] > 0.9)
    up = SLOPE if kind == "plane" else 0.0
    np.testing.assert_allclose(noses, [np.cos(up) * forward + [0, 0, np.sin(up)]] * len(noses), atol=1e-6)
    way = (ended - begun) @ forward
    assert np.all(way[4:] > 0.1)
    assert np.all(np.abs(way[:4]) < 1e-3)


def test_a_chart_has_the_same_coordinates_on_every_obstacle():
    """Files of plans are described without an obstacle."""
    known = {}
    for charts in CHARTED.values():
        for name, chart in charts.items():
            assert known.setdefault(name, chart.names) == chart.names, name


def test_the_page_tells_all_charts():
    page = (Path(__file__).parents[2] / "docs/plan_files.md").read_text()
    told = page[page.index("| obstacle | charts for feet |") :].partition("\n\n")[0]
    words = set(re.findall(r"`(\w+)`", told))
    offered = {name for charts in CHARTED.values() for name in charts}
    assert offered <= words <= offered | set(CHARTED)

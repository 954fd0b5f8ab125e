"""Successes of the built-in robot's scenarios on draws wider than those that its plans were searched for.

To run: `python bench/beyond.py [NAME...]`, from a checkout; a name is SCENARIO or SCENARIO:KIND, by default all
scenarios and kinds. It adds to research/data/beyond.json, which research/searching_plans.md cites.

Kinds of draws: `known` (all sizes, masses and friction within 4 %, heights of a pole within 2 %), `loads` (masses
within 20 % and other obstacles) and `unknown` (all within 2 %, unknown to the planner, without and with learning).
"""

import sys
import tempfile
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pandas as pd
import shared

from sweep import api
from sweep.backends import devices
from sweep.backends.run_id import describe_device
from sweep.config.experiment import compose
from sweep.core.errors import InputError
from sweep.core.provenance import version_record

FILE, COMMAND = shared.DATA / "beyond.json", "python bench/beyond.py"
DRAWS, SEED = 64, 7601  # of no search
GOAL = 60  # successes of a cell that nobody needs to tune
MASSES = ("robot.body_mass", "robot.thigh_mass", "robot.shin_mass")
ROBOT = (*MASSES, *(f"robot.{name}" for name in ("body_length", "body_width", "body_height", "thigh", "shin")))
HEIGHTS = {"obstacle.height": 0.5, "obstacle.ledge_height": 0.5}  # of poles: half as wide as other sizes
# sizes of each obstacle, with their widths relative to that of the draws
OBSTACLES: dict[str, dict[str, float]] = {
    "plane": {},
    "kerb": {"obstacle.height": 1},
    "pole_ledge": {"obstacle.radius": 1, **HEIGHTS},
    "corner": {"obstacle.half_angle": 1, "obstacle.height": 1},
    "ladder": {f"obstacle.{name}": 1 for name in ("lean", "rung_step", "ledge_height", "mass", "rung_depth")},
    "ball": {"obstacle.radius": 1, "obstacle.mass": 1},
    "two_balls": {"obstacle.radius": 1, "obstacle.mass": 1},
    "ledges": {"obstacle.radius": 1, "obstacle.mass": 1},
    "beam": {f"obstacle.{name}": 1 for name in ("width", "length", "height", "thickness")},
    "raft": {f"obstacle.{name}": 1 for name in ("length", "width", "thickness", "density", "water_width")},
}
# other obstacles: relative widths, or the ends of a range as ratios to the nominal value
OTHER: dict[str, dict[str, float | tuple[float, float]]] = {
    "plane": {},
    "kerb": {"obstacle.height": 0.2},
    "pole_ledge": {"obstacle.radius": (0.9, 1.2), "obstacle.height": 0.04, "obstacle.ledge_height": 0.04},
    "corner": {"obstacle.half_angle": 0.04, "obstacle.height": 0.04},
    "ladder": {"obstacle.mass": 0.2, "obstacle.lean": 0.02, "obstacle.rung_step": 0.02, "obstacle.ledge_height": 0.02},
    "ball": {"obstacle.radius": (0.9, 1.2), "obstacle.mass": 0.2},
    "two_balls": {"obstacle.radius": (0.9, 1.2), "obstacle.mass": 0.2},
    "ledges": {"obstacle.radius": (0.9, 1.2), "obstacle.mass": 0.2},
    "beam": {"obstacle.width": (0.9, 1.2), "obstacle.length": 0.1, "obstacle.height": 0.1},
    "raft": {"obstacle.density": 0.2, "obstacle.length": 0.04, "obstacle.width": 0.04, "obstacle.water_width": 0.04},
}
KINDS = ("known", "loads", "unknown", "learned")
SCENARIOS = ("walk_kerb", "walk_slope", "pole_climb", "pole_climb_held", "pole_return", "pole_round", "pole_top",
             "pole_ledge_level", "pole_ledge_below", "pole_ledge_above", "pole_descent", "pole_descent_below",
             "pole_descent_above", "corner_climb", "corner_roof", "corner_full", "corner_descend", "ladder_climb",
             "ladder_descend", "ball_balance", "ball_drive", "ball_turn", "ball_aside", "ball_climb", "ball_descend",
             "ball_over", "ball_ledges", "ball_to_ball", "beam_cross", "raft_cross", "raft_stand")  # fmt: skip


def draw_axes(obstacle: str, kind: str) -> dict[str, float | tuple[float, float]]:
    """Return what a kind of draws varies: relative widths, or the ends of a range as ratios, by path."""
    if kind == "loads":
        return {**dict.fromkeys(MASSES, 0.2), **OTHER[obstacle]}
    wide = 0.04 if kind == "known" else 0.02
    sizes = {path: share * wide for path, share in OBSTACLES[obstacle].items()}
    return {**dict.fromkeys(ROBOT, wide), **sizes, "contact.friction": wide}


def study_overrides(scenario: str, kind: str) -> list[str]:
    """Return the overrides of a study of one kind of draws of a scenario."""
    side = "world" if kind in ("unknown", "learned") else "both"
    found = ["study.design.kind=monte_carlo", f"study.design.num={DRAWS}", f"study.seed={SEED}", "study.replays=0",
             "study.invalid_max=1", f"study.name={scenario}_{kind}"]  # fmt: skip
    obstacle = compose([f"scenario={scenario}"]).case.obstacle.kind
    for path, ends in draw_axes(obstacle, kind).items():
        by = (f"relative: 1, distribution: {{kind: uniform, from: {ends[0] - 1:g}, to: {ends[1] - 1:g}}}"
              if isinstance(ends, tuple) else f"relative: {ends}")  # fmt: skip
        found.append(f"+study.axes.{path.replace('.', '_')}={{path: {path}, side: {side}, {by}}}")
    return [f"scenario={scenario}", *found, *(["control=learn"] if kind == "learned" else [])]


def count_causes(rows: pd.DataFrame) -> dict[str, int]:
    """Return how many rollouts ended by which cause in which stage, most frequent first, other than successes."""
    failed = rows[rows["outcome"] != "success"]
    found = (failed["cause"].astype(str) + " in " + failed["stage"].astype(str)).value_counts()
    return {str(key): int(count) for key, count in found.items()}


def simulate_cell(scenario: str, kind: str) -> dict[str, Any]:
    """Simulate the draws of one cell; return successes, and causes by stage of all others."""
    with tempfile.TemporaryDirectory() as folder:
        rows = api.run([*study_overrides(scenario, kind), f"out={Path(folder) / 'draws'}"])
    return {"success": int((rows["outcome"] == "success").sum()), "draws": len(rows), "causes": count_causes(rows)}


def evidence_tables(scenarios: Mapping[str, Mapping[str, Any]]) -> dict[str, shared.Table]:
    """Return the table of successes, and that of cells below the goal with their most frequent causes."""
    cells = {(name, kind): one["cells"][kind] for name, one in scenarios.items() for kind in KINDS
             if kind in one["cells"]}  # fmt: skip
    counts = [[name, *(str(cells[name, kind]["success"]) if (name, kind) in cells else "" for kind in KINDS)]
              for name in scenarios]  # fmt: skip
    low = [[name, kind, str(cell["success"]), "; ".join(f"`{key}` {n}" for key, n in [*cell["causes"].items()][:3])]
           for (name, kind), cell in cells.items() if cell["success"] < GOAL]  # fmt: skip
    return {"successes": [["scenario", *KINDS], *counts],
            "below": [["scenario", "draws", "successes", "causes of others"], *low]}  # fmt: skip


def main(*names: str) -> None:
    """Simulate the cells that are named, or all, and write them to the file."""
    devices.configure_jax()
    for name in names or SCENARIOS:
        scenario, _, kind = name.partition(":")
        for one in [kind] if kind else KINDS:
            try:
                compose(study_overrides(scenario, one))
            except InputError as why:
                print(f"{scenario} {one}: {why}", flush=True)
                continue
            start = time.perf_counter()
            cell = simulate_cell(scenario, one)
            print(scenario, one, cell["success"], cell["causes"], flush=True)
            before = shared.read_scenarios(FILE).get(scenario, {"cells": {}, "seconds": 0})
            content = {"device": describe_device(compose([f"scenario={scenario}"]).settings), **version_record(),
                       "seconds": before["seconds"] + time.perf_counter() - start,
                       "cells": {**before["cells"], one: cell}}  # fmt: skip
            shared.add_scenario(FILE, scenario, content, COMMAND, evidence_tables)


if __name__ == "__main__":
    main(*sys.argv[1:])

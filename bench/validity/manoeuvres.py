"""Whole manoeuvres over the time step and iterations: how far base, forces, slip and outcome are from the finest."""

from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any

import numpy as np

from sweep.config.experiment import compose
from sweep.contract.engine import Trace
from sweep.core.constants import GRAVITY
from sweep.engines.batching import require_trace
from sweep.engines.mjx import MjxEngine
from sweep.metrics.outcome import classify
from sweep.models.robot import total_mass
from validity.tables import short

NAMES = ("walk_tripod", "pole_climb", "corner_climb", "ball_climb", "raft_cross")  # each takes minutes
FINEST = (2.5e-4, 8)  # s, iterations
EVERY = 5  # control ticks between samples
MEAN = 12  # samples that forces are averaged over: a quarter of a second


def jobs() -> Iterator[tuple[str, Callable[[], list[dict[str, Any]]]]]:
    """One for each manoeuvre."""
    for name in NAMES:
        yield name, lambda name=name: _rows(name)


def _rows(name: str) -> list[dict[str, Any]]:
    own = compose([f"scenario={name}"]).settings.iterations
    finest, _ = _run(name, *FINEST)
    rows = []
    for h, iterations in dict.fromkeys([FINEST, (5e-4, own), (1e-3, own), (2e-3, own), (2e-3, 1), (2e-3, 16)]):
        trace, outcome = _run(name, h, iterations)
        as_default = (h, iterations) == (2e-3, own)
        row = {"scenario": name, "time_step": h, "iterations": iterations, "default": as_default}
        rows.append({**row, **_apart(trace, finest), "outcome": outcome})
        print(rows[-1], flush=True)
    return rows


def _run(name: str, h: float, iterations: int) -> tuple[Trace, str]:
    exp = compose([f"scenario={name}"])
    settings = replace(exp.settings, width=1, time_step=h, iterations=iterations)
    engine = MjxEngine(settings, exp.case, exp.case, exp.thresholds)
    trace = require_trace(engine.traces(exp.case, exp.case, np.zeros(1, int), EVERY)[0])
    figures = {key: np.asarray([value]) for key, value in trace.metrics.items()}
    told = classify(figures, exp.thresholds, engine.stages)
    return trace, str(told["outcome"][0]) + (f" ({told['cause'][0]})" if told["cause"][0] else "")


def _apart(trace: Trace, finest: Trace) -> dict[str, Any]:
    """How far a rollout is from the finest, over the time that both have."""
    n, weight = min(len(trace.time), len(finest.time)), float(total_mass(trace.world.robot)) * GRAVITY
    place = np.linalg.norm(trace.qpos[:n, :3] - finest.qpos[:n, :3], axis=-1)
    total = np.cumsum(trace.foot_force[:n] - finest.foot_force[:n], axis=0)
    forces = (total[MEAN:] - total[:-MEAN]) / MEAN
    return {
        "base_mm": short(1e3 * place.max()),
        "end_mm": short(1e3 * place[-1]),
        "forces": short(_rms(forces) / weight),
        "net": short(_rms(forces.sum(axis=1)) / weight),
        "slip_mm": short(1e3 * float(trace.metrics["slip_max_m"])),
        "residual": short(float(trace.metrics["solver_residual_over_weight"])),
    }


def _rms(forces: np.ndarray) -> float:
    return float(np.sqrt(np.mean(np.sum(forces**2, axis=-1))))

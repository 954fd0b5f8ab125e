"""How fast rollouts part that differ by 1e-9: the robot's mass, in double precision throughout."""

from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from sweep.config.experiment import compose
from sweep.contract.engine import Trace
from sweep.engines import make_engine
from sweep.engines.batching import require_trace
from sweep.metrics.outcome import classify
from validity.tables import short

NAMES = sorted(path.stem for path in (Path(__file__).parents[2] / "conf" / "scenario").glob("*.yaml"))
ROWS, PART, EVERY = 16, 1e-9, 5  # rollouts; what they differ by; control ticks between samples
PARTED = 1e-3  # m: as far apart as rollouts may come before they are strangers
SETTLED = 0.5  # s, in which a difference of mass becomes one of places


def jobs() -> Iterator[tuple[str, Callable[[], list[dict[str, Any]]]]]:
    """One for each manoeuvre and engine."""
    for name in NAMES:
        for engine in ("mjx", "native"):
            yield f"{name}, {engine}", lambda name=name, engine=engine: [_row(name, engine)]


def _row(name: str, engine: str) -> dict[str, Any]:
    exp = compose([f"scenario={name}", f"engine={engine}", "engine.precision=float64", f"engine.width={ROWS}"])
    draws = np.concatenate([[0.0], np.random.default_rng(0).uniform(-1, 1, ROWS - 1)])
    robot = replace(exp.case.robot, body_mass=exp.case.robot.body_mass * (1 + PART * draws))
    made = make_engine(exp.settings, exp.case, exp.case, exp.thresholds)
    found = made.traces(replace(exp.case, robot=robot), exp.case, np.zeros(ROWS, int), EVERY)
    traces = [require_trace(trace) for trace in found]
    figures = {key: np.asarray([trace.metrics[key] for trace in traces]) for key in traces[0].metrics}
    outcomes = classify(figures, exp.thresholds, made.stages)["outcome"]
    return {
        "scenario": name,
        "engine": engine,
        **divergence(traces),
        "success": int(np.sum(outcomes == "success")),
        "of": ROWS,
    }


def divergence(traces: list[Trace]) -> dict[str, Any]:
    """Return mean distances of the feet at first and at last, and the time in which they grow by a factor of e.

    That time is None unless rollouts part, which means growth by at least a factor of 1000, or to `PARTED`.
    """
    n = min(len(trace.time) for trace in traces)
    feet = np.stack([trace.foot_position[:n] for trace in traces])
    apart = np.sqrt(np.mean(np.sum((feet[1:] - feet[0]) ** 2, axis=-1), axis=(0, 2)))
    apart = np.maximum.accumulate(apart)
    time = traces[0].time[:n]
    first = int(np.searchsorted(time, SETTLED))
    last = min(int(np.searchsorted(apart, PARTED)), n - 1)
    growth = apart[last] / apart[first]
    e_fold = (time[last] - time[first]) / np.log(growth) if growth > 1e3 else None
    return {"first_m": short(apart[first]), "last_m": short(apart[-1]), "seconds": short(float(time[-1])),
            "parted_s": short(float(time[last])) if apart[last] >= PARTED else None,
            "e_fold_s": None if e_fold is None else short(float(e_fold))}  # fmt: skip

"""Draws research/figures/scenario_*.png: moments of each scenario's nominal rollout, with contact forces.

MUJOCO_GL=egl python research/scenario_pictures.py SCENARIO [...] [engine=native]
"""

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np

from sweep.config.experiment import compose
from sweep.contract.trace_frames import count_finite_frames
from sweep.core.spacing import evenly_spaced_indices
from sweep.replay.rendering import write_filmstrip
from sweep.runs.batches import Batch, make_engine

FIGURES = Path(__file__).parent / "figures"
LONG = 45.0  # s


def strip(scenario: str, *changes: str) -> Path:
    """Frames of the scenario side by side."""
    exp = compose([f"scenario={scenario}", *changes])
    one = Batch(replace(exp.settings, width=1), exp.case, exp.case, np.zeros(1, int))
    engine = make_engine(exp, one)
    trace = engine.trace(exp.case, exp.case, one.streams, 0)
    path = FIGURES / f"scenario_{scenario}.png"
    write_filmstrip(path, trace, evenly_spaced_indices(count_finite_frames(trace), 4 if engine.duration < LONG else 8))
    return path


if __name__ == "__main__":
    changes = [word for word in sys.argv[1:] if "=" in word]
    for name in [word for word in sys.argv[1:] if "=" not in word]:
        print(strip(name, *changes))

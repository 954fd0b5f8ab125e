"""Projects of a MuJoCo model in a few texts, and all rollouts of a study in one batch."""

from dataclasses import replace
from pathlib import Path

import pandas as pd

from sweep.config.experiment import compose
from sweep.runs import batches
from sweep.runs.runner import select_points_to_simulate


def write_texts(texts, folder="."):
    """Write files of a project, texts by name, beside its `sweep.yaml`."""
    for name, text in {"sweep.yaml": "modules: []", **texts}.items():
        file = Path(folder, name)
        file.parent.mkdir(exist_ok=True)
        file.write_text(text)


def prepare_batch(*words, cross_check=True):
    """The engine of `study=one.yaml`, and the sides and streams of a batch of all its rollouts."""
    exp = compose(["study=one.yaml", *words])
    rows = select_points_to_simulate(exp)
    exp = batches.allocate_delay_buffers(exp, rows)
    rows = batches.assign_batches(exp, pd.DataFrame(), rows).assign(width=len(rows))
    task = batches.make_batch(exp, rows)
    engine = exp.system.make_engine(replace(task.settings, cross_check=cross_check), task.world, task.belief, None)
    return engine, (task.world, task.belief, task.streams)

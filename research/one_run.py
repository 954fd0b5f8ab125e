"""One nominal rollout, recorded: what pages draw and tell of single runs."""

from dataclasses import replace

import numpy as np

from sweep.config.experiment import Experiment, compose
from sweep.contract.engine import Trace
from sweep.runs.batches import Batch, make_engine


def traced(*words: str) -> tuple[Experiment, Trace]:
    """What `words` compose, and its rollout."""
    exp = compose([*words])
    one = Batch(replace(exp.settings, width=1), exp.case, exp.case, np.zeros(1, int))
    return exp, make_engine(exp, one).trace(exp.case, exp.case, one.streams, 0)

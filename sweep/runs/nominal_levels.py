"""Check for values of categorical axes, such as gaits, that fail before anything else is varied."""

from collections.abc import Iterator
from dataclasses import replace
from typing import NamedTuple

from sweep.config.experiment import Experiment
from sweep.runs.batches import allocate_delay_buffers, make_engine, make_nominal_batch
from sweep.runs.runner import simulate_batch
from sweep.study.designs import Axis
from sweep.study.study import make_points

MAX_LEVELS_PER_AXIS = 12  # tried on an axis, as each level compiles a program


class FailingLevel(NamedTuple):
    """A value of a categorical axis, such as a gait, whose nominal rollout does not succeed."""

    axis: str
    value: str
    outcome: str
    meaning: str  # of the cause

    def __str__(self) -> str:
        became = "fails" if self.outcome == "failure" else f"is {self.outcome}"
        return (
            f"{self.axis} = {self.value} {became} at the nominal point, before anything else is varied: {self.meaning}"
        )


def find_failing_levels(exp: Experiment) -> list[FailingLevel]:
    """Find the values of categorical axes, such as gaits, whose nominal rollouts do not succeed.

    Each level is simulated once, with all other parameters nominal.

    Args:
        exp: Experiment of a study. Axes of the engine, of numbers, and of a table of points are left out, and so is
            everything where batches run on other machines.

    Returns:
        The levels that do not succeed, in the order of the axes.
    """
    if exp.study.points or exp.cluster.is_remote:
        return []
    return [level for axis in exp.study.axes if _is_categorical(axis) for level in _iter_failing(exp, axis)]


def _is_categorical(axis: Axis) -> bool:
    names = axis.values is not None and all(isinstance(value, str) for value in axis.values)
    return names and axis.along is None and axis.path is not None and not axis.path.startswith("engine.")


def _iter_failing(exp: Experiment, axis: Axis) -> Iterator[FailingLevel]:
    axis = replace(axis, values=(axis.values or ())[:MAX_LEVELS_PER_AXIS])
    nominal = replace(exp.study.design, num=0, correlation=())
    alone = {"axes": (axis,), "design": nominal, "replicates": 1, "where": None, "resolution": 0.0, "budget": 0}
    exp = replace(exp, study=replace(exp.study, **alone, keep=()))
    table = make_points(exp.study, exp.system, exp.settings).assign(width=1)
    exp = allocate_delay_buffers(exp, table)
    meanings = exp.system.cause_meanings(exp.thresholds)
    for place, value in enumerate(table[axis.column]):
        row = table.iloc[[place]]
        rows, _ = simulate_batch(exp, make_engine(exp, make_nominal_batch(exp, row, 1)), row)
        outcome, cause = str(rows["outcome"].iloc[0]), str(rows["cause"].iloc[0])
        if outcome != "success":
            yield FailingLevel(axis.name, str(value), outcome, meanings.get(cause, cause))

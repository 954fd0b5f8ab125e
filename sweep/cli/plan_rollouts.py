"""Rollouts of a study's draws with other plan numbers in each, and a score of each, for `sweep tune --by-rollouts`."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
import pandas as pd
from jaxtyping import Float

from sweep.config.experiment import Experiment
from sweep.core.outcomes import SUCCESS
from sweep.planning import plan_table
from sweep.planning.score import broadcast_over_draws, relative_size_changes, replace_plan_value
from sweep.runs.batches import assign_batches, make_batch, make_engine, make_nominal_batch
from sweep.study.study import make_points, parameter_columns

MAX_MARGIN, MIN_MARGIN = 0.2, -1.0  # to which the margin in a rollout's score is limited, in units of its threshold


class PlanRollouts:
    """Simulated draws of a study, each with its own numbers of the plan.

    Args:
        exp: The experiment; its study gives the draws.
        numbers: Numbers of the plan that may change, by path.
        sizes: Reference values of the sizes that numbers may follow, by path.
    """

    def __init__(self, exp: Experiment, numbers: Mapping[str, float], sizes: Mapping[str, float]):
        self._exp, self._numbers, self._sizes = exp, dict(numbers), dict(sizes)
        self._formulas = plan_table.formula_values(exp.case)

    def draw_points(self, seed: int) -> pd.DataFrame:
        """Draw the points of the study with a seed."""
        return make_points(replace(self._exp.study, seed=seed), self._exp.system, self._exp.settings)

    def relative_sizes(self, points: pd.DataFrame) -> Float[np.ndarray, "draws k"]:
        """Return the relative differences between the believed sizes of each point and their reference values."""
        values = {c: points[c].to_numpy(float) for c in parameter_columns(points)}
        belief = self._exp.system.make_world_and_belief(values)[1]
        return relative_size_changes(broadcast_over_draws(belief, len(points)), self._sizes)

    def scores(self, points: pd.DataFrame, moved: Float[np.ndarray, "sets draws n"]) -> Float[np.ndarray, "sets draws"]:
        """Simulate each point with several changes of the plan's numbers, and return how well each rollout ends.

        Args:
            points: Points of the study.
            moved: Changes of the numbers of each point, in their units.

        Returns:
            The share of the plan's stages before the one that failed, or 1, plus the least margin, within bounds.
        """
        every = assign_batches(self._exp, pd.DataFrame(), pd.concat([points] * len(moved), ignore_index=True))
        changes, found = moved.reshape(len(every), -1), np.empty(len(every))
        for _, rows in every.groupby("batch"):
            index, width = rows.index.to_numpy(), int(rows["width"].iloc[0])
            batch = make_batch(self._exp, rows)
            slots = index[np.minimum(np.arange(width), len(index) - 1)]
            world, belief = batch.world, batch.belief
            for (path, value), change in zip(self._numbers.items(), changes[slots].T, strict=True):
                world, belief = (replace_plan_value(x, path, value + change, self._formulas) for x in (world, belief))
            engine = make_engine(self._exp, make_nominal_batch(self._exp, rows, width))
            metrics = engine.run(world, belief, batch.streams)
            figures = {name: np.asarray(values, float)[: len(index)] for name, values in metrics.items()}
            labels = self._exp.system.judge(figures, self._exp.thresholds, engine.stages)
            found[index] = score_ends(labels, engine.stages)
        return found.reshape(moved.shape[:2])


def score_ends(labels: Mapping[str, np.ndarray], stages: Sequence[str]) -> Float[np.ndarray, " n"]:
    """Return how well rollouts ended, by stage and margin: 1 and more for those that succeed with some margin.

    Args:
        labels: Outcome, stage and margin (n,) of each rollout.
        stages: Names of the plan's stages.
    """
    number = {name: k for k, name in enumerate(stages)}
    share = np.array([number.get(str(name), len(stages) - 1) for name in labels["stage"]]) / len(stages)
    done = np.where(labels["outcome"] == SUCCESS, 1.0, share)
    return done + np.clip(np.nan_to_num(labels["margin"].astype(float), nan=MIN_MARGIN), MIN_MARGIN, MAX_MARGIN)

"""Accumulation of all metrics of a batch of rollouts of a MuJoCo model."""

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from sweep.contract.engine import Metrics
from sweep.core.metric import Array, compute_columns, freeze_ended_states, select_metrics
from sweep.systems.mujoco_model.metrics import METRICS
from sweep.systems.mujoco_model.model_spec import ModelSpec
from sweep.systems.mujoco_model.tick import ModelPartIndices, ModelRollout, ModelStart, ModelTick


class ModelMetricStates(NamedTuple):
    """States of all metrics of n rollouts as NumPy or JAX arrays, which engines carry."""

    steps: Array  # (n,), physics steps so far
    start_qpos: Array  # positions (n, nq)
    last_qpos: Array  # likewise, now
    last_qvel: Array  # velocities (n, nv), now
    states: tuple[Any, ...]


class MetricAccumulator:
    """Computes the metrics of n rollouts from the engine's reports of its ticks."""

    def __init__(self, own: ModelSpec):
        self._parts = ModelPartIndices(own)
        self._metrics = select_metrics(METRICS, self._parts.names, own)

    @property
    def columns(self) -> tuple[str, ...]:
        """Names of the metric columns that rollouts of the model have."""
        return tuple(column for metric in self._metrics for column in metric.columns)

    def start(self, qpos: Array, qvel: Array) -> ModelMetricStates:
        """Return the states of all metrics before the first tick.

        Args:
            qpos: Positions (n, nq).
            qvel: Velocities (n, nv).
        """
        start = ModelStart(self._parts, qpos)
        states = tuple(metric.begin(start) for metric in self._metrics)
        return ModelMetricStates(start.constant_state(0.0), qpos, qpos, qvel, states)

    @np.errstate(invalid="ignore", over="ignore")
    def update(
        self, running: ModelMetricStates, steps: Mapping[str, Array], limits: Mapping[str, Array], going: Array
    ) -> ModelMetricStates:
        """Update the states of all metrics with an engine's report of a tick; rollouts that have ended stay unchanged.

        Args:
            running: States before it.
            steps: What was recorded of its steps, see `ModelTick`.
            limits: The models' own limits, see `ModelTick`.
            going: Which rollouts (n,) have not ended before; the others stay as they are.
        """
        ctx = ModelTick(self._parts, steps, limits, running.start_qpos)
        states = tuple(metric.update(state, ctx) for metric, state in zip(self._metrics, running.states, strict=True))
        ends = steps["qpos"][:, -1], steps["qvel"][:, -1]
        new = ModelMetricStates(running.steps + ctx.number, running.start_qpos, *ends, states)
        return freeze_ended_states(going, new, running)

    def compute(self, running: ModelMetricStates, mass: Array, gained: Array, broken: Array, full: Array) -> Metrics:
        """Compute the metric columns (n,) of all rollouts.

        Args:
            running: States after the last tick, in NumPy's arrays.
            mass: Masses of the models (n,) in kg.
            gained: Energies at the end less those at the start (n,) in J.
            broken: Where the engine found numbers that are not finite (n,).
            full: Where a buffer was full (n,).
        """
        rollout = ModelRollout(
            self._parts, running.steps, running.start_qpos, running.last_qpos, mass, gained, broken, full
        )
        return compute_columns(self._metrics, running.states, rollout)

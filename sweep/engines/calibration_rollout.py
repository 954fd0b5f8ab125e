"""Simulated calibration: a batch first goes through the calibration poses with soft drives, then does its manoeuvre.

Both are rollouts of the same engine. The second one starts in its plan's start pose, with the estimated sizes.
"""

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from sweep.backends import devices
from sweep.contract.engine import Engine, Metrics, MissingTrace, SideMaker, TimeSeriesRequest, Trace
from sweep.contract.engine_settings import EngineSettings
from sweep.core.errors import InputError
from sweep.core.outcomes import FAILURE, INVALID
from sweep.engines import batching, pre_rollout
from sweep.engines.batching import require_trace
from sweep.estimation.calibration import MOVES, PoseMeasurements, learnable_sizes
from sweep.estimation.calibration_poses import HOLD, MOVE, CalibrationPoses, held_pose_index
from sweep.metrics import calibration, outcome
from sweep.metrics.outcome import OutcomeThresholds
from sweep.models.case import Case
from sweep.models.legs import JOINT_KINDS, JOINT_Q, LEGS, N_LEGS

SAMPLE_INTERVAL = 0.04  # s between samples while a pose is held
SAMPLED_COLUMNS = (
    *(f"qpos_{k}" for k in range(JOINT_Q.stop)),
    *(f"foot{leg}_force_{axis}_n" for leg in LEGS for axis in "xyz"),
)
POSE_METRICS = {  # metrics of the poses that a row keeps, by their column in it
    "calibration_slip_max_m": "slip_max_m",
    "calibration_clearance_min_m": "clearance_min_m",
    "calibration_torque_peak_nm": "torque_peak_nm",
}


class CalibratingEngine:
    """Engine for `control.calibrate=simulated`: simulates the robot's self-calibration before each manoeuvre."""

    def __init__(
        self,
        make: Callable[..., Engine],
        settings: EngineSettings,
        world: Case,
        belief: Case,
        limits: OutcomeThresholds,
    ):
        self.settings, self.limits = settings, limits
        pre_rollout.check_calibration_stance(belief, batching.nominal_plan(belief), world.control.calibrate)
        others = {name: None for name in world.manoeuvre.goal if name not in CalibrationPoses.goal}
        self._limits = replace(limits, **others)  # pyright: ignore[reportArgumentType]
        self._poses = make(settings, _pose_case(world), _pose_case(belief), self._limits)
        self._then = make(settings, _manoeuvre_case(world), _manoeuvre_case(belief), limits)
        self.stages = self._poses.stages + self._then.stages
        self.duration = self._poses.duration + self._then.duration
        self.width, self.dynamics, self.devices = self._then.width, self._then.dynamics, self._then.devices
        self._learn: dict[Any, Callable[..., Any]] = {}

    def rollout_bytes(self) -> int | None:
        """Return the memory in bytes of the larger of the two rollouts, calibration or manoeuvre."""
        sizes = self._poses.rollout_bytes(), self._then.rollout_bytes()
        return None if None in sizes else max(size for size in sizes if size is not None)

    def find_inactive_parameters(self, sides: SideMaker, ends: Mapping[str, tuple[float, float]]) -> set[str]:
        """Return an empty set: unused parameters cannot be found, as this engine is no single traced program."""
        return set()

    def run(self, world: Case, belief: Case, streams: np.ndarray) -> Metrics:
        """Simulate calibration and manoeuvre of a batch; return the metrics of both as one row for each rollout."""
        sides, before = self._run_calibration(world, belief, streams)
        return self._join_metrics(before, self._then.run(*sides, streams))

    def run_with_time_series(
        self, world: Case, belief: Case, streams: np.ndarray, slots: np.ndarray, watch: TimeSeriesRequest
    ) -> tuple[Metrics, np.ndarray]:
        """Raise `InputError`: the calibration and the manoeuvre have no common clock for time series."""
        raise InputError("study.keep is not allowed with control.calibrate = simulated: none, sizes")

    def trace(self, world: Case, belief: Case, streams: np.ndarray, slot: int) -> Trace:
        """Record calibration and manoeuvre of one rollout as a single trace."""
        sides, before = self._run_calibration(world, belief, streams)
        first = self._poses.trace(_pose_case(world), _pose_case(belief), streams, slot)
        return self._join_traces(before, slot, first, self._then.trace(*sides, streams, slot))

    def traces(self, world: Case, belief: Case, streams: np.ndarray, every: int) -> list[Trace | MissingTrace]:
        """Record calibration and manoeuvre of each rollout as a single trace."""
        sides, before = self._run_calibration(world, belief, streams)
        firsts = self._poses.traces(_pose_case(world), _pose_case(belief), streams, every)
        thens = self._then.traces(*sides, streams, every)
        both = enumerate(zip(firsts, thens, strict=True))
        return [
            next((one for one in (first, then) if isinstance(one, MissingTrace)), None)
            or self._join_traces(before, slot, require_trace(first), require_trace(then))
            for slot, (first, then) in both
        ]

    def _run_calibration(self, world: Case, belief: Case, streams: np.ndarray) -> tuple[tuple[Case, Case], Metrics]:
        """Simulate the poses. Returns world and belief for the manoeuvre, and the metrics of the poses."""
        every = max(1, round(SAMPLE_INTERVAL / self.settings.control_period))
        watch, slots = TimeSeriesRequest(SAMPLED_COLUMNS, every, self.width), np.arange(self.width)
        figures, seen = self._poses.run_with_time_series(_pose_case(world), _pose_case(belief), streams, slots, watch)
        with devices.precision_context(self.settings):
            true = _average_poses(
                seen, every * self.settings.control_period, float(np.max(world.control.load_threshold))
            )
            given = devices.to_jax_arrays((world, belief, true))
            form = devices.program_signature(given[:2])
            if form not in self._learn:
                self._learn[form] = _compile_estimation(given)
            sizes, told = jax.tree.map(np.asarray, self._learn[form](*given, devices.noise_keys(streams)))
        known = replace(belief, robot=replace(belief.robot, **sizes))
        return (_manoeuvre_case(world), _manoeuvre_case(known)), self._calibration_metrics(figures) | told

    def _calibration_metrics(self, figures: Metrics) -> Metrics:
        """Metrics that a row keeps of the poses, with their margin to failure."""
        labels = outcome.classify(figures, self._limits, self._poses.stages)
        failed, margin = labels["outcome"] == FAILURE, labels["margin"].astype(float)
        margin = np.where(failed & (margin >= 0), -1.0, margin)
        number = {name: k for k, name in enumerate(self._poses.stages)}
        peaks = [figures[f"torque_peak_{joint}_nm"] for joint in JOINT_KINDS]
        figures = figures | {"torque_peak_nm": np.max(peaks, axis=0)}
        return {
            **{name: figures[own] for name, own in POSE_METRICS.items() if own in figures},
            "calibration_margin": np.where(labels["outcome"] == INVALID, np.nan, margin),
            "uncalibrated_time_s": np.where(failed, np.nan_to_num(labels["t_cause_s"].astype(float)), np.nan),
            "uncalibrated_stage": np.array([number.get(name, -1) for name in labels["stage"]]),
            "calibration_s": figures["duration_s"],
        }

    def _join_metrics(self, before: Metrics, after: Metrics) -> Metrics:
        """Metrics of a row: those of the manoeuvre, its times and stages counted from the start of the poses."""
        joined, first = dict(after), len(self._poses.stages)
        for name, values in after.items():
            if name.endswith("_time_s") or name == "duration_s":
                joined[name] = values + before["calibration_s"]
            elif name.endswith("_stage"):
                joined[name] = np.where(values < 0, values, values + first)
        return joined | before

    def _join_traces(self, before: Metrics, slot: int, first: Trace, then: Trace) -> Trace:
        """One trace of the poses and the manoeuvre after them."""
        own = {name: values[slot] for name, values in before.items()}
        rows = {k: np.concatenate([x, getattr(then, k)]) for k, x in vars(first).items() if isinstance(x, np.ndarray)}
        rows["time"][len(first.time) :] += own["calibration_s"]
        rows["stage"][len(first.time) :] += len(first.stages)
        return replace(then, **rows, stages=self.stages, metrics=self._join_metrics(own, then.metrics))


def _pose_case(case: Case) -> Case:
    """Case of the calibration poses: soft drives, and no estimation during the rollout."""
    control = replace(case.control, calibrate="none", touch="none", replan="never")
    drive = replace(case.drive, stiffness=case.control.stiffness, damping=case.control.damping)
    return replace(case, manoeuvre=CalibrationPoses(case.manoeuvre), drive=drive, control=control)


def _manoeuvre_case(case: Case) -> Case:
    """Case of the manoeuvre after calibration."""
    return replace(case, control=replace(case.control, calibrate="none"))


def _compile_estimation(cases: tuple[Case, Case, PoseMeasurements]) -> Callable[..., Any]:
    """Compile the estimation of sizes from the true means of the poses: estimated sizes by name, and metrics."""

    def learned(world: Case, belief: Case, true: PoseMeasurements, key: Any) -> tuple[dict[str, Any], dict[str, Any]]:
        found = pre_rollout.calibrate_from_poses(world, belief, true, key)
        return {
            name: getattr(found.robot, name) for name in learnable_sizes(found.robot)
        }, calibration.learned_size_columns(found)

    return jax.jit(jax.vmap(learned, in_axes=(*devices.vmap_in_axes(cases), 0)))


def _average_poses(samples: np.ndarray, interval: float, threshold: float) -> PoseMeasurements:
    """Average each calibration pose over the samples taken while it was held.

    Args:
        samples: recorded columns (samples, rollouts, columns).
        interval: time between samples (s).
        threshold: force above which a foot carries load (N).
    """
    pose = np.array([held_pose_index(interval * (k + 1)) for k in range(round(len(MOVES) * (MOVE + HOLD) / interval))])
    missing = max(0, len(pose) - len(samples))  # all rollouts ended earlier
    samples = np.concatenate([samples, np.full((missing, *samples.shape[1:]), np.nan, samples.dtype)])[: len(pose)]
    each = [samples[pose == k] for k in range(len(MOVES))]  # numbers of samples differ
    mean = np.stack([x.mean(axis=0) for x in each], axis=1)
    shape = *mean.shape[:2], N_LEGS, 3
    force = [np.linalg.norm(x[..., JOINT_Q.stop :].reshape(*x.shape[:2], N_LEGS, 3), axis=-1) for x in each]
    loaded = np.stack([np.all(x > threshold, axis=0) for x in force], axis=1)
    quat = mean[..., 3:7] / np.linalg.norm(mean[..., 3:7], axis=-1, keepdims=True)
    return PoseMeasurements(*map(jnp.asarray, (mean[..., :3], quat, mean[..., JOINT_Q].reshape(shape), loaded)))

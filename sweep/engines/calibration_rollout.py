"""A batch that calibrates itself in physics before it begins: the poses in soft drives, then the manoeuvre.

Both are rollouts of the same engine. The second begins with what was learned, standing as its plan wants.
"""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from sweep.controllers.calibration import MOVES, PoseMeasurements, learnable_sizes
from sweep.controllers.calibration_poses import HOLD, MOVE, CalibrationPoses, held_pose_index
from sweep.core.errors import InputError
from sweep.core.outcomes import FAILURE, INVALID
from sweep.engines import batching, devices, pre_rollout
from sweep.engines.base import Engine, Figures, NoTrace, Trace, Watch
from sweep.engines.batching import require_trace
from sweep.engines.settings import EngineSettings
from sweep.metrics import calibration, outcome
from sweep.metrics.outcome import Thresholds
from sweep.models.case import Case
from sweep.models.legs import JOINT_Q, KINDS, LEGS, N_LEGS

EVERY = 0.04  # s between the samples of a pose that is held
WATCHED = (
    *(f"qpos_{k}" for k in range(JOINT_Q.stop)),
    *(f"foot{leg}_force_{axis}_n" for leg in LEGS for axis in "xyz"),
)
KEPT = {  # figures of the poses that a row keeps
    "calibration_slip_max_m": "slip_max_m",
    "calibration_clearance_min_m": "clearance_min_m",
    "calibration_torque_peak_nm": "torque_peak_nm",
}


class Calibrating:
    """An engine for `control.calibrate=simulated`, of two by `make`."""

    def __init__(
        self, make: Callable[..., Engine], settings: EngineSettings, world: Case, belief: Case, limits: Thresholds
    ):
        self.settings, self.limits = settings, limits
        pre_rollout.check_level(belief, batching.nominal_plan(belief), world.control.calibrate)
        others = {name: None for name in world.manoeuvre.goal if name not in CalibrationPoses.goal}
        self._limits = replace(limits, **others)  # pyright: ignore[reportArgumentType]
        self._poses = make(settings, _in_poses(world), _in_poses(belief), self._limits)
        self._then = make(settings, _informed(world), _informed(belief), limits)
        self.stages = self._poses.stages + self._then.stages
        self.duration = self._poses.duration + self._then.duration
        self.width, self.dynamics, self.devices = self._then.width, self._then.dynamics, self._then.devices
        self._learn: dict[Any, Callable[..., Any]] = {}

    def rollout_bytes(self) -> int | None:
        """Bytes of the larger of both rollouts, see `Engine`."""
        sizes = self._poses.rollout_bytes(), self._then.rollout_bytes()
        return None if None in sizes else max(size for size in sizes if size is not None)

    def run(self, world: Case, belief: Case, streams: np.ndarray) -> Figures:
        """Figures of both rollouts as one, see `Engine`."""
        sides, before = self._calibrated(world, belief, streams)
        return self._joined(before, self._then.run(*sides, streams))

    def histories(
        self, world: Case, belief: Case, streams: np.ndarray, slots: np.ndarray, watch: Watch
    ) -> tuple[Figures, np.ndarray]:
        """See `Engine`. Raises `InputError`: there is one clock to a history."""
        raise InputError("study.keep is not allowed with control.calibrate = simulated: none, sizes")

    def trace(self, world: Case, belief: Case, streams: np.ndarray, slot: int) -> Trace:
        """The poses and what follows as one record, see `Engine`."""
        sides, before = self._calibrated(world, belief, streams)
        first = self._poses.trace(_in_poses(world), _in_poses(belief), streams, slot)
        return self._chained(before, slot, first, self._then.trace(*sides, streams, slot))

    def traces(self, world: Case, belief: Case, streams: np.ndarray, every: int) -> list[Trace | NoTrace]:
        """The same of all rollouts, see `Engine`."""
        sides, before = self._calibrated(world, belief, streams)
        firsts = self._poses.traces(_in_poses(world), _in_poses(belief), streams, every)
        thens = self._then.traces(*sides, streams, every)
        both = enumerate(zip(firsts, thens, strict=True))
        return [
            next((one for one in (first, then) if isinstance(one, NoTrace)), None)
            or self._chained(before, slot, require_trace(first), require_trace(then))
            for slot, (first, then) in both
        ]

    def _calibrated(self, world: Case, belief: Case, streams: np.ndarray) -> tuple[tuple[Case, Case], Figures]:
        """World and belief after the poses, and what a row keeps of these."""
        every = max(1, round(EVERY / self.settings.control_period))
        watch, slots = Watch(WATCHED, every, self.width), np.arange(self.width)
        figures, seen = self._poses.histories(_in_poses(world), _in_poses(belief), streams, slots, watch)
        with devices.precision(self.settings):
            true = _means(seen, every * self.settings.control_period, float(np.max(world.control.load_threshold)))
            given = devices.as_arrays((world, belief, true))
            form = devices.form(given[:2])
            if form not in self._learn:
                self._learn[form] = _learner(given)
            sizes, told = jax.tree.map(np.asarray, self._learn[form](*given, devices.keys(streams)))
        known = replace(belief, robot=replace(belief.robot, **sizes))
        return (_informed(world), _informed(known)), self._judged(figures) | told

    def _judged(self, figures: Figures) -> Figures:
        """What a row keeps of the poses, and how near they came to what fails them."""
        labels = outcome.classify(figures, self._limits, self._poses.stages)
        failed, margin = labels["outcome"] == FAILURE, labels["margin"].astype(float)
        margin = np.where(failed & (margin >= 0), -1.0, margin)
        number = {name: k for k, name in enumerate(self._poses.stages)}
        peaks = [figures[f"torque_peak_{joint}_nm"] for joint in KINDS]
        figures = figures | {"torque_peak_nm": np.max(peaks, axis=0)}
        return {
            **{name: figures[own] for name, own in KEPT.items() if own in figures},
            "calibration_margin": np.where(labels["outcome"] == INVALID, np.nan, margin),
            "uncalibrated_time_s": np.where(failed, np.nan_to_num(labels["t_cause_s"].astype(float)), np.nan),
            "uncalibrated_stage": np.array([number.get(name, -1) for name in labels["stage"]]),
            "calibration_s": figures["duration_s"],
        }

    def _joined(self, before: Figures, after: Figures) -> Figures:
        """Figures of a row: of the manoeuvre, counted on in time and stages from the poses, and theirs."""
        joined, first = dict(after), len(self._poses.stages)
        for name, values in after.items():
            if name.endswith("_time_s") or name == "duration_s":
                joined[name] = values + before["calibration_s"]
            elif name.endswith("_stage"):
                joined[name] = np.where(values < 0, values, values + first)
        return joined | before

    def _chained(self, before: Figures, slot: int, first: Trace, then: Trace) -> Trace:
        """One trace of the poses and of what follows."""
        own = {name: values[slot] for name, values in before.items()}
        rows = {k: np.concatenate([x, getattr(then, k)]) for k, x in vars(first).items() if isinstance(x, np.ndarray)}
        rows["time"][len(first.time) :] += own["calibration_s"]
        rows["stage"][len(first.time) :] += len(first.stages)
        return replace(then, **rows, stages=self.stages, figures=self._joined(own, then.figures))


def _in_poses(case: Case) -> Case:
    """The case of the poses: soft drives, nothing learned while it goes through them."""
    control = replace(case.control, calibrate="none", touch="none", replan="never")
    drive = replace(case.drive, stiffness=case.control.stiffness, damping=case.control.damping)
    return replace(case, manoeuvre=CalibrationPoses(case.manoeuvre), drive=drive, control=control)


def _informed(case: Case) -> Case:
    """The case of the manoeuvre."""
    return replace(case, control=replace(case.control, calibrate="none"))


def _learner(given: tuple[Case, Case, PoseMeasurements]) -> Callable[..., Any]:
    """What rollouts like `given` learn of what really was in their poses: sizes by name, and figures."""

    def learned(world: Case, belief: Case, true: PoseMeasurements, key: Any) -> tuple[dict[str, Any], dict[str, Any]]:
        found = pre_rollout.calibrate_from_poses(world, belief, true, key)
        return {name: getattr(found.robot, name) for name in learnable_sizes(found.robot)}, calibration.learned_sizes(
            found
        )

    return jax.jit(jax.vmap(learned, in_axes=(*devices.axes(given), 0)))


def _means(seen: np.ndarray, every: float, threshold: float) -> PoseMeasurements:
    """Of each pose, from samples (s, n, columns) every so many seconds: base and joints, and which feet bear load."""
    pose = np.array([held_pose_index(every * (k + 1)) for k in range(round(len(MOVES) * (MOVE + HOLD) / every))])
    missing = max(0, len(pose) - len(seen))  # where all rollouts were over before
    seen = np.concatenate([seen, np.full((missing, *seen.shape[1:]), np.nan, seen.dtype)])[: len(pose)]
    each = [seen[pose == k] for k in range(len(MOVES))]  # not all as many
    mean = np.stack([x.mean(axis=0) for x in each], axis=1)
    shape = *mean.shape[:2], N_LEGS, 3
    force = [np.linalg.norm(x[..., JOINT_Q.stop :].reshape(*x.shape[:2], N_LEGS, 3), axis=-1) for x in each]
    loaded = np.stack([np.all(x > threshold, axis=0) for x in force], axis=1)
    quat = mean[..., 3:7] / np.linalg.norm(mean[..., 3:7], axis=-1, keepdims=True)
    return PoseMeasurements(*map(jnp.asarray, (mean[..., :3], quat, mean[..., JOINT_Q].reshape(shape), loaded)))

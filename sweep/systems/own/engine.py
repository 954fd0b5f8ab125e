"""What engines for own models have in common: from figures and frames of a batch to histories and traces."""

from collections.abc import Iterable, Iterator
from contextlib import AbstractContextManager
from typing import NamedTuple

import mujoco
import numpy as np

from sweep.core.errors import InputError
from sweep.engines import devices
from sweep.engines.base import Figures, Trace, Watch, single_joints
from sweep.engines.settings import EngineSettings
from sweep.systems.own import batch
from sweep.systems.own.batch import NUMBERS
from sweep.systems.own.outcome import STAGE
from sweep.systems.own.policy import Programs
from sweep.systems.own.subject import Side, Subject


class Frame(NamedTuple):
    """What is recorded at the end of a tick, of some rollouts."""

    time: float
    qpos: np.ndarray
    qvel: np.ndarray
    ctrl: np.ndarray
    force: np.ndarray


class Loop:
    """An `Engine`, but for `dynamics` and for the way from one tick to the next. Raises `InputError`."""

    stages: tuple[str, ...] = (STAGE,)
    dynamics: str
    devices = 1  # threads share it
    width: int

    def __init__(self, own: Subject, settings: EngineSettings):
        devices.configure()
        self._own, self._settings, self._model = own, settings, own.model
        self.duration = own.about.duration
        self._substeps = substeps(self._model, own.about.period)
        ramp = (1 + np.arange(self._substeps)) / self._substeps  # what a command counts for, beside the one before
        self._shares = ramp if own.about.command == "ramped" else np.ones(self._substeps)
        belief = {name: NUMBERS[settings.precision](value) for name, value in own.told({}).items()}
        with self._within():
            self._programs = Programs(own, belief)

    def _within(self) -> AbstractContextManager:
        """The precision that JAX reckons in."""
        return devices.precision(self._settings)

    def check_start(self) -> None:
        """Raise `InputError` where the controller's first controls are not finite, all being nominal."""
        begun = batch.begin(self._own, self._settings, Side(), Side(), np.zeros(1, np.int64))

        def pose(start: np.ndarray | None) -> np.ndarray:
            begun.pose(start)
            return self._own.state(begun.qpos, begun.qvel, begun.sensors)[0]

        with self._within():
            self._programs.check_start(begun.given, pose)

    def cautions(self) -> Iterator[str]:
        """What is to be known of it before it runs, each a line."""
        return iter(())

    def vary(self, paths: Iterable[str]) -> None:
        """Raise `InputError` where it cannot simulate models that differ in what `paths` name."""

    def rollout_bytes(self) -> None:
        """See `Engine`."""
        return None

    def run(self, world: Side, belief: Side, streams: np.ndarray) -> Figures:
        """See `Engine`."""
        return self._simulate(world, belief, streams)[0]

    def histories(
        self, world: Side, belief: Side, streams: np.ndarray, slots: np.ndarray, watch: Watch
    ) -> tuple[Figures, np.ndarray]:
        """See `Engine`."""
        found, frames, _ = self._simulate(world, belief, streams, slots, watch.every)
        columns = [self._own.record(frame.qpos, frame.qvel) for frame in frames]
        samples = [np.stack([one[name] for name in watch.columns], axis=-1) for one in columns]
        return found, np.stack(samples) if samples else np.zeros((0, len(slots), len(watch.columns)))

    def trace(self, world: Side, belief: Side, streams: np.ndarray, slot: int) -> Trace:
        """See `Engine`."""
        return self._traces(world, belief, streams, np.array([slot]), 1)[0]

    def traces(self, world: Side, belief: Side, streams: np.ndarray, every: int) -> list[Trace]:
        """See `Engine`."""
        return self._traces(world, belief, streams, np.arange(len(streams)), every)

    def _traces(self, world: Side, belief: Side, streams: np.ndarray, slots: np.ndarray, every: int) -> list[Trace]:
        found, frames, models = self._simulate(world, belief, streams, slots, every)
        time = np.array([frame.time for frame in frames])
        traces = []
        for k, slot in enumerate(slots):
            row = {name: values[slot] for name, values in found.items()}
            within = time <= row["duration_s"] + self._own.about.period / 2
            qpos, qvel, ctrl, force = (
                np.stack([one[k] for one in values])[within] for values in zip(*(f[1:] for f in frames), strict=True)
            )
            count, none = int(within.sum()), np.zeros((int(within.sum()), 0, 3))
            base = self._own.base
            pose = np.tile([0.0, 0, 0, 1, 0, 0, 0], (count, 1)) if base is None else qpos[:, base : base + 7]
            traces.append(
                Trace(
                    world,
                    belief,
                    models[k],
                    time[within],
                    qpos,
                    qvel,
                    ctrl,
                    force @ levers(models[k]),
                    none,
                    none,
                    none,
                    pose,
                    np.zeros(count, dtype=int),
                    np.full(count, np.nan),
                    np.full(count, ""),
                    self.stages,
                    row,
                )
            )
        return traces

    def _simulate(
        self, world: Side, belief: Side, streams: np.ndarray, slots: np.ndarray | None = None, every: int = 1
    ) -> tuple[Figures, list[Frame], list[mujoco.MjModel]]:
        """Figures of a batch; of the rollouts in `slots` frames at one in `every` ticks, and their models."""
        raise NotImplementedError


def levers(model: mujoco.MjModel) -> np.ndarray:
    """How much of an actuator's force (nu, J) each of the `single_joints` has, of those that drive one."""
    joints, kind = single_joints(model), int(mujoco.mjtTrn.mjTRN_JOINT)
    driven = (model.actuator_trnid[:, :1] == joints) & (model.actuator_trntype[:, None] == kind)
    return driven * model.actuator_gear[:, :1]


def substeps(model: mujoco.MjModel, period: float) -> int:
    """Physics steps of a tick. Raises `InputError` where they are not a whole number."""
    steps = period / model.opt.timestep
    if round(steps) < 1 or abs(steps - round(steps)) > 1e-6:
        raise InputError(
            f"model.period = {period:g} is not allowed: a multiple of {model.opt.timestep:g} s, the model's time step"
        )
    return round(steps)

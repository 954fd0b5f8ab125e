"""An own model on C MuJoCo: a batch of models on all cores, each rollout with fields of its own.

Bits depend neither on threads nor on how many rollouts share a batch.
"""

from typing import Any, NamedTuple

import mujoco
import numpy as np
from mujoco.batch import Batch

from sweep.core.errors import InputError
from sweep.engines import devices
from sweep.engines.base import Figures, Trace, Watch
from sweep.engines.settings import EngineSettings
from sweep.systems.own import fields, figures
from sweep.systems.own.outcome import STAGE
from sweep.systems.own.policy import Programs, Rollouts, keys
from sweep.systems.own.subject import Side, Subject

WIDTH = 256
W = mujoco.mjtWarning
BROKEN = [int(w) for w in (W.mjWARN_INERTIA, W.mjWARN_BADQPOS, W.mjWARN_BADQVEL, W.mjWARN_BADQACC, W.mjWARN_BADCTRL)]
FULL = [int(w) for w in (W.mjWARN_CONTACTFULL, W.mjWARN_CNSTRFULL)]


class Frame(NamedTuple):
    """What is recorded at the end of a tick, of some rollouts."""

    time: float
    qpos: np.ndarray
    qvel: np.ndarray
    ctrl: np.ndarray
    force: np.ndarray


class Native:
    """See `Engine`."""

    stages: tuple[str, ...] = (STAGE,)
    dynamics = "C MuJoCo"
    devices = 1  # threads share it

    def __init__(self, own: Subject, settings: EngineSettings):
        devices.configure()
        mujoco.set_mju_user_warning(lambda _: None)  # a row that it is about is invalid
        self._own, self._settings = own, settings
        self._model = own.model
        self.width = settings.width or WIDTH
        self.duration = own.about.duration
        self._substeps = round(settings.control_period / self._model.opt.timestep)
        control = own.controller
        belief = {name: np.float32(value) for name, value in own.told({}).items()}
        sizes = own.seen, self._model.nu, self._model.nq
        self._programs = Programs(own.about.controller, control.begin, control.policy, belief, sizes, own.room)

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
        found, frames = self._simulate(world, belief, streams, slots, watch.every)
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
        found, frames = self._simulate(world, belief, streams, slots, every)
        time = np.array([frame.time for frame in frames])
        traces = []
        for k, slot in enumerate(slots):
            row = {name: values[slot] for name, values in found.items()}
            within = time <= row["duration_s"] + self._settings.control_period / 2
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
                    self._model,
                    time[within],
                    qpos,
                    qvel,
                    ctrl,
                    force,
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
    ) -> tuple[Figures, list[Frame]]:
        """Figures of a batch, and frames of the rollouts in `slots` at one in `every` ticks."""
        own, n, period = self._own, len(streams), self._settings.control_period
        batch = Batch(self._model, n)
        seen = batch.bind("sensordata")  # before the reset: what is bound after it is zero until the next call
        fields.write(batch, {p: np.broadcast_to(v, (n,)) for p, v in world.of("model").items()})
        batch.reset(keyframe=own.keyframe)
        noise = {**own.noise, **world.of("noise")}
        told = own.told({**belief.of("model"), **belief.of("controller")})
        given: dict[str, Any] = {
            "belief": {name: np.broadcast_to(np.float32(value), (n,)) for name, value in told.items()},
            "delay": np.broadcast_to(np.rint(noise["noise.delay"]).astype(np.int32), (n,)),
            **{name: np.broadcast_to(np.float32(noise[f"noise.{name}"]), (n,)) for name in ("white", "bias")},
            "key": keys(streams),
        }
        qpos, qvel = batch.bind("qpos"), batch.bind("qvel")
        rollouts = Rollouts(self._programs, given, n)
        if rollouts.start is not None:
            qpos[:] = rollouts.start
            batch.forward()
        rollouts.enter(own.observed(qpos, qvel, seen).astype(np.float32))
        duration = np.full(n, self.duration) if rollouts.duration is None else rollouts.duration
        ticks = np.rint(np.minimum(duration, self.duration) / period).astype(int)
        mass = _expanded(batch, "body_mass").sum(axis=1)
        limits = {name: _expanded(batch, name) for name in ("actuator_forcerange", "jnt_range")}
        meter = figures.Meter(self._model, own.base, own.feet, qpos)
        broken, frames, steps = np.zeros(n, dtype=bool), [], None
        controls = np.zeros((n, self._substeps, self._model.nu))
        for k in range(int(ticks.max(initial=0))):
            going = k < ticks
            ctrl = rollouts.tick(own.observed(qpos, qvel, seen).astype(np.float32))
            broken |= going & ~np.isfinite(ctrl).all(axis=1)
            controls[:] = np.nan_to_num(ctrl)[:, None]
            steps = batch.rollout(self._substeps, controls, record=figures.STEPS, out=steps)
            seen = steps["sensordata"][:, -1]
            meter.update(steps, limits, self._model.opt.timestep, going)
            if slots is not None and (k + 1) % every == 0:
                last = (steps[name][slots, -1].copy() for name in ("qpos", "qvel", "actuator_force"))
                at, speed, force = last
                frames.append(Frame((k + 1) * period, at, speed, ctrl[slots], force))
        warned = batch.warning[:, :, 0] > 0
        found = meter.figures(mass, broken | warned[:, BROKEN].any(axis=1), warned[:, FULL].any(axis=1))
        return found, frames


def substeps(model: mujoco.MjModel, period: float) -> None:
    """Raise `InputError` where a tick is no whole number of physics steps."""
    steps = period / model.opt.timestep
    if round(steps) < 1 or abs(steps - round(steps)) > 1e-6:
        raise InputError(
            f"model.period = {period:g} is not allowed: a multiple of {model.opt.timestep:g} s, the model's time step"
        )


def _expanded(batch: Batch, name: str) -> np.ndarray:
    """A field of every model (n, ...), whether they differ in it or not."""
    own = batch._expanded.get(name)
    values: np.ndarray = getattr(batch.model, name) if own is None else own
    return np.broadcast_to(values, (batch.nsim, *getattr(batch.model, name).shape))

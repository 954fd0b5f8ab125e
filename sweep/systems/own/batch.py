"""Rollouts of an own model as they begin: models of their own, what their controllers are given, and poses."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, NamedTuple

import mujoco
import numpy as np
from mujoco.batch import MODEL_FIELDS, Batch

from sweep.engines import devices
from sweep.engines.settings import EngineSettings
from sweep.systems.own import fields
from sweep.systems.own.policy import keys
from sweep.systems.own.subject import Side, Subject

NUMBERS = {"float32": np.float32, "float64": np.float64}  # what controllers reckon in, by `engine.precision`
LIMITS = "actuator_forcerange", "jnt_range"


class AtStart(NamedTuple):
    """n rollouts at their first tick."""

    batch: Batch  # at the keyframe
    qpos: np.ndarray  # (n, nq), of the batch: what is written here is where it goes on from
    qvel: np.ndarray  # (n, nv), likewise
    sensors: np.ndarray  # (n, nsensordata), likewise
    given: dict[str, Any]  # to the controllers, by row
    mass: np.ndarray  # (n,) kg
    limits: dict[str, np.ndarray]  # by field, (n, ..., 2)

    def models(self, slots: np.ndarray | None) -> list[mujoco.MjModel]:
        """Of the rollouts in `slots`."""
        return [] if slots is None else [self.batch.get_model(int(slot)) for slot in slots]

    def energy(self, qpos: np.ndarray, qvel: np.ndarray) -> np.ndarray:
        """Of each model (n,), potential and kinetic (J), at positions (n, nq) and velocities (n, nv) that it takes."""
        finite = np.isfinite(qpos).all(axis=1) & np.isfinite(qvel).all(axis=1)
        self.qpos[:], self.qvel[:] = qpos, qvel
        with energies(self.batch) as found:
            self.batch.forward(np.flatnonzero(finite), int(mujoco.mjtStage.mjSTAGE_VEL))
        return np.where(finite, found.sum(axis=1), np.nan)

    def pose(self, start: np.ndarray | None) -> np.ndarray:
        """Begin at positions (n, nq) rather than at the keyframe, if there are any; the energy there (n,), in J."""
        with energies(self.batch) as found:
            if start is not None:
                self.qpos[:] = start
            self.batch.forward()
        return np.where(np.isfinite(self.qpos).all(axis=1), found.sum(axis=1), np.nan)


@contextmanager
def energies(batch: Batch) -> Iterator[np.ndarray]:
    """Those of a batch's models, potential and kinetic (n, 2), as its calls inside find them on all cores."""
    flags, found = batch.expand("opt.enableflags"), batch.bind("energy")
    usual = flags.copy()
    flags |= int(mujoco.mjtEnableBit.mjENBL_ENERGY)
    yield found
    flags[:] = usual


def begin(own: Subject, settings: EngineSettings, world: Side, belief: Side, streams: np.ndarray) -> AtStart:
    """Rollouts of a batch of two sides."""
    n, number = len(streams), NUMBERS[settings.precision]
    batch = Batch(own.model, n, devices.cores())
    qpos, qvel, sensors = (batch.bind(name) for name in ("qpos", "qvel", "sensordata"))
    # bound before the reset: what is bound after it is zero until the next call
    varied = fields.by_rollout(own.model, world.of("model"))
    fields.write(batch, {path: np.broadcast_to(value, (n,)) for path, value in varied.items()}, own.source)
    batch.reset(keyframe=own.keyframe, stage=int(mujoco.mjtStage.mjSTAGE_NONE))
    noise = {**own.noise, **world.of("noise")}
    told = own.told({**belief.of("model"), **belief.of("controller")})
    given = {
        "belief": {name: np.broadcast_to(number(value), (n,)) for name, value in told.items()},
        "delay": np.broadcast_to(np.rint(noise["noise.delay"]).astype(np.int32), (n,)),
        **{name: np.broadcast_to(number(noise[f"noise.{name}"]), (n,)) for name in ("white", "bias")},
        "key": keys(streams),
    }
    mass = expanded(batch, "body_mass").sum(axis=1)
    return AtStart(batch, qpos, qvel, sensors, given, mass, {name: expanded(batch, name) for name in LIMITS})


def ticks(own: Subject, duration: np.ndarray | None, n: int) -> np.ndarray:
    """Control ticks of each of n rollouts, whose controllers may end them early (s)."""
    longest = own.about.duration
    seconds = np.full(n, longest) if duration is None else np.minimum(duration, longest)
    return np.rint(seconds / own.about.period).astype(int)


def expanded(batch: Batch, name: str) -> np.ndarray:
    """A field of every model (n, ...), whether they differ in it or not; what follows from others, too."""
    rows, same = _own_rows(batch, name), fields.whole(batch.model, name)
    return np.broadcast_to(same, (batch.nsim, *same.shape)) if rows is None else rows


def differing(batch: Batch) -> dict[str, np.ndarray]:
    """The fields in which a batch's models differ from its own, (n, ...)."""
    found = {name: _own_rows(batch, name) for name in sorted(MODEL_FIELDS)}
    return {
        name: rows
        for name, rows in found.items()
        if rows is not None and rows.dtype.kind == "f" and (rows != fields.whole(batch.model, name)).any()
    }


def _own_rows(batch: Batch, name: str) -> np.ndarray | None:
    """A field's values (n, ...) where each model has its own, even if all are alike."""
    return batch._expanded.get(name) if name.startswith("opt.") else batch._expanded_values(name)

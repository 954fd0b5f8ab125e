"""An own model on C MuJoCo: a batch of models on all cores, each rollout with fields of its own.

Bits depend neither on threads nor on how many rollouts share a batch.
"""

from collections.abc import Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from typing import Any

import mujoco
import numpy as np

from sweep.engines import devices
from sweep.engines.base import Figures
from sweep.engines.settings import EngineSettings
from sweep.systems.own import batch, figures
from sweep.systems.own.engine import Frame, Loop
from sweep.systems.own.policy import Rollouts
from sweep.systems.own.subject import Side, Subject

WIDTH = 256
W = mujoco.mjtWarning
BROKEN = [int(w) for w in (W.mjWARN_INERTIA, W.mjWARN_BADQPOS, W.mjWARN_BADQVEL, W.mjWARN_BADQACC, W.mjWARN_BADCTRL)]
SOLVER = ("solver_niter", "M", *figures.BALANCE)  # what is recorded of it, beside figures' own
FULL = [int(w) for w in (W.mjWARN_CONTACTFULL, W.mjWARN_CNSTRFULL)]


class Native(Loop):
    """See `Engine`."""

    dynamics = "C MuJoCo"

    def __init__(self, own: Subject, settings: EngineSettings):
        mujoco.set_mju_user_warning(lambda _: None)  # a row that it is about is invalid
        super().__init__(own, settings)
        self.width = settings.width or WIDTH

    @contextmanager
    def _within(self) -> Iterator[None]:
        """See `Loop`; and on the CPU, of which rows say that they are, beside a GPU too."""
        with super()._within(), devices.on_cpu():
            yield

    def _simulate(
        self, world: Side, belief: Side, streams: np.ndarray, slots: np.ndarray | None = None, every: int = 1
    ) -> tuple[Figures, list[Frame], list[mujoco.MjModel]]:
        own, n = self._own, len(streams)
        # figures of a tick are worked out, on one core, while the next one is simulated on all of them
        with self._within(), ThreadPoolExecutor(1) as aside:
            begun = batch.begin(own, self._settings, world, belief, streams)
            qpos, qvel, seen = begun.qpos, begun.qvel, begun.sensors
            rollouts = Rollouts(self._programs, begun.given, n)
            before_all = begun.pose(rollouts.start)
            ticks = batch.ticks(own, rollouts.duration, n)
            rollouts.enter(own.state(qpos, qvel, seen), ticks)
            meter = figures.Meter(own)
            sofar = aside.submit(meter.start, qpos.copy(), qvel.copy())

            def measured(sofar: Any, steps: Any, going: np.ndarray) -> dict[str, Any]:
                return meter.update(sofar, {**steps, "unsolved": unsolved(self._model, steps)}, begun.limits, going)

            broken, frames, before = np.zeros(n, dtype=bool), [], None
            recorded: list[Any] = [None, None]  # of this tick and the one before
            controls = np.zeros((n, self._substeps, self._model.nu))
            for k in range(int(ticks.max(initial=0))):
                going = k < ticks
                ctrl = rollouts.tick(own.state(qpos, qvel, seen))
                broken |= going & ~np.isfinite(ctrl).all(axis=1)
                ctrl = np.nan_to_num(ctrl)
                before = ctrl if before is None else before
                controls[:] = before[:, None] + self._shares[:, None] * (ctrl - before)[:, None]
                before = ctrl
                out = recorded[k % 2]
                told = *figures.STEPS, *SOLVER
                steps = recorded[k % 2] = begun.batch.rollout(self._substeps, controls, record=told, out=out)
                seen = steps["sensordata"][:, -1]
                sofar = aside.submit(measured, sofar.result(), steps, going)
                if slots is not None and (k + 1) % every == 0:
                    last = (steps[name][slots, -1].copy() for name in ("qpos", "qvel", "actuator_force"))
                    at, speed, force = last
                    frames.append(Frame((k + 1) * own.about.period, at, speed, ctrl[slots], force))
            own_figures = rollouts.finish(own.state(qpos, qvel, seen))
        warned = begun.batch.warning[:, :, 0] > 0
        broken |= warned[:, BROKEN].any(axis=1)
        last = sofar.result()
        gained = begun.energy(last["last"], last["speed"]) - before_all
        found = meter.figures(last, begun.mass, gained, broken, warned[:, FULL].any(axis=1))
        return found | own_figures, frames, begun.models(slots)


def unsolved(model: mujoco.MjModel, steps: Mapping[str, np.ndarray]) -> np.ndarray:
    """Which steps (n, s) took all of the solver's iterations and are not solved by them.

    What PGS and noslip find balances whatever it is, so that of theirs the iterations alone are known.
    """
    found = steps["solver_niter"].reshape(*steps["M"].shape[:2], -1).max(axis=2) >= model.opt.iterations
    if found.any() and model.opt.solver != int(mujoco.mjtSolver.mjSOL_PGS) and not model.opt.noslip_iterations:
        inertia, *forces = (steps[name][found] for name in SOLVER[1:])
        row, column = np.repeat(np.arange(model.nv), model.M_rownnz), model.M_colind
        mass = np.zeros((len(inertia), model.nv, model.nv))  # of which the lower triangle is recorded
        mass[:, row, column] = mass[:, column, row] = inertia
        found[found] = figures.unbalanced(mass, *forces)
    return found

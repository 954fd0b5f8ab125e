"""Speed over error: the robot standing and walking by targets recorded once, the same MJCF before C MuJoCo and MJX.

Standing, errors are of the feet's loads against the equilibrium of weight, drives and springs. Walking open loop they
are of the base's path against the same engine at its finest step: the laws of contact differ, and with them the paths.
"""

import dataclasses
import io
import time
from collections.abc import Callable, Iterator
from contextlib import redirect_stdout
from functools import cache
from typing import Any, NamedTuple

import mujoco
import numpy as np
from mujoco import rollout

from sweep.core.constants import GRAVITY
from sweep.engines.closed_loop import start_state
from sweep.engines.mjx import Mjx
from sweep.models.case import Case
from sweep.models.legs import JOINT_Q, N_LEGS
from sweep.models.robot import total_mass
from sweep.study.config import compose
from sweep.systems import exported
from validity import robot, simulation
from validity.tables import short

FINEST = 1.25e-4  # s
OWN = [(2e-3, 1), (2e-3, 2), (1e-3, 2), (5e-4, 2), (2.5e-4, 4)]  # s, and iterations: of contacts
C = [(2e-3, 50), (1e-3, 50), (1e-3, 5), (5e-4, 50), (2.5e-4, 50)]  # and most iterations of Newton's method
MJX = [(1e-3, 50)]  # each compiles for half a minute
WIDTHS = {"mjx": 128, "C MuJoCo": 16, "MJX": 32}  # rollouts that are timed
WALKED = 2.0  # s


class Motion(NamedTuple):
    """What the robot is told."""

    name: str
    case: Case
    q: np.ndarray  # (25,) at the start
    time: np.ndarray  # (k,) s
    targets: np.ndarray  # (k, 18) rad
    loads: np.ndarray | None  # (6,) N, of its feet at the end, where it comes to rest

    def told(self, h: float) -> np.ndarray:
        """Targets (t, 18) at the ends of steps of `h` seconds."""
        steps = np.arange(1, round(self.time[-1] / h) + 1) * h
        return np.stack([np.interp(steps, self.time, column) for column in self.targets.T], axis=1)


@cache
def motions() -> tuple[Motion, ...]:
    """Standing on six feet, and walking as `walk_tripod` does."""
    case, rows = robot.rows()
    stands, drawn = rows[0], rows[0].targets.ravel()
    times = np.array([0.0, robot.RAMP, robot.SECONDS])
    loads = robot.equilibrium(case, stands)[:, 2]
    level = dataclasses.replace(case, obstacle=compose(["manoeuvre=stand"]).case.obstacle)
    standing = Motion("standing", level, stands.q, times, np.stack([stands.q[JOINT_Q], drawn, drawn]), loads)
    exp = compose(["scenario=walk_tripod"])
    engine = Mjx(dataclasses.replace(exp.settings, width=1), exp.case, exp.case, exp.thresholds)
    (trace,) = engine.traces(exp.case, exp.case, np.zeros(1, int), 1)
    n = int(np.searchsorted(trace.time, WALKED + 1e-9))
    first = np.asarray(start_state(exp.case, exp.case, exp.case.manoeuvre.plan(exp.case)).qpos, float)
    targets = np.vstack([first[JOINT_Q], trace.joint_target[:n]])
    walking = Motion("walking", exp.case, first, np.concatenate([[0.0], trace.time[:n]]), targets, None)
    return standing, walking


def jobs() -> Iterator[tuple[str, Callable[[], list[dict[str, Any]]]]]:
    """One for each engine and motion."""
    mujoco.set_mju_user_warning(lambda _: None)  # that a robot falls shows in its errors
    for engine, rows in (("mjx", _own), ("C MuJoCo", _c), ("MJX", _mjx)):
        for k, name in enumerate(("standing", "walking")):
            yield f"{engine}, {name}", lambda rows=rows, k=k: rows(motions()[k])


def _row(
    motion: Motion, engine: str, h: float, iterations: int, error: float, seconds: float, **more: Any
) -> dict[str, Any]:
    """`seconds`: that the batch took."""
    simulated = WIDTHS[engine] * motion.time[-1]
    return {"engine": engine, "motion": motion.name, "time_step": h, "iterations": iterations, "error": short(error),
            "per_s": short(simulated / seconds), "steps_per_s": short(simulated / h / seconds), **more}  # fmt: skip


def _error(motion: Motion, loads: np.ndarray, path: np.ndarray, finest: np.ndarray | None) -> float:
    """Of loads (t, 6), by the weight, or of the base's path (t, 3) in metres."""
    if motion.loads is not None:
        last = loads[-max(1, len(loads) // 10) :].mean(axis=0)
        return float(np.abs(last - motion.loads).max() / (total_mass(motion.case.robot) * GRAVITY))
    assert finest is not None
    every = len(finest) // len(path)
    return float(np.linalg.norm(path - finest[every - 1 :: every], axis=-1).max())


def _own(motion: Motion) -> list[dict[str, Any]]:
    def run(h: float, iterations: int, q: np.ndarray) -> simulation.History:
        told = motion.told(h).reshape(-1, N_LEGS, 3).astype(np.float32)
        return simulation.simulate(
            motion.case, motion.case, q.astype(np.float32), told, h, None, iterations, fused=True
        )

    finest = None if motion.loads is not None else run(FINEST, 4, motion.q[None]).q[:, 0, :3]
    rows = []
    for h, iterations in OWN:
        found = run(h, iterations, motion.q[None])
        error = _error(motion, found.normal[:, 0], found.q[:, 0, :3], finest)
        told, many = motion.told(h).reshape(-1, N_LEGS, 3).astype(np.float32), np.tile(motion.q, (WIDTHS["mjx"], 1))
        running = simulation.begun(motion.case, many.astype(np.float32), told, h, iterations)
        seconds = _timed(lambda running=running, told=told: running.tiles.advance(0, len(told)))
        contacts = float((found.normal > 0).sum(axis=-1).mean())
        more = {"contacts": contacts, "residual_n": found.residual.max(), "compile_s": running.compile_s}
        more = {name: short(float(x)) for name, x in more.items()}
        rows.append(_row(motion, "mjx", h, iterations, error, seconds, **more))
    return rows


def _timed(work: Callable[[], object]) -> float:
    """Seconds of a core: by the wall others would be timed, too."""
    start = time.process_time()
    work()
    return time.process_time() - start


def _model(motion: Motion, h: float, iterations: int) -> mujoco.MjModel:
    exp = compose(["engine=native"])
    model = exported.spec(motion.case, exp.settings).compile()
    model.opt.timestep, model.opt.iterations = h, iterations
    return model


def _loads_of(model: mujoco.MjModel) -> np.ndarray:
    return np.array([model.sensor(f"load_foot{leg + 1}").adr[0] for leg in range(N_LEGS)])


def _c_run(motion: Motion, h: float, iterations: int) -> tuple[np.ndarray, np.ndarray, float, float]:
    """Loads, the base's path, contacts and iterations in the mean."""
    model = _model(motion, h, iterations)
    data, where = mujoco.MjData(model), _loads_of(model)
    data.qpos[:] = motion.q
    kept = []
    for told in motion.told(h):
        data.ctrl[:] = told
        mujoco.mj_step(model, data)
        kept.append([*data.sensordata[where], *data.qpos[:3], data.ncon, data.solver_niter[0]])
    kept = np.array(kept)
    return kept[:, :6], kept[:, 6:9], float(kept[:, 9].mean()), float(kept[:, 10].mean())


def _c(motion: Motion) -> list[dict[str, Any]]:
    finest = None if motion.loads is not None else _c_run(motion, FINEST, 50)[1]
    rows = []
    for h, most in C:
        loads, path, contacts, iterations = _c_run(motion, h, most)
        model, width = _model(motion, h, most), WIDTHS["C MuJoCo"]
        begun = mujoco.MjData(model)
        begun.qpos[:] = motion.q
        state = np.zeros(mujoco.mj_stateSize(model, mujoco.mjtState.mjSTATE_FULLPHYSICS))
        mujoco.mj_getState(model, begun, state, mujoco.mjtState.mjSTATE_FULLPHYSICS)
        told = np.tile(motion.told(h), (width, 1, 1))
        threads = [mujoco.MjData(model) for _ in range(2)]
        seconds = _timed(lambda m=model, t=threads, s=state, c=told: rollout.rollout(m, t, np.tile(s, (len(c), 1)), c))
        error = _error(motion, loads, path, finest)
        rows.append(
            _row(motion, "C MuJoCo", h, most, error, seconds, contacts=short(contacts), taken=short(iterations))
        )
    return rows


def _mjx(motion: Motion) -> list[dict[str, Any]]:
    import jax
    import jax.numpy as jnp

    with redirect_stdout(io.StringIO()):  # which it prints as it is imported
        from mujoco import mjx

    finest = None if motion.loads is not None else _c_run(motion, FINEST, 50)[1]
    rows = []
    for h, iterations in MJX:
        model = _model(motion, h, iterations)
        there, where = mjx.put_model(model), _loads_of(model)
        begun = mjx.make_data(there).replace(qpos=jnp.asarray(motion.q, jnp.float32))

        def run(data, told, there=there, where=where):
            def ahead(data, ctrl):
                data = mjx.step(there, data.replace(ctrl=ctrl))
                return data, (data.sensordata[where], data.qpos[:3])

            return jax.lax.scan(ahead, data, told)[1]

        told = jnp.asarray(motion.told(h), jnp.float32)
        many = jax.jit(jax.vmap(run, in_axes=(0, None)))
        batch = jax.tree.map(lambda x: jnp.broadcast_to(x, (WIDTHS["MJX"], *x.shape)), begun)
        start = time.perf_counter()
        program = many.lower(batch, told).compile()
        compile_s = time.perf_counter() - start
        loads, path = (np.asarray(x[0], float) for x in program(batch, told))
        seconds = _timed(lambda program=program, batch=batch, told=told: jax.block_until_ready(program(batch, told)))
        error = _error(motion, loads, path, finest)
        rows.append(_row(motion, "MJX", h, iterations, error, seconds, compile_s=short(compile_s)))
    return rows

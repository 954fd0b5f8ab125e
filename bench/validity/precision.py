"""Speed over error: the robot standing and walking by recorded targets, and two scenes, on one core or a GPU.

C MuJoCo, MJX and MuJoCo Warp have the same MJCF, that of the native engine. Errors of standing are those of the feet's
loads against the equilibrium of weight, drives and springs; errors of scenes are those of their first figure. Walking
open loop, errors are those of the base's path against the same engine at its finest step, or for MJX and Warp against C
MuJoCo: the contact laws differ, and with them the paths.
"""

import dataclasses
import io
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import redirect_stdout
from functools import cache
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from mujoco import rollout

from sweep.config.experiment import compose
from sweep.core.constants import GRAVITY
from sweep.engines.batching import require_trace
from sweep.engines.closed_loop import start_state
from sweep.engines.mjx import MjxEngine
from sweep.models.case import Case
from sweep.models.legs import JOINT_Q, N_LEGS
from sweep.models.robot import total_mass
from sweep.systems.hexapod import exported
from sweep.systems.mujoco_model.mjx import CARRIED_FIELDS, WARP_CONSTRAINTS_PER_CONTACT, WARP_CONTACTS_PER_ROLLOUT
from validity import peers, points, robot, simulation
from validity.scenes import History, Scene, error, kick_on_slope, slides_then_rolls
from validity.tables import short

TICK = 4e-3  # s, from one row of targets to the next, and between samples
FINEST = 1.25e-4  # s
OWN = [(2e-3, 1), (2e-3, 2), (1e-3, 2), (5e-4, 2), (2.5e-4, 4)]  # s, and iterations: of contacts
C = [(2e-3, 50), (1e-3, 50), (1e-3, 5), (5e-4, 50), (2.5e-4, 50)]  # and most iterations of Newton's method
BATCHED = [(2e-3, 50), (1e-3, 50), (5e-4, 50)]  # of MJX and MuJoCo Warp
PIECE = 100  # steps of a program of theirs
CORE = {"mjx": 128, "C MuJoCo": 16, "MJX": 32}  # rollouts that are timed
GPU = {"mjx": 131072, "C MuJoCo": 16, "MJX": 4096, "Warp": 32768}
SHORT = 3  # of `OWN`, in scenes on a GPU, where a simulated second of a batch takes 12 s at the first of them
WALKED = 2.0  # s
Settings = tuple[float, int]


class Samples(NamedTuple):
    """Of one rollout, a tick apart: MuJoCo's qpos and qvel, and the loads of the robot's feet."""

    q: np.ndarray  # (t, nq)
    v: np.ndarray  # (t, nv)
    load: np.ndarray  # (t, 6) N, none of a scene


class Task(NamedTuple):
    """A simulation whose error and speed are measured."""

    name: str
    seconds: float
    own: points.Batch  # of one rollout
    table: np.ndarray  # (t + 1, 6, 3) rad, targets of joints
    model: Callable[[], mujoco.MjModel]
    beside: tuple[int, int]  # numbers of q and v before those of the model: of the robot beside a scene
    off: Callable[[Samples, Samples | None], float]  # the error, where need be against the finest
    to_finest: bool = False

    def targets_at_steps(self, h: float) -> np.ndarray:
        """Return the joint targets (t, 18) at the ends of steps of `h` seconds; none (t, 0) in a scene."""
        at, rows = np.arange(1, round(self.seconds / h) + 1) * h, self.table.reshape(len(self.table), -1)
        if any(self.beside):
            return np.zeros((len(at), 0))
        return np.stack([np.interp(at, TICK * np.arange(len(rows)), column) for column in rows.T], axis=1)

    def mujoco_start(self, h: float, iterations: int) -> tuple[mujoco.MjModel, mujoco.MjData]:
        """Return C MuJoCo's model and data before the first step."""
        model = self.model()
        model.opt.timestep, model.opt.iterations = h, iterations
        data, (nq, nv) = mujoco.MjData(model), self.beside
        data.qpos[:], data.qvel[:] = self.own.q[0, nq : nq + model.nq], self.own.v[0, nv : nv + model.nv]
        return model, data


@cache
def tasks() -> tuple[Task, ...]:
    """Standing on six feet, walking as `walk_tripod` does, and two scenes."""
    return standing(), _walking(), scene(kick_on_slope()), scene(slides_then_rolls())


def standing() -> Task:
    """The robot on six feet."""
    case, rows = robot.rows()
    stands, weight = rows[0], float(total_mass(case.robot)) * GRAVITY
    loads = robot.equilibrium(case, stands)[:, 2]
    level = dataclasses.replace(case, obstacle=compose(["manoeuvre=stand"]).case.obstacle)
    begun, times = stands.q[JOINT_Q].reshape(N_LEGS, 3), np.arange(round(robot.SECONDS / TICK) + 1) * TICK
    table = begun + np.minimum(times / robot.RAMP, 1.0)[:, None, None] * (stands.targets - begun)

    def off(found: Samples, _: Samples | None) -> float:
        last = found.load[-max(1, len(found.load) // 10) :].mean(axis=0)
        return float(np.abs(last - loads).max() / weight)

    return Task("standing", robot.SECONDS, _alone(level, stands.q), table, _mjcf(level), (0, 0), off)


def _walking() -> Task:
    exp = compose(["scenario=walk_tripod"])
    engine = MjxEngine(dataclasses.replace(exp.settings, width=1), exp.case, exp.case, exp.thresholds)
    trace = require_trace(engine.traces(exp.case, exp.case, np.zeros(1, int), 1)[0])
    first = np.asarray(start_state(exp.case, exp.case, exp.case.manoeuvre.plan(exp.case)).qpos, float)
    targets = np.vstack([first[JOINT_Q], trace.joint_target[: round(WALKED / TICK)]]).reshape(-1, N_LEGS, 3)

    def off(found: Samples, finest: Samples | None) -> float:
        assert finest is not None
        return float(np.linalg.norm(found.q[:, :3] - finest.q[:, :3], axis=-1).max())

    return Task("walking", WALKED, _alone(exp.case, first), targets, _mjcf(exp.case), (0, 0), off, to_finest=True)


def _alone(case: Case, q: np.ndarray) -> points.Batch:
    return points.Batch(case, case, q[None], np.zeros((1, len(q) - 1)), q[JOINT_Q])


def _mjcf(case: Case) -> Callable[[], mujoco.MjModel]:
    return lambda: exported.make_mujoco_spec(case, compose(["engine=native"]).settings).compile()


def scene(of: Scene) -> Task:
    """A scene, and the robot that stands beside it where this package steps it."""
    own, figure = points.batch([of]), of.figures[0]
    size, count = round(of.seconds / TICK), len(of.bodies)
    table = np.broadcast_to(own.joints.reshape(N_LEGS, 3), (size + 1, N_LEGS, 3))

    def off(found: Samples, _: Samples | None) -> float:
        q = found.q[:, : 7 * count].reshape(-1, count, 7)
        v = found.v[:, : 6 * count].reshape(-1, count, 6)
        time = TICK * (1 + np.arange(len(q)))
        history = History(time, q[..., :3], q[..., 3:], v[..., :3], v[..., 3:], np.zeros(0))
        return error(figure, figure.of(history), float("nan"))

    return Task(of.name, of.seconds, own, table, lambda: peers.model(of, peers.NATIVE), (25, 24), off)


def jobs() -> Iterator[tuple[str, Callable[[], list[dict[str, Any]]]]]:
    """One for each engine and task."""
    mujoco.set_mju_user_warning(lambda _: None)  # that a robot falls shows in its errors
    engines: dict[str, Callable[[Task], list[dict[str, Any]]]] = {"mjx": _own}
    if peers.has_warp():
        engines["Warp"] = lambda task: by_mjx(task, "Warp", "warp", BATCHED, GPU["Warp"])
    engines["C MuJoCo"] = _c
    engines["MJX"] = lambda task: by_mjx(task, "MJX", "jax", BATCHED, _width("MJX"))
    for engine, rows in engines.items():
        for k, name in enumerate(("standing", "walking", kick_on_slope().name, slides_then_rolls().name)):
            yield f"{engine}, {name}", lambda rows=rows, k=k: rows(tasks()[k])


def on_gpu() -> bool:
    """Whether there is one."""
    return jax.default_backend() == "gpu"


def _width(engine: str) -> int:
    return (GPU if on_gpu() else CORE)[engine]


def _row(task: Task, engine: str, used: Settings, error: float, width: int, seconds: float, **more: float) -> Any:
    """`seconds`: that the batch took, of a core or of the GPU."""
    h, iterations = used
    simulated = width * task.seconds
    return {"engine": engine, "motion": task.name, "time_step": h, "iterations": iterations, "error": short(error),
            "of": "GPU" if on_gpu() and engine != "C MuJoCo" else "core", "width": width,
            "per_s": short(simulated / seconds), "steps_per_s": short(simulated / h / seconds),
            **{name: short(x) for name, x in more.items()}}  # fmt: skip


def _timed(work: Callable[[], object]) -> tuple[Any, float]:
    """What comes of it, and seconds: of a core, as by the wall others would be timed, too; of a GPU by the wall."""
    clock = time.perf_counter if on_gpu() else time.process_time
    start = clock()
    found = work()
    return found, clock() - start


def _own(task: Task) -> list[dict[str, Any]]:
    finest = _own_run(task, (FINEST, 4), 1)[0] if task.to_finest else None
    rows = []
    width = _width("mjx")
    for used in OWN[:SHORT] if on_gpu() and any(task.beside) else OWN:
        found, residual, seconds, compile_s = _own_run(task, used, width)
        more = {} if any(task.beside) else {"contacts": float((found.load > 0).sum(axis=-1).mean())}
        more |= {"residual_n": residual, "compile_s": compile_s}
        rows.append(_row(task, "mjx", used, task.off(found, finest), width, seconds, **more))
    return rows


def _own_run(task: Task, used: Settings, width: int) -> tuple[Samples, float, float, float]:
    """Samples of the first rollout, the largest residual (N), and how long the batch and all before it took (s)."""
    (h, iterations), own = used, task.own
    case = jax.tree.map(lambda x: np.repeat(x, width, axis=-1) if np.ndim(x) else x, own.case)
    q, v = (np.repeat(np.asarray(x, np.float32), width, axis=0) for x in (own.q, own.v))
    table = np.asarray(task.table, np.float32)
    running = simulation.compile_batch(case, own.nominal, q, v, table, h, iterations, round(TICK / h))
    record, first = _timed(running.advance)  # on a GPU the driver translates the kernel first
    _, seconds = _timed(running.advance)
    nq, nv = task.beside
    found = Samples(record["q"][:, 0, nq:], record["v"][:, 0, nv:], record["normal"][:, 0])
    return found, float(record["residual"].max()), seconds, running.compile_s + max(0.0, first - seconds)


def _loads_of(model: mujoco.MjModel) -> np.ndarray:
    names = [f"load_foot{leg + 1}" for leg in range(N_LEGS)]
    return np.array([model.sensor(name).adr[0] for name in names if model.nu], int)


def _c_run(task: Task, used: Settings) -> tuple[Samples, float, float]:
    """Samples, contacts and iterations in the mean."""
    model, data = task.mujoco_start(*used)
    where, kept = _loads_of(model), []
    for told in task.targets_at_steps(used[0]):
        data.ctrl[:] = told
        mujoco.mj_step(model, data)
        kept.append([*data.qpos, *data.qvel, *data.sensordata[where], data.ncon, data.solver_niter[0]])
    kept = np.array(kept)
    every = round(TICK / used[0])
    q, v, load, _ = np.split(kept[every - 1 :: every], np.cumsum([model.nq, model.nv, len(where)]), axis=1)
    return Samples(q, v, load), float(kept[:, -2].mean()), float(kept[:, -1].mean())


def _c_finest(task: Task) -> Samples | None:
    return _c_run(task, (FINEST, 50))[0] if task.to_finest else None


def _c(task: Task) -> list[dict[str, Any]]:
    finest, width, rows = _c_finest(task), _width("C MuJoCo"), []
    for used in C:
        found, contacts, taken = _c_run(task, used)
        model, data = task.mujoco_start(*used)
        state = np.zeros(mujoco.mj_stateSize(model, mujoco.mjtState.mjSTATE_FULLPHYSICS))
        mujoco.mj_getState(model, data, state, mujoco.mjtState.mjSTATE_FULLPHYSICS)
        told = np.tile(task.targets_at_steps(used[0]), (width, 1, 1))
        start = time.process_time()
        rollout.rollout(model, [mujoco.MjData(model) for _ in range(2)], np.tile(state, (width, 1)), told,
                        nstep=told.shape[1])  # fmt: skip
        seconds = time.process_time() - start
        off = task.off(found, finest)
        rows.append(_row(task, "C MuJoCo", used, off, width, seconds, contacts=contacts, taken=taken))
    return rows


def by_mjx(task: Task, engine: str, impl: str, settings: Sequence[Settings], width: int) -> list[dict[str, Any]]:
    """Rows of MJX, or of MuJoCo Warp by it, for settings that differ by the time step alone."""
    finest, rows = _c_finest(task), []
    start = time.perf_counter()
    piece, begin = _program(task, settings[0], impl, width)
    compile_s = time.perf_counter() - start
    for used in settings:
        there, now = begin(used[0])
        told = jnp.asarray(task.targets_at_steps(used[0]), jnp.float32)

        def work(there=there, now=now, told=told) -> list[Any]:
            pieces = []
            for k in range(0, len(told), PIECE):
                now, found = piece(there, now, told[k : k + PIECE])
                pieces.append(found)
            return jax.block_until_ready(pieces)

        jax.block_until_ready(piece(there, now, told[:PIECE]))  # Warp loads its kernels then
        pieces, seconds = _timed(work)
        q, v, load, contacts, taken = (np.concatenate([np.asarray(p[k], float) for p in pieces]) for k in range(5))
        every = round(TICK / used[0])
        samples = Samples(*(x[every - 1 :: every] for x in (q, v, load)))
        more = {"contacts": float(contacts.mean()), "compile_s": compile_s}
        more |= {"taken": float(taken.mean())} if impl == "warp" else {}  # MJX's own solver does not tell
        rows.append(_row(task, engine, used, task.off(samples, finest), width, seconds, **more))
    return rows


def _program(task: Task, used: Settings, impl: str, width: int) -> tuple[Callable, Callable[[float], tuple[Any, Any]]]:
    """What takes a batch `PIECE` steps on, and what it begins with at a time step."""
    with redirect_stdout(io.StringIO()):  # which it prints as it is imported
        from mujoco import mjx

    model, data = task.mujoco_start(*used)
    mujoco.mj_forward(model, data)
    where, rooms = _loads_of(model), {}
    if impl == "warp":
        rooms = {
            "naconmax": WARP_CONTACTS_PER_ROLLOUT * width,
            "njmax": WARP_CONSTRAINTS_PER_CONTACT * WARP_CONTACTS_PER_ROLLOUT + model.njnt + 2 * model.nv,
        }
    begun = mjx.put_data(model, data, impl=impl, **rooms)

    def begin(h: float) -> tuple[Any, Any]:
        model.opt.timestep = h
        now = {name: jnp.broadcast_to(x := getattr(begun, name), (width, *x.shape)) for name in CARRIED_FIELDS}
        return mjx.put_model(model, impl=impl), now

    def one(there: Any, now: dict[str, jax.Array], ctrl: jax.Array) -> tuple[dict[str, jax.Array], Any]:
        after = mjx.step(there, begun.replace(**now, ctrl=ctrl))
        # Warp has the contacts of all rollouts in one list
        contacts = after._impl.nacon[0] / width if impl == "warp" else jnp.sum(after._impl.contact.dist < 0)
        told = after.qpos, after.qvel, after.sensordata[where], contacts, jnp.ravel(after._impl.solver_niter)[0]
        return {name: getattr(after, name).astype(now[name].dtype) for name in CARRIED_FIELDS}, told

    def ahead(there: Any, now: dict[str, jax.Array], ctrl: jax.Array) -> tuple[dict[str, jax.Array], Any]:
        now, told = jax.vmap(one, (None, 0, None))(there, now, ctrl)
        return now, jax.tree.map(lambda x: x[0], told)

    program = jax.jit(lambda there, now, told: jax.lax.scan(lambda now, ctrl: ahead(there, now, ctrl), now, told))
    like = jax.ShapeDtypeStruct((PIECE, model.nu), jnp.float32)
    return program.lower(*begin(used[0]), like).compile(), begin

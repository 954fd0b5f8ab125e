"""A raft that heaves, and one that rocks in water that rubs: about which draught, and with which periods and decay.

Answers are Archimedes' draught, and small motions' poles (4.2).
"""

import dataclasses
import io
from contextlib import redirect_stdout
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import mujoco
import numpy as np

from sweep.config.experiment import compose
from sweep.core.constants import GRAVITY
from sweep.core.rotations import exponential
from sweep.engines.closed_loop import free_body_state
from sweep.formulas.raft_dynamics import RaftBody as Formula
from sweep.formulas.raft_dynamics import raft_linear
from sweep.models.obstacles.raft import Raft
from validity.scenes import Figure
from validity.simulation import simulate

GAMMA, SECONDS, OPEN = 9810.0, 4.0, 100.0  # N/m³ of water; m, far from both banks
HEAVE, PITCH = 0.01, 1e-3  # m, rad
AWAY = 1e3  # m, that the robot falls from


def rafts() -> tuple[Raft, Raft]:
    """One without drag, one in viscous water."""
    return (Raft(gap=OPEN, water_width=1e3, drag=0.0, viscosity=0.0),
            Raft(gap=OPEN, water_width=1e3, drag=0.0, viscosity=500.0))  # fmt: skip


def formula(raft: Raft) -> Formula:
    """The same in chapter 4's words."""
    a, b, d = (float(x) for x in np.asarray(raft.half_size))
    mass = float(raft.mass)
    inertia = mass / 3 * jnp.array([b * b + d * d, a * a + d * d, a * a + b * b])
    return Formula(a, b, d, GAMMA, float(raft.draught(0.0)) - d, float(raft.viscosity), 0.0, GRAVITY * mass, mass,
                   inertia, jnp.zeros(3))  # fmt: skip


class Motion(NamedTuple):
    """Of both rafts: the one's draught, and its height off its rest, the other's pitch."""

    time: np.ndarray  # (t,) s
    draught: np.ndarray  # m
    height: np.ndarray  # m
    pitch: np.ndarray  # rad


def figures() -> tuple[Figure, ...]:
    """What closed forms say of them."""
    heaves, rocks = rafts()
    a, b, _ = np.asarray(heaves.half_size, float)
    heave = float(2 * np.pi * np.sqrt(float(heaves.mass) / (GAMMA * 4 * a * b)))
    words = formula(rocks)
    with jax.enable_x64(True):
        forces = np.asarray(raft_linear(words).matrix)
    pitching = forces[np.ix_([0, 4], [0, 4, 6, 10])] / np.array([[float(words.M)], [float(words.J[1])]])
    poles = np.linalg.eigvals(np.vstack([np.eye(2, 4, 2), pitching]))
    pole = poles[np.argmax(poles.imag)]
    period, decay = float(2 * np.pi / pole.imag), float(-pole.real)
    draught = float(heaves.mass) * GRAVITY / (GAMMA * 4 * a * b)
    return (
        Figure("draught", "m", lambda h: _rest(h.time, h.draught), draught, draught, 0.001),
        Figure("period of heave", "s", lambda h: _period(h.time, h.height), heave, heave, 0.005),
        Figure("period of pitch", "s", lambda h: _period(h.time, h.pitch), period, period, 0.005),
        Figure("decay of pitch", "1/s", lambda h: _decay(h.time, h.pitch), decay, decay, 0.1),
    )


def _rest(time: np.ndarray, x: np.ndarray) -> float:
    """The mean over whole periods."""
    off = x - x.mean()
    late = np.flatnonzero((off[:-1] < 0) & (off[1:] >= 0))
    return float(x[late[0] + 1 : late[-1] + 1].mean())


def _period(time: np.ndarray, x: np.ndarray) -> float:
    """Between the first and the last time that `x` passes zero upwards."""
    late = np.flatnonzero((x[:-1] < 0) & (x[1:] >= 0))
    passes = time[late] - x[late] * (time[late + 1] - time[late]) / (x[late + 1] - x[late])
    return float((passes[-1] - passes[0]) / (len(passes) - 1))


def _decay(time: np.ndarray, x: np.ndarray) -> float:
    """Of the peaks, each by the parabola through it and its neighbours."""
    top = 1 + np.flatnonzero((x[1:-1] > x[:-2]) & (x[1:-1] >= x[2:]))
    before, at, after = x[top - 1], x[top], x[top + 1]
    height = at + (after - before) ** 2 / (8 * (2 * at - before - after))
    return float(-np.polyfit(time[top], np.log(height), 1)[0])


def by_step(h: float = 2e-3, iterations: int = 2, double: bool = False, fused: bool = False) -> Motion:
    """Both rafts by this package's step, robots falling far above."""
    nominal = dataclasses.replace(compose([]).case, obstacle=rafts()[0])
    kind = np.float64 if double else np.float32
    q, v = np.zeros((2, 32), kind), np.zeros((2, 30), kind)
    q[:, 2], q[:, 3] = AWAY, 1.0
    q[:, 25:] = [_start(raft, k) for k, raft in enumerate(rafts())]
    raft = dataclasses.replace(rafts()[0], viscosity=np.array([raft.viscosity for raft in rafts()]))  # pyright: ignore
    case = dataclasses.replace(nominal, obstacle=raft)
    with jax.enable_x64(double):
        found = simulate(case, nominal, q, np.zeros((round(SECONDS / h), 6, 3), kind), h, v, iterations, fused)
    return _motion(h, found.q[:, 0, 25:], found.q[:, 1, 25:])


def _start(raft: Raft, number: int) -> np.ndarray:
    rest = np.asarray(raft.start().position[0], float)
    quat = np.asarray(exponential(jnp.array([0.0, PITCH * number, 0.0])), float)
    return np.concatenate([rest + np.array([0, 0, HEAVE * (1 - number)]), quat])


def _motion(h: float, heaves: np.ndarray, rocks: np.ndarray) -> Motion:
    raft = rafts()[0]
    rest = float(raft.start().position[0, 2])
    draught = float(raft.half_size[2]) - raft.bank_height - heaves[:, 2]
    return Motion(h * (1 + np.arange(len(heaves))), draught, heaves[:, 2] - rest, 2 * rocks[:, 5])


def by_mujoco(h: float) -> Motion:
    """The same by C MuJoCo, which is told the water's force at every step."""
    found = []
    with jax.enable_x64(True):
        for k, raft in enumerate(rafts()):
            load = jax.jit(lambda q, v, raft=raft: raft.external_wrench(free_body_state(q, v, 1))[0])
            model = _alone(raft, h)
            data = mujoco.MjData(model)
            data.qpos[:] = _start(raft, k)
            kept = []
            for _ in range(round(SECONDS / h)):
                data.xfrc_applied[1] = load(data.qpos, data.qvel)
                mujoco.mj_step(model, data)
                kept.append(data.qpos.copy())
            found.append(np.array(kept))
    return _motion(h, *found)


def by_mjx(h: float, impl: str) -> Motion:
    """The same by MJX, or with `impl="warp"`, on a GPU, by MuJoCo Warp, in single precision."""
    with redirect_stdout(io.StringIO()):  # which it prints as it is imported
        from mujoco import mjx

    found = []
    for k, raft in enumerate(rafts()):
        model = _alone(raft, h)
        data = mujoco.MjData(model)
        data.qpos[:] = _start(raft, k)
        mujoco.mj_forward(model, data)
        there, begun = mjx.put_model(model, impl=impl), mjx.put_data(model, data, impl=impl)

        def ahead(now: Any, _: None, raft: Raft = raft, there: Any = there) -> Any:
            load = raft.external_wrench(free_body_state(now.qpos, now.qvel, 1))[0]
            now = mjx.step(there, now.replace(xfrc_applied=now.xfrc_applied.at[1].set(load)))
            return now, now.qpos

        program = jax.jit(lambda now, ahead=ahead: jax.lax.scan(ahead, now, length=round(SECONDS / h))[1])
        found.append(np.asarray(program(begun), float))
    return _motion(h, *found)


def _alone(raft: Raft, h: float) -> mujoco.MjModel:
    spec = mujoco.MjSpec()
    spec.option.gravity, spec.option.timestep = [0, 0, -GRAVITY], h
    inertia = np.asarray(raft.batched_model_fields()["body_inertia"]["raft"], float)
    body = spec.worldbody.add_body(explicitinertial=True, mass=float(raft.mass), inertia=inertia, ipos=[0, 0, 0])
    body.add_freejoint()
    return spec.compile()

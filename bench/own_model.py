"""An own model's speed beside MuJoCo's own loops: `python bench/own_model.py [ENGINE [WIDTH [SECONDS]]]`.

The quadruped of `sweep init --model` and its trot. `native` beside `mujoco.rollout` of the same model with the very
controls that the policy gave, on as many threads; `mjx` beside steps under `vmap` in a scan, as mjx-testspeed takes
them, with the controls of the keyframe. Both in one run, one after the other several times; the least of each counts,
by the wall and by CPU time, which other programs disturb less.
"""

import os
import sys
import tempfile
import time
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from mujoco.rollout import Rollout

from sweep.cli.main import main as sweep
from sweep.study.config import compose
from sweep.systems.own import Own

REPETITIONS = 5
THREADS = len(os.sched_getaffinity(0))


def least(ways: Mapping[str, Callable[[], Any]]) -> None:
    """One line for each way, the last one being what the others are compared with."""
    found = dict.fromkeys(ways, (np.inf, np.inf))
    for _ in range(REPETITIONS):
        for name, call in ways.items():
            wall, cpu = time.perf_counter(), time.process_time()
            call()
            now = time.perf_counter() - wall, time.process_time() - cpu
            found[name] = min(found[name][0], now[0]), min(found[name][1], now[1])
    base = found[[*ways][-1]]
    for name, (wall, cpu) in found.items():
        print(f"{name}: wall {wall:.3f} s x {wall / base[0]:.2f}, CPU {cpu:.3f} s x {cpu / base[1]:.2f}", flush=True)


def native(own: Own, engine: Any, task: tuple[Any, Any, np.ndarray]) -> None:
    """Beside `mujoco.rollout`, which records the state, and nothing of figures."""
    model, n = own.model, len(task[2])
    ctrl = np.stack([one.joint_target for one in engine.traces(*task, 1)])
    substeps = round(own.about.period / model.opt.timestep)
    ctrl = np.repeat(ctrl, substeps, axis=1)
    data = [mujoco.MjData(model) for _ in range(THREADS)]
    mujoco.mj_resetDataKeyframe(model, data[0], own.keyframe)
    full = mujoco.mjtState.mjSTATE_FULLPHYSICS
    start = np.zeros(mujoco.mj_stateSize(model, full))
    mujoco.mj_getState(model, data[0], start, full)
    with Rollout(nthread=THREADS) as pool:
        least({"native": lambda: engine.run(*task),
               "mujoco.rollout": lambda: pool.rollout(model, data, np.tile(start, (n, 1)), ctrl)})  # fmt: skip


def on_mjx(own: Own, engine: Any, task: tuple[Any, Any, np.ndarray]) -> None:
    """Beside nothing but steps."""
    from mujoco import mjx

    steps, n = round(own.about.duration / own.model.opt.timestep), len(task[2])
    data = mujoco.MjData(own.model)
    mujoco.mj_resetDataKeyframe(own.model, data, own.keyframe)
    model = mjx.put_model(own.model)
    each = jax.tree.map(lambda x: jnp.broadcast_to(x, (n, *x.shape)), mjx.put_data(own.model, data))

    @jax.jit
    @jax.vmap
    def unroll(one: Any) -> Any:
        return jax.lax.scan(lambda d, _: (mjx.step(model, d), None), one, None, length=steps)[0]

    jax.block_until_ready(unroll(each))
    engine.run(*task)  # compiles
    least({"mjx": lambda: engine.run(*task), "mjx.step": lambda: jax.block_until_ready(unroll(each))})


def main(engine: str = "native", width: str = "256", seconds: str = "4") -> None:
    """Two lines."""
    with tempfile.TemporaryDirectory() as folder:
        sweep(["init", "--model", f"{folder}/quad"])
        os.chdir(Path(folder, "quad"))
        exp = compose(["scenario=own", f"engine.name={engine}", f"model.duration={seconds}"])
        own = exp.system
        assert isinstance(own, Own)
        sides, streams = own.sides({}), np.zeros(int(width), np.int64)
        made = own.engine(replace(exp.settings, width=int(width)), *sides, None)
        print(f"{width} rollouts of {seconds} s on {THREADS} cores, {own.device(exp.settings)}")
        {"native": native, "mjx": on_mjx}[engine](own, made, (*sides, streams))


if __name__ == "__main__":
    main(*sys.argv[1:])

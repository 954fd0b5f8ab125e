"""How fast the walking map is simulated: the engine on both dynamics, its bare physics, and C MuJoCo, in one run.

`bare` is the same physics of the same batch without controller and metrics, the drives holding the starting posture.
Compile time is measured apart, with nothing kept from earlier processes.
"""

import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import NamedSharding, PartitionSpec
from jaxtyping import Array

from sweep.dynamics import interface as dynamics
from sweep.dynamics.step import State, rest
from sweep.engines import batching, devices, make, physics, program_cache
from sweep.engines.batch_last import batch_last_vmap
from sweep.engines.closed_loop import start_state
from sweep.engines.settings import EngineSettings
from sweep.metrics.outcome import Thresholds
from sweep.models.case import Case
from sweep.models.drive import position_mode
from sweep.models.legs import JOINT_Q, N_LEGS
from sweep.study.study import assign

MOST_NATIVE = 128  # rollouts for the row of C MuJoCo, the slowest
SECOND = 1.0  # s, simulated by one call of the bare physics


def table(nominal: Case, rollouts: int, width: int, rows: tuple[str, ...]) -> Iterator[dict[str, Any]]:
    """One line for each of `rows`, `nominal` walking; width 0 is the device's best, rollouts 0 one batch of them."""
    for name in rows:
        settings = EngineSettings(
            width=width if name != "native" else 0,
            dynamics="mjx" if name == "mjx" else "auto",
            name="native" if name == "native" else "mjx",
        )
        with program_cache.unused():
            line = _bare(settings, nominal, rollouts) if name == "bare" else _engine(settings, nominal, rollouts)
        yield line


def walk_map(nominal: Case, rollouts: int, width: int) -> list[tuple[Case, Case]]:
    """Worlds and beliefs of batches of `width` over the grid of walk_map, as fine as `rollouts` points need."""
    rows = max(1, round((rollouts * 17 / 33) ** 0.5))
    friction, ratio = np.meshgrid(np.linspace(0.05, 1.2, -(-rollouts // rows)), np.linspace(0.03, 0.2, rows))
    slots = np.minimum(np.arange(-(-rollouts // width) * width), rollouts - 1).reshape(-1, width)
    batches = []
    for batch in slots:
        belief = assign(nominal, "manoeuvre.half_step_ratio", ratio.ravel()[batch])
        world = assign(belief, "contact.friction", friction.ravel()[batch])
        batches.append((world, belief))
    return batches


def _engine(settings: EngineSettings, nominal: Case, rollouts: int) -> dict[str, Any]:
    """Controller, physics and metrics."""
    engine = make(settings, nominal, nominal, Thresholds())
    rollouts = rollouts or engine.width
    if settings.name == "native":
        rollouts = min(rollouts, MOST_NATIVE)
    batches = walk_map(nominal, rollouts, engine.width)
    streams = np.zeros(engine.width, int)

    def simulate(batch: tuple[Case, Case]) -> float:
        return float(np.max(engine.run(*batch, streams)["duration_s"]))

    first = timed(lambda: simulate(batches[0]))
    start = time.perf_counter()
    seconds = sum(simulate(batch) for batch in batches)
    wall = time.perf_counter() - start
    compile_s = first - wall / len(batches)
    return _line(
        settings.name, engine.dynamics, engine.width, rollouts, seconds, wall, compile_s, batching.step_time(settings)
    )


def _bare(settings: EngineSettings, nominal: Case, rollouts: int) -> dict[str, Any]:
    """Its physics steps alone, for the time that the plan takes."""
    devices.configure()
    width = settings.width or devices.default_width()
    rollouts = rollouts or width
    top = dynamics.topology(nominal)
    steps = physics.make(settings, top)
    plan = nominal.manoeuvre.plan(nominal)
    start = start_state(nominal, nominal, plan)
    servo = position_mode(nominal.drive, start.qpos[JOINT_Q].reshape(N_LEGS, 3))
    ticks = round(SECOND / settings.control_period)

    def one(friction: Array, state: State, tick: Array) -> State:
        world = replace(nominal, contact=replace(nominal.contact, friction=friction))
        return steps.advance(world, state, servo, servo, tick)[0]

    mesh = devices.mesh(width)
    tick = batch_last_vmap(one, (-1, -1, None), devices.reuse_from())

    def second(friction: Array, states: Any) -> Any:
        return jax.lax.scan(lambda s, k: (tick(friction, s, k), None), states, jnp.arange(ticks))[0]

    spec = PartitionSpec(devices.BATCH)
    specs = jax.tree.map(lambda x: PartitionSpec(*[None] * jnp.ndim(x), devices.BATCH), rest(top, start.qpos))
    run = jax.jit(jax.shard_map(second, mesh=mesh, in_specs=(spec, specs), out_specs=specs, check_vma=False))
    frictions = [jnp.asarray(world.contact.friction, float) for world, _ in walk_map(nominal, rollouts, width)]
    frictions = [jax.device_put(friction, NamedSharding(mesh, spec)) for friction in frictions]
    fresh = jax.tree.map(lambda x: jnp.broadcast_to(x[..., None], (*x.shape, width)), rest(top, start.qpos))
    # laid out as the results are, or the second call compiles again
    fresh = jax.tree.map(lambda x, s: jax.device_put(x, NamedSharding(mesh, s)), fresh, specs)
    compile_s = timed(lambda: jax.block_until_ready(run(frictions[0], fresh)))
    seconds = int(np.ceil(float(np.sum(plan.duration)) / SECOND))

    def simulate() -> None:
        for friction in frictions:
            states = fresh
            for _ in range(seconds):
                states = run(friction, states)
            jax.block_until_ready(states)

    wall = timed(simulate)
    total = seconds * SECOND * len(frictions)
    return _line("bare", physics.taken(settings), width, rollouts, total, wall, compile_s, settings.time_step)


def timed(work: Callable[[], object]) -> float:
    """Wall time (s)."""
    start = time.perf_counter()
    work()
    return time.perf_counter() - start


def _line(
    name: str, kind: str, width: int, rollouts: int, seconds: float, wall: float, compile_s: float, step: float
) -> dict[str, Any]:
    """One line of the table; `seconds` were simulated by each slot of the batch."""
    device = jax.devices()[0]
    peak = (device.memory_stats() or {}).get("peak_bytes_in_use")
    share = jax.device_count() if name != "native" else 1
    return {
        "engine": name,
        "dynamics": kind,
        "device": f"{share} x {device.device_kind}",
        "width": width,
        "env-steps/s": width * seconds / step / wall,
        "rollouts/s": rollouts / wall,
        "compile s": compile_s if compile_s > 0 else None,  # lost beside a long run whose speed is not even
        "KiB/rollout": peak / (width / share) / 1024 if peak and name != "native" else None,
    }

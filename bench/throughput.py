"""How fast a walking map is simulated: the whole runner's engine, its bare physics, and C MuJoCo, in one run.

    python bench/throughput.py                          # 561 rollouts of walk_map, mjx against both baselines
    python bench/throughput.py --rollouts 8192 --engines mjx bare   # on a GPU

Compile time is measured apart. `bare` is the same physics step of the same batch without controller and metrics,
with the joints held at the starting posture.
"""

import argparse
import time
from collections.abc import Callable
from dataclasses import replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import PartitionSpec
from mujoco import mjx

from sweep.case import Case
from sweep.controllers.manoeuvres.walk import Walk
from sweep.controllers.observation import Noise
from sweep.engines import batching, devices, make
from sweep.engines.pilot import start_state
from sweep.engines.settings import EngineSettings
from sweep.metrics.outcome import Thresholds
from sweep.models import dynamics, step
from sweep.models.contact import Contact
from sweep.models.drive import Drive, position_mode
from sweep.models.execution import Execution
from sweep.models.obstacles.plane import Plane
from sweep.models.robot import Robot

NOMINAL = Case(Robot(), Drive(), Contact(), Plane(), Walk(), Noise(), Execution())


def walk_map(rollouts: int) -> tuple[np.ndarray, np.ndarray]:
    """Friction and step ratio of `rollouts` points on the grid of walk_map, refined as needed."""
    rows = round((rollouts * 17 / 33) ** 0.5)
    friction, ratio = np.meshgrid(np.linspace(0.05, 1.2, -(-rollouts // rows)), np.linspace(0.03, 0.2, rows))
    return friction.ravel()[:rollouts], ratio.ravel()[:rollouts]


def cases(friction: np.ndarray, ratio: np.ndarray) -> tuple[Case, Case]:
    """World and belief of a batch."""
    belief = replace(NOMINAL, manoeuvre=replace(NOMINAL.manoeuvre, half_step_ratio=ratio))
    return replace(belief, contact=replace(belief.contact, friction=friction)), belief


def padded(values: np.ndarray, width: int) -> np.ndarray:
    """`values` in rows of `width`, the last one repeated."""
    count = -(-len(values) // width) * width
    return values[np.minimum(np.arange(count), len(values) - 1)].reshape(-1, width)


def time_engine(name: str, width: int, rollouts: int) -> dict:
    """Compile and run times (s) of an engine over the map, and the seconds that its rollouts lasted."""
    engine = make(EngineSettings(name=name, width=width), NOMINAL, NOMINAL, Thresholds())
    batches = list(zip(*(padded(values, engine.width) for values in walk_map(rollouts)), strict=True))
    streams = np.zeros(engine.width, int)

    def run(batch: tuple) -> float:
        return float(np.max(engine.run(*cases(*batch), streams)["duration_s"]))

    start = time.perf_counter()
    run(batches[0])
    first = time.perf_counter() - start
    start = time.perf_counter()
    simulated = [run(batch) for batch in batches]
    wall = time.perf_counter() - start
    compile_s = first - wall / len(batches)
    return row(name, engine.width, rollouts, simulated, wall, compile_s, batching.step_time(EngineSettings(name=name)))


def time_bare(width: int, rollouts: int, seconds: float) -> dict:
    """The same number of physics steps with nothing around them."""
    settings = EngineSettings(width=width)
    devices.configure()
    width = width or devices.default_width()
    top = dynamics.topology(NOMINAL)
    data = mjx.make_data(top.model)
    plan = NOMINAL.manoeuvre.plan(NOMINAL)
    q = start_state(NOMINAL, NOMINAL, plan).qpos
    joints = q[1 + top.leg]
    limits = batching.execution_limits(NOMINAL, jnp.zeros(()))
    servo = position_mode(NOMINAL.drive, joints)
    steps = round(1.0 / settings.time_step)

    def one(friction: jax.Array, state: step.State) -> step.State:
        world = replace(NOMINAL, contact=replace(NOMINAL.contact, friction=friction))
        return step.step(top, top.model, data, world, limits, state, servo, settings.time_step, settings.iterations)[0]

    mesh = devices.mesh(width)
    split = PartitionSpec(devices.BATCH)

    @partial(jax.jit, donate_argnums=1)
    @partial(jax.shard_map, mesh=mesh, in_specs=split, out_specs=split, check_vma=False)
    def chunk(friction: jax.Array, states: step.State) -> step.State:
        return jax.lax.scan(lambda s, _: (jax.vmap(one)(friction, s), None), states, None, length=steps)[0]

    def fresh() -> step.State:
        states = jax.tree.map(lambda x: jnp.broadcast_to(x, (width, *x.shape)), step.rest(top, q))
        return devices.spread(states, mesh)

    frictions = padded(walk_map(rollouts)[0], width)
    compile_s = timed(lambda: chunk(devices.spread(jnp.asarray(frictions[0], float), mesh), fresh()))
    chunks = round(seconds)

    def run() -> None:
        for friction in frictions:
            states = fresh()
            for _ in range(chunks):
                states = chunk(devices.spread(jnp.asarray(friction, float), mesh), states)
            jax.block_until_ready(states)

    wall = timed(run)
    return row("bare", width, rollouts, [float(chunks)] * len(frictions), wall, compile_s, settings.time_step)


def timed(work: Callable[[], object]) -> float:
    """Wall time of `work` (s), its results ready."""
    start = time.perf_counter()
    jax.block_until_ready(work())
    return time.perf_counter() - start


def row(
    name: str, width: int, rollouts: int, simulated: list[float], wall: float, compile_s: float, step_s: float
) -> dict:
    """One line of the table; a batch lasts as long as its longest rollout."""
    seconds = width * sum(simulated)
    device = jax.devices()[0]
    memory = (device.memory_stats() or {}).get("peak_bytes_in_use", float("nan"))
    return {
        "engine": name, "device": device.device_kind, "devices": 1 if name == "native" else jax.device_count(),
        "width": width, "rollouts": rollouts, "wall_s": wall, "compile_s": compile_s, "rollouts/s": rollouts / wall,
        "simulated s/s": seconds / wall, "env-steps/s": seconds / step_s / wall, "peak MiB": memory / 2**20,
    }  # fmt: skip


def main() -> None:
    """Print the table and the ratios."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rollouts", type=int, default=561)
    parser.add_argument("--width", type=int, default=0, help="rollouts in a batch; 0: the device's default")
    parser.add_argument("--engines", nargs="+", default=["mjx", "bare", "native"])
    args = parser.parse_args()
    rows = {}
    for name in args.engines:
        if name == "bare":
            seconds = (
                rows["mjx"]["simulated s/s"] * rows["mjx"]["wall_s"] / (rows["mjx"]["width"] * batches(rows["mjx"]))
            )
            rows[name] = time_bare(args.width, args.rollouts, seconds)
        else:
            rows[name] = time_engine(name, args.width if name == "mjx" else 0, args.rollouts)
        print("  ".join(f"{key} {value:.4g}" if isinstance(value, float) else f"{key} {value}"
                        for key, value in rows[name].items()), flush=True)  # fmt: skip
    if {"mjx", "bare"} <= rows.keys():
        print(f"time a simulated second, mjx / bare physics: "
              f"{rows['bare']['simulated s/s'] / rows['mjx']['simulated s/s']:.2f}")  # fmt: skip
    if {"mjx", "native"} <= rows.keys():
        print(f"simulated seconds a second, mjx / native: "
              f"{rows['mjx']['simulated s/s'] / rows['native']['simulated s/s']:.2f}")  # fmt: skip


def batches(line: dict) -> int:
    """Batches that a line's rollouts took."""
    return -(-line["rollouts"] // line["width"])


if __name__ == "__main__":
    main()

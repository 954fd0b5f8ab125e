"""What every scenario plans, for what is nominally believed and for draws of robot and obstacle, and how it is tracked.

    python tests/recorded.py NAME ...  # renews the record of scenarios, or of all that have one

Plans are made in double precision, as engines on a CPU make them: what differs by more than rounding is another plan.
Planned forces are left out: they follow from a plan. The tracker is told that all goes as it commands but for errors,
and of forces that no one planned: every way through it counts, not where it leads.
"""

import dataclasses
import re
import sys
import zlib
from functools import partial
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from sweep.config.experiment import compose
from sweep.controllers import tracker
from sweep.controllers.layers import ForceFeedforward
from sweep.controllers.observation import Observation
from sweep.core.errors import InputError
from sweep.fused import eager
from sweep.models.case import Case
from sweep.models.obstacles.surface import free_start_state
from sweep.planning.forces import KNOTS, PlannedForces
from sweep.systems.hexapod import replace_parameter

FOLDER = Path(__file__).parent / "data" / "plans"
TRACKED = FOLDER.parent / "tracked.npz"
GROUPED = re.compile(r"\.curve|\.path|\.layers\[\d+\]")  # fields of these have unique names
RECORDED_NAMES = {".servo": ".own"}  # fields renamed since: their recorded names seed the weights of sums
TICKS = 150  # of a whole plan
ERRORS = 2e-3  # m, rad and their rates, of the measurements that the tracker receives
LOADED = 0.9  # share of ticks in which a foot carries load
DRAWS = 4
SPREAD = {"robot": 0.02, "obstacle": 0.01}  # relative, of sizes and masses


def scenarios() -> list[str]:
    """Return the scenarios that have a record."""
    return sorted(file.stem for file in FOLDER.glob("*.npz"))


def draws(case: Case) -> dict[str, np.ndarray]:
    """Return sizes and masses by path: nominal, then `DRAWS` others; adding a parameter changes no other one."""
    found = {}
    for group, spread in SPREAD.items():
        owner: Any = getattr(case, group)
        for field in dataclasses.fields(owner):
            value = getattr(owner, field.name)
            if field.metadata.get("unit") in ("m", "kg") and value:
                random = np.random.default_rng(zlib.crc32(f"{group}.{field.name}".encode()))
                found[f"{group}.{field.name}"] = value * (1 + spread * random.uniform(-1, 1, DRAWS + 1))
                found[f"{group}.{field.name}"][0] = value
    return found


def record_plan(name: str, count: int = DRAWS) -> dict[str, np.ndarray]:
    """The record of a scenario: its stages, all numbers of the nominal plan, and sums of them by draw and stage.

    The nominal plan is draw 0, followed by `count` others; what belongs to no stage is summed up last. Draws that the
    plan refuses are not a number.
    """
    exp = compose([f"scenario={name}"])
    drawn, sums, record = draws(exp.case), [], {}
    with jax.enable_x64(True):
        for k in range(count + 1):
            case = exp.case
            for path, values in drawn.items():
                case = replace_parameter(case, path, float(values[k]))
            try:
                plan = drop_idle_lifts(eager.evaluate_constant_function(partial(without_forces, case)))
            except InputError:
                sums.append(np.full_like(sums[0], np.nan))
                continue
            numbers = {GROUPED.sub("", jax.tree_util.keystr(path)): np.asarray(value, float)
                       for path, value in jax.tree_util.tree_leaves_with_path(plan)}  # fmt: skip
            sums.append(sum(_by_stage(key, value, len(plan.names)) for key, value in numbers.items()))
            if not record:
                record = {key: value.astype(np.float32) for key, value in numbers.items()}
                record["names"] = np.array(
                    [f"{name}|{onset}" for name, onset in zip(plan.names, plan.onset, strict=True)]
                )
    return {**record, "sums": np.stack(sums)}


def without_forces(case: Case) -> Any:
    """Return the plan of a case before forces are planned."""
    kept, PlannedForces.add_force_feedforward = PlannedForces.add_force_feedforward, lambda self, belief, plan: plan
    try:
        return case.manoeuvre.plan(case)
    finally:
        PlannedForces.add_force_feedforward = kept


def drop_idle_lifts(plan: Any) -> Any:
    """Return the plan with zero lift in stages without a swing, where lift has no effect."""
    idle = ~np.any(plan.swing, axis=1)
    height, plane = plan.curve.height, plan.curve.plane
    curve = plan.curve._replace(height=np.where(idle, 0.0, height), plane=np.where(idle[:, None, None], 0.0, plane))
    return dataclasses.replace(plan, curve=curve)


def _by_stage(key: str, value: np.ndarray, stages: int) -> np.ndarray:
    """Weighted sums of numbers by stage; last of numbers that belong to no stage."""
    staged = value.shape[:1] == (stages,) and "start" not in key
    rows = value.reshape(stages if staged else 1, -1)
    weights = np.random.default_rng(zlib.crc32(key.encode())).uniform(0.5, 1.5, rows.shape[1])
    return np.pad(rows @ weights, (0, 1) if staged else (stages, 0))


def record_tracking(name: str) -> np.ndarray:
    """Return the commands of a scenario tick by tick: the stage, and a weighted sum of all numbers."""
    case = compose([f"scenario={name}"]).case
    random = np.random.default_rng(zlib.crc32(name.encode()))
    with jax.enable_x64(True):
        plan = _with_some_forces(case, without_forces(case), random)
        period = float(np.sum(plan.duration)) / TICKS
        state, free = tracker.init(case, plan), free_start_state(case.obstacle)
        zero, joints = jnp.zeros(3), state.joints
        seen = Observation(*plan.start[1:], zero, zero, joints, *(jnp.zeros_like(joints),) * 2, np.ones(6, bool), free)
        errors = jax.tree.map(lambda x: ERRORS * random.normal(size=(TICKS, *np.shape(x))), seen)
        errors = errors._replace(loaded=random.uniform(size=(TICKS, 6)) < LOADED, load=np.zeros(TICKS))

        def tick(before: Any, error: Observation) -> Any:
            state, (target, joints) = before
            told = seen._replace(position=target.position, quat=target.quat, angles=joints, loaded=0)
            told = jax.tree.map(lambda x, off: x + off, told, error)
            free = told.free._replace(quat=told.free.quat / jnp.linalg.norm(told.free.quat, axis=1, keepdims=True))
            quat = told.quat / jnp.linalg.norm(told.quat)
            told = told._replace(quat=quat, free=free, loaded=error.loaded)
            state, command = tracker.step(case, plan, state, told, period)
            command = command._replace(shortfall=jnp.max(command.shortfall))
            return (state, (command.target, command.joints)), (state.stage, command)

        start = state, jax.tree.map(lambda x: jnp.asarray(x, float), (plan.start, joints))
        stage, commands = jax.jit(lambda start, errors: jax.lax.scan(tick, start, errors))(start, errors)[1]
        numbers = {_recorded_name(path): np.asarray(value, float)
                   for path, value in jax.tree_util.tree_leaves_with_path(commands)}  # fmt: skip
        sums = sum(_by_stage(key, value, TICKS) for key, value in numbers.items())
    return np.stack([stage, sums[:-1]])


def _recorded_name(path: Any) -> str:
    """Key of a leaf, with the field names at the time of recording."""
    key = jax.tree_util.keystr(path)
    return next((old + key.removeprefix(new) for new, old in RECORDED_NAMES.items() if key.startswith(new)), key)


def _with_some_forces(case: Case, plan: Any, random: np.random.Generator) -> Any:
    """Plan with arbitrary forces, if its manoeuvre holds on by planned forces."""
    manoeuvre = case.manoeuvre
    if not isinstance(manoeuvre, PlannedForces) or getattr(manoeuvre, "forces", "planned") != "planned":
        return plan
    stages = len(plan.names)
    offset, inward = ERRORS * random.normal(size=(stages, KNOTS, 6, 3)), random.normal(size=(stages, 6, 3))
    forces = ForceFeedforward(
        offset, np.zeros(stages), inward, np.float64(manoeuvre.creep), np.float64(manoeuvre.anchoring)
    )
    return plan.replace_layer(jax.tree.map(jnp.asarray, forces))


def read_plan(name: str) -> dict[str, np.ndarray]:
    """Return the record of a scenario's plan."""
    with np.load(FOLDER / f"{name}.npz") as file:
        return dict(file)


def read_tracked() -> dict[str, np.ndarray]:
    """Return the records of the tracker, by scenario."""
    with np.load(TRACKED) as file:
        return dict(file)


if __name__ == "__main__":
    ways = read_tracked() if TRACKED.exists() else {}
    for name in sys.argv[1:] or sorted({*scenarios(), *ways}):
        if name in scenarios() or name not in ways:  # most plans without a table are not worth a record
            np.savez_compressed(FOLDER / f"{name}.npz", **record_plan(name))
        ways[name] = record_tracking(name)
        np.savez_compressed(TRACKED, **ways)
        print(name, flush=True)

"""What every scenario plans: for what is nominally believed, and for draws of robot and obstacle.

    python tests/recorded.py NAME ...  # renews the record of scenarios, or of all that have one

Plans are made in double precision, operation by operation: what differs by more than rounding is another plan. Planned
forces are left out: they follow from a plan, and take long.
"""

import dataclasses
import sys
import zlib
from pathlib import Path
from typing import Any

import jax
import numpy as np

from sweep.controllers.forces import PlannedForces
from sweep.core.errors import InputError
from sweep.models.case import Case
from sweep.study.config import compose
from sweep.systems.hexapod import assign

FOLDER = Path(__file__).parent / "data" / "plans"
DRAWS = 4
SPREAD = {"robot": 0.02, "obstacle": 0.01}  # of sizes and masses


def scenarios() -> list[str]:
    """Those that are recorded."""
    return sorted(file.stem for file in FOLDER.glob("*.npz"))


def draws(case: Case) -> dict[str, np.ndarray]:
    """Sizes and masses by path: nominal ones, then `DRAWS` others. A parameter that is added changes no other one."""
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


def planned(name: str, count: int = DRAWS) -> dict[str, np.ndarray]:
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
                case = assign(case, path, float(values[k]))
            try:
                plan = told(without_forces(case))
            except InputError:
                sums.append(np.full_like(sums[0], np.nan))
                continue
            numbers = {jax.tree_util.keystr(path): np.asarray(value, float)
                       for path, value in jax.tree_util.tree_leaves_with_path(plan)}  # fmt: skip
            sums.append(sum(_by_stage(key, value, len(plan.names)) for key, value in numbers.items()))
            if not record:
                record = {key: value.astype(np.float32) for key, value in numbers.items()}
                record["names"] = np.array(
                    [f"{name}|{onset}" for name, onset in zip(plan.names, plan.onset, strict=True)]
                )
    return {**record, "sums": np.stack(sums)}


def without_forces(case: Case) -> Any:
    """The plan for what is believed, before forces are planned for it."""
    kept, PlannedForces.with_feedforward = PlannedForces.with_feedforward, lambda self, belief, plan: plan
    try:
        return case.manoeuvre.plan(case)
    finally:
        PlannedForces.with_feedforward = kept


def told(plan: Any) -> Any:
    """The plan without what says nothing: how swings are lifted where no foot swings."""
    idle = ~np.any(plan.swing, axis=1)
    return dataclasses.replace(plan, height=np.where(idle, 0.0, plan.height),
                               plane=np.where(idle[:, None, None], 0.0, plan.plane))  # fmt: skip


def _by_stage(key: str, value: np.ndarray, stages: int) -> np.ndarray:
    """Sums of numbers by stage, each with a weight of its own; last of what belongs to no stage."""
    staged = value.shape[:1] == (stages,) and "start" not in key
    rows = value.reshape(stages if staged else 1, -1)
    weights = np.random.default_rng(zlib.crc32(key.encode())).uniform(0.5, 1.5, rows.shape[1])
    return np.pad(rows @ weights, (0, 1) if staged else (stages, 0))


def read(name: str) -> dict[str, np.ndarray]:
    """What is recorded of a scenario."""
    with np.load(FOLDER / f"{name}.npz") as file:
        return dict(file)


if __name__ == "__main__":
    for name in sys.argv[1:] or scenarios():
        np.savez_compressed(FOLDER / f"{name}.npz", **planned(name))
        print(name, flush=True)

"""The exported robot compared with the built-in one: `python bench/through_the_door.py NAME N [ENGINE [FOLDER]]`.

N draws from the area of `walk_map`, or of `pole_map` (a model for each of three radii, since exported sizes are no
axes). They are shared among one process for each core, none of which sees a GPU; on a GPU engine, one process runs them
all. The output: equal outcomes, differences of distances, and rows that differ. A FOLDER keeps the rows and the logs:
the same command on as many cores continues, and a larger N contains the draws of a smaller one.
"""

import os
import subprocess
import sys
import tempfile
import time
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from pathlib import Path
from queue import SimpleQueue

import numpy as np
import pandas as pd

from sweep.analysis.intervals import wilson
from sweep.config.experiment import compose
from sweep.runs import store
from sweep.runs.runner import select_points_to_simulate

GEOMS = {"walk_map": ["ground"], "pole_map": ["floor", "pole", "ledge"]}
RADII = (0.35, 0.42, 0.49)  # m
FRICTION, STEP, RADIUS = "world.contact.friction", "manoeuvre.half_step_ratio", "obstacle.radius"
SHOWN = ["outcome", "cause", "slip_max_m", "end_drift_m", "progress", "feet_on_target", "distance_m", "tilt_max_deg"]


def sweep(args: list[str], folder: Path, log: Path, cores: list[int], engine: str = "native") -> None:
    """Run a command in `folder` in a process of its own, since each model brings a controller of the same name."""
    on = "taskset", "-c", ",".join(map(str, cores))
    env = os.environ | {"NPROC": str(len(cores))}  # else XLA has a thread for each core of the machine
    if engine == "native":
        env["JAX_PLATFORMS"] = "cpu"
    with log.open("a") as out:
        command = [*on, sys.executable, "-m", "sweep.cli", *args]
        subprocess.run(command, cwd=folder, stdout=out, stderr=out, env=env, check=False)


def points(name: str, number: int) -> pd.DataFrame:
    """Return points drawn evenly from the area of a study's map; larger sets start with smaller ones."""
    grid = select_points_to_simulate(compose([f"study={name}"]))
    drawn = np.random.default_rng(0).random((number, 2))
    low, high = grid[FRICTION].min(), grid[FRICTION].max()
    table = pd.DataFrame({FRICTION: low + (high - low) * drawn[:, 0]})
    if name == "walk_map":
        low, high = grid[STEP].min(), grid[STEP].max()
        return table.assign(**{STEP: low + (high - low) * drawn[:, 1]})
    return table.assign(**{RADIUS: np.resize(RADII, number)})


def run(name: str, engine: str, overrides: list[str], folder: Path, table: pd.DataFrame, cores: list[int]) -> None:
    """Simulate points with both models in `folder`."""
    folder.mkdir(exist_ok=True)
    table.to_csv(folder / "own.csv", index=False)
    same = ["study.invalid_max=1", "study.expect=[]"]
    sweep(["run", f"study={name}", *overrides, "engine=native", f"study.points={folder}/own.csv", "study.axes={}",
           f"out={folder}/own", *same], folder, folder / "said.txt", cores)  # fmt: skip
    door = pd.DataFrame({f"model.geom.{geom}_contact.friction.slide": table[FRICTION] for geom in GEOMS[name]})
    if STEP in table:
        door[f"controller.{STEP}"] = table[STEP]
    door.to_csv(folder / "door.csv", index=False)
    sweep(["run", "study=study.yaml", "scenario=own", f"engine.name={engine}", "--points", f"{folder}/door.csv",
           f"out={folder}/door", *same], folder.parent / "model", folder / "said.txt", cores, engine)  # fmt: skip


def joined_rows(name: str, folder: Path) -> pd.DataFrame:
    """Return the rows of both models in a folder, joined by friction, and by step length if it varies."""
    rows = store.read_rows(folder / "door").rename(
        columns={f"model.geom.{GEOMS[name][0]}_contact.friction.slide": FRICTION, f"controller.{STEP}": STEP}
    )
    own = store.read_rows(folder / "own")
    return own.merge(rows, on=[key for key in (FRICTION, STEP) if key in rows], suffixes=("", "_door"))


def export(name: str, overrides: list[str], place: Path, cores: list[int]) -> None:
    """Export the robot's model and controller for `run`."""
    place.mkdir(parents=True, exist_ok=True)
    if not (place / "model/study.yaml").exists():
        scenario = compose([f"study={name}"]).scenario
        asked = ["export-model", f"scenario={scenario}", *overrides, f"out={place}/model"]
        sweep(asked, place, place / "said.txt", cores)
        (place / "model/study.yaml").write_text("scenario: own\nstudy: {name: door}\n")


def main(name: str, number: str, engine: str = "native", kept: str = "") -> None:
    """Compare both models."""
    table, begun = points(name, int(number)), time.perf_counter()
    cores = sorted(os.sched_getaffinity(0))
    groups = [*table.groupby(RADIUS)] if RADIUS in table else [("", table)]
    at_once = [[core] for core in cores] if engine == "native" else [cores]
    parts = max(len(at_once) // len(groups), 1)  # of each group
    free: SimpleQueue[list[int]] = SimpleQueue()
    for one in at_once:
        free.put(one)

    def share(overrides: list[str], folder: Path, rows: pd.DataFrame) -> pd.DataFrame:
        mine = free.get()
        run(name, engine, overrides, folder, rows, mine)
        free.put(mine)
        return joined_rows(name, folder)

    with ExitStack() as stack:
        root = Path(kept).absolute() if kept else Path(stack.enter_context(tempfile.TemporaryDirectory()))
        pool = stack.enter_context(ThreadPoolExecutor(len(at_once)))
        asked = []
        for radius, rows in groups:
            place, overrides = root / f"{name}{radius}", [f"{RADIUS}={radius}"] if radius else []
            export(name, overrides, place, cores)
            rows = rows.drop(columns=RADIUS, errors="ignore")
            asked += [(overrides, place / f"part{k}", rows[k::parts]) for k in range(min(parts, len(rows)))]
        found = pd.concat(pool.map(lambda one: share(*one), asked), ignore_index=True)
    print(f"{time.perf_counter() - begun:.0f} s on {len(cores)} cores")
    print_agreement(f"{name} on {engine}", found)


def print_agreement(label: str, rows: pd.DataFrame) -> None:
    """Print how far joined rows agree, and which do not."""
    far, same = (rows["distance_m"] - rows["distance_m_door"]).abs(), rows["outcome"] == rows["outcome_door"]
    low, high = wilson(int(same.sum()), len(rows))
    cause = rows["cause"] == rows["cause_door"]
    print(f"{label}: {same.sum()} of {len(rows)} outcomes are equal ({100 * same.mean():.2f} %; {100 * low:.2f} to "
          f"{100 * high:.2f}), {cause.sum()} causes")  # fmt: skip
    print(f"distance: median {far.median():.1e} m, 90 % within {far.quantile(0.9):.1e} m, largest {far.max():.1e} m")
    print(rows.loc[~same, [FRICTION, *[n for s in SHOWN for n in (s, f"{s}_door") if n in rows]]].T.to_string())


if __name__ == "__main__":
    main(*sys.argv[1:])

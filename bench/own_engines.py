"""Engines for users' MuJoCo models compared: `python bench/own_engines.py FOLDER [LOOPS]`, with the extra `warp`.

The study of `sweep init --model`, 16 loads by 16 frictions, on `native`, `mjx`, `warp`, and on `warp` again, each in a
folder of FOLDER; existing folders are only read. Results that research/own_models.md cites are written to
research/data/own_engines.json: equal outcomes, differences of metrics, and the times in LOOPS, which is the output of
bench/own_model.py.
"""

import contextlib
import json
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pandas as pd

from sweep.analysis.intervals import wilson
from sweep.cli.main import main as sweep
from sweep.core.files import write_atomically
from sweep.runs import store
from sweep.study.columns import metric_columns

DATA = Path(__file__).parents[1] / "research/data/own_engines.json"
RUNS = {"native": "native", "mjx": "mjx", "warp": "warp", "warp_again": "warp"}  # engine by folder
PAIRS = ("native", "mjx"), ("native", "warp"), ("mjx", "warp"), ("warp", "warp_again")
FIGURES = {"travelled_m": ("way, mm", 1e3), "tilt_max_deg": ("tilt, °", 1), "energy_j": ("energy, J", 1)}
ASKED = ["study=grip", "study.axes.load.num=16", "study.axes.grip.num=16", "study.invalid_max=1"]


def run(folder: Path) -> None:
    """Simulate the study on the engine of a folder."""
    with tempfile.TemporaryDirectory() as place:
        sweep(["init", "--model", f"{place}/quad"])
        with contextlib.chdir(f"{place}/quad"):
            sweep(["run", *ASKED, f"engine={RUNS[folder.name]}", f"out={folder}"])


def compare_engines(rows: dict[str, pd.DataFrame]) -> Iterator[list[str]]:
    """Yield a table line for each pair of runs."""
    apart = (f"{words}: median, 90 % within" for words, _ in FIGURES.values())
    yield ["run", "beside", "outcomes equal", "invalid", *apart, "rows with the same bits"]
    for a, b in PAIRS:
        one, other = rows[a], rows[b].loc[rows[a].index]
        same = int((one["outcome"] == other["outcome"]).sum())
        low, high = wilson(same, len(one))
        far = (scale * (one[name] - other[name]).abs() for name, (_, scale) in FIGURES.items())
        figures = metric_columns(one)
        bits = (one[figures].to_numpy(float) == other[figures].to_numpy(float)).all(axis=1).sum()
        yield [
            f"`{a}`",
            f"`{b}`".replace("warp_again`", "warp` again"),
            f"{same} of {len(one)} ({100 * low:.1f} to {100 * high:.1f} %)",
            ", ".join(str((run["outcome"] == "invalid").sum()) for run in (one, other)),
            *(f"{one.median():.2g}, {one.quantile(0.9):.2g}" for one in far),
            str(bits),
        ]


def loops(measured: dict[str, Any]) -> Iterator[list[str]]:
    """Yield a table line for each loop that bench/own_model.py measured."""
    yield ["loop", "wall, s", "M steps/s", "engine over it"]
    for one in (loop for loop in measured["loops"] if not loop["loop"].endswith("its start")):
        beside = "" if one["loop"] == one["engine"] else f"{one['engine_by_wall']:.2f}"
        yield [f"`{one['loop']}`", f"{one['wall_s']:.3f}", f"{one['steps_per_s'] / 1e6:.2f}", beside]


def main(kept: str, printed: str = "") -> None:
    """Run missing studies, and write all results."""
    folder = Path(kept).absolute()
    for name in RUNS:
        if not (folder / name).exists():
            run(folder / name)
    made = store.read_study(folder / "warp")
    rows = {name: store.read_rows(folder / name).set_index("point_id") for name in RUNS}
    tables = {"beside": [*compare_engines(rows)]}
    if printed:
        tables["loops"] = [*loops(json.loads(Path(printed).read_text(encoding="utf-8").splitlines()[-1]))]
    about = {"command": "python bench/own_engines.py FOLDER LOOPS", "engine": "native, mjx, warp"}
    about |= {key: made[key] for key in ("devices", "code", "commit", "versions")}
    about |= {"seconds": "", "tables": tables}
    write_atomically(DATA, (json.dumps(about, indent=1, ensure_ascii=False) + "\n").encode())


if __name__ == "__main__":
    main(*sys.argv[1:])

"""Certify regions and find causes of failure for research/certainty.md: `python bench/certainty.py [1e-5]`.

For 1 % failures, or for one in a hundred thousand, which takes a GPU minutes. Results are written to
research/data/certified.json, or research/data/certified_1e_5.json. Studies start with an empty program cache.
"""

import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

from sweep.analysis import failing
from sweep.analysis.certify import certify_largest_region as tested
from sweep.analysis.certify import learn_region_score, required_failure_free_rows
from sweep.analysis.intervals import CONFIDENCE_LEVEL
from sweep.cli import certification
from sweep.config.experiment import build_experiment
from sweep.core.files import write_atomically
from sweep.core.provenance import version_record
from sweep.report.labels import axis_words
from sweep.runs import store

DATA = Path(__file__).parents[1] / "research" / "data"
LENGTHS = ("body_length", "body_width", "thigh", "shin")


class RegionStudy(NamedTuple):
    """A study, and the regions to certify in it."""

    name: str
    overrides: list[str]
    shapes: tuple[str, ...]


def climb(off: float) -> list[str]:
    """Return the overrides of the pole climb with lengths off by a share."""
    return ["scenario=pole_climb", *(f"study.axes.{name}.relative={off:g}" for name in LENGTHS)]


WALK = RegionStudy("`walk_tripod`", ["scenario=walk_tripod"], ("box",))
CLIMB = RegionStudy("`pole_climb`, lengths off by up to 0.5 %", climb(0.005), ("ellipsoid", "score"))
RARE = RegionStudy("`pole_climb`, lengths off by up to 0.2 %", climb(0.002), ("ellipsoid",))
WIDTH = 21120  # rollouts of a batch: four for each slot of the 132 multiprocessors of an H100
ASKED = {  # by failures at most: rows to learn from, fresh ones, and studies; batches of one width are of one program
    "1e-2": (1024, 1024, [], (WALK, CLIMB)),
    "1e-5": (WIDTH, 330_000, [f"engine.width={WIDTH}"], (WALK, RARE)),
}


def regions(failures: str, root: Path) -> Iterator[list[str]]:
    """Yield a table line for each region; rows are stored in one folder of `root` for each study."""
    learn, fresh, width, promises = ASKED[failures]
    for k, promise in enumerate(promises):
        folder, told = root / f"{k}", root / "region.json"
        about = ["study=any_errors", *promise.overrides, f"study.design.num={learn}", *width]
        seconds = run_sweep(root, "run", *about, f"out={folder}")
        for shape in promise.shapes:
            asked = f"--failures {failures} --shape {shape} --rollouts {fresh} -o {told}"
            seconds += run_sweep(root, "certify", str(folder), *asked.split())
            found = json.loads(told.read_text(encoding="utf-8"))
            checks = [f"{one['fail']} of {one['rollouts']}" for one in found["checked"]] or ["", ""]
            larger = f"{found['next_failed']} of {found['next_rows']:,}" if found["next_rows"] else "it is the largest"
            share = f"{100 * found['share_of_draws']:.1f} %" if found["certified"] else "none"
            yield [promise.name, failures, shape, share, f"{found['failed']} of {found['rows']:,}", larger, *checks,
                   f"{seconds:.0f}"]  # fmt: skip
            seconds = 0.0


def phases(failures: str, root: Path) -> Iterator[list[str]]:
    """Yield how the time of each study's regions splits into rollouts and the rest, which is run once more."""
    for k, promise in enumerate(ASKED[failures][-1]):
        folder = root / f"{k}"
        parts = [folder, folder / certification.FRESH_DRAWS_STUDY, folder / certification.CHECK_STUDY]
        rows = [store.read_rows(part) for part in parts if part.exists()]  # nothing is checked where nothing is found
        learning, fresh = rows[:2]
        names = certification.drawn_parameter_columns(build_experiment(store.read_study(folder)["config"]), learning)
        known, new = (
            certification.parameter_matrix_and_failures(learning, names),
            certification.parameter_matrix_and_failures(fresh, names),
        )
        most, least = float(failures), required_failure_free_rows(float(failures), CONFIDENCE_LEVEL) / len(fresh)
        times = [time.perf_counter()]
        score = learn_region_score(promise.shapes[0], *known, least)
        times.append(time.perf_counter())
        tested(score, known, new, most, CONFIDENCE_LEVEL)
        times.append(time.perf_counter())
        spent = [*(some["wall_s"].sum() for some in rows), 0.0][:3]
        yield [promise.name, *(f"{s:.1f}" for s in (*spent, *(b - a for a, b in pairwise(times))))]


def run_sweep(root: Path, *words: str) -> float:
    """Return the duration of a command (s), with the program cache in `root`; exit if it fails."""
    (kept := root / "programs").mkdir(mode=0o700, exist_ok=True)
    there = {**os.environ, "XDG_CACHE_HOME": str(root), "JAX_COMPILATION_CACHE_DIR": str(kept)}
    start = time.perf_counter()
    done = subprocess.run([sys.executable, "-m", "sweep.cli", *words], env=there, capture_output=True, text=True)
    if done.returncode not in (0, 4):  # nothing is certified
        raise SystemExit(f"sweep {' '.join(words)}: {done.stderr.strip()}")
    print(f"sweep {' '.join(words)}: {done.stdout.strip()}", flush=True)
    return time.perf_counter() - start


def shares(folder: Path) -> list[list[Any]]:
    """Return the causes of failure with their shares, the largest first."""
    found = failing.shapley_failure_shares(
        store.read_rows(folder), build_experiment(store.read_study(folder)["config"])
    )
    columns = found[["axis", "share", "error", "alone"]].to_numpy().tolist()
    return [[axis_words(axis), f"{100 * share:.1f} %", f"{100 * error:.1f}", f"{alone:.2f}"]
            for axis, share, error, alone in columns]  # fmt: skip


def main(failures: str = "1e-2") -> None:
    """Run all measurements and write the results."""
    if failures not in ASKED:
        raise SystemExit(f"{failures} is not allowed: {' or '.join(ASKED)}")
    start, titles = time.perf_counter(), ["study=any_errors", "at most fail", "shape", "share of the draws",
        "fresh rows that fail", "in the next larger region", "where it looks worst fail", "outside", "s"]  # fmt: skip
    with tempfile.TemporaryDirectory() as root:
        tables = {"regions": [titles, *regions(failures, Path(root))]}
        titles = ["study=any_errors", "rows to learn from, with all that is compiled: s", "fresh draws", "checks",
                  "learning, beside them", "tests"]  # fmt: skip
        tables["phases"] = [titles, *phases(failures, Path(root))]
        folder = Path(root, "1")
        tables["shares"] = [["", "share in failing", "error", "alone"], *shares(folder)]
        rows, stored = store.read_rows(folder), store.read_study(folder)
        failed = int((rows["outcome"] != "success").sum())
    usual = failures == next(iter(ASKED))
    command = "python bench/certainty.py" + ("" if usual else f" {failures}")
    about = {"command": command, "engine": "`mjx`", "devices": stored["devices"], **version_record(),
             "seconds": round(time.perf_counter() - start), "rows": len(rows), "failed": failed}  # fmt: skip
    path = DATA / ("certified.json" if usual else f"certified_{failures.replace('-', '_')}.json")
    write_atomically(path, (json.dumps(about | {"tables": tables}, indent=1, ensure_ascii=False) + "\n").encode())


if __name__ == "__main__":
    main(*sys.argv[1:])

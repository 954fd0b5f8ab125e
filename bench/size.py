"""Time and peak memory of commands on a folder of a million rows.

    python bench/size.py FOLDER                       # makes FOLDER where it is missing, a minute, then measures
    python bench/size.py FOLDER --sweep OTHER/python  # measures the package that another interpreter has

It prints a table as Markdown; research/reliability.md has the results. Imports are compiled beforehand, as pip does.
Times hold for a machine that does nothing else. The folder is not simulated: its plan is drawn, its metrics are those
of the rows in `tests/data/ci_smoke`, repeated with noise so that they compress as badly as real ones,
and the thresholds judge them.
"""

import argparse
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
import pandas as pd

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
import fake_engine  # pyright: ignore

from sweep.config.experiment import compose
from sweep.runs import manifest, runner, store
from sweep.runs.manifest import POINTS_FILE
from sweep.study.columns import metric_columns

ROWS, PLANNED = 1_000_000, 10_000_000  # rollouts of the folder, and of the dry run
WIDTH, PART = 4096, 8  # rollouts of a batch, batches of a part
DONOR = Path(__file__).parents[1] / "tests" / "data" / "ci_smoke"
AXES = {
    "friction": "{path: contact.friction, side: world, distribution: {kind: uniform, from: 0.05, to: 1.2}}",
    "step": "{path: manoeuvre.half_step_ratio, distribution: {kind: uniform, from: 0.03, to: 0.19}}",
    "body_mass": "{path: robot.body_mass, side: world, relative: 0.1}",
    "position_bias": "{path: noise.position_bias, distribution: {kind: uniform, from: 0.0, to: 0.02}}",
}


def study_overrides(number: int) -> list[str]:
    """Return the command line of a study with `number` draws."""
    axes = [f"+study.axes.{name}={how}" for name, how in AXES.items()]
    return ["scenario=walk_tripod", "study.name=size", "study.design.kind=monte_carlo", f"study.design.num={number}",
            f"engine.width={WIDTH}", *axes]  # fmt: skip


def make_folder(folder: Path, number: int) -> None:
    """Write a finished study of `number` rows."""
    fake_engine.install()
    exp = compose([*study_overrides(number), f"out={folder}"])
    job = runner.prepare_job(exp, folder, runner.select_points_to_simulate(exp))
    donor, stages = store.read_rows(DONOR), store.read_study(DONOR)["stages"][0]
    figures, chance = donor[metric_columns(donor)].astype(float), np.random.default_rng(0)
    tally = runner.RunRecord({0: stages}, ["none: made by bench/size.py"])
    with store.lock_folder(folder):
        runner.write_study_file(job, tally)
        store.write_points(folder, job.table)
        batches = job.missing_batches()
        for first in range(0, len(batches), PART):
            rows = job.points_of_batches(batches[first : first + PART]).reset_index(drop=True).assign(run_id="0" * 16)
            # most rows from those that succeed, as in studies of robustness
            share = np.where(donor["outcome"] == "success", 5.0, 1.0)
            table = figures.iloc[chance.choice(len(figures), len(rows), p=share / share.sum())].reset_index(drop=True)
            noisy = [c for c in metric_columns(table) if c != "end_stage" and (table[c] % 1 != 0).any()]
            table[noisy] *= chance.normal(1.0, 0.02, (len(rows), len(noisy)))
            measured = {c: table[c].to_numpy() for c in metric_columns(table)}
            labels = exp.system.judge(measured, exp.thresholds, tuple(stages))
            done = pd.concat([rows, table, pd.DataFrame(labels)], axis=1).assign(wall_s=1e-4)
            manifest.append_entries(folder, store.write_part(folder, done, job.study_digest, job.labels_digest))


def measure(command: list[str], place: Path) -> list[str]:
    """Run a command in a folder; return wall time (s), processor time (s) and peak memory (GB), or that it failed."""
    start = time.perf_counter()
    environment = {key: value for key, value in os.environ.items() if key != "PYTHONDONTWRITEBYTECODE"}
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, cwd=place, env=environment)
    _, status, used = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode:
        return ["failed", "", ""]
    wall, processor = time.perf_counter() - start, used.ru_utime + used.ru_stime
    return [f"{wall:.1f}", f"{processor:.1f}", f"{used.ru_maxrss * 1024 / 1e9:.2f}"]


def commands(python: str, folder: Path, out: Path, planned: int) -> dict[str, list[str]]:
    """Return what is measured, by its name in the table."""
    code, sweep, one = [python, "-P", "-c"], [python, "-P", "-m", "sweep.cli"], str(folder)
    load = "import sys, sweep; sweep.load(sys.argv[1], {})"
    plan = "import sys, pathlib; from sweep.runs import store; store.read_points(pathlib.Path(sys.argv[1]))"
    few = "columns=['outcome', 'slip_max_m']"
    return {
        "`sweep status` of the 36 rows": [*sweep, "status", str(DONOR)],
        "`sweep status`": [*sweep, "status", one],
        "`sweep verify`": [*sweep, "verify", one],
        "`sweep stats`": [*sweep, "stats", one],
        "`sweep report`": [*sweep, "report", one, "-o", str(out)],
        "`sweep table --format csv`": [*sweep, "table", one, "--format", "csv", "-o", str(out / "rows.csv")],
        "`sweep table --format parquet`": [
            *sweep,
            "table",
            one,
            "--format",
            "parquet",
            "-o",
            str(out / "rows.parquet"),
        ],
        "`load(columns=[2 names])`": [*code, load.format(few), one],
        "`load()`": [*code, load.format(""), one],
        f"the plan, `{POINTS_FILE}`, alone": [*code, plan, one],
        f"a dry run of {planned:,} points": [*sweep, "run", *study_overrides(planned), f"out={out}/plan", "--dry-run"],
    }


def main() -> None:
    """Make the folder, measure, print and store the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--rows", type=int, default=ROWS)
    parser.add_argument("--planned", type=int, default=PLANNED)
    parser.add_argument("--sweep", default=sys.executable, metavar="PYTHON", help="interpreter of the package")
    parser.add_argument("--only", default="", help="only commands whose name has this in it")
    args = parser.parse_args()
    if not (args.folder / store.STUDY_FILE).exists():
        make_folder(args.folder, args.rows)
    print("| command | wall, s | processor, s | peak memory, GB |\n|:--|--:|--:|--:|")
    with tempfile.TemporaryDirectory() as out:
        for name, command in commands(args.sweep, args.folder.resolve(), Path(out), args.planned).items():
            if args.only in name:
                small = [DONOR if word == str(args.folder.resolve()) else word for word in command]
                few = [word.replace(f"num={args.planned}", "num=100") for word in map(str, small)]
                measure(few, Path(out))  # so that what it imports is compiled
                print(f"| {' | '.join([name, *measure(command, Path(out))])} |", flush=True)


if __name__ == "__main__":
    main()

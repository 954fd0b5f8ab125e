"""Simulates 20 rollouts of one of the shipped examples again and compares their outcomes: a minute on two cores.

    python jobs/check_points.py [COMMIT]

Which example, and which of its rollouts, follows from the commit's hash, so that in time all of them are. Exit code 4
says that more end otherwise than one, which rounding alone may tip over at a boundary.
"""

import hashlib
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
import pandas as pd

from sweep.config.experiment import build_experiment, compose
from sweep.runs import runner, store
from sweep.study.study import parameter_columns

ROOT = Path(__file__).parents[1]
EXAMPLES = ROOT / "research" / "examples"
STUDIES = ("walk_map", "robustness_walk", "robustness_pole")
NUMBER, TOLERATED, UNEXPECTED = 20, 1, 4


def rows_of(study: str) -> pd.DataFrame:
    """Return all rows of a shipped example."""
    data = EXAMPLES / study / "paper" / "data"
    if (data / "rows.parquet").exists():
        return pd.read_parquet(data / "rows.parquet")
    return pd.read_csv(data / "rows.csv", dtype={"point_id": str}).fillna({"cause": ""})


def choose_rows(commit: str) -> tuple[str, pd.DataFrame]:
    """Return the example and the rows to simulate again for a commit."""
    number = int.from_bytes(hashlib.sha256(commit.encode()).digest()[:8])
    study = STUDIES[number % len(STUDIES)]
    rows = rows_of(study)
    places = np.random.default_rng(number).choice(len(rows), NUMBER, replace=False)
    return study, rows.iloc[np.sort(places)].reset_index(drop=True)


def simulate_again(study: str, rows: pd.DataFrame, folder: Path) -> pd.DataFrame:
    """Return the rows as simulated here, in their order."""
    composed = compose([f"study={study}"])
    exp = build_experiment({**composed.values, "out": str(folder)})
    points = rows[[*parameter_columns(rows), "replicate", "stream", "point_id"]]
    with store.lock_folder(folder):
        runner.repair_folder(exp, folder)
        runner.run_job(runner.prepare_job(exp, folder, points), lambda *_: None)
    found = store.read_rows(folder).set_index("point_id")
    return found.loc[rows["point_id"]].reset_index()


def main(argv: list[str]) -> int:
    """Compare the rows and print differences."""
    asked = ["git", "rev-parse", "HEAD"]
    commit = argv[0] if argv else subprocess.run(asked, cwd=ROOT, capture_output=True, text=True).stdout.strip()
    study, before = choose_rows(commit)
    with tempfile.TemporaryDirectory() as folder:
        now = simulate_again(study, before, Path(folder) / study)
    differ = before["outcome"].to_numpy() != now["outcome"].to_numpy()
    print(f"{study}, by commit {commit[:12]}: {differ.sum()} of {len(before)} rollouts end otherwise")
    for place in np.flatnonzero(differ):
        one, other = before.iloc[place], now.iloc[place]
        print(f"  {one['point_id']}: {one['outcome']} {one['cause']} before, {other['outcome']} {other['cause']} now")
    return UNEXPECTED if differ.sum() > TOLERATED else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))

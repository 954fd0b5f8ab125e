"""The first hour of a new user, on the real engine: from a wheel in a fresh environment to a figure and a notebook."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
STUDY = """# Does walking bear what the planner is not told of the ground?
scenario: walk_tripod
robot: tall
outcome: {slip_max_m: 0.02}
study:
  design: {kind: latin_hypercube, num: 32}
  axes:
    friction: {path: contact.friction, side: world, distribution: {kind: uniform, from: 0.01, to: 0.2}}
    step: {path: manoeuvre.half_step_ratio, distribution: {kind: uniform, from: 0.03, to: 0.2}}
  invalid_max: 0.1
"""


@pytest.mark.slow
def test_from_a_wheel_to_an_own_study_its_figure_and_a_notebook(tmp_path):
    bin_, lab = tmp_path / "venv" / "bin", tmp_path / "lab"
    clean = {key: value for key, value in os.environ.items() if key not in ("PYTHONPATH", "VIRTUAL_ENV")}
    clean |= {"XDG_CACHE_HOME": str(tmp_path / "cache"), "MPLBACKEND": "agg"}  # nothing is compiled yet

    def do(*command: str | Path, here: Path = lab) -> str:
        done = subprocess.run([str(c) for c in command], cwd=here, env=clean, capture_output=True, text=True)
        assert done.returncode == 0, (command, done.stdout, done.stderr)
        return done.stdout

    do(sys.executable, "-m", "venv", tmp_path / "venv", here=tmp_path)
    wheels, pinned = tmp_path / "wheels", ROOT / "constraints.txt"
    do(bin_ / "pip", "wheel", "-q", "--no-deps", "-w", wheels, ROOT, here=tmp_path)
    do(bin_ / "pip", "install", "-q", "-c", pinned, next(wheels.glob("*.whl")), here=tmp_path)
    do(bin_ / "sweep", "init", lab, here=tmp_path)
    (lab / "robots" / "tall.yaml").write_text("# Long legs\nextends: base\nshin: 0.38\nthigh: 0.56\n")
    (lab / "studies" / "ground.yaml").write_text(STUDY)
    assert "tall                 Long legs" in do(bin_ / "sweep", "list")
    assert "32 of 32 rollouts to run" in do(bin_ / "sweep", "run", "study=ground", "--dry-run")
    assert "32 of 32 planned rollouts are in results/ground" in do(bin_ / "sweep", "run", "study=ground")
    assert "draws.png" in do(bin_ / "sweep", "report", "results/ground")
    assert do(bin_ / "sweep", "table", "results/ground", "--format", "csv").count("\n") == 33
    assert "| 32 of 32 " in do(bin_ / "sweep", "list", "results")
    cells = json.loads((lab / "first.ipynb").read_text())["cells"]
    code = "\n".join("".join(cell["source"]) for cell in cells if cell["cell_type"] == "code")
    shown = do(bin_ / "python", "-c", code.replace("study=first", "study=ground") + "\nprint(again.again['outcome'])")
    assert shown.split()[-1] in ("success", "failure", "invalid")
    assert "commit: ''" not in (lab / "results/ground/study.yaml").read_text()

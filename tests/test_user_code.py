"""Controllers of users that fail, hang, print, change the working folder or read files of their own."""

import os
from pathlib import Path

import numpy as np
import pytest
from small_study import one_line

from sweep.cli.main import main
from sweep.core import user_code

MODEL = """<mujoco><option timestep="0.005"/><worldbody><body name="ball" pos="0 0 0.3">
<joint name="z" type="slide" axis="0 0 1"/><geom size="0.1"/></body></worldbody><actuator><motor joint="z"/></actuator>
</mujoco>"""
STUDY = """system: mujoco
model: {mjcf: model.xml, controller: "NAME:policy", observe: [qpos], duration: 0.5}
outcome: {goal: duration_s > 0}
study:
  axes:
    load: {path: model.body.ball.mass, side: world, values: [1, 2]}
"""
LATE = """import numpy as np
def deep(seen):
    raise ValueError("no way\\nat all")
def policy(seen):
    print("called")
    return np.zeros((64, 1)) if seen[0, 0] > -0.05 else deep(seen)
"""
CALLBACK = """import jax
import numpy as np
def host(seen):
    if seen[0] < -0.05:
        raise ValueError("no way")
    return np.zeros(1, np.float32)
def policy(belief, seen, state, key):
    return jax.pure_callback(host, jax.ShapeDtypeStruct((1,), np.float32), seen), state
"""


@pytest.fixture
def project(tmp_path, monkeypatch):
    """Writes a project with one controller, and enters it; the words that run its study."""
    monkeypatch.chdir(tmp_path)

    def write(name: str, controller: str) -> list[str]:
        Path("sweep.yaml").touch()
        Path("model.xml").write_text(MODEL)
        Path(f"{name}.py").write_text(controller)
        Path("study.yaml").write_text(STUDY.replace("NAME", name))
        return ["run", "study=study.yaml"]

    return write


@pytest.mark.parametrize(("name", "controller", "line"), [("late", LATE, 3), ("called_back", CALLBACK, 5)])
def test_an_error_in_a_later_tick_names_controller_tick_file_and_line(project, capfd, name, controller, line):
    assert main(project(name, controller)) == 2
    told = f"model.controller = {name}:policy fails in tick 6 (0.1 s): ValueError: no way ({name}.py, line {line})"
    one_line(capfd.readouterr().err, told)
    log = Path("results/study/log.txt").read_text()
    assert f"{name}.py, line {line}\n" in log


def test_prints_of_a_policy_go_to_the_log_once(project, capfd):
    assert main(project("says", LATE.replace("> -0.05", "> -99"))) == 0
    assert "called" not in "".join(capfd.readouterr())
    assert Path("results/study/log.txt").read_text().count("says:policy prints: called") == 1


def test_a_policy_that_does_not_return_is_reported(project, monkeypatch, capfd):
    monkeypatch.setattr(user_code, "FIRST_REPORT_AFTER_S", 0.5)
    slow = LATE.replace("else deep(seen)", "else wait(seen)").replace("def deep", "def wait")
    slow = slow.replace('raise ValueError("no way\\nat all")', "import time; time.sleep(0.1); return np.zeros((64, 1))")
    assert main(project("slow", slow.replace("0.1)", "1.5 * (seen[0, 0] > -0.1))"))) == 0
    assert "sweep: slow:policy in tick 6 (0.1 s) has not returned for " in capfd.readouterr().err


def test_a_controller_that_changes_the_folder_breaks_no_path(project, tmp_path, capfd):
    away = tmp_path / "away"
    away.mkdir()
    (away / "gain.txt").write_text("0.5")
    moving = f"""import os
import numpy as np
os.chdir({str(away)!r})
def policy(seen):
    gain = float(open("gain.txt").read())
    os.chdir("..")
    os.chdir("away")
    return gain * np.ones((len(seen), 1))
"""
    assert main(project("moving", moving)) == 0
    assert os.getcwd() == str(tmp_path)
    assert (tmp_path / "results/study/study.yaml").is_file()
    assert not (away / "results").exists()


@pytest.mark.parametrize("place", [".", "below"])
@pytest.mark.parametrize("module", ["walks", "legs.walks"])
def test_files_of_a_module_are_found_from_any_folder(project, tmp_path, monkeypatch, capfd, module, place):
    reads = """import numpy as np
FILES = ["walk.npz"]
saved = np.load(FILES[0])
def policy(seen):
    return seen[:, :1] * np.load(FILES[0])["weight"]
"""
    run = project("other", reads)
    folder = tmp_path.joinpath(*module.split(".")[:-1])
    folder.mkdir(exist_ok=True)
    (folder / "walks.py").write_text(reads)
    np.savez(folder / "walk.npz", weight=0.5)
    Path("study.yaml").write_text(STUDY.replace("NAME", module))
    Path("below").mkdir()
    monkeypatch.chdir(place)
    assert main([*run[:1], f"study={tmp_path}/study.yaml", "--dry-run"]) == 0
    assert os.getcwd() == str((tmp_path / place).resolve())

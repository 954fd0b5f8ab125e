"""Models that others ship, as they are: the same physics as a loop of MuJoCo's own, and a study with its check.

MuJoCo's come with it; the others with the extra `models`.
"""

from importlib.util import find_spec
from pathlib import Path

import mujoco
import numpy as np
import pytest

from sweep.cli.main import main
from sweep.runs import store

MODELS = [
    ("mujoco", "mjx/test_data/humanoid/humanoid.xml", "torso"),
    ("mujoco", "mjx/test_data/barkour_v0/assets/barkour_v0_mjx.xml", "chassis"),
    ("gymnasium", "envs/mujoco/assets/ant.xml", "torso"),
    ("gymnasium", "envs/mujoco/assets/humanoid.xml", "torso"),
    ("dm_control", "suite/quadruped.xml", "torso"),
]
TICKS, STEPS = 10, 5


@pytest.mark.parametrize(("package", "path", "body"), MODELS, ids=lambda part: Path(part).stem)
def test_a_model_of_others_runs_as_it_is(tmp_path, monkeypatch, capsys, package, path, body):
    found = find_spec(package)
    if found is None or not found.submodule_search_locations:
        pytest.skip(f"{package} is of the extra models")
    file = Path(found.submodule_search_locations[0], path)
    model = mujoco.MjSpec.from_file(str(file)).compile()
    own, period, wave = mujoco.MjData(model), STEPS * model.opt.timestep, f"wave_{package}_{file.stem}"
    monkeypatch.chdir(tmp_path)
    Path(f"{wave}.py").write_text(
        f"import numpy as np\ndef policy(seen):\n    return 0.1 + 0.2 * np.tile(seen[:, 2:3], {model.nu})\n"
    )
    mass, gravity = float(model.body(body).mass[0]), float(model.opt.gravity[2])
    Path("study.yaml").write_text(
        f"system: own\nmodel: {{mjcf: {file}, controller: '{wave}:policy', period: {period}, observe: [qpos],\n"
        f"  duration: {TICKS * period}}}\noutcome: {{fell: tilt_max_deg > 90}}\nstudy:\n  axes:\n"
        f"    load: {{path: model.body.{body}.mass, side: world, values: [{mass}, {1.5 * mass}]}}\n"
        f"    pull: {{path: model.option.gravity.z, side: world, values: [{gravity}, {gravity / 2}]}}\n"
    )
    for _ in range(TICKS):
        own.ctrl[:] = 0.1 + 0.2 * own.qpos[2]
        mujoco.mj_step(model, own, STEPS)
    assert main(["run", "study=study.yaml", "engine.precision=float64", "out=out"]) == 0
    rows = store.read_rows(Path("out")).iloc[0]
    np.testing.assert_allclose(rows["travelled_m"], own.qpos[0] - model.qpos0[0], atol=1e-6)
    assert main(["run", "study=study.yaml", "--check"]) == 0
    assert "2 of 2 axes have an effect" in capsys.readouterr().out
    assert main(["report", "out"]) == 0

"""States of a rollout and their model, read back with plain MuJoCo and pandas by the lines of the documents."""

import re
from pathlib import Path

import mujoco
import numpy as np
import pandas as pd
import pytest

from sweep.cli.commands import execute_command
from sweep.cli.main import main
from sweep.core.parameters import InputError

PAGE = Path(__file__).parents[2] / "docs" / "howto" / "use_states_elsewhere.md"
SHORT = ["scenario=stand_push", "engine=native", "engine.width=1", "engine.solid=true"]


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A real rollout, stored and replayed."""
    out = tmp_path_factory.mktemp("states")
    main(["run", *SHORT, f"out={out / 'rows'}"])
    assert (
        main(
            ["replay", str(out / "rows"), "0", "--states", str(out / "walk.parquet"), "--model", str(out / "walk.xml")]
        )
        == 0
    )
    return out


def test_the_documents_lines_load_them(folder, monkeypatch, capsys):
    code = re.findall(r"```python\n(import mujoco.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL)[0]
    monkeypatch.chdir(folder)
    found = {}
    exec(code, found)
    states, data, model = found["states"], found["data"], found["model"]
    assert capsys.readouterr().out.startswith("0.404 stand")
    assert data.site("foot1").xpos[2] == pytest.approx(0.0, abs=1e-3)  # it stands
    assert model.geom("base").contype[0]  # and is the model that was simulated, with its solid bodies
    assert not states.isna().any().any()
    weight = states.filter(like="_force_z_n").sum(axis=1).mean()
    assert weight == pytest.approx(9.81 * model.body_mass.sum(), rel=0.02)


def test_velocities_are_those_of_the_positions(folder):
    states = pd.read_parquet(folder / "walk.parquet")
    model = mujoco.MjModel.from_xml_path(str(folder / "walk.xml"))
    qpos, qvel = (states.filter(like=name).to_numpy() for name in ("qpos_", "qvel_"))
    period, shift = states["time_s"].diff().iloc[1], np.zeros(model.nv)
    for k in range(200, 320, 10):
        mujoco.mj_differentiatePos(model, shift, 2 * period, qpos[k - 1], qpos[k + 1])
        assert qvel[k] == pytest.approx(shift, abs=5e-3 + 0.2 * np.abs(shift).max())


@pytest.mark.parametrize("options", [["--states", "walk.csv"], ["--model", "walk.mjb"]])
def test_other_files_are_refused(options):
    with pytest.raises(InputError, match="is not allowed: a file that ends in"):
        execute_command(["replay", "results", "0", *options])

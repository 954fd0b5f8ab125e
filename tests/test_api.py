import json
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import matplotlib as mpl
import pandas as pd
import pytest

import sweep
from sweep.cli.main import main
from sweep.core.parameters import InputError
from sweep.runs import store

SMALL = ("study=walk_map", "study.axes.friction.num=4", "study.axes.step.num=3", "study.expect=[]")


@pytest.fixture(autouse=True)
def in_an_empty_folder(fake_engine, monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)


def test_rows_come_with_units_and_are_those_on_disk():
    rows = sweep.run(*SMALL)
    assert len(rows) == 12
    assert rows.attrs["study"] == "walk_map"
    units = rows.attrs["units"]
    assert (units["slip_max_m"], units["t_cause_s"], units["tilt_max_deg"]) == ("m", "s", "°")
    assert "world.contact.friction" not in units
    pd.testing.assert_frame_equal(sweep.load("results/walk_map"), rows)
    assert rows.groupby("step").size().tolist() == [4, 4, 4]
    stored = rows.drop(columns=["friction", "step"])  # names of axes, beside the columns on disk
    pd.testing.assert_frame_equal(store.read_rows(Path("results/walk_map")), stored)
    assert sweep.load("results/walk_map", "friction > 1")["world.contact.friction"].min() > 1


def test_a_nominal_rollout_is_one_row_and_leaves_no_files(tmp_path):
    rows = sweep.run("robot.thigh=0.5")
    assert rows["outcome"].tolist() == ["success"]
    assert not list(tmp_path.iterdir())
    with pytest.raises(InputError, match=r"robot\.thihg = 0\.5 is unknown: did you mean thigh"):
        sweep.run("robot.thihg=0.5")


def test_the_example_of_the_page_on_python_runs():
    page = (Path(__file__).parents[1] / "docs/howto/use_from_python.md").read_text(encoding="utf-8")
    example = re.search(r"```python\n(.*?)```", page, re.DOTALL)
    assert example
    names: dict[str, Any] = {}
    with mpl.rc_context({"backend": "agg"}):
        exec(example[1], names)
        figure = names["rows"].sweep.map("friction", "half_step_ratio")
    assert figure.axes


def test_a_folder_is_checked_without_what_simulates_it():
    """`sweep verify` of a million rows takes 0.36 GB; with JAX it took 0.47 GB."""
    code = "import sys, sweep.runs.repair; print({'jax', 'mujoco', 'scipy'} & set(sys.modules))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout == "set()\n"


def test_importing_is_light():
    code = "import sys, sweep; print({'jax', 'mujoco', 'pandas', 'hydra'} & set(sys.modules))"
    out = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    assert out == "set()\n"


def test_a_notebook_sees_maps_draws_and_pages():
    rows = sweep.run(*SMALL)
    assert rows.sweep.map().axes[0].get_xlabel() == "friction (world)"
    assert rows.sweep.map("half_step_ratio", "friction").axes[0].get_ylabel() == "friction (world)"
    some = rows[rows["outcome"] == "failure"]
    page = some.sweep.report()
    assert f"<strong>0 of {len(some)}</strong>" in str(page)
    assert page._repr_html_().startswith('<iframe srcdoc="&lt;!doctype')
    with pytest.raises(sweep.InputError, match="no axis with a distribution"):
        rows.sweep.draws()
    with pytest.raises(sweep.InputError, match="no row of results/walk_map is selected"):
        rows[rows["slip_max_m"] > 1e3].sweep.map()
    with pytest.raises(sweep.InputError, match="row 99 is not among the rows of results/walk_map"):
        rows.sweep.replay(99)
    with pytest.raises(AttributeError, match=r"see sweep\.load"):
        sweep.run().sweep.map()


def test_the_notebook_of_a_new_project_runs(tmp_path, monkeypatch):
    """All its cells but the replay, of which the fake engine has no record."""
    assert main(["init", str(tmp_path / "lab")]) == 0
    monkeypatch.chdir(tmp_path / "lab")
    cells = json.loads(Path("first.ipynb").read_text())["cells"]
    *code, last = ["".join(cell["source"]) for cell in cells if cell["cell_type"] == "code"]
    space: dict = {}
    for source in code:
        exec(source, space)
    assert len(space["rows"]) == 32
    assert "replay" in last


def test_a_grid_becomes_a_labelled_array():
    pytest.importorskip("xarray")
    rows = sweep.run(*SMALL)
    grid = rows.sweep.to_xarray()
    assert dict(grid.sizes) == {"world.contact.friction": 4, "manoeuvre.half_step_ratio": 3}
    first = rows.iloc[0]
    there = grid.sel({name: first[name] for name in grid.dims})
    assert float(there["slip_max_m"]) == first["slip_max_m"]
    assert grid["slip_max_m"].attrs["units"] == "m"
    assert "replicate" in sweep.run(*SMALL, "study.replicates=2").sweep.to_xarray().dims


def test_a_missing_xarray_is_said_in_one_line(monkeypatch):
    monkeypatch.setitem(sys.modules, "xarray", None)
    rows = sweep.run(*SMALL)
    with pytest.raises(InputError, match=r"^to_xarray needs the package xarray: pip install 'insect-sweep\[xarray\]'$"):
        rows.sweep.to_xarray()

"""Labels of what a study varies: the names that it gives to its axes, no two alike."""

import shutil
from pathlib import Path

import pandas as pd
import pytest

from sweep import load
from sweep.cli.main import main
from sweep.config.experiment import compose
from sweep.core.errors import InputError
from sweep.core.expressions import find_column
from sweep.report.labels import axis_words, unique_headings, unique_labels
from sweep.report.page.data import page_data
from sweep.runs import results
from sweep.study.study import attach_axis_names

DATA = Path(__file__).parents[1] / "data"


@pytest.fixture(scope="module")
def masses(tmp_path_factory):
    """A study of two masses of the quadruped that `sweep init --model` makes; its folder."""
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(tmp_path_factory.mktemp("masses"))
        assert main(["init", "--model", "quad"]) == 0
        patch.chdir("quad")
        shutil.copy(DATA / "two_masses.yaml", "studies/names.yaml")
        assert main(["run", "study=names", "out=results/names"]) == 0
        yield Path("results/names").resolve()


def test_labels_are_the_names_of_the_axes(masses, capsys):
    heads = ["trunk load (world) [kg]", "hip load (world) [kg]"]
    assert main(["table", str(masses)]) == 0
    table = capsys.readouterr().out
    assert [cell.strip() for cell in table.splitlines()[0].split("|")[1:3]] == heads
    assert "- hip load (world): world.model.body.lf_hip.mass" in table
    assert main(["report", str(masses)]) == 0
    page = (masses / "report.html").read_text()
    for head, path in zip(heads, ("trunk", "lf_hip"), strict=True):
        assert f'<th title="world.model.body.{path}.mass [kg]">{head}</th>' in page
    assert [one["label"] for one in page_data(results.read_results(masses))["columns"][:2]] == [
        head[:-5] for head in heads
    ]
    assert main(["table", str(masses), "--format", "latex"]) == 0
    assert " & ".join(heads) in capsys.readouterr().out


def test_names_of_axes_are_accepted_where_columns_are(masses, capsys):
    assert main(["table", str(masses), "--where", "trunk_load > 7", "--columns", "hip_load", "--format", "csv"]) == 0
    assert capsys.readouterr().out.splitlines()[1:] == ["0.4", "0.8"]
    assert main(["compare", str(masses), str(masses), "--by", "trunk_load,hip_load", "--regions", "hip_load"]) == 0
    assert load(masses, "hip_load < 0.5").groupby("trunk_load").size().tolist() == [1, 1]
    assert load(masses).sweep.map("hip_load", "trunk_load").axes[0].get_xlabel() == "hip load (world) [kg]"


def test_no_two_columns_share_a_label():
    masses = ["world.model.body.trunk.mass", "world.model.body.lf_hip.mass", "belief.model.body.trunk.mass"]
    words = unique_labels([*masses, "mass"])
    assert list(words.values()) == ["trunk mass (world)", "lf hip mass (world)", "mass (belief)", "mass"]
    exp = compose(["study=walk_map", "+study.axes.slip_max={path: drive.damping, values: [500.0, 520.0]}"])
    heads = unique_headings(["world.contact.friction", "drive.damping", "slip_max_m"], exp)
    assert len(set(heads.values())) == 3
    ratio = compose(["study=walk_map", "+study.axes.shin={path: robot.shin, relative: 1, values: [0.0, 0.01]}"])
    assert axis_words("axis.shin", ratio) == "shin, relative error"


def test_an_axis_that_another_column_ends_like_is_ambiguous():
    rows = pd.DataFrame({"robot.body_mass": [1.0], "obstacle.mass": [2.0], "axis.shin": [0.1], "robot.shin": [0.2]})
    exp = compose(["study=walk_map", "+study.axes.mass={path: robot.body_mass, values: [10.0, 20.0]}"])
    with pytest.raises(InputError, match=r"column mass is ambiguous .*obstacle\.mass, robot\.body_mass"):
        find_column(attach_axis_names(rows, exp.study.axes), "mass")
    rows.attrs["axes"] = {"shin": "axis.shin"}
    assert find_column(rows, "shin") == "axis.shin"


def test_columns_of_the_second_run_have_the_units_of_the_first():
    assert [*unique_headings(["t_cause_s", "t_cause_s (B)"]).values()] == ["t cause [s]", "t cause (B) [s]"]

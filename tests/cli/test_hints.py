"""Messages that say what the user probably meant."""

import pandas as pd
import pytest

from sweep.cli.main import main
from sweep.core.errors import InputError
from sweep.core.expressions import condition_mask, find_column

ROWS = pd.DataFrame({"world.contact.friction": [0.5], "slip_max_m": [0.01], "slip_mean_m": [0.01],
                     "tilt_max_deg": [1.0],
                     "energy_j": [1.0], "outcome": ["success"], "cause": [""]})  # fmt: skip
NO_PROJECT = "this folder is in no project: neither it nor a folder above it has a sweep.yaml"
LOW = "+study.axes.mu={path: contact.friction, distribution: {kind: normal, mean: 0.1, std: 0.1}}"


@pytest.mark.parametrize(
    ("words", "line"),
    [
        (["run", "walk_tripod"], "walk_tripod is not allowed: did you mean scenario=walk_tripod?"),
        (["run", "walk_map"], "walk_map is not allowed: did you mean study=walk_map?"),
        (["run", "--study", "walk_map"], "--study is not allowed: did you mean study=walk_map?"),
        (["run", "first"], f"group=choice or group.name=value; {NO_PROJECT}"),
        (["run", "study=first"], NO_PROJECT),
        (["run", "--points", "points.csv", "study.name=s"], "points.csv separates values by semicolons"),
        (
            ["run", LOW, "study.name=s", "study.design.num=64"],
            "axis mu draws it: give its distribution `from` and `to` to truncate it",
        ),
        (["describe", "energi_j"], "energi_j is unknown: did you mean energy_j?"),
        (["describe", "torque_limt"], "did you mean torque_limit? (nearest: drive.torque_limit, "),
        (["describe", "robot=mine"], NO_PROJECT),
    ],
)
def test_mistakes_are_answered_with_what_was_meant(words, line, monkeypatch, tmp_path, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "points.csv").write_text("contact.friction;robot.body_mass\n0,5;10\n")
    assert main(words) == 2
    assert line in capsys.readouterr().err


def test_a_choice_of_the_project_is_suggested(monkeypatch, tmp_path, capsys):
    monkeypatch.chdir(tmp_path)
    assert main(["init", "own"]) == 0
    monkeypatch.chdir("own")
    capsys.readouterr()
    assert main(["run", "first"]) == main(["run", "--study", "first"]) == 2
    told = capsys.readouterr().err.splitlines()
    assert [line.rpartition(": ")[2] for line in told] == ["did you mean study=first?"] * 2


@pytest.mark.parametrize(
    ("name", "said"),
    [("energy_j", "positive work of the drives"), ("obstacle=flat", "slope: 0.0"), ("margin", "nearest threshold"),
     ("robot=circular", "mount_radius: 0.525")],
)  # fmt: skip
def test_describe_knows_columns_and_choices(name, said, capsys):
    assert main(["describe", name]) == 0
    assert said in capsys.readouterr().out


def test_an_unknown_column_is_answered_with_the_five_nearest():
    with pytest.raises(InputError) as caught:
        find_column(ROWS, "slip_max")
    assert str(caught.value).startswith(
        "column slip_max is unknown: did you mean slip_max_m? (nearest: slip_max_m, slip_"
    )
    assert str(caught.value).count(", ") == 4


def test_a_single_equals_sign_is_answered_with_two():
    with pytest.raises(InputError, match=r"is not a condition \(equality is written ==\)"):
        condition_mask(ROWS, 'outcome = "failure"')
    with pytest.raises(InputError, match=r"is not a condition, such as"):
        condition_mask(ROWS, "slip_max_m <")

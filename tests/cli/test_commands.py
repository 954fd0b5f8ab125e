import subprocess
import sys

import pandas as pd
import pytest

from sweep.cli.main import main

SMALL = ["study=walk_map", "study.axes.friction.num=4", "study.axes.step.num=3"]


@pytest.fixture(autouse=True)
def in_an_empty_folder(fake_engine, monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)


def test_a_scenario_shows_its_outcome_and_leaves_no_files(capsys, tmp_path):
    assert main(["run"]) == 0
    out, err = capsys.readouterr()
    assert out.startswith("| figure")
    assert "walk_tripod" in out
    assert "success" in out
    assert not err
    assert main(["run", "contact.friction=0.3"]) == 4
    out, err = capsys.readouterr()
    assert "in stage walk: the base tilted beyond tilt_max_deg" in out
    assert "expected share" in err
    assert main(["run", "contact.friction=7"]) == 3
    assert not list(tmp_path.iterdir())


def test_a_study_from_run_to_table_and_map(capsys, tmp_path):
    assert main(["run", *SMALL, "--dry-run"]) == 0
    plan = "12 of 12 rollouts to run (2 batches of 6), 2.0 KiB kept a rollout, time unknown before a first batch"
    assert plan in capsys.readouterr().out
    assert not list(tmp_path.iterdir())
    assert main(["run", *SMALL]) == 0
    assert "12 of 12 planned rollouts are in results/walk_map" in capsys.readouterr().out
    assert main(["run", *SMALL, "out=results/else", "--dry-run"]) == 0
    assert " s by the pace of results/walk_map" in capsys.readouterr().out
    assert main(["status", "results/walk_map"]) == 0
    told = capsys.readouterr().out
    assert "12 of 12 rollouts done" in told
    assert "fell: the base tilted beyond tilt_max_deg" in told
    assert main(["table", "results/walk_map", "--format", "csv", "--where", "friction > 1"]) == 0
    assert capsys.readouterr().out.count("\n") == 4
    assert main(["table", "results/walk_map", "--format", "parquet", "-o", "rows.parquet"]) == 0
    assert len(pd.read_parquet("rows.parquet")) == 12
    assert main(["table", "results/walk_map", "--columns", "friction,slip_max_m"]) == 0
    assert "slip max [m]" in capsys.readouterr().out
    assert main(["stats", "results/walk_map"]) == 0
    statistics = capsys.readouterr().out
    assert "Share of the grid's box that succeeds" in statistics
    # success where friction > 5 ratio, of ratios 0.03, 0.115, 0.2; 0.8167 is the friction nearest to the nominal one
    assert "| manoeuvre.half_step_ratio | above  | 0.1       | 0.115      | 0.2        | 0.015    | 2 " in statistics
    assert main(["report", "results/walk_map"]) == 0
    assert (tmp_path / "results/walk_map/map.png").stat().st_size > 10_000


def test_what_a_study_expects_and_what_is_invalid_decide_the_exit_code(capsys):
    assert main(["run", *SMALL, "study.expect=[{where: 'friction < 0.1', at_least: 0.5}]"]) == 4
    assert 'share of outcome == "success" where friction < 0.1 from 0.5 to 1' in capsys.readouterr().err
    assert main(["run", *SMALL, "study.expect=[{that: 'slip_max_m < 100', at_least: 1}]"]) == 0
    seven = ["study=walk_map", "out=seven", "study.axes.friction.values=[1.0,7.0]"]
    assert main(["run", *seven]) == 3
    out, err = capsys.readouterr()
    assert "17 invalid (50.0 %)" in out
    assert "1.0% allowed" in err
    assert main(["run", *seven, "study.invalid_max=0.5", "study.expect=[]"]) == 0


def test_points_from_a_file(tmp_path, capsys):
    (tmp_path / "p.csv").write_text("world.contact.friction,manoeuvre.half_step_ratio\n1.0,0.1\n0.2,0.1\n")
    assert main(["run", "--points", "p.csv", "out=here"]) == 0
    assert "1 of 2 succeed" in capsys.readouterr().out
    assert main(["run", "--points", "none.csv"]) == 2


@pytest.mark.parametrize(
    "arguments",
    [
        ["run", "robot.coxx=1"],
        ["run", "robot.thigh=-1"],
        ["run", "contact.friction=-1"],
        ["run", "scenario=nowhere"],
        ["run", "+study.axes.a={path: contact.frction, values: [1]}"],
        ["run", *SMALL, "--where", "frction > 1"],
        ["run", *SMALL, "--limit", "0"],
        ["status", "nowhere"],
        ["table", "nowhere"],
        ["relabel", "nowhere", "slip_max_m<1"],
        ["replay", "nowhere", "0"],
    ],
)
def test_bad_input_is_one_line_and_exit_code_2(arguments, capsys, tmp_path):
    assert main(arguments) == 2
    out, err = capsys.readouterr()
    assert not out
    assert err.startswith("sweep: ")
    assert err.count("\n") == 1
    assert not list(tmp_path.iterdir())


def test_hydra_keeps_its_own_flags(capsys):
    assert main(["run", "--cfg", "job", "contact.friction=0.5"]) == 0
    assert "friction: 0.5" in capsys.readouterr().out
    assert main(["run", "--multirun", "contact.friction=0.1,1.0"]) == 4
    assert capsys.readouterr().out.count("| figure") == 2


def test_the_standard_output_holds_results_only():
    command = [sys.executable, "-m", "sweep.cli", "run", "study=walk_map", "--dry-run"]  # with the real engine
    out = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    assert out.startswith("walk_map: 561 of 561 rollouts to run")
    assert "| step     | manoeuvre.half_step_ratio | both   | 0.03, 0.040625, ... 0.2 (17 values)  | a_r" in out
    assert out.count("\n") == 5


def test_list_describes_every_choice_and_needs_no_simulation():
    slow = "{'mujoco', 'hydra', 'jax'}"
    code = f"import sys; from sweep.cli.main import main; main(['list']); print(sys.modules.keys() & {slow})"
    out = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    assert "walk_map             Where walking works" in out
    assert out.endswith("set()\n")


def test_mistakes_with_results_are_one_line_each(capsys, tmp_path):
    assert main(["run", "study=walk_map", "study.axes.friction.num=2", "study.axes.step.num=2", "study.expect=[]"]) == 0
    (tmp_path / "file").touch()
    (tmp_path / "empty").mkdir()
    results = "results/walk_map"
    mistakes = [
        (["run", "study=wlak_map"], "study = wlak_map is unknown: did you mean walk_map"),
        (["report", "empty"], "empty is not a folder of results"),
        (["report", results, "--where", "friction > 9"], "no row of results/walk_map matches where = 'friction > 9'"),
        (["report", results, "-o", "file"], "file: File exists"),
        (["export", results, "--paper", "file"], "file/figures: Not a directory"),
        (["table", results, "-o", "none/rows.md"], "none/rows.md: No such file or directory"),
        (["table", results, "--where", "friction"], "where = 'friction' is not a condition"),
        (["stats", results, "--figure", "slip_max_m"], "need a study with study.design.kind=saltelli"),
        (["compare", results, results, "--regions", "firction"], "column firction is unknown"),
    ]
    capsys.readouterr()
    for arguments, message in mistakes:
        assert main(arguments) == 2, arguments
        error = capsys.readouterr().err
        assert message in error
        assert error.count("\n") == 1

import re
import subprocess
import sys

import pandas as pd
import pytest
from small_study import one_line

from sweep import engines
from sweep.cli.main import main
from sweep.runs import store

REAL = engines.make_engine
SMALL = ["study=walk_map", "study.axes.friction.num=4", "study.axes.step.num=3"]


@pytest.fixture(autouse=True)
def in_an_empty_folder(fake_engine, monkeypatch, tmp_path):
    for screen in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(screen, raising=False)
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
    assert "in stage walk" in out
    assert "the base tilted beyond 20° (tilt_max_deg 40, at most 20)" in out
    assert "expected share" in err
    assert main(["run", "contact.friction=7"]) == 3
    assert not list(tmp_path.iterdir())


def test_status_counts_each_point_of_a_study_with_delays_once(capsys):
    delay = "+study.axes.delay={path: noise.delay, side: world, values: [0, 1]}"
    for flags, done in ((["--limit", "5"], "5 of 24"), ([], "24 of 24")):
        assert main(["run", *SMALL, delay, *flags, "study.expect=[]"]) == 0
        assert main(["status", "results/walk_map"]) == 0
        assert f"{done} rollouts done" in capsys.readouterr().out


def test_a_study_from_run_to_table_and_map(capsys, tmp_path):
    assert main(["run", *SMALL, "--dry-run"]) == 0
    plan = "12 of 12 rollouts to run (2 batches of 6), 2.0 KiB of memory per rollout, time unknown until a first batch"
    told = capsys.readouterr().out
    assert plan in told
    assert re.search(r"compile time unknown: not measured|about \d+ s to compile", told)  # tests share a cache
    assert not list(tmp_path.iterdir())
    assert main(["run", *SMALL]) == 0
    assert "12 of 12 planned rollouts are in results/walk_map" in capsys.readouterr().out
    assert main(["run", *SMALL, "out=results/else", "--dry-run"]) == 0
    assert " s at the speed of results/walk_map" in capsys.readouterr().out
    assert main(["status", "results/walk_map"]) == 0
    told = capsys.readouterr().out
    assert "12 of 12 rollouts done" in told
    assert "fell: the base tilted beyond 20° (tilt_max_deg)" in told
    assert main(["table", "results/walk_map", "--format", "csv", "--where", "friction > 1"]) == 0
    assert capsys.readouterr().out.count("\n") == 4
    assert main(["table", "results/walk_map", "--format", "parquet", "-o", "rows.parquet"]) == 0
    assert len(pd.read_parquet("rows.parquet")) == 12
    assert main(["table", "results/walk_map", "--columns", "friction,slip_max_m,friction", "--format", "csv"]) == 0
    assert capsys.readouterr().out.startswith("world.contact.friction,slip_max_m\n")  # each once
    assert main(["table", "results/walk_map", "--columns", "friction,slip_max_m"]) == 0
    assert "slip max [m]" in capsys.readouterr().out
    assert main(["stats", "results/walk_map"]) == 0
    statistics = capsys.readouterr().out
    first, second, _, title = statistics.splitlines()[:4]
    assert first == "walk_map: 6 of 12 succeed (50.0 %), 0 invalid (0.0 %); the points were chosen: no random sample"
    assert second.startswith("most frequent failure: fell (6 of 6 failures, 100.0 %): the base tilted beyond 20°")
    assert title.startswith("## ")
    assert "Share of the grid's volume that succeeds" in statistics
    # success where friction > 5 ratio, of ratios 0.03, 0.115, 0.2; 0.8167 is the friction nearest to the nominal one
    assert "| manoeuvre.half_step_ratio | above  | 0.1       | 0.115      | 0.2        | 0.015    | 2 " in statistics
    assert main(["report", "results/walk_map"]) == 0
    assert (tmp_path / "results/walk_map/map.png").stat().st_size > 10_000


def test_what_a_study_expects_and_what_is_invalid_decide_the_exit_code(capsys):
    assert main(["run", *SMALL, "study.expect=[{where: 'friction < 0.1', at_least: 0.5}]"]) == 4
    assert 'share of outcome == "success" where friction < 0.1: at least 0.5' in capsys.readouterr().err
    assert main(["run", *SMALL, "study.expect=[{that: 'slip_max_m < 100', at_least: 1}]"]) == 0
    nominal = ["scenario=walk_tripod", "scenario.expect=[{at_most: 0}]"]
    assert main(["run", *nominal]) == 4
    assert "at most 0, got 1 of 1" in capsys.readouterr().err
    assert main(["run", *nominal, "engine=native", "manoeuvre.steps=1"]) == 4  # by sixteen
    assert "at most 0.2, got 1 of 16" in capsys.readouterr().err
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
    (tmp_path / "comma.csv").write_text("contact.friction\n0,9\n")
    assert main(["run", "--points", "comma.csv"]) == 2
    one_line(capsys.readouterr().err, "comma.csv is not a table: a line has more values than there are column names")
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
        ["run", *SMALL, "study.expect=[{where: frction > 1}]"],
        ["run", "scenario.expect=[{that: slip_mx_m < 1}]"],
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


def test_an_early_interruption_finds_the_command_ready():
    code = """import sys
class Interrupts:
    def find_spec(self, name, *_):
        if name == "sweep.cli.commands":
            raise KeyboardInterrupt
sys.meta_path.insert(0, Interrupts())
before = {*sys.modules}
from sweep.cli.main import main
print(main(["list"]), *{*sys.modules} - before)"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    status, *imported = done.stdout.split()
    assert status == "130"
    assert done.stderr.startswith("sweep: interrupted")
    # threading and signal, with what they import, end a command whose compiler holds the main thread
    assert len([name for name in imported if not name.startswith("sweep")]) < 15


@pytest.mark.parametrize(
    ("argument", "unneeded"),
    [
        ("scenario=nowhere", ("hydra", "jax", "mujoco", "numpy", "pandas")),
        ("robot.thigh=-1", ("llvmlite", "matplotlib", "mujoco", "pandas", "pyarrow", "rich", "SALib", "scipy")),
    ],
)
def test_what_is_wrong_is_told_before_what_is_slow_is_imported(argument, unneeded):
    code = f"import sys; from sweep.cli.main import main; print(main(['run', '{argument}']), *sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    status, *imported = done.stdout.split()
    assert status == "2"
    assert argument.partition("=")[0] in done.stderr
    assert not set(unneeded) & set(imported)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ([], "the following arguments are required: command (`sweep --help` explains more)"),
        (["lits"], "command = lits is unknown: did you mean list? (allowed: audit, bench,"),
        (["table"], "the following arguments are required: dir (`sweep table --help` explains more)"),
        (["table", "results", "--whre", "x"], "--whre is unknown: did you mean --where? (allowed: --columns,"),
        (["table", "results", "--format", "md"], "--format = md is unknown (allowed: csv, latex, markdown, parquet)"),
        (["stats", "results", "--level", "x"], "--level = x is not allowed: a number"),
        (["run", "--limit", "x"], "--limit = x is not allowed: a whole number"),
        (
            ["run", "study=walk_map", "--dryrun"],
            "--dryrun is unknown: did you mean --dry-run? (allowed: --cfg, --check",
        ),
        (["run", "--cfg", "jb"], "--cfg/-c = jb is unknown: did you mean job? (allowed: all, hydra, job)"),
        (["run", "--resolve"], "--resolve is for --cfg"),
        (["run", "--shell-completion"], "--shell-completion needs install=, uninstall=, query= and a shell"),
        (["run", "--experimental-rerun", "none"], "--experimental-rerun = none is not a file"),
        (["run", "--multirun", "--cfg", "job"], "--multirun and --cfg are not allowed together"),
        (["tune", "--populaton", "3"], "--populaton is unknown: did you mean --population?"),
        (["replay", "results", "3", "--plot", "torque"], "--plot = torque is unknown: did you mean torques?"),
        (["formula", "--jsn"], "--jsn is unknown: did you mean --json?"),
    ],
)
def test_mistaken_flags_are_one_line_without_the_usage(arguments, message, capsys):
    assert main(arguments) == 2
    told = capsys.readouterr()
    assert told.err.startswith(f"sweep: {message}")
    assert told.err.count("\n") == 1
    assert not told.out


def test_points_from_a_file_with_a_quote_in_its_name(tmp_path, capsys):
    (tmp_path / "it's mine.csv").write_text("world.contact.friction\n1.0\n0.2\n")
    assert main(["run", "--points", "it's mine.csv", "out=here"]) == 0
    assert "1 of 2 succeed" in capsys.readouterr().out


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
    assert "walk_map             Walking by tripod: friction" in out
    assert out.endswith("set()\n")


def test_a_part_of_a_study_is_not_taken_for_the_whole(capsys):
    assert main(["run", *SMALL, "--limit", "5"]) == 0
    assert "5 of 12 planned rollouts are in results/walk_map" in capsys.readouterr().out
    assert main(["status", "results/walk_map"]) == 0
    assert "5 of 12 rollouts done" in capsys.readouterr().out
    assert main(["list", "results"]) == 0
    assert "| results/walk_map | walk_map | 5 of 12 " in re.sub(" +", " ", capsys.readouterr().out)


def test_several_folders_are_compared_with_one(capsys):
    for name in "abc":
        limit = "0.5" if name == "b" else "20"
        assert main(["run", *SMALL, f"out={name}", "study.expect=[]", f"outcome.tilt_max_deg={limit}"]) == 0
    capsys.readouterr()
    assert main(["compare", "a", "b", "c", "-o", "differ.csv"]) == 4
    out, _ = capsys.readouterr()
    assert out.index("a and b") < out.index("a and c")
    assert set(pd.read_csv("differ.csv")["B"]) == {"b"}


def test_draws_have_a_picture_of_their_own(capsys, tmp_path):
    axes = ["+study.axes.f={path: contact.friction, side: world, distribution: {kind: uniform, from: 0.1, to: 1}}",
            "+study.axes.m={path: robot.body_mass, relative: 0.1}", "study.design.num=12"]  # fmt: skip
    assert main(["run", "study.name=few", *axes]) == 0
    assert main(["report", "results/few"]) == 0
    assert {"report.html", "draws.png", "draws.svg"} <= {path.name for path in (tmp_path / "results/few").iterdir()}
    page = (tmp_path / "results/few/report.html").read_text().partition("<script")[0]
    assert 'alt="Draws"' in page
    assert "bins" not in page  # of which 12 draws would leave most empty
    assert main(["report", "results/few", "--x", "friction", "--y", "body_mass"]) == 0


def test_copies_and_choices_are_not_taken_for_evidence(capsys):
    assert main(["run", *SMALL, "study.replicates=5"]) == 0
    out = capsys.readouterr().out
    assert "6 of 12 succeed (50.0 %), 0 invalid" in out  # of a grid: no sample, no interval
    assert "48 duplicate noise-free rollouts are counted once" in out
    assert main(["stats", "results/walk_map"]) == 0
    told = capsys.readouterr().out
    assert "| 60 " not in told
    assert "48 duplicate noise-free rollouts are counted once; the points were chosen" in told.splitlines()[0]
    assert main(["run", "study.replicates=5", "out=noisy", "noise.position_noise=0.001"]) == 0
    assert "5 of 5 succeed (100.0 %, 95 % interval 56.6 % to 100.0 %)" in capsys.readouterr().out


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
        (["report", results, "-o", ""], "-o/--output =  is not allowed: a path"),
        (["export", results, "--paper", "file"], "file/figures: Not a directory"),
        (["table", results, "-o", "none/rows.md"], "none/rows.md cannot be written: No such file or directory"),
        (["table", results, "--where", "friction"], "where = 'friction' is not a condition"),
        (
            ["table", results, "--where", "outcome == failure"],
            'failure is unknown (a word is written in quotes: "failure")',
        ),
        (["table", results, "--where", "not friction"], "where = 'not friction' is not a condition"),
        (["replay", results, "99"], "99 is not a point of results/walk_map: give a row from 0 to 3"),
        (["relabel", results, "slip_max<1"], "outcome.slip_max is unknown: did you mean slip_max_m"),
        (["relabel", results, "slip_max_m<1", "slip_max_m<2"], "given twice: slip_max_m<1 slip_max_m<2"),
        (["compare", results, results, "--level", "0.9"], "--level = 0.9 is for --anytime"),
        (
            ["run", *SMALL, "+study.axes.d={path: noise.delay, values: [1, 1.5]}"],
            "noise.delay = 1.5 is not allowed: a whole",
        ),
        (["run", "obstacle=file.yaml"], "file.yaml: obstacle.kind is missing (allowed: ball, "),
        (["stats", results, "--figure", "slip_max_m"], "needs a study with study.design.kind=saltelli"),
        (["compare", results, results, "--regions", "firction"], "column firction is unknown"),
        (["compare", results, results, "--regions", "outcome"], "outcome is not a parameter"),
        (["compare", results, results, "--tolerance", "7"], "--tolerance = 7 is not allowed: a share from 0 to 1"),
        (["stats", results, "--figure", "nope"], "column nope is unknown"),
        (["report", results, "--x", "nope"], "column nope is unknown"),
        (["report", results, "--x", "frction"], "column frction is unknown: did you mean friction?"),
        (
            ["report", results, "--x", "outcome", "--y", "friction"],
            "a map over outcome is not allowed: its axes are num",
        ),
        (["reproduce", "empty", "--seed", "-1"], "--seed = -1 is not allowed: at least 0 and below 2^32"),
        (["compare", results, results, "--anytime", "--most", "-3"], "--most = -3 is not allowed: at least 1"),
        (["table", results, "-o", f"{results}/study.yaml"], "study.yaml is not allowed: a study's own file"),
        (["table", results, "-o", f"{results}/log.txt"], "log.txt is not allowed: a study's own file"),
        (
            ["compare", results, results, "-o", f"{results}/points.parquet"],
            "points.parquet is not allowed: a study's own",
        ),
        (["table", results, "-o", "."], ". cannot be written: Is a directory"),
        (
            ["replay", results, "0", "--mcap", "/proc/self/x"],
            "/proc/self/x cannot be written: No such file or directory",
        ),
        (["compare", results, results, "--anytime", "-o", "x.csv"], "--output is not allowed with --anytime"),
        (["compare", results, results, "--anytime", "--figures", "0"], "--figures is not allowed with --anytime"),
        (["export", results, "--paper", "p", "--zip"], "--zip, --author and --license need --crate"),
        (["view", "nowhere", "3"], "nowhere is neither a folder of results nor group.name=value"),
        (["describe", "torque_limit"], "torque_limit is unknown: did you mean drive.torque_limit?"),
        (["run", "study=walk_map", "study=push_map"], "study is chosen twice: study=walk_map study=push_map"),
        (["run", "--limit", "3"], "--limit = 3 selects points of a study: give study=NAME"),
        (["run", *SMALL, "study.invalid_max=-1"], "study.invalid_max = -1 is not allowed: a share from 0 to 1"),
        (
            ["run", *SMALL, "study.axes.step.num=1"],
            "study.axes.step.num = 1 is not allowed from 0.03 to 0.2: at least 2",
        ),
        (["run", "manoeuvre.steps=0"], "manoeuvre.steps = 0 is not allowed: at least 1"),
        (["run", "contact.friction=inf"], "contact.friction = inf is not allowed: a finite number"),
        (["run", "@=3"], "@=3 cannot be read"),
        (["run", "friction=0.3"], "friction = 0.3 is unknown: did you mean contact.friction?"),
        (["run", "contact.friction.x=3"], "contact.friction.x=3 is not allowed: contact.friction has no parts"),
        (
            ["run", "robot=base,circular"],
            "robot=base,circular cannot be read: write a list as key=[VALUE,VALUE], or run each value with --multi",
        ),
        (["run", "study=list.yaml"], "study/list.yaml has a list or a word where keys and values are needed"),
        (["run", "study=word.yaml"], "study/word.yaml has a list or a word where keys and values are needed"),
        (["run", "--points", ""], "study.points =  is not a file"),
        (["run", "execution.dead_joint=1.5"], "execution.dead_joint = 1.5 is not allowed: a whole number"),
        (["init", " "], "dir = ' ' is not allowed: a new or empty folder"),
        (["run", "--points", "file.csv"], "world.contact.friction = 'abc' is not allowed: a number"),
    ]
    (tmp_path / "file.yaml").write_text("height: 3\n")
    for name, part in (("list", "axes: [1, 2]"), ("word", "design: sobol")):
        (tmp_path / f"{name}.yaml").write_text(f"scenario: walk_tripod\nstudy:\n  {part}\n")
    (tmp_path / "file.csv").write_text("world.contact.friction\n0.3\n0.5\nabc\n")
    capsys.readouterr()
    for arguments, message in mistakes:
        assert main(arguments) == 2, arguments
        one_line(capsys.readouterr().err, message)
    long = "x" * 250
    assert main(["table", results, "-o", long]) == 2  # nor can what is half-written be removed, as on a disk to read
    assert capsys.readouterr().err == f"sweep: {long} cannot be written: File name too long\n"
    assert main(["report", results, "-o", "/proc/self"]) == 2  # where not even root may write
    assert capsys.readouterr().err == "sweep: /proc/self/report.html cannot be written: No such file or directory\n"
    assert main(["table", results, "--where", "friction > 9", "--format", "csv"]) == 0
    assert capsys.readouterr().err == "sweep: none of 4 rows of results/walk_map matches 'friction > 9'\n"


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (
            ["robot.body_mass=1e-30"],
            "robot or obstacle is not allowed: MuJoCo cannot compile its model: mass and inertia of",
        ),
        (
            ["scenario=corner_roof", "plan=bad.yaml", "--dry-run"],
            "plan.roof.reverse = roof is not allowed: another part",
        ),
    ],
)
def test_what_only_the_engine_knows_is_one_line_too(arguments, message, capsys, tmp_path, monkeypatch):
    monkeypatch.setattr(engines, "make_engine", REAL)
    (tmp_path / "bad.yaml").write_text("extends: corner\nsizes: {rise: 0}\nroof: {reverse: roof}\n")
    assert main(["run", *arguments]) == 2
    one_line(capsys.readouterr().err, f"sweep: {message}")


def test_a_folder_that_this_version_cannot_read_is_named_with_its_own(capsys, tmp_path):
    assert main(["run", *SMALL, "study.expect=[]"]) == 0
    stored = store.read_study(folder := tmp_path / "results/walk_map")
    stored["config"]["contact"]["fricshun"] = 1
    store.write_study(folder, stored | {"commit": "abc"})
    for command in ("table", "stats", "report", "status", "replay"):
        capsys.readouterr()
        assert main([command, str(folder), *["0"] * (command == "replay")]) == 2
        assert f"sweep: {folder}, by version abc: contact.fricshun is unknown: did you mean" in capsys.readouterr().err
    assert main(["list", str(folder), "elsewhere"]) == 2
    assert capsys.readouterr().err == "sweep: elsewhere holds no study: a folder with study.yaml is one\n"


def test_a_folder_of_another_version_is_no_other_study(capsys, tmp_path):
    assert main(["run", *SMALL, "study.expect=[]"]) == 0
    stored = store.read_study(folder := tmp_path / "results/walk_map")
    del stored["config"]["control"]  # which came later
    store.write_study(folder, stored | {"code": "before", "commit": "abc"})
    capsys.readouterr()
    assert main(["run", *SMALL, "study.expect=[]"]) == 2
    assert "was simulated by another version of the code or of its libraries (abc)" in capsys.readouterr().err
    assert main(["run", *SMALL, "study.expect=[]", "contact.damping=4000"]) == 2
    assert "holds another study: contact.damping is " in capsys.readouterr().err


def test_a_grid_of_other_values_is_added_and_told(capsys):
    other = "study.axes.friction.from=0.3"
    assert main(["run", *SMALL, "study.expect=[]"]) == 0
    for arguments in (["--dry-run"], []):
        capsys.readouterr()
        assert main(["run", *SMALL, "study.expect=[]", other, *arguments]) == 0
        assert (
            "sweep: note: study.axes.friction.from was 0.05 in results/walk_map and is 0.3 " in capsys.readouterr().err
        )
    assert main(["run", *SMALL, "study.expect=[]", other]) == 0
    assert "note" not in capsys.readouterr().err


def test_rollouts_are_replayed_on_the_page_and_watched(capsys, tmp_path, monkeypatch):
    for screen in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(screen, raising=False)
    assert main(["run", *SMALL, "study.expect=[]"]) == 0
    assert main(["report", "results/walk_map", "--replays", "5"]) == 0
    kept = {file.stem.partition("-")[2] for file in (tmp_path / "results/walk_map/replays").iterdir()}
    assert len(kept) == 5
    page = (tmp_path / "results/walk_map/report.html").read_text()
    assert all(f'"point":"{point}"' in page for point in kept)
    assert main(["view", "results/walk_map", "3", "--with", "7", "-o", "two.html"]) == 0
    assert '"open":2' in (tmp_path / "two.html").read_text()
    assert main(["view", "scenario=walk_tripod", "--with", "contact.friction=0.3"]) == 0
    page = (tmp_path / "results/view/walk_tripod.html").read_text()
    assert "contact.friction=0.3: <strong>fell</strong>" in page
    assert "sweep: there is no display (DISPLAY is not set): open two.html in a browser" in capsys.readouterr().err
    monkeypatch.setenv("DISPLAY", ":9")
    opened = []
    monkeypatch.setattr("webbrowser.open", lambda address: opened.append(address) or len(opened) < 2)
    for _ in range(2):
        assert main(["view", "results/walk_map", "3", "-o", "one.html"]) == 0
    assert opened == [(tmp_path / "one.html").resolve().as_uri()] * 2
    assert capsys.readouterr().err.count("no browser opens it: open one.html in a browser") == 1
    monkeypatch.delenv("DISPLAY")
    refused = {
        "study=walk_map": "walk_map is a study",
        "results/walk_map": "add a row number",
        "results/walk_map 999": "is not a point",
        "--mujoco robot=base": "needs a screen",
    }
    for words, error in refused.items():
        assert main(["view", *words.split()]) == 2
        assert error in capsys.readouterr().err

"""What a user has of one's own: a project with studies, robots, obstacles and manoeuvres."""

import dataclasses
import subprocess
import sys
import warnings

import pytest
from small_study import one_line

import sweep
from sweep.cli.main import main
from sweep.config import reference
from sweep.config.experiment import CLASSES_BY_KIND, compose
from sweep.core import project, provenance
from sweep.core.groups import GROUPS
from sweep.core.parameters import InputError
from sweep.models.case import Case

OWN = """
from dataclasses import dataclass
import jax.numpy as jnp
from sweep.manoeuvres.walking.walk import Walk
from sweep.core.parameters import choice, parameters, quantity
from sweep.models.obstacles.plane import Plane

@parameters
class Ramp(Plane):
    kind: str = choice("ramp", "ramp")
    slope: float = quantity(0.05, "rad", at_least=0, at_most=1)  # rises ahead

@parameters
class Stroll(Walk):
    kind: str = choice("stroll", "stroll")
    half_step_ratio: float = quantity(0.04, "a_r", above=0)  # short steps

OBSTACLES = {"ramp": Ramp}
MANOEUVRES = {"stroll": Stroll}
"""


@pytest.fixture(autouse=True)
def home(fake_engine, monkeypatch, tmp_path, request):
    """A new project, in which the test is; what its module adds is forgotten."""
    assert main(["init", str(tmp_path / "lab")]) == 0
    monkeypatch.chdir(tmp_path / "lab")
    monkeypatch.setattr(sys, "path", [*sys.path])
    for group, kinds in list(CLASSES_BY_KIND.items()):
        monkeypatch.setitem(CLASSES_BY_KIND, group, dict(kinds))
    yield tmp_path / "lab"
    provenance.code_version.cache_clear()
    project._imported.cache_clear()
    sys.modules.pop("own", None)


def write(path, text):
    path.parent.mkdir(exist_ok=True)
    path.write_text(text, errors="surrogateescape")
    return path


def test_a_new_project_has_a_study_that_runs_and_is_never_overwritten(home, capsys):
    exp = compose(["study=first"])
    assert (exp.study.name, exp.study.design.num, exp.case.robot.shin) == ("first", 32, 0.402)
    assert {axis.side for axis in exp.study.axes} == {"world", "both"}
    assert main(["run", "study=first"]) == 0
    assert len(sweep.load("results/first")) == 32
    assert main(["init", "."]) == 2
    assert "is there already" in capsys.readouterr().err
    assert main(["init", "my lab"]) == 0
    assert "next: cd 'my lab'; " in capsys.readouterr().out
    (home / "my lab/sweep.yaml").unlink()  # as where the disk was full
    assert main(["init", "my lab"]) == 0
    assert (home / "my lab/sweep.yaml").read_text() == (home / "sweep.yaml").read_text()
    (home / "my lab/sweep.yaml").unlink()
    (home / "my lab/studies/first.yaml").write_text("# mine")
    assert main(["init", "my lab"]) == 2
    assert "my lab/studies/first.yaml is there already" in capsys.readouterr().err
    assert "results/" in (home / ".gitignore").read_text().split()


def test_a_study_is_a_plain_file_wherever_it_lies(home, monkeypatch):
    axes = "study: {axes: {f: {path: contact.friction, side: world, values: [0.2, 1]}}}\n"
    write(home / "studies/tall.yaml", f"# High\nscenario: pole_climb\nobstacle: {{height: 3.5}}\n{axes}")
    exp = compose(["study=tall"])
    assert (exp.scenario, exp.study.name, exp.case.obstacle.height) == ("pole_climb", "tall", 3.5)
    assert exp.study.axes[0].side == "world"  # which YAML reads as true
    write(home / "else/mine.yaml", f"robot: {{extends: long_legs, thigh: 0.6}}\n{axes}")
    for path in ("else/mine.yaml", "./else/mine.yaml", str(home / "else/mine.yaml")):
        exp = compose([f"study={path}"])
        assert (exp.study.name, exp.case.robot.thigh, exp.case.robot.shin) == ("mine", 0.6, 0.402)
    assert compose(["study=else/mine.yaml", "robot=base"]).case.robot.shin == 0.335  # the command line wins
    write(home / "studies/taller.yaml", "extends: tall\nobstacle: {height: 4.0}\n")
    exp = compose(["study=taller"])
    assert (exp.study.name, exp.scenario, exp.case.obstacle.height, len(exp.study.axes)) == (
        "taller", "pole_climb", 4.0, 1)  # fmt: skip
    monkeypatch.chdir(home / "else")
    assert compose(["study=../else/mine.yaml"]).case.robot.shin == 0.402  # the project is found from below


@pytest.mark.parametrize(
    ("text", "named"),
    [
        ("scenario: pole_clmb\n", "scenario = pole_clmb is unknown: did you mean pole_climb?"),
        ("extends: wlak_map\n", "study = wlak_map is unknown: did you mean walk_map?"),
        ("study: {axis: {}}\n", "study.axis is unknown: did you mean axes?"),
        ("study: [\n", "cannot be read: line 2"),
        ("just words\n", "just words is unknown (allowed: "),
        ("study: 3\n", "study = 3 is not allowed"),
        ("robot: 3\n", "bad.yaml: robot = 3 is not allowed: the name of a choice, or keys and values"),
        ("study: {axes: {1: {path: contact.friction, values: [1]}}}\n", "study.axes.1 is not allowed: a name"),
        ("\udcff", "bad.yaml cannot be read: it is not text in UTF-8"),
        ("contact: {frictoin: 1}\nstudy: {name: a}\n", "contact.frictoin is unknown: did you mean friction?"),
    ],
)
def test_what_is_wrong_with_a_study_file_is_one_line(home, capsys, text, named):
    write(home / "bad.yaml", text)
    assert main(["run", "study=bad.yaml"]) == 2
    one_line(capsys.readouterr().err, named)
    assert main(["run", "study=none.yaml"]) == 2
    assert "study = none.yaml is not a file" in capsys.readouterr().err


@pytest.mark.parametrize(("folder", "option"), [("studies", "study"), ("robots", "robot")])
def test_files_that_extend_each_other_in_a_ring_are_refused(home, capsys, folder, option):
    for name, above in (("a", "b"), ("b", "c"), ("c", "b")):
        write(home / folder / f"{name}.yaml", f"extends: {above}\n")
    assert main(["run", f"{option}=a"]) == 2
    one_line(capsys.readouterr().err, "b.yaml extends ", "c.yaml extends ")


def test_every_group_is_listed_completed_chosen_once_and_has_a_folder(home, capsys):
    """One table of groups: none of them is less than another."""
    assert {name for name, group in GROUPS.items() if group.in_case} == {f.name for f in dataclasses.fields(Case)}
    assert main(["list"]) == 0
    listed = capsys.readouterr().out.splitlines()
    assert main(["completion", "--line", "sweep run "]) == 0
    completed = capsys.readouterr().out.splitlines()
    for group in GROUPS:
        assert f"{group}=" in listed
        assert f"{group}=" in completed
        assert main(["run", f"{group}=a", f"{group}=b"]) == 2
        assert f"{group} is chosen twice" in capsys.readouterr().err
    write(home / "controls/mine.yaml", "# By touch alone\ntouch: obstacle\n")
    write(home / "studies/by_touch.yaml", "scenario: ladder_climb\ncontrol: mine\n")
    assert compose(["control=mine"]).case.control.touch == "obstacle"
    assert compose(["study=by_touch"]).case.control.touch == "obstacle"
    assert main(["list"]) == 0
    assert "mine                 By touch alone" in capsys.readouterr().out


def test_lists_and_completion_show_what_is_ones_own_apart(capsys, home):
    capsys.readouterr()
    assert main(["list"]) == 0
    shipped, own = capsys.readouterr().out.split("of this project")
    assert "long_legs" not in shipped
    assert own.split()[2:4] == ["study=", "first"]
    assert "long_legs            The base robot with shins longer by a fifth" in own
    for line, wanted in (
        ("sweep run study=fi", "first"),
        ("sweep run robot=lo", "long_legs"),
        ("sweep des", "describe"),
        ("sweep run --dry", "--dry-run"),
        ("sweep run scena", "scenario="),
    ):
        assert main(["completion", "--line", line]) == 0
        assert capsys.readouterr().out.split() == [wanted]
    (odd := home / "results/a b$").mkdir(parents=True)
    (odd / "study.yaml").touch()
    assert main(["completion", "--line", "sweep table res"]) == 0
    assert capsys.readouterr().out == "results/a\\ b\\$\n"
    code = "import sys; from sweep.cli.main import main; main(['completion', '--line', 'sweep run study=']); "
    code += "print(sys.modules.keys() & {'mujoco', 'hydra', 'jax', 'pandas'})"
    out = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    assert out.endswith("set()\n")


def test_a_list_fits_two_screens_and_takes_a_group_and_words(home, capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")
    monkeypatch.chdir(home.parent)
    capsys.readouterr()
    assert main(["list"]) == 0
    whole = capsys.readouterr().out.splitlines()
    assert len(whole) <= 80
    assert max(map(len, whole[:-1])) <= 80
    assert main(["list", "study", "MAP", "pole"]) == 0
    group, *lines = capsys.readouterr().out.splitlines()
    assert group == "study="
    assert [line.split()[0] for line in lines] == ["pole_map", "pole_torque_map"]
    assert main(["list", "raft"]) == 0
    assert "obstacle=" in capsys.readouterr().out
    for words in (["study", "nonsense"], ["nonsense"]):
        assert main(["list", *words]) == 2
        one_line(capsys.readouterr().err, "nonsense", "`sweep list` shows the groups")


def test_obstacles_and_manoeuvres_of_ones_own_are_simulated(home, capsys, monkeypatch):
    before = provenance.code_version()
    write(home / "own.py", OWN)
    write(home / "sweep.yaml", "modules: [own]\n")
    write(home / "obstacles/ramp.yaml", "# A gentle ramp\nkind: ramp\nslope: 0.1\n")
    write(home / "manoeuvres/stroll.yaml", "kind: stroll\n")
    provenance.code_version.cache_clear()
    with warnings.catch_warnings(action="error"):  # Hydra's, of a file that is called as its kind
        exp = compose(["obstacle=ramp", "manoeuvre=stroll"])
    assert (exp.case.obstacle.kind, exp.case.obstacle.slope) == ("ramp", 0.1)
    assert exp.case.manoeuvre.plan(exp.case).duration.sum() > 1
    assert provenance.code_version() != before  # rows are told apart by what simulated them
    assert main(["describe", "obstacle=ramp"]) == 0
    assert "rises ahead" in capsys.readouterr().out
    with pytest.raises(InputError, match=r"obstacle\.slope = 2 is not allowed: at least 0 and at most 1 rad"):
        compose(["obstacle=ramp", "obstacle.slope=2"])
    for text, named in (("modules: [nowhere]", "module nowhere cannot be imported: ModuleNotFoundError"),
                        ("\udcff", "sweep.yaml cannot be read: it is not text in UTF-8"),
                        ("moduls: [own]", "moduls is unknown"), ("modules: own", "a list of names")):  # fmt: skip
        write(home / "sweep.yaml", text)
        with pytest.raises(InputError, match=named):
            compose([])


STEP = """from sweep.core.parameters import choice, parameters, quantity
from sweep.models.obstacles.charts import Chart, point_ahead
from sweep.models.obstacles.plane import Plane

AHEAD = (0.0, 1.0)


@parameters
class Step(Plane):
    kind: str = choice("step", "step")
    charts = {"floor": Chart(("aside", "ahead"), lambda of, side, unit, depth, x, y: point_ahead(AHEAD, x, y, 0.0))}

    def surface(self, points, owner, bodies):
        found = super().surface(points, owner, bodies)
        return found


OBSTACLES = {"step": Step}
"""


@pytest.mark.parametrize(
    ("old", "new", "told"),
    [
        ("return found", "exit()", "obstacle.kind = step is not allowed: surface fails: SystemExit"),
        ("return found", "pass", "surface gives NoneType: a Surface is wanted"),
        (
            "return found",
            "return found._replace(depth=points)",
            "surface gives depth (2, 3) of 2 points: (2,) is wanted",
        ),
        ("depth, x, y: p", "depth, x: p", "chart floor fails: TypeError: "),
        ("point_ahead(AHEAD, x, y, 0.0)", "x", "chart floor gives (): (3,) is wanted"),
        (
            "return found",
            "return found\n    def solids(self, bodies): return [3]",
            "solids gives [3]: a tuple of solids",
        ),
        ("@parameters\n", "", "not a class with @parameters and a field `kind`"),
        ("(Plane)", "", "module own: obstacle step has no solids"),
        ('{"step": Step}', "[Step]", "OBSTACLES = [<class 'own.Step'>] is not allowed: classes by kind"),
        (
            "return found",
            "return found\n    @property\n    def free_bodies(self): exit()",
            "own.py, line 17, fails: SystemExit",
        ),
    ],
)
def test_what_is_wrong_with_an_obstacle_of_ones_own_is_one_line(home, capsys, old, new, told):
    write(home / "own.py", STEP.replace(old, new))
    write(home / "sweep.yaml", "modules: [own]\n")
    assert main(["run", "obstacle=step"]) == 2
    one_line(capsys.readouterr().err, told)


def test_no_parameter_is_explained_by_a_symbol_alone():
    for group, classes in reference.classes_by_group().items():
        for cls in classes:
            for line in reference.parameter_rows(cls):
                short = len(line["meaning"].split()) < 3
                assert not short, (group, line)


def test_parameters_are_described_where_they_are_defined(capsys):
    assert main(["describe", "drive.torque_limit"]) == 0
    told = capsys.readouterr().out
    assert all(part in told for part in ("default: 150", "unit: N·m", "greater than 0 N·m", "(monograph 1.2.1)"))
    assert main(["describe"]) == 0
    page = capsys.readouterr().out
    assert all(f"## {group}" in page for group in CLASSES_BY_KIND)
    assert page.count("| thigh ") == 1
    assert main(["describe", "drive.torque"]) == 2
    assert "did you mean torque_limit?" in capsys.readouterr().err

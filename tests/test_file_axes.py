"""Models and controllers as axes: rows of each, their identity, resume, relabel, comparison, and mistakes."""

from pathlib import Path

import pytest
from own_rollouts import write_texts
from small_study import one_line

from sweep.cli.main import main
from sweep.report import crate
from sweep.runs import store

GRAVITY = 9.81
MODEL = f"""<mujoco><option timestep="0.002" integrator="Euler" gravity="0 0 -{GRAVITY}"/>
<worldbody>
  <geom name="floor" type="plane" size="5 5 1"/>
  <body name="ball" pos="0 0 HEIGHT"><freejoint/><geom name="ball" size="0.1" mass="1"/></body>
  <body name="cart" pos="0 3 3"><joint name="rail" type="slide" axis="1 0 0"/><geom size="0.1" mass="MASS"/></body>
</worldbody>
<actuator><motor name="pull" joint="rail"/></actuator>
</mujoco>"""
POLICY = """import jax.numpy as jnp
PARAMETERS = {"force": FORCE}
FIGURES = {"pulled": "force at the end"}
def policy(belief, seen, state, key): return belief["force"] * jnp.ones(1), state
def figures(belief, state): return {"pulled": belief["force"]}
"""
BARE = """import jax.numpy as jnp
def policy(belief, seen, state, key): return 3.0 * jnp.ones(1), state
"""
STUDY = """system: mujoco
model: {mjcf: worlds/low.xml, controller: "gentle:policy", duration: 0.2}
outcome: {down: base_height_min_m < 0.9}
study:
  axes:
    world: {path: model.mjcf, values: [worlds/low.xml, worlds/high.xml]}
    pilot: {path: model.controller, values: ["gentle:policy", "bare:policy"]}
"""


@pytest.fixture
def here(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    write_texts(
        {
            "worlds/low.xml": MODEL.replace("HEIGHT", "1").replace("MASS", "1"),
            "worlds/high.xml": MODEL.replace("HEIGHT", "2").replace("MASS", "2"),
            "gentle.py": POLICY.replace("FORCE", "1.0"),
            "bare.py": BARE,
            "one.yaml": STUDY,
        }
    )
    return tmp_path


def test_rows_are_those_of_each_model_with_each_controller(here, capsys):
    assert main(["run", "study=one.yaml", "out=all", "--limit", "2"]) == 0
    assert main(["run", "study=one.yaml", "out=all"]) == 0
    rows = store.read_rows(Path("all"))
    assert len(rows) == 4
    assert rows["point_id"].nunique() == 4
    assert rows.groupby("model.mjcf")["group"].nunique().to_dict() == {"worlds/high.xml": 2, "worlds/low.xml": 2}
    for row in rows.to_dict("records"):
        height = mass = 2 if row["model.mjcf"] == "worlds/high.xml" else 1
        force, has_column = {"gentle:policy": (1.0, True), "bare:policy": (3.0, False)}[row["model.controller"]]
        assert row["base_height_min_m"] == pytest.approx(height - GRAVITY * 0.2**2 / 2, abs=3e-3)
        assert row["energy_j"] == pytest.approx((force * 0.2) ** 2 / mass / 2, rel=0.02)
        assert (row["pulled"] == force) == has_column  # the scenario's controller has it
    capsys.readouterr()
    assert main(["replay", "all", "2"]) == 0
    assert "equal to the last bit" in capsys.readouterr().out
    assert main(["relabel", "all", "down=base_height_min_m < 1.9"]) == 0
    assert (store.read_rows(Path("all"))["cause"] == "down").all()
    assert main(["stats", "all"]) == 0
    assert main(["compare", "all", "all", "--tolerance", "0"]) == 0
    assert main(["report", "all"]) == 0
    page = Path("all/report.html").read_text()
    assert '"names":["high","low"]' in page.replace(" ", "")
    assert main(["export", "all", "--crate", "crate"]) == 0
    code = "\n".join(crate.list_code_files(Path("crate")))
    for name in ("gentle", "bare"):
        assert f"controller {name}:policy" in code
        assert f"{name}.py, SHA-256" in code


def test_a_changed_file_of_an_axis_is_another_study(here, capsys):
    assert main(["run", "study=one.yaml", "out=all", "--limit", "1"]) == 0
    Path("bare.py").write_text(BARE.replace("3.0", "5.0"))
    capsys.readouterr()
    assert main(["run", "study=one.yaml", "out=all"]) == 2
    one_line(capsys.readouterr().err, "holds another study: model.content is")


@pytest.mark.parametrize(("axis", "line"), [
    ("world={path: model.mjcf, values: [../low.xml]}", "model.mjcf = ../low.xml is not allowed as a value of an axis"),
    ("world={path: model.mjcf, values: [/etc/low.xml]}", "is not allowed as a value of an axis: a file within the"),
    ("world={path: model.mjcf, values: [worlds/lwo.xml]}", "'worlds/lwo.xml' is not a file: did you mean worlds/low"),
    ("world={path: model.mjcf, side: world, values: [worlds/low.xml]}", "a file belongs to both sides"),
    ("pilot={path: model.controller, values: ['gentle:polcy']}", "polcy is unknown: did you mean policy?"),
    ("pilot={path: model.controller, values: ['os:system']}", "os is a module of Python itself"),
    ("pilot={path: controller.force, values: [1, 2]}", "(with model.mjcf = worlds/low.xml, model.contr"),
])  # fmt: skip
def test_a_file_that_cannot_be_is_one_line(here, capsys, axis, line):
    world = "~study.axes.pilot" if axis.startswith("world") else "~study.axes.world"
    more = "    {}: {}\n".format(*axis.replace("pilot=", "other=").split("=", 1)) if "force" in axis else ""
    Path("one.yaml").write_text(STUDY + more)
    asked = [] if more else [f"study.axes.{axis.partition('=')[0]}={axis.partition('=')[2]}", world]
    assert main(["run", "study=one.yaml", *asked, "out=wrong"]) == 2
    one_line(capsys.readouterr().err, line)

"""What controllers of users observe: the state of the tick, and sensors of the same state where that is asked for."""

from pathlib import Path

import pytest

from sweep.cli.main import main
from sweep.runs import store

MODEL = """<mujoco><option timestep="0.005"/><worldbody><body name="ball" pos="0 0 0.3">
<joint name="z" type="slide" axis="0 0 1"/><geom size="0.1"/></body></worldbody><actuator><motor joint="z"/></actuator>
<sensor><jointpos name="height" joint="z"/></sensor></mujoco>"""
CONTROLLER = """import jax.numpy as jnp
FIGURES = {"observed_late_m": "largest difference of the sensor and the position that are observed together"}
def begin(belief, key): return None, jnp.zeros(()), None
def policy(belief, seen, state, key): return jnp.zeros(1), jnp.maximum(state, jnp.abs(seen[0] - seen[1]))
def figures(belief, state): return {"observed_late_m": state}
"""
STUDY = """system: mujoco
model: {mjcf: model.xml, controller: "compares:policy", observe: [qpos, height], duration: 0.1}
outcome: {goal: duration_s > 0}
study:
  axes:
    load: {path: model.body.ball.mass, side: world, values: [1, 2]}
"""


@pytest.mark.parametrize("engine", ["native", "mjx"])
def test_sensors_are_of_the_observed_state_where_they_are_current(engine, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for name, text in {"model.xml": MODEL, "compares.py": CONTROLLER, "study.yaml": STUDY}.items():
        Path(name).write_text(text)
    run = ["run", "study=study.yaml", f"engine={engine}"]
    assert main([*run, "out=old"]) == main([*run, "+model.sensors=current", "out=new"]) == 0
    old, new = (store.read_rows(Path(name)) for name in ("old", "new"))
    assert (old["observed_late_m"] > 1e-3).all()  # 0.4 m/s for a step of 5 ms
    assert (new["observed_late_m"] < 1e-6).all()
    assert not {*old["point_id"]} & {*new["point_id"]}


def test_new_projects_observe_current_sensors(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert main(["init", "--model", "quad"]) == 0
    assert "sensors: current" in Path("quad/scenarios/own.yaml").read_text()

"""MuJoCo 3.17 and 4: the same calls, with the same results."""

import sys
from pathlib import Path

import mujoco
import numpy as np
import pytest
from mujoco.batch import MODEL_FIELDS, Batch
from small_study import one_line

from sweep.backends import mujoco_versions
from sweep.cli.main import main
from sweep.systems.mujoco_model import fields

MODEL = """<mujoco><worldbody><camera name="c" mode="trackcom"/><geom name="floor" type="plane" size="0 0 1"/>
<body name="ball" pos="0 0 1"><freejoint/><geom name="g" size=".1"/><site name="s"/></body>
<body name="arm" pos="1 0 1"><joint name="a"/><geom name="h" type="box" size=".1 .2 .3"/><site name="t"/></body>
</worldbody><tendon><spatial name="t"><site site="s"/><site site="t"/></spatial></tendon>
<actuator><motor name="m" tendon="t"/><position joint="a" kp="3"/></actuator></mujoco>"""
VARIED = {
    "model.body.ball.mass": (1.0, 2.0),
    "model.geom.h.size.x": (0.1, 0.4),
    "model.site.t.pos.x": (0.0, 0.1),
    "model.geom.g.friction.slide": (1.0, 0.5),
    "model.option.gravity.z": (-9.81, -1.6),
}
STUDY = """system: mujoco
model: {mjcf: model.xml, controller: "still:policy", duration: 0.02}
outcome: {goal: duration_s > 0}
study: {name: small}
"""
STILL = """import jax.numpy as jnp
def policy(belief, observation, state, key): return jnp.zeros(0), state
"""


@pytest.mark.parametrize("paths", [list(VARIED), ["model.geom.g.friction.slide"], []])
def test_fields_that_differ_within_a_batch_are_all_found(paths):
    spec = mujoco.MjSpec.from_string(MODEL)
    batch = Batch(spec.copy().compile(), 2)
    written = fields.write_batch_parameters(batch, {path: np.array(VARIED[path]) for path in paths}, lambda: spec)
    found = mujoco_versions.differing_model_fields(batch, written)
    models = [batch.get_model(k) for k in range(2)]
    for name in MODEL_FIELDS:
        rows = np.array([fields.field_values(model, name) for model in models])
        if name in found:
            np.testing.assert_array_equal(found[name], rows, err_msg=name)
        elif rows.dtype.kind == "f":
            np.testing.assert_array_equal(rows[0], rows[1], err_msg=name)
    assert {fields.resolve_parameter_path(models[0], path)[1][0].field for path in paths} <= found.keys()


@pytest.fixture
def small(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("study.yaml").write_text(STUDY)
    Path("still.py").write_text(STILL)
    return Path("model.xml")


def test_an_mjx_that_does_not_import_is_one_line(small, monkeypatch, capsys):
    small.write_text("<mujoco><worldbody><body><joint/><geom size='.1'/></body></worldbody></mujoco>")
    monkeypatch.setitem(sys.modules, "mujoco.mjx", None)  # importing it fails
    for run in (["study=study.yaml", "engine=mjx"], ["scenario=walk_tripod", "engine.dynamics=mjx"]):
        assert main(["run", *run, "out=none"]) == 2
        why = f"does not import with MuJoCo {mujoco.__version__}"
        one_line(capsys.readouterr().err, "= mjx is not allowed: mujoco-mjx", why)
    assert main(["run", "study=study.yaml", "engine=native", "out=native"]) == 0


@pytest.mark.skipif(not mujoco_versions.YIELDING_SPRING_FIELDS, reason="needs MuJoCo 4")
def test_a_spring_that_yields_is_refused_by_mjx(small, capsys):
    joint = '<joint name="j" stiffness="5" springyield="0.1"/>'
    small.write_text(f"<mujoco><worldbody><body>{joint}<geom size='.1'/></body></worldbody></mujoco>")
    assert main(["run", "study=study.yaml", "engine=mjx", "out=none"]) == 2
    one_line(capsys.readouterr().err, "MJX leaves out joint.springyield")
    assert main(["run", "study=study.yaml", "engine=native", "out=native"]) == 0

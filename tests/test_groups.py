"""Groups of numbers of a model under one path, and the strength of actuators."""

from pathlib import Path

import mujoco
import numpy as np
import pytest
from mujoco.batch import Batch
from robots import JOINTS, quadruped, save_perceptron, write_project
from small_study import one_line

from sweep.cli.main import main
from sweep.core.errors import InputError
from sweep.runs import store
from sweep.systems.mujoco_model import fields

MODEL = mujoco.MjModel.from_xml_string(quadruped())


def written(values):
    """Models (2) of a batch with values by path."""
    batch = Batch(MODEL, 2)
    fields.write_batch_parameters(batch, {path: np.array(value) for path, value in values.items()}, lambda: None)
    return [batch.get_model(k) for k in range(2)]


def test_a_group_sets_or_multiplies_the_numbers_that_its_pattern_fits():
    group, single = "model.joint.{lf,rh}_*.damping", "model.joint.lf_hip.damping"
    assert fields.group_members(MODEL, group) == [f"model.joint.{one}.damping" for one in JOINTS if one[:2] in "lf rh"]
    assert fields.parameter_field(MODEL, group).default == 0.2
    assert fields.parameter_field(MODEL, group).metadata["unit"] == "6 numbers"
    assert fields.parameter_field(MODEL, "model.geom.*_foot.friction.slide").metadata["unit"] == "4 numbers"
    assert fields.parameter_field(MODEL, "model.body.*_hip.mass").metadata["unit"] == "kg, 4 numbers"
    for path, values, expected in (
        (group, [0.3, 0.5], [0.3, 0.5]),
        (f"{group}.relative", [1.0, 2.0], [0.2, 0.4]),
    ):
        for model, value in zip(written({single: [7.0, 8.0], path: values}), expected, strict=True):
            found = {name: model.dof_damping[model.joint(name).dofadr[0]] for name in JOINTS}
            assert found.pop("lf_hip") in (7.0, 8.0)  # a single path replaces the group's value
            for name, one in found.items():
                assert one == pytest.approx(value if name[:2] in "lf rh" else 0.2), name


def test_numbers_of_a_group_that_differ_are_multiplied_only():
    with pytest.raises(InputError, match=r"no nominal value, \d+ numbers from 0.2 to 8 differ: multiply them by"):
        fields.parameter_field(MODEL, "model.body.*.mass")
    with pytest.raises(InputError, match="names nothing: no joint fits toe_"):
        fields.parameter_field(MODEL, "model.joint.toe_*.damping")
    assert fields.parameter_field(MODEL, "model.body.*.mass.relative").default == 1.0


def test_strength_multiplies_the_force_of_actuators_at_and_below_their_limit():
    models = written({"model.actuator.*.strength": [1.0, 0.5], "model.actuator.lf_hip.kp": [200.0, 100.0]})
    for target in (0.01, 3.0):
        forces = []
        for model in models:
            data = mujoco.MjData(model)
            data.ctrl[:] = target
            mujoco.mj_forward(model, data)
            forces.append(data.actuator_force.copy())
        full, half = forces
        assert (full > 0).all()
        share = np.full(12, 0.5)
        share[list(JOINTS).index("lf_hip")] = 0.25 if target < 1 else 0.5  # half of half the gain; at the limit half
        np.testing.assert_allclose(half, share * full)


def test_a_group_is_an_axis_whose_note_counts_its_numbers(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    write_project(tmp_path, "preset: playground", more="")
    save_perceptron("walk.onnx", (48, 12))
    axis = "study.axes.load={path: 'model.actuator.*.strength', side: world, values: [0.5, 1.0]}"
    assert main(["run", "study=one", axis, "model.duration=0.2", "out=groups"]) == 0
    assert "model.actuator.*.strength moves 12 numbers" in capsys.readouterr().err
    rows = store.read_rows(Path("groups")).set_index("world.model.actuator.*.strength")
    assert rows.loc[0.5, "base_height_min_m"] < rows.loc[1.0, "base_height_min_m"]
    assert main(["run", "study=one", axis.replace("*", "toe_*"), "out=wrong"]) == 2
    one_line(capsys.readouterr().err, "no actuator fits toe_*")

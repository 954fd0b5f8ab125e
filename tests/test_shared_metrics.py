"""Shared metrics: one definition, computed for the built-in robot and for MuJoCo models."""

from types import SimpleNamespace

import numpy as np
import pytest
from simple_motion import MASS, MODEL, Motion, columns_by_system

from sweep import metrics
from sweep.core import shared_metrics
from sweep.core.constants import GRAVITY
from sweep.core.metric import EVERY_COLUMN, Metric, compute_columns, select_metrics
from sweep.systems.mujoco_model import metrics as model_metrics
from sweep.systems.mujoco_model.accumulator import MetricAccumulator
from sweep.systems.mujoco_model.tick import ModelRollout

SHARED = tuple(shared_metrics.METRICS.values())
COUNT, PERIOD = 50, 0.02
TIME = PERIOD * (1 + np.arange(COUNT))  # to 1 s
PITCH = 0.3 * np.sin(np.pi * TIME)
WAY = np.stack([0.4 * TIME, 0.3 * TIME, 0.5 - 0.1 * np.sin(np.pi * TIME)], axis=1)
MOTION = Motion(
    PERIOD,
    position=WAY,
    pitch=PITCH,
    joint_rate=np.where(TIME < 0.5, -2.0, 1.5),
    torque=np.where(TIME < 0.5, -3.0, 2.5),
    foot=np.stack([np.maximum(0.05 * (TIME - 0.2), 0.0), 0 * TIME, 0 * TIME], axis=1),
    load=np.where(TIME > 0.19, 20.0, 0.0),
)
EXPECTED = {
    "duration_s": 1.0,
    "distance_m": 0.5,
    "travelled_m": 0.4,
    "speed_mps": 0.4,
    "energy_j": 24 * PERIOD * 6.0 + 26 * PERIOD * 3.75,
    "cost_of_transport": (24 * PERIOD * 6.0 + 26 * PERIOD * 3.75) / (MASS * GRAVITY * 0.4),
    "tilt_max_deg": np.degrees(0.3),
    "end_tilt_deg": 0.0,
    "joint_speed_max_radps": 2.0,
    "torque_max_nm": 3.0,
    "slip_max_m": 0.04,
    "base_height_min_m": 0.4,
    "path_length_m": np.linalg.norm(np.diff(WAY, axis=0, prepend=[[0, 0, 0.5]]), axis=1).sum(),
}


def test_a_known_motion_has_the_same_columns_in_every_system():
    found = columns_by_system(*SHARED, motion=MOTION)
    expected = next(iter(found.values())) | EXPECTED  # a metric of which nothing is expected here has a test of its own
    for system, columns in found.items():
        assert columns.keys() == expected.keys(), system
        for name, value in columns.items():
            assert value == pytest.approx(expected[name], rel=1e-4, abs=2e-4), (system, name)


def test_every_system_has_the_shared_columns():
    shared = {column for metric in SHARED for column in metric.columns}
    left_out = {column for name in metrics.OMITTED_SHARED_METRICS for column in shared_metrics.METRICS[name].columns}
    robot = [column for metric in metrics.METRICS for column in metric.columns]
    assert len(robot) == len({*robot})
    assert shared - {*robot} == left_out
    model = [column for metric in model_metrics.METRICS for column in metric.columns]
    assert len(model) == len({*model})
    assert shared <= {*model}


def test_a_metric_of_columns_is_computed_after_them_and_only_where_they_exist():
    def constant(name, value, **options):
        return Metric(lambda start: (), lambda state, ctx: state, lambda state, rollout: {name: value(rollout)},
                      {name: ""}, **options)  # fmt: skip

    double = constant("double", lambda rollout: 2 * rollout.columns["one"], reads=("one",))
    total = constant("total", lambda rollout: sum(rollout.columns.values()), reads=(EVERY_COLUMN,))
    one = constant("one", lambda rollout: 1.0)
    legs = constant("legs", lambda rollout: 6.0, needs=("legs",))
    some = select_metrics((total, double, one, legs), (), None)
    end = model_end()
    assert compute_columns(some, [()] * len(some), end) == {"one": 1.0, "double": 2.0, "total": 3.0}
    assert select_metrics((total, double, legs), ("legs",), None) == (total, legs)


def model_end():
    """A rollout of a model, of which nothing is read but columns."""
    return ModelRollout(*[None] * 8)  # pyright: ignore[reportArgumentType]


def test_what_a_rollout_does_after_its_end_changes_none_of_its_columns():
    """Also where it is not a number any more: 0 times such a number would be none either."""
    spec = SimpleNamespace(
        model=MODEL, base_qpos_address=0, config=SimpleNamespace(direction=(1.0, 0.0, 0.0), terrain=None),
        touch_sensors=lambda key: [0] if key == "feet" else [],
    )  # fmt: skip
    accumulator = MetricAccumulator(spec)
    qpos, qvel = np.tile([0.0, 0, 1, 1, 0, 0, 0, 0], (2, 1)), np.ones((2, 7))
    steps = {"qpos": qpos[:, None], "qvel": qvel[:, None], "actuator_force": np.ones((2, 1, 1)),
             "actuator_velocity": np.ones((2, 1, 1)), "sensordata": np.full((2, 1, 1), 5.0),
             "site_xpos": np.zeros((2, 1, 1, 3)), "unsolved": np.zeros((2, 1), bool)}  # fmt: skip
    wild = {name: np.full(values.shape, np.nan) for name, values in steps.items()} | {"unsolved": steps["unsolved"]}
    running = accumulator.update(accumulator.start(qpos, qvel), steps, {}, np.array([True, True]))
    ended = accumulator.update(running, wild, {}, np.array([False, True]))
    none = np.zeros(2)
    before, after = (accumulator.compute(x, none + 1, none, none > 0, none > 0) for x in (running, ended))
    assert {name: values[0] for name, values in after.items()} == {name: values[0] for name, values in before.items()}
    assert list(after["not_finite"]) == [0, 1]

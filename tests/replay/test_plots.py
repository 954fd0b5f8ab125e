"""Plots: what is on the axes, and that every format is written."""

import dataclasses

import numpy as np
import pytest

from sweep.config.experiment import compose
from sweep.core.parameters import InputError
from sweep.core.plot_style import save_figure
from sweep.models import scene
from sweep.systems.hexapod.plots import PLOTS, tilt_deg

LABELS = {
    "torques": {f"leg {leg}\ntorque (N·m)" for leg in range(1, 7)},
    "joints": {f"leg {leg}\nangle (deg)" for leg in range(1, 7)},
    "base": {"x (m)", "y (m)", "z (m)", "tilt (deg)"},
    "margin": {"margin"},
    "feet": {f"leg {leg}\nheight (m)" for leg in range(1, 7)} | {"force (N)"},
    "paths": {"y (m)", "z (m)"},
    "forces": {"N/P", "friction used", "margin to\nthe cone"},
}


def test_a_ball_is_plotted_where_there_is_one(trace):
    with pytest.raises(InputError, match="no free body"):
        PLOTS["ball"](dataclasses.replace(trace, model=scene.compile_model(compose([]).case)))
    model = scene.compile_model(compose(["scenario=ball_balance"]).case)
    time = 0.004 * np.arange(1, 501)
    qpos = np.tile(model.qpos0, (500, 1))
    qpos[:, -7] = 0.2 * time
    qpos[:, :3] = qpos[:, -7:-4] + [0.03, 0.0, 1.11]
    rolling = dataclasses.replace(trace, model=model, time=time, qpos=qpos, stage=np.zeros(500, int))
    figure = PLOTS["ball"](rolling)
    speed, way, base, centre = (ax.lines[0].get_ydata() for ax in figure.axes)
    np.testing.assert_allclose(speed, 200, rtol=1e-3)  # mm/s, to the very ends
    np.testing.assert_allclose(base, 30, rtol=1e-6)  # mm
    assert way[-1] == pytest.approx(0.2 * (time[-1] - time[0]))
    assert np.ptp(centre) < 1e-6
    assert figure.axes[0].get_ylabel() == "speed (mm/s)"


@pytest.mark.parametrize("name", LABELS)
def test_axes_say_what_they_show(name, trace):
    figure = PLOTS[name](trace)
    assert {ax.get_ylabel() for ax in figure.axes} == LABELS[name]
    assert figure.axes[-1].get_xlabel() == ("x (m)" if name == "paths" else "time (s)")


def test_forces_are_measured_against_the_surface_under_the_foot(trace):
    """A loaded foot of the trace bears 60 N on the floor and 10 N along it, of a robot of 16 kg."""
    load, used, left = (ax.lines[0].get_ydata() for ax in PLOTS["forces"](trace).axes)
    assert load.max() == pytest.approx(60 / (16 * 9.81), rel=1e-3)
    assert np.nanmax(used) == pytest.approx(1 / 6, rel=1e-3)
    assert left.min() == pytest.approx(trace.world.contact.friction - 1 / 6, rel=1e-3)


@pytest.mark.parametrize("suffix", ["png", "svg", "pdf"])
def test_files_are_written(suffix, trace, tmp_path):
    save_figure(PLOTS["base"](trace), tmp_path / f"base.{suffix}")
    assert (tmp_path / f"base.{suffix}").stat().st_size > 5000


def test_stages_are_marked_and_named(trace):
    ax = PLOTS["base"](trace).axes[0]
    marked = [np.asarray(line.get_xdata()) for line in ax.lines]
    starts = [float(x[0]) for x in marked if len(x) == 2]
    np.testing.assert_allclose(starts, [0.504, 0.752], atol=1e-9)
    (names,) = ax.child_axes
    assert [label.get_text() for label in names.get_xticklabels()] == list(trace.stages)


def test_many_stages_are_named_too(trace):
    many = dataclasses.replace(trace, stage=np.arange(250) // 10, stages=tuple(f"swing{k}" for k in range(25)))
    (names,) = PLOTS["base"](many).axes[0].child_axes
    labels = names.get_xticklabels()
    assert [label.get_text() for label in labels] == list(many.stages)
    assert {label.get_rotation() for label in labels} == {90}


def test_torques_are_also_in_the_unit_of_the_monograph(trace):
    ax = PLOTS["torques"](trace).axes[1]
    ax.set_ylim(0, 150.4)
    (scaled,) = (child for child in ax.child_axes if child.yaxis.get_ticks_position() == "right")
    scaled.figure.draw_without_rendering()
    np.testing.assert_allclose(scaled.get_ylim(), [0, 2], atol=1e-9)


def test_curves_are_the_trace(trace):
    target, actual = PLOTS["base"](trace).axes[0].lines[:2]
    np.testing.assert_array_equal(actual.get_ydata(), trace.qpos[:, 7])
    np.testing.assert_array_equal(target.get_ydata(), trace.base_target[:, 0])


@pytest.mark.parametrize("name", ["torques", "feet"])
def test_a_peak_in_the_last_leg_is_not_cut_off(name, trace):
    torque, force = trace.joint_torque.copy(), trace.foot_force.copy()
    torque[50, 17], force[50, 5] = 99.0, [0.0, 0.0, 999.0]
    figure = PLOTS[name](dataclasses.replace(trace, joint_torque=torque, foot_force=force))
    for ax in figure.axes:
        curves = [y for line in ax.lines if len(y := np.asarray(line.get_ydata())) > 2]  # not the stage marks
        assert max(y.max() for y in curves) <= ax.get_ylim()[1]


def test_tilt_of_a_turned_base():
    angle = np.radians([0, 30, 90])
    pose = np.zeros((3, 7))
    pose[:, 3], pose[:, 4] = np.cos(angle / 2), np.sin(angle / 2)
    np.testing.assert_allclose(tilt_deg(pose), [0, 30, 90], atol=1e-6)


def test_a_broken_simulation_leaves_a_gap(trace, tmp_path):
    qpos = trace.qpos.copy()
    qpos[100:] = np.nan
    broken = dataclasses.replace(trace, qpos=qpos)
    for name in ("base", "joints"):
        save_figure(PLOTS[name](broken), tmp_path / f"{name}.svg")

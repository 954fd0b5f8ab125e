"""Successes with random parameters, judged again by plain MuJoCo and NumPy from their recorded states alone."""

import dataclasses

import mujoco
import numpy as np
import pytest

from sweep.config.experiment import compose
from sweep.core.constants import GRAVITY
from sweep.engines import make_engine
from sweep.metrics.outcome import classify
from sweep.models.robot import total_mass
from sweep.models.scene import compile_native_model

pytestmark = pytest.mark.slow
ROWS, NOMINAL_SHARE, SPREAD = 48, 0.7, 0.25
SCENARIOS = ("walk_tripod", "walk_kerb", "walk_slope", "pole_climb")
LOADED_N, LANDING_TICKS = 5.0, 3  # force on a foot that stands; ticks after which it stands, and before it leaves
INSIDE_M = 0.007  # by which links may seem to be inside: 5 mm, and what two ways of measuring differ by
WEIGHT_ERROR = 0.03  # of the weight, in the mean load of the last second
AWAY_M, SLIP_M = 0.05, 0.03  # of the base from where it was to end; of a foot that stands


def draw_values(case, rows, seed):
    """Values (rows,) by path of robot, contact, obstacle and manoeuvre, within bounds; most of a row are nominal."""
    random, found = np.random.default_rng(seed), {}
    for group in ("robot", "contact", "obstacle", "manoeuvre"):
        owner = getattr(case, group)
        for field in dataclasses.fields(owner):
            value, data = getattr(owner, field.name), field.metadata
            if data.get("role") == "quantity" and value:
                other = value * random.uniform(1 - SPREAD, 1 + SPREAD, rows)
                allowed = (other > data["above"]) & (other >= data["at_least"]) & (other <= data["at_most"])
                nominal = (random.random(rows) < NOMINAL_SHARE) | ~allowed
                found[f"{group}.{field.name}"] = np.where(nominal, value, other)
    return found


def find_faults(trace, limits):
    """What a success may not have, in words, from positions, velocities and forces."""
    world, faults = trace.world, []
    x, y = trace.qpos[:, 4:6].T
    tilt = np.degrees(np.arccos(np.clip(1 - 2 * (x**2 + y**2), -1, 1)))
    level = np.abs(trace.base_target[:, 4:6]).max() < 1e-3  # whose base is planned without pitch and roll
    if level and tilt.max() > limits["tilt_max_deg"] + 0.1:
        faults.append(f"tilts by {tilt.max():.1f} degrees")
    carried = trace.foot_force[trace.time > trace.time[-1] - 1.0].sum(axis=1).mean(axis=0)
    weight = float(total_mass(world.robot)) * GRAVITY
    if np.linalg.norm(carried - [0, 0, weight]) > WEIGHT_ERROR * weight:
        faults.append(f"feet carry {carried.round(1)} N of {weight:.1f}")
    if (off := np.linalg.norm(trace.qpos[-1, :3] - trace.base_target[-1, :3])) > AWAY_M:
        faults.append(f"ends {off:.3f} m from where it was to go")
    if (torque := np.abs(trace.joint_torque).max()) > 1.001 * trace.torque_limit:
        faults.append(f"drives give {torque:.1f} of {trace.torque_limit:.1f} N m")
    force = np.linalg.norm(trace.foot_force, axis=-1)
    for leg in range(trace.foot_position.shape[1]):
        stands = np.flatnonzero(force[:, leg] > LOADED_N)
        for run in np.split(stands, np.flatnonzero(np.diff(stands) > 1) + 1):
            place = trace.foot_position[run[LANDING_TICKS:-LANDING_TICKS], leg]
            if len(place) and (slip := np.linalg.norm(place - place[0], axis=-1).max()) > SLIP_M:
                faults.append(f"foot {leg + 1} slips by {slip:.3f} m")
                break
    depth, pair = find_deepest_contact(world, trace.qpos)
    if depth > INSIDE_M:
        faults.append(f"{pair[0]} is {1e3 * depth:.1f} mm inside {pair[1]}")
    return faults


def find_deepest_contact(world, states):
    """How deep (m) a link or the base is in anything else in the recorded states, and in what, by C MuJoCo."""
    model = compile_native_model(world, 1e-3, solid=True)
    data, depth, pair = mujoco.MjData(model), 0.0, []
    for qpos in states:
        data.qpos[: len(qpos)] = qpos
        mujoco.mj_forward(model, data)
        for contact in data.contact[: data.ncon]:
            names = [model.geom(int(geom)).name for geom in contact.geom]
            if not any(name.startswith("foot") for name in names) and -contact.dist > depth:
                depth, pair = -contact.dist, names
    return depth, pair


@pytest.mark.parametrize("name", SCENARIOS)
def test_no_success_of_random_parameters_is_false(name):
    exp = compose([f"scenario={name}"])
    world, belief = exp.system.make_world_and_belief(draw_values(exp.case, ROWS, seed=7600))
    engine = make_engine(dataclasses.replace(exp.settings, width=ROWS), exp.case, exp.case, exp.thresholds)
    traces = engine.traces(world, belief, np.zeros(ROWS, int), 1)
    figures = {key: np.array([trace.metrics[key] for trace in traces]) for key in traces[0].metrics}
    outcome = classify(figures, exp.thresholds, engine.stages)["outcome"]
    successes = np.flatnonzero(outcome == "success")
    assert 0.1 * ROWS < len(successes) < ROWS  # draws say something
    limits = exp.system.thresholds(exp.thresholds)
    assert not {int(k): found for k in successes if (found := find_faults(traces[k], limits))}


def test_a_false_success_is_found():
    """A robot whose base is lowered by 0.2 m in the recorded states has its links in the ground, and is not where
    it was to go."""
    exp = compose(["scenario=walk_tripod"])
    engine = make_engine(dataclasses.replace(exp.settings, width=1), exp.case, exp.case, exp.thresholds)
    trace = engine.traces(exp.case, exp.case, np.zeros(1, int), 25)[0]
    limits = exp.system.thresholds(exp.thresholds)
    assert not find_faults(trace, limits)
    low = dataclasses.replace(trace, qpos=trace.qpos - np.eye(trace.qpos.shape[1])[2] * 0.2)
    assert [word for fault in find_faults(low, limits) for word in ("ends", "inside") if word in fault] == [
        "ends",
        "inside",
    ]

"""Initial states, payloads and motors of own models against mechanics, on both engines."""

from pathlib import Path

import numpy as np
import pytest
from own_rollouts import prepare_batch, write_texts
from small_study import one_line

from sweep.cli.main import main
from sweep.runs import store

STEP, PERIOD = 0.002, 0.02
SIZE, MASS = np.array([0.1, 0.2, 0.3]), 2.0  # half sizes and mass of the box
MODEL = f"""<mujoco><option timestep="{STEP}" gravity="0 0 0" integrator="Euler"/>
<worldbody>
  <body name="box" pos="0 0 1" quat="0.8 0 0.6 0"><freejoint/>
    <geom type="box" size="{SIZE[0]} {SIZE[1]} {SIZE[2]}" mass="{MASS}"/></body>
  <body name="wheel" pos="0 2 1"><joint name="axle" axis="0 0 1"/>
    <geom size="0.1" mass="1"/><inertial pos="0 0 0" mass="1" diaginertia="0.01 0.01 0.01"/></body>
  <body name="arm" pos="0 4 1"><joint name="elbow" axis="0 1 0" range="-20 20" limited="true"/>
    <geom size="0.1" mass="1"/></body>
</worldbody>
<actuator><motor name="spin" joint="axle" gear="2"/><position name="hold" joint="elbow" kp="0.1"/></actuator>
</mujoco>"""
CONTROL = """import jax.numpy as jnp
def policy(belief, seen, state, key): return jnp.array([3.0, 0.0]), state
"""
STUDY = """system: mujoco
model: {{mjcf: model.xml, controller: "full:policy", duration: 0.5, observe: [qpos]}}
{more}
outcome: {{far: travelled_m > 9}}
study: {{axes: {{a: {axis}}}}}
"""
ENGINES = pytest.mark.parametrize("engine", ["native", pytest.param("mjx", marks=pytest.mark.slow)])


@pytest.fixture
def here(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    write_texts({"model.xml": MODEL, "full.py": CONTROL})
    return tmp_path


def simulate(engine, axis, more="", *words):
    """Traces and metrics of a study on an engine, in double precision."""
    Path("one.yaml").write_text(STUDY.format(axis=axis, more=more))
    made, batch = prepare_batch(f"engine={engine}", "engine.precision=float64", *words, cross_check=False)
    return made.traces(*batch, 1), made.run(*batch)


@ENGINES
def test_a_body_starts_with_the_pose_and_the_velocity_that_it_is_given(here, engine):
    more = "start: {x: 0.5, yaw: 1.2, velocity_y: 0.4, height: 0.3, joint: {axle: {position: 0.7}}}"
    traces, found = simulate(engine, "{path: start.velocity_x, values: [0.0, 2.0]}", more)
    for speed, trace in zip((0.0, 2.0), traces, strict=True):
        moved = np.outer(trace.time, [speed, 0.4, 0.0]) + np.array([0.5, 0.0, 1.3])
        np.testing.assert_allclose(trace.qpos[:, :3], moved, atol=1e-9)
        turned = np.array([0.8 * np.cos(0.6), -0.6 * np.sin(0.6), 0.6 * np.cos(0.6), 0.8 * np.sin(0.6)])
        np.testing.assert_allclose(np.abs(trace.qpos[-1, 3:7]), np.abs(turned), atol=1e-9)
        assert trace.qpos[0, 7] > 0.7
    assert np.ptp(found["energy_gained_j"]) < 1e-6  # the energy of the start is no gain


def test_random_states_lie_in_their_bounds_and_belong_to_the_row(here):
    more = "start: {random: {yaw_rate: 3.0, joint_positions: 0.5, velocity_x: 1.0}}"
    words = ["study.replicates=24", "model.duration=0.02", "model.option.timestep=0.02"]
    traces, _ = simulate("native", "{path: start.velocity_z, values: [0.2]}", more, *words)
    speeds = np.stack([one.qvel[0] for one in traces])
    for dof, size in ((0, 1.0), (5, 3.0)):
        assert np.abs(speeds[:, dof]).max() <= size
        assert speeds[:, dof].min() < -0.6 * size
        assert speeds[:, dof].max() > 0.6 * size
    np.testing.assert_allclose(speeds[:, 2], 0.2, atol=1e-12)
    elbows = np.array([one.qpos[0, 8] for one in traces])
    assert 0.3 < np.abs(elbows).max() <= np.radians(20) + 0.01  # within the joint's range
    for width in (5, 24):
        assert main(["run", "study=one.yaml", *words, f"engine.width={width}", f"out=w{width}"]) == 0
    assert main(["compare", "w5", "w24", "--tolerance", "0"]) == 0
    assert store.read_rows(Path("w5"))["travelled_m"].nunique() > 12


@ENGINES
def test_a_payload_adds_its_mass_and_its_inertia_about_the_common_centre(here, engine):
    """A free body that is pushed beside its centre of mass turns by the parallel-axis theorem's inertia."""
    load, place, radius, force = 1.5, np.array([0.2, -0.1, 0.4]), 0.05, 1e-3
    Path("model.xml").write_text(MODEL.replace(' quat="0.8 0 0.6 0"', ""))
    more = (
        "payload: {bag: {body: box, x: 0.2, y: -0.1, z: 0.4, radius: 0.05}}\n"
        f"push: {{kick: {{body: box, force: {force}, start: 0, length: 9, direction: 0.5}}}}"
    )
    traces, found = simulate(engine, "{path: payload.bag.mass, values: [0.0, 1.5]}", more)
    own = MASS / 3 * (np.diag(np.full(3, (SIZE**2).sum())) - np.diag(SIZE**2))
    push = force * np.array([np.cos(0.5), np.sin(0.5), 0.0])
    for mass, trace in ((0.0, traces[0]), (load, traces[1])):
        centre = mass * place / (MASS + mass)
        shift, rest = centre, place - centre
        inertia = own + MASS * (shift @ shift * np.eye(3) - np.outer(shift, shift))
        inertia += mass * (rest @ rest * np.eye(3) - np.outer(rest, rest)) + 0.4 * mass * radius**2 * np.eye(3)
        spin = np.linalg.solve(inertia, np.cross(-centre, push))
        linear = push / (MASS + mass) + np.cross(spin, -centre)
        np.testing.assert_allclose(trace.qvel[-1, :3] / 0.5, linear, rtol=1e-3, atol=1e-9)
        np.testing.assert_allclose(trace.qvel[-1, 3:6] / 0.5, spin, rtol=1e-3, atol=1e-9)
    assert np.ptp(found["energy_gained_j"]) < 1e-6  # the push moves both by its work alone


@ENGINES
def test_a_motor_follows_its_line_of_torque_and_speed(here, engine):
    """The wheel's speed approaches the no-load speed exponentially; the servo's torque stays below its limit."""
    stall, idle, inertia = 0.4, 20.0, 0.01
    more = (
        f"motor: {{wheel: {{joints: axle, stall_torque: {stall}, no_load_speed: {idle}}}, "
        "arm: {joints: elbow, stall_torque: 0.02, no_load_speed: 50}}\n"
        "start: {joint: {elbow: {position: 0.3}}}"
    )
    traces, _ = simulate(engine, "{path: motor.wheel.strength, values: [1.0, 0.5]}", more)
    for strength, trace in zip((1.0, 0.5), traces, strict=True):
        rate = strength * stall / idle / inertia
        steps = np.round(trace.time / STEP)
        np.testing.assert_allclose(trace.qvel[:, 6], idle * (1 - (1 - rate * STEP) ** steps), atol=1e-6)
        np.testing.assert_allclose(trace.joint_torque[0, -1], -0.02, rtol=0.02)


@pytest.mark.parametrize(("more", "line"), [
    ("start: {yaww: 1}", "start.yaww is unknown: did you mean start.yaw?"),
    ("start: {random: {yaw: -1}}", "start.random.yaw = -1 is not allowed: at least 0 rad"),
    ("start: {joint: {axel: {position: 1}}}", "start.joint.axel.position is unknown"),
    ("payload: {bag: {mass: 1}}", "payload.bag needs the key body"),
    ("payload: {bag: {body: boxx}}", "payload.bag.body: boxx is unknown: did you mean box?"),
    ("payload: {bag: {body: box, mass: -1}}", "payload.bag.mass = -1 is not allowed: at least 0 kg"),
    ("motor: {m: {joints: '*', stall_torque: 1}}", "motor.m needs the key no_load_speed"),
    ("motor: {m: {joints: leg, stall_torque: 1, no_load_speed: 2}}", "motor.m.joints = leg fits no joint"),
    ("motor: {m: {joints: axle, stall_torque: 0, no_load_speed: 2}}", "motor.m.stall_torque = 0 is not allowed"),
])  # fmt: skip
def test_a_mistake_is_one_line(here, capsys, more, line):
    Path("one.yaml").write_text(STUDY.format(axis="{path: noise.white, values: [0]}", more=more))
    assert main(["run", "study=one.yaml", "out=wrong"]) == 2
    one_line(capsys.readouterr().err, line)

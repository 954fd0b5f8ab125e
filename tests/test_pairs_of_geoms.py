"""Friction of a pair of geoms as an axis, against mechanics."""

import pytest
from own_rollouts import prepare_batch, write_texts

GRAVITY = 9.81
MODEL = f"""<mujoco><option timestep="0.0005" integrator="Euler" cone="elliptic" gravity="0 0 -{GRAVITY}"/>
<worldbody>
  <geom name="floor" type="plane" size="9 9 1"/>
  <body name="block" pos="0 0 0.05"><freejoint/><geom name="block" type="box" size="0.1 0.1 0.05" mass="1"/></body>
  <body name="cart" pos="0 3 3"><joint name="rail" type="slide" axis="1 0 0"/><geom size="0.1" mass="1"/></body>
</worldbody>
<contact>
  <pair name="rub" geom1="block" geom2="floor" condim="3"/>
</contact>
<actuator><motor name="pull" joint="rail"/></actuator>
</mujoco>"""
STILL = """import jax.numpy as jnp
def policy(belief, seen, state, key): return jnp.zeros(1), state
"""
STUDY = """system: mujoco
model: {mjcf: model.xml, controller: "still:policy", duration: 0.7}
start: {velocity_x: 2.0}
outcome: {far: travelled_m > 9}
study: {axes: {one: {path: AXIS, side: world, values: [LOW, HIGH]},
               two: {path: AXIS2, side: world, values: [LOW, HIGH], with: one}}}
"""


def simulate(folder, axis, low, high):
    """Positions and velocities of two rollouts over time."""
    study = STUDY.replace("AXIS", axis).replace("LOW", str(low)).replace("HIGH", str(high))
    write_texts({"model.xml": MODEL, "still.py": STILL, "one.yaml": study}, folder)
    engine, batch = prepare_batch()
    return [(one.qpos, one.qvel) for one in engine.traces(*batch, 1)]


# both directions of the contact have a friction of their own
def test_a_block_is_decelerated_by_the_friction_of_its_pair(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for (_, qvel), friction in zip(
        simulate(tmp_path, "model.pair.rub.friction.slide", 0.1, 0.25), (0.1, 0.25), strict=True
    ):
        assert (qvel[4, 0] - qvel[24, 0]) / 0.4 == pytest.approx(friction * GRAVITY, rel=0.02)

"""A ball that bounces, by `solref` of its contact, against the law of a spring with a dashpot."""

import numpy as np
import pytest
from own_rollouts import prepare_batch, write_texts

STIFFNESS, FALL, GRAVITY = 1e5, 0.3, 9.81  # 1/s^2, m, m/s^2
STEP = float(np.pi / np.sqrt(STIFFNESS) / 40)  # s: a contact lasts 40 steps
RATIOS = (0.1, 0.2, 0.4)
MODEL = f"""<mujoco><option timestep="{STEP}" cone="elliptic"/>
<default><geom solref="{-STIFFNESS} -1" solimp="0.9999 0.9999 0.001"/></default>
<worldbody><geom name="floor" type="plane" size="5 5 0.1"/>
<body pos="0 0 {0.05 + FALL}"><freejoint/><geom name="ball" size="0.05" mass="1"/></body>
<body pos="1 0 1"><joint name="rail" type="slide" axis="1 0 0"/><geom size="0.01"/></body>
</worldbody><actuator><motor joint="rail"/></actuator></mujoco>"""
STUDY = """system: mujoco
model: {mjcf: model.xml, controller: "still:policy", duration: 0.36, period: %r}
outcome: {far: travelled_m > 9}
study: {axes: {damping: {path: "model.geom.{floor,ball}.solref.dampratio", values: %s}}}
"""


def rebound(ratio):
    """Share of the speed that is left, by small steps of the law, whose force does not pull."""
    damping, depth, speed, step = 2 * ratio * np.sqrt(STIFFNESS), 0.0, -np.sqrt(2 * GRAVITY * FALL), 1e-6
    while depth <= 0 and (speed < 0 or STIFFNESS * depth + damping * speed < 0):
        speed += step * (max(-STIFFNESS * depth - damping * speed, 0) - GRAVITY)
        depth += step * speed
    return np.sqrt(speed**2 + 2 * GRAVITY * depth) / np.sqrt(2 * GRAVITY * FALL)


def test_the_rebound_is_that_of_the_law(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    damping = [float(-2 * one * np.sqrt(STIFFNESS)) for one in RATIOS]
    write_texts({"model.xml": MODEL, "one.yaml": STUDY % (20 * STEP, damping),
                 "still.py": "import jax.numpy as jnp\n\ndef policy(seen): return 0 * seen[:, :1]\n"})  # fmt: skip
    made, batch = prepare_batch("engine=native", "engine.precision=float64")
    for ratio, trace in zip(RATIOS, made.traces(*batch, 1), strict=True):
        height, speed = trace.qpos[:, 2] - 0.05, trace.qvel[:, 2]
        up = height[-1], speed[-1]
        assert up[0] > 0
        left = np.sqrt(up[1] ** 2 + 2 * GRAVITY * up[0]) / np.sqrt(2 * GRAVITY * FALL)
        assert left == pytest.approx(rebound(ratio), rel=0.05)

"""A trot for quadruped.xml, as `sweep` wants a controller: a pure function of JAX, called once a tick."""

import jax.numpy as jnp

PERIOD, LINK = 0.02, 0.2  # s, of a tick, as in the study; m, of thigh and shank
BEFORE = jnp.array([0.0, 0.5, 0.5, 0.0])  # phases of the legs lf, rf, lh, rh
LEFT, FRONT = jnp.array([1.0, -1, 1, -1]), jnp.array([1.0, 1, -1, -1])

# m/s, 1/s, m, m: axes such as `controller.speed`
PARAMETERS = {"speed": 0.4, "steps": 2.0, "lift": 0.04, "height": 0.28}
BELIEVES = {"load": "model.body.trunk.mass", "stiffness": "model.actuator.lf_knee.kp"}  # as the study's belief has them


def begin(belief, key):
    """Where it starts (None: at the keyframe), the state that `policy` keeps, how long it takes (None: duration)."""
    return None, {"time": jnp.zeros(()), "spin": jnp.zeros(3)}, None


def policy(belief, observation, state, key):
    """Angles of the joints (12,) from the trunk's quaternion and angular velocity (7,), and the new state."""
    (w, x, y, z), spin = observation[:4], 0.8 * state["spin"] + 0.2 * observation[4:7]
    roll = jnp.arctan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y))
    pitch = jnp.arcsin(jnp.clip(2 * (w * y - z * x), -1.0, 1.0))
    phase = (state["time"] * belief["steps"] + BEFORE) % 1.0
    eager = jnp.minimum(state["time"], 1.0)  # it starts gently
    swing = phase > 0.5
    share = jnp.where(swing, 2 * phase - 1.5, 0.5 - 2 * phase)  # of a step, ahead of the hip
    ahead = eager * belief["speed"] / belief["steps"] / 2 * share
    up = eager * belief["lift"] * jnp.sin(2 * jnp.pi * (phase - 0.5)) * swing
    down = belief["height"] - up - 0.1 * LEFT * roll + 0.1 * FRONT * pitch
    bend = jnp.arccos(jnp.clip(jnp.hypot(ahead, down) / (2 * LINK), 0.2, 0.99))
    weight = (belief["load"] + 5.2) * 9.81 / 2 * ~swing  # N, on a standing leg; the knee's servo gives way under it
    knee = -2 * bend + weight * LINK * jnp.sin(bend) / belief["stiffness"]
    side = -0.3 * roll - 0.05 * spin[0] + jnp.zeros(4)
    angles = jnp.stack([side, bend - jnp.arctan2(ahead, down), knee], axis=1)
    return angles.ravel(), {"time": state["time"] + PERIOD, "spin": spin}

"""A trace moved by hand: a small hexapod that trots past a box and a floating ball."""

import mujoco
import numpy as np
import pytest

from sweep.config.experiment import compose
from sweep.contract.engine import Trace
from sweep.engines.contact_forces import SurfaceContacts

FRAMES, TICK = 250, 4e-3  # 1 s

_LEG = """
<body name="thigh{leg}" pos="{x} {y} 0" euler="0 0 {yaw}">
  <joint name="alpha{leg}" axis="0 0 1"/><joint name="beta{leg}" axis="0 -1 0"/>
  <geom type="capsule" fromto="0 0 0 .4 0 .2" size=".015"/>
  <body name="shin{leg}" pos=".4 0 .2">
    <joint name="gamma{leg}" axis="0 -1 0"/>
    <geom type="capsule" fromto="0 0 0 .1 0 -.6" size=".012"/><site name="foot{leg}" pos=".1 0 -.6"/>
  </body>
</body>"""


def _mjcf() -> str:
    legs = "".join(
        _LEG.format(leg=leg, x=0.45 * ((leg - 1) // 2 - 1), y=0.25 * (-1) ** leg, yaw=90 * (-1) ** leg)
        for leg in range(1, 7)
    )
    return f"""<mujoco>
      <asset>
        <texture name="soil" type="2d" builtin="checker" width="8" height="8" rgb1=".8 .8 .8" rgb2=".6 .6 .6"/>
        <material name="soil" texture="soil" texrepeat="1 1" texuniform="true"/>
      </asset>
      <worldbody><light pos="0 0 5"/>
      <geom type="plane" size="0 0 1" material="soil"/>
      <body name="step" pos="1 .9 .1" euler="0 0 30"><geom type="box" size=".2 .1 .1" rgba=".4 .5 .7 1"/></body>
      <body name="post" pos="-.7 -1 .3"><geom type="cylinder" size=".05 .3" rgba=".4 .5 .7 1"/></body>
      <body name="ball" pos="1 -1 .2"><freejoint/><geom type="sphere" size=".2" rgba=".7 .4 .3 1"/></body>
      <body name="base" pos="0 0 .4"><freejoint/><geom type="box" size=".5 .22 .05"/>{legs}</body>
    </worldbody></mujoco>"""


def _trace() -> Trace:
    model = mujoco.MjModel.from_xml_string(_mjcf())
    data = mujoco.MjData(model)
    time = TICK * np.arange(1, FRAMES + 1)
    phase = np.pi * (np.array([0, 1, 1, 0, 0, 1]) + 2 * time[:, None])  # (F, 6)
    lift = np.maximum(np.sin(phase), 0)
    angles = np.stack([0.2 * np.cos(phase), 0.4 * lift, 0.3 * lift], axis=-1).reshape(FRAMES, 18)
    ball, base = np.array([1, -1, 0.2, 1, 0, 0, 0]), np.array([0, 0, 0.4, 1, 0, 0, 0])
    qpos = np.column_stack([np.tile(ball, (FRAMES, 1)), np.tile(base, (FRAMES, 1)), angles])
    qpos[:, 7] += 0.3 * time
    feet = np.empty((FRAMES, 6, 3))
    for k, position in enumerate(qpos):
        data.qpos[:] = position
        mujoco.mj_kinematics(model, data)
        feet[k] = data.site_xpos
    force = np.where(lift[..., None] > 0, 0.0, np.array([10.0, 0.0, 60.0]))
    case = compose([]).case
    return Trace(
        world=case,
        belief=case,
        model=model,
        time=time,
        qpos=qpos,
        qvel=np.zeros((FRAMES, model.nv)),
        joint_target=angles + 0.02,
        joint_torque=np.tile([2.0, 10.0, 5.0], 6) * np.sin(phase).repeat(3, axis=1),
        foot_position=feet,
        foot_target=feet + 0.01,
        foot_force=force,
        base_target=qpos[:, 7:14] + np.array([0.01, 0, 0, 0, 0, 0, 0]),
        stage=(time > 0.5).astype(int) + (time > 0.75),
        stages=("stand", "left tripod", "right tripod"),
        margin=np.full(FRAMES, 0.5),
        margin_of=np.full(FRAMES, "slip_max"),
        metrics={"slip_max_m": np.float32(0.001)},
        contacts=SurfaceContacts(),
    )


@pytest.fixture(scope="session")
def trace() -> Trace:
    return _trace()

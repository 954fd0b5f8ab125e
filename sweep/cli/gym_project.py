"""Files of a project that evaluates a policy in a MuJoCo task of gymnasium: `sweep init --gym Ant-v5`."""

import math
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from sweep.core.errors import InputError, require_choice
from sweep.systems.mujoco_model import files

TASKS = {  # that give a reward for the forward speed of their root: names of the positions that health is judged by
    "Ant-v5": {"_healthy_z_range": 2},
    "HalfCheetah-v5": {},
    "Hopper-v5": {"_healthy_z_range": 1, "_healthy_angle_range": 2},
    "Swimmer-v5": {},
    "Walker2d-v5": {"_healthy_z_range": 1, "_healthy_angle_range": 2},
}
CLIPPED = ("Hopper-v5", "Walker2d-v5")  # whose observed velocities are clipped
MODEL = """<mujoco>
  <!-- {task}: gymnasium's model, and sensors of the actions for the reward -->
  <include file="{file}"/>
  <sensor>
{sensors}
  </sensor>
</mujoco>
"""
CODE = '''"""{task}: what the policy observes, and the task's reward and termination as metrics."""

import jax.numpy as jnp

PERIOD = {period!r}  # s
FORWARD, CONTROL, HEALTHY = {forward!r}, {control!r}, {healthy!r}  # weights of the reward
LEVERS = {levers!r}  # N m of joint torque for a unit of action
HEALTH = {health!r}  # least and largest value of positions, by index; beyond them the task ends
FIGURES = {{
    "reward_sum": "sum of the task's rewards until it ended",
    "healthy_steps": "control ticks until the task ended",
}}


def observe(told):
    """Observation of the task: positions{skipped} and velocities."""
    return jnp.concatenate([told["qpos"][{skip}:], {velocities}])
{policy}

def measure(previous, told):
    """Add the reward of a control tick."""
    position = told["qpos"]
    if previous is None:
        return {{"x": position[0], "reward": jnp.zeros(()), "alive": jnp.ones(()), "steps": jnp.zeros(())}}
    healthy = jnp.ones((), bool)
    for index, (low, high) in HEALTH.items():
        healthy &= (position[index] >= low) & (position[index] <= high)
    action = jnp.stack([told[f"action_{{k}}"][0] / lever for k, lever in enumerate(LEVERS)])
    reward = FORWARD * (position[0] - previous["x"]) / PERIOD + HEALTHY * healthy - CONTROL * jnp.sum(action**2)
    alive = previous["alive"]
    return {{
        "x": position[0],
        "reward": previous["reward"] + alive * reward,
        "alive": alive * healthy,
        "steps": previous["steps"] + alive,
    }}


def figures(belief, state, measured):
    """Metrics of the task."""
    return {{"reward_sum": measured["reward"], "healthy_steps": measured["steps"]}}
'''
STILL = '''

def policy(belief, observation, state, key):
    """No action: put your policy here, or a network beside this file."""
    return jnp.zeros(len(LEVERS)), state

'''
SCENARIO = """# {task} of gymnasium
system: mujoco
model:
  mjcf: task.xml
  controller: {controller}
  period: {period!r}
  duration: {duration!r}
start:
  random: {{{start}}}
outcome:
  {outcome}
"""
STUDY = """# How heavy may the {body} be?
scenario: own
study:
  replicates: 5
  axes:
    mass: {{path: model.body.{body}.mass, side: world, from: {low:.3g}, to: {high:.3g}, num: 8}}
"""


def project_files(task: str, policy: Path | None) -> dict[str, bytes]:
    """Return the files of a project that simulates a gymnasium task, as content by path.

    Args:
        task: Name of the task.
        policy: A network that maps the task's observation to actions; None for a policy that does nothing.

    Raises:
        InputError: gymnasium is not installed, the task is not supported, or the policy is no network.
    """
    require_choice(task, TASKS, f"--gym {task}")
    if policy and (not policy.is_file() or policy.suffix not in files.NETWORK_SUFFIXES):
        raise InputError(f"--policy {policy} is not allowed: a network in a file {', '.join(files.NETWORK_SUFFIXES)}")
    try:
        import gymnasium

        made = gymnasium.make(task, **({"include_cfrc_ext_in_observation": False} if task == "Ant-v5" else {}))
    except ImportError as error:
        raise InputError(f"--gym {task} needs gymnasium: pip install 'insect-sweep[gym]' ({error})") from None
    env: Any = made.unwrapped
    steps = (made.spec and made.spec.max_episode_steps) or 1000
    model, source = env.model, Path(env.fullpath)
    skip = int(env.observation_structure["skipped_qpos"])
    health = {index: tuple(map(float, getattr(env, name))) for name, index in TASKS[task].items()}
    joints = [model.joint(int(k)).name for k in model.actuator_trnid[:, 0]]
    code = CODE.format(
        task=task,
        period=float(env.dt),
        forward=float(env._forward_reward_weight),
        control=float(env._ctrl_cost_weight),
        healthy=float(getattr(env, "_healthy_reward", 0.0)),
        levers=[float(x) for x in model.actuator_gear[:, 0] * model.actuator_gainprm[:, 0]],
        health={index: tuple(_finite(x) for x in limits) for index, limits in health.items()},
        skipped=f" from number {skip} on",
        skip=skip,
        velocities='jnp.clip(told["qvel"], -10, 10)' if task in CLIPPED else 'told["qvel"]',
        policy="" if policy else STILL,
    )
    sensors = [f'    <jointactuatorfrc name="action_{k}" joint="{joint}"/>' for k, joint in enumerate(joints)]
    controller = policy.name if policy else "task:policy"
    found = {} if policy is None else {one.name: one.read_bytes() for one in files.list_network_files(policy)}
    body = model.body(1)
    return found | {
        source.name: source.read_bytes(),
        "task.xml": MODEL.format(task=task, file=source.name, sensors="\n".join(sensors)).encode(),
        f"{policy.stem if policy else 'task'}.py": code.encode(),
        "scenarios/own.yaml": SCENARIO.format(
            task=task,
            controller=controller,
            period=float(env.dt),
            duration=steps * float(env.dt),
            start=_start(model, env._reset_noise_scale),
            outcome=f"terminated: healthy_steps < {steps}" if health else "backward: reward_sum < 0",
        ).encode(),
        "studies/mass.yaml": STUDY.format(body=body.name, low=0.5 * body.mass[0], high=3 * body.mass[0]).encode(),
        "sweep.yaml": b"# A sweep project: studies/ and scenarios/ are read from here\nmodules: []\n",
        ".gitignore": b"results/\n",
    }


def _finite(value: float) -> float:
    return float(np.clip(value, -1e9, 1e9))


def _start(model: mujoco.MjModel, size: float) -> str:
    """Return the random offsets of the task's reset: even ones of positions, and velocities of the same deviation."""
    fast = float(f"{size * math.sqrt(3):.4g}")  # an even distribution has the deviation of its half width over sqrt(3)
    found = {"joint_positions": size, "joint_velocities": fast}
    if model.jnt_type[0] == int(mujoco.mjtJoint.mjJNT_FREE):
        found |= dict.fromkeys(("x", "y", "height"), size) | dict.fromkeys(("roll", "pitch", "yaw"), 2 * size)
        speeds = ("velocity_x", "velocity_y", "velocity_z", "roll_rate", "pitch_rate", "yaw_rate")
        found |= dict.fromkeys(speeds, fast)
    return ", ".join(f"{name}: {value:g}" for name, value in found.items())

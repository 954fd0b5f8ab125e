"""Files of a project that evaluates a policy in a MuJoCo task of gymnasium: `sweep init --gym Ant-v5`."""

import math
from collections.abc import Sequence
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
    "Humanoid-v5": {"_healthy_z_range": 2},
    "Swimmer-v5": {},
    "Walker2d-v5": {"_healthy_z_range": 1, "_healthy_angle_range": 2},
}
BY_MASS_CENTRE = ("Humanoid-v5",)  # whose forward speed is that of the centre of mass
CLIPPED = ("Hopper-v5", "Walker2d-v5")  # whose observed velocities are clipped
# arrays of mjData that some tasks observe, with the number of elements of world or base that they leave out
OBSERVED_ARRAYS = {"cinert": 10, "cvel": 6, "qfrc_actuator": 6, "cfrc_ext": 6}
CONTACT = """CONTACT = {weight!r}  # weight of the cost of contact forces
FORCE_LIMITS, COST_LIMITS = {forces!r}, {costs!r}
"""
CONTACT_COST = """
    contact = CONTACT * jnp.sum(jnp.clip(told["cfrc_ext"], *FORCE_LIMITS) ** 2)
    reward = reward - jnp.clip(contact, *COST_LIMITS)"""
UNLIMITED = 1e9  # in the place of an infinite limit
MODEL = """<mujoco>
  <!-- {task}: gymnasium's model, and sensors that the reward needs -->
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
{contact}HEALTH = {health!r}  # least and largest value of positions, by index; beyond them the task ends
FIGURES = {{
    "reward_sum": "sum of the task's rewards until it ended",
    "healthy_steps": "control ticks until the task ended",
}}


def observe(told):
    """Observation of the task."""
    return jnp.concatenate([told["qpos"][{skip}:], {velocities}{arrays}])
{policy}

def measure(previous, told):
    """Add the reward of a control tick."""
    position, x = told["qpos"], told["{forward_array}"][0]
    if previous is None:
        return {{"x": x, "reward": jnp.zeros(()), "alive": jnp.ones(()), "steps": jnp.zeros(())}}
    healthy = jnp.ones((), bool)
    for index, (low, high) in HEALTH.items():
        healthy &= (position[index] >= low) & (position[index] <= high)
    action = jnp.stack([told[f"action_{{k}}"][0] / lever for k, lever in enumerate(LEVERS)])
    reward = FORWARD * (x - previous["x"]) / PERIOD + HEALTHY * healthy - CONTROL * jnp.sum(action**2){contact_cost}
    alive = previous["alive"]
    return {{
        "x": x,
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
{data}start:
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
    if policy and not policy.is_file():
        raise InputError(f"--policy {policy} is not a file")
    if policy and policy.suffix not in files.NETWORK_SUFFIXES:
        raise InputError(f"--policy {policy} is not allowed: a network in a file {', '.join(files.NETWORK_SUFFIXES)}")
    try:
        import gymnasium

        made = gymnasium.make(task)
    except ImportError as error:
        raise InputError(f"--gym {task} needs gymnasium: pip install 'insect-sweep[gym]' ({error})") from None
    env: Any = made.unwrapped
    steps = (made.spec and made.spec.max_episode_steps) or 1000
    model, source = env.model, Path(env.fullpath)
    weight, observed = getattr(env, "_contact_cost_weight", 0.0), _observed_arrays(env, policy)
    limits = {key: _finite(getattr(env, f"_contact_{key}_range", (-math.inf, math.inf))) for key in ("force", "cost")}
    data = [*observed, *(["cfrc_ext"] if weight and "cfrc_ext" not in observed else [])]
    data += ["subtree_com"] if task in BY_MASS_CENTRE else []
    skip = int(env.observation_structure["skipped_qpos"])
    health = {index: _finite(getattr(env, name)) for name, index in TASKS[task].items()}
    joints = [model.joint(int(k)).name for k in model.actuator_trnid[:, 0]]
    code = CODE.format(
        task=task,
        period=float(env.dt),
        forward=float(env._forward_reward_weight),
        control=float(env._ctrl_cost_weight),
        healthy=float(getattr(env, "_healthy_reward", 0.0)),
        levers=[float(x) for x in model.actuator_gear[:, 0] * model.actuator_gainprm[:, 0]],
        health=health,
        contact=CONTACT.format(weight=float(weight), forces=limits["force"], costs=limits["cost"]) if weight else "",
        contact_cost=CONTACT_COST if weight else "",
        skip=skip,
        velocities='jnp.clip(told["qvel"], -10, 10)' if task in CLIPPED else 'told["qvel"]',
        arrays="".join(f", {text}" for text in observed.values()),
        forward_array="subtree_com" if task in BY_MASS_CENTRE else "qpos",
        policy="" if policy else STILL,
    )
    sensors = [f'    <jointactuatorfrc name="action_{k}" joint="{joint}"/>' for k, joint in enumerate(joints)]
    if "cfrc_ext" in data:  # which MuJoCo computes for sensors of accelerations and forces only
        sensors.append(f'    <framelinacc name="acceleration" objtype="body" objname="{model.body(1).name}"/>')
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
            data=f"  data: [{', '.join(data)}]\n  sensors: current\n" if data else "",
            start=_start(model, env._reset_noise_scale),
            outcome=f"terminated: healthy_steps < {steps}" if health else "backward: reward_sum < 0",
        ).encode(),
        "studies/mass.yaml": STUDY.format(body=body.name, low=0.5 * body.mass[0], high=3 * body.mass[0]).encode(),
        "sweep.yaml": b"# A sweep project: studies/ and scenarios/ are read from here\nmodules: []\n",
        ".gitignore": b"results/\n",
    }


def _finite(limits: Sequence[float]) -> tuple[float, ...]:
    """Return limits of which infinite ones are replaced by large numbers."""
    return tuple(float(x) for x in np.clip(limits, -UNLIMITED, UNLIMITED))


def _observed_arrays(env: Any, policy: Path | None) -> dict[str, str]:
    """Return code for the arrays of mjData that the task observes, by name: all of them, or none for a small network.

    Raises `InputError` where the network takes another number of observations.
    """
    sizes = env.observation_structure
    found = {name: f'told["{name}"][{skip}:]' for name, skip in OBSERVED_ARRAYS.items() if sizes.get(name)}
    if not found or policy is None:
        return found
    network = files.read_network(policy.name, policy)
    shape = [size for size in network.input_shape(next(iter(network.inputs))) if size != 1]
    plain, whole = sizes["qpos"] + sizes["qvel"], int(env.observation_space.shape[0])
    if -1 not in shape and math.prod(shape) not in (plain, whole):
        raise InputError(
            f"--policy {policy} is not allowed: it takes {math.prod(shape)} numbers; the task observes {whole}, or "
            f"{plain} without {', '.join(found)}"
        )
    if hasattr(env, "_contact_force_range"):
        found["cfrc_ext"] = f"jnp.clip({found['cfrc_ext']}, *FORCE_LIMITS)"
    return found if math.prod(shape) != plain else {}


def _start(model: mujoco.MjModel, size: float) -> str:
    """Return the random offsets of the task's reset: even ones of positions, and velocities of the same deviation."""
    fast = float(f"{size * math.sqrt(3):.4g}")  # an even distribution has the deviation of its half width over sqrt(3)
    found = {"joint_positions": size, "joint_velocities": fast}
    if model.jnt_type[0] == int(mujoco.mjtJoint.mjJNT_FREE):
        found |= dict.fromkeys(("x", "y", "height"), size) | dict.fromkeys(("roll", "pitch", "yaw"), 2 * size)
        speeds = ("velocity_x", "velocity_y", "velocity_z", "roll_rate", "pitch_rate", "yaw_rate")
        found |= dict.fromkeys(speeds, fast)
    return ", ".join(f"{name}: {value:g}" for name, value in found.items())

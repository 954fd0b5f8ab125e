"""Files of a project that evaluates a learned policy: `sweep init --policy walk.onnx --mjcf robot.xml`."""

import os
from pathlib import Path

import mujoco
import numpy as np

from sweep.core.errors import InputError, require_choice
from sweep.systems.mujoco_model import files
from sweep.systems.mujoco_model.learned_policy import spec_path
from sweep.systems.mujoco_model.policy_spec import PRESETS

DEFAULT_PERIOD_S, DEFAULT_DURATION_S = 0.02, 4.0  # s, of a policy whose file says nothing
STRONGEST_PUSH_MPS = 1.0  # m/s that the strongest push of the study adds to the whole robot
SPECIFICATION_TEMPLATE = """# How the policy was trained: docs/reference/policy_file.md lists the keys
preset: {preset}
period: {period:g}  # s between two calls of the network
"""
# of the actuators' work, by which the energy balance may be off: servos of restless policies change their force by much
# within a physics step, and the balance has one value of a step
WORK_ERROR_SHARE = 0.05
FEW_ITERATIONS = 10  # of the solver: models with fewer leave many steps unsolved, in training as here
SCENARIO_TEMPLATE = """# {network} on {mjcf}: what is simulated, and when it fails
system: mujoco
model:
  mjcf: {mjcf}
  controller: {network}
  duration: {duration:g}
  sensors: current
{keyframe}push:
  kick: {{body: {body}, start: 1.0, length: 0.1}}
outcome:
  fell: {fell}
{invalid}
"""
STUDY_TEMPLATE = """# How strong a push, and how late an action, does the policy survive?
scenario: own
study:
  axes:
    push: {{path: push.kick.impulse, side: world, from: 0, to: {most:.3g}, num: 6}}
    delay: {{path: noise.action_delay, side: world, values: {delays}}}
"""


def project_files(policy: Path, mjcf: Path, preset: str) -> dict[str, bytes]:
    """Return the files of a project that runs a learned policy on a MuJoCo model, as content by path.

    Args:
        policy: The network's file.
        mjcf: The model's file; what it refers to is copied, too.
        preset: Conventions of the policy where no specification lies beside it.

    Raises:
        InputError: A file is missing or is not allowed.
    """
    require_choice(preset, PRESETS, f"--preset {preset}")
    for flag, file in (("policy", policy), ("mjcf", mjcf)):
        if not file.is_file():
            raise InputError(f"--{flag} {file} is not a file")
    if policy.suffix not in files.NETWORK_SUFFIXES:
        raise InputError(f"--policy {policy} is not allowed: a network in a file {', '.join(files.NETWORK_SUFFIXES)}")
    mjcf = mjcf.resolve()
    model, sources = files.load_model(str(mjcf)), [file.resolve() for file in files.list_files(str(mjcf))]
    # the project has the folders in which the model's files lie to each other
    folder = os.path.commonpath([mjcf.parent, *(file.parent for file in sources)])
    found = {str(file.relative_to(folder)): file.read_bytes() for file in sources}
    found |= {file.name: file.read_bytes() for file in files.list_network_files(policy)}
    beside = spec_path(policy)
    specification = (
        beside.read_bytes()
        if beside.is_file()
        else SPECIFICATION_TEMPLATE.format(preset=preset, period=DEFAULT_PERIOD_S).encode()
    )
    return found | {
        beside.name: specification,
        "scenarios/own.yaml": _scenario(policy.name, str(mjcf.relative_to(folder)), model).encode(),
        "studies/push_delay.yaml": _study(model).encode(),
        "sweep.yaml": b"# A sweep project: studies/ and scenarios/ are read from here\nmodules: []\n",
        ".gitignore": b"results/\n",
    }


def _scenario(network: str, mjcf: str, model: mujoco.MjModel) -> str:
    """Return the text of the scenario: a fall is half the height of the start, or a tilt."""
    keyframes = [name for k in range(model.nkey) if (name := model.key(k).name)]
    keyframe = model.key(0).name if model.nkey else ""
    others = f"  # or {', '.join(keyframes[1:])}" if len(keyframes) > 1 else ""
    free = np.flatnonzero(model.jnt_type == int(mujoco.mjtJoint.mjJNT_FREE))
    body = model.body(int(model.jnt_bodyid[free[0] if len(free) else 0])).name
    if not body:
        raise InputError(f"--mjcf {mjcf} is not allowed: the first body with a joint has no name, which pushes need")
    pose = model.key_qpos[0] if keyframe else model.qpos0
    fell = "joint_limit_share > 0.5"
    if len(free):
        fell = f"base_height_min_m < {pose[model.jnt_qposadr[free[0]] + 2] / 2:.3g} or tilt_max_deg > 60"
    return SCENARIO_TEMPLATE.format(
        network=network,
        mjcf=mjcf,
        duration=DEFAULT_DURATION_S,
        keyframe=f"  keyframe: {keyframe}{others}\n" if keyframe else "",
        body=body,
        fell=fell,
        invalid=_invalid(model),
    )


def _invalid(model: mujoco.MjModel) -> str:
    """Return the scenario's lines on rollouts that the simulation cannot vouch for."""
    small = 0.1 * model.body_mass.sum() * STRONGEST_PUSH_MPS**2
    gained = f"  invalid: energy_gained_j > {small:.3g} + {WORK_ERROR_SHARE} * energy_j"
    iterations = int(model.opt.iterations)
    if iterations >= FEW_ITERATIONS:
        return f"{gained} or unsolved_share > 0.1"
    return (
        f"  # unsolved_share is left out, since the model allows the contact solver {iterations} iteration(s)\n{gained}"
    )


def _study(model: mujoco.MjModel) -> str:
    """Return the text of a study over impulse and delay, up to two calls of the policy."""
    steps = max(round(DEFAULT_PERIOD_S / model.opt.timestep), 1)
    delays = sorted({round(steps * share / 2) for share in range(5)})
    return STUDY_TEMPLATE.format(most=STRONGEST_PUSH_MPS * model.body_mass.sum(), delays=delays)

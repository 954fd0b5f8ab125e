"""Interface of smooth dynamics of a robot with legs on one base: mass matrix in blocks, bias forces, foot Jacobians.

Legs couple through the base only, so the mass matrix is kept as blocks and never as a full matrix. The obstacle's
free bodies are rigid bodies of their own, see `free_bodies`.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import NamedTuple

import mujoco
import numpy as np

from sweep.core.errors import InputError
from sweep.core.vectors import Vector
from sweep.dynamics.free_bodies import contact_owners
from sweep.dynamics.spatial import GeneralizedVector, MassMatrix, SystemPose
from sweep.models import scene
from sweep.models.case import Case
from sweep.models.legs import JOINT_NAMES, LEGS, N_LEGS


@dataclass(frozen=True)
class ModelTopology:
    """Compiled MuJoCo model and its index tables, which do not depend on varied sizes and masses.

    Contact points are the six feet, then the obstacle's sites.
    """

    model: mujoco.MjModel
    ids_by_name: Mapping[str, Mapping[str, int]]  # ids by kind ("body", "site", "joint") and name
    leg_dofs: np.ndarray  # (6, 3) dofs of the legs
    foot_site_ids: np.ndarray  # (6,) their site ids
    free_body_ids: tuple[int, ...]  # body ids of the free bodies
    contact_owners: tuple[int, ...]  # (n,) free body that carries the contact point, -1 for the robot's feet


class RobotDynamicsTerms(NamedTuple):
    """Mass matrix, bias and foot Jacobians of the robot at one pose and motion, base axes from the base's origin."""

    mass: MassMatrix  # with armature
    bias: GeneralizedVector  # Coriolis and gravity
    joints: tuple[Vector, ...]  # (l,) m, along a leg: hip, (end of the coxa,) knee, foot
    foot: tuple[Vector, Vector, Vector]  # (l,) velocity of the foot per rate of a joint


SmoothDynamics = Callable[
    [SystemPose, GeneralizedVector], RobotDynamicsTerms
]  # of one world; motions in the bodies' own axes


def build_model_topology(case: Case) -> ModelTopology:
    """Compile the MuJoCo model of a rollout's parameters (plain numbers), and build tables of its bodies and joints.

    Raises:
        InputError: The frame of a free body is not at its mass centre along its principal axes.
    """
    model = scene.compile_model(case, geoms=False)
    kinds = {"body": mujoco.mjtObj.mjOBJ_BODY, "site": mujoco.mjtObj.mjOBJ_SITE, "joint": mujoco.mjtObj.mjOBJ_JOINT}
    sizes = {"body": model.nbody, "site": model.nsite, "joint": model.njnt}
    names = {kind: {mujoco.mj_id2name(model, obj, i): i for i in range(sizes[kind])} for kind, obj in kinds.items()}
    free = tuple(names["body"][name] for name in case.obstacle.free_bodies)
    for name, body in zip(case.obstacle.free_bodies, free, strict=True):
        if np.any(model.body_ipos[body]) or np.any(model.body_iquat[body, 1:]):
            raise InputError(f"free body {name} is not allowed: its frame is at its mass centre, on principal axes")
    leg = np.array([model.jnt_dofadr[names["joint"][joint]] for joint in JOINT_NAMES], np.int32).reshape(N_LEGS, 3)
    feet = np.array([names["site"][f"foot{leg}"] for leg in LEGS], np.int32)
    return ModelTopology(model, names, leg, feet, free, contact_owners(case))

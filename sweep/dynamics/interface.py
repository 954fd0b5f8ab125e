"""What the smooth dynamics of a star-shaped robot and the obstacle's free bodies are: arrowhead blocks.

Generalised velocity: the root part (base, then free bodies, 6 each: world linear, body angular), then 3 per leg.
The mass matrix couples legs through the base only, so it is kept as blocks and never as a full matrix.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import NamedTuple

import mujoco
import numpy as np
from jaxtyping import Array, Float

from sweep.models import scene
from sweep.models.case import Case
from sweep.models.legs import JOINTS, LEGS, N_LEGS
from sweep.models.obstacles.surface import Bodies


@dataclass(frozen=True)
class Topology:
    """What does not change while sizes and masses are swept. Contact points: the six feet, then obstacle sites."""

    model: mujoco.MjModel
    names: Mapping[str, Mapping[str, int]]  # ids by kind ("body", "site", "joint") and name
    root: np.ndarray  # (r,) dofs of the base and of the free bodies
    leg: np.ndarray  # (6, 3) dofs of the legs
    free: tuple[int, ...]  # body ids of the free bodies
    points: np.ndarray  # (n,) site ids of the contact points
    owner: tuple[int, ...]  # (n,) free body that carries the point, -1 for the robot's feet
    links_per_leg: int


class Smooth(NamedTuple):
    """Mass matrix blocks, bias and contact points of one configuration. r root dofs, n contact points."""

    m_root: Float[Array, "r r"]
    m_cross: Float[Array, "6 r 3"]
    m_leg: Float[Array, "6 3 3"]  # with armature
    bias_root: Float[Array, " r"]  # Coriolis and gravity
    bias_leg: Float[Array, "6 3"]
    point: Float[Array, "n 3"]  # m, world
    j_root: Float[Array, "n 3 r"]  # world velocity of a point
    j_leg: Float[Array, "6 3 3"]  # of foot i by its own leg
    bodies: Bodies
    j_body: Float[Array, "k n 3 6"]  # velocity of the body's material under each point
    potential: Float[Array, ""]  # J
    links: Float[Array, "l 3"]  # m, world position of every link's frame, leg by leg
    centre_of_mass: Float[Array, " 3"]  # m, of the robot


SmoothDynamics = Callable[[Float[Array, " nq"], Float[Array, " nv"]], Smooth]  # of one world


def topology(case: Case) -> Topology:
    """The compiled model of `case` (plain numbers) and the index tables of its arrowhead."""
    model = scene.compile_model(case, geoms=False)
    kinds = {"body": mujoco.mjtObj.mjOBJ_BODY, "site": mujoco.mjtObj.mjOBJ_SITE, "joint": mujoco.mjtObj.mjOBJ_JOINT}
    sizes = {"body": model.nbody, "site": model.nsite, "joint": model.njnt}
    names = {kind: {mujoco.mj_id2name(model, obj, i): i for i in range(sizes[kind])} for kind, obj in kinds.items()}
    free = tuple(names["body"][name] for name in case.obstacle.free_bodies)
    root = np.concatenate([np.arange(6), *[model.body_dofadr[b] + np.arange(6) for b in free]]).astype(np.int32)
    joints = np.array([model.jnt_dofadr[names["joint"][joint]] for joint in JOINTS], np.int32)
    feet = [names["site"][f"foot{leg}"] for leg in LEGS]
    extra = [names["site"][name] for name, _ in case.obstacle.contact_sites]
    owner = (-1,) * N_LEGS + tuple(body for _, body in case.obstacle.contact_sites)
    points = np.array(feet + extra, np.int32)
    per_leg = len(scene.links(case.robot))
    return Topology(model, names, root, joints.reshape(N_LEGS, 3), free, points, owner, per_leg)


def saved(model: mujoco.MjModel) -> bytes:
    """All that is in a compiled model."""
    content = np.empty(mujoco.mj_sizeModel(model), np.uint8)
    mujoco.mj_saveModel(model, None, content)
    return content.tobytes()

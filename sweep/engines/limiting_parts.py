"""Which leg, link or foot of a recorded rollout came nearest to a limit, from its states alone."""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from sweep.contract.engine import Trace
from sweep.core.rotations import matrix, rotate
from sweep.engines.closed_loop import free_body_state
from sweep.fused import eager
from sweep.models.case import Case
from sweep.models.geometry import gap_between_legs, leg_base_gap, link_capsules, thigh_shin_gap
from sweep.models.legs import JOINT_Q, LEG_NAMES, LEGS, N_LEGS
from sweep.models.obstacles.surface import BodyPoses, body_poses
from sweep.models.posture import leg_joint_positions
from sweep.models.robot import base_half_size
from sweep.models.solids import distance_to_box

NAMES = [LEG_NAMES[leg].replace("_", " ") for leg in LEGS]
PAIRS = [(i, j) for j in range(N_LEGS) for i in range(j)]
FAR_M = 1e3  # m, where legs are put that do not count
FOOT_CAUSES = ("slipped", "unreachable", "lifted_off")


class Pose(NamedTuple):
    """Robot and free bodies in one frame of a rollout, world axes."""

    world: Case
    base: tuple[Float[Array, " 3"], Float[Array, "3 3"]]  # m, rotation
    legs: Float[Array, "6 k 3"]  # m, points along each leg from the hip to the foot
    bodies: BodyPoses


def describe_limiting_part(trace: Trace, cause: str, stage: str) -> str:
    """Describe the part of the robot that caused a failure, such as a link that collided or a foot that slipped.

    Args:
        trace: The failed rollout.
        cause: Its cause of failure.
        stage: The stage of the plan in which it failed.

    Returns:
        The part, such as "shin of the front left leg"; empty where the cause has none.
    """
    frames = np.flatnonzero(trace.stage == trace.stages.index(stage)) if stage in trace.stages else np.array([], int)
    if not len(frames):
        return ""
    if cause in FOOT_CAUSES:
        off = np.linalg.norm(trace.foot_position[frames] - trace.foot_target[frames], axis=-1)
        return f"{NAMES[int(off.max(axis=0).argmax())]} foot"
    if cause not in GAPS:
        return ""
    names, gaps = GAPS[cause]
    qpos = trace.qpos[frames]
    found = eager.trace_numpy_program(lambda x: gaps(_pose(trace.world, x)), qpos[0])(len(frames), qpos)
    return names[int(found.min(axis=0).argmin())]


def _pose(world: Case, qpos: Float[Array, " n"]) -> Pose:
    count = len(world.obstacle.free_bodies)
    bodies = body_poses(free_body_state(qpos, jnp.zeros(6 * count), count))  # velocities do not matter
    legs = qpos[:3] + rotate(qpos[3:7], leg_joint_positions(world.robot, qpos[JOINT_Q].reshape(N_LEGS, 3)))
    return Pose(world, (qpos[:3], matrix(qpos[3:7])), legs, bodies)


def _gaps_to_obstacle(pose: Pose) -> Float[Array, " 13"]:
    """Of the base, the thighs and the shins."""
    robot, solids = pose.world.robot, pose.world.obstacle.solids(pose.bodies)
    links = link_capsules(pose.legs, robot).distance_to(solids)
    base = distance_to_box(solids, *pose.base, base_half_size(robot))
    # a shin is two capsules, the second of them thin
    return jnp.concatenate([base[None], jnp.min(links[:, :-2], axis=1), jnp.min(links[:, -2:], axis=1)])


def _gaps_of_pairs(pose: Pose) -> Float[Array, " 15"]:
    apart = jnp.asarray(FAR_M * np.arange(1.0, N_LEGS + 1)[:, None, None] * np.array([1.0, 0.0, 0.0]))
    chosen = np.array([[leg in pair for leg in range(N_LEGS)] for pair in PAIRS])
    return jnp.stack([gap_between_legs(pose.legs + jnp.where(two[:, None, None], 0.0, apart)) for two in chosen])


def _gaps_to_base(pose: Pose) -> Float[Array, " 6"]:
    return _gaps_of_legs(lambda legs: leg_base_gap(legs, *pose.base, pose.world.robot), pose)


def _gaps_of_folds(pose: Pose) -> Float[Array, " 6"]:
    robot = pose.world.robot
    return _gaps_of_legs(lambda legs: thigh_shin_gap(legs, robot.fork_ratio * robot.shin + robot.link_radius), pose)


def _gaps_of_legs(gap: Callable[[Float[Array, "6 k 3"]], Array], pose: Pose) -> Float[Array, " 6"]:
    """Gap of each leg, by a function of the least gap of six: all six are put where the leg is."""
    return jnp.stack([gap(jnp.broadcast_to(leg, pose.legs.shape)) for leg in pose.legs])


GAPS: dict[str, tuple[Sequence[str], Callable[[Pose], Array]]] = {
    "link_collision": (
        ["base", *(f"{link} of the {name} leg" for link in ("thigh", "shin") for name in NAMES)],
        _gaps_to_obstacle,
    ),
    "leg_crossing": ([f"{NAMES[i]} and {NAMES[j]} leg" for i, j in PAIRS], _gaps_of_pairs),
    "base_hit": ([f"{name} leg" for name in NAMES], _gaps_to_base),
    "folded": ([f"{name} leg" for name in NAMES], _gaps_of_folds),
}

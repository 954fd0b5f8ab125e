"""Contact forces of the feet of a trace, resolved along the surfaces under them, as simulated and as planned."""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from sweep.contract.engine import Trace
from sweep.controllers.layers import ForceFeedforward, interpolate_stage_values
from sweep.core.constants import FOOT_LOAD_THRESHOLD_N, GRAVITY
from sweep.engines.closed_loop import free_body_state
from sweep.models.obstacles.surface import Obstacle, Surface, body_poses, surface_at
from sweep.models.robot import total_mass

FRAMES_PER_CHUNK = 256  # frames that are evaluated together


class ContactForces(NamedTuple):
    """Normal and tangential forces of the six feet over the F frames of a trace."""

    normal: np.ndarray  # (F, 6), in units of the robot's weight
    friction: np.ndarray  # (F, 6), tangential over normal force; nan below a load of `LOADED` N
    elastic_share: np.ndarray  # (F, 6), `friction` over the friction coefficient, 1 where the foot slips; nan likewise


class SurfaceContacts:
    """Contacts of the feet with the obstacle over a recorded rollout: friction use, and depth of points inside."""

    def friction_utilization(self, trace: Trace) -> np.ndarray:
        """Return the share of its friction limit that each foot uses, (F, 6): 1 where it slips, NaN without load."""
        return measured_contact_forces(trace).elastic_share

    def penetration_depth(self, trace: Trace, points: np.ndarray, frames: np.ndarray) -> np.ndarray:
        """Return how deep points (K, n, 3) lie inside the obstacle, (K, n), m, at frames (K,) of the trace."""
        return np.asarray(nearest_surfaces(trace, points, frames).depth)


def measured_contact_forces(trace: Trace) -> ContactForces:
    """Return the simulated normal and tangential forces of the feet over the frames of a trace."""
    return _contact_forces(trace, trace.foot_force)


def planned_contact_forces(trace: Trace) -> ContactForces | None:
    """Return the planned contact forces at the frames of a trace; None for a plan without forces."""
    plan, force = jax.jit(_plan)(trace.belief)
    if force is None:
        return None
    number = np.arange(len(trace.stage))
    first = np.maximum.accumulate(np.where(np.diff(trace.stage, prepend=-1) != 0, number, 0))
    tick = trace.time[1] - trace.time[0]
    phase = np.clip((trace.time - trace.time[first] + tick) / np.asarray(plan.duration)[trace.stage], 0, 1)
    force = jax.vmap(partial(interpolate_stage_values, force))(jnp.asarray(trace.stage), jnp.asarray(phase, float))
    return _contact_forces(trace, np.asarray(force))


def _plan(belief):
    plan = belief.manoeuvre.plan(belief)
    return plan, None if plan.find_layer(ForceFeedforward) is None else belief.manoeuvre.force_plan(belief, plan).force


def nearest_surfaces(trace: Trace, points: np.ndarray, frames: slice | np.ndarray = slice(None)) -> Surface:
    """Return the obstacle's surface nearest to each of some points, with free bodies at their simulated poses.

    Args:
        trace: The rollout.
        points: Points (N, n, 3), m, world axes.
        frames: The N frames of the trace to which the points belong.

    Returns:
        Surfaces (N, n).
    """
    moments = [np.asarray(x, np.float32) for x in (points, trace.qpos[frames], trace.qvel[frames])]
    # padded to a multiple of CHUNK_FRAMES, so that the program compiled for one trace serves the next
    count = len(points)
    filled = [np.pad(x, ((0, -count % FRAMES_PER_CHUNK), *([(0, 0)] * (x.ndim - 1))), mode="edge") for x in moments]
    return jax.tree.map(lambda part: part[:count], _surfaces(trace.world.obstacle, *filled))


@jax.jit
def _surfaces(obstacle: Obstacle, points: jax.Array, qpos: jax.Array, qvel: jax.Array) -> Surface:
    def surfaces_of_frame(points: jax.Array, qpos: jax.Array, qvel: jax.Array) -> Surface:
        return surface_at(obstacle, points, body_poses(free_body_state(qpos, qvel, len(obstacle.free_bodies))))

    return jax.vmap(surfaces_of_frame)(points, qpos, qvel)


def _contact_forces(trace: Trace, force: np.ndarray) -> ContactForces:
    """Resolve `force` (F, 6, 3), N, along the normal of the surface nearest to each foot."""
    surface = nearest_surfaces(trace, trace.foot_position)
    normals = np.asarray(surface.normal, float)
    normal = np.sum(force * normals, axis=-1)
    tangential = np.linalg.norm(force - normal[..., None] * normals, axis=-1)
    friction = np.where(normal > FOOT_LOAD_THRESHOLD_N, tangential / np.maximum(normal, FOOT_LOAD_THRESHOLD_N), np.nan)
    share = friction / (float(trace.world.contact.friction) * np.asarray(surface.friction_scale, float))
    return ContactForces(normal / (GRAVITY * total_mass(trace.world.robot)), friction, share)

"""How the feet of a trace hold on: their forces on the surfaces under them, as they were and as they were planned."""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from sweep.controllers.layers import Feedforward, interpolate_moments
from sweep.core.constants import GRAVITY, LOADED
from sweep.engines.base import Trace
from sweep.engines.closed_loop import free_body_state
from sweep.models.obstacles.surface import Obstacle, Surface, body_poses, surface_at
from sweep.models.robot import total_mass

TOGETHER = 256  # frames


class ContactForces(NamedTuple):
    """Forces of the feet over F frames."""

    normal: np.ndarray  # (F, 6), in the robot's weights
    friction: np.ndarray  # (F, 6), tangential over normal force; nan below a load of `LOADED`
    share: np.ndarray  # (F, 6), of the friction that there is, 1 slips; nan as well


def measured(trace: Trace) -> ContactForces:
    """What the surfaces of the world did."""
    return _contact_forces(trace, trace.foot_force)


def planned(trace: Trace) -> ContactForces | None:
    """What was planned for the same moments; nothing where no forces were."""
    plan, force = jax.jit(_plan)(trace.belief)
    if force is None:
        return None
    number = np.arange(len(trace.stage))
    first = np.maximum.accumulate(np.where(np.diff(trace.stage, prepend=-1) != 0, number, 0))
    tick = trace.time[1] - trace.time[0]
    phase = np.clip((trace.time - trace.time[first] + tick) / np.asarray(plan.duration)[trace.stage], 0, 1)
    force = jax.vmap(partial(interpolate_moments, force))(jnp.asarray(trace.stage), jnp.asarray(phase, float))
    return _contact_forces(trace, np.asarray(force))


def _plan(belief):
    plan = belief.manoeuvre.plan(belief)
    return plan, None if plan.layer(Feedforward) is None else belief.manoeuvre.force_plan(belief, plan).force


def surfaces(trace: Trace, points: np.ndarray, frames: slice | np.ndarray = slice(None)) -> Surface:
    """What is under `points` (F, n, 3) (m, world axes) in `frames`, the obstacle's bodies where they were."""
    moments = [np.asarray(x, np.float32) for x in (points, trace.qpos[frames], trace.qvel[frames])]
    # as many frames as others have: what was compiled for one trace serves the next
    count = len(points)
    filled = [np.pad(x, ((0, -count % TOGETHER), *([(0, 0)] * (x.ndim - 1))), mode="edge") for x in moments]
    return jax.tree.map(lambda part: part[:count], _surfaces(trace.world.obstacle, *filled))


@jax.jit
def _surfaces(obstacle: Obstacle, points: jax.Array, qpos: jax.Array, qvel: jax.Array) -> Surface:
    def there(points: jax.Array, qpos: jax.Array, qvel: jax.Array) -> Surface:
        return surface_at(obstacle, points, body_poses(free_body_state(qpos, qvel, len(obstacle.free_bodies))))

    return jax.vmap(there)(points, qpos, qvel)


def _contact_forces(trace: Trace, force: np.ndarray) -> ContactForces:
    """`force` (F, 6, 3) in parts normal and tangential to the surface nearest to each foot."""
    surface = surfaces(trace, trace.foot_position)
    normals = np.asarray(surface.normal, float)
    normal = np.sum(force * normals, axis=-1)
    tangential = np.linalg.norm(force - normal[..., None] * normals, axis=-1)
    friction = np.where(normal > LOADED, tangential / np.maximum(normal, LOADED), np.nan)
    share = friction / (float(trace.world.contact.friction) * np.asarray(surface.friction_scale, float))
    return ContactForces(normal / (GRAVITY * total_mass(trace.world.robot)), friction, share)

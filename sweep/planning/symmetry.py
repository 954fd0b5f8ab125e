"""Plans made from other plans: reversed in time, mirrored, or joined.

For plans without postures, flywheel or planned forces. Mirrored and joined plans must be in world axes.
"""

from dataclasses import fields, replace

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from sweep.controllers.frames import points_to_frame, points_to_world, stance_to_world
from sweep.controllers.plan import Plan, stage_start_pose
from sweep.core.rotations import exponential, multiply
from sweep.models.case import Case
from sweep.models.obstacles.surface import FreeBodyState, empty_free_body_state, free_start_state
from sweep.models.posture import Stance
from sweep.planning import plan_table

BACK = "back."  # prefix of the names of stages that run backwards in time
OTHER_SIDE = np.array([1, 0, 3, 2, 5, 4])  # index of each leg's partner on the robot's other side


def last_stance(plan: Plan) -> Stance:
    """Return the stance in which a plan ends, with feet and base in the coordinate frames of its last stage."""
    return Stance(plan.foothold[-1], plan.position[-1], multiply(exponential(plan.turn[-1]), plan.quat[-1]))


def reverse_in_time(plan: Plan, free: FreeBodyState | None = None) -> Plan:
    """Return the plan that passes through the stances of `plan` in reverse order of time.

    Step cycles, paces and paths are their own reversal except at their ends. So a stage goes back with the same swings,
    from its footholds to those of the stage before, in the frames of the latter: a foot goes to where it is to stand on
    a measured body. Reversing twice gives the plan again.

    Args:
        plan: plan to reverse.
        free: state of the free bodies, which stay there; None: there are none.
    """
    free = empty_free_body_state() if free is None else free
    starts, position = jax.vmap(lambda stage: stage_start_pose(plan, stage, free))(jnp.arange(len(plan.names)))
    frame = jnp.concatenate([plan.foot_frame[:1], plan.foot_frame[:-1]])  # frames to go back to
    feet, guides = (
        _in_frames(points, plan.foot_frame, frame, free) for points in (starts[:, :, None], plan.curve.guides)
    )
    end_quats = multiply(exponential(plan.turn), plan.quat)  # the base's attitude at the end of each stage

    def back(array: Array) -> Array:
        return jnp.flip(array, axis=0)

    curve = plan.curve._replace(guides=jnp.flip(guides, axis=2))
    path = plan.path._replace(rates=jnp.flip(plan.path.rates, axis=1))
    return replace(
        plan,
        names=tuple(name.removeprefix(BACK) if name.startswith(BACK) else BACK + name for name in plan.names[::-1]),
        start=stance_to_world(last_stance(plan), plan.foot_frame[-1], plan.base_frame[-1], free),
        foothold=back(feet[:, :, 0]),
        foot_frame=back(frame),
        position=back(position),
        quat=back(end_quats),
        turn=back(-plan.turn),
        duration=back(plan.duration),
        swing=back(plan.swing),
        curve=jax.tree.map(back, curve),
        path=jax.tree.map(back, path),
        base_frame=back(plan.base_frame),
        onset=plan.onset[::-1],
        laws=plan.laws[::-1],
    )


def apply_plan_direction(belief: Case, plan: Plan) -> Plan:
    """Return the plan forward, reversed in time, or forward and then back, as the case's plan file asks.

    Args:
        belief: the case.
        plan: the forward plan, without planned forces.
    """
    direction = plan_table.plan_direction(belief)
    if direction == plan_table.FORTH:
        return plan
    back = reverse_in_time(plan, free_start_state(belief.obstacle))
    return back if direction == plan_table.BACK else join_plans(plan, back)


def _in_frames(
    points: Float[Array, "s 6 n 3"], frame: Int[Array, "s 6"], into: Int[Array, "s 6"], free: FreeBodyState
) -> Float[Array, "s 6 n 3"]:
    """Points (m) of every stage and leg, transformed from `frame` to the frame `into`."""
    flat = points.reshape(-1, 3)
    old, new = (jnp.repeat(frames.reshape(-1), points.shape[2]) for frames in (frame, into))
    return points_to_frame(points_to_world(flat, old, free), new, free).reshape(points.shape)


def mirror_plan(plan: Plan, normal: Float[np.ndarray, " 3"]) -> Plan:
    """Mirror a plan in a plane through the world's origin, with left and right legs exchanged.

    For robots that are their own mirror image. Mirroring twice gives the plan again.

    Args:
        plan: plan to mirror, world axes.
        normal: unit normal of the plane.
    """
    mirror = jnp.asarray(np.eye(3) - 2 * np.outer(normal, normal))
    left = np.array([0.0, 1.0, 0.0])
    # From the base's own plane of symmetry to this one: a rotation by twice the angle between them.
    to_mirror = jnp.asarray(np.concatenate([[normal @ left], np.cross(left, normal)]))

    def legs(array: Array) -> Array:
        """Mirror vectors by stage and leg, (S, 6, ..., 3)."""
        return array[:, OTHER_SIDE] @ mirror

    def attitude(quat: Array) -> Array:
        turned = jnp.concatenate([quat[..., :1], -quat[..., 1:] @ mirror], axis=-1)
        return multiply(turned, jnp.broadcast_to(to_mirror, quat.shape))

    feet, position, quat = plan.start
    return replace(
        plan,
        start=Stance(legs(feet[None])[0], position @ mirror, attitude(quat)),
        swing=plan.swing[:, OTHER_SIDE],
        foothold=legs(plan.foothold),
        curve=plan.curve._replace(
            guided=plan.curve.guided[:, OTHER_SIDE], plane=legs(plan.curve.plane), guides=legs(plan.curve.guides)
        ),
        position=plan.position @ mirror,
        quat=attitude(plan.quat),
        turn=-plan.turn @ mirror,
        path=plan.path._replace(pivot=plan.path.pivot @ mirror),
    )


def join_plans(first: Plan, *following: Plan) -> Plan:
    """Concatenate plans; each should start in the stance in which the one before it ends.

    Args:
        first: first plan, whose start and layers are kept.
        *others: the following plans.
    """
    plans = (first, *following)
    whole = ("start", "patience", "layers")
    names = [f.name for f in fields(Plan) if f.name not in whole and not f.metadata.get("static")]
    parts = ({name: getattr(plan, name) for name in names} for plan in plans)
    table = jax.tree.map(lambda *arrays: jnp.concatenate(arrays), *parts)
    words = {key: tuple(word for plan in plans for word in getattr(plan, key)) for key in ("names", "onset", "laws")}
    return replace(first, **words, **table)

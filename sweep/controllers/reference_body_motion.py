"""Reference motion of free bodies: the planned state of a ball, raft or ladder, used instead of the measured one.

While feet stand both on the ground and on a body, feet that followed the measured body would let it drift anywhere. And
feet that are to push a body have to move ahead of it. In such stages the body's frames move with its reference.
"""

from dataclasses import dataclass, field

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from sweep.controllers.layers import TrackerLayer
from sweep.controllers.plan import ALONGSIDE, KEPT, TO_POSE, Plan, SupportMotion
from sweep.core.rotations import conjugate, exponential, heading, logarithm, multiply, rotation_about_vertical
from sweep.formulas import stepping
from sweep.models.obstacles.surface import FreeBodyState
from sweep.models.posture import Stance

LOWEST = (-np.inf, -np.inf, 0.0)  # m/s, least velocity of a body on a floor


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class FreeBodyReferenceMotion(TrackerLayer):
    """Tracker layer that gives the reference motion of k free bodies (balls, rafts) in each of S stages.

    The state is the bodies' state at the start of the stage. Made by `compile_plan`.
    """

    support: SupportMotion  # leading axes (s, k)
    # whether the bodies float: height and tilt are then always as measured
    afloat: bool = field(metadata={"static": True})

    def init_state(self, start: Stance, joints: Float[Array, "6 3"], free: FreeBodyState) -> FreeBodyState:
        """Return the layer's state before the first tick: the states of the free bodies at the start."""
        return free

    def free_body_reference(
        self, plan: Plan, state: FreeBodyState, stage: Int[Array, ""], clock: Float[Array, ""], free: FreeBodyState
    ) -> FreeBodyState:
        """Return the reference state of the free bodies at time `clock` (s) of the stage."""
        support = jax.tree.map(lambda x: x[stage], self.support)
        return (floating_body_reference_state if self.afloat else free_body_reference_state)(
            support, state, free, clock, plan.duration[stage]
        )

    def on_stage_enter(
        self, stage: Int[Array, ""], state: FreeBodyState, last_free: FreeBodyState, free: FreeBodyState
    ) -> tuple[FreeBodyState, FreeBodyState]:
        """Start the reference at the measured bodies, or where it ended in the last stage if this stage says `KEPT`."""
        kept = jnp.asarray(self.support.mode)[stage] == KEPT
        start = FreeBodyState(*[jnp.where(kept[:, None], a, b) for a, b in zip(last_free, free, strict=True)])
        return start, start


def free_body_reference_state(
    support: SupportMotion, start: FreeBodyState, measured: FreeBodyState, clock: Array, duration: Array
) -> FreeBodyState:
    """Return the reference state of free bodies at time `clock` (s) of a stage; they rest after its duration.

    Args:
        support: reference motion of each body, leading axis k.
        start: state of the bodies at the start of the stage, world axes.
        measured: measured state of the bodies, world axes.
        clock: s since the stage started.
        duration: of the stage (s).
    """
    time = jnp.minimum(clock, duration)
    share = time / duration
    first = jnp.maximum(start.velocity, jnp.asarray(LOWEST))
    goes, turns = (end - begin for end, begin in ((support.velocity, first), (support.turn, start.turn)))
    to_velocity = FreeBodyState(
        start.position + time * (first + 0.5 * share * goes),
        multiply(exponential(time * (start.turn + 0.5 * share * turns)), start.quat),
        first + share * goes,
        start.turn + share * turns,
    )
    done, rate = stepping.trapezoidal_transfer_timing(share, 0.0, 1.0)
    shift, turn = (
        support.position - start.position,
        logarithm(multiply(jnp.asarray(support.quat), conjugate(start.quat))),
    )
    to_pose = FreeBodyState(
        start.position + done * shift,
        multiply(exponential(done * turn), start.quat),
        rate / duration * shift,
        rate / duration * turn,
    )
    moved, turned = measured.position - start.position, logarithm(multiply(measured.quat, conjugate(start.quat)))
    together = FreeBodyState(
        start.position + jnp.mean(moved, axis=0),
        multiply(exponential(jnp.broadcast_to(jnp.mean(turned, axis=0), turned.shape)), start.quat),
        jnp.broadcast_to(jnp.mean(measured.velocity, axis=0), measured.velocity.shape),
        jnp.broadcast_to(jnp.mean(measured.turn, axis=0), measured.turn.shape),
    )

    kept = start._replace(velocity=jnp.zeros_like(start.velocity), turn=jnp.zeros_like(start.turn))

    def select(*parts: Array) -> Array:
        mode = jnp.broadcast_to(jnp.asarray(support.mode)[..., None], parts[0].shape)
        return jnp.select([mode == k for k in range(KEPT)], parts[:KEPT], parts[KEPT])

    return FreeBodyState(
        *[select(*parts) for parts in zip(measured, to_velocity, to_pose, together, kept, strict=True)]
    )


def floating_body_reference_state(
    support: SupportMotion, start: FreeBodyState, measured: FreeBodyState, clock: Array, duration: Array
) -> FreeBodyState:
    """Return the reference state of floating bodies: horizontal motion and heading as planned, the rest as measured.

    For `ALONGSIDE` bodies, y and height of the pose to reach are those at the start of the stage.

    Args:
        support: reference motion of each body, leading axis k.
        start: state of the bodies at the start of the stage, world axes.
        measured: measured state of the bodies, world axes.
        clock: s since the stage started.
        duration: of the stage (s).
    """
    alongside = jnp.asarray(support.mode) == ALONGSIDE
    kept = alongside[..., None] & (np.arange(3) > 0)
    position = jnp.where(kept, start.position, support.position)
    support = support._replace(mode=jnp.where(alongside, TO_POSE, support.mode), position=position)
    plane = free_body_reference_state(support, start, measured, clock, duration)
    ahead = jax.vmap(heading)(multiply(plane.quat, conjugate(measured.quat)))
    upright = np.array([False, False, True])
    return FreeBodyState(
        jnp.where(upright, measured.position, plane.position),
        multiply(jax.vmap(rotation_about_vertical)(ahead), measured.quat),
        jnp.where(upright, measured.velocity, plane.velocity),
        jnp.where(upright, plane.turn, measured.turn),
    )

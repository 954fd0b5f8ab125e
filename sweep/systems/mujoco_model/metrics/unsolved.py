"""Steps that the contact solver left unsolved."""

import numpy as np

from sweep.core.metric import array_namespace
from sweep.systems.mujoco_model.tick import Array, make_step_share_metric

BALANCE_FIELDS = (
    "qacc",
    "qfrc_smooth",
    "qfrc_constraint",
)  # recorded of each step for `find_unbalanced_steps`, beside M
MAX_IMBALANCE_SHARE = 0.01  # share of the forces, up to which those of a step are in balance


@np.errstate(invalid="ignore", over="ignore")
def find_unbalanced_steps(mass: Array, qacc: Array, smooth: Array, constraint: Array) -> Array:
    """Return in which physics steps forces and accelerations do not balance: M a differs from f + Jᵀλ.

    Each component counts by its own inertia, M's diagonal, so that forces and moments are both in √kg m/s². What is
    left over is the gradient of what the solver minimizes, and 0 at its minimum.

    Args:
        mass: M (..., nv, nv).
        qacc: Accelerations a (..., nv).
        smooth: Forces f (..., nv).
        constraint: Forces of constraints Jᵀλ (..., nv).
    """
    xp = array_namespace(mass)
    left = (mass @ qacc[..., None])[..., 0] - smooth - constraint
    inertia = xp.diagonal(mass, axis1=-2, axis2=-1)
    left, smooth, constraint = (xp.sqrt((one**2 / inertia).sum(axis=-1)) for one in (left, smooth, constraint))
    return left > MAX_IMBALANCE_SHARE * (smooth + constraint)


METRIC = make_step_share_metric(
    lambda ctx: ctx.steps["unsolved"].sum(axis=1),
    "unsolved_share",
    "share of the steps that the contact solver left unsolved",
)

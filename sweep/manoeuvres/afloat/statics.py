"""Check that a raft carries its robot (monograph 4.1.1)."""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from sweep.core.constants import GRAVITY
from sweep.core.errors import InputError
from sweep.formulas.raft_statics import raft_equilibrium
from sweep.fused.numbers import evaluate_with_numpy
from sweep.models.case import Case
from sweep.models.obstacles.charts import stack_components
from sweep.models.obstacles.raft import CORNER_SIGNS, WATER_DENSITY, Raft
from sweep.models.robot import total_mass
from sweep.planning.validation import are_plain_numbers


def freeboard_and_draught(
    belief: Case, offset: tuple[Array | float, Array | float], height: Array | float
) -> tuple[Array, Array]:
    """Return the least freeboard of the deck's corners and the least draught of the bottom's corners (m); NaN if the
    raft capsizes.

    Args:
        belief: has raft and robot.
        offset: robot's mass centre ahead and to the left of the raft's middle (m).
        height: of the mass centre above the deck (m).
    """
    raft, load = belief.obstacle_of_type(Raft), total_mass(belief.robot)
    a, b, d = raft.half_size
    mass = raft.mass + load
    place = load / mass * stack_components(*offset, d + height)
    rest = raft_equilibrium(GRAVITY * mass, place, a, b, d, WATER_DENSITY * GRAVITY)
    corners = jnp.stack([x * a * rest.a31 + y * b * rest.a32 for x, y in CORNER_SIGNS])
    freeboard = d * rest.a33 - rest.depth
    return freeboard + jnp.min(corners), 2 * d * rest.a33 - freeboard - jnp.max(corners)


def require_floating(belief: Case, offset: tuple[float, float]) -> None:
    """Raise an error if the raft capsizes or dips a corner under the robot; skip the check under JAX tracing.

    Args:
        belief: has raft and robot.
        offset: robot's mass centre ahead and to the left of the raft's middle (m).

    Raises:
        InputError: the raft capsizes, a corner is under water, or one is lifted out of it.
    """
    if not are_plain_numbers(belief.robot, belief.obstacle, belief.manoeuvre):
        return
    freeboard, draught = map(
        float, evaluate_with_numpy(lambda: freeboard_and_draught(belief, offset, 0.5 * belief.robot.body_length))
    )
    if freeboard > 0 and draught > 0:
        return
    ends = "capsizes" if np.isnan(freeboard) else f"has a corner {-1e3 * freeboard:.0f} mm under water"
    if freeboard > 0:
        ends = f"lifts a corner {-1e3 * draught:.0f} mm out of the water"
    raise InputError(
        f"obstacle.density = {belief.obstacle_of_type(Raft).density:g} is not allowed: the raft {ends} under the robot "
        f"of {total_mass(belief.robot):g} kg, {offset[0]:.2f} m ahead and {offset[1]:.2f} m to the left of its middle"
    )

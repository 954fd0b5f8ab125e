"""Crossing on a raft: the push that reaches the other bank, and how far the raft turns until then, monograph 4.3."""

from typing import Annotated, NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float

from sweep.formulas.formula import Input, Scalar, formula, positive_input


class RaftCrossing(NamedTuple):
    """Result of `crossing`: speed (m/s) and turn rate (rad/s) after the push, heading (rad) and time (s) of arrival."""

    v0: Annotated[Float[Array, "..."], "m/s"]
    w0: Annotated[Float[Array, "..."], "rad/s"]
    yaw: Annotated[Float[Array, "..."], "rad"]
    time: Annotated[Float[Array, "..."], "s"]


@formula(
    "monograph",
    "4.3.1",
    correction="(4.3.1) has (M + m)/h for (M + m)^2 h/J and diverges for a centred push",
    condition="S must be at least sigma",
)
def crossing(
    S: Annotated[Scalar, positive_input("m", 5.46)],
    sigma: Annotated[Scalar, positive_input("m", 3.15)],
    v_eps: Annotated[Scalar, positive_input("m/s", 0.1)],
    mt: Annotated[Scalar, positive_input("kg", 660.0)],
    al2: Annotated[Scalar, positive_input("kg/m", 100.0)],
    J: Annotated[Scalar, positive_input("kg*m^2", 790.0)],
    al3: Annotated[Scalar, positive_input("kg*m^2", 100.0)],
    h: Annotated[Scalar, Input("m", 0.1)],
) -> RaftCrossing:
    """Push-off speed of a raft, its turn and the time to the other bank.

    The raft coasts against quadratic drag. Its turn starts with J w0 = mt v0 h.

    Args:
        S: distance of the banks (m).
        sigma: length of the raft (m).
        v_eps: speed of arrival (m/s).
        mt: mass of raft and robot (kg).
        al2: drag coefficient of the motion ahead (kg/m).
        J: moment of inertia about the vertical (kg m^2).
        al3: drag coefficient of the turn (kg m^2).
        h: distance of the push's line from the centre (m).

    Returns:
        Speed and rate of turn after the push, heading and time of arrival; nan if the raft is longer than S.
    """
    stretch = al2 * jnp.where(sigma <= S, S - sigma, jnp.nan) / mt
    v0 = v_eps * jnp.exp(stretch)
    w0 = mt * v0 * h / J
    time = mt / (al2 * v0) * jnp.expm1(stretch)
    yaw = jnp.sign(h) * J / al3 * jnp.log1p(al3 * jnp.abs(w0) * time / J)
    return RaftCrossing(v0, w0, yaw, time)

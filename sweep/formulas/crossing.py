"""Crossing on a raft: the push that reaches the other bank, and how far the raft turns until then, monograph 4.3."""

from typing import Annotated, NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float

from sweep.formulas.formula import Input, Scalar, formula, positive


class Crossing(NamedTuple):
    """Speed (m/s) and rate of turn (rad/s) after the push, heading (rad) and time (s) of arrival."""

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
    S: Annotated[Scalar, positive("m", 5.46)],
    sigma: Annotated[Scalar, positive("m", 3.15)],
    v_eps: Annotated[Scalar, positive("m/s", 0.1)],
    mt: Annotated[Scalar, positive("kg", 660.0)],
    al2: Annotated[Scalar, positive("kg/m", 100.0)],
    J: Annotated[Scalar, positive("kg*m^2", 790.0)],
    al3: Annotated[Scalar, positive("kg*m^2", 100.0)],
    h: Annotated[Scalar, Input("m", 0.1)],
) -> Crossing:
    """Push-off speed of a raft, its turn and the time to the other bank.

    Coasting of a raft with quadratic drag.

    Banks S apart, raft sigma long (m), landing speed v_eps (m/s), mass mt of raft and robot (kg), drag al2 (kg/m)
    and al3 (kg m^2), moment of inertia J (kg m^2), push along a line that passes the centre at h (m): J w0 = mt v0 h.
    Nan if the raft is longer than the water is wide.
    """
    stretch = al2 * jnp.where(sigma <= S, S - sigma, jnp.nan) / mt
    v0 = v_eps * jnp.exp(stretch)
    w0 = mt * v0 * h / J
    time = mt / (al2 * v0) * jnp.expm1(stretch)
    yaw = jnp.sign(h) * J / al3 * jnp.log1p(al3 * jnp.abs(w0) * time / J)
    return Crossing(v0, w0, yaw, time)

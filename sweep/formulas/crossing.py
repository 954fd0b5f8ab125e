"""Crossing on a raft: the push that reaches the other bank, and how far the raft turns until then, monograph 4.3."""

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float

from sweep.formulas.formula import Formula, Input, Scalar, positive


class Crossing(NamedTuple):
    """Speed (m/s) and rate of turn (rad/s) after the push, heading (rad) and time (s) of arrival."""

    v0: Float[Array, "..."]
    w0: Float[Array, "..."]
    yaw: Float[Array, "..."]
    time: Float[Array, "..."]


def crossing(
    S: Scalar, sigma: Scalar, v_eps: Scalar, mt: Scalar, al2: Scalar, J: Scalar, al3: Scalar, h: Scalar
) -> Crossing:
    """Coasting of a raft with quadratic drag: monograph 4.3.3 and (4.3.1).

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


FORMULAS = (
    Formula(
        "crossing",
        "push-off speed of a raft, its turn and the time to the other bank",
        "monograph",
        ("4.3.1",),
        crossing,
        (
            positive("S", "m", 5.46),
            positive("sigma", "m", 3.15),
            positive("v_eps", "m/s", 0.1),
            positive("mt", "kg", 660.0),
            positive("al2", "kg/m", 100.0),
            positive("J", "kg*m^2", 790.0),
            positive("al3", "kg*m^2", 100.0),
            Input("h", "m", 0.1),
        ),
        {"v0": "m/s", "w0": "rad/s", "yaw": "rad", "time": "s"},
        correction="(4.3.1) has (M + m)/h for (M + m)^2 h/J and diverges for a centred push",
        condition="S must be at least sigma",
    ),
)

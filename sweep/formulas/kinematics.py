"""Formulas of the leg's kinematics (module `leg`) and of step cycles (module `stepping`)."""

from typing import Annotated, NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from sweep.formulas import leg as legs
from sweep.formulas import stepping
from sweep.formulas.formula import Input, Scalar, formula, positive_input

LegNumber = Annotated[int, Input("", 6, options=(1, 2, 3, 4, 5, 6))]
Coxa = Annotated[Scalar, Input("m", 0.0, at_least=0)]
Thigh = Annotated[Scalar, positive_input("m", 0.52)]
Shin = Annotated[Scalar, positive_input("m", 0.335)]


def _side(leg: int) -> Array:
    return jnp.asarray(legs.SIDE_BY_LEG[leg - 1])


class FootPosition(NamedTuple):
    """Result of `leg_fk`: position of the foot relative to its hip, base axes."""

    foot: Annotated[Float[Array, "... 3"], "m"]


@formula("monograph", "1.1.1", "1.1.4")
def leg_fk(
    leg: LegNumber,
    angles: Annotated[Float[Array, "... 3"], Input("rad", (0.0, 2.0, 1.0))],
    l0: Coxa,
    l1: Thigh,
    l2: Shin,
) -> FootPosition:
    """Foot of a leg from its joint angles."""
    return FootPosition(legs.forward_kinematics(_side(leg), angles, l0, l1, l2))


class JointAngles(NamedTuple):
    """Result of `leg_ik`: joint angles with the knee on the outer and on the inner side, and whether the foot is on the
    inner side."""

    angles: Annotated[Float[Array, "... 3"], "rad"]
    mirror_knee_angles: Annotated[Float[Array, "... 3"], "rad"]
    inner_side: Annotated[Bool[Array, "..."], ""]


@formula(
    "monograph",
    "1.1.2-1.1.3",
    correction="(1.1.3) misses a foot on the inner side of its hip, and any foot if l0 > 0",
    condition="the foot must be in reach of the leg",
)
def leg_ik(
    leg: LegNumber, q: Annotated[Float[Array, "... 3"], Input("m", (0.1, 0.4, -0.3))], l0: Coxa, l1: Thigh, l2: Shin
) -> JointAngles:
    """Joint angles of a leg from its foot, knee outside or (mirror) inside."""
    side = _side(leg)
    outside, miss = legs.inverse_kinematics(side, q, l0, l1, l2)
    inside, _ = legs.inverse_kinematics(side, q, l0, l1, l2, mirror=True)
    reached = jnp.where(miss[..., None] > 0, jnp.nan, 1.0)
    return JointAngles(outside * reached, inside * reached, side * q[..., 1] < 0)


class HipPositions(NamedTuple):
    """Result of `mounts`: positions of the hips of legs 1 to 6, in base axes."""

    points: Annotated[Float[Array, "6 3"], "m"]


@formula("monograph", "1.1.5-1.1.6")
def mounts(b_p: Annotated[Scalar, positive_input("m", 0.525)]) -> HipPositions:
    """Hip positions of six legs on a circle."""
    return HipPositions(legs.circular_hip_positions(b_p))


class StepCycleFootPosition(NamedTuple):
    """Result of `step_cycle`: position of the foot in the axes of its step cycle."""

    xy: Annotated[Float[Array, "... 2"], "m"]


@formula(
    "monograph",
    "1.3.1-1.3.2",
    correction="cycle b turns at pi/t*; kprime = 1 stands for 2 t*; x* is positive",
)
def step_cycle(
    cycle: Annotated[str, Input("", "a", options=("a", "b"))],
    t: Annotated[Scalar, Input("s", 0.5, at_least=0)],
    tstar: Annotated[Scalar, positive_input("s", 1.2156)],
    d_x: Annotated[Scalar, positive_input("m", 0.1)],
    d_y: Annotated[Scalar, positive_input("m", 0.08)],
    kprime: Annotated[int, Input("", 2, options=(1, 2))],
    period: Annotated[Scalar, Input("s", 0.0, at_least=0)],
) -> StepCycleFootPosition:
    """Foot position in a step cycle of swing and stance (period 0: the period that follows from kprime)."""
    full = jnp.where(jnp.asarray(period) > 0, period, tstar * (1 + 2 / kprime))
    return StepCycleFootPosition(stepping.step_cycle(cycle, t % full, tstar, d_x, d_y, kprime))


class TransferProgress(NamedTuple):
    """Result of `lambda1`: share of a swing's path that the foot has covered, and the rate of that share (1/s)."""

    lam: Annotated[Float[Array, "..."], ""]
    dlam: Annotated[Float[Array, "..."], "1/s"]


@formula("monograph", "1.3.3", correction="w = 1/[sigma (sigma2 t* - sigma)], printed for sigma2 = 1 only")
def lambda1(
    t: Annotated[Scalar, Input("s", 0.6)],
    t0: Annotated[Scalar, Input("s", 0.0)],
    tstar: Annotated[Scalar, positive_input("s", 1.2156)],
    sigma2: Annotated[Scalar, Input("", 1.0, at_least=0.5, at_most=1)],
) -> TransferProgress:
    """Share of an irregular swing's path that is covered at a time, and its rate."""
    return TransferProgress(*stepping.trapezoidal_transfer_timing(t, t0, tstar, sigma2))

"""All formulas by name, those of the leg and of the step cycles described here."""

from collections.abc import Mapping
from typing import Any, NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from sweep.core.parameters import InputError, suggest
from sweep.formulas import (
    ball,
    ball_reach,
    corner,
    crossing,
    drag,
    drive,
    ladder,
    mass_centre,
    raft_drift,
    raft_dynamics,
    raft_statics,
    stepping,
    thesis,
)
from sweep.formulas import leg as legs
from sweep.formulas.formula import Formula, Input, Scalar, positive


def _side(leg: int) -> Array:
    return jnp.asarray(legs.SIDE[leg - 1])


class Foot(NamedTuple):
    """Foot from the hip (m, body axes)."""

    foot: Float[Array, "... 3"]


def _leg_fk(leg: int, angles: Array, l0: Scalar, l1: Scalar, l2: Scalar) -> Foot:
    return Foot(legs.fk(_side(leg), angles, l0, l1, l2))


class JointAngles(NamedTuple):
    """Angles (rad) with the knee outside and, for a foot on the inner side, inside."""

    angles: Float[Array, "... 3"]
    mirror_knee_angles: Float[Array, "... 3"]
    inner_side: Bool[Array, "..."]


def _leg_ik(leg: int, q: Array, l0: Scalar, l1: Scalar, l2: Scalar) -> JointAngles:
    side = _side(leg)
    outside, miss = legs.ik(side, q, l0, l1, l2)
    inside, _ = legs.ik(side, q, l0, l1, l2, mirror=True)
    reached = jnp.where(miss[..., None] > 0, jnp.nan, 1.0)
    return JointAngles(outside * reached, inside * reached, side * q[..., 1] < 0)


class Mounts(NamedTuple):
    """Hips of legs 1 to 6 (m, body axes)."""

    points: Float[Array, "6 3"]


def _mounts(b_p: Scalar) -> Mounts:
    return Mounts(legs.circular_mounts(b_p))


class Cycle(NamedTuple):
    """Foot in the axes of its cycle (m)."""

    xy: Float[Array, "... 2"]


def _step_cycle(cycle: str, t: Scalar, tstar: Scalar, d_x: Scalar, d_y: Scalar, kprime: int, period: Scalar) -> Cycle:
    full = jnp.where(jnp.asarray(period) > 0, period, tstar * (1 + 2 / kprime))
    return Cycle(stepping.step_cycle(cycle, t % full, tstar, d_x, d_y, kprime))


class Blend(NamedTuple):
    """Share of the way, and its rate (1/s)."""

    lam: Float[Array, "..."]
    dlam: Float[Array, "..."]


def _lambda1(t: Scalar, t0: Scalar, tstar: Scalar, sigma2: Scalar) -> Blend:
    return Blend(*stepping.lambda_1(t, t0, tstar, sigma2))


_LEG = Input("leg", "", 6, options=(1, 2, 3, 4, 5, 6))
_LINKS = (Input("l0", "m", 0.0, at_least=0), positive("l1", "m", 0.52), positive("l2", "m", 0.335))

_LEGS = (
    Formula(
        "leg_fk",
        "foot of a leg from its joint angles",
        "monograph",
        ("1.1.1", "1.1.4"),
        _leg_fk,
        (_LEG, Input("angles", "rad", (0.0, 2.0, 1.0)), *_LINKS),
        {"foot": "m"},
    ),
    Formula(
        "leg_ik",
        "joint angles of a leg from its foot, knee outside or (mirror) inside",
        "monograph",
        ("1.1.2-1.1.3",),
        _leg_ik,
        (_LEG, Input("q", "m", (0.1, 0.4, -0.3)), *_LINKS),
        {"angles": "rad", "mirror_knee_angles": "rad", "inner_side": ""},
        correction="(1.1.3) misses a foot on the inner side of its hip, and any foot if l0 > 0",
        condition="the foot must be in reach of the leg",
    ),
    Formula(
        "mounts",
        "hips of the six legs on a circle",
        "monograph",
        ("1.1.5-1.1.6",),
        _mounts,
        (positive("b_p", "m", 0.525),),
        {"points": "m"},
    ),
    Formula(
        "step_cycle",
        "foot in a step cycle, swing and stance (period 0: that of kprime)",
        "monograph",
        ("1.3.1-1.3.2",),
        _step_cycle,
        (
            Input("cycle", "", "a", options=("a", "b")),
            Input("t", "s", 0.5, at_least=0),
            positive("tstar", "s", 1.2156),
            positive("d_x", "m", 0.1),
            positive("d_y", "m", 0.08),
            Input("kprime", "", 2, options=(1, 2)),
            Input("period", "s", 0.0, at_least=0),
        ),
        {"xy": "m"},
        correction="cycle b turns at pi/t*; kprime = 1 stands for 2 t*; x* is positive",
    ),
    Formula(
        "lambda1",
        "share of an irregular transfer done at a time, and its rate",
        "monograph",
        ("1.3.3",),
        _lambda1,
        (
            Input("t", "s", 0.6),
            Input("t0", "s", 0.0),
            positive("tstar", "s", 1.2156),
            Input("sigma2", "", 1.0, at_least=0.5, at_most=1),
        ),
        {"lam": "", "dlam": "1/s"},
        correction="w = 1/[sigma (sigma2 t* - sigma)], printed for sigma2 = 1 only",
    ),
)

FORMULAS: Mapping[str, Formula] = {
    formula.name: formula
    for formula in (
        *_LEGS,
        *drive.FORMULAS,
        *corner.FORMULAS,
        *ladder.FORMULAS,
        *ball.FORMULAS,
        *mass_centre.FORMULAS,
        *ball_reach.FORMULAS,
        *raft_statics.FORMULAS,
        *drag.FORMULAS,
        *raft_dynamics.FORMULAS,
        *raft_drift.FORMULAS,
        *crossing.FORMULAS,
        *thesis.FORMULAS,
    )
}


def find(name: str) -> Formula:
    """The formula called `name`; raises `InputError` with what is allowed."""
    if name not in FORMULAS:
        raise InputError(f"formula {name} is unknown{suggest(name, FORMULAS)}")
    return FORMULAS[name]


def evaluate(name: str, inputs: Mapping[str, Any]) -> dict[str, Any]:
    """Outputs of formula `name` as plain numbers and lists; inputs left out take their defaults.

    In double precision, whatever JAX's default is. Raises `InputError`: an unknown name, an input outside its
    domain, or inputs for which the formula has no solution (`NoSolution`).
    """
    return find(name).evaluate(inputs)


def covering(equation: str) -> list[Formula]:
    """Formulas that hold equation `equation` ("2.1.6" of the monograph, "14" of the thesis)."""
    return [formula for formula in FORMULAS.values() if formula.covers(equation)]

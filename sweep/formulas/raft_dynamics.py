"""A raft moving on still water, and small motions about its rest: monograph 4.2.

Position r of the centre (m; z up from the water plane), rotation R (body to world), velocity v (m/s, world), angular
velocity w (rad/s, body). The state is these in a row, R by rows: 3 + 9 + 3 + 3 numbers. The kinematics are those of
e3 fixed in space; (4.2.1) and (4.2.3) print every sign of them the other way round.
"""

from collections.abc import Callable
from typing import Annotated, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from sweep.formulas.drag import raft_drag
from sweep.formulas.formula import Input, Scalar, formula, positive_input
from sweep.formulas.raft_statics import HalfHeight, HalfLength, HalfWidth, WaterWeight, buoyancy

_LEVEL = (1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0)

MAX_STEPS = 2**14
# of Dormand and Prince (1980): the weights of the slopes before each stage, and of the difference of both orders
STAGE_WEIGHTS = (
    (1 / 5,),
    (3 / 40, 9 / 40),
    (44 / 45, -56 / 15, 32 / 9),
    (19372 / 6561, -25360 / 2187, 64448 / 6561, -212 / 729),
    (9017 / 3168, -355 / 33, 46732 / 5247, 49 / 176, -5103 / 18656),
    (35 / 384, 0.0, 500 / 1113, 125 / 192, -2187 / 6784, 11 / 84),
)
ERROR_WEIGHTS = (71 / 57600, 0.0, -71 / 16695, 71 / 1920, -17253 / 339200, 22 / 525, -1 / 40)


class RaftBody(NamedTuple):
    """Parameters of a raft with its load: geometry, water, drag, mass and weight.

    Half sides a, b, d (m), specific weight of water gamma (N/m^3), waterline zeta0 over the centre at rest (m). P (N)
    is the weight of raft and load, acting at `rs` (m, body axes); M (kg) is the mass and J (kg m^2) the moments of
    inertia.
    """

    a: HalfLength
    b: HalfWidth
    d: HalfHeight
    gamma: WaterWeight
    zeta0: Annotated[Scalar, Input("m", -0.005)]
    k_lin: Annotated[Scalar, Input("N*s/m^3", 20.0, at_least=0)]
    k_quad: Annotated[Scalar, Input("N*s^2/m^4", 500.0, at_least=0)]
    P: Annotated[Scalar, positive_input("N", 6489.3)]
    M: Annotated[Scalar, positive_input("kg", 661.5)]
    J: Annotated[Float[Array, " 3"], Input("kg*m^2", (245.5, 549.4, 790.1), above=0)]
    rs: Annotated[Float[Array, " 3"], Input("m", (0.0, 0.0, 0.03))]


def raft_wrench(
    raft: RaftBody, z: Scalar, R: Float[Array, "3 3"], v: Float[Array, " 3"], w: Float[Array, " 3"]
) -> tuple[Float[Array, " 3"], Float[Array, " 3"]]:
    """Force and torque of buoyancy, drag and weight on a raft in motion: monograph (4.2.1).

    Args:
        raft: The raft and its load.
        z: Height of the centre over the water plane (m).
        R: Rotation from body to world axes.
        v: Velocity of the centre (m/s, world axes).
        w: Angular velocity (rad/s, body axes).

    Returns:
        Force (N, world axes) and moment about the centre (N m, body axes).
    """
    a3 = R[2]  # the vertical in body axes
    water = buoyancy(a3, -z, raft.a, raft.b, raft.d, raft.gamma)
    drag = raft_drag(R.T @ v, w, raft.a, raft.b, raft.d, raft.zeta0, raft.k_lin, raft.k_quad)
    weight = -raft.P * a3
    return R @ (water.F + drag.R + weight), water.M + drag.N + jnp.cross(raft.rs, weight)


class RaftLinearization(NamedTuple):
    """Linearised forces (rows x, y, z, world axes) and moments (body axes) of a raft by its position, rotation and
    rates (columns)."""

    matrix: Annotated[Float[Array, "6 12"], "SI"]


@formula(
    "monograph",
    "4.2.7-4.2.11",
    "4.2.20-4.2.21",
    correction="h14 = b15 = 4 k a b d, b14 = 4 k a b d^2, h34 = 0; b31 = -M_y0, b32 = M_x0; 12 (zeta^2 - d^2)",
)
@jax.jit
def raft_linear(raft: RaftBody) -> RaftLinearization:
    """Forces and moments on a raft per unit of a small motion.

    Coefficients of (4.2.7) about the level raft at rest (SI units).

    Differentiates `raft_wrench`: friction of the bottom acts at the depth d, so that h14 = 4 k a b d and heave is not
    damped in first order; the load turns with the raft.
    """

    def at(motion: Float[Array, " 12"]) -> Float[Array, " 6"]:
        shift, turn, v, w = jnp.split(motion, 4)
        return jnp.concatenate(raft_wrench(raft, shift[2] - raft.zeta0, jnp.eye(3) + _cross(turn), v, w))

    return RaftLinearization(jax.jacfwd(at)(jnp.zeros(12)))


def _cross(vector: Float[Array, " 3"]) -> Float[Array, "3 3"]:
    """Matrix of the cross product with `vector` from the left."""
    return jnp.cross(vector, jnp.eye(3), axisb=0, axisc=0)


class RaftModes(NamedTuple):
    """Result of `raft_modes`: poles of the linear motion (1/s), and whether none of them grows."""

    poles_re: Annotated[Float[Array, " 12"], "1/s"]
    poles_im: Annotated[Float[Array, " 12"], "1/s"]
    stable: Annotated[Array, ""]


@formula(
    "monograph", "4.1.27", "4.2.12-4.2.15", correction="coefficients of (4.2.8); indices and the factor P in (4.1.27)"
)
def raft_modes(raft: RaftBody) -> RaftModes:
    """Poles of a raft's small motions, and whether any motion grows.

    Answers (4.2.10)-(4.2.15) by eigenvalues. Position and heading have poles at 0 (neutral), heave oscillates undamped;
    roll and pitch die out if the raft is stable and the water brakes it (k_lin > 0).
    """
    mass = jnp.concatenate([jnp.full(3, raft.M), jnp.asarray(raft.J)])
    motion = jnp.concatenate([jnp.eye(6, 12, 6), raft_linear(raft).matrix / mass[:, None]])
    poles = jnp.linalg.eigvals(motion)
    # A double zero comes out as +-sqrt(round-off).
    slack = 10 * jnp.sqrt(jnp.finfo(poles.real.dtype).eps) * jnp.abs(poles).max()
    return RaftModes(poles.real, poles.imag, poles.real.max() < slack)


class RaftEndState(NamedTuple):
    """Result of `raft_ode`: the state of the raft at the end of its motion."""

    state: Annotated[Float[Array, " 18"], "SI"]


@formula(
    "monograph",
    "4.2.1-4.2.6",
    correction="every sign of the kinematics of (4.2.1), (4.2.3); 2 (zeta^2 - d^2) in (4.2.2)",
    condition="the motion must stay in the range of the model (no capsizing) and t_end be reasonable",
)
@jax.jit
def raft_ode(
    prm: RaftBody,
    state0: Annotated[Float[Array, " 18"], Input("SI", (0.0, 0.0, 0.0, *_LEVEL, 0.2, 0.0, 0.0, 0.0, 0.0, 0.05))],
    t_end: Annotated[Scalar, positive_input("s", 1.5)],
) -> RaftEndState:
    """State of a moving raft (position r, rotation R by rows, velocity v, angular velocity w) after some time.

    (4.2.1)-(4.2.3) integrated over t_end (s). Nan if the integration does not get there.
    """
    state0 = jnp.asarray(state0)
    # Well above round-off, well below what the model is good for.
    accuracy = float(jnp.finfo(state0.dtype).eps) ** (2 / 3)
    return RaftEndState(integrate_dormand_prince(lambda state: state_derivative(prm, state), state0, t_end, accuracy))


def integrate_dormand_prince(
    rate: Callable[[Array], Array], start: Float[Array, " n"], end: Scalar, accuracy: float
) -> Float[Array, " n"]:
    """Integrate y' = rate(y) by the method of Dormand and Prince, of order 5.

    The error of a step is estimated by the embedded method of order 4.

    Args:
        rate: The derivative of y.
        start: y at time 0.
        end: Time to integrate to, in the unit of `rate`.
        accuracy: Largest error of a step, relative and absolute.

    Returns:
        y at the time `end`; nan after `MAX_STEPS` steps.
    """
    end = jnp.asarray(end, start.dtype)

    def step(carry: tuple[Array, ...]) -> tuple[Array, ...]:
        time, y, size, number = carry
        last = size >= end - time
        size = jnp.minimum(size, end - time)
        slopes = [rate(y)]
        for weights in STAGE_WEIGHTS:
            slopes.append(rate(y + size * sum(w * k for w, k in zip(weights, slopes, strict=True))))
        new = y + size * sum(w * k for w, k in zip(STAGE_WEIGHTS[-1], slopes, strict=False))
        error = size * sum(w * k for w, k in zip(ERROR_WEIGHTS, slopes, strict=True))
        allowed = accuracy * (1 + jnp.maximum(jnp.abs(y), jnp.abs(new)))
        off = jnp.nan_to_num(jnp.sqrt(jnp.mean((error / allowed) ** 2)), nan=jnp.inf)
        taken = off <= 1
        after, next_size = jnp.where(last, end, time + size), size * jnp.clip(0.9 * off**-0.2, 0.2, 10)
        return jnp.where(taken, after, time), jnp.where(taken, new, y), next_size, number + 1

    first = jnp.zeros_like(end), start, end / 100, jnp.asarray(0)
    time, y, _, _ = jax.lax.while_loop(lambda carry: (carry[0] < end) & (carry[3] < MAX_STEPS), step, first)
    return jnp.where(time >= end, y, jnp.nan)


def state_derivative(raft: RaftBody, state: Float[Array, " 18"]) -> Float[Array, " 18"]:
    """Time derivative of a raft's state (r, R by rows, v, w): monograph (4.2.1), (4.2.3)."""
    r, R, v, w = split_raft_state(state)
    force, moment = raft_wrench(raft, r[2], R, v, w)
    spin = (moment - jnp.cross(w, raft.J * w)) / raft.J
    return jnp.concatenate([v, (R @ _cross(w)).ravel(), force / raft.M, spin])


def split_raft_state(state: Float[Array, " 18"]) -> tuple[Array, Array, Array, Array]:
    """Split a state into position (3,), rotation (3, 3), velocity (3,) and angular velocity (3,)."""
    return state[:3], state[3:12].reshape(3, 3), state[12:15], state[15:]

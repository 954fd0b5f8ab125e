"""Conserved and dissipated quantities of a raft's motion, which check `raft_ode` and the simulated raft."""

from jaxtyping import Array, Float

from sweep.formulas.raft_dynamics import RaftBody, split_raft_state


def energy(raft: RaftBody, state: Float[Array, " 18"]) -> Float[Array, ""]:
    """Kinetic energy plus that of the load's height and of the displaced water (J); drag alone takes from it."""
    r, R, v, w = split_raft_state(state)
    a31, a32, a33 = R[2]
    area, cut = 4 * raft.a * raft.b, -r[2] / a33
    wet = (cut + raft.d) ** 2 + ((a31 * raft.a) ** 2 + (a32 * raft.b) ** 2) / (3 * a33**2)
    moving = (raft.M * v @ v + w @ (raft.J * w)) / 2
    return moving + raft.P * (r[2] + R[2] @ raft.rs) + raft.gamma * area * a33 * wet / 2


def vertical_momentum(raft: RaftBody, state: Float[Array, " 18"]) -> Float[Array, ""]:
    """Angular momentum about the vertical (N m s), kept without drag: (4.2.4), p q r for the misprinted rho."""
    _, R, _, w = split_raft_state(state)
    return R[2] @ (raft.J * w)

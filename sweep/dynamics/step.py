"""One physics step: clamped drives (1.2.1) and foot contact (1.2.2), implicit, on the smooth dynamics.

The end velocity w solves M0 w = b0 + h (contact forces + clamped drive torques), both at w. Every Newton iteration
decides anew which feet are loaded, which slip and which drives saturate; of three step lengths the one with the least
residual is taken, which is what carries it across those switches.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from sweep.core.rotations import exponential, multiply
from sweep.dynamics import arrowhead
from sweep.dynamics.arrowhead import Arrowhead, Split
from sweep.dynamics.interface import N_LEGS, Smooth, SmoothDynamics, Topology
from sweep.dynamics.rolling import contact_offset, resisting_moments, turning
from sweep.models.case import Case
from sweep.models.contact import Anchors, Contact, Forces, Geometry, approach, contact_forces, settle
from sweep.models.drive import Drive, Servo
from sweep.models.obstacles.surface import Rolling, Surface

STEP_LENGTHS = (1.0, 0.5, 0.2)


class State(NamedTuple):
    """Physical state: MuJoCo's qpos and qvel, and the contact anchors."""

    q: Float[Array, " nq"]
    v: Float[Array, " nv"]
    anchors: Anchors


class StepReport(NamedTuple):
    """What happened in one step."""

    forces: Forces
    normal: Float[Array, "n 3"]  # of the surfaces
    torque: Float[Array, "6 3"]  # N m, at the joints
    saturated: Float[Array, "6 3"]  # 1 where the drive was at its limit
    residual: Float[Array, ""]  # N, of the root's linear momentum balance and the legs' over a metre
    power: Float[Array, "6 3"]  # W, drive torque times joint rate
    kinetic: Float[Array, ""]  # J, at the start
    smooth: Smooth


class Limits(NamedTuple):
    """What execution leaves of the drives: gain and limit of each joint, and an outside force."""

    gain: Float[Array, "6 3"]  # 0 for a dead joint
    torque: Float[Array, "6 3"]  # N m
    push: Float[Array, " 3"]  # N, at the base's centre, world axes


def rest(top: Topology, q: Float[Array, " nq"]) -> State:
    """A state at rest with no foothold yet."""
    n = len(top.points)
    anchors = Anchors(jnp.zeros((n, 3), q.dtype), jnp.zeros(n, bool), jnp.zeros(n, jnp.int32))
    return State(q, jnp.zeros(top.model.nv, q.dtype), anchors)


def step(
    top: Topology,
    smooth_dynamics: SmoothDynamics,
    case: Case,
    limits: Limits,
    state: State,
    servo: Servo,
    h: float,
    iterations: int,
) -> tuple[State, StepReport]:
    """Advance `state` by h seconds while the drives do as `servo` tells them."""
    smooth = smooth_dynamics(state.q, state.v)
    surface = case.obstacle.surface(smooth.point, top.owner, smooth.bodies)
    point = smooth.point + contact_offset(surface)
    geometry, place = approach(case.contact, surface, state.anchors, point, smooth.bodies)
    j_root, j_turn = _relative(smooth, surface.body), turning(top.owner, surface, smooth.bodies)
    if surface.rolling is not None:
        offset = (point - smooth.point)[N_LEGS:, :, None]
        j_root = j_root.at[N_LEGS:].add(jnp.cross(j_turn, jnp.broadcast_to(offset, j_turn.shape), axis=1))
    v = Split(state.v[top.root], state.v[top.leg])
    mass = _mass(smooth)
    mass_v = arrowhead.times(mass, v)
    problem = _Problem(case.contact, servo, limits, geometry, surface, smooth, j_root, j_turn,
                       _damped(mass, case.drive, h), _momentum(smooth, mass_v, limits, h),
                       servo.target - state.q[1 + top.leg], h)  # fmt: skip
    # a loop, not written out: every operation more takes time to compile
    w, _ = jax.lax.scan(lambda w, _: (_improve(problem, w), None), v, length=iterations)
    velocity = problem.point_velocity(w)
    forces = contact_forces(case.contact, geometry, velocity, h)
    torque, free = problem.drive(w)
    anchors = settle(case.contact, surface, point, smooth.bodies, place, forces, velocity, h)
    v_new = jnp.zeros_like(state.v).at[top.root].set(w.root).at[top.leg].set(w.leg)
    q_new = _integrate(top, state.q, v_new, h)
    left = problem.residual(w)
    torque = torque - case.drive.back_emf * w.leg
    report = StepReport(
        forces=forces,
        normal=surface.normal,
        torque=torque,
        saturated=1.0 - free,
        residual=jnp.maximum(jnp.max(jnp.abs(left.root)), jnp.max(jnp.abs(left.leg))) / h,
        power=torque * w.leg,
        kinetic=0.5 * (mass_v.root @ v.root + jnp.sum(mass_v.leg * v.leg)),
        smooth=smooth,
    )
    return State(q_new, v_new, anchors), report


def kinetic_energy(top: Topology, smooth: Smooth, v: Float[Array, " nv"]) -> Float[Array, ""]:
    """Of robot and free bodies at velocity v (J)."""
    split = Split(v[top.root], v[top.leg])
    mass_v = arrowhead.times(_mass(smooth), split)
    return 0.5 * (mass_v.root @ split.root + jnp.sum(mass_v.leg * split.leg))


def _mass(smooth: Smooth) -> Arrowhead:
    """The mass matrix as one."""
    return Arrowhead(smooth.m_root, smooth.m_cross, jnp.swapaxes(smooth.m_cross, 1, 2), smooth.m_leg)


class _Problem(NamedTuple):
    """The step's equation; everything but the end velocity is fixed."""

    contact: Contact
    servo: Servo
    limits: Limits
    geometry: Geometry
    surface: Surface
    smooth: Smooth
    j_root: Array  # (n, 3, r), relative to the surface's body
    j_turn: Array  # (n - 6, 3, r), rates of turning of the obstacle's points, likewise
    mass: Arrowhead  # M0 = M + h c_e on the joints
    momentum: Split  # b0 = M v - h bias
    error: Array  # (6, 3) rad
    h: float

    def point_velocity(self, w: Split) -> Array:
        """(n, 3) velocity of the contact points relative to their surface."""
        velocity = self.j_root @ w.root
        return velocity.at[:N_LEGS].add(jnp.einsum("lij,lj->li", self.smooth.j_leg, w.leg))

    def moments(self, w: Split, forces: Forces) -> tuple[Array, Array]:
        """Momentum (r,) that rolling resistance takes from the root, and its slope (r, r) by the root's velocity."""
        rolling = self.surface.rolling
        if rolling is None:
            return jnp.zeros_like(w.root), jnp.zeros_like(self.mass.root)
        own = Rolling(*(x[N_LEGS:] for x in rolling))
        moments = resisting_moments(own, self.geometry.normal[N_LEGS:], forces.normal[N_LEGS:], self.j_turn @ w.root)
        slope = jnp.einsum("mij,mik,mkl->jl", self.j_turn, moments.slope, self.j_turn)
        return self.h * jnp.einsum("mij,mi->j", self.j_turn, moments.moment), self.h * slope

    def drive(self, w: Split) -> tuple[Array, Array]:
        """Clamped drive effort (N m) and 1 where it is not at its limit."""
        gain = self.limits.gain
        wanted = gain * (self.servo.stiffness * self.error + self.servo.torque - self._damping() * w.leg)
        effort = jnp.clip(wanted, -self.limits.torque, self.limits.torque)
        return effort, (jnp.abs(wanted) < self.limits.torque).astype(w.leg.dtype)

    def _damping(self) -> Array | float:
        return self.h * self.servo.stiffness + self.servo.damping

    def residual(self, w: Split) -> Split:
        """Momentum that the step leaves unexplained (N s)."""
        forces = contact_forces(self.contact, self.geometry, self.point_velocity(w), self.h)
        return self._balance(w, forces.force, self.drive(w)[0], self.moments(w, forces)[0])

    def _balance(self, w: Split, force: Array, effort: Array, moment: Array) -> Split:
        done = arrowhead.times(self.mass, w)
        root = self.momentum.root - done.root + self.h * jnp.einsum("nij,ni->j", self.j_root, force) + moment
        leg = jnp.einsum("lij,li->lj", self.smooth.j_leg, force[:N_LEGS]) + effort
        return Split(root, self.momentum.leg - done.leg + self.h * leg)

    def newton(self, w: Split) -> Split:
        """The Newton direction at w, with contact and clamp states as they are there."""
        forces = contact_forces(self.contact, self.geometry, self.point_velocity(w), self.h)
        effort, free = self.drive(w)
        moment, resistance = self.moments(w, forces)
        right = self._balance(w, forces.force, effort, moment)
        slope_root = self.h * forces.slope @ self.j_root
        j_leg = self.smooth.j_leg
        slope_leg = self.h * forces.slope[:N_LEGS] @ j_leg
        feet = self.j_root[:N_LEGS]
        stiff = self.h * self._damping() * free * self.limits.gain
        matrix = Arrowhead(
            self.mass.root + jnp.einsum("nij,nik->jk", self.j_root, slope_root) + resistance,
            self.mass.upper + jnp.einsum("lij,lik->ljk", feet, slope_leg),
            self.mass.lower + jnp.einsum("lij,lik->ljk", j_leg, slope_root[:N_LEGS]),
            self.mass.leg
            + jnp.einsum("lij,lik->ljk", j_leg, slope_leg)
            + stiff[:, :, None] * jnp.eye(3, dtype=stiff.dtype),
        )
        return arrowhead.solve(matrix, right)

    def cost(self, w: Split) -> Array:
        """Residual, weighted with the inverse masses."""
        left = self.residual(w)
        legs = jnp.diagonal(self.mass.leg, axis1=1, axis2=2)
        return jnp.sum(left.root**2 / jnp.diagonal(self.mass.root)) + jnp.sum(left.leg**2 / legs)


def _improve(problem: _Problem, w: Split) -> Split:
    """One Newton iteration, with the best of the fixed step lengths."""
    direction = problem.newton(w)
    tried = jax.vmap(lambda length: w.plus(length, direction))(jnp.asarray(STEP_LENGTHS, w.root.dtype))
    best = jnp.argmin(jax.vmap(problem.cost)(tried))
    return Split(tried.root[best], tried.leg[best])


def _relative(smooth: Smooth, body: Array) -> Array:
    """Root Jacobian of the points, minus that of the free body they stand on."""
    j_root = smooth.j_root
    for k in range(smooth.j_body.shape[0]):
        on_it = (body == k).astype(j_root.dtype)[:, None, None]
        j_root = j_root.at[:, :, 6 * (k + 1) : 6 * (k + 2)].add(-on_it * smooth.j_body[k])
    return j_root


def _damped(mass: Arrowhead, drive: Drive, h: float) -> Arrowhead:
    """M with the back-EMF's damping taken implicitly."""
    return mass._replace(leg=mass.leg + h * drive.back_emf * jnp.eye(3, dtype=mass.leg.dtype))


def _momentum(smooth: Smooth, mass_v: Split, limits: Limits, h: float) -> Split:
    """M v - h (bias - push)."""
    root = mass_v.root - h * smooth.bias_root
    return Split(root.at[:3].add(h * limits.push), mass_v.leg - h * smooth.bias_leg)


def _integrate(top: Topology, q: Array, v: Array, h: float) -> Array:
    """Positions after h seconds at velocity v; quaternions along the exponential map."""
    moved = q.at[1 + top.leg].add(h * v[top.leg])
    for k, dofs in enumerate(top.root.reshape(-1, 6)):
        at = int(dofs[0]) + k  # a free joint has one more position than velocities, and the hinges one each
        moved = moved.at[at : at + 3].add(h * v[dofs[:3]])
        turned = multiply(q[at + 3 : at + 7], exponential(h * v[dofs[3:]]))
        moved = moved.at[at + 3 : at + 7].set(turned / jnp.linalg.norm(turned))
    return moved

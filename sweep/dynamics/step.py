"""One implicit physics step: drives with clamped torque (1.2.1) and contact (1.2.2) on top of the smooth dynamics.

The end velocity w solves M0 w = b0 + h (contact forces + clamped drive torques), both at w. Every Newton iteration
decides anew which feet are loaded, which slip and which drives saturate. Where a whole Newton step does not converge,
the step length with the least residual is taken out of a few, which is what carries it across those switches.

All is in the axes of the base at the start of the step, by components. Momentum and the velocities of contact points
are linear in the end velocity, so they are formed once for all step lengths.
"""

from functools import reduce
from operator import add, mul, sub
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from sweep.core.constants import GRAVITY
from sweep.core.vectors import Matrix, Vector, sum_last_axis
from sweep.dynamics import free_bodies, newton
from sweep.dynamics.contacts import (
    ContactAnchors,
    ContactForces,
    ContactSet,
    RollingResistanceMoments,
    contact_damping,
    contact_forces,
    find_contacts,
    make_initial_anchors,
    rolling_resistance_moments,
)
from sweep.dynamics.free_bodies import FreeBodies
from sweep.dynamics.interface import ModelTopology, RobotDynamicsTerms, SmoothDynamics
from sweep.dynamics.spatial import (
    GeneralizedVector,
    JointTriple,
    MassMatrix,
    SpatialVector,
    SystemPose,
    map_leg_joints,
    pack_state,
    split_leg_joints,
    tree_add_scaled,
    unpack_state,
)
from sweep.models.case import Case
from sweep.models.drive import ServoCommand
from sweep.models.legs import N_LEGS
from sweep.models.obstacles.surface import BodyPoses

# shorter steps along Newton's direction: at a limit a drive's stiffness is not in the slope, and a longer step goes on
# past its other limit
STEP_FRACTIONS = (0.5, 0.2, 0.1)
CONVERGENCE_FACTOR = 100  # a step has converged if its error is below so many rounding errors of the momentum g m h


class PhysicsState(NamedTuple):
    """Physical state of a rollout: MuJoCo's qpos and qvel, and the contact anchors (ends of tangential springs)."""

    q: Float[Array, " nq"]
    v: Float[Array, " nv"]
    anchors: tuple[ContactAnchors, ...]


class UnpackedPhysicsState(NamedTuple):
    """A `PhysicsState` split into separate components of bodies and joints, with which steps are computed."""

    pose: SystemPose
    motion: GeneralizedVector  # in the bodies' own axes
    anchors: tuple[ContactAnchors, ...]


class StepStart(NamedTuple):
    """Positions and mechanical energy at the start of a step, world axes; part of a `StepReport`."""

    normal: Vector  # (l,) of the surfaces under the feet
    energy: Array  # (1,) J
    centre_of_mass: Vector  # (1,) m, of the robot
    joints: tuple[Vector, ...]  # (l,) m, along a leg: hip, ..., foot
    bodies: BodyPoses


class StepReport(NamedTuple):
    """Forces, torques and power of one step; forces in world axes."""

    force: Vector  # (l,) N, on the feet
    normal: Array  # (l,) N
    torque: JointTriple  # (l,) N m, at the joints
    saturated: JointTriple
    residual: Array  # (1,) N, of the bodies' momentum balance and the legs' over a metre
    power: JointTriple  # (l,) W, of the drives
    external_power: Array  # (1,) W, of the push and the obstacle's loads
    start: StepStart


class DriveLimits(NamedTuple):
    """Limits and faults in one step: gain and torque limit of each joint, and an external push on the base."""

    gain: Float[Array, "6 3"]  # 0 for a dead joint
    torque: Float[Array, "6 3"]  # N m
    push: Float[Array, " 3"]  # N, at the base's centre, world axes


def state_at_rest(top: ModelTopology, q: Float[Array, " nq"]) -> PhysicsState:
    """Make a state with zero velocities and without contacts from positions `q` (MuJoCo's qpos).

    Args:
        top: The topology of the model.
        q: MuJoCo's qpos (m, quaternions, rad).
    """
    counts = (N_LEGS, len(top.contact_owners) - N_LEGS)
    return PhysicsState(
        q, jnp.zeros(top.model.nv, q.dtype), tuple(make_initial_anchors(n, q.dtype) for n in counts if n)
    )


def unpack_physics_state(state: PhysicsState) -> UnpackedPhysicsState:
    """Split a physics state into separate components of bodies and joints."""
    return UnpackedPhysicsState(*unpack_state(state.q, state.v), state.anchors)


def pack_physics_state(moving: UnpackedPhysicsState) -> PhysicsState:
    """Join components of a physics state into arrays in MuJoCo's order, the inverse of `unpack_physics_state`."""
    return PhysicsState(*pack_state(moving.pose, moving.motion), moving.anchors)


def step(
    smooth_dynamics: SmoothDynamics,
    case: Case,
    limits: DriveLimits,
    state: UnpackedPhysicsState,
    servo: ServoCommand,
    h: float,
    iterations: int,
) -> tuple[UnpackedPhysicsState, StepReport]:
    """Advance the state by one physics step, by an implicit solution of the equations (1.2.1) and (1.2.2).

    Args:
        smooth_dynamics: Mass matrix, bias and foot Jacobians of the robot.
        case: The world.
        limits: Faults of execution.
        state: The state at the start of the step.
        servo: Command of the drives.
        h: Time step (s).
        iterations: Number of Newton iterations.

    Returns:
        The state at the end, and the step's forces, torques and power.
    """
    here = _configuration(smooth_dynamics, case, state)
    mass, turned, v = here.mass, here.turned, here.motion
    momentum, outside = mass.momentum(v), _external_wrenches(case, limits, state, here)
    touches = find_contacts(case, state.anchors, here.pose.root[0].position, turned, here.robot.joints[-1], here.free)
    error = map_leg_joints(sub, split_leg_joints(servo.target), state.pose.angle)
    problem = _ImplicitStepProblem(
        case,
        servo,
        limits,
        tuple(touch.contacts for touch in touches),
        mass,
        here.robot.foot,
        _start_momentum(momentum, here, outside, h),
        error,
        h,
    )
    trial = problem.solve_end_velocity(v, iterations)
    w, acting = trial.motion, problem.trial_forces(trial)
    world = tuple(motion.rotate(turned) for motion in w.root)  # of the root bodies
    torque = map_leg_joints(lambda u, rate: u - case.drive.back_emf * rate, acting.effort, w.leg)
    feet, normal = acting.forces[0], Vector.from_array(touches[0].surface.normal)
    report = StepReport(
        force=feet.normal * normal + turned @ feet.tangential,
        normal=feet.normal,
        torque=torque,
        saturated=map_leg_joints(lambda f: 1.0 - f, acting.free),
        residual=_largest_component(problem.momentum_residual(trial, acting), here) / h,
        power=map_leg_joints(mul, torque, w.leg),
        external_power=reduce(add, (motion.dot(force) for motion, force in zip(world, outside, strict=False))),
        start=_step_start(here, normal, 0.5 * momentum.dot(v)),
    )
    anchors = tuple(
        touch.next_anchors(case.contact, forces, velocity, turned, here.free.frames, h)
        for touch, forces, velocity in zip(touches, acting.forces, trial.velocity, strict=True)
    )
    return UnpackedPhysicsState(*_integrate(state.pose, w, world, here, h), anchors), report


def mechanical_energy(smooth_dynamics: SmoothDynamics, case: Case, state: UnpackedPhysicsState) -> Array:
    """Kinetic and potential energy of robot and free bodies.

    Args:
        smooth_dynamics: Mass matrix, bias and foot Jacobians of the robot.
        case: The world.
        state: The state.

    Returns:
        The energy (J), (1,).
    """
    here = _configuration(smooth_dynamics, case, state)
    return 0.5 * here.mass.momentum(here.motion).dot(here.motion) + _potential_energy(here)


class _Configuration(NamedTuple):
    """One configuration of robot and free bodies, in base axes."""

    pose: SystemPose
    turned: Matrix  # (1,) to world axes
    robot: RobotDynamicsTerms
    free: FreeBodies
    mass: MassMatrix
    motion: GeneralizedVector


def _configuration(smooth_dynamics: SmoothDynamics, case: Case, state: UnpackedPhysicsState) -> _Configuration:
    pose, robot = state.pose, smooth_dynamics(state.pose, state.motion)
    turned = pose.root[0].rotation()
    free = free_bodies.kinematics(pose, turned.transpose)
    mass = robot.mass._replace(root=(*robot.mass.root, *free_bodies.inertias(case, free.axes)))
    base, *others = state.motion.root
    motions = (base, *(own.rotate(axes) for own, axes in zip(others, free.axes, strict=True)))
    return _Configuration(pose, turned, robot, free, mass, GeneralizedVector(motions, state.motion.leg))


def _external_wrenches(
    case: Case, limits: DriveLimits, state: UnpackedPhysicsState, config: _Configuration
) -> list[SpatialVector]:
    """External wrenches on the root bodies, world axes: the push on the base, then loads on free bodies if any."""
    push = Vector(*(limits.push[k : k + 1] for k in range(3)))
    no_torque = Vector.from_array(jnp.zeros((1, 3), push.x.dtype))
    return [SpatialVector(push, no_torque), *free_bodies.external_wrenches(case, state.pose, state.motion, config.free)]


def _start_momentum(
    momentum: GeneralizedVector, config: _Configuration, outside: list[SpatialVector], h: float
) -> GeneralizedVector:
    """Momentum at the end of the step without contact and drives: M v - h (bias - external forces)."""
    up, to_base = config.turned.z, config.turned.transpose
    biases = [config.robot.bias.root[0]]
    biases += [
        free_bodies.bias_wrench(m, v, up) for m, v in zip(config.mass.root[1:], config.motion.root[1:], strict=True)
    ]
    start = tree_add_scaled(momentum, -h, GeneralizedVector(tuple(biases), config.robot.bias.leg))
    root = list(start.root)
    for k, force in enumerate(outside):
        root[k] = tree_add_scaled(root[k], h, force.rotate(to_base))
    return start._replace(root=tuple(root))


def _potential_energy(config: _Configuration) -> Array:
    """Gravitational potential energy (J)."""
    up, energies = config.turned.z, []
    for place, body in zip(config.pose.root, config.mass.root, strict=True):
        height = body.mass * place.position.z
        energies.append(height if body.moment is None else height + up.dot(body.moment))
    return GRAVITY * reduce(add, energies)


def _step_start(config: _Configuration, normal: Vector, kinetic: Array) -> StepStart:
    turned, at, robot = config.turned, config.pose.root[0].position, config.robot.mass.root[0]
    centre = at if robot.moment is None else at + turned @ ((1 / robot.mass) * robot.moment)
    joints = tuple(at + turned @ joint for joint in config.robot.joints)
    return StepStart(
        normal,
        kinetic + _potential_energy(config),
        centre,
        joints,
        free_bodies.body_pose_arrays(config.free, normal.x.dtype),
    )


def _largest_component(left: GeneralizedVector, config: _Configuration) -> Array:
    """Largest component (1,) of a residual; forces in world axes, torques in body axes."""
    parts = [*left.root[0].angular]
    for force, axes in zip(left.root[1:], config.free.axes, strict=True):
        parts += axes.transpose @ force.angular
    for force in left.root:
        parts += config.turned @ force.linear
    legs = [jnp.max(jnp.abs(part), axis=-1, keepdims=True) for part in left.leg]
    return reduce(jnp.maximum, [*(jnp.abs(part) for part in parts), *legs])


def _integrate(
    pose: SystemPose, w: GeneralizedVector, world: tuple[SpatialVector, ...], config: _Configuration, h: float
) -> tuple[SystemPose, GeneralizedVector]:
    """Integrate poses over h seconds at velocity w; linear parts in world axes, the returned motion in body axes."""
    base, *others = w.root
    spins = [base.angular, *(b.transpose @ own.angular for own, b in zip(others, config.free.axes, strict=True))]
    places = [
        place.integrate(motion.linear, spin, h) for place, motion, spin in zip(pose.root, world, spins, strict=True)
    ]
    root = [
        SpatialVector(place.rotation().transpose @ motion.linear, spin)
        for place, motion, spin in zip(places, world, spins, strict=True)
    ]
    angle = map_leg_joints(lambda a, rate: a + h * rate, pose.angle, w.leg)
    return SystemPose(tuple(places), angle), GeneralizedVector(tuple(root), w.leg)


class _Trial(NamedTuple):
    """A trial end velocity, with the quantities that are linear in it."""

    motion: GeneralizedVector
    momentum: GeneralizedVector  # (M + h c_e on the joints) w
    velocity: tuple[Vector, ...]  # of feet and sites over their surfaces
    turning: Vector | None  # of sites that roll


class _Iterate(NamedTuple):
    """An end velocity, and how far it is from a solution."""

    trial: _Trial
    cost: Array  # () J, see `_ImplicitStepProblem._cost`
    number: Array  # () int32, of the iteration


class _ActingForces(NamedTuple):
    """Forces that act at a trial end velocity."""

    forces: tuple[ContactForces, ...]  # on feet and sites
    moments: RollingResistanceMoments | None  # against rolling
    effort: JointTriple  # N m, of the drives
    free: JointTriple  # 1 where a drive is not at its limit


class _ImplicitStepProblem(NamedTuple):
    """The implicit equation of a step; everything but the end velocity is fixed."""

    case: Case
    servo: ServoCommand
    limits: DriveLimits
    contacts: tuple[ContactSet, ...]  # feet, and sites if any
    mass: MassMatrix
    j_leg: tuple[Vector, Vector, Vector]
    start: GeneralizedVector  # M v - h (bias - outside forces)
    error: JointTriple  # rad
    h: float

    def trial_at_velocity(self, w: GeneralizedVector) -> _Trial:
        """Return momentum and contact velocities at a trial end velocity."""
        done, damping = self.mass.momentum(w), self.h * self.case.drive.back_emf
        done = done._replace(leg=tuple(p + damping * rate for p, rate in zip(done.leg, w.leg, strict=True)))
        feet, *sites = (contacts.velocity(w.root) for contacts in self.contacts)
        feet = reduce(add, (rate * j for rate, j in zip(w.leg, self.j_leg, strict=True)), feet)
        rolls = sites and self.contacts[1].rolling is not None
        return _Trial(w, done, (feet, *sites), self.contacts[1].relative_spin(w.root) if rolls else None)

    def trial_forces(self, trial: _Trial) -> _ActingForces:
        """Return the forces at a trial velocity: contact (1.2.2), rolling resistance and clamped drives (1.2.1)."""
        laws = zip(self.contacts, trial.velocity, strict=True)
        forces = tuple(contact_forces(self.case.contact, own.geometry, velocity) for own, velocity in laws)
        moments = None
        if trial.turning is not None:
            sites = self.contacts[1]
            moments = rolling_resistance_moments(sites.rolling, sites.geometry.normal, forces[1].normal, trial.turning)  # pyright: ignore
        return _ActingForces(forces, moments, *self._drive(trial.motion))

    def _drive(self, w: GeneralizedVector) -> tuple[JointTriple, JointTriple]:
        stiffness, torque, limit = (
            split_leg_joints(x) for x in (self.servo.stiffness, self.servo.torque, self.limits.torque)
        )
        terms = stiffness, self.error, torque, self._damping(), w.leg
        pull = map_leg_joints(lambda k, error, u, damping, rate: k * error + u - damping * rate, *terms)
        wanted = map_leg_joints(mul, split_leg_joints(self.limits.gain), pull)
        free = map_leg_joints(lambda u, most: (jnp.abs(u) < most).astype(u.dtype), wanted, limit)
        return map_leg_joints(lambda u, most: jnp.clip(u, -most, most), wanted, limit), free

    def _damping(self) -> JointTriple:
        return split_leg_joints(self.h * self.servo.stiffness + self.servo.damping)

    def momentum_residual(self, trial: _Trial, acting: _ActingForces) -> GeneralizedVector:
        """Return the residual of the momentum balance at a trial velocity (N s)."""
        left = jax.tree.map(sub, self.start, trial.momentum)
        root, feet = list(left.root), acting.forces[0].force
        for k, (contacts, forces) in enumerate(zip(self.contacts, acting.forces, strict=True)):
            moments = acting.moments.moment if k and acting.moments is not None else None
            for body, force in contacts.root_wrenches(forces.force, moments):
                root[body] = tree_add_scaled(root[body], self.h, force)
        legs = map_leg_joints(
            lambda own, j, effort: own + self.h * (j.dot(feet) + effort), left.leg, self.j_leg, acting.effort
        )
        return GeneralizedVector(tuple(root), legs)

    def solve_end_velocity(self, v: GeneralizedVector, iterations: int) -> _Trial:
        """Solve for the velocity at the end of the step by Newton's method, starting from the velocity `v` at its
        start.

        Most steps converge in one iteration, and few need more than three. A rollout that has converged keeps its
        solution while others of the same warp or vector go on.
        """
        rounding = CONVERGENCE_FACTOR * float(jnp.finfo(v.leg[0].dtype).eps)
        enough = (rounding * GRAVITY * self.h) ** 2 * self.mass.root[0].mass[0]
        first = _Iterate(self.trial_at_velocity(v), jnp.full_like(enough, jnp.inf), jnp.zeros((), jnp.int32))
        return jax.lax.while_loop(
            lambda now: (now.cost > enough) & (now.number < iterations), lambda now: self._improve(now, enough), first
        ).trial

    def _improve(self, now: _Iterate, enough: Array) -> _Iterate:
        """Take a full Newton step or, if that does not converge, the step length with the least residual."""
        trial, number = now.trial, now.number + 1
        acting = self.trial_forces(trial)
        direction = self.trial_at_velocity(self._newton(acting, self.momentum_residual(trial, acting)))
        whole = jax.tree.map(add, trial, direction)
        cost = self._cost(self.momentum_residual(whole, self.trial_forces(whole)))[0]

        def take_best_step_length() -> _Iterate:
            lengths = jnp.asarray(STEP_FRACTIONS, cost.dtype)
            tried = tree_add_scaled(trial, lengths[:, None], direction)
            costs = self._cost(self.momentum_residual(tried, self.trial_forces(tried)))[:, 0]
            best, length = cost, jnp.ones_like(cost)
            for k in range(len(STEP_FRACTIONS)):
                better = costs[k] < best
                best, length = jnp.where(better, costs[k], best), jnp.where(better, lengths[k], length)
            return _Iterate(tree_add_scaled(trial, length, direction), best, number)

        return jax.lax.cond(cost > enough, take_best_step_length, lambda: _Iterate(whole, cost, number))

    def _cost(self, left: GeneralizedVector) -> Array:
        """Norm of the residual, weighted with the inverse masses."""
        cost = []
        for body, force in zip(self.mass.root, left.root, strict=True):
            own = zip(force.angular, body.inertia, "xyz", strict=True)
            cost += [force.linear.dot(force.linear) / body.mass, *(p**2 / getattr(row, name) for p, row, name in own)]
        leg, damping = self.mass.leg, self.h * self.case.drive.back_emf
        own = (leg.x.x + damping, leg.y.y + damping, leg.z.z + damping)
        return reduce(add, [*cost, sum_last_axis(reduce(add, (p**2 / m for p, m in zip(left.leg, own, strict=True))))])

    def _newton(self, acting: _ActingForces, right: GeneralizedVector) -> GeneralizedVector:
        """Newton direction, with the contact and clamp states of the present trial."""
        slopes = [
            contact_damping(own.geometry, forces, self.h)
            for own, forces in zip(self.contacts, acting.forces, strict=True)
        ]
        rolling = None if acting.moments is None else acting.moments.slope.scale(self.h)
        held = map_leg_joints(
            lambda damping, free, gain: damping * free * gain,
            self._damping(),
            acting.free,
            split_leg_joints(self.limits.gain),
        )
        stiff = map_leg_joints(lambda d: self.h * (self.case.drive.back_emf + d), held)
        return newton.newton_direction(self.mass, self.j_leg, stiff, self.contacts, slopes, rolling, right)

"""The step of `step` for a robot on ground that does not move, on the structured dynamics of `star`.

The equation, its Newton iterations and the choice among step lengths are those of `step`, in base axes and written
out by components. Momentum and the feet's velocities are linear in the end velocity, so they are formed once for all
step lengths.
"""

from functools import reduce
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array

from sweep.dynamics.step import STEP_LENGTHS, Limits, State
from sweep.dynamics.tree import Column, Mass, Motion, Pose, Star, pack, potential, star, unpack
from sweep.dynamics.vectors import Matrix, Vector, cross_matrix, rotation
from sweep.formulas.leg import SIDE
from sweep.models.case import Case
from sweep.models.contact import Anchors
from sweep.models.drive import Servo
from sweep.models.obstacles.surface import fixed_surface
from sweep.models.scene import links


class Moving(NamedTuple):
    """Physical state by components."""

    pose: Pose
    motion: Motion  # base axes
    anchor: Vector  # (l,) m, world axes
    loaded: Array  # (l,)
    face: Array  # (l,)


class End(NamedTuple):
    """Where things were at the start of the last step. World axes."""

    normal_force: Array  # (l,) N, in the step
    normal: Vector  # (l,)
    energy: Array  # (1,) J
    centre_of_mass: Vector  # (1,) m
    joints: tuple[Vector, ...]  # (l,) m, along a leg: hip, ..., foot


class Report(NamedTuple):
    """What happened in one step; forces in world axes."""

    force: Vector  # (l,) N, on the feet
    torque: tuple[Array, Array, Array]  # (l,) N m, at the joints
    saturated: tuple[Array, Array, Array]
    residual: Array  # (1,) N
    power: tuple[Array, Array, Array]  # (l,) W, of the drives
    push: Array  # (1,) W, of the push
    end: End


class Sums(NamedTuple):
    """Reports of several steps together: peaks of torque and residual, sums of the rest."""

    torque_peak: tuple[Array, Array, Array]
    saturated: tuple[Array, Array, Array]
    force: Vector
    normal: Array
    residual: Array
    power: Array
    effort: Array  # of drives that drive
    push: Array


class Feet(NamedTuple):
    """Contacts at the start of a step, in base axes."""

    depth: Array
    normal: Vector
    stretch: Vector
    limit: Array


class Grip(NamedTuple):
    """Contact forces at a velocity, in base axes."""

    force: Vector
    normal: Array  # N
    tangential: Vector
    direction: Vector  # of the tangential force
    share: Array  # of the elastic force that holds
    slipping: Array
    loaded: Array


def from_state(state: State) -> Moving:
    """By components."""
    pose, motion = unpack(state.q, state.v)
    return Moving(pose, motion, Vector.of(state.anchors.place), state.anchors.loaded, state.anchors.face)


def to_state(moving: Moving) -> State:
    """As MuJoCo's arrays."""
    q, v = pack(moving.pose, moving.motion)
    return State(q, v, Anchors(moving.anchor.array(), moving.loaded, moving.face))


def step(case: Case, limits: Limits, state: Moving, servo: Servo, h: float, iterations: int) -> tuple[Moving, Report]:
    """Advance `state` by h seconds while the drives do as `servo` tells them."""
    v, pose = state.motion, state.pose
    robot = star(case.robot, case.drive.armature, pose, v)
    turned, to_base = robot.rotation, robot.rotation.transposed
    end = robot.joints[-1]
    foot = pose.position + turned @ end
    surface = fixed_surface(case.obstacle, foot.array())
    normal = Vector.of(surface.normal)
    held = state.loaded & (state.face == surface.face)
    fresh = foot + surface.depth * normal
    place = _where(held, state.anchor, fresh)
    gap = place - foot
    feet = Feet(surface.depth, to_base @ normal, to_base @ (gap - gap.dot(normal) * normal),
                case.contact.friction * surface.grip)  # fmt: skip
    momentum = robot.mass.times(v)
    pushed = Vector(*(limits.push[k : k + 1] for k in range(3)))
    start = momentum.plus(-h, robot.bias)
    error = tuple(servo.target[:, k] - pose.angle[k] for k in range(3))
    problem = _Problem(case, servo, limits, feet, robot.mass, end, robot.foot,
                       start._replace(linear=start.linear + h * (to_base @ pushed)), error, h)  # pyright: ignore  # fmt: skip
    begin = v, problem.momentum(v), problem.foot_velocity(v)
    # a loop, not written out: every operation more takes time to compile
    (w, carried, velocity), _ = jax.lax.scan(lambda s, _: (problem.improve(*s), None), begin, length=iterations)
    grip = problem.grip(velocity)
    effort, free = problem.drive(w)
    left = problem.residual(carried, grip, effort)
    root = [jnp.abs(part) for part in (*_parts(turned @ left.linear), *_parts(left.angular))]
    legs = [jnp.max(jnp.abs(part), axis=-1, keepdims=True) for part in left.leg]
    torque = tuple(u - case.drive.back_emf * rate for u, rate in zip(effort, w.leg, strict=True))
    passed, tangential, velocity_after = turned @ velocity, turned @ grip.tangential, turned @ w.linear
    landed = foot + h * passed + (surface.depth - h * normal.dot(passed)) * normal
    anchor = _where(grip.slipping, landed + (1 / case.contact.stiffness) * tangential, place)
    report = Report(
        force=grip.normal * normal + tangential, torque=torque, saturated=tuple(1.0 - f for f in free),  # pyright: ignore
        residual=reduce(jnp.maximum, [*root, *legs]) / h,
        power=tuple(u * rate for u, rate in zip(torque, w.leg, strict=True)), push=pushed.dot(velocity_after),  # pyright: ignore
        end=_end(pose, robot, grip, normal, _kinetic(momentum, v)),
    )  # fmt: skip
    after = _integrate(pose, velocity_after, w, h)
    motion = w._replace(linear=rotation(*after.quat).transposed @ velocity_after)
    return Moving(after, motion, anchor, grip.loaded, surface.face), report


def energy(case: Case, moving: Moving) -> Array:
    """Kinetic and potential energy (J), (1,)."""
    robot = star(case.robot, case.drive.armature, moving.pose, moving.motion)
    kinetic = _kinetic(robot.mass.times(moving.motion), moving.motion)
    return kinetic + potential(robot.mass, robot.rotation, moving.pose.position)


def _kinetic(momentum: Motion, v: Motion) -> Array:
    legs = sum(a * b for a, b in zip(momentum.leg, v.leg, strict=True))
    return 0.5 * (momentum.linear.dot(v.linear) + momentum.angular.dot(v.angular) + _total(legs))  # pyright: ignore


def _end(pose: Pose, robot: Star, grip: Grip, normal: Vector, kinetic: Array) -> End:
    turned, at = robot.rotation, pose.position
    centre = at + turned @ ((1 / robot.mass.mass) * robot.mass.moment)
    joints = tuple(at + turned @ joint for joint in robot.joints)
    return End(grip.normal, normal, kinetic + potential(robot.mass, turned, at), centre, joints)


def nothing(case: Case, dtype: Any) -> tuple[Sums, End]:
    """Before the first step."""
    leg, one = jnp.zeros(len(SIDE), dtype), jnp.zeros(1, dtype)
    legs, base, three = Vector(leg, leg, leg), Vector(one, one, one), (leg, leg, leg)
    joints = (legs,) * (len(links(case.robot)) + 1)
    return Sums(three, three, legs, leg, one, leg, leg, one), End(leg, legs, one, base, joints)


def add(sums: Sums, report: Report) -> Sums:
    """With one more step."""
    return Sums(
        tuple(jnp.maximum(peak, jnp.abs(u)) for peak, u in zip(sums.torque_peak, report.torque, strict=True)),  # pyright: ignore
        tuple(a + b for a, b in zip(sums.saturated, report.saturated, strict=True)),  # pyright: ignore
        sums.force + report.force, sums.normal + report.end.normal_force, jnp.maximum(sums.residual, report.residual),
        sum(report.power, sums.power), sum((jnp.maximum(p, 0.0) for p in report.power), sums.effort),
        sums.push + report.push,
    )  # fmt: skip


class _Problem(NamedTuple):
    """The step's equation; everything but the end velocity is fixed."""

    case: Case
    servo: Servo
    limits: Limits
    feet: Feet
    mass: Mass
    end: Vector  # of the legs
    j_leg: tuple[Vector, Vector, Vector]
    start: Motion  # M v - h (bias - push)
    error: tuple[Array, Array, Array]  # rad
    h: float

    def momentum(self, w: Motion) -> Motion:
        """(M + h c_e on the joints) w."""
        done = self.mass.times(w)
        damping = self.h * self.case.drive.back_emf
        return done._replace(leg=tuple(p + damping * rate for p, rate in zip(done.leg, w.leg, strict=True)))

    def foot_velocity(self, w: Motion) -> Vector:
        """(l,) of the feet."""
        at_base = w.linear + w.angular.cross(self.end)
        return at_base + w.leg[0] * self.j_leg[0] + w.leg[1] * self.j_leg[1] + w.leg[2] * self.j_leg[2]

    def grip(self, velocity: Vector) -> Grip:
        """Contact forces (1.2.2) at a velocity of the feet; see `contact_forces`."""
        contact, n = self.case.contact, self.feet.normal
        g = contact.stiffness * self.h + contact.damping
        v_normal = velocity.dot(n)
        normal = jnp.maximum(0.0, contact.stiffness * self.feet.depth - g * v_normal)
        loaded = normal > 0
        elastic = contact.stiffness * self.feet.stretch - g * (velocity - v_normal * n)
        size = jnp.sqrt(elastic.dot(elastic) + 1e-6)
        most = self.feet.limit * normal
        slipping = loaded & ~(size <= most)  # a limit that is not a number must show, not hold
        share = jnp.where(loaded, jnp.where(slipping, most / size, 1.0), 0.0)
        tangential = share * elastic
        return Grip(normal * n + tangential, normal, tangential, (1 / size) * elastic, share, slipping, loaded)

    def drive(self, w: Motion) -> tuple[tuple[Array, ...], tuple[Array, ...]]:
        """Clamped drive effort (N m) and 1 where it is not at its limit, by joint."""
        efforts, free = [], []
        for k in range(3):
            gain, limit = self.limits.gain[:, k], self.limits.torque[:, k]
            pull = self.servo.stiffness[:, k] * self.error[k] + self.servo.torque[:, k]
            wanted = gain * (pull - self._damping(k) * w.leg[k])
            efforts.append(jnp.clip(wanted, -limit, limit))
            free.append((jnp.abs(wanted) < limit).astype(wanted.dtype))
        return tuple(efforts), tuple(free)

    def _damping(self, k: int) -> Array:
        return self.h * self.servo.stiffness[:, k] + self.servo.damping[:, k]

    def residual(self, carried: Motion, grip: Grip, effort: tuple[Array, ...]) -> Motion:
        """Momentum that the step leaves unexplained (N s), `carried` being the momentum at its end."""
        force = grip.force
        linear = self.start.linear - carried.linear + self.h * force.total()
        angular = self.start.angular - carried.angular + self.h * self.end.cross(force).total()
        legs = tuple(
            self.start.leg[k] - carried.leg[k] + self.h * (self.j_leg[k].dot(force) + effort[k]) for k in range(3)
        )
        return Motion(linear, angular, legs)  # pyright: ignore

    def improve(self, w: Motion, carried: Motion, velocity: Vector) -> tuple[Motion, Motion, Vector]:
        """One Newton iteration, with the best of the fixed step lengths."""
        grip = self.grip(velocity)
        effort, free = self.drive(w)
        way = self.newton(grip, free, self.residual(carried, grip, effort))
        carried_way, velocity_way = self.momentum(way), self.foot_velocity(way)
        lengths = jnp.asarray(STEP_LENGTHS, grip.normal.dtype)[:, None]
        tried = w.plus(lengths, way)
        grips = self.grip(velocity + lengths * velocity_way)
        costs = self.cost(self.residual(carried.plus(lengths, carried_way), grips, self.drive(tried)[0]))
        first, second, third = costs[0], costs[1], costs[2]
        length = jnp.where(third < jnp.minimum(first, second), STEP_LENGTHS[2],
                           jnp.where(second < first, STEP_LENGTHS[1], STEP_LENGTHS[0])).astype(first.dtype)  # fmt: skip
        return w.plus(length, way), carried.plus(length, carried_way), velocity + length * velocity_way

    def cost(self, left: Motion) -> Array:
        """Residual, weighted with the inverse masses."""
        inertia, leg = self.mass.inertia, self.mass.leg
        root = left.linear.dot(left.linear) / self.mass.mass
        root = root + left.angular.x**2 / inertia.x.x + left.angular.y**2 / inertia.y.y
        root = root + left.angular.z**2 / inertia.z.z
        damping = self.h * self.case.drive.back_emf
        own = (leg.x.x + damping, leg.y.y + damping, leg.z.z + damping)
        return root + _total(sum(part**2 / m for part, m in zip(left.leg, own, strict=True)))

    def newton(self, grip: Grip, free: tuple[Array, ...], right: Motion) -> Motion:
        """The direction at a velocity, with contact and clamp states as they are there."""
        slope = self._slope(grip)
        down = slope.transposed
        pulls = [slope @ j for j in self.j_leg]  # impulse on a foot per rate of a joint
        pushes = [down @ j for j in self.j_leg]  # torque of a joint per velocity of the foot
        upper = [
            Column(c.linear + f, c.angular + self.end.cross(f)) for c, f in zip(self.mass.cross, pulls, strict=True)
        ]
        lower = [
            Column(c.linear + f, c.angular + self.end.cross(f)) for c, f in zip(self.mass.cross, pushes, strict=True)
        ]
        leg = Matrix(*(Vector(*(j.dot(f) for f in pulls)) for j in self.j_leg)).plus(self.mass.leg)
        stiff = [
            self.h * (self.case.drive.back_emf + self._damping(k) * free[k] * self.limits.gain[:, k]) for k in range(3)
        ]
        leg = Matrix(leg.x + _only(0, stiff[0]), leg.y + _only(1, stiff[1]), leg.z + _only(2, stiff[2]))
        inverse = leg.inverse()
        return self._solve(slope, upper, lower, inverse, right)

    def _slope(self, grip: Grip) -> Matrix:
        """-h d force / d velocity of the feet. Its parts are kept as values: worked out twice, they might differ."""
        contact, n, t = self.case.contact, self.feet.normal, grip.direction
        scale = self.h * (contact.stiffness * self.h + contact.damping)
        slips, holds = grip.slipping.astype(t.x.dtype), grip.loaded.astype(t.x.dtype)
        round_ = scale * grip.share
        along_n = scale * (holds - grip.share) * n + (scale * slips * self.feet.limit) * t
        along_t = (-scale * slips * grip.share) * t
        round_, along_n, along_t = jax.lax.optimization_barrier((round_, along_n, along_t))
        rows = []
        for k, (a, b) in enumerate(zip(_parts(along_n), _parts(along_t), strict=True)):
            rows.append(a * n + b * t + _only(k, round_))
        return Matrix(*rows)

    def _solve(self, slope: Matrix, upper: list[Column], lower: list[Column], inverse: Matrix, right: Motion) -> Motion:
        """The legs are eliminated one by one, then the base's linear and angular parts in blocks of three."""
        arm = cross_matrix(self.end)
        moved = slope.times(arm)  # minus the impulse per rate of turning
        turned_moved, turned = arm.times(moved), arm.times(slope)
        blocks = []  # Schur complement, per leg: linear-linear, linear-angular, angular-linear, angular-angular
        linear, angular = [c.linear for c in lower], [c.angular for c in lower]
        solved = [Column(_combine(row, linear), _combine(row, angular)) for row in inverse]
        for part, own in (("linear", slope), ("angular", turned)):
            for other in ("linear", "angular"):
                base = own if other == "linear" else _negative(moved if part == "linear" else turned_moved)
                rows = []
                for name, row in zip("xyz", base, strict=True):
                    for k in range(3):
                        row = row - getattr(getattr(upper[k], part), name) * getattr(solved[k], other)
                    rows.append(row)
                blocks.append(Matrix(*rows).total())
        mass, cross = self.mass, cross_matrix(self.mass.moment)
        eye = [Matrix(*(_only(k, mass.mass) for k in range(3))), _negative(cross), cross, mass.inertia]
        ll, la, al, aa = (b.plus(m) for b, m in zip(blocks, eye, strict=True))
        leg = inverse @ Vector(*right.leg)
        linear, angular = right.linear, right.angular
        for column, part in zip(upper, _parts(leg), strict=True):
            linear, angular = linear - (part * column.linear).total(), angular - (part * column.angular).total()
        inner = ll.inverse()
        factor = al.times(inner)
        angular = _minus(aa, factor.times(la)).inverse() @ (angular - factor @ linear)
        linear = inner @ (linear - la @ angular)
        rates = tuple(
            part - (c.linear.dot(linear) + c.angular.dot(angular)) for part, c in zip(_parts(leg), solved, strict=True)
        )
        return Motion(linear, angular, rates)  # pyright: ignore


def _combine(shares: Vector, vectors: list[Vector]) -> Vector:
    return shares.x * vectors[0] + shares.y * vectors[1] + shares.z * vectors[2]


def _negative(m: Matrix) -> Matrix:
    return Matrix(*(-row for row in m))


def _minus(a: Matrix, b: Matrix) -> Matrix:
    return a.plus(_negative(b))


def _parts(v: Vector) -> tuple[Array, Array, Array]:
    return v.x, v.y, v.z


def _only(k: int, value: Array) -> Vector:
    """A vector along axis k."""
    zero = jnp.zeros_like(value)
    return Vector(*(value if i == k else zero for i in range(3)))


def _total(x: Array | int) -> Array:
    return jnp.sum(x, axis=-1, keepdims=True)


def _where(condition: Array, a: Vector, b: Vector) -> Vector:
    return Vector(*(jnp.where(condition, x, y) for x, y in zip(_parts(a), _parts(b), strict=True)))


def _turn(quat: tuple, spin: Vector, h: float) -> tuple:
    """`quat` turned about `spin` (rad/s, base axes) for h seconds."""
    rate = jnp.sqrt(spin.dot(spin) + 1e-24)
    half = 0.5 * h * rate
    c, s = jnp.cos(half), jnp.sin(half) / rate
    x, y, z = s * spin.x, s * spin.y, s * spin.z
    w0, x0, y0, z0 = quat
    out = (w0 * c - x0 * x - y0 * y - z0 * z, w0 * x + x0 * c + y0 * z - z0 * y,
           w0 * y - x0 * z + y0 * c + z0 * x, w0 * z + x0 * y - y0 * x + z0 * c)  # fmt: skip
    scale = jax.lax.rsqrt(sum(part * part for part in out))
    return tuple(part * scale for part in out)


def _integrate(pose: Pose, velocity: Vector, w: Motion, h: float) -> Pose:
    """Positions after h seconds at velocity w, its linear part in world axes too."""
    angle = tuple(a + h * rate for a, rate in zip(pose.angle, w.leg, strict=True))
    return Pose(pose.position + h * velocity, _turn(pose.quat, w.angular, h), angle)  # pyright: ignore

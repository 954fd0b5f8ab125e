"""Newton's method for the accelerations of a step: Gauss's principle with the costs of all constraints.

The matrix has the form of the robot's tree: a joint meets those between it and the base, and the base. It is factored
from the tips inward, so that nothing is filled in; the base's 6x6 block is last.
"""

from collections.abc import Sequence
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array

from sweep.systems.mujoco_model.kernel.constraints import (
    Constraints,
    ContactHessian,
    JointConstraint,
    contact_cost_hessian,
    contact_force,
    contact_frame_components,
    contact_wrench,
    joint_constraint_force,
    make_line_search_cost,
)
from sweep.systems.mujoco_model.kernel.coupling import (
    CoupledSystem,
    compute_relative_motion,
    solve_dense,
    sum_wrenches_by_stack,
)
from sweep.systems.mujoco_model.kernel.layout import RobotLayout
from sweep.systems.mujoco_model.kernel.scalars import (
    NOTHING,
    ONE,
    ZERO,
    Scalar,
    Vector,
    flatten_scalars,
    largest,
    square_root,
    where,
)
from sweep.systems.mujoco_model.kernel.smooth import BASE, STILL, SmoothTerms, SpatialVector
from sweep.systems.mujoco_model.kernel.tendons import multiply_terms

Joint = tuple[int, int]
TRIALS = 20  # of a search for a step's length, at most; mostly one or two are enough
NEVER = 1e10  # a step length that is never reached
CONVERGED = 32  # a step is solved when so many rounding errors of all forces are left over
ROUNDING = 32  # a slope of so many rounding errors of that at the start is level


class Acceleration(NamedTuple):
    """Accelerations of the base and of each joint; or generalized forces on them."""

    base: SpatialVector
    joints: dict[Joint, Scalar]

    def add_scaled(self, factor: Scalar, other: "Acceleration") -> "Acceleration":
        """Return self + factor * other."""
        return Acceleration(
            self.base + other.base * factor, {j: x + other.joints[j] * factor for j, x in self.joints.items()}
        )

    def minus(self, other: "Acceleration") -> "Acceleration":
        """Return self - other."""
        return Acceleration(self.base - other.base, {j: x - other.joints[j] for j, x in self.joints.items()})


class Residuals(NamedTuple):
    """Acceleration along each contact and joint constraint, minus its reference acceleration."""

    contacts: tuple[tuple[Scalar, ...], ...]
    rows: tuple[Scalar, ...]
    pairs: tuple[tuple[Scalar, ...], ...] = ()

    def add_scaled(self, factor: Scalar, other: "Residuals") -> "Residuals":
        """Return self + factor * other."""
        contacts, pairs = (
            tuple(tuple(a + b * factor for a, b in zip(*both, strict=True)) for both in zip(*each, strict=True))
            for each in ((self.contacts, other.contacts), (self.pairs, other.pairs))
        )
        rows = tuple(a + b * factor for a, b in zip(self.rows, other.rows, strict=True))
        return Residuals(contacts, rows, pairs)


class SumOverLimbs:
    """A sum of numbers of joints; terms that differ between limbs are added up over the limbs at the end."""

    def __init__(self, single: Scalar = ZERO):
        self._single, self._stack = single, ZERO

    def add(self, number: Scalar, n: int) -> None:
        """Add a number that occurs once for each of n bodies."""
        if n == 1:
            self._single = self._single + number
        elif number.is_constant and not number.varies_over_stack:
            self._single = self._single + number * n
        else:
            self._stack = self._stack + number

    @property
    def value(self) -> Scalar:
        """The sum of all numbers that were added."""
        return self._single if self._stack.is_exactly(0) else self._single + self._stack.sum_over_stack(1)


class StepProblem(NamedTuple):
    """The problem of a physics step: accelerations a with M a = f + constraint forces, found by Newton's method."""

    layout: RobotLayout
    smooth: SmoothTerms
    constraints: Constraints
    force: Acceleration  # f: all forces but those of constraints

    def count_limbs_with_joint(self, joint: Joint) -> int:
        """Return the number of bodies that have a joint like the given one, one in each limb."""
        return self.layout.stacks[joint[0]].n

    def momentum(self, a: Acceleration) -> Acceleration:
        """Return the product M a of mass matrix and acceleration."""
        smooth, has_base = self.smooth, self.layout.has_free_base
        base = [SumOverLimbs() for _ in range(6)]
        joints = {joint: SumOverLimbs() for joint in a.joints}
        for joint, rate in a.joints.items():
            n = self.count_limbs_with_joint(joint)
            for inner in [*self.layout.inner_joints[joint], joint]:
                entry = smooth.mass.get((inner, joint), ZERO)
                joints[inner].add(entry * rate, n if self.count_limbs_with_joint(inner) == 1 else 1)
                if inner != joint:
                    joints[joint].add(entry * a.joints[inner], 1)
            if has_base:
                joints[joint].add(smooth.momenta[joint].dot(a.base), 1)
                for total, part in zip(base, _parts(smooth.momenta[joint] * rate), strict=True):
                    total.add(part, n)
        whole = smooth.whole.momentum(a.base) if has_base else STILL
        return Acceleration(
            whole + _spatial([one.value for one in base]), {joint: one.value for joint, one in joints.items()}
        )

    def residuals(self, a: Acceleration, wanted: bool) -> Residuals:
        """Return the accelerations along all constraints, minus their reference accelerations if `wanted`."""
        contacts = []
        for one in self.constraints.contacts:
            moved = a.base if self.layout.has_free_base else STILL
            at_point, turned = moved.velocity_at(one.at), moved.angular
            for joint in self.layout.moving_joints(one.point.stack):
                motion, rate = self.smooth.motions[joint], a.joints[joint]
                at_point = at_point + motion.velocity_at(one.at) * rate
                if one.dim > len(one.frame):
                    turned = turned + motion.angular * rate
            given = contact_frame_components(one.frame, at_point, turned, one.dim)
            if wanted:
                given = tuple(x - y for x, y in zip(given, one.wanted, strict=True))
            contacts.append(given)
        pairs = []
        for one in self.constraints.pairs:
            moved = compute_relative_motion(self.layout, self.smooth, one, a.joints)
            given = contact_frame_components(one.frame, moved.velocity_at(one.at), moved.angular, one.dim)
            if wanted:
                given = tuple(x - y for x, y in zip(given, one.wanted, strict=True))
            pairs.append(given)
        along = [row.project(a.base, a.joints) for row in self.constraints.rows]
        rows = [x - row.wanted if wanted else x for x, row in zip(along, self.constraints.rows, strict=True)]
        return Residuals(tuple(contacts), tuple(rows), tuple(pairs))

    def constraint_force(self, residuals: Residuals) -> Acceleration:
        """Return the generalized forces that all constraints exert at given residuals."""
        base = [SumOverLimbs() for _ in range(6)]
        joints = {joint: SumOverLimbs() for joint in self.force.joints}
        for one, residual in zip(self.constraints.contacts, residuals.contacts, strict=True):
            wrench = contact_wrench(one, contact_force(one, residual, self.constraints.is_elliptic))
            self._spread(wrench, one, base, joints)
        for one, residual in zip(self.constraints.pairs, residuals.pairs, strict=True):
            wrench = contact_wrench(one, contact_force(one, residual, self.constraints.is_elliptic))
            for s, part in sum_wrenches_by_stack(self.layout, one, wrench).items():
                for joint in self.layout.moving_joints(s):
                    n = self.layout.stacks[s].n if self.count_limbs_with_joint(joint) == 1 else 1
                    joints[joint].add(self.smooth.motions[joint].dot(part), n)
        for row, residual in zip(self.constraints.rows, residuals.rows, strict=True):
            force = joint_constraint_force(row, residual)[0]
            for joint, factor in row.terms:
                joints[joint].add(factor * force, row.n if self.count_limbs_with_joint(joint) == 1 else 1)
            for total, part in zip(base, _parts((row.direction or STILL) * force), strict=True):
                total.add(part, row.n)
        return Acceleration(_spatial([one.value for one in base]), {joint: one.value for joint, one in joints.items()})

    def _spread(
        self, wrench: SpatialVector, contact: Any, base: list[SumOverLimbs], joints: dict[Joint, SumOverLimbs]
    ) -> None:
        n = contact.n
        if self.layout.has_free_base:
            for total, part in zip(base, _parts(wrench), strict=True):
                total.add(part, n)
        for joint in self.layout.moving_joints(contact.point.stack):
            joints[joint].add(
                self.smooth.motions[joint].dot(wrench), n if self.count_limbs_with_joint(joint) == 1 else 1
            )

    def solve_linear_system(
        self,
        right: Acceleration,
        curves: list[ContactHessian] | None,
        stiff: dict[Joint, Scalar],
        rows: Sequence[tuple[JointConstraint, Scalar]] = (),
        pair_curves: Sequence[ContactHessian] = (),
        damped: Sequence[tuple[tuple[Joint, Joint], Scalar, int]] = (),
    ) -> Acceleration:
        """Solve the linear system of a Newton step, (M + Jᵀ C J + diag) x = right, with contact Hessians C.

        Args:
            right: The right side.
            curves: C of each contact; None for none.
            stiff: What is added to the diagonal, by joint; of `BASE` for all six directions of the base.
            rows: Rows of several joints or of the base, with the second derivatives of their costs.
            pair_curves: C of each row of pairs of the robot's geoms; empty for none.
            damped: What is added to entries of joints (inner, outer), and of how many limbs each entry is the sum.
        """
        joints, has_base = [*self.force.joints], self.layout.has_free_base
        smooth = self.smooth
        corner = [[SumOverLimbs() for _ in range(i + 1)] for i in range(6)]  # the base's block, lower triangle
        side: dict[Joint, list[SumOverLimbs]] = {}  # the base's rows by joint
        entries: dict[tuple[Joint, Joint], SumOverLimbs] = {}
        if has_base:
            whole = smooth.whole
            h, inertia = whole.moment, whole.inertia.rows
            for i, row in enumerate(_base_block(whole.mass, h, inertia)):
                for j, x in enumerate(row):
                    corner[i][j].add(x, 1)
                corner[i][i].add(stiff.get(BASE, ZERO), 1)
        for joint in joints:
            side[joint] = [SumOverLimbs(x) for x in _parts(smooth.momenta[joint])] if has_base else []
            for inner in self.layout.inner_joints[joint]:
                entries[inner, joint] = SumOverLimbs(smooth.mass.get((inner, joint), ZERO))
            entries[joint, joint] = SumOverLimbs(smooth.mass[joint, joint] + stiff.get(joint, ZERO))
        for row, bend in rows:
            self._add_row(row, bend, corner, side, entries)
        for both, number, limbs in damped:
            entries[both].add(number, limbs)
        for one, curve in zip(self.constraints.contacts, curves or (), strict=curves is not None):
            self._add_contact(one, curve, corner, side, entries)
        if pair_curves:
            coupled = CoupledSystem(
                self.layout,
                [[one.value for one in row] for row in corner],
                {joint: [one.value for one in totals] for joint, totals in side.items()},
                {both: one.value for both, one in entries.items()},
            )
            for one, curve in zip(self.constraints.pairs, pair_curves, strict=True):
                coupled.add_contacts(smooth, one, curve)
            x_base, found = coupled.solve(_parts(right.base) if has_base else [], right.joints)
            return Acceleration(_spatial(x_base) if has_base else STILL, found)
        rest = {joint: SumOverLimbs(right.joints[joint]) for joint in joints}
        base = [SumOverLimbs(x) for x in _parts(right.base)]
        inverse, low, low_base = {}, {}, {}
        for joint in reversed(joints):
            n, inner = self.count_limbs_with_joint(joint), self.layout.inner_joints[joint]
            pivot = entries[joint, joint].value
            row = {one: entries[one, joint].value for one in inner}
            row_base = [one.value for one in side[joint]]
            inverse[joint] = ONE / pivot
            low[joint] = {one: x * inverse[joint] for one, x in row.items()}
            low_base[joint] = [x * inverse[joint] for x in row_base]
            known = rest[joint].value
            rest[joint] = SumOverLimbs(known)
            for i, one in enumerate(inner):
                m = n if self.count_limbs_with_joint(one) == 1 else 1
                factor = low[joint][one]
                rest[one].add(-(factor * known), m)
                for other in inner[: i + 1]:
                    entries[other, one].add(-(factor * row[other]), m)
                for total, x in zip(side[one], row_base, strict=True):
                    total.add(-(factor * x), m)
            for i, factor in enumerate(low_base[joint]):
                base[i].add(-(factor * known), n)
                for j in range(i + 1):
                    corner[i][j].add(-(factor * row_base[j]), n)
        x_base = (
            solve_dense([[one.value for one in row] for row in corner], [one.value for one in base]) if has_base else []
        )
        found: dict[Joint, Scalar] = {}
        for joint in joints:
            x = rest[joint].value * inverse[joint]
            for one, factor in low[joint].items():
                x = x - factor * found[one]
            for factor, one in zip(low_base[joint], x_base, strict=True):
                x = x - factor * one
            found[joint] = x
        return Acceleration(_spatial(x_base) if has_base else STILL, found)

    def _add_row(self, row: JointConstraint, bend: Scalar, corner: Any, side: Any, entries: Any) -> None:
        """Add the square of a row of joints or of the base, times the second derivative of its cost."""
        if row.direction is not None:
            parts = _parts(row.direction)
            for i, totals in enumerate(corner):
                for j, total in enumerate(totals):
                    total.add(parts[i] * parts[j] * bend, row.n)
            for joint, factor in row.terms:
                limbs = row.n if self.count_limbs_with_joint(joint) == 1 else 1
                for total, part in zip(side[joint], parts, strict=True):
                    total.add(part * factor * bend, limbs)
        for both, product, limbs in multiply_terms(self.layout, row.terms, row.n):
            entries[both].add(product * bend, limbs)

    def _add_contact(self, contact: Any, curve: ContactHessian, corner: Any, side: Any, entries: Any) -> None:
        """Add Jᵀ C J of a row of contacts."""
        n, at, chain = contact.n, contact.at, self.layout.moving_joints(contact.point.stack)
        moved = [
            SpatialVector(one.velocity_at(at), one.angular) for one in (self.smooth.motions[joint] for joint in chain)
        ]
        pushed = [curve.multiply_motion(one) for one in moved]
        if self.layout.has_free_base:
            rows, extra = curve.linear.rows, curve.mixed or [NOTHING] * 3
            columns = [at.cross(row) + more for row, more in zip(rows, extra, strict=True)]
            mixed = [Vector(*(getattr(one, name) for one in columns)) for name in "xyz"]
            turned = [at.cross(row) for row in mixed]
            if curve.mixed is not None:
                crossed = [at.cross(Vector(*(getattr(row, name) for row in curve.mixed))) for name in "xyz"]
                turned = [
                    row + Vector(*(getattr(one, name) for one in crossed)) + more
                    for row, name, more in zip(turned, "xyz", curve.angular.rows, strict=True)
                ]
            for i, row in enumerate(rows):
                for j in range(i + 1):
                    corner[i][j].add(row[j], n)
            for i in range(3):
                for j in range(3):
                    corner[3 + i][j].add(mixed[i][j], n)
                for j in range(i + 1):
                    corner[3 + i][3 + j].add(turned[i][j], n)
        for joint, push in zip(chain, pushed, strict=True):
            m = n if self.count_limbs_with_joint(joint) == 1 else 1
            for total, x in zip(side[joint], (*push.linear, *(at.cross(push.linear) + push.angular)), strict=False):
                total.add(x, m)
        for i, joint in enumerate(chain):
            for j in range(i + 1):
                m = n if self.count_limbs_with_joint(joint) == 1 else 1
                power = moved[j].linear.dot(pushed[i].linear)
                if curve.mixed is not None:
                    power = power + moved[j].angular.dot(pushed[i].angular)
                entries[chain[j], joint].add(power, m)

    def first_iterate(self, warm: Acceleration) -> "Iterate":
        """Return Newton's first iterate, at the given accelerations `warm` of the last physics step."""
        residuals = self.residuals(warm, wanted=True)
        return self._iterate(warm, self.momentum(warm), residuals)

    def _iterate(self, acceleration: Acceleration, momentum: Acceleration, residuals: Residuals) -> "Iterate":
        pull = self.constraint_force(residuals)
        left = self.norm(momentum.minus(self.force).minus(pull))
        return Iterate(acceleration, momentum, residuals, pull, left / (self.norm(self.force) + self.norm(pull)))

    def norm(self, force: Acceleration) -> Scalar:
        """Return the Euclidean norm of generalized forces, with forces (N) and torques (N m) counted alike."""
        total = SumOverLimbs()
        if self.layout.has_free_base:
            for x in _parts(force.base):
                total.add(x * x, 1)
        for joint, x in force.joints.items():
            total.add(x * x, self.count_limbs_with_joint(joint))
        return square_root(total.value)

    def next_iterate(self, now: "Iterate") -> "Iterate":
        """Return the next Newton iterate, with the step length that a line search finds."""
        is_elliptic = self.constraints.is_elliptic
        constraints, residuals = self.constraints, now.residuals
        curves, pair_curves = (
            [contact_cost_hessian(*each, is_elliptic) for each in zip(*both, strict=True)]
            for both in ((constraints.contacts, residuals.contacts), (constraints.pairs, residuals.pairs))
        )
        stiff: dict[Joint, Scalar] = {}
        rows = []
        for row, residual in zip(self.constraints.rows, now.residuals.rows, strict=True):
            bend = joint_constraint_force(row, residual)[1]
            if row.is_unit and row.terms:
                joint = row.terms[0][0]
                stiff[joint] = stiff.get(joint, ZERO) + bend
            else:
                rows.append((row, bend))
        left = self.force.minus(now.momentum)
        way = self.solve_linear_system(left.add_scaled(ONE, now.pull), curves, stiff, rows, pair_curves)
        moved, changed = self.momentum(way), self.residuals(way, wanted=False)
        length = self._search(way, left, moved, now.residuals, changed)
        return self._iterate(
            now.acceleration.add_scaled(length, way),
            now.momentum.add_scaled(length, moved),
            now.residuals.add_scaled(length, changed),
        )

    def _power(self, one: Acceleration, other: Acceleration) -> Scalar:
        total = SumOverLimbs()
        if self.layout.has_free_base:
            total.add(one.base.dot(other.base), 1)
        for joint, x in one.joints.items():
            total.add(x * other.joints[joint], self.count_limbs_with_joint(joint))
        return total.value

    def _search(self, way: Any, left: Any, moved: Any, residuals: Residuals, changed: Residuals) -> Scalar:
        """Return the length of a step that makes the cost least, from a bracketed Newton's method.

        Where Newton's method leaves the bracket, the next length is where a joint with friction changes its direction,
        of all such places in the bracket the one with the largest change of slope; else the middle.
        """
        slope_at_0, bend_at_0 = -self._power(way, left), self._power(way, moved)
        like, constraints = slope_at_0.value, self.constraints
        flat = slope_at_0 * -float(ROUNDING * jnp.finfo(like.dtype).eps)
        turns = self._turning_points(residuals, changed)
        lines = [
            make_line_search_cost(*each, constraints.is_elliptic)
            for each in zip(
                (*constraints.contacts, *constraints.pairs),
                (*residuals.contacts, *residuals.pairs),
                (*changed.contacts, *changed.pairs),
                strict=True,
            )
        ]

        def try_length(state: tuple[Any, ...]) -> tuple[Any, ...]:
            count, _, length, low, high = state[0], state[1], *(Scalar(x) for x in state[2:])
            first, second = SumOverLimbs(), SumOverLimbs()
            for line in lines:
                n, (a, b) = line.contact.n, line.derivatives(length)
                first.add(a, n)
                second.add(b, n)
            for row, residual, change in zip(constraints.rows, residuals.rows, changed.rows, strict=True):
                force, curve = joint_constraint_force(row, residual + length * change)
                first.add(-(force * change), row.n)
                second.add(curve * change * change, row.n)
            slope = slope_at_0 + length * bend_at_0 + first.value
            bend = bend_at_0 + second.value
            falls = slope < ZERO
            low, high = where(falls, length, low), where(falls, high, length)
            # once nothing is left to move, both are 0
            new = length - slope / largest(bend, 1e-20)
            is_found = ~(flat < slope) & ~(slope < -flat)
            is_open = ~(high < Scalar(NEVER / 10))
            within = (low < new) & (new < high) | is_open
            is_out = ~(is_found | within)
            choose = partial(self._choose_turn, turns)
            new = jax.lax.cond(is_out, lambda a, b, _: choose(a, b), lambda *x: x[2], low.value, high.value, new.value)
            return count + 1, is_found, where(is_found, length, Scalar(new)).value, low.value, high.value

        start = jnp.int32(0), jnp.zeros_like(like, bool), *(jnp.full_like(like, x) for x in (1.0, 0.0, NEVER))
        found = jax.lax.while_loop(lambda state: (state[0] < TRIALS) & ~state[1], try_length, start)
        return Scalar(found[2])

    def _turning_points(self, residuals: Residuals, changed: Residuals) -> list[tuple[Scalar, Scalar, int]]:
        """Return step lengths at which joints with friction turn, with the changes of slope there."""
        found = []
        for row, residual, change in zip(self.constraints.rows, residuals.rows, changed.rows, strict=True):
            if row.most is not None:
                size = largest(change, -change)
                moves = Scalar(1e-20) < size
                place = -residual / where(moves, change, ONE)
                found.append((place, where(moves, size * row.most, ZERO), row.n))
        return found

    def _choose_turn(self, turns: list[tuple[Scalar, Scalar, int]], shorter: Array, longer: Array) -> Any:
        """Return the turning point between two step lengths with the largest change of slope; their middle for none."""
        low, high = Scalar(shorter), Scalar(longer)
        best, middle = Scalar(jnp.zeros_like(low.value)), (low + high) * 0.5
        inner = [(place, where((low < place) & (place < high), jump, ZERO), n) for place, jump, n in turns]
        for _, jump, n in inner:
            best = largest(best, Scalar(jump.value.max()) if n > 1 else jump)
        chosen, count = SumOverLimbs(), SumOverLimbs()
        for place, jump, n in inner:
            is_best = (jump > ZERO) & ~(jump < best)
            chosen.add(where(is_best, place, ZERO), n)
            count.add(where(is_best, ONE, ZERO), n)
        if not inner:
            return middle.value
        return where(count.value > ZERO, chosen.value / largest(count.value, ONE), middle).value


class Iterate(NamedTuple):
    """An iterate of Newton's method for a physics step: accelerations, constraint forces and residuals."""

    acceleration: Acceleration
    momentum: Acceleration
    residuals: Residuals
    pull: Acceleration  # forces of constraints
    error: Scalar  # what is left over of the equation, as a share of all forces


def solve_step_by_newton(problem: StepProblem, warm: Acceleration, iterations: int) -> Iterate:
    """Return the accelerations of a physics step, by Newton's method from those of the last step.

    Contacts of the robot with itself couple its limbs. They are part of the equations only in rollouts that have such
    contacts, and cost nothing where no rollout of a warp or vector has.

    Args:
        problem: The equation.
        warm: Accelerations to begin with.
        iterations: Iterations, at most: a rollout that has converged stays as it is. 0 for none, which returns `warm`.
    """
    if not problem.constraints.pairs:
        return _iterate_newton(problem, warm, iterations)
    pairs = problem.constraints.pairs
    touches = jnp.stack([(one.weight > ZERO).any() for one in pairs]).any()
    apart = problem._replace(constraints=problem.constraints._replace(pairs=()))
    still = tuple((ZERO,) * one.dim for one in pairs)
    found = _iterate_newton(apart, warm, iterations, ~touches)
    found = found._replace(residuals=found.residuals._replace(pairs=still))
    coupled = jax.eval_shape(lambda: flatten_scalars(_iterate_newton(problem, warm, iterations))[0])
    values, rebuild = flatten_scalars(found)
    dtype = coupled[0].dtype
    values = [jnp.broadcast_to(jnp.asarray(x, dtype), like.shape) for x, like in zip(values, coupled, strict=True)]

    def couple(values: list[Any]) -> list[Any]:
        return [jnp.asarray(x, dtype) for x in flatten_scalars(_iterate_newton(problem, warm, iterations))[0]]

    return rebuild(jax.lax.cond(touches, couple, lambda values: values, values))


def _iterate_newton(problem: StepProblem, warm: Acceleration, iterations: int, is_wanted: Any = True) -> Iterate:
    """Newton's iterations, where they are wanted."""
    if not iterations:
        return problem.first_iterate(warm)
    values, rebuild = flatten_scalars(problem.first_iterate(warm))
    dtype = next(x.dtype for x in values if hasattr(x, "dtype"))
    shapes = jax.eval_shape(lambda: flatten_scalars(problem.next_iterate(rebuild(values)))[0])
    values = [jnp.broadcast_to(jnp.asarray(x, dtype), like.shape) for x, like in zip(values, shapes, strict=True)]
    enough = float(CONVERGED * jnp.finfo(dtype).eps)

    def goes_on(state: tuple[Any, list[Any]]) -> Any:
        more = (state[0] < iterations) & (rebuild(state[1]).error.value > enough)
        return more if is_wanted is True else more & is_wanted

    def body(state: tuple[Any, list[Any]]) -> tuple[Any, list[Any]]:
        count, values = state
        after = flatten_scalars(problem.next_iterate(rebuild(values)))[0]
        return count + 1, [jnp.asarray(x, dtype) for x in after]

    return rebuild(jax.lax.while_loop(goes_on, body, (jnp.int32(0), values))[1])


def _parts(one: SpatialVector) -> list[Scalar]:
    return [*one.linear, *one.angular]


def _spatial(parts: list[Scalar]) -> SpatialVector:
    return SpatialVector(Vector(*parts[:3]), Vector(*parts[3:]))


def _base_block(mass: Scalar, h: Vector, inertia: Any) -> list[list[Scalar]]:
    """Lower triangle of the inertia of a body, linear before angular."""
    return [
        [mass],
        [ZERO, mass],
        [ZERO, ZERO, mass],
        [ZERO, -h.z, h.y, inertia[0].x],
        [h.z, ZERO, -h.x, inertia[1].x, inertia[1].y],
        [-h.y, h.x, ZERO, *inertia[2]],
    ]

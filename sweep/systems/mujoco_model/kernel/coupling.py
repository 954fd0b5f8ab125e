"""Motion and equations of limbs that contacts of the robot with itself couple.

Without such contacts limbs meet in the base only, and one operation eliminates a joint of all limbs. With them, joints
are eliminated one by one, in an order that keeps the matrix as sparse as the model's pairs allow.
"""

from typing import Any

from sweep.systems.mujoco_model.kernel.constraints import ContactHessian
from sweep.systems.mujoco_model.kernel.layout import RobotLayout
from sweep.systems.mujoco_model.kernel.pairs import (
    BodyMember,
    JointMember,
    PairContacts,
    inner_members,
    join_motions,
    joints_between,
    order_elimination,
)
from sweep.systems.mujoco_model.kernel.scalars import ZERO, Scalar, join_members, join_vectors
from sweep.systems.mujoco_model.kernel.smooth import STILL, SmoothTerms, SpatialVector

Joint = tuple[int, int]


def compute_relative_motion(
    layout: RobotLayout, smooth: SmoothTerms, contact: PairContacts, rates: dict[Joint, Scalar]
) -> SpatialVector:
    """Return the motion of the second bodies of a row of pairs relative to the first, for given rates of the joints."""
    sides = []
    for bodies in contact.row.bodies:
        moved = {s: STILL for s, _ in bodies}
        for s in moved:
            for joint in layout.moving_joints(s):
                moved[s] += smooth.motions[joint] * rates[joint]
        sides.append(join_motions(moved, bodies))
    return sides[1] - sides[0]


def sum_wrenches_by_stack(
    layout: RobotLayout, contact: PairContacts, wrench: SpatialVector
) -> dict[int, SpatialVector]:
    """Return the forces and moments on the bodies of each stack that a row of pairs exerts.

    Args:
        layout: Stacks of like bodies of the robot.
        contact: The row.
        wrench: Forces and moments on the second bodies; those on the first are opposite.
    """
    found: dict[BodyMember, SpatialVector] = {}
    for bodies, sign in zip(contact.row.bodies, (-1.0, 1.0), strict=True):
        for k, body in enumerate(bodies):
            if contact.row.real[k]:
                part = SpatialVector(*(one.stack_member(k) * sign for one in wrench))
                found[body] = found.get(body, STILL) + part
    stacks = {}
    for s, _ in found:
        each = [found.get((s, member), STILL) for member in range(layout.stacks[s].n)]
        single = len(each) == 1
        stacks[s] = each[0] if single else SpatialVector(*(join_vectors([one[k] for one in each]) for k in range(2)))
    return stacks


class CoupledSystem:
    """The linear system of a Newton step, with a row for every joint of every limb and six for the base.

    Args:
        layout: Stacks of like bodies of the robot.
        corner: The base's block, its lower triangle.
        side: The base's rows (6) by joint.
        entries: Entries of two joints of a limb, by (inner, outer).
    """

    def __init__(
        self,
        layout: RobotLayout,
        corner: list[list[Scalar]],
        side: dict[Joint, list[Scalar]],
        entries: dict[tuple[Joint, Joint], Scalar],
    ):
        self._layout, self._couplings = layout, []
        self._matrix: dict[frozenset, Scalar] = {}
        self._base: list[Any] = [("base", k) for k in range(6 * layout.has_free_base)]
        for i, row in enumerate(corner[: len(self._base)]):
            for j, x in enumerate(row):
                self._add(self._base[i], self._base[j], x)
        for joint in layout.joints:
            for member in range(layout.stacks[joint[0]].n):
                for one, x in zip(self._base, side[joint], strict=True):
                    self._add(one, (joint, member), x.stack_member(member))
                for inner in [*inner_members(layout, (joint, member)), (joint, member)]:
                    self._add(inner, (joint, member), entries[inner[0], joint].stack_member(member))

    def _add(self, one: Any, other: Any, number: Scalar) -> None:
        key = frozenset((one, other))
        self._matrix[key] = self._matrix.get(key, ZERO) + number

    def add_contacts(self, smooth: SmoothTerms, contact: PairContacts, curve: ContactHessian) -> None:
        """Add the second derivatives of the costs of a row of pairs.

        Args:
            smooth: Kinematics of the state.
            contact: The row.
            curve: Second derivative of the cost of each contact.
        """
        for k in range(contact.n):
            if not contact.row.real[k]:
                continue
            bodies = contact.row.bodies[0][k], contact.row.bodies[1][k]
            self._couplings.append(bodies)
            at, own = contact.at.stack_member(k), curve.stack_member(k)
            moved: list[tuple[JointMember, SpatialVector]] = []
            for members, sign in zip(joints_between(self._layout, bodies), (-1.0, 1.0), strict=True):
                for joint, member in members:
                    motion = SpatialVector(*(one.stack_member(member) for one in smooth.motions[joint]))
                    linear = motion.velocity_at(at) * sign
                    moved.append(((joint, member), SpatialVector(linear, motion.angular * sign)))
            pushed = [own.multiply_motion(one) for _, one in moved]
            for i, (one, push) in enumerate(zip(moved, pushed, strict=True)):
                for other in moved[: i + 1]:
                    power = push.linear.dot(other[1].linear)
                    if own.mixed is not None:
                        power = power + push.angular.dot(other[1].angular)
                    self._add(one[0], other[0], power)

    def solve(self, base: list[Scalar], joints: dict[Joint, Scalar]) -> tuple[list[Scalar], dict[Joint, Scalar]]:
        """Return the solution for a right side: numbers of the base and of all joints."""
        order: list[Any] = [*order_elimination(self._layout, self._couplings)[0], *self._base]
        lower = [[self._matrix.get(frozenset((a, b)), ZERO) for b in order[: i + 1]] for i, a in enumerate(order)]
        right = [joints[one[0]].stack_member(one[1]) for one in order[: len(order) - len(self._base)]]
        found = dict(zip(order, solve_dense(lower, [*right, *base]), strict=True))
        by_joint = {
            joint: join_members([found[joint, member] for member in range(self._layout.stacks[joint[0]].n)])
            for joint in joints
        }
        return [found[one] for one in self._base], by_joint


def solve_dense(lower: list[list[Scalar]], right: list[Scalar]) -> list[Scalar]:
    """Solve a symmetric positive system by L D Lᵀ; known zeros of its matrix cost nothing until they are filled in.

    Args:
        lower: Lower triangle of the matrix, by rows.
        right: The right side.
    """
    n, full = len(right), [list(row) for row in lower]
    known, inverse = list(right), []
    factors = [[ZERO] * n for _ in range(n)]
    for k in range(n):
        inverse.append(1 / full[k][k])
        for i in range(k + 1, n):
            factors[i][k] = full[i][k] * inverse[k]
        for i in range(k + 1, n):
            for j in range(k + 1, i + 1):
                full[i][j] = full[i][j] - factors[i][k] * full[j][k]
            known[i] = known[i] - factors[i][k] * known[k]
    x = [a * b for a, b in zip(known, inverse, strict=True)]
    for k in reversed(range(n)):
        for i in range(k + 1, n):
            x[k] = x[k] - factors[i][k] * x[i]
    return x

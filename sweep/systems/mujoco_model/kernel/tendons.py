"""Fixed tendons: sums of joint positions that have springs, dampers, armature and actuators."""

from typing import NamedTuple

import mujoco
import numpy as np

from sweep.systems.mujoco_model.kernel.layout import RobotLayout, find_joint_member
from sweep.systems.mujoco_model.kernel.links import ON_TENDON, find_tendon_coefficients
from sweep.systems.mujoco_model.kernel.numbers import ModelFieldValues
from sweep.systems.mujoco_model.kernel.scalars import ZERO, Scalar, join_members

Joint = tuple[int, int]
Terms = tuple[tuple[Joint, Scalar], ...]  # joints, and the factors that a sum has of their positions


class LinkRow(NamedTuple):
    """Tendons or equality constraints of corresponding joints, one of each limb."""

    joints: tuple[Joint, ...]
    ids: np.ndarray  # (n,), of one of the others where a limb has none
    real: np.ndarray  # (n,) whether a limb has one

    @property
    def n(self) -> int:
        """Number of limbs in the row, 1 for a part of the robot that has no twin."""
        return len(self.ids)


def group_links_by_limb(layout: RobotLayout, links: list[tuple[int, list[int]]]) -> list[LinkRow]:
    """Group tendons or equality constraints of corresponding joints of limbs into rows.

    Args:
        layout: Stacks of like bodies of the robot.
        links: The id of each, and the ids of its joints.
    """
    found: list[tuple[tuple[Joint, ...], list[int]]] = []
    for number, joints in links:
        places = [find_joint_member(layout, one) for one in joints]
        key, n = tuple(place[0] for place in places), max(layout.stacks[place[0][0]].n for place in places)
        member = next((k for joint, k in places if layout.stacks[joint[0]].n == n), 0)
        row = next((ids for joints, ids in found if joints == key and ids[member] < 0), None)
        if row is None:
            row = [-1] * n
            found.append((key, row))
        row[member] = number
    rows = []
    for key, ids in found:
        real = np.array(ids) >= 0
        rows.append(LinkRow(key, np.where(real, ids, max(ids)), real))
    return rows


class TendonRow(NamedTuple):
    """Corresponding fixed tendons of all limbs."""

    ids: np.ndarray  # (n,) of the tendons
    terms: Terms  # factors are 0 where a limb has no such tendon

    @property
    def n(self) -> int:
        """Number of limbs in the row, 1 for a part of the robot that has no twin."""
        return len(self.ids)

    def combine(self, numbers: dict[Joint, Scalar]) -> Scalar:
        """Return the sum of the tendon's numbers of joints, such as its length of positions."""
        return sum((factor * numbers[joint] for joint, factor in self.terms), ZERO)


def find_tendon_rows(layout: RobotLayout, model: mujoco.MjModel) -> list[TendonRow]:
    """Return the fixed tendons of a model as rows of corresponding ones.

    Args:
        layout: Stacks of like bodies of the robot.
        model: The model.
    """
    links = [(one, list(find_tendon_coefficients(model, one))) for one in range(model.ntendon)]
    found = []
    for row in group_links_by_limb(layout, links):
        each = [
            list(find_tendon_coefficients(model, int(one)).values()) if real else [0.0] * len(row.joints)
            for one, real in zip(row.ids, row.real, strict=True)
        ]
        factors = (join_members([Scalar(x) for x in one]) for one in zip(*each, strict=True))
        found.append(TendonRow(row.ids, tuple(zip(row.joints, factors, strict=True))))
    return found


def list_tendon_actuators(model: mujoco.MjModel, tendon: int) -> list[int]:
    """Return the actuators that pull a tendon.

    Args:
        model: The model.
        tendon: Id of the tendon.
    """
    mine = (model.actuator_trntype == ON_TENDON) & (model.actuator_trnid[:, 0] == tendon)
    return np.flatnonzero(mine).tolist()


def add_tendon_armature(
    layout: RobotLayout, numbers: ModelFieldValues, mass: dict[tuple[Joint, Joint], Scalar]
) -> None:
    """Add the armature of tendons to the mass matrix of joints, whose keys are (inner, outer).

    Like MuJoCo, leave out entries of joints of which neither moves the other.
    """
    for row in find_tendon_rows(layout, numbers.model):
        if numbers.may_be_nonzero("tendon_armature", row.ids):
            armature = numbers.get("tendon_armature", row.ids)
            for both, product, limbs in multiply_terms(layout, row.terms, row.n):
                if both in mass:
                    added = product * armature
                    mass[both] = mass[both] + (added.sum_over_stack(limbs) if limbs > 1 else added)


def multiply_terms(layout: RobotLayout, terms: Terms, n: int) -> list[tuple[tuple[Joint, Joint], Scalar, int]]:
    """Return what the square of a sum of joint positions adds to a symmetric matrix of joints.

    Args:
        layout: Stacks of like bodies of the robot.
        terms: The sum.
        n: Number of limbs that have such a sum.

    Returns:
        For each entry its joints (inner, outer), the number, and of how many limbs the entry is the sum.
    """
    ranked = sorted(terms, key=lambda term: layout.joints.index(term[0]))
    found = []
    for k, (outer, factor) in enumerate(ranked):
        limbs = n if layout.stacks[outer[0]].n == 1 else 1
        found += [((inner, outer), factor * other, limbs) for inner, other in ranked[: k + 1]]
    return found

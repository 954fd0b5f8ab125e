"""Constraints that link joints: limits and friction of fixed tendons, and equalities of joints, tendons and points."""

from typing import NamedTuple

import mujoco
import numpy as np

from sweep.systems.mujoco_model.kernel.constraints import JointConstraint, compute_impedance, read_constraint_law
from sweep.systems.mujoco_model.kernel.layout import (
    RobotLayout,
    find_fixed_places,
    find_joint_member,
    find_stack_of_body,
)
from sweep.systems.mujoco_model.kernel.links import (
    CONNECT,
    JOINT,
    SITE,
    TENDON,
    find_connected_bodies,
    find_tendon_coefficients,
    list_equalities,
    list_joints_above,
)
from sweep.systems.mujoco_model.kernel.numbers import ModelFieldValues
from sweep.systems.mujoco_model.kernel.scalars import (
    NOTHING,
    ONE,
    ZERO,
    Scalar,
    Vector,
    join_members,
    rotate_to_world,
    square_root,
    where,
)
from sweep.systems.mujoco_model.kernel.smooth import (
    STILL,
    UPRIGHT,
    RobotState,
    SmoothTerms,
    SpatialVector,
    relative_acceleration,
)
from sweep.systems.mujoco_model.kernel.tendons import Joint, LinkRow, find_tendon_rows, group_links_by_limb


def compute_link_constraints(
    layout: RobotLayout, numbers: ModelFieldValues, state: RobotState, smooth: SmoothTerms
) -> list[JointConstraint]:
    """Compute the rows of tendons that have limits or friction, and of equality constraints.

    Args:
        layout: Stacks of like bodies of the robot.
        numbers: Numbers of the rollout's model.
        state: State of the robot.
        smooth: Kinematics of the state.
    """
    found = _tendon_rows(layout, numbers, state)
    for kind in (JOINT, TENDON):
        found += _coupling_rows(layout, numbers, state, kind)
    return found + _connect_rows(layout, numbers, state, smooth)


def _tendon_rows(layout: RobotLayout, numbers: ModelFieldValues, state: RobotState) -> list[JointConstraint]:
    """Friction and limits of tendons."""
    model, found = numbers.model, []
    for row in find_tendon_rows(layout, model):
        ids, inverse = row.ids, numbers.get("tendon_invweight0", row.ids)
        length, rate = row.combine(state.angles), row.combine(state.rates)
        if numbers.may_be_nonzero("tendon_frictionloss", ids):
            law = read_constraint_law(numbers, "tendon_solref_fri", "tendon_solimp_fri", ids)
            weight = law.impedance[0] / (inverse * (1 - law.impedance[0]))
            most = numbers.get("tendon_frictionloss", ids)
            found.append(JointConstraint(row.terms, row.n, weight, -(rate * law.damping), most))
        limited = model.tendon_limited[ids].astype(bool)
        if limited.any():
            low, high = (numbers.get("tendon_range", ids, k) for k in range(2))
            far = Scalar(np.where(limited, 0.0, 1e6) if row.n > 1 else 0.0)
            under, over = length - (low - far), high + far - length
            is_low = under < over
            depth, side = where(is_low, under, over), where(is_low, ONE, -ONE)
            law = read_constraint_law(numbers, "tendon_solref_lim", "tendon_solimp_lim", ids)
            margin = numbers.get("tendon_margin", ids)
            impedance = compute_impedance(law, depth - margin)
            weight = where(depth < margin, impedance / (inverse * (1 - impedance)), ZERO)
            wanted = -(side * rate) * law.damping - law.stiffness * impedance * (depth - margin)
            terms = tuple((joint, factor * side) for joint, factor in row.terms)
            found.append(JointConstraint(terms, row.n, weight, wanted))
    return found


def _coupling_rows(
    layout: RobotLayout, numbers: ModelFieldValues, state: RobotState, kind: int
) -> list[JointConstraint]:
    """Equalities of joints or of tendons: a length is a polynomial of another one, or constant."""
    model, found, every = numbers.model, [], list_equalities(numbers.model, kind)
    for is_pair in (False, True):
        sides = (model.eq_obj1id, model.eq_obj2id) if is_pair else (model.eq_obj1id,)
        chosen = [one for one in every if (model.eq_obj2id[one] >= 0) == is_pair]
        links = [(one, [j for side in sides for j in _find_factors(model, kind, int(side[one]))]) for one in chosen]
        for row in group_links_by_limb(layout, links):
            law = read_constraint_law(numbers, "eq_solref", "eq_solimp", row.ids)
            parts = [_combine_joints(layout, model, kind, row, side[row.ids]) for side in sides]
            data = [numbers.get("eq_data", row.ids, k) for k in range(5)]
            moved = [sum((x * _move(numbers, layout, state, joint) for joint, x in one.items()), ZERO) for one in parts]
            rates = [sum((x * state.rates[joint] for joint, x in one.items()), ZERO) for one in parts]
            inverse = sum((_inverse_weight(numbers, kind, side[row.ids]) for side in sides), ZERO)
            error, rate, terms = moved[0] - data[0], rates[0], dict(parts[0])
            if is_pair:
                x = moved[1]
                error = error - x * (data[1] + x * (data[2] + x * (data[3] + x * data[4])))
                slope = data[1] + x * (data[2] * 2 + x * (data[3] * 3 + x * (data[4] * 4)))
                rate = rate - slope * rates[1]
                for joint, factor in parts[1].items():
                    terms[joint] = terms.get(joint, ZERO) - slope * factor
            impedance = compute_impedance(law, error)
            weight = impedance / (inverse * (1 - impedance))
            wanted = -(rate * law.damping) - law.stiffness * impedance * error
            found.append(JointConstraint(tuple(terms.items()), row.n, weight, wanted, is_equality=True))
    return found


def _find_factors(model: mujoco.MjModel, kind: int, number: int) -> dict[int, float]:
    """Factors by joint of what an equality has as one of its two lengths: a joint or a tendon."""
    return {number: 1.0} if kind == JOINT else find_tendon_coefficients(model, number)


def _combine_joints(
    layout: RobotLayout, model: mujoco.MjModel, kind: int, row: LinkRow, numbers: np.ndarray
) -> dict[Joint, Scalar]:
    """Factors of joints in one of the two lengths of a row; 0 where a limb has no such equality."""
    each = [_find_factors(model, kind, int(one)) for one in numbers]
    keys = [find_joint_member(layout, one)[0] for one in each[0]]
    rows = [list(one.values()) if real else [0.0] * len(keys) for one, real in zip(each, row.real, strict=True)]
    factors = (join_members([Scalar(x) for x in column]) for column in zip(*rows, strict=True))
    return dict(zip(keys, factors, strict=True))


def _move(numbers: ModelFieldValues, layout: RobotLayout, state: RobotState, joint: Joint) -> Scalar:
    """How far joints are from their positions in the model's reference configuration."""
    ids = layout.stacks[joint[0]].joints[joint[1]]
    return state.angles[joint] - numbers.get("qpos0", numbers.model.jnt_qposadr[ids])


def _inverse_weight(numbers: ModelFieldValues, kind: int, ids: np.ndarray) -> Scalar:
    if kind == JOINT:
        return numbers.get("dof_invweight0", numbers.model.jnt_dofadr[ids])
    return numbers.get("tendon_invweight0", ids)


class _Anchor(NamedTuple):
    """Points of bodies that equalities hold together with others."""

    stack: int | None  # None for the world
    bodies: np.ndarray  # ids (n,)
    at: Vector  # from the base's origin
    velocity: Vector
    acceleration: Vector  # while no joint and no base accelerates, less gravity


def _connect_rows(
    layout: RobotLayout, numbers: ModelFieldValues, state: RobotState, smooth: SmoothTerms
) -> list[JointConstraint]:
    """Equalities that hold points of two bodies together, three rows each."""
    model, found = numbers.model, []
    alike: dict[tuple, list[tuple[int, list[int]]]] = {}
    for one in list_equalities(model, CONNECT):
        bodies = find_connected_bodies(model, one)
        stacks = tuple(find_stack_of_body(layout, b)[0] if model.body_weldid[b] else None for b in bodies)
        joints = [j for body in bodies for j in list_joints_above(model, body)]
        alike.setdefault((stacks, int(model.eq_objtype[one])), []).append((one, joints))
    for (stacks, kind), links in alike.items():
        for row in group_links_by_limb(layout, links):
            anchors = [_locate_anchor(numbers, state, smooth, row, kind, stacks, side) for side in range(2)]
            law = read_constraint_law(numbers, "eq_solref", "eq_solimp", row.ids)
            inverse = sum((numbers.get("body_invweight0", one.bodies, 0) for one in anchors), ZERO)
            errors, rates, drifts = (one - other for one, other in zip(anchors[0][2:], anchors[1][2:], strict=True))
            impedance = compute_impedance(law, square_root(errors.dot(errors)))
            weight = impedance / (inverse * (1 - impedance))
            real = ONE if row.real.all() else Scalar(row.real.astype(float))
            for k, axis in enumerate(UPRIGHT):
                terms: dict[Joint, Scalar] = {}
                direction = STILL
                for anchor, sign in zip(anchors, (real, -real), strict=True):
                    if anchor.stack is None:
                        continue
                    for joint in layout.moving_joints(anchor.stack):
                        moved = smooth.motions[joint].velocity_at(anchor.at)[k] * sign
                        terms[joint] = terms.get(joint, ZERO) + moved
                    direction = direction + SpatialVector(axis, anchor.at.cross(axis)) * sign
                wanted = -(rates[k] * law.damping) - law.stiffness * impedance * errors[k] - drifts[k]
                of_base = direction if layout.has_free_base else None
                every = tuple(terms.items())
                found.append(JointConstraint(every, row.n, weight, wanted, direction=of_base, is_equality=True))
    return found


def _locate_anchor(
    numbers: ModelFieldValues,
    state: RobotState,
    smooth: SmoothTerms,
    row: LinkRow,
    kind: int,
    stacks: tuple[int | None, int | None],
    side: int,
) -> _Anchor:
    """Points on one side of a row of equalities, given in the axes of bodies or as sites."""
    model, stack = numbers.model, stacks[side]
    bodies = np.array([find_connected_bodies(model, int(one))[side] for one in row.ids])
    if kind == SITE:
        sites = (model.eq_obj1id, model.eq_obj2id)[side][row.ids]
        arm = numbers.get_vector("site_pos", sites)
    else:
        arm = Vector(*(numbers.get("eq_data", row.ids, 3 * side + k) for k in range(3)))
    if stack is None:
        places, axes = find_fixed_places(model)
        columns = tuple(
            Vector(*(join_members([Scalar(float(axes[b, i, k])) for b in bodies]) for i in range(3))) for k in range(3)
        )
        place = Vector(*(join_members([Scalar(float(places[b, i])) for b in bodies]) for i in range(3)))
        at = place + rotate_to_world(columns, arm) - state.position  # pyright: ignore[reportArgumentType]
        return _Anchor(None, bodies, at, NOTHING, -numbers.get_vector("opt.gravity"))
    place = smooth.places[stack]
    arm = rotate_to_world(place.axes, arm)
    at, spin = place.origin + arm, place.motion.angular
    drift = place.acceleration + relative_acceleration(spin, place.spin_rate, arm)
    return _Anchor(stack, bodies, at, place.motion.velocity_at(at), drift)

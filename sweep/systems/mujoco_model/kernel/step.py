"""One physics step of MuJoCo: forces, accelerations under constraints, and Euler's or the implicit fast integrator."""

import operator
from functools import reduce
from typing import Any, NamedTuple

import jax.numpy as jnp
import mujoco
import numpy as np
from jaxtyping import Array, Float

from sweep.systems.mujoco_model.kernel.constraints import (
    ELLIPTIC,
    Constraints,
    compute_joint_constraints,
    find_contacts,
)
from sweep.systems.mujoco_model.kernel.ground import find_ground_contacts
from sweep.systems.mujoco_model.kernel.layout import RobotLayout, joint_actuators
from sweep.systems.mujoco_model.kernel.link_constraints import compute_link_constraints
from sweep.systems.mujoco_model.kernel.numbers import ModelFieldValues
from sweep.systems.mujoco_model.kernel.pairs import find_pair_contacts
from sweep.systems.mujoco_model.kernel.scalars import (
    NOTHING,
    ONE,
    ZERO,
    Scalar,
    Vector,
    largest,
    multiply_quaternions,
    quaternion_axes,
    rotate_to_body,
    rotate_to_world,
    smallest,
    square_root,
    stack_scalars,
    where,
)
from sweep.systems.mujoco_model.kernel.smooth import (
    BASE,
    STILL,
    RobotState,
    SmoothTerms,
    SpatialVector,
    compute_smooth_terms,
    point_force_wrench,
)
from sweep.systems.mujoco_model.kernel.solver import Acceleration, Iterate, Joint, StepProblem, solve_step_by_newton
from sweep.systems.mujoco_model.kernel.tendons import (
    TendonRow,
    find_tendon_rows,
    list_tendon_actuators,
    multiply_terms,
)

IMPLICIT = int(mujoco.mjtIntegrator.mjINT_IMPLICITFAST)
UNBALANCED = 0.01  # share of the forces that may be left over in a solved step, as for other engines
UNCLAMPED, EXPLICIT = (int(getattr(mujoco.mjtDisableBit, f"mjDSBL_{name}")) for name in ("CLAMPCTRL", "EULERDAMP"))


class ActuatorState(NamedTuple):
    """Force, length and velocity of corresponding actuators of all limbs in a physics step."""

    actuators: np.ndarray  # ids (n,)
    force: Scalar  # N or N m, of the actuator
    length: Scalar  # of the actuator
    velocity: Scalar


class StepResult(NamedTuple):
    """Kinematics, forces and accelerations at the start of a physics step."""

    smooth: SmoothTerms
    problem: StepProblem
    solution: Iterate
    drives: tuple[ActuatorState, ...]
    is_unsolved: Any  # () bool
    is_unsure: Any = False  # () bool, whether there is a contact that the kernel does not simulate


class ImplicitDamping(NamedTuple):
    """Damping that the integrator treats implicitly: how forces fall with rates."""

    joints: dict[Joint, Scalar]  # of each joint, and of `BASE`
    pairs: tuple[tuple[tuple[Joint, Joint], Scalar, int], ...]  # of tendons, see `StepProblem.solve_linear_system`


class BodyPush(NamedTuple):
    """An external force on one body, at its centre of mass, in world axes."""

    stack: int
    member: int
    force: Vector  # N


def read_state(layout: RobotLayout, model: mujoco.MjModel, qpos: Array, qvel: Array, warm: Array) -> RobotState:
    """Convert MuJoCo's `qpos` (nq,), `qvel` (nv,) and `qacc_warmstart` (nv,) to a state of the kernel."""
    angles, rates, before = {}, {}, {}
    for joint in layout.joints:
        ids = layout.stacks[joint[0]].joints[joint[1]]
        places, dofs = model.jnt_qposadr[ids], model.jnt_dofadr[ids]
        for found, values, at in ((angles, qpos, places), (rates, qvel, dofs), (before, warm, dofs)):
            found[joint] = Scalar(values[int(at[0])] if len(at) == 1 else values[at])
    if not layout.has_free_base:
        none = (ONE, ZERO, ZERO, ZERO)
        return RobotState(NOTHING, none, STILL, angles, rates, STILL, before)
    free = int(model.body_jntadr[layout.stacks[0].bodies[0]])
    q, v = int(model.jnt_qposadr[free]), int(model.jnt_dofadr[free])
    quat = tuple(Scalar(qpos[q + 3 + k]) for k in range(4))
    axes = quaternion_axes(*quat)  # pyright: ignore[reportArgumentType]

    def vector(values: Array, first: int) -> Vector:
        return Vector(*(Scalar(values[first + k]) for k in range(3)))

    moving = [SpatialVector(vector(one, v), rotate_to_world(axes, vector(one, v + 3))) for one in (qvel, warm)]
    return RobotState(vector(qpos, q), quat, moving[0], angles, rates, moving[1], before)  # pyright: ignore


def write_state(layout: RobotLayout, model: mujoco.MjModel, state: RobotState) -> tuple[Array, Array, Array]:
    """Convert a state of the kernel to MuJoCo's `qpos` (nq,), `qvel` (nv,) and `qacc_warmstart` (nv,)."""
    dtype = next(one.value.dtype for one in state.angles.values())
    qpos, qvel, warm = ([ZERO] * size for size in (model.nq, model.nv, model.nv))
    for joint in layout.joints:
        ids = layout.stacks[joint[0]].joints[joint[1]]
        for values, numbers, at in (
            (qpos, state.angles, model.jnt_qposadr[ids]),
            (qvel, state.rates, model.jnt_dofadr[ids]),
            (warm, state.warm, model.jnt_dofadr[ids]),
        ):
            for k, place in enumerate(at):
                values[place] = numbers[joint].stack_member(k)
    if layout.has_free_base:
        free = int(model.body_jntadr[layout.stacks[0].bodies[0]])
        q, v = int(model.jnt_qposadr[free]), int(model.jnt_dofadr[free])
        qpos[q : q + 7] = [*state.position, *state.quat]
        axes = quaternion_axes(*state.quat)
        for values, moving in ((qvel, state.velocity), (warm, state.warm_base)):
            values[v : v + 6] = [*moving.linear, *rotate_to_body(axes, moving.angular)]
    return stack_scalars(qpos, dtype), stack_scalars(qvel, dtype), stack_scalars(warm, dtype)


def compute_forces(
    layout: RobotLayout,
    numbers: ModelFieldValues,
    state: RobotState,
    smooth: SmoothTerms,
    ctrl: Array,
    pushes: tuple[BodyPush, ...],
) -> tuple[Acceleration, ImplicitDamping, tuple[ActuatorState, ...]]:
    """Compute all forces of a physics step except constraint forces.

    Args:
        layout: Stacks of like bodies of the robot.
        numbers: Numbers of the rollout's model.
        state: State of the robot.
        smooth: Kinematics, mass matrix and bias forces of the state.
        ctrl: Controls (nu,).
        pushes: Forces on bodies.

    Returns:
        Generalized forces; the damping that the integrator treats implicitly; the actuators.
    """
    model = numbers.model
    is_implicit = model.opt.integrator == IMPLICIT
    damps_implicitly = is_implicit or not model.opt.disableflags & EXPLICIT
    forces, damping, found, pairs = {}, {}, [], []
    by_tendon: dict[Joint, tuple[Scalar, Scalar]] = {}  # forces of springs and dampers, and of actuators
    for row in find_tendon_rows(layout, model):
        passive, driven, drag, drives = _pull_tendons(numbers, row, state, ctrl)
        found += drives
        for joint, factor in row.terms:
            limbs = row.n if layout.stacks[joint[0]].n == 1 else 1
            pulls = (factor * passive, factor * driven)
            pulls = [one.sum_over_stack(limbs) if limbs > 1 else one for one in pulls]
            before = by_tendon.get(joint, (ZERO, ZERO))
            by_tendon[joint] = before[0] + pulls[0], before[1] + pulls[1]
        if is_implicit and not drag.is_exactly(0):
            entries = multiply_terms(layout, row.terms, row.n)
            pairs += [(both, product * drag, limbs) for both, product, limbs in entries if both in smooth.mass]
    for joint in layout.joints:
        ids = layout.stacks[joint[0]].joints[joint[1]]
        dofs, places = model.jnt_dofadr[ids], model.jnt_qposadr[ids]
        angle, rate = state.angles[joint], state.rates[joint]
        drag = numbers.get("dof_damping", dofs)
        passive = -(drag * rate)
        if numbers.may_be_nonzero("jnt_stiffness", ids):
            passive = passive - numbers.get("jnt_stiffness", ids) * (angle - numbers.get("qpos_spring", places))
        driven, soft = ZERO, drag if damps_implicitly else ZERO
        for acting in zip(*(joint_actuators(model, int(j)) for j in ids), strict=True):
            those = np.array(acting)
            drive, gear, velocity_gain = _drive(numbers, those, angle, rate, ctrl)
            found.append(drive)
            driven = driven + gear * drive.force
            if is_implicit:
                soft = soft - gear * gear * velocity_gain
        if joint in by_tendon:
            passive, driven = passive + by_tendon[joint][0], driven + by_tendon[joint][1]
        limited = model.jnt_actfrclimited[ids].astype(bool)
        if limited.any():
            low, high = (numbers.get("jnt_actfrcrange", ids, k) for k in range(2))
            far = Scalar(np.where(limited, 0.0, 1e9))
            driven = smallest(largest(driven, low - far), high + far)
        forces[joint] = driven + passive - smooth.bias[joint]
        damping[joint] = soft
    base = smooth.bias_base * Scalar(-1.0)
    dofs = layout.base_dof_indices(model)
    if len(dofs) and numbers.may_be_nonzero("dof_damping", dofs):
        drag = numbers.get("dof_damping", dofs[:1])
        base = base - state.velocity * drag
        damping[BASE] = drag if damps_implicitly else ZERO
    for push in pushes:
        stack, place = layout.stacks[push.stack], smooth.places[push.stack]
        force = push.force
        if stack.n > 1:
            mask = Scalar((np.arange(stack.n) == push.member).astype(float))
            force = force * mask
        wrench = point_force_wrench(place.centre, force)
        base = base + (wrench.sum_over_stack(stack.n) if stack.n > 1 else wrench)
        for joint in layout.moving_joints(push.stack):
            pull = smooth.motions[joint].dot(wrench)
            wide = stack.n > 1 and layout.stacks[joint[0]].n == 1
            forces[joint] = forces[joint] + (pull.sum_over_stack(stack.n) if wide else pull)
    return Acceleration(base, forces), ImplicitDamping(damping, tuple(pairs)), tuple(found)


def _pull_tendons(
    numbers: ModelFieldValues, row: TendonRow, state: RobotState, ctrl: Array
) -> tuple[Scalar, Scalar, Scalar, list[ActuatorState]]:
    """Forces of tendons by springs and dampers, and by actuators; how both fall with their rates; and the actuators."""
    model, ids = numbers.model, row.ids
    length, rate = row.combine(state.angles), row.combine(state.rates)
    drag, driven, found = numbers.get("tendon_damping", ids), ZERO, []
    passive = -(drag * rate)
    if numbers.may_be_nonzero("tendon_stiffness", ids):
        low, high = (numbers.get("tendon_lengthspring", ids, k) for k in range(2))
        stretch = largest(length - high, 0.0) + smallest(length - low, 0.0)
        passive = passive - numbers.get("tendon_stiffness", ids) * stretch
    for acting in zip(*(list_tendon_actuators(model, int(one)) for one in ids), strict=True):
        drive, gear, velocity_gain = _drive(numbers, np.array(acting), length, rate, ctrl)
        found.append(drive)
        driven = driven + gear * drive.force
        drag = drag - gear * gear * velocity_gain
    return passive, driven, drag, found


def _drive(
    numbers: ModelFieldValues, ids: np.ndarray, angle: Scalar, rate: Scalar, ctrl: Array
) -> tuple[ActuatorState, Scalar, Scalar]:
    """Force of an actuator of each joint, its gear, and how its force grows with its velocity."""
    model = numbers.model
    control = Scalar(ctrl[int(ids[0])] if len(ids) == 1 else ctrl[ids])
    if model.actuator_ctrllimited[ids].any() and not model.opt.disableflags & UNCLAMPED:
        control = _clamp(numbers, control, ids, "actuator_ctrlrange", model.actuator_ctrllimited)[0]
    gear = numbers.get("actuator_gear", ids, 0)
    length, velocity = gear * angle, gear * rate
    gain = [numbers.get("actuator_gainprm", ids, k) for k in range(3)]
    affine = model.actuator_gaintype[ids] == int(mujoco.mjtGain.mjGAIN_AFFINE)
    biased = model.actuator_biastype[ids] == int(mujoco.mjtBias.mjBIAS_AFFINE)
    strength, slope = gain[0], ZERO
    if affine.any():
        share = Scalar(affine.astype(float))
        strength = strength + share * (gain[1] * length + gain[2] * velocity)
        slope = slope + share * gain[2] * control
    force = strength * control
    if biased.any():
        bias = [Scalar(biased.astype(float)) * numbers.get("actuator_biasprm", ids, k) for k in range(3)]
        force = force + bias[0] + bias[1] * length + bias[2] * velocity
        slope = slope + bias[2]
    if model.actuator_forcelimited[ids].any():
        force, is_free = _clamp(numbers, force, ids, "actuator_forcerange", model.actuator_forcelimited)
        slope = where(is_free, slope, ZERO) if not slope.is_exactly(0) else slope
    return ActuatorState(ids, force, length, velocity), gear, slope


def _clamp(numbers: ModelFieldValues, value: Scalar, ids: np.ndarray, name: str, limited: Any) -> tuple[Scalar, Any]:
    """A number within a range where it is limited, and whether it was within."""
    low, high = (numbers.get(name, ids, k) for k in range(2))
    flags = limited[ids].astype(bool)
    if not flags.all():
        far = Scalar(np.where(flags, 0.0, 1e9))
        low, high = low - far, high + far
    return smallest(largest(value, low), high), (low < value) & (value < high)


def step(
    layout: RobotLayout,
    numbers: ModelFieldValues,
    state: RobotState,
    ctrl: Float[Array, " nu"],
    pushes: tuple[BodyPush, ...],
    iterations: int,
) -> tuple[RobotState, StepResult]:
    """Advance a robot's state by one physics step.

    Args:
        layout: Stacks of like bodies of the robot.
        numbers: Numbers of the rollout's model.
        state: The state at the start of the step.
        ctrl: Controls.
        pushes: Forces on bodies.
        iterations: Iterations of Newton's method.

    Returns:
        The state at the end, and what was computed at the start.
    """
    result, damping = compute_forward_dynamics(layout, numbers, state, ctrl, pushes, iterations)
    h, solution, problem = float(numbers.model.opt.timestep), result.solution, result.problem
    acceleration = solution.acceleration
    total = problem.force.add_scaled(ONE, solution.pull)
    moved = acceleration
    if damping.pairs or not all(one.is_exactly(0) for one in damping.joints.values()):
        soft = {joint: one * h for joint, one in damping.joints.items()}
        pairs = [(both, number * h, limbs) for both, number, limbs in damping.pairs]
        moved = problem.solve_linear_system(total, None, soft, damped=pairs)
    rates = {joint: rate + moved.joints[joint] * h for joint, rate in state.rates.items()}
    angles = {joint: angle + rates[joint] * h for joint, angle in state.angles.items()}
    if not layout.has_free_base:
        after = RobotState(NOTHING, state.quat, STILL, angles, rates, STILL, acceleration.joints)
        return after, result
    velocity = state.velocity + moved.base * Scalar(h)
    position = state.position + velocity.linear * h
    quat = _turn(state.quat, velocity.angular, h)
    after = RobotState(position, quat, velocity, angles, rates, acceleration.base, acceleration.joints)
    return after, result


def _turn(quat: Any, spin: Vector, h: float) -> Any:
    """Integrate an orientation over h seconds at an angular velocity in the world's axes."""
    size = square_root(spin.dot(spin) + 1e-24)
    half = size * (0.5 * h)
    share = Scalar(jnp.sin(half.value)) / size
    turned = multiply_quaternions((Scalar(jnp.cos(half.value)), spin.x * share, spin.y * share, spin.z * share), quat)
    length = square_root(sum((one * one for one in turned), ZERO))
    return tuple(one / length for one in turned)


def compute_forward_dynamics(
    layout: RobotLayout,
    numbers: ModelFieldValues,
    state: RobotState,
    ctrl: Array,
    pushes: tuple[BodyPush, ...],
    iterations: int,
) -> tuple[StepResult, ImplicitDamping]:
    """Compute the accelerations of a state under all forces, and the damping that the integrator needs."""
    smooth = compute_smooth_terms(layout, numbers, state)
    force, damping, drives_ = compute_forces(layout, numbers, state, smooth, ctrl, pushes)
    contacts = find_contacts(layout, numbers, state, smooth)
    others, unsure = find_ground_contacts(layout, numbers, state, smooth)
    pairs = find_pair_contacts(layout, numbers, smooth)
    rows = (
        *compute_joint_constraints(layout, numbers, state),
        *compute_link_constraints(layout, numbers, state, smooth),
    )
    constraints = Constraints((*contacts, *others), rows, numbers.model.opt.cone == ELLIPTIC, tuple(pairs))
    problem = StepProblem(layout, smooth, constraints, force)
    warm = Acceleration(state.warm_base, state.warm)
    solution = solve_step_by_newton(problem, warm, iterations)
    is_unsolved = Scalar(UNBALANCED) < solution.error
    flags = [*unsure, *(one.is_unsure for one in pairs)]
    for flag in flags:
        is_unsolved = is_unsolved | flag
    is_unsure = reduce(operator.or_, flags, jnp.asarray(False))
    return StepResult(smooth, problem, solution, drives_, is_unsolved, is_unsure), damping

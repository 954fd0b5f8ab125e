"""Sensor readings in a state, for the sensor types that policies of legged robots use."""

from collections.abc import Callable, Container
from typing import Any

import mujoco
import numpy as np

from sweep.systems.mujoco_model.kernel.constraints import contact_force
from sweep.systems.mujoco_model.kernel.layout import (
    BOX,
    HINGE,
    SPHERE,
    RobotLayout,
    find_joint_member,
    find_stack_of_body,
)
from sweep.systems.mujoco_model.kernel.links import find_lever
from sweep.systems.mujoco_model.kernel.numbers import ModelFieldValues
from sweep.systems.mujoco_model.kernel.scalars import (
    NOTHING,
    ZERO,
    Axes,
    Scalar,
    Vector,
    clip,
    largest,
    multiply_quaternions,
    rotate_to_body,
    rotate_to_world,
    rotation_quaternion,
    smallest,
    square_root,
    where,
)
from sweep.systems.mujoco_model.kernel.smooth import RobotState, SpatialVector, relative_acceleration
from sweep.systems.mujoco_model.kernel.step import StepResult

Sensor = mujoco.mjtSensor
SITE, BODY, XBODY, GEOM = (int(getattr(mujoco.mjtObj, f"mjOBJ_{one}")) for one in ("SITE", "BODY", "XBODY", "GEOM"))
POSITIVE = int(mujoco.mjtDataType.mjDATATYPE_POSITIVE)


class Frame:
    """A frame that is fixed in a body of the robot: a site, a geom, or the body itself.

    Args:
        layout: Stacks of like bodies of the robot.
        numbers: Numbers of the rollout's model.
        state: State of the robot.
        result: Kinematics, forces and accelerations of the state.
        kind: MuJoCo's type of the object, such as a site.
        number: Id of the object.
    """

    def __init__(
        self,
        layout: RobotLayout,
        numbers: ModelFieldValues,
        state: RobotState,
        result: StepResult,
        kind: int,
        number: int,
    ):
        model, ids = numbers.model, np.array([number])
        self._numbers, self._state, self._result = numbers, state, result
        names = {SITE: "site", GEOM: "geom"}
        body = int(number if kind in (BODY, XBODY) else getattr(model, f"{names[kind]}_bodyid")[number])
        self._stack, self._member = find_stack_of_body(layout, body)
        self._layout, place = layout, result.smooth.places[self._stack]
        x, y, z = (one.stack_member(self._member) for one in place.axes)
        origin, axes = place.origin.stack_member(self._member), (x, y, z)
        prefix = {SITE: "site", GEOM: "geom", BODY: "body_i", XBODY: ""}[kind]
        prefix = f"{prefix}_" if kind in names else prefix
        self.offset = rotate_to_world(axes, numbers.get_vector(f"{prefix}pos", ids)) if prefix else NOTHING
        columns = numbers.get_rotation_columns(f"{prefix}quat", ids) if prefix else None
        self.axes: Axes = tuple(rotate_to_world(axes, one) for one in columns) if columns else axes  # pyright: ignore
        self.own_quat = np.asarray(getattr(model, f"{prefix}quat")[number]) if prefix else np.array([1.0, 0, 0, 0])
        self.place = origin + self.offset  # from the base's origin
        moving = place.motion
        self.spin = moving.angular.stack_member(self._member)
        self.velocity = moving.linear.stack_member(self._member) + self.spin.cross(self.place)

    @property
    def position(self) -> Vector:
        """Position of the frame in the world (m)."""
        return self._state.position + self.place

    @property
    def acceleration(self) -> Vector:
        """Acceleration minus gravity (m/s^2), in world axes, as an accelerometer feels it."""
        smooth, found = self._result.smooth, self._result.solution.acceleration
        place = smooth.places[self._stack]
        spin_rate = place.spin_rate.stack_member(self._member)
        total = place.acceleration.stack_member(self._member) + relative_acceleration(self.spin, spin_rate, self.offset)
        moved = found.base.velocity_at(self.place) if self._layout.has_free_base else NOTHING
        for joint in self._layout.moving_joints(self._stack):
            linear, angular = (part.stack_member(self._member) for part in smooth.motions[joint])
            rate = found.joints[joint].stack_member(self._member)
            moved = moved + SpatialVector(linear, angular).velocity_at(self.place) * rate
        return total + moved

    @property
    def quat(self) -> tuple[Scalar, ...]:
        """Orientation (w, x, y, z) of the frame in the world; used only for frames of the base."""
        numbers, found, joints = self._numbers, tuple(self._state.quat), self._state.angles
        for s in self._layout.ancestor_stacks(self._stack):
            stack = self._layout.stacks[s]
            member = self._member if stack.n > 1 else 0
            if stack.parent >= 0:
                ids = stack.bodies[member : member + 1]
                found = multiply_quaternions(found, tuple(numbers.get("body_quat", ids, k) for k in range(4)))
            for k, same in enumerate(stack.joints):
                ids = same[member : member + 1]
                if numbers.model.jnt_type[ids[0]] != HINGE:
                    continue
                start = numbers.get("qpos0", numbers.model.jnt_qposadr[ids])
                turn = rotation_quaternion(
                    numbers.get_vector("jnt_axis", ids), joints[s, k].stack_member(member) - start
                )
                found = multiply_quaternions(found, turn)
        return multiply_quaternions(found, tuple(Scalar(float(x)) for x in self.own_quat))


def compute_sensors(
    layout: RobotLayout,
    numbers: ModelFieldValues,
    state: RobotState,
    result: StepResult,
    wanted: Container[int] | None = None,
) -> list[Scalar]:
    """Compute the values of MuJoCo's sensors in a state of the robot.

    Args:
        layout: Stacks of like bodies of the robot.
        numbers: Numbers of the rollout's model.
        state: State of the robot.
        result: Kinematics, forces and accelerations of the state; without accelerations where no wanted sensor
            needs them.
        wanted: Ids of sensors; None for all.

    Returns:
        Numbers (nsensordata), 0 for sensors that are not wanted, or of `find_unsupported_sensors`.
    """
    model, found = numbers.model, []
    for k in range(model.nsensor):
        dim = int(model.sensor_dim[k])
        rule = RULES.get(int(model.sensor_type[k]))
        if rule is None or (wanted is not None and k not in wanted) or _why_unknown(layout, model, k):
            found += [ZERO] * dim
            continue
        values = [*rule(layout, numbers, state, result, k)]
        limit = numbers.get("sensor_cutoff", np.array([k]))
        if not limit.is_exactly(0):
            low = ZERO if int(model.sensor_datatype[k]) == POSITIVE else -limit
            values = [smallest(largest(one, low), limit) for one in values]
        found += values
    return found


def find_unsupported_sensors(layout: RobotLayout, model: mujoco.MjModel) -> dict[int, str]:
    """Return the sensors of a model that the kernel does not compute, with the reason."""
    why = {k: _why_unknown(layout, model, k) for k in range(model.nsensor)}
    return {k: reason for k, reason in why.items() if reason}


def _why_unknown(layout: RobotLayout, model: mujoco.MjModel, k: int) -> str:
    kind, name = int(model.sensor_type[k]), Sensor(int(model.sensor_type[k])).name.removeprefix("mjSENS_").lower()
    if kind not in RULES:
        return name
    if model.sensor_reftype[k]:
        return f"{name} in another frame"
    if kind in FRAMES:
        bodies = {SITE: model.site_bodyid, GEOM: model.geom_bodyid}
        number = int(model.sensor_objid[k])
        table = bodies.get(int(model.sensor_objtype[k]))
        body = number if table is None else int(table[number])
        stacks = [s for s, stack in enumerate(layout.stacks) if body in stack.bodies]
        if not stacks or not body:
            return f"{name} of what does not move"
    if kind == int(Sensor.mjSENS_SUBTREECOM) and not model.body_weldid[model.sensor_objid[k]]:
        return f"{name} of what does not move"
    if kind == int(Sensor.mjSENS_TOUCH) and int(model.site_type[model.sensor_objid[k]]) not in (SPHERE, BOX):
        return f"{name} of a site that is neither sphere nor box"
    return ""


def _frame(layout: Any, numbers: Any, state: Any, result: Any, k: int) -> Frame:
    model = numbers.model
    return Frame(layout, numbers, state, result, int(model.sensor_objtype[k]), int(model.sensor_objid[k]))


def _of_frame(read: Callable[[Frame], Any]) -> Callable[..., Any]:
    return lambda *args: read(_frame(*args))


def _joint(read: Callable[[RobotState, tuple[int, int]], Scalar]) -> Callable[..., list[Scalar]]:
    def rule(
        layout: RobotLayout, numbers: ModelFieldValues, state: RobotState, result: StepResult, k: int
    ) -> list[Scalar]:
        joint, member = find_joint_member(layout, int(numbers.model.sensor_objid[k]))
        return [read(state, joint).stack_member(member)]

    return rule


def _actuator_force(
    layout: RobotLayout, numbers: ModelFieldValues, state: RobotState, result: StepResult, k: int
) -> list[Scalar]:
    """Force of all actuators on a joint, within the joint's range."""
    model, joint = numbers.model, np.array([int(numbers.model.sensor_objid[k])])
    total = ZERO
    for drive in result.drives:
        for place, actuator in enumerate(drive.actuators):
            if lever := find_lever(model, int(actuator), int(joint[0])):
                gear = numbers.get("actuator_gear", drive.actuators[place : place + 1], 0)
                total = total + gear * drive.force.stack_member(place) * lever
    if model.jnt_actfrclimited[joint[0]]:
        total = clip(total, *(numbers.get("jnt_actfrcrange", joint, side) for side in range(2)))
    return [total]


def _actuator(read: Callable[[Any], Scalar]) -> Callable[..., list[Scalar]]:
    def rule(
        layout: RobotLayout, numbers: ModelFieldValues, state: RobotState, result: StepResult, k: int
    ) -> list[Scalar]:
        number = int(numbers.model.sensor_objid[k])
        (drive,) = [one for one in result.drives if number in one.actuators]
        return [read(drive).stack_member(int(np.flatnonzero(drive.actuators == number)[0]))]

    return rule


def _touch(
    layout: RobotLayout, numbers: ModelFieldValues, state: RobotState, result: StepResult, k: int
) -> list[Scalar]:
    """Sum of the normal forces of contacts of the site's body, whose normals meet the site's volume."""
    model, problem = numbers.model, result.problem
    site = int(model.sensor_objid[k])
    frame, body = _frame(layout, numbers, state, result, k), int(model.site_bodyid[site])
    total = ZERO
    for contact, residual in zip(problem.constraints.contacts, result.solution.residuals.contacts, strict=True):
        mine = contact.point.bodies == body
        if not (mine & contact.point.real).any():
            continue
        force = contact_force(contact, residual, problem.constraints.is_elliptic)[0]
        at = contact.at
        if len(mine) > 1 and mine.sum() == 1:
            member = int(np.flatnonzero(mine)[0])
            force, at = force.stack_member(member), at.stack_member(member)
            total = total + _if_hit(numbers, site, frame, at, -contact.frame[0].stack_member(member), force)
        else:  # rows of one body
            total = total + _if_hit(numbers, site, frame, at, -contact.frame[0], force).sum_over_stack(1)
    for contact, residual in zip(problem.constraints.pairs, result.solution.residuals.pairs, strict=True):
        force = contact_force(contact, residual, problem.constraints.is_elliptic)[0]
        for geoms, sign in zip(contact.row.geoms, (1.0, -1.0), strict=True):
            for member in np.flatnonzero((model.geom_bodyid[geoms] == body) & contact.row.real):
                k = int(member)
                way = contact.frame[0].stack_member(k) * sign
                total = total + _if_hit(numbers, site, frame, contact.at.stack_member(k), way, force.stack_member(k))
    return [total]


def _if_hit(numbers: ModelFieldValues, site: int, frame: Frame, at: Vector, way: Vector, force: Scalar) -> Scalar:
    """A force where a ray from a point along a unit vector meets the volume of a site, see `mju_rayGeom`."""
    ids, arm = np.array([site]), at - frame.place
    if int(numbers.model.site_type[site]) == SPHERE:
        radius = numbers.get("site_size", ids, 0)
        along, reach = way.dot(arm), arm.dot(arm) - radius * radius
        left = along * along - reach
        hit = (left > ZERO) & ~(square_root(largest(left, 0.0)) < along)
        return where(hit, force, ZERO)
    point, line = rotate_to_body(frame.axes, arm), rotate_to_body(frame.axes, way)
    near, far = Scalar(-1e10), Scalar(1e10)
    size = [numbers.get("site_size", ids, k) for k in range(3)]
    for p, d, half in zip(point, line, size, strict=True):
        safe = where(largest(d, -d) < 1e-12, Scalar(1e-12), d)
        ends = (half - p) / safe, (-half - p) / safe
        near, far = largest(near, smallest(*ends)), smallest(far, largest(*ends))
    return where((near < far) & ~(far < ZERO), force, ZERO)


def _subtree_centre(
    layout: RobotLayout, numbers: ModelFieldValues, state: RobotState, result: StepResult, k: int
) -> list[Scalar]:
    """Centre of mass (m, world axes) of a body and all bodies that it moves."""
    model, root = numbers.model, int(numbers.model.sensor_objid[k])
    inside = {root}
    for body in range(root + 1, model.nbody):  # parents come before their children
        inside |= {body} if int(model.body_parentid[body]) in inside else set()
    mass, moment = ZERO, NOTHING
    for stack, place in zip(layout.stacks, result.smooth.places, strict=True):
        chosen = np.isin(stack.bodies, list(inside))
        own = numbers.get("body_mass", stack.bodies)
        own = own if chosen.all() else own * Scalar(chosen.astype(float))
        mass = mass + own.sum_over_stack(stack.n)
        moment = moment + Vector(*(one.sum_over_stack(stack.n) for one in place.centre * own))
    return [*(state.position + moment * (1 / mass))]


FRAME_RULES: dict[str, Callable[[Frame], Any]] = {
    "ACCELEROMETER": lambda frame: rotate_to_body(frame.axes, frame.acceleration),
    "VELOCIMETER": lambda frame: rotate_to_body(frame.axes, frame.velocity),
    "GYRO": lambda frame: rotate_to_body(frame.axes, frame.spin),
    "FRAMEPOS": lambda frame: frame.position,
    "FRAMEQUAT": lambda frame: frame.quat,
    "FRAMEXAXIS": lambda frame: frame.axes[0],
    "FRAMEYAXIS": lambda frame: frame.axes[1],
    "FRAMEZAXIS": lambda frame: frame.axes[2],
    "FRAMELINVEL": lambda frame: frame.velocity,
    "FRAMEANGVEL": lambda frame: frame.spin,
}
FRAMES = {int(getattr(Sensor, f"mjSENS_{name}")) for name in (*FRAME_RULES, "TOUCH")}
RULES: dict[int, Callable[..., Any]] = {
    **{int(getattr(Sensor, f"mjSENS_{name}")): _of_frame(read) for name, read in FRAME_RULES.items()},
    int(Sensor.mjSENS_TOUCH): _touch,
    int(Sensor.mjSENS_SUBTREECOM): _subtree_centre,
    int(Sensor.mjSENS_JOINTPOS): _joint(lambda state, joint: state.angles[joint]),
    int(Sensor.mjSENS_JOINTVEL): _joint(lambda state, joint: state.rates[joint]),
    int(Sensor.mjSENS_JOINTACTFRC): _actuator_force,
    int(Sensor.mjSENS_ACTUATORPOS): _actuator(lambda drive: drive.length),
    int(Sensor.mjSENS_ACTUATORVEL): _actuator(lambda drive: drive.velocity),
    int(Sensor.mjSENS_ACTUATORFRC): _actuator(lambda drive: drive.force),
}

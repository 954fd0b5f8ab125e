"""Stacks of like bodies of a model, and the features of models that the kernel simulates.

Bodies form stacks: the base alone, and limbs that are alike joint by joint, such as the four hips of a quadruped, in
which one operation computes all. A stack is a body alone (n = 1) or one body of each of `RobotLayout.group` limbs.
"""

from typing import NamedTuple

import mujoco
import numpy as np

from sweep.core.errors import InputError
from sweep.systems.mujoco_model.geom_pairs import may_touch
from sweep.systems.mujoco_model.kernel.hulls import find_hull
from sweep.systems.mujoco_model.kernel.links import (
    CONNECT,
    JOINT,
    ON_TENDON,
    TENDON,
    has_spatial_tendons,
    list_linked_joints,
)

FREE, BALL, SLIDE, HINGE = (int(getattr(mujoco.mjtJoint, f"mjJNT_{one}")) for one in ("FREE", "BALL", "SLIDE", "HINGE"))
GEOM = mujoco.mjtGeom
PLANE, SPHERE, CAPSULE, BOX, CYLINDER, ELLIPSOID, MESH, HFIELD = (
    int(getattr(GEOM, f"mjGEOM_{one}"))
    for one in ("PLANE", "SPHERE", "CAPSULE", "BOX", "CYLINDER", "ELLIPSOID", "MESH", "HFIELD")
)
GROUND_SHAPES = {  # shapes of the robot whose contacts with a shape of the world are simulated; `guard` watches others
    PLANE: (SPHERE, CAPSULE, BOX, CYLINDER, ELLIPSOID, MESH),
    SPHERE: (SPHERE, CAPSULE),
    CAPSULE: (SPHERE, CAPSULE),
    BOX: (SPHERE,),
    HFIELD: (SPHERE,),
}
UNKNOWN_FIELDS = (
    "dof_dampingpoly",
    "jnt_stiffnesspoly",
    "tendon_dampingpoly",
    "tendon_stiffnesspoly",
    "actuator_damping",
    "actuator_dampingpoly",
    "actuator_armature",
    "actuator_delay",
    "geom_adhesion",
    "geom_surfacevel",
    "geom_fluid",
)
Disabled = mujoco.mjtDisableBit
ALLOWED_FLAGS = (  # the last ones change nothing of what the kernel simulates, or only where its solver starts
    Disabled.mjDSBL_CLAMPCTRL,
    Disabled.mjDSBL_EULERDAMP,
    Disabled.mjDSBL_REFSAFE,
    Disabled.mjDSBL_FILTERPARENT,
    Disabled.mjDSBL_MIDPHASE,
    Disabled.mjDSBL_NATIVECCD,
    Disabled.mjDSBL_MULTICCD,
    Disabled.mjDSBL_ISLAND,
    Disabled.mjDSBL_WARMSTART,
)
FREE_JOINT_FIELDS = ("dof_frictionloss", "dof_damping", "dof_armature")
FEW = 2  # bodies of a stack, at least


class BodyStack(NamedTuple):
    """Corresponding bodies of all limbs (such as all shins), computed together as arrays; or a single body."""

    bodies: np.ndarray  # (n,) ids
    parent: int  # index of the stack that holds their parents; -1 for the world's
    joints: tuple[np.ndarray, ...]  # ids (n,) of each joint, in the order in which they move the body
    geoms: tuple[np.ndarray, ...]  # ids (n,) of each geom that may touch the ground

    @property
    def n(self) -> int:
        """Number of bodies in the stack (corresponding bodies of all limbs)."""
        return len(self.bodies)


class CollisionPlane(NamedTuple):
    """A plane of the world that geoms may touch."""

    geom: int  # id
    position: np.ndarray  # (3,) m
    normal: np.ndarray  # (3,)


class StaticGeom(NamedTuple):
    """A sphere, capsule, box or height field of the world that spheres or capsules of the robot may touch."""

    geom: int  # id
    kind: int  # shape
    position: np.ndarray  # (3,) m
    axes: np.ndarray  # (3, 3) columns


class RobotLayout(NamedTuple):
    """Bodies of a model, grouped into stacks of corresponding limb bodies, parents before children, the base first."""

    stacks: tuple[BodyStack, ...]
    group: int  # bodies of a stack
    has_free_base: bool
    planes: tuple[CollisionPlane, ...]
    static_geoms: tuple[StaticGeom, ...]
    inner_joints: dict[tuple[int, int], tuple[tuple[int, int], ...]]  # by joint, see `find_inner_joints`

    def base_dof_indices(self, model: mujoco.MjModel) -> np.ndarray:
        """Return the indices (6,) of the base's free degrees of freedom, linear then angular; (0,) for a fixed base."""
        if not self.has_free_base:
            return np.zeros(0, int)
        return int(model.body_dofadr[self.stacks[0].bodies[0]]) + np.arange(6)

    @property
    def joints(self) -> list[tuple[int, int]]:
        """All joints from the base outward, as index of the stack (corresponding bodies) and joint number in it."""
        return [(s, k) for s, stack in enumerate(self.stacks) for k in range(len(stack.joints))]

    def moving_joints(self, stack: int) -> list[tuple[int, int]]:
        """Return the joints between the base and the bodies of a stack, from the base outward."""
        return [(s, k) for s in self.ancestor_stacks(stack) for k in range(len(self.stacks[s].joints))]

    def ancestor_stacks(self, stack: int) -> list[int]:
        """Return the indices of the stacks on the way from the base to `stack`, the last of them."""
        found = [stack]
        while self.stacks[found[0]].parent >= 0:
            found.insert(0, self.stacks[found[0]].parent)
        return found


def find_layout(model: mujoco.MjModel) -> RobotLayout:
    """Group the bodies of a model into stacks of corresponding limb bodies. Raises `InputError` if the kernel cannot
    simulate the model."""
    require_supported_features(model)
    links, apart = list_linked_joints(model), set()
    while True:
        layout = _group_bodies(model, apart)
        linked = {body for joints in links for body in _find_linked_twins(layout, model, joints)}
        if linked <= apart:
            return layout._replace(inner_joints=find_inner_joints(layout, links))
        apart |= linked


def _find_linked_twins(layout: RobotLayout, model: mujoco.MjModel, joints: list[int]) -> set[int]:
    """Bodies of stacks that a tendon or an equality constraint links with other limbs, so that they have no twins."""
    places = [find_joint_member(layout, one) for one in joints]
    wide = [(joint, member) for joint, member in places if layout.stacks[joint[0]].n > 1]
    narrow = [joint for joint, _ in places if layout.stacks[joint[0]].n == 1]
    is_within = len({member for _, member in wide}) < 2 and all(
        one[0] in layout.ancestor_stacks(joint[0]) for joint, _ in wide for one in narrow
    )
    return set() if is_within else {int(layout.stacks[joint[0]].bodies[member]) for joint, member in wide}


def find_inner_joints(
    layout: RobotLayout, links: list[list[int]]
) -> dict[tuple[int, int], tuple[tuple[int, int], ...]]:
    """Return the joints that the equation of each joint has when all outer ones are eliminated, from the base outward.

    They are those between it and the base, and others that tendons and equality constraints link with them.

    Args:
        layout: Stacks of like bodies of the robot.
        links: Ids of the joints that each of these links.
    """
    order = layout.joints
    meets = {joint: set(layout.moving_joints(joint[0])) & set(order[: order.index(joint)]) for joint in order}

    def link(joints: set[tuple[int, int]]) -> None:
        for outer in joints:
            meets[outer] |= {inner for inner in joints if order.index(inner) < order.index(outer)}

    for joints in links:
        link({find_joint_member(layout, one)[0] for one in joints})
    for joint in reversed(order):
        link(meets[joint])
    return {joint: tuple(sorted(inner, key=order.index)) for joint, inner in meets.items()}


def _group_bodies(model: mujoco.MjModel, apart: set[int]) -> RobotLayout:
    """Stacks of the bodies of a model, of which those `apart` are in stacks of their own."""
    planes, static_geoms = find_planes(model), find_static_geoms(model)
    ground = [one.geom for one in (*planes, *static_geoms)]
    children: dict[int, list[int]] = {b: [] for b in range(model.nbody)}
    for body in range(1, model.nbody):
        children[int(model.body_parentid[body])].append(body)
    free = np.flatnonzero(model.jnt_type == FREE)
    base = int(model.jnt_bodyid[free[0]]) if len(free) else 0
    if base:
        stray = [b for b in range(1, model.nbody) if model.body_weldid[b] and model.body_rootid[b] != base]
        if model.body_parentid[base] or stray:
            raise unsupported_model_error(
                f"body {model.body(stray[0] if stray else base).name} beside the robot with its free base"
            )

    def touched(geom: int) -> tuple[int, ...]:
        """Geoms of the world that a geom of the robot may touch, in contacts that are simulated."""
        return tuple(g for g in ground if simulates_shapes(model, geom, g) and touches_ground(model, geom, g))

    def touching(body: int) -> list[int]:
        mine = [g for g in range(model.ngeom) if model.geom_bodyid[g] == body and model.body_weldid[body]]
        return [g for g in mine if touched(g)]

    def own_joints(body: int) -> list[int]:
        first = model.body_jntadr[body]
        return [j for j in range(first, first + model.body_jntnum[body]) if model.jnt_type[j] != FREE]

    def signature(body: int) -> tuple:
        kinds = tuple((int(model.jnt_type[j]), len(joint_actuators(model, j))) for j in own_joints(body))
        fields = model.geom_type, model.geom_condim, model.geom_priority
        shapes = tuple((*(int(one[g]) for one in fields), touched(g)) for g in touching(body))
        return kinds, shapes, tuple(signature(child) for child in moving(children[body])), body if body in apart else 0

    def moving(bodies: list[int]) -> list[int]:
        return [b for b in bodies if model.body_weldid[b] or moving(children[b])]  # others belong to the world

    def size(form: tuple) -> int:
        return len(form[0]) + sum(map(size, form[2]))

    def classes(body: int) -> dict[tuple, list[int]]:
        found: dict[tuple, list[int]] = {}
        for child in moving(children[body]):
            found.setdefault(signature(child), []).append(child)
        return found

    def alone(body: int) -> list[tuple[tuple, list[int]]]:
        """Classes of like limbs of all bodies that have no twin."""
        found = list(classes(body).items())
        return found + [each for _, same in found if len(same) == 1 for each in alone(same[0])]

    many = [(len(same) * size(form), len(same)) for form, same in alone(base) if len(same) >= FEW and size(form)]
    group = max(many)[1] if many else FEW
    stacks: list[BodyStack] = []

    def add(bodies: list[int], parent: int) -> None:
        joints = tuple(np.array(one) for one in zip(*(own_joints(b) for b in bodies), strict=True))
        geoms = tuple(np.array(one) for one in zip(*(touching(b) for b in bodies), strict=True))
        place = len(stacks)
        stacks.append(BodyStack(np.array(bodies), parent, joints, geoms))
        if len(bodies) > 1:
            for each in zip(*(moving(children[b]) for b in bodies), strict=True):
                add(list(each), place)
            return
        for same in classes(bodies[0]).values():
            if len(same) == group:
                add(same, place)
            else:
                for one in same:
                    add([one], place)

    add([base], -1)
    return RobotLayout(tuple(stacks), group, bool(base), planes, static_geoms, {})


def find_stack_of_body(layout: RobotLayout, body: int) -> tuple[int, int]:
    """Return the stack (corresponding limb bodies) of a body, and its index there. Raises `InputError` without one."""
    for s, stack in enumerate(layout.stacks):
        found = np.flatnonzero(stack.bodies == body)
        if len(found):
            return s, int(found[0])
    raise unsupported_model_error(f"contacts, sensors or pushes of body number {body}, which does not move")


def find_joint_member(layout: RobotLayout, joint: int) -> tuple[tuple[int, int], int]:
    """Return a joint's key (index of its stack, number in it) and the index of its body in the stack.

    Args:
        layout: Stacks of like bodies of the robot.
        joint: Id of the joint.

    Raises:
        InputError: The joint is the free one.
    """
    for s, k in layout.joints:
        found = np.flatnonzero(layout.stacks[s].joints[k] == joint)
        if len(found):
            return (s, k), int(found[0])
    raise unsupported_model_error("sensors, tendons or equality constraints of the free joint")


def find_fixed_places(model: mujoco.MjModel) -> tuple[np.ndarray, np.ndarray]:
    """Return positions (b, 3) in m and axes (b, 3, 3) of all bodies in the reference configuration, world axes."""
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    return data.xpos.copy(), data.xmat.reshape(-1, 3, 3).copy()


def find_planes(model: mujoco.MjModel) -> tuple[CollisionPlane, ...]:
    """Return the collision planes of a model with their poses in the world."""
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    normals = data.geom_xmat.reshape(-1, 3, 3)[:, :, 2]
    normals[np.abs(normals) < 1e-15] = 0  # so that constants fold
    found = np.flatnonzero((model.geom_type == PLANE) & _may_collide(model))
    return tuple(CollisionPlane(int(g), data.geom_xpos[g].copy(), normals[g].copy()) for g in found)


def find_static_geoms(model: mujoco.MjModel) -> tuple[StaticGeom, ...]:
    """Return the spheres, capsules, boxes and height fields of the world that geoms may touch, with their poses."""
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    is_static = (model.body_weldid[model.geom_bodyid] == 0) & _may_collide(model)
    found = np.flatnonzero(is_static & np.isin(model.geom_type, [SPHERE, CAPSULE, BOX, HFIELD]))
    axes = data.geom_xmat.reshape(-1, 3, 3)
    axes[np.abs(axes) < 1e-15] = 0  # so that constants fold
    kinds = model.geom_type
    return tuple(StaticGeom(int(g), int(kinds[g]), data.geom_xpos[g].copy(), axes[g].copy()) for g in found)


def _may_collide(model: mujoco.MjModel) -> np.ndarray:
    """Whether each geom may touch another one, by its type or by an explicit pair."""
    by_type = (model.geom_contype | model.geom_conaffinity) != 0
    return by_type | np.isin(np.arange(model.ngeom), [model.pair_geom1, model.pair_geom2])


def find_contact_pair_ids(model: mujoco.MjModel, geoms: np.ndarray, others: np.ndarray) -> np.ndarray | None:
    """Return the ids of the explicit MuJoCo contact pairs between geoms and others.

    Args:
        model: The model.
        geoms: Ids (n,) of the geoms.
        others: Ids (n,) of the other geoms, or (1,) of one.

    Returns:
        Ids (n,) of the pairs; None where there are none.

    Raises:
        InputError: Some of the geoms have a pair, and others have none.
    """
    table = {frozenset(both): k for k, both in enumerate(zip(model.pair_geom1, model.pair_geom2, strict=True))}
    wanted = zip(geoms, np.broadcast_to(others, np.shape(geoms)), strict=True)
    found = [table.get(frozenset((int(one), int(other))), -1) for one, other in wanted]
    if max(found) < 0:
        return None
    if min(found) < 0:
        raise unsupported_model_error("limbs of which some, but not all, have explicit contact pairs")
    return np.array(found)


def simulates_shapes(model: mujoco.MjModel, geom: int, ground: int) -> bool:
    """Return whether the kernel simulates contacts of a geom's shape with that of a geom of the world.

    Args:
        model: The model.
        geom: Id of the robot's geom.
        ground: Id of the world's geom.
    """
    kind = int(model.geom_type[geom])
    is_small = kind != MESH or find_hull(model, geom) is not None
    return is_small and kind in GROUND_SHAPES[int(model.geom_type[ground])]


def touches_ground(model: mujoco.MjModel, geom: int, ground: int) -> bool:
    """Return whether a geom and one of the world may touch, by type or by an explicit pair."""
    excluded = (min(bodies := model.geom_bodyid[[geom, ground]].tolist()) << 16) + max(bodies)
    if find_contact_pair_ids(model, np.array([geom]), np.array([ground])) is not None:
        return True
    return bool(may_touch(model, geom, ground)) and excluded not in model.exclude_signature


def joint_actuators(model: mujoco.MjModel, joint: int) -> list[int]:
    """Return the actuators that drive a joint."""
    mine = (model.actuator_trntype != ON_TENDON) & (model.actuator_trnid[:, 0] == joint)
    return np.flatnonzero(mine).tolist()


def unsupported_model_error(what: str) -> InputError:
    """Return the error for a model with a feature that the kernel does not simulate."""
    return InputError(f"engine.name = kernel is not allowed: it does not simulate {what} (native and mjx do)")


def require_supported_features(model: mujoco.MjModel) -> None:
    """Raise `InputError` with the first feature of a model that the kernel does not simulate."""
    opt, jnt = model.opt, model.jnt_type
    on_joint = np.isin(model.actuator_trntype, [int(mujoco.mjtTrn.mjTRN_JOINT), int(mujoco.mjtTrn.mjTRN_JOINTINPARENT)])
    driven = jnt[model.actuator_trnid[on_joint, 0]]
    on_tendon = model.actuator_trntype == ON_TENDON
    equalities = np.isin(model.eq_type, [CONNECT, JOINT, TENDON]) | (model.eq_active0 == 0)
    odd = sorted({mujoco.mjtEq(int(kind)).name for kind in model.eq_type[~equalities]})
    gains = np.isin(model.actuator_gaintype, [int(mujoco.mjtGain.mjGAIN_FIXED), int(mujoco.mjtGain.mjGAIN_AFFINE)])
    biases = np.isin(model.actuator_biastype, [int(mujoco.mjtBias.mjBIAS_NONE), int(mujoco.mjtBias.mjBIAS_AFFINE)])
    free = np.flatnonzero(jnt == FREE)
    first = model.jnt_dofadr[free[0]] if len(free) else 0
    of_base = slice(first, first + 6 * len(free))
    integrators = [int(mujoco.mjtIntegrator.mjINT_EULER), int(mujoco.mjtIntegrator.mjINT_IMPLICITFAST)]
    disabled = int(opt.disableflags) & ~sum(int(one) for one in ALLOWED_FLAGS)
    other = [name for name in UNKNOWN_FIELDS if np.any(getattr(model, name, 0))]
    wrong = {
        "ball joints": (jnt == BALL).any(),
        "several free joints": len(free) > 1,
        "spatial tendons": has_spatial_tendons(model),
        "force ranges of tendons": model.tendon_actfrclimited.any(),
        f"equality constraints of type {', '.join(odd)}": len(odd),
        "plugins": model.nplugin,
        "flexible bodies": model.nflex,
        "mocap bodies": model.nmocap,
        "solreffriction of explicit contact pairs": model.pair_solreffriction.any(),
        "actuators that drive neither a joint nor a tendon": not (on_joint | on_tendon).all(),
        "actuators of the free joint": (driven < SLIDE).any(),
        "actuators with activation": model.na,
        "gains or biases of actuators that are not affine": not (gains.all() and biases.all()),
        "friction, damping or armature that differ among the directions of the free joint": any(
            np.ptp(getattr(model, name)[of_base]) > 0 for name in FREE_JOINT_FIELDS if len(free)
        ),
        "fluid forces": opt.density or opt.viscosity or np.any(opt.wind),
        "gravity compensation": model.body_gravcomp.any(),
        "noslip iterations": opt.noslip_iterations,
        f"the integrator {mujoco.mjtIntegrator(int(opt.integrator)).name}": int(opt.integrator) not in integrators,
        "height fields of moving bodies": (model.body_weldid[model.geom_bodyid[model.geom_type == HFIELD]] != 0).any(),
        "margins of contacts beside height fields": (model.geom_type == HFIELD).any() and model.geom_margin.any(),
        "disabled features of MuJoCo": disabled,
        "override of contacts or forward-inverse comparison": int(opt.enableflags)
        & ~int(mujoco.mjtEnableBit.mjENBL_ENERGY),
        f"{', '.join(other)}": len(other),
    }
    if found := [what for what, is_there in wrong.items() if is_there]:
        raise unsupported_model_error(", ".join(found))

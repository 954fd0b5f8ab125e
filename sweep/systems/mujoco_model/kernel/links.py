"""Which joints of a model its tendons and equality constraints link, and what the kernel simulates of them."""

import mujoco
import numpy as np

Equality = mujoco.mjtEq
CONNECT, JOINT, TENDON = (int(getattr(Equality, f"mjEQ_{one}")) for one in ("CONNECT", "JOINT", "TENDON"))
SITE = int(mujoco.mjtObj.mjOBJ_SITE)
ON_TENDON = int(mujoco.mjtTrn.mjTRN_TENDON)
FREE = int(mujoco.mjtJoint.mjJNT_FREE)


def find_tendon_coefficients(model: mujoco.MjModel, tendon: int) -> dict[int, float]:
    """Return the coefficients of a fixed tendon by joint: its length is the sum of joint positions times coefficients.

    Args:
        model: The model.
        tendon: Id of the tendon.
    """
    found: dict[int, float] = {}
    first = int(model.tendon_adr[tendon])
    for k in range(first, first + int(model.tendon_num[tendon])):
        joint = int(model.wrap_objid[k])
        found[joint] = found.get(joint, 0.0) + float(model.wrap_prm[k])
    return found


def find_lever(model: mujoco.MjModel, actuator: int, joint: int) -> float:
    """Return the force that an actuator of unit force and gear exerts on a joint: 1, or the coefficient of its tendon.

    Args:
        model: The model.
        actuator: Id of the actuator.
        joint: Id of the joint.
    """
    target = int(model.actuator_trnid[actuator, 0])
    if model.actuator_trntype[actuator] == ON_TENDON:
        return find_tendon_coefficients(model, target).get(joint, 0.0)
    return float(target == joint)


def has_spatial_tendons(model: mujoco.MjModel) -> bool:
    """Return whether any tendon runs through sites or about geoms, whose length is no sum of joint positions."""
    return bool((model.wrap_type != int(mujoco.mjtWrap.mjWRAP_JOINT)).any())


def list_equalities(model: mujoco.MjModel, kind: int) -> list[int]:
    """Return the ids of the active equality constraints of a kind.

    Args:
        model: The model.
        kind: MuJoCo's type, such as `CONNECT`.
    """
    return np.flatnonzero((model.eq_type == kind) & (model.eq_active0 != 0)).tolist()


def find_connected_bodies(model: mujoco.MjModel, equality: int) -> tuple[int, int]:
    """Return the two bodies that a `connect` constraint holds together.

    Args:
        model: The model.
        equality: Id of the constraint.
    """
    both = int(model.eq_obj1id[equality]), int(model.eq_obj2id[equality])
    if model.eq_objtype[equality] == SITE:
        return int(model.site_bodyid[both[0]]), int(model.site_bodyid[both[1]])
    return both


def list_linked_joints(model: mujoco.MjModel) -> list[list[int]]:
    """Return the joints that each tendon and each active equality constraint links, without the free joint."""
    by_tendon = [list(find_tendon_coefficients(model, one)) for one in range(model.ntendon)]
    found = list(by_tendon)
    for kind in (JOINT, TENDON):
        for one in list_equalities(model, kind):
            both = [int(x) for x in (model.eq_obj1id[one], model.eq_obj2id[one]) if x >= 0]
            found.append(both if kind == JOINT else [joint for tendon in both for joint in by_tendon[tendon]])
    for one in list_equalities(model, CONNECT):
        bodies = find_connected_bodies(model, one)
        found.append(sorted({joint for body in bodies for joint in list_joints_above(model, body)}))
    return found


def list_joints_above(model: mujoco.MjModel, body: int) -> list[int]:
    """Return the ids of the joints that move a body, the free one left out.

    Args:
        model: The model.
        body: Id of the body.
    """
    found = []
    while body:
        first = int(model.body_jntadr[body])
        found += [j for j in range(first, first + int(model.body_jntnum[body])) if model.jnt_type[j] != FREE]
        body = int(model.body_parentid[body])
    return found

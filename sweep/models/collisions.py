"""Collisions of links and base with the obstacle and each other in C MuJoCo; foot contacts are unchanged.

Every leg collides with every other leg, its thigh (from `Robot.hip_clearance` on) and its shin with the base between
the hips, and these two, from where the knee's fork ends, with each other. Shins end as in
`sweep.models.geometry.capsules`, in a pin that meets the obstacle.
"""

import mujoco
import numpy as np

from sweep.models.case import Case
from sweep.models.legs import LEGS
from sweep.models.obstacles.geoms import COLLISION_GROUP, STIFF_CONTACT
from sweep.models.obstacles.surface import identity_poses
from sweep.models.robot import FOOT_LENGTH, PIN_RADIUS, leg_keepout_half_size

INNER_BASE_NAME = "inner_base"  # what legs meet of their own base
OBSTACLE_COLLISION_BIT, SHIN_COLLISION_BIT, LEG_COLLISION_BIT = (
    4,
    8,
    16,
)  # what bodies collide with: contype and conaffinity, beside those of feet and balls


def enable_collisions(spec: mujoco.MjSpec, case: Case, links: tuple[str, ...]) -> None:
    """Enable collisions of the robot's links and base in a finished MuJoCo spec.

    Args:
        spec: The model of `build_spec` with geoms; changed in place.
        case: The parameters that it was built from, plain numbers.
        links: Names of a leg's links, from the hip outwards.
    """
    friction, radius = float(case.contact.friction), float(case.robot.link_radius)
    fork, hip = (float(way + radius) for way in (case.robot.fork_ratio * case.robot.shin, case.robot.hip_clearance))
    touch = {**STIFF_CONTACT, "friction": [friction, 0.005, 1e-4]}
    for solid in case.obstacle.solids(identity_poses(len(case.obstacle.free_bodies))):
        _set(spec.geom(solid.name), conaffinity=OBSTACLE_COLLISION_BIT, **touch)
    base = spec.body("base").first_geom()
    _set(base, name="base", contype=OBSTACLE_COLLISION_BIT, conaffinity=0, **touch)
    spec.body("base").add_geom(
        name=INNER_BASE_NAME,
        type=mujoco.mjtGeom.mjGEOM_BOX,
        size=np.asarray(leg_keepout_half_size(case.robot)),
        mass=0.0,
        group=COLLISION_GROUP,
        rgba=[0, 0, 0, 0],
        contype=0,
        conaffinity=SHIN_COLLISION_BIT,
        **touch,
    )
    for leg in LEGS:
        bodies = [f"{link}{leg}" for link in links]
        solid = {"contype": OBSTACLE_COLLISION_BIT | LEG_COLLISION_BIT, "conaffinity": LEG_COLLISION_BIT, **touch}
        for link in map(spec.body, bodies[:-1]):
            _add_capsule(link, link.name, (np.zeros(3), _end(link)), radius, **solid)
        thigh, shin = spec.body(f"thigh{leg}"), spec.body(bodies[-1])
        shares = (1 - off / np.linalg.norm(_end(shin)) for off in (FOOT_LENGTH + radius, radius))
        thick, thin = (_end(shin) * max(0.0, share) for share in shares)
        _add_capsule(
            shin,
            shin.name,
            (np.zeros(3), thick),
            radius,
            **solid | {"contype": OBSTACLE_COLLISION_BIT | LEG_COLLISION_BIT | SHIN_COLLISION_BIT},
        )
        _add_capsule(
            shin, f"pin{leg}", (thick, thin), PIN_RADIUS, contype=OBSTACLE_COLLISION_BIT, conaffinity=0, **touch
        )
        parts = {
            f"outer_thigh{leg}": (thigh, _way(thigh, hip), _end(thigh)),
            f"inner_thigh{leg}": (thigh, np.zeros(3), _end(thigh) - _way(thigh, fork)),
            f"outer_shin{leg}": (shin, _way(shin, fork), _end(shin) - _way(shin, FOOT_LENGTH + radius)),
        }
        for name, (body, *ends) in parts.items():
            _add_capsule(body, name, (ends[0], ends[1]), radius, contype=0, conaffinity=0)
        # as pairs, since a body and its child do not collide otherwise
        for one, other in (
            (INNER_BASE_NAME, f"outer_thigh{leg}_solid"),
            (f"inner_thigh{leg}_solid", f"outer_shin{leg}_solid"),
        ):
            spec.add_pair(
                geomname1=one, geomname2=other, friction=[friction, friction, 0.005, 1e-4, 1e-4], **STIFF_CONTACT
            )
        for inner, outer in zip(bodies, bodies[2:], strict=False):
            spec.add_exclude(bodyname1=inner, bodyname2=outer)


def _add_capsule(
    body: mujoco.MjsBody, name: str, ends: tuple[np.ndarray, np.ndarray], radius: float, **how: object
) -> None:
    """Add a capsule to a body, unless its ends coincide, as for a link without length."""
    if np.allclose(*ends):
        return
    body.add_geom(
        name=f"{name}_solid",
        type=mujoco.mjtGeom.mjGEOM_CAPSULE,
        fromto=np.concatenate(ends),
        mass=0.0,
        size=[radius, 0, 0],
        group=COLLISION_GROUP,
        rgba=[0, 0, 0, 0],
        **how,
    )


def _end(body: mujoco.MjsBody) -> np.ndarray:
    """Outer end of a link, whose mass centre is at its middle."""
    return 2 * np.asarray(body.ipos)


def _way(body: mujoco.MjsBody, way: float) -> np.ndarray:
    """Point on a link `way` (m) from its inner end, a little before its outer end at most."""
    end = _end(body)
    return end * min(way / max(float(np.linalg.norm(end)), 1e-9), 0.99)


def _set(geom: mujoco.MjsGeom, **options: object) -> None:
    for name, value in options.items():
        setattr(geom, name, value)

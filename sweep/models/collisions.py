"""Links and base that collide in C MuJoCo: with the obstacle, in its full size, and with each other. Feet stay as ever.

Every leg collides with every other leg, and its outer half with the base: the second half of its thigh, and its shin.
Neighbours in the tree do not.
"""

import mujoco
import numpy as np

from sweep.models.case import Case
from sweep.models.legs import LEGS
from sweep.models.obstacles.geoms import COLLIDING, STIFF
from sweep.models.obstacles.surface import own_axes
from sweep.models.robot import FOOT_LENGTH

OBSTACLE, SHIN, LEG = 4, 8, 16  # what bodies collide with: contype and conaffinity, beside those of feet and balls


def collide(spec: mujoco.MjSpec, case: Case, links: tuple[str, ...]) -> None:
    """Let the bodies of a finished spec collide; `links` are a leg's, from the hip out."""
    friction = float(case.contact.friction)
    touch = {**STIFF, "friction": [friction, 0.005, 1e-4]}
    for solid in case.obstacle.solids(own_axes(len(case.obstacle.free_bodies))):
        _set(spec.geom(solid.name), conaffinity=OBSTACLE, **touch)
    base = spec.body("base").first_geom()
    _set(base, name="base", contype=OBSTACLE, conaffinity=SHIN, **touch)
    for leg in LEGS:
        bodies = [f"{link}{leg}" for link in links]
        for name in bodies:
            start, end = np.zeros(3), _end(spec.body(name))
            if name == bodies[-1]:
                end = end * max(0.0, 1 - (FOOT_LENGTH + case.robot.link_radius) / np.linalg.norm(end))
            if np.any(end):
                kinds = OBSTACLE | LEG | (SHIN if name == bodies[-1] else 0)
                _add_capsule(spec.body(name), name, start, end, case, contype=kinds, conaffinity=LEG, **touch)
        thigh = spec.body(f"thigh{leg}")
        half = f"outer_thigh{leg}"
        _add_capsule(thigh, half, _end(thigh) / 2, _end(thigh), case, contype=0, conaffinity=0)
        # as a pair, since a body and its child do not collide otherwise
        spec.add_pair(
            geomname1="base", geomname2=f"{half}_solid", friction=[friction, friction, 0.005, 1e-4, 1e-4], **STIFF
        )
        for inner, outer in zip(bodies, bodies[2:], strict=False):
            spec.add_exclude(bodyname1=inner, bodyname2=outer)


def _add_capsule(
    body: mujoco.MjsBody, name: str, start: np.ndarray, end: np.ndarray, case: Case, **how: object
) -> None:
    body.add_geom(
        name=f"{name}_solid",
        type=mujoco.mjtGeom.mjGEOM_CAPSULE,
        fromto=[*start, *end],
        mass=0.0,
        size=[case.robot.link_radius, 0, 0],
        group=COLLIDING,
        rgba=[0, 0, 0, 0],
        **how,
    )


def _end(body: mujoco.MjsBody) -> np.ndarray:
    """The outer end of a link, whose mass centre is in its middle."""
    return 2 * np.asarray(body.ipos)


def _set(geom: mujoco.MjsGeom, **options: object) -> None:
    for name, value in options.items():
        setattr(geom, name, value)

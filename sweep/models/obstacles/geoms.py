"""Drawing and collision geometry of obstacles: each solid is drawn in full and collides shrunk by the foot radius."""

from collections.abc import Sequence

import mujoco
import numpy as np

from sweep.models.obstacles.surface import FOOT_RADIUS

DRAWN, COLLIDING = 0, 3  # geom groups: group 3 is hidden by default
SOIL = (0.62, 0.66, 0.60, 1.0)
WOOD = (0.72, 0.55, 0.36, 1.0)
_STIFF = {"solref": [0.004, 1.0], "solimp": [0.95, 0.99, 0.001, 0.5, 2.0], "condim": 3}


def add_plane(body: mujoco.MjsBody, name: str, normal: Sequence[float] | np.ndarray, friction: float) -> None:
    """A half-space through the origin."""
    quat = _to_axis(np.asarray(normal, float))
    body.add_geom(name=name, type=mujoco.mjtGeom.mjGEOM_PLANE, size=[20, 20, 0.1], quat=quat, material="ground",
                  group=DRAWN, contype=0, conaffinity=0)  # fmt: skip
    body.add_geom(name=f"{name}_contact", type=mujoco.mjtGeom.mjGEOM_PLANE, size=[0, 0, 0.1], quat=quat,
                  pos=-FOOT_RADIUS * np.asarray(normal, float), **_colliding(friction))  # fmt: skip


def add_solid(
    body: mujoco.MjsBody,
    name: str,
    kind: mujoco.mjtGeom,
    size: Sequence[float],
    pos: Sequence[float],
    friction: float,
    rgba: Sequence[float] = WOOD,
    mass: float = 0.0,
) -> None:
    """A box or cylinder at `pos` with half-sizes `size` (m)."""
    shrunk = [max(s - FOOT_RADIUS, 1e-4) for s in size]
    body.add_geom(name=name, type=kind, size=_three(size), pos=pos, rgba=rgba, group=DRAWN, mass=mass,
                  contype=0, conaffinity=0)  # fmt: skip
    body.add_geom(name=f"{name}_contact", type=kind, size=_three(shrunk), pos=pos, **_colliding(friction))


def add_ball(
    world: mujoco.MjsBody, body: mujoco.MjsBody, radius: float, friction: float, resistance: Sequence[float]
) -> None:
    """A ball on which feet stand, and which lies on the floor z = 0 with its own sliding, spinning, rolling friction.

    Ball and floor meet in geoms of their own, which have their full size and which feet do not feel. They are stiff:
    MuJoCo softens rolling friction by (slide/roll)^2, and with the impedance of the feet it would be viscous below
    25 mm/s.
    """
    look = {"material": "ball", "group": DRAWN, "contype": 0, "conaffinity": 0, "mass": 0.0}
    body.add_geom(name="ball", type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[radius, 0, 0], **look)
    body.add_geom(name="ball_contact", type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[radius - FOOT_RADIUS, 0, 0],
                  **_colliding(friction))  # fmt: skip
    rolling = {**_colliding(0.0), "contype": 2, "conaffinity": 2, "condim": 6, "friction": resistance,
               "solimp": [0.9999, 0.9999, 0.001, 0.5, 2.0]}  # fmt: skip
    body.add_geom(name="ball_rolling", type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[radius, 0, 0], **rolling)
    world.add_geom(name="floor_rolling", type=mujoco.mjtGeom.mjGEOM_PLANE, size=[0, 0, 0.1], **rolling)


def add_prism(
    spec: mujoco.MjSpec, name: str, base: Sequence[tuple[float, float]], height: float, friction: float
) -> None:
    """An upright prism from z = 0 to `height` (m) over a convex polygon, counterclockwise or not."""
    centre = np.mean(base, axis=0)
    for suffix, margin, looks in (
        ("", 0.0, {"rgba": WOOD, "group": DRAWN, "contype": 0, "conaffinity": 0}),
        ("_contact", FOOT_RADIUS, _colliding(friction)),
    ):
        sides = _inset(np.asarray(base) - centre, margin)
        corners = [c for x, y in sides for z in (0.0, height - margin) for c in (x, y, z)]
        spec.add_mesh(name=name + suffix, uservert=corners)
        spec.worldbody.add_geom(name=name + suffix, type=mujoco.mjtGeom.mjGEOM_MESH, meshname=name + suffix,
                                pos=[*centre, 0.0], **looks)  # fmt: skip


def _inset(polygon: np.ndarray, margin: float) -> np.ndarray:
    """A polygon (n, 2) about the origin with its sides moved inward by `margin`."""
    along = np.roll(polygon, -1, axis=0) - polygon
    across = np.stack([along[:, 1], -along[:, 0]], axis=-1) / np.linalg.norm(along, axis=-1, keepdims=True)
    offset = np.sum(across * polygon, axis=-1)
    offset = offset - np.sign(offset) * margin
    normals = np.stack([np.roll(across, 1, axis=0), across], axis=1)  # of the two sides that meet in a corner
    offsets = np.stack([np.roll(offset, 1), offset], axis=-1)
    return np.linalg.solve(normals, offsets[..., None])[..., 0]


def _colliding(friction: float) -> dict:
    invisible = {"rgba": [0, 0, 0, 0], "group": COLLIDING, "mass": 0.0}
    return {"contype": 0, "conaffinity": 1, "friction": [friction, 0.005, 1e-4], **_STIFF, **invisible}


def _three(size: Sequence[float]) -> list[float]:
    return [*size, *[0.0] * (3 - len(size))]


def _to_axis(normal: np.ndarray) -> np.ndarray:
    quat = np.zeros(4)
    mujoco.mju_quatZ2Vec(quat, normal)
    return quat

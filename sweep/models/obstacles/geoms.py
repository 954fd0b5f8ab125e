"""MuJoCo geoms of an obstacle's solids: a full-size geom for rendering, and one shrunk by the foot radius for contact.

MuJoCo is imported as a model is made: what is wrong with a configuration is told before.
"""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from sweep.models.obstacles.surface import FOOT_RADIUS
from sweep.models.solids import Box, Cylinder, HalfSpace, Prism, Solid, Sphere

if TYPE_CHECKING:
    import mujoco

RENDER_GROUP, COLLISION_GROUP = 0, 3  # geom groups: group 3 is hidden by default
STIFF_CONTACT = {"solref": [0.004, 1.0], "solimp": [0.95, 0.99, 0.001, 0.5, 2.0], "condim": 3}


def add_solids(spec: "mujoco.MjSpec", solids: Sequence[Solid], friction: float, bodies: Sequence[str] = ()) -> None:
    """Add two MuJoCo geoms for each solid, one rendered and one for contact, to the body that owns the solid."""
    for solid in solids:
        body = spec.worldbody if solid.body < 0 else spec.body(bodies[solid.body])
        drawn = {"group": RENDER_GROUP, "mass": 0.0, "contype": 0, "conaffinity": 0}
        body.add_geom(name=solid.name, **add_solid(spec, solid, solid.name), **_look(solid), **drawn)
        name = f"{solid.name}_contact"
        body.add_geom(name=name, **add_solid(spec, solid, name, FOOT_RADIUS), **_contact_options(friction))


def add_solid(spec: "mujoco.MjSpec", solid: Solid, name: str, margin: float = 0.0) -> dict[str, Any]:
    """Return the MuJoCo geom options for the shape of a solid, shrunk by `margin` (m), in the solid's axes.

    A prism's is a mesh called `name`, which is put in the spec.
    """
    import mujoco

    kinds = mujoco.mjtGeom
    match solid:
        case HalfSpace():
            normal = np.asarray(solid.normal, float)
            extent = 0.0 if margin else 20.0  # of the drawing
            quat = np.zeros(4)
            mujoco.mju_quatZ2Vec(quat, normal)
            size, pos = [extent, extent, 0.1], 0.0 - margin * normal
            return {"type": kinds.mjGEOM_PLANE, "size": size, "quat": quat, "pos": pos}
        case Sphere():
            return {"type": kinds.mjGEOM_SPHERE, "size": [solid.radius - margin, 0, 0], "pos": _numbers(solid.centre)}
        case Box():
            return {"type": kinds.mjGEOM_BOX, "size": _shrink(solid.half, margin), **_place(solid)}
        case Cylinder():
            size = [*_shrink([solid.radius, solid.half], margin), 0.0]
            return {"type": kinds.mjGEOM_CYLINDER, "size": size, **_place(solid)}
        case Prism():
            polygon = np.asarray(solid.polygon, float)
            centre = np.mean(polygon, axis=0)
            sides = _inset(polygon - centre, margin)
            spec.add_mesh(
                name=name, uservert=[c for x, y in sides for z in (0.0, solid.height - margin) for c in (x, y, z)]
            )
            place = _place(solid)
            turn = np.eye(3) if solid.rotation is None else np.asarray(solid.rotation, float)
            return {**place, "type": kinds.mjGEOM_MESH, "meshname": name, "pos": place["pos"] + turn @ [*centre, 0.0]}
        case _:
            raise TypeError(f"no geom has the shape of a {type(solid).__name__}")


def add_rolling_contact(
    world: "mujoco.MjsBody", balls: "Sequence[mujoco.MjsBody]", radius: float, resistance: Sequence[float]
) -> None:
    """Add MuJoCo contact pairs of balls with the floor z = 0, with sliding, spinning and rolling friction.

    Balls and floor meet in geoms of their own, which have their full size and which feet do not feel. They are stiff:
    MuJoCo softens rolling friction by (slide/roll)^2, and with the impedance of the feet it would be viscous below
    25 mm/s.
    """
    import mujoco

    rolling = {
        **_contact_options(0.0),
        "contype": 2,
        "conaffinity": 0,
        "condim": 6,
        "friction": resistance,
        "solimp": [0.9999, 0.9999, 0.001, 0.5, 2.0],
    }
    for ball in balls:
        ball.add_geom(name=f"{ball.name}_rolling", type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[radius, 0, 0], **rolling)
    rolling |= {"contype": 0, "conaffinity": 2}
    world.add_geom(name="floor_rolling", type=mujoco.mjtGeom.mjGEOM_PLANE, size=[0, 0, 0.1], **rolling)


def add_contact_pair(spec: "mujoco.MjSpec", first: str, second: str, friction: float, damping_ratio: float) -> None:
    """Add a MuJoCo contact pair, with its own friction, between geoms of two bodies, or of a body and the world.

    With its own friction and damping: the impedance of the feet lets bodies rebound with most of their speed.
    """
    spec.add_pair(
        name=f"{first}_{second}",
        geomname1=first,
        geomname2=second,
        condim=3,
        friction=[friction] * 2 + [0.0] * 3,
        solref=[STIFF_CONTACT["solref"][0], damping_ratio],
        solimp=STIFF_CONTACT["solimp"],
    )


def _look(solid: Solid) -> dict[str, Any]:
    match solid:
        case HalfSpace():
            return {"material": "ground"}
        case Sphere():
            return {"material": "ball"}
        case _:
            return {"rgba": solid.colour}  # pyright: ignore[reportAttributeAccessIssue]


def _place(solid: Box | Cylinder | Prism) -> dict[str, np.ndarray]:
    quat = np.array([1.0, 0.0, 0.0, 0.0])
    if solid.rotation is not None:
        import mujoco

        mujoco.mju_mat2Quat(quat, np.asarray(solid.rotation, float).ravel())
    return {"pos": _numbers(solid.position), "quat": quat}


def _shrink(sizes: Any, margin: float) -> np.ndarray:
    """Half-sizes less a margin; a thin solid keeps a little."""
    return np.array([max(size - margin, min(size, 1e-4)) for size in _numbers(sizes)])


def _numbers(values: Any) -> np.ndarray:
    return np.asarray([float(value) for value in values])


def _inset(polygon: np.ndarray, margin: float) -> np.ndarray:
    """A polygon (n, 2) about the origin with its sides moved inward by `margin`."""
    along = np.roll(polygon, -1, axis=0) - polygon
    across = np.stack([along[:, 1], -along[:, 0]], axis=-1) / np.linalg.norm(along, axis=-1, keepdims=True)
    offset = np.sum(across * polygon, axis=-1)
    offset = offset - np.sign(offset) * margin
    normals = np.stack([np.roll(across, 1, axis=0), across], axis=1)  # of the two sides that meet in a corner
    offsets = np.stack([np.roll(offset, 1), offset], axis=-1)
    return np.linalg.solve(normals, offsets[..., None])[..., 0]


def hidden_geom_options() -> dict[str, Any]:
    """Return the options of a MuJoCo geom that collides but is not rendered."""
    return {"rgba": [0, 0, 0, 0], "group": COLLISION_GROUP, "mass": 0.0}


def _contact_options(friction: float) -> dict:
    return {
        "contype": 0,
        "conaffinity": 1,
        "friction": [friction, 0.005, 1e-4],
        **STIFF_CONTACT,
        **hidden_geom_options(),
    }

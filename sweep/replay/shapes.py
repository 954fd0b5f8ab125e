"""Conversion of the geoms of a MuJoCo model to Foxglove primitives."""

import mujoco
import numpy as np
from foxglove.messages import (
    Color,
    CubePrimitive,
    CylinderPrimitive,
    Duration,
    Point3,
    Pose,
    Quaternion,
    SceneEntity,
    SpherePrimitive,
    Timestamp,
    TriangleListPrimitive,
    Vector3,
)

from sweep.replay.height_fields import sample_height_field
from sweep.replay.hulls import geom_hull
from sweep.replay.model_geoms import VISIBLE_GROUPS, body_name, geom_color, moving_body_ids

Primitive = CubePrimitive | CylinderPrimitive | SpherePrimitive | TriangleListPrimitive
Geom = mujoco.mjtGeom

WORLD = "world"  # the fixed frame
PLANE_SIDE = 20.0  # m, drawn of an infinite plane
PLANE_THICKNESS = 2e-3  # m
FIELD_POINTS = 128  # of a height field along each side, at most


def foxglove_vector(values: np.ndarray) -> Vector3:
    """Convert (3,) numbers to a Foxglove vector."""
    return Vector3(x=float(values[0]), y=float(values[1]), z=float(values[2]))


def foxglove_quaternion(values: np.ndarray) -> Quaternion:
    """Convert a quaternion in MuJoCo's order (w, x, y, z) to Foxglove's."""
    return Quaternion(x=float(values[1]), y=float(values[2]), z=float(values[3]), w=float(values[0]))


def scene_entities(model: mujoco.MjModel) -> list[SceneEntity]:
    """Return a Foxglove entity for every body with visible geoms, locked to the body's frame.

    Fixed bodies are drawn in the world's frame, so that only moving bodies need a transform.
    """
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    moving = set(moving_body_ids(model).tolist())
    made = []
    for body in range(model.nbody):
        geoms = [g for g in range(model.ngeom) if model.geom_bodyid[g] == body]
        shapes = [
            s for g in geoms if model.geom_group[g] < VISIBLE_GROUPS for s in _shapes(model, data, g, body in moving)
        ]
        if shapes:
            name = body_name(model, body)
            made.append(_entity(name, name if body in moving else WORLD, shapes))
    return made


def _entity(name: str, frame: str, shapes: list[Primitive]) -> SceneEntity:
    return SceneEntity(
        timestamp=Timestamp(0, 0),
        frame_id=frame,
        id=name,
        lifetime=Duration(0, 0),  # for ever
        frame_locked=True,
        cubes=[s for s in shapes if isinstance(s, CubePrimitive)],
        spheres=[s for s in shapes if isinstance(s, SpherePrimitive)],
        cylinders=[s for s in shapes if isinstance(s, CylinderPrimitive)],
        triangles=[s for s in shapes if isinstance(s, TriangleListPrimitive)],
    )


def _shapes(model: mujoco.MjModel, data: mujoco.MjData, geom: int, moving: bool) -> list[Primitive]:
    """Primitives of one geom."""
    if moving:
        position, orientation = model.geom_pos[geom], model.geom_quat[geom]
    else:
        position, orientation = data.geom_xpos[geom], np.empty(4)
        mujoco.mju_mat2Quat(orientation, data.geom_xmat[geom])
    r, g, b, a = geom_color(model, geom)
    color, size, kind = Color(r=r, g=g, b=b, a=a), model.geom_size[geom], Geom(model.geom_type[geom])

    def pose(along_z: float = 0.0) -> Pose:
        offset = np.empty(3)
        mujoco.mju_rotVecQuat(offset, np.array([0.0, 0.0, along_z]), orientation)
        return Pose(position=foxglove_vector(position + offset), orientation=foxglove_quaternion(orientation))

    def tube(radius: float, half: float) -> CylinderPrimitive:
        dimensions = foxglove_vector(np.array([2 * radius, 2 * radius, 2 * half]))
        return CylinderPrimitive(pose=pose(), size=dimensions, bottom_scale=1.0, top_scale=1.0, color=color)

    def ball(radii: np.ndarray, along_z: float = 0.0) -> SpherePrimitive:
        return SpherePrimitive(pose=pose(along_z), size=foxglove_vector(2 * radii), color=color)

    match kind:
        case Geom.mjGEOM_BOX:
            return [CubePrimitive(pose=pose(), size=foxglove_vector(2 * size), color=color)]
        case Geom.mjGEOM_SPHERE:
            return [ball(size[[0, 0, 0]])]
        case Geom.mjGEOM_ELLIPSOID:
            return [ball(size)]
        case Geom.mjGEOM_CYLINDER:
            return [tube(size[0], size[1])]
        case Geom.mjGEOM_CAPSULE:  # Foxglove has no capsule
            return [tube(size[0], size[1]), *(ball(size[[0, 0, 0]], end) for end in (-size[1], size[1]))]
        case Geom.mjGEOM_PLANE:  # a thin slab whose top is the plane; half-size 0 means infinite
            sides = np.where(size[:2] > 0, 2 * size[:2], PLANE_SIDE)
            slab = foxglove_vector(np.array([*sides, PLANE_THICKNESS]))
            return [CubePrimitive(pose=pose(-PLANE_THICKNESS / 2), size=slab, color=color)]
        case Geom.mjGEOM_MESH:
            vertices, faces = geom_hull(model, geom)
            points = [Point3(x=float(x), y=float(y), z=float(z)) for x, y, z in vertices]
            fans = [
                index for face in faces for k in range(1, len(face) - 1) for index in (face[0], face[k], face[k + 1])
            ]
            return [TriangleListPrimitive(pose=pose(), points=points, color=color, indices=fans)]
        case Geom.mjGEOM_HFIELD:
            grid = sample_height_field(model, geom, most=FIELD_POINTS)
            x, y = np.meshgrid(grid.x, grid.y)
            places = np.stack([x, y, grid.heights], axis=-1).reshape(-1, 3)
            corner = np.arange(x.size).reshape(x.shape)
            a, b, c, d = (corner[i : i or None, j : j or None].ravel() for i, j in ((0, 0), (0, 1), (1, 1), (1, 0)))
            triangles = np.stack([a, b, c, a, c, d], axis=1)
            points = [Point3(x=float(x), y=float(y), z=float(z)) for x, y, z in places]
            return [TriangleListPrimitive(pose=pose(), points=points, color=color, indices=triangles.ravel().tolist())]
        case _:
            return []

"""Outlines of a robot as seen from above."""

import mujoco
import numpy as np
from scipy.spatial import ConvexHull

from sweep.replay.hulls import geom_hull
from sweep.replay.model_geoms import VISIBLE_GROUPS, moving_body_ids

CIRCLE_CORNERS = 24  # of the outline of a sphere
BOX_CORNERS = np.array(np.meshgrid([-1, 1], [-1, 1], [-1, 1])).reshape(3, 8).T


def outlines_from_above(model: mujoco.MjModel, qpos: np.ndarray) -> list[np.ndarray]:
    """Return the outline of each geom of the moving bodies, seen along the world's z axis.

    Args:
        model: The MuJoCo model.
        qpos: Its positions (nq,).

    Returns:
        Corners (k, 2) of each convex outline, m, in world axes about the centre of mass; lower geoms first.
    """
    data = mujoco.MjData(model)
    data.qpos[:] = qpos
    mujoco.mj_kinematics(model, data)
    mujoco.mj_comPos(model, data)
    bodies = moving_body_ids(model)
    moving = np.isin(model.geom_bodyid, bodies)
    visible = moving & (model.geom_group < VISIBLE_GROUPS)
    geoms = np.flatnonzero(visible if visible.any() else moving)
    mass = model.body_mass[bodies]
    centre = mass @ data.xipos[bodies] / max(mass.sum(), 1e-12)
    circle, outlines = _circle(), []
    for geom in sorted(geoms.tolist(), key=lambda geom: data.geom_xpos[geom, 2]):
        points, radius = _points_and_radius(model, geom)
        if len(points):
            seen = (points @ data.geom_xmat[geom].reshape(3, 3).T + data.geom_xpos[geom] - centre)[:, :2]
            seen = (seen[:, None] + radius * circle).reshape(-1, 2) if radius else seen
            outlines.append(seen[ConvexHull(seen, qhull_options="QJ").vertices])
    return outlines


def _circle() -> np.ndarray:
    """Points (k, 2) of a circle of radius 1."""
    angle = np.linspace(0, 2 * np.pi, CIRCLE_CORNERS, endpoint=False)
    return np.stack([np.cos(angle), np.sin(angle)], axis=1)


def _points_and_radius(model: mujoco.MjModel, geom: int) -> tuple[np.ndarray, float]:
    """Points (k, 3) in the geom's axes and the radius of spheres about them, whose convex hull is the geom.

    Planes have no points.
    """
    kind, size = model.geom_type[geom], model.geom_size[geom]
    shapes = mujoco.mjtGeom
    if kind == shapes.mjGEOM_SPHERE:
        return np.zeros((1, 3)), float(size[0])
    if kind == shapes.mjGEOM_CAPSULE:
        return np.array([[0, 0, -size[1]], [0, 0, size[1]]]), float(size[0])
    if kind == shapes.mjGEOM_CYLINDER:
        return np.concatenate([np.insert(size[0] * _circle(), 2, z, axis=1) for z in (-size[1], size[1])]), 0.0
    if kind == shapes.mjGEOM_BOX:
        return BOX_CORNERS * size, 0.0
    if kind in (shapes.mjGEOM_ELLIPSOID, shapes.mjGEOM_MESH):
        return geom_hull(model, geom)[0], 0.0
    return np.zeros((0, 3)), 0.0

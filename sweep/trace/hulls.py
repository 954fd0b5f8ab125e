"""Convex hulls of what has no simple shape, with few enough faces to be drawn many times a second."""

import mujoco
import numpy as np
from scipy.spatial import ConvexHull

MOST = 64  # faces of a mesh that is drawn as it is
POINTS = 40  # of a hull: those farthest along so many directions


def hull_of(model: mujoco.MjModel, geom: int) -> tuple[np.ndarray, list[list[int]]]:
    """Vertices (N, 3) and faces of an ellipsoid or a mesh, in the geom's axes, counterclockwise from outside.

    A mesh is its convex hull: MuJoCo's, or where that has many faces or is not known one of fewer.
    """
    if model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_ELLIPSOID:
        return _hull(_directions(POINTS) * model.geom_size[geom])
    mesh = int(model.geom_dataid[geom])
    first, number = int(model.mesh_vertadr[mesh]), int(model.mesh_vertnum[mesh])
    vertices = np.asarray(model.mesh_vert[first : first + number], float)
    if not 0 < model.mesh_polynum[mesh] <= MOST:
        return _hull(vertices[np.unique(np.argmax(_directions(POINTS) @ vertices.T, axis=1))])
    faces = []
    for polygon in model.mesh_polyadr[mesh] + np.arange(model.mesh_polynum[mesh]):
        start = int(model.mesh_polyvertadr[polygon])
        faces.append(model.mesh_polyvert[start : start + int(model.mesh_polyvertnum[polygon])].tolist())
    return vertices, faces


def _directions(number: int) -> np.ndarray:
    """Unit vectors (number, 3), spread evenly over a sphere on a spiral."""
    k = np.arange(number) + 0.5
    z, angle = 1 - 2 * k / number, np.pi * (1 + np.sqrt(5)) * k
    return np.column_stack([np.sqrt(1 - z**2) * np.cos(angle), np.sqrt(1 - z**2) * np.sin(angle), z])


def _hull(points: np.ndarray) -> tuple[np.ndarray, list[list[int]]]:
    hull = ConvexHull(points, qhull_options="QJ")  # of flat ones, too
    faces = []
    for (a, b, c), outward in zip(hull.simplices, hull.equations[:, :3], strict=True):
        turn = np.cross(points[b] - points[a], points[c] - points[a]) @ outward
        faces.append([int(a), int(b), int(c)] if turn > 0 else [int(a), int(c), int(b)])
    return points, faces

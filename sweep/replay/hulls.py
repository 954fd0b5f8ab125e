"""Convex hulls of ellipsoids and meshes with few enough faces for fast drawing."""

import mujoco
import numpy as np
from scipy.spatial import ConvexHull

MAX_FACES = 64  # of MuJoCo's hull of a mesh; a hull with more faces is simplified
HULL_DIRECTIONS = 40  # directions along which a simplified hull has its farthest points


def geom_hull(model: mujoco.MjModel, geom: int) -> tuple[np.ndarray, list[list[int]]]:
    """Return the convex hull of an ellipsoid or mesh geom: vertices (m) and faces.

    For a mesh this is MuJoCo's hull, or one with fewer faces where that is missing or has more than `MAX_FACES`.

    Args:
        model: The MuJoCo model.
        geom: Id of the geom.

    Returns:
        Vertices (N, 3) in the geom's axes, m, and faces as lists of vertices, counterclockwise seen from outside.
    """
    if model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_ELLIPSOID:
        return _hull(_directions(HULL_DIRECTIONS) * model.geom_size[geom])
    mesh = int(model.geom_dataid[geom])
    first, number = int(model.mesh_vertadr[mesh]), int(model.mesh_vertnum[mesh])
    vertices = np.asarray(model.mesh_vert[first : first + number], float)
    if not 0 < model.mesh_polynum[mesh] <= MAX_FACES:
        return _hull(vertices[np.unique(np.argmax(_directions(HULL_DIRECTIONS) @ vertices.T, axis=1))])
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
    hull = ConvexHull(points, qhull_options="QJ")  # also works for points in a plane
    faces = []
    for (a, b, c), outward in zip(hull.simplices, hull.equations[:, :3], strict=True):
        turn = np.cross(points[b] - points[a], points[c] - points[a]) @ outward
        faces.append([int(a), int(b), int(c)] if turn > 0 else [int(a), int(c), int(b)])
    return points, faces

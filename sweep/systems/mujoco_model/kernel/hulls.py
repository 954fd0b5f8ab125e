"""Faces of the convex hulls of meshes, whose corners MuJoCo lets touch a plane."""

from typing import NamedTuple

import mujoco
import numpy as np

MOST_CORNERS = 4  # of a face; MuJoCo leaves out some corners of larger ones
MOST_CHOICES = 200  # corners of a hull and of all its faces, at most


class MeshHull(NamedTuple):
    """Convex hull of a mesh, in the axes of its geom."""

    corners: np.ndarray  # (v, 3) m
    faces: tuple[tuple[int, ...], ...]  # corners of each face
    normals: np.ndarray  # (f, 3) outward unit vectors


def find_hull(model: mujoco.MjModel, geom: int) -> MeshHull | None:
    """Return the convex hull of a geom's mesh; None if it has none, or too many corners.

    Args:
        model: The model.
        geom: Id of the geom.
    """
    mesh = int(model.geom_dataid[geom])
    if model.geom_type[geom] != mujoco.mjtGeom.mjGEOM_MESH or mesh < 0 or not model.mesh_polynum[mesh]:
        return None
    own = range(int(model.mesh_polyadr[mesh]), int(model.mesh_polyadr[mesh] + model.mesh_polynum[mesh]))
    starts, counts = model.mesh_polyvertadr[own], model.mesh_polyvertnum[own]
    polygons = [model.mesh_polyvert[first : first + n] for first, n in zip(starts, counts, strict=True)]
    used = np.unique(np.concatenate(polygons))
    if counts.max() > MOST_CORNERS or len(used) + counts.sum() > MOST_CHOICES:
        return None
    corners = np.asarray(model.mesh_vert[int(model.mesh_vertadr[mesh]) + used], float)
    faces = tuple(tuple(np.searchsorted(used, one).tolist()) for one in polygons)
    return MeshHull(corners, faces, np.asarray(model.mesh_polynormal[own], float))

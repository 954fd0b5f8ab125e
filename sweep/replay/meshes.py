"""Meshes of a MuJoCo model with few enough triangles for drawing."""

from collections.abc import Iterable
from typing import NamedTuple

import mujoco
import numpy as np

FACE_BUDGET = 12_000  # triangles of all geoms of a model
LEAST_CELLS = 8  # cells along the longest side of a mesh, at least
HALVINGS = 12  # steps of the search for the cell size
SINGULAR_SHARE = 1e-2  # eigenvalues below this share of the largest do not move a point


class Mesh(NamedTuple):
    """Triangles of a surface."""

    vertices: np.ndarray  # (N, 3) m
    faces: np.ndarray  # (F, 3) indices of vertices, counterclockwise seen from outside


def model_mesh(model: mujoco.MjModel, mesh: int) -> Mesh:
    """Return a mesh of a model, in the axes of the geoms that use it, with each point once.

    Args:
        model: The MuJoCo model.
        mesh: Id of the mesh.
    """
    first, count = int(model.mesh_vertadr[mesh]), int(model.mesh_vertnum[mesh])
    start, faces = int(model.mesh_faceadr[mesh]), int(model.mesh_facenum[mesh])
    points, place = np.unique(np.asarray(model.mesh_vert[first : first + count], float), axis=0, return_inverse=True)
    return _without_flat_faces(Mesh(points, place.ravel()[np.asarray(model.mesh_face[start : start + faces])]))


def simplify_meshes(model: mujoco.MjModel, geoms: Iterable[int], budget: int = FACE_BUDGET) -> dict[int, Mesh]:
    """Return the meshes of some geoms, by id, simplified where all geoms together have more triangles than `budget`.

    All meshes have details of the same size (m), so that large parts keep more triangles than small ones.

    Args:
        model: The MuJoCo model.
        geoms: Ids of mesh geoms; a mesh that several of them use counts for each.
        budget: Largest number of triangles.
    """
    used, uses = np.unique([int(model.geom_dataid[geom]) for geom in geoms], return_counts=True)
    whole = {int(mesh): model_mesh(model, int(mesh)) for mesh in used}

    def count_faces(meshes: dict[int, Mesh]) -> int:
        return sum(int(count) * len(meshes[int(mesh)].faces) for mesh, count in zip(used, uses, strict=True))

    if not whole or count_faces(whole) <= budget:
        return whole
    fine, coarse = 0.0, max(float(np.ptp(mesh.vertices, axis=0).max()) for mesh in whole.values())
    found = {mesh: simplify_mesh(one, coarse) for mesh, one in whole.items()}
    for _ in range(HALVINGS):
        size = (fine + coarse) / 2
        tried = {mesh: simplify_mesh(one, size) for mesh, one in whole.items()}
        if count_faces(tried) > budget:
            fine = size
        else:
            coarse, found = size, tried
    return found


def simplify_mesh(mesh: Mesh, cell: float) -> Mesh:
    """Merge the points of a mesh in each cube of a grid into one, as close as possible to the planes around them.

    Source: Lindstrom 2000, Out-of-core simplification of large polygonal models, section 3.

    Args:
        mesh: The mesh.
        cell: Length of the cubes, m; a mesh has `LEAST_CELLS` of them along its longest side at least.
    """
    points, faces = mesh
    low, sides = points.min(axis=0), np.ptp(points, axis=0)
    cell = min(cell, float(sides.max()) / LEAST_CELLS)
    if cell <= 0 or not len(faces):
        return mesh
    _, cube = np.unique(np.floor((points - low) / cell).astype(np.int64), axis=0, return_inverse=True)
    cube = cube.ravel()
    count = int(cube.max()) + 1
    mean = _sum_by_cube(cube, points, count) / np.bincount(cube, minlength=count)[:, None]
    a, b, c = (points[faces[:, k]] for k in range(3))
    normal = np.cross(b - a, c - a)  # twice the area
    matrix, vector = np.zeros((count, 3, 3)), np.zeros((count, 3))
    for k in range(3):
        corner = cube[faces[:, k]]
        offset = np.einsum("ni,ni->n", normal, a - mean[corner])
        outer = normal[:, :, None] * normal[:, None, :]
        matrix += _sum_by_cube(corner, outer.reshape(-1, 9), count).reshape(-1, 3, 3)
        vector += _sum_by_cube(corner, normal * offset[:, None], count)
    shift = np.einsum("nij,nj->ni", np.linalg.pinv(matrix, rcond=SINGULAR_SHARE, hermitian=True), vector)
    moved = mean + np.clip(shift, -cell / 2, cell / 2)
    return _without_flat_faces(Mesh(moved, cube[faces]))


def _sum_by_cube(cube: np.ndarray, values: np.ndarray, count: int) -> np.ndarray:
    """Sum rows (n, k) by the number of their cube, (count, k)."""
    return np.stack([np.bincount(cube, weights=column, minlength=count) for column in values.T], axis=1)


def _without_flat_faces(mesh: Mesh) -> Mesh:
    """Drop triangles with fewer than three points, repeated ones, and points without triangle."""
    faces = mesh.faces
    faces = faces[(faces != np.roll(faces, 1, axis=1)).all(axis=1)]
    rolled = np.take_along_axis(faces, (np.argmin(faces, axis=1)[:, None] + np.arange(3)) % 3, axis=1)
    faces = np.unique(rolled, axis=0) if len(rolled) else rolled
    kept, place = np.unique(faces, return_inverse=True)
    return Mesh(mesh.vertices[kept], place.reshape(-1, 3))

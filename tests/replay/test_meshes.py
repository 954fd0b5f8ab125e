"""Meshes are simplified for drawing without losing their shape."""

import mujoco
import numpy as np

from sweep.replay import meshes


def cube_of_squares(count):
    """Return a cube with sides of 1 m whose sides are cut into `count` x `count` squares."""
    step = np.arange(count)
    corner = (step[:, None] * (count + 1) + step).ravel()
    faces = np.concatenate([np.stack([corner, corner + count + 1, corner + 1], 1),
                            np.stack([corner + 1, corner + count + 1, corner + count + 2], 1)])  # fmt: skip
    flat = np.stack(np.meshgrid(*[np.linspace(-0.5, 0.5, count + 1)] * 2, indexing="ij"), -1).reshape(-1, 2)
    parts = [np.insert(flat, axis, side, axis=1) for axis in range(3) for side in (-0.5, 0.5)]
    points, place = np.unique(np.concatenate(parts), axis=0, return_inverse=True)
    return meshes.Mesh(points, place.ravel()[np.concatenate([faces + k * len(flat) for k in range(6)])])


def test_flat_sides_and_sharp_edges_of_a_mesh_stay():
    cube = cube_of_squares(40)
    simple = meshes.simplify_mesh(cube, 0.3)
    assert len(simple.faces) < len(cube.faces) / 20
    assert np.abs(np.abs(simple.vertices).max(axis=1) - 0.5).max() < 1e-9  # every point is on a side
    corners = np.abs(simple.vertices).min(axis=1) > 0.5 - 1e-6
    assert corners.sum() == 8


def test_all_meshes_of_a_model_share_a_budget():
    xml = """<mujoco><asset><mesh name="large" builtin="sphere" params="4"/>
    <mesh name="small" builtin="sphere" params="4" scale=".1 .1 .1"/></asset><worldbody>
    <geom type="mesh" mesh="large"/><geom type="mesh" mesh="large"/><geom type="mesh" mesh="small"/>
    </worldbody></mujoco>"""
    model = mujoco.MjModel.from_xml_string(xml)
    found = meshes.simplify_meshes(model, range(3), 3000)
    large, small = (found[mesh] for mesh in range(2))
    assert 2000 < 2 * len(large.faces) + len(small.faces) <= 3000
    assert len(small.faces) < len(large.faces)
    assert np.abs(np.linalg.norm(large.vertices, axis=1) - 1).max() < 0.02
    assert len(meshes.simplify_meshes(model, range(3))[0].faces) > len(large.faces)

"""The contact law (1.2.2), its Newton slope, and the root bodies' solver, each against a plain calculation."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sweep.core.rotations import exponential, matrix
from sweep.core.vectors import Matrix, Vector
from sweep.dynamics.contacts import (
    ContactAnchors,
    ContactGeometry,
    contact_damping,
    contact_forces,
    contact_geometry,
    make_initial_anchors,
    transform_points_to_body,
    transform_points_to_world,
    update_anchors,
)
from sweep.dynamics.newton import BlockMatrix
from sweep.models.contact import Contact
from sweep.models.obstacles.kerb import Kerb
from sweep.models.obstacles.plane import Plane
from sweep.models.obstacles.surface import BodyPoses, body_poses, empty_free_body_state

H = 2e-3
CONTACT = Contact(friction=0.7)
NOWHERE = body_poses(empty_free_body_state())
DAMPING = 300.0  # N s/m, of contact and surface


pytestmark = pytest.mark.usefixtures("double")


def contacts(rng, n: int) -> tuple[ContactGeometry, np.ndarray]:
    """Loaded, sticking, slipping and open contacts in all directions, and velocities of their points."""
    normal = rng.normal(size=(n, 3))
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    stretch = rng.normal(size=(n, 3)) * 10 ** rng.uniform(-6, -3, (n, 1))
    stretch -= np.sum(stretch * normal, axis=1, keepdims=True) * normal
    depth = rng.uniform(-0.5e-3, 1e-3, n)
    limit, damping = jnp.full(n, 0.7), jnp.full(n, DAMPING)
    geometry = ContactGeometry(
        jnp.asarray(depth), Vector.from_array(normal), Vector.from_array(stretch), limit, damping
    )
    return geometry, rng.normal(size=(n, 3)) * 0.1


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 2**31))
def test_slope_equals_finite_differences(seed):
    """Where no contact changes its state between the two sides of the difference."""
    geometry, velocity = contacts(np.random.default_rng(seed), 60)

    def at(v):
        return contact_forces(CONTACT, geometry, Vector.from_array(jnp.asarray(v)))

    here, d = at(velocity), 1e-6
    slope = np.asarray(contact_damping(geometry, here, H).array()) / H
    for axis in np.eye(3):
        ahead, behind = at(velocity + d * axis), at(velocity - d * axis)
        same = (ahead.slipping == behind.slipping) & (ahead.loaded == behind.loaded)
        assert np.mean(same) > 0.9
        numeric = -(ahead.force - behind.force).array() / (2 * d)
        error = np.abs(numeric - slope @ axis)[same] / DAMPING
        assert error.max() < 1e-6


def test_forces_obey_coulomb():
    geometry, velocity = contacts(np.random.default_rng(1), 2000)
    f = contact_forces(CONTACT, geometry, Vector.from_array(jnp.asarray(velocity)))
    drag, limit = np.linalg.norm(f.tangential.array(), axis=1), 0.7 * np.asarray(f.normal)
    slips, holds = np.asarray(f.slipping), np.asarray(f.loaded & ~f.slipping)
    assert min(slips.sum(), holds.sum(), (~np.asarray(f.loaded)).sum()) > 100  # all three states are among them
    np.testing.assert_allclose(drag[slips], limit[slips], rtol=1e-5)
    assert np.all(drag[holds] <= limit[holds] * (1 + 1e-9) + 1e-3)
    assert np.all(np.asarray(f.force.array())[~np.asarray(f.loaded)] == 0)
    assert np.all(np.asarray(f.normal) >= 0)


def test_dragged_anchor_holds_just_the_limit():
    """After a slip the anchor is so near that the foot, come to rest there, feels the Coulomb limit and no more."""
    point = jnp.array([[0.0, 0.0, -1e-4]])
    velocity = jnp.array([[0.3, 0.0, 0.0]])
    surface = Plane().surface(point, (-1,), NOWHERE)
    foot, passing = Vector.from_array(point), Vector.from_array(velocity)
    anchors = ContactAnchors(Vector.from_array(jnp.array([[-0.01, 0.0, 0.0]])), jnp.array([True]), surface.face)
    geometry, place = contact_geometry(CONTACT, surface, anchors, foot, ())
    forces = contact_forces(CONTACT, geometry, passing)
    assert forces.slipping[0]
    after = update_anchors(CONTACT, surface, foot, (), place, forces, passing, H)
    moved = point + H * velocity
    stretch = np.asarray(after.positions.array() - moved)[0, :2]
    assert CONTACT.stiffness * np.linalg.norm(stretch) == pytest.approx(0.7 * float(forces.normal[0]), rel=1e-5)
    assert stretch[0] < 0  # and it pulls back


def test_axes_of_free_bodies_round_trip():
    rng = np.random.default_rng(2)
    bodies = BodyPoses(jnp.asarray(rng.normal(size=(2, 3))), matrix(exponential(jnp.asarray(rng.normal(size=(2, 3))))))
    body, place = jnp.array([-1, 0, 1, 1]), jnp.asarray(rng.normal(size=(4, 3)))
    world = transform_points_to_world(place, body, bodies)
    np.testing.assert_allclose(world[0], place[0])
    np.testing.assert_allclose(world[2], bodies.rotation[1] @ place[2] + bodies.position[1], atol=1e-14)
    np.testing.assert_allclose(transform_points_to_body(world, body, bodies), place, atol=1e-14)


def test_anchors_keep_their_form_in_double_precision():
    """Or a step could not be repeated: faces that an obstacle works out are wider there."""
    foot = Vector.from_array(jnp.array([[0.1, 0.0, 0.0999]]))
    surface, still = Kerb().surface(foot.array(), (-1,), NOWHERE), Vector.from_array(jnp.zeros((1, 3)))
    geometry, place = contact_geometry(CONTACT, surface, make_initial_anchors(1, jnp.float64), foot, ())
    forces = contact_forces(CONTACT, geometry, still)
    after = update_anchors(CONTACT, surface, foot, (), place, forces, still, H)
    assert [x.dtype for x in jax.tree.leaves(after)] == [
        x.dtype for x in jax.tree.leaves(make_initial_anchors(1, jnp.float64))
    ]


@pytest.mark.parametrize("bodies", [1, 2, 3])
def test_root_bodies_equal_a_dense_solve(bodies):
    """Unsymmetric, as with slipping feet; the diagonal prevails, as in a step; two free bodies do not touch."""
    rng = np.random.default_rng(bodies)
    n = 6 * bodies
    dense, b = rng.normal(size=(n, n)) + 2 * n * np.eye(n), rng.normal(size=n)
    if bodies == 3:
        dense[6:12, 12:] = dense[12:, 6:12] = 0
    blocks = BlockMatrix()
    for i in range(2 * bodies):
        for j in range(2 * bodies):
            block = dense[3 * i : 3 * i + 3, 3 * j : 3 * j + 3]
            if np.any(block):
                blocks.add_block(i, j, Matrix.from_array(jnp.asarray(block[None])))
    x = blocks.solve([Vector.from_array(jnp.asarray(part[None])) for part in b.reshape(-1, 3)])
    np.testing.assert_allclose(np.ravel([part.array() for part in x]), np.linalg.solve(dense, b), rtol=1e-12)

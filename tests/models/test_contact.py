"""The contact law (1.2.2), its Newton slope, and the arrowhead solver, each against a plain calculation."""

import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sweep.core.rotations import exponential, matrix
from sweep.dynamics import arrowhead
from sweep.dynamics.arrowhead import Arrowhead, Split
from sweep.models.contact import Anchors, Contact, Geometry, approach, contact_forces, settle, to_body, to_world
from sweep.models.obstacles.plane import Plane
from sweep.models.obstacles.surface import Bodies, no_bodies, poses

H = 2e-3
CONTACT = Contact(friction=0.7)
NOWHERE = poses(no_bodies())


pytestmark = pytest.mark.usefixtures("double")


def contacts(rng, n: int) -> tuple[Geometry, np.ndarray]:
    """Loaded, sticking, slipping and open contacts in all directions, and velocities of their points."""
    normal = rng.normal(size=(n, 3))
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    stretch = rng.normal(size=(n, 3)) * 10 ** rng.uniform(-6, -3, (n, 1))
    stretch -= np.sum(stretch * normal, axis=1, keepdims=True) * normal
    depth = rng.uniform(-0.5e-3, 1e-3, n)
    return Geometry(*map(jnp.asarray, (depth, normal, stretch, np.full(n, 0.7)))), rng.normal(size=(n, 3)) * 0.1


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 2**31))
def test_slope_equals_finite_differences(seed):
    """Where no contact changes its state between the two sides of the difference."""
    geometry, velocity = contacts(np.random.default_rng(seed), 60)

    def at(v):
        return contact_forces(CONTACT, geometry, jnp.asarray(v), H)

    here, d = at(velocity), 1e-6
    for axis in np.eye(3):
        ahead, behind = at(velocity + d * axis), at(velocity - d * axis)
        same = (ahead.slipping == behind.slipping) & (ahead.loaded == behind.loaded)
        assert np.mean(same) > 0.9
        numeric = -(ahead.force - behind.force) / (2 * d)
        # relative to the stiffest entry, g = c_n h + d_n
        error = np.abs(numeric - here.slope @ axis)[same] / (CONTACT.stiffness * H + CONTACT.damping)
        assert error.max() < 1e-6


def test_forces_obey_coulomb():
    geometry, velocity = contacts(np.random.default_rng(1), 2000)
    f = contact_forces(CONTACT, geometry, jnp.asarray(velocity), H)
    drag, limit = np.linalg.norm(f.tangential, axis=1), 0.7 * np.asarray(f.normal)
    slips, holds = np.asarray(f.slipping), np.asarray(f.loaded & ~f.slipping)
    assert min(slips.sum(), holds.sum(), (~np.asarray(f.loaded)).sum()) > 100  # all three states are among them
    np.testing.assert_allclose(drag[slips], limit[slips], rtol=1e-5)
    assert np.all(drag[holds] <= limit[holds] * (1 + 1e-9) + 1e-3)
    assert np.all(np.asarray(f.force)[~np.asarray(f.loaded)] == 0)
    assert np.all(np.asarray(f.normal) >= 0)


def test_dragged_anchor_holds_just_the_limit():
    """After a slip the anchor is so near that the foot, come to rest there, feels the Coulomb limit and no more."""
    ground = Plane()
    point = jnp.array([[0.0, 0.0, -1e-4]])
    velocity = jnp.array([[0.3, 0.0, 0.0]])
    surface = ground.surface(point, (-1,), NOWHERE)
    anchors = Anchors(jnp.array([[-0.01, 0.0, 0.0]]), jnp.array([True]), surface.face)
    geometry, place = approach(CONTACT, surface, anchors, point, NOWHERE)
    forces = contact_forces(CONTACT, geometry, velocity, H)
    assert forces.slipping[0]
    after = settle(CONTACT, surface, point, NOWHERE, place, forces, velocity, H)
    moved = point + H * velocity
    stretch = np.asarray(after.place - moved)[0, :2]
    assert CONTACT.stiffness * np.linalg.norm(stretch) == pytest.approx(0.7 * float(forces.normal[0]), rel=1e-5)
    assert stretch[0] < 0  # and it pulls back


def test_axes_of_free_bodies_round_trip():
    rng = np.random.default_rng(2)
    bodies = Bodies(jnp.asarray(rng.normal(size=(2, 3))), matrix(exponential(jnp.asarray(rng.normal(size=(2, 3))))))
    body, place = jnp.array([-1, 0, 1, 1]), jnp.asarray(rng.normal(size=(4, 3)))
    world = to_world(place, body, bodies)
    np.testing.assert_allclose(world[0], place[0])
    np.testing.assert_allclose(world[2], bodies.rotation[1] @ place[2] + bodies.position[1], atol=1e-14)
    np.testing.assert_allclose(to_body(world, body, bodies), place, atol=1e-14)


@pytest.mark.parametrize("root", [6, 12])
def test_arrowhead_equals_a_dense_solve(root):
    """Unsymmetric, as with slipping feet; the diagonal prevails, as in a step."""
    rng = np.random.default_rng(root)
    n = root + 18
    dense = rng.normal(size=(n, n)) + 2 * n * np.eye(n)
    legs = [slice(root + 3 * k, root + 3 * k + 3) for k in range(6)]
    for a in legs:
        for b in legs:
            if a is not b:
                dense[a, b] = 0
    b = rng.normal(size=n)
    a = Arrowhead(
        jnp.asarray(dense[:root, :root]),
        jnp.stack([dense[:root, s] for s in legs]),
        jnp.stack([dense[s, :root] for s in legs]),
        jnp.stack([dense[s, s] for s in legs]),
    )
    x = arrowhead.solve(a, Split(jnp.asarray(b[:root]), jnp.asarray(b[root:].reshape(6, 3))))
    np.testing.assert_allclose(np.concatenate([x.root, x.leg.ravel()]), np.linalg.solve(dense, b), rtol=1e-12)
    back = arrowhead.times(a, x)
    np.testing.assert_allclose(np.concatenate([back.root, back.leg.ravel()]), b, atol=1e-13)

"""Support polygon and distances between links, against SciPy's hull and bounded least squares."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from scipy.optimize import lsq_linear
from scipy.spatial import ConvexHull, QhullError

from sweep.models.geometry import (
    EDGE_SEARCH_RADIUS_M,
    foot_edge_distance,
    gap_between_legs,
    leg_base_gap,
    link_capsules,
    segment_box_distance,
    segment_distance,
    shin_slope_sines,
    support_margin,
)
from sweep.models.obstacles.kerb import Kerb
from sweep.models.obstacles.ladder import Ladder
from sweep.models.obstacles.surface import BodyPoses, identity_poses
from sweep.models.robot import FOOT_LENGTH, Robot
from sweep.models.solids import Box, HalfSpace

MARGIN, DISTANCE = jax.jit(support_margin), jax.jit(segment_distance)
SEED = st.integers(0, 2**31)


@settings(max_examples=200, deadline=None)
@given(SEED, st.lists(st.booleans(), min_size=6, max_size=6))
def test_support_margin_equals_scipys_hull(seed, standing):
    """Least distance to the hull's border lines, positive inside: SciPy's facets are a x + b <= 0 there."""
    assume(sum(standing) >= 3)
    rng = np.random.default_rng(seed)
    feet, point = rng.uniform(-1, 1, (6, 2)), rng.uniform(-1.5, 1.5, 2)
    try:
        facets = ConvexHull(feet[np.array(standing)]).equations
    except QhullError:
        assume(False)
    expected = -np.max(facets[:, :2] @ point + facets[:, 2])
    assert MARGIN(feet, np.array(standing), point) == pytest.approx(expected, abs=1e-5)


@pytest.mark.parametrize("standing", [[], [2], [0, 5], [0, 2, 4]])
def test_too_few_feet_or_feet_in_line_support_nothing(standing):
    """Feet 1, 3, 5 stand in one line; the point is 0.3 m beside it."""
    feet = np.array([[-0.5, -0.4], [-0.5, 0.4], [0, -0.4], [0, 0.4], [0.5, -0.4], [0.5, 0.4]])
    margin = float(MARGIN(feet, np.isin(np.arange(6), standing), np.array([0.1, -0.1])))
    assert margin < 0 or (len(standing) < 2 and margin == np.inf)
    if len(standing) == 3:
        assert margin == pytest.approx(-0.3, abs=1e-6)


@settings(max_examples=60, deadline=None)
@given(SEED)
def test_segment_distance_is_the_bounded_least_squares_one(seed):
    """The two shares of the segments that are nearest to each other minimise a square within bounds."""
    p, p_end, q, q_end = np.random.default_rng(seed).uniform(-1, 1, (4, 3))
    nearest = lsq_linear(np.stack([p_end - p, q - q_end], axis=-1), q - p, bounds=(0, 1), method="bvls")
    expected = np.sqrt(2 * nearest.cost)
    assert DISTANCE(*map(jnp.asarray, (p, p_end, q, q_end))) == pytest.approx(expected, abs=1e-4)


@pytest.mark.parametrize(
    ("q", "q_end", "expected"),
    [
        ([0, 0.2, 0], [1, 0.2, 0], 0.2),  # side by side
        ([2, 0, 0], [3, 0, 0], 1.0),  # one behind the other
        ([0.5, -1, 0], [0.5, 1, 0], 0.0),  # crossing
        ([0.3, 0, 0.1], [0.3, 0, 2], 0.1),  # end on side
    ],
)
def test_segment_distance_of_special_positions(q, q_end, expected):
    one = [jnp.array([0.0, 0, 0]), jnp.array([1.0, 0, 0])]
    assert DISTANCE(*one, jnp.array(q, float), jnp.array(q_end, float)) == pytest.approx(expected, abs=2e-6)


@pytest.mark.parametrize(("one", "other"), [(1, 3), (2, 6), (5, 6), (1, 5)])
def test_legs_that_cross_have_no_gap(one, other):
    """Six legs stand 1 m apart, two of them are laid across each other."""
    joints = np.array([[[leg, 0, 1], [leg, 0.1, 0.5], [leg, 0.2, 0]] for leg in range(6)], dtype=float)
    assert float(gap_between_legs(jnp.asarray(joints))) == pytest.approx(1.0, abs=1e-5)
    joints[one - 1] += [10, 0, 0]
    joints[other - 1] = [[9 + one, 0.1, 0.5], [8 + one, 0.1, 0.5], [8 + one, 0.2, 0.5]]
    assert float(gap_between_legs(jnp.asarray(joints))) == pytest.approx(0.0, abs=1e-5)


@settings(max_examples=60, deadline=None)
@given(SEED)
def test_distance_of_a_segment_to_a_box_is_that_of_its_nearest_point(seed):
    rng = np.random.default_rng(seed)
    a, b, half = rng.uniform(-1, 1, 3), rng.uniform(-1, 1, 3), rng.uniform(0.05, 0.6, 3)
    points = a + np.linspace(0, 1, 2001)[:, None] * (b - a)
    expected = np.linalg.norm(np.maximum(np.abs(points) - half, 0), axis=-1).min()
    found = float(jax.jit(segment_box_distance)(*(jnp.asarray(x) for x in (a[None], b[None], half)))[0])
    assert max(found, 0.0) == pytest.approx(expected, abs=2e-3)


def test_the_shin_is_thick_to_its_foot_and_then_a_pin():
    joints = jnp.asarray([[[0, 0, 0.6], [0, 0.4, 0.6], [0, 0.4, 0]]] * 6, float)
    found = link_capsules(joints, Robot())
    np.testing.assert_allclose(found.start[0, 1], [0, 0.4, 0.6], atol=1e-6)
    np.testing.assert_allclose(found.end[0, 1], [0, 0.4, FOOT_LENGTH + 0.015], atol=1e-6)
    np.testing.assert_allclose(found.end[0, 2], [0, 0.4, 0.015], atol=1e-6)
    floor = HalfSpace(name="floor", normal=(0, 0, 1))
    np.testing.assert_allclose(found.distance_to([floor])[0], [0.585, FOOT_LENGTH, 0.013], atol=1e-6)
    base = jnp.zeros(3), jnp.eye(3), Robot(body_length=1.0, body_width=0.5, body_height=0.1)
    assert float(leg_base_gap(joints, *base)) == pytest.approx(0.15, abs=1e-3)  # the foot, beside the base


@pytest.mark.parametrize("angle", [-0.66, 0.24])
def test_a_shin_goes_through_the_rung_that_its_foot_is_on_or_rises_over_it(angle):
    """Its foot is on the rung's top, 20 mm from the edge that it goes out over: through it where its knee is below."""
    rung = Box(name="rung", position=(0, -0.01, -0.02), half=(0.8, 0.03, 0.02))
    foot = np.array([0.0, 0.0, -5e-4])
    knee = foot + 0.335 * np.array([0, np.cos(angle), np.sin(angle)])
    joints = jnp.asarray([[knee + np.array([0, 0.1, 0.5]), knee, foot]] * 6, float)
    distance = float(jnp.min(link_capsules(joints, Robot()).distance_to([rung])))
    assert (distance < -0.005) == (angle < 0)  # -5 mm is what the judge allows
    np.testing.assert_allclose(shin_slope_sines(joints, jnp.asarray([[0.0, 0.0, 1.0]] * 6)), np.sin(angle), atol=1e-6)


def test_a_foot_on_a_kerb_is_as_far_from_the_edge_as_it_stands_from_it():
    """Along its top, and down its side; no farther than edges are looked for."""
    feet = jnp.array([[0.02, 0.0, 0.1], [0.3, 1.0, 0.1], [0.0, 0.0, 0.07]])
    assert foot_edge_distance(Kerb(), feet, identity_poses(0)) == pytest.approx(
        np.array([0.02, EDGE_SEARCH_RADIUS_M, 0.03]), abs=1e-6
    )


def test_a_foot_on_a_rung_is_as_far_from_its_edge_as_half_of_the_rung_is_high_at_most():
    """A rung is 40 mm high, less than edges are looked for: its underside is none."""
    ladder = Ladder()
    bars = ladder.bars()
    rung = int(np.argmax(np.asarray(bars.centre)[2:, 1])) + 2  # the lowest, clear of wall and ledge
    out = np.array([0.0, 0.012, 0.029])
    top = np.asarray(bars.centre)[rung] - [0.0, float(np.asarray(bars.half)[rung, 1]), 0.0]
    feet = jnp.asarray(top + out[:, None] * [0.0, 0.0, 1.0])
    lies = BodyPoses(jnp.array([[0.0, 0.0, 1.0]]), jnp.eye(3)[None])
    left = foot_edge_distance(ladder, feet + lies.position[0], lies)
    assert left == pytest.approx(np.array([0.02, 0.018, 0.001]), abs=1e-6)

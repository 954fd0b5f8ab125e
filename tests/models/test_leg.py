"""Leg kinematics: the inverse is exact wherever the foot can be, and clamps to the nearest point where it cannot."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sweep.formulas.leg import forward_kinematics, inverse_kinematics

THIGH, SHIN = 0.52, 0.335
LEG = st.sampled_from([-1, 1])
COXA = st.sampled_from([0.0, 0.136])
MIRROR = st.booleans()
ANGLE = st.floats(-np.pi, np.pi)
ALPHA = st.floats(-np.pi / 2, np.pi / 2)  # turned further, a leg with a coxa reaches the same foot in two ways
COORDINATE = st.floats(-1.2, 1.2)
TOLERANCE = 2e-8  # m: arccos near a stretched or folded leg keeps half the digits


pytestmark = pytest.mark.usefixtures("double")


@jax.jit
def there_and_back(side, foot, coxa, thigh, shin, mirror):
    angles, shortfall = inverse_kinematics(side, foot, coxa, thigh, shin, mirror)
    return angles, shortfall, forward_kinematics(side, angles, coxa, thigh, shin)


@settings(max_examples=300, deadline=None)
@given(LEG, st.tuples(ALPHA, ANGLE, ANGLE), COXA, MIRROR)
def test_reached_feet_are_found_again(side, angles, coxa, mirror):
    foot = forward_kinematics(side, jnp.array(angles), coxa, THIGH, SHIN)
    _, shortfall, back = there_and_back(side, foot, coxa, THIGH, SHIN, mirror)
    assert shortfall < TOLERANCE
    np.testing.assert_allclose(back, foot, atol=TOLERANCE)


@settings(max_examples=300, deadline=None)
@given(LEG, st.tuples(COORDINATE, COORDINATE, COORDINATE), COXA, MIRROR, st.booleans())
def test_feet_out_of_reach_are_clamped_and_flagged(side, foot, coxa, mirror, longer_shin):
    """The foot ends as far from any target as the flag says: at it where it can be reached. Never NaN."""
    thigh, shin = (SHIN, THIGH) if longer_shin else (THIGH, SHIN)
    angles, shortfall, back = there_and_back(side, jnp.array(foot), coxa, thigh, shin, mirror)
    assert np.all(np.isfinite(angles))
    hip = np.hypot(*foot[:2]) * (1 if side * foot[1] >= 0 else -1) - coxa
    if np.hypot(hip, foot[2]) > 1e-6:  # at the hip itself every direction is the nearest
        assert np.linalg.norm(back - np.array(foot)) == pytest.approx(float(shortfall), abs=TOLERANCE)


def test_knee_stands_outward_or_mirrors():
    """Foot on the inner side of the left hip: by default the knee is outside the hip, mirrored it is inside."""
    foot = jnp.array([0.05, -0.2, -0.5])
    for mirror, sign in ((False, 1), (True, -1)):
        angles, _ = inverse_kinematics(1, foot, 0.0, THIGH, SHIN, mirror)
        knee = forward_kinematics(1, angles, 0.0, THIGH, 0.0)
        assert np.sign(knee[1]) == sign


@pytest.mark.parametrize("foot", [[0, 0, 0], [0, 0.136, 0], [0, 0, -1], [5, 5, 5]])
def test_singular_targets_give_numbers(foot):
    angles, shortfall = inverse_kinematics(np.array([-1, 1]), jnp.array([foot, foot], float), 0.136, THIGH, SHIN)
    assert np.all(np.isfinite(angles))
    assert np.all(np.isfinite(shortfall))

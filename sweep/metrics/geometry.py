"""Geometry that the metrics need: support polygon, links as segments. World axes, metres."""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from sweep.models.robot import FOOT_LENGTH
from sweep.models.solids import from_box

HALVINGS = 8  # a segment of 0.4 m is searched to 1 mm


def support_margin(feet: Float[Array, "n 2"], standing: Bool[Array, " n"], point: Float[Array, " 2"]) -> Array:
    """Signed distance of `point` to the border lines of the convex hull of the standing feet, positive inside.

    An ordered pair of feet is a border when every other standing foot lies to its left. Fewer than three standing
    feet, or feet on one line, support nothing: the margin is then minus the distance to the nearest border line.
    """
    edge = feet[None, :] - feet[:, None]  # from i to j
    length = jnp.sqrt(jnp.sum(edge**2, axis=-1) + 1e-12)

    def left_of(p: Array) -> Array:
        offset = p - feet
        return (edge[..., 0] * offset[:, None, 1] - edge[..., 1] * offset[:, None, 0]) / length

    sides = jnp.stack([left_of(foot) for foot in feet], axis=-1)  # (i, j, foot)
    pair = standing[:, None] & standing[None, :] & ~np.eye(feet.shape[0], dtype=bool)
    border = pair & jnp.all((sides > -1e-6) | ~standing, axis=-1)
    return jnp.min(jnp.where(border, left_of(point), jnp.inf))


def segment_distance(
    p: Float[Array, "*b 3"], p_end: Float[Array, "*b 3"], q: Float[Array, "*b 3"], q_end: Float[Array, "*b 3"]
) -> Float[Array, "*b"]:
    """Least distance between two segments."""
    u, v, w = p_end - p, q_end - q, p - q
    a, b, c = _dot(u, u), _dot(u, v), _dot(v, v)
    d, e = _dot(u, w), _dot(v, w)
    determinant = a * c - b * b
    parallel = determinant < 1e-9 * a * c
    s = jnp.where(parallel, 0.0, (b * e - c * d) / jnp.where(parallel, 1.0, determinant))
    t = jnp.clip((b * jnp.clip(s, 0, 1) + e) / c, 0, 1)
    s = jnp.clip((b * t - d) / a, 0, 1)
    t = jnp.clip((b * s + e) / c, 0, 1)
    gap = w + s[..., None] * u - t[..., None] * v
    return jnp.sqrt(_dot(gap, gap) + 1e-12)


def segment_box_distance(
    a: Float[Array, "n 3"], b: Float[Array, "n 3"], half: Float[Array, " 3"]
) -> Float[Array, " n"]:
    """Distance of segments to a box of half-sizes `half` about the origin; negative where one goes in.

    Its square is convex along a segment: the slope is halved in on, coordinate by coordinate, which a compiler makes
    one loop of.
    """
    start, along = a.T, (b - a).T
    share, step = jnp.full_like(start[0], 0.5), 0.25
    for _ in range(HALVINGS):
        slope = sum(_out(p + share * u, h) * u for p, u, h in zip(start, along, half, strict=True))
        share, step = share - step * jnp.sign(slope), step / 2
    return from_box((start + share * along).T, half)


def _out(x: Array, half: Array) -> Array:
    return x - jnp.clip(x, -half, half)


def _dot(a: Array, b: Array) -> Array:
    return jnp.sum(a * b, axis=-1)


def leg_gap(joints: Float[Array, "6 k 3"]) -> Float[Array, ""]:
    """Least distance between the centre lines of any two legs.

    `joints` are the points along each leg from the end of the hip's first link to the foot.
    """
    links = joints.shape[1] - 1
    one, other = np.triu_indices(6, 1)
    i, j = (index.ravel() for index in np.indices((links, links)))
    a, b = joints[one], joints[other]
    return jnp.min(segment_distance(a[:, i], a[:, i + 1], b[:, j], b[:, j + 1]))


def links_beyond_foot(
    joints: Float[Array, "6 k 3"], radius: Array | float
) -> tuple[Float[Array, "n 3"], Float[Array, "n 3"]]:
    """Ends of the centre lines of links as capsules of `radius`; the shin's ends, round, where its foot begins."""
    knee, foot = joints[:, -2], joints[:, -1]
    shin = foot - knee
    length = jnp.sqrt(jnp.sum(shin**2, axis=-1, keepdims=True) + 1e-12)
    ends = joints.at[:, -1].set(foot - jnp.minimum((FOOT_LENGTH + radius) / length, 1.0) * shin)
    return joints[:, :-1].reshape(-1, 3), ends[:, 1:].reshape(-1, 3)


def base_gap(
    joints: Float[Array, "6 k 3"], centre: Float[Array, " 3"], rotation: Float[Array, "3 3"], half: Float[Array, " 3"]
) -> Float[Array, ""]:
    """Least distance from the centre line of a leg's outer half to the robot's own base, negative inside.

    A thigh, which begins at the base's surface, comes no nearer than its middle or its end: the distance is convex.
    """
    points = (joints - centre) @ rotation
    knee, foot = points[:, -2], points[:, -1]
    thigh = from_box(0.5 * (points[:, -3] + knee), half)
    return jnp.min(jnp.minimum(thigh, segment_box_distance(knee, foot, half)))

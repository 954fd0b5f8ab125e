"""Geometry for metrics: support polygon, and distances between links as segments. World axes, metres.

Legs are the first axis throughout: what is done to each is then one operation of a compiled program.
"""

from collections.abc import Sequence
from functools import partial, reduce
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from sweep.models.obstacles.surface import BodyPoses, Obstacle, surface_at
from sweep.models.robot import FOOT_LENGTH, PIN_RADIUS, Robot, leg_keepout_half_size
from sweep.models.solids import Solid, distance_to_segments, signed_box_distance

BISECTION_STEPS = 8  # a segment of 0.4 m is searched to 1 mm
EDGE_SEARCH_RADIUS_M = 0.05  # m, how far from a foot edges are looked for
PROBE_DEPTHS = (0.4, 1.0)  # of it, how deep under a foot: the first is in the middle of a rung, 40 mm thick


def support_margin(feet: Float[Array, "n 2"], standing: Bool[Array, " n"], point: Float[Array, " 2"]) -> Array:
    """Return the signed distance of a point to the border of the convex hull of the standing feet, positive inside.

    An ordered pair of feet is a border when every other standing foot lies to its left. Fewer than three standing
    feet, or feet on one line, support nothing: the margin is then minus the distance to the nearest border line.

    Args:
        feet: Feet, seen from above (m).
        standing: Which of them carry load.
        point: The mass centre, seen from above (m).

    Returns:
        The margin (m).
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


def foot_edge_distance(obstacle: Obstacle, feet: Float[Array, "n 3"], bodies: BodyPoses) -> Float[Array, " n"]:
    """Return the distance (m) of each foot from the edge of the obstacle's face on which it stands.

    It probes the depth of the obstacle under each foot, so that it is at most `EDGE_SEARCH_RADIUS_M` and half the local
    thickness.

    Args:
        obstacle: The obstacle.
        feet: Positions of the feet (m, world axes).
        bodies: Poses of the free bodies.

    Returns:
        Distances (m).
    """
    normal = surface_at(obstacle, feet, bodies).normal
    probes = [
        surface_at(obstacle, feet - share * EDGE_SEARCH_RADIUS_M * normal, bodies).depth for share in PROBE_DEPTHS
    ]
    return reduce(jnp.maximum, probes)


def segment_distance(
    p: Float[Array, "*b 3"], p_end: Float[Array, "*b 3"], q: Float[Array, "*b 3"], q_end: Float[Array, "*b 3"]
) -> Float[Array, "*b"]:
    """Return the least distance (m) between pairs of segments, p to p_end and q to q_end."""
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
    """Return the distance (m) of segments a to b from a box of half sizes `half` about the origin; negative inside.

    Its square is convex along a segment: the slope is halved in on, coordinate by coordinate, which a compiler makes
    one loop of.
    """
    start, along = a.T, (b - a).T
    share, step = jnp.full_like(start[0], 0.5), 0.25
    for _ in range(BISECTION_STEPS):
        slope = sum(_out(p + share * u, h) * u for p, u, h in zip(start, along, half, strict=True))
        share, step = share - step * jnp.sign(slope), step / 2
    return signed_box_distance((start + share * along).T, half)


def _out(x: Array, half: Array) -> Array:
    return x - jnp.clip(x, -half, half)


def _dot(a: Array, b: Array) -> Array:
    return jnp.sum(a * b, axis=-1)


def gap_between_legs(joints: Float[Array, "6 k 3"]) -> Float[Array, ""]:
    """Return the least distance (m) between the centre lines of any two legs.

    `joints` are the points along each leg from the end of the hip's first link to the foot.
    """
    links = joints.shape[1] - 1
    i, j = (index.ravel() for index in np.indices((links, links)))

    def gaps(other_legs: Array) -> Array:
        return segment_distance(joints[:, i], joints[:, i + 1], other_legs[:, j], other_legs[:, j + 1])

    return jnp.min(jnp.stack([gaps(jnp.roll(joints, k, axis=0)) for k in (1, 2, 3)]))


class Capsules(NamedTuple):
    """Links of all legs as capsules for distance computations, made by `link_capsules`."""

    start: Float[Array, "6 n 3"]  # m, of the centre line
    end: Float[Array, "6 n 3"]  # m
    radius: Float[Array, " n"]  # m

    def distance_to(self, solids: Sequence[Solid]) -> Float[Array, "6 n"]:
        """Return the signed distance (m) of each link to the nearest of some solids."""
        return jax.vmap(partial(distance_to_segments, solids))(self.start, self.end) - self.radius


def link_capsules(joints: Float[Array, "6 k 3"], robot: Robot) -> Capsules:
    """Make the capsules of the legs' links for distance computations; a shin becomes thin before its foot.

    A shin has the link's radius until it is `FOOT_LENGTH` plus that radius from the foot, then `PIN_RADIUS` until it is
    a link's radius from the foot. Nearer to the foot only the contact point remains.

    Args:
        joints: Points along each leg from the hip to the foot (m).
        robot: Sizes of the links.
    """
    knee, foot = joints[:, -2], joints[:, -1]
    shin = foot - knee
    length = jnp.sqrt(jnp.sum(shin**2, axis=-1, keepdims=True) + 1e-12)
    radius = jnp.asarray(robot.link_radius, joints.dtype)

    def before_foot(distance: Array) -> Array:
        return foot - jnp.minimum(distance / length, 1.0) * shin

    thick, thin = before_foot(FOOT_LENGTH + radius), before_foot(radius)
    return Capsules(
        joints.at[:, -1].set(thick),
        jnp.concatenate([joints[:, 1:-1], thick[:, None], thin[:, None]], axis=1),
        jnp.stack([radius] * (joints.shape[1] - 1) + [jnp.asarray(PIN_RADIUS, joints.dtype)]),
    )


def shin_slope_sines(joints: Float[Array, "6 k 3"], normal: Float[Array, "6 3"]) -> Float[Array, " 6"]:
    """Return for each leg the sine of the angle between its shin and the face under its foot.

    Args:
        joints: Points along each leg from the hip to the foot (m).
        normal: Outward normals of the faces.

    Returns:
        Sines, negative where a shin is below its face.
    """
    shin = joints[:, -2] - joints[:, -1]
    return _dot(shin, normal) / jnp.sqrt(_dot(shin, shin) + 1e-12)


def leg_base_gap(
    joints: Float[Array, "6 k 3"],
    centre: Float[Array, " 3"],
    rotation: Float[Array, "3 3"],
    robot: Robot,
) -> Float[Array, ""]:
    """Return the least distance (m) of thighs and shins from the robot's own base.

    Thighs start at the surface of the base, so that only their part beyond `hip_clearance` counts.

    Args:
        joints: Points along each leg from the hip to the foot (m, world axes).
        centre: Centre of the base (m, world axes).
        rotation: Base axes to world axes.
        robot: Sizes of base and links.

    Returns:
        The distance (m), negative inside the base.
    """
    points = (joints[:, -3:] - centre) @ rotation
    points = points.at[:, 0].set(_point_along(points[:, 0], points[:, 1], robot.hip_clearance + robot.link_radius))
    to_base = jax.vmap(segment_box_distance, (0, 0, None))
    return jnp.min(to_base(points[:, :-1], points[:, 1:], leg_keepout_half_size(robot))) - robot.link_radius


def thigh_shin_gap(joints: Float[Array, "6 k 3"], clearance: Array | float) -> Float[Array, ""]:
    """Return the least distance (m) between the centre lines of thigh and shin of the same leg, over all legs.

    Args:
        joints: Points along each leg from the hip to the foot (m).
        clearance: Length of both links at the knee that does not count (m).

    Returns:
        The least distance over all legs (m).
    """
    hip, knee, foot = joints[:, -3], joints[:, -2], joints[:, -1]
    inner, outer = (_point_along(knee, end, clearance) for end in (hip, foot))
    return jnp.min(segment_distance(hip, inner, foot, outer))


def _point_along(start: Float[Array, "6 3"], end: Float[Array, "6 3"], way: Array | float) -> Float[Array, "6 3"]:
    """Points at a distance of `way` (m) from each start towards its end, at most at the end."""
    link = end - start
    return start + jnp.minimum(way / jnp.sqrt(jnp.sum(link**2, axis=-1, keepdims=True) + 1e-12), 1.0) * link

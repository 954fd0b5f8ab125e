"""Obstacles as solids, with true signed distances to a robot's links and base. World axes, metres, radians.

The signed distance of two bodies is their gap where they are apart, and minus the least shift that parts them where
they overlap (penetration depth). Apart, it is found on edges: the distance from a convex solid is a convex function
along a segment, whose minimum a golden section search brackets. Overlapping, it is the largest separation over the
axes that can be the last to part the two: normals of their faces and of pairs of their edges (Gottschalk, Lin and
Manocha, OBBTree, SIGGRAPH 1996, 15.3); a rim counts as its tangent.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, Protocol

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float

GOLDEN_SECTION_STEPS = 12  # golden sections, to 3 mm of a segment of 1 m; its least distance is then right to 0.1 mm
RIM_NEWTON_STEPS = 3  # Newton's, for the tangent of a rim that an edge crosses
MIN_AXIS_LENGTH = 1e-3  # an axis shorter than that, from unit vectors that are nearly parallel, tells nothing
MIN_SQUARE = 1e-12  # m^2, under roots: their derivatives stay finite, and their values true to 1 um
SOIL = (0.62, 0.66, 0.60, 1.0)
WOOD = (0.72, 0.55, 0.36, 1.0)
CORNER_SIGNS = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])  # of a box's corners
# ends of a box's edges among its corners: the four along each axis, in twos, as six are one operation when compiled
EDGE_STARTS, EDGE_ENDS = (
    np.stack([np.flatnonzero(CORNER_SIGNS[:, axis] == s) for axis in range(3)]).reshape(6, 2) for s in (-1, 1)
)


class Solid(Protocol):
    """A rigid shape that is part of an obstacle, with signed distances to the robot's links and base."""

    @property
    def name(self) -> str:
        """Name of the solid's geoms in MuJoCo."""
        ...

    @property
    def body(self) -> int:
        """Index of the free body to which the solid belongs; -1 for the fixed world."""
        ...

    def segment_distance(self, a: Float[Array, "n 3"], b: Float[Array, "n 3"]) -> Float[Array, " n"]:
        """Return the signed distances (m) to n segments from `a` to `b` (m, world axes)."""
        ...

    def box_distance(
        self, centre: Float[Array, " 3"], rotation: Float[Array, "3 3"], half: Float[Array, " 3"]
    ) -> Float[Array, ""]:
        """Return the signed distance (m) to a box of half sizes `half` (m) along the columns of `rotation` (world
        axes)."""
        ...


def distance_to_segments(solids: Sequence[Solid], a: Float[Array, "n 3"], b: Float[Array, "n 3"]) -> Float[Array, " n"]:
    """Return the signed distance of segments, such as centre lines of capsules, to the nearest solid.

    Args:
        solids: The solids of an obstacle.
        a: Starts of the segments (m, world axes).
        b: Their ends (m, world axes).

    Returns:
        Distances (m), negative by the penetration depth.
    """
    return _nearest(solids, lambda solid: solid.segment_distance(a, b))


def distance_to_box(
    solids: Sequence[Solid], centre: Float[Array, " 3"], rotation: Float[Array, "3 3"], half: Float[Array, " 3"]
) -> Float[Array, ""]:
    """Return the signed distance of a box to the nearest solid.

    Args:
        solids: The solids of an obstacle.
        centre: Centre of the box (m, world axes).
        rotation: Box axes to world axes.
        half: Half sizes of the box (m).

    Returns:
        The distance (m), negative by the penetration depth.
    """
    return _nearest(solids, lambda solid: solid.box_distance(centre, rotation, half))


def _nearest(solids: Sequence[Solid], distance: Callable[[Solid], Array]) -> Array:
    """The least distance over solids; boxes of free bodies are batched, so that their code compiles once."""
    boxes = [solid for solid in solids if isinstance(solid, Box) and solid.body >= 0]
    if len(boxes) < 2:
        return jnp.min(jnp.stack([distance(solid) for solid in solids]), axis=0)
    places = [jnp.stack([jnp.stack([*getattr(box, name)]) for box in boxes]) for name in ("position", "half")]
    rotations = jnp.stack([jnp.eye(3) if box.rotation is None else box.rotation for box in boxes])
    of_boxes: Callable = jax.vmap(
        lambda at, half, turned: distance(Box(name="", position=at, half=half, rotation=turned))
    )
    others = [distance(solid) for solid in solids if not any(solid is box for box in boxes)]
    return jnp.min(jnp.stack([*others, jnp.min(of_boxes(*places, rotations), axis=0)]), axis=0)


def array_module(x: Any) -> Any:
    """Return the module that computes with `x`: `jax.numpy` for JAX arrays and tracers, NumPy for plain numbers."""
    return jnp if isinstance(x, jax.Array) else np


def box_corners(
    centre: Float[Array, " 3"], rotation: Float[Array, "3 3"], half: Float[Array, " 3"]
) -> Float[Array, "8 3"]:
    """Return the eight corners of a box (m)."""
    return centre + (CORNER_SIGNS.astype(half.dtype) * half) @ rotation.T


@dataclass(frozen=True, kw_only=True)
class HalfSpace:
    """The half-space below a plane through the world's origin."""

    name: str
    normal: Sequence[Any] | Array
    body: int = -1

    def segment_distance(self, a: Array, b: Array) -> Array:
        """Return the signed distance (m) from the plane to segments, measured at their lower ends."""
        normal = _vector(self.normal, a.dtype)
        return jnp.minimum(a @ normal, b @ normal)

    def box_distance(self, centre: Array, rotation: Array, half: Array) -> Array:
        """Return the signed distance (m) from the plane to a box, measured at its lowest corner."""
        normal = _vector(self.normal, centre.dtype)
        return centre @ normal - jnp.abs(normal @ rotation) @ half


@dataclass(frozen=True, kw_only=True)
class Sphere:
    """A sphere as an obstacle's solid, with signed distances to links and base."""

    name: str
    radius: Any
    centre: Sequence[Any] | Array
    body: int = -1

    def segment_distance(self, a: Array, b: Array) -> Array:
        """Return the signed distance (m) from the sphere to segments: centre to nearest point, less the radius."""
        centre, along = _vector(self.centre, a.dtype), b - a
        share = jnp.clip(_dot(centre - a, along) / (_dot(along, along) + MIN_SQUARE), 0.0, 1.0)
        return _length(a + share[:, None] * along - centre) - self.radius

    def box_distance(self, centre: Array, rotation: Array, half: Array) -> Array:
        """Return the signed distance (m) from the sphere to a box: centre to nearest point, less the radius."""
        return signed_box_distance((_vector(self.centre, centre.dtype) - centre) @ rotation, half) - self.radius


@dataclass(frozen=True, kw_only=True)
class _Convex(ABC):
    """A convex solid about the origin of its own frame, in which the methods below take points and axes."""

    name: str
    position: Sequence[Any] | Array = (0.0, 0.0, 0.0)  # of its frame
    rotation: Array | None = None  # own axes to world axes, None where they are the same
    body: int = -1
    colour: tuple[float, ...] = WOOD

    @abstractmethod
    def signed_distance(self, points: Float[Array, "n 3"]) -> Float[Array, " n"]:
        """Return the signed distance (m) from the solid to points (m, solid axes)."""

    @abstractmethod
    def extent(self, axes: Float[Array, "*n 3"]) -> tuple[Array, Array]:
        """Return the extent of the solid (m) along given axes and against them (its support function)."""

    @abstractmethod
    def support_points(self, axes: Float[Array, "3 3"]) -> Float[Array, "m 3"]:
        """Return points of the solid among which, for each axis (row), one is outermost along it and one against it."""

    @abstractmethod
    def face_normals(self, dtype: Any) -> Float[Array, "k 3"]:
        """Return the normals of the solid's flat faces, one of each parallel pair."""

    def curved_face_normals(self, points: Float[Array, "n 3"]) -> list[Array]:
        """Return the normals (n, 3) of the solid's curved face towards points."""
        return []

    @abstractmethod
    def edge_cross_axes(self, along: Float[Array, "n 3"], points: Float[Array, "n 3"]) -> list[Array]:
        """Return axes (n, 3) normal to the solid's edges and to edges along `along`, whose innermost points are
        `points`."""

    def to_solid_frame(self, points: Float[Array, "*n 3"]) -> Float[Array, "*n 3"]:
        """Transform points from the world frame to the solid's frame (m)."""
        offset = points - _vector(self.position, points.dtype)
        return offset if self.rotation is None else offset @ self.rotation

    def segment_distance(self, a: Array, b: Array) -> Array:
        """Return signed distances (m) to the segments from `a` to `b`; a negative one is a depth of overlap."""
        a, b = self.to_solid_frame(a), self.to_solid_frame(b)
        at, apart = minimize_along_segments(self.signed_distance, a, b)
        along = (b - a) / _length(b - a)[:, None]
        axes = jnp.stack(
            [
                *[jnp.broadcast_to(plane, a.shape) for plane in self.face_normals(a.dtype)],
                *self.curved_face_normals(a),
                *self.curved_face_normals(b),
                *self.edge_cross_axes(along, at),
            ]
        )
        one, other = _dot(axes, a), _dot(axes, b)
        parted = self._separation(axes, jnp.minimum(one, other), jnp.maximum(one, other))
        return jnp.where(apart > 0, apart, jnp.max(parted, axis=0))

    def box_distance(self, centre: Array, rotation: Array, half: Array) -> Array:
        """Return the signed distance (m) to a box, from edges and corners, or from separating planes if they
        overlap."""
        centre = self.to_solid_frame(centre)
        rotation = rotation if self.rotation is None else self.rotation.T @ rotation
        corners = box_corners(centre, rotation, half)
        edges = (centre + (CORNER_SIGNS[k].astype(half.dtype) * half) @ rotation.T for k in (EDGE_STARTS, EDGE_ENDS))
        at, from_edges = jax.vmap(partial(minimize_along_segments, self.signed_distance))(*edges)
        from_tips = signed_box_distance((self.support_points(rotation.T) - centre) @ rotation, half)
        apart = jnp.minimum(jnp.min(from_edges), jnp.min(from_tips))
        nearest = jnp.argmin(from_edges.reshape(3, 4), axis=1)  # of the edges along each axis
        at = jnp.take_along_axis(at.reshape(3, 4, 3), nearest[:, None, None], axis=1)[:, 0]
        axes = [
            rotation.T,
            self.face_normals(centre.dtype),
            *self.curved_face_normals(corners),
            *self.edge_cross_axes(rotation.T, at),
        ]
        axes = jnp.concatenate(axes)
        middle, around = axes @ centre, jnp.abs(axes @ rotation) @ half
        parted = jnp.max(self._separation(axes, middle - around, middle + around))
        return jnp.where(parted > 0, apart, parted)

    def _separation(self, axes: Array, low: Array, high: Array) -> Array:
        """Gap along axes, or against them, between the solid and what extends from `low` to `high`."""
        size = _length(axes)
        along, against = self.extent(axes)
        return jnp.where(size > MIN_AXIS_LENGTH, jnp.maximum(low - along, -high - against) / size, -jnp.inf)


@dataclass(frozen=True, kw_only=True)
class Box(_Convex):
    """A box about its centre, with half sizes along its own axes."""

    half: Sequence[Any] | Array

    def signed_distance(self, points: Array) -> Array:
        """Return the signed distance (m) from the box to points (m, box axes)."""
        return signed_box_distance(points, _vector(self.half, points.dtype))

    def extent(self, axes: Array) -> tuple[Array, Array]:
        """Return the extents (m) of the box from its centre along given axes and against them, which are equal."""
        extent = jnp.abs(axes) @ _vector(self.half, axes.dtype)
        return extent, extent

    def support_points(self, axes: Array) -> Array:
        """Return the eight corners of the box."""
        return jnp.asarray(CORNER_SIGNS, axes.dtype) * _vector(self.half, axes.dtype)

    def face_normals(self, dtype: Any) -> Array:
        """Return the box's three axes."""
        return jnp.eye(3, dtype=dtype)

    def edge_cross_axes(self, along: Array, points: Array) -> list[Array]:
        """Return the cross products of edges along `along` with the box's three axes."""
        return [jnp.cross(edge, along) for edge in np.eye(3, dtype=along.dtype)]


@dataclass(frozen=True, kw_only=True)
class Cylinder(_Convex):
    """A cylinder about its centre, along its own z axis."""

    radius: Any
    half: Any  # of its height

    def signed_distance(self, points: Array) -> Array:
        """Return the signed distance (m) from the cylinder to points (m, cylinder axes)."""
        return _extruded_distance(_length(points[..., :2]) - self.radius, jnp.abs(points[..., 2]) - self.half)

    def extent(self, axes: Array) -> tuple[Array, Array]:
        """Return the extents (m) of the cylinder from its centre along given axes and against them, which are equal."""
        extent = self.radius * _length(axes[..., :2]) + self.half * jnp.abs(axes[..., 2])
        return extent, extent

    def support_points(self, axes: Array) -> Array:
        """Return the points of both rims that lie farthest along given axes."""
        rim = self._rim(axes[:, :2] / _length(axes[:, :2])[:, None], jnp.where(axes[:, 2] < 0, -1.0, 1.0))
        return jnp.concatenate([rim, -rim])

    def face_normals(self, dtype: Any) -> Array:
        """Return the cylinder's axis, the normal of its end faces."""
        return jnp.eye(3, dtype=dtype)[2:]

    def curved_face_normals(self, points: Array) -> list[Array]:
        """Return radial directions of the cylinder towards points."""
        return [points * np.array([1, 1, 0], points.dtype)]

    def edge_cross_axes(self, along: Array, points: Array) -> list[Array]:
        """Return candidate axes that separate the cylinder from edges along `along`, for its side and rims."""
        side = jnp.where(points[:, 2] < 0, -1.0, 1.0)
        clamped = jnp.clip(points[:, 2], -self.half, self.half)
        distance = _length(points[:, :2])[:, None]
        outer = jnp.concatenate(
            [points[:, :2] * jnp.maximum(1 - self.radius / distance, 0.0), (points[:, 2] - clamped)[:, None]], axis=1
        )
        axes = [outer, jnp.cross(np.array([0, 0, 1], along.dtype), along)]
        radial = points[:, :2] / distance
        for _ in range(RIM_NEWTON_STEPS):
            tangent = jnp.stack([-radial[:, 1], radial[:, 0], jnp.zeros_like(side)], axis=1)
            axes.append(jnp.cross(tangent, along))
            gap, cosine = points - self._rim(radial, side), _dot(tangent, along)
            step = (_dot(gap, tangent) - _dot(gap, along) * cosine) / jnp.maximum(1 - cosine**2, MIN_AXIS_LENGTH)
            radial = self.radius * radial + jnp.clip(step, -self.radius, self.radius)[:, None] * tangent[:, :2]
            radial = radial / _length(radial)[:, None]
        return axes

    def _rim(self, radial: Array, side: Array) -> Array:
        return jnp.concatenate([self.radius * radial, (side * self.half)[:, None]], axis=1)


@dataclass(frozen=True, kw_only=True)
class Prism(_Convex):
    """A prism over a convex polygon (clockwise seen from above), from its own z = 0 to `height`."""

    polygon: Sequence[tuple[Any, Any]]
    height: Any

    def to_solid_frame(self, points: Array) -> Array:
        """Transform points from the world frame to the prism's frame, with the origin at half its height (m)."""
        return super().to_solid_frame(points) - _vector((0.0, 0.0, self.height / 2), points.dtype)

    def signed_distance(self, points: Array) -> Array:
        """Return the signed distance (m) from the prism to points (m, prism axes)."""
        corners, along, length = self._sides(points.dtype)
        offset = points[:, None, :2] - corners
        out, on = _dot(offset, _turn_left(along)), _dot(offset, along)
        deepest = jnp.max(out, axis=1)
        outside = jnp.sqrt(jnp.min(out**2 + (on - jnp.clip(on, 0.0, length)) ** 2, axis=1) + MIN_SQUARE)
        aside = jnp.where(deepest > 0, outside, deepest)
        return _extruded_distance(aside, jnp.abs(points[:, 2]) - self.height / 2)

    def extent(self, axes: Array) -> tuple[Array, Array]:
        """Return the extents (m) of the prism from its origin along given axes and against them."""
        at = axes[..., :2] @ self._sides(axes.dtype)[0].T
        up = self.height / 2 * jnp.abs(axes[..., 2])
        return up + jnp.max(at, axis=-1), up - jnp.min(at, axis=-1)

    def support_points(self, axes: Array) -> Array:
        """Return the corners of both end faces."""
        return jnp.concatenate([_with_height(self._sides(axes.dtype)[0], end * self.height / 2) for end in (-1, 1)])

    def face_normals(self, dtype: Any) -> Array:
        """Return the normals of the prism's sides and end faces."""
        return jnp.concatenate([_with_height(_turn_left(self._sides(dtype)[1]), 0.0), jnp.eye(3, dtype=dtype)[2:]])

    def edge_cross_axes(self, along: Array, points: Array) -> list[Array]:
        """Return the cross products of edges along `along` with the base's edges and the prism's axis."""
        edges = [*_with_height(self._sides(along.dtype)[1], 0.0), jnp.eye(3, dtype=along.dtype)[2]]
        return [jnp.cross(edge, along) for edge in edges]

    def _sides(self, dtype: Any) -> tuple[Array, Array, Array]:
        """Corners, unit vectors along the sides that start there, and the sides' lengths."""
        corners = jnp.stack([_vector(corner, dtype) for corner in self.polygon])
        side = jnp.roll(corners, -1, axis=0) - corners
        length = _length(side)
        return corners, side / length[:, None], length


def minimize_along_segments(
    signed_distance: Callable[[Array], Array], a: Float[Array, "n 3"], b: Float[Array, "n 3"]
) -> tuple[Float[Array, "n 3"], Float[Array, " n"]]:
    """Minimize a signed distance along segments by golden-section search; it must be convex along each segment.

    Args:
        signed_distance: From points (n, 3) to distances (n,) (m).
        a: Starts of the segments (m).
        b: Their ends (m).

    Returns:
        The nearest point of each segment (m), and its distance (m).
    """
    golden = (5**0.5 - 1) / 2
    along = b - a

    def at(share: Array) -> Array:
        return a + share[:, None] * along

    def narrow(_: int, bracket: tuple[Array, ...]) -> tuple[Array, ...]:
        start, width, early, late = bracket  # two inner points, `golden` and 1 - `golden` of the width from the start
        left = early < late
        start = jnp.where(left, start, start + (1 - golden) * width)
        width = golden * width
        fresh = signed_distance(at(start + jnp.where(left, 1 - golden, golden) * width))
        return start, width, jnp.where(left, fresh, late), jnp.where(left, early, fresh)

    zero = jnp.zeros_like(a[:, 0])
    first, last = (signed_distance(at(zero + share)) for share in (1 - golden, golden))
    start, width, early, late = lax.fori_loop(0, GOLDEN_SECTION_STEPS, narrow, (zero, zero + 1, first, last))
    places = [zero, start + (1 - golden) * width, start + golden * width, zero + 1]
    values = [signed_distance(a), early, late, signed_distance(b)]
    place, value = places[0], values[0]
    for other, fresh in zip(places[1:], values[1:], strict=True):
        place, value = jnp.where(fresh < value, other, place), jnp.minimum(fresh, value)
    return at(place), value


def _extruded_distance(aside: Array, above: Array) -> Array:
    """Signed distance to a prism, from the distances to its cross-section and to its slab."""
    most = jnp.maximum(aside, above)
    return jnp.where(most > 0, jnp.sqrt(jnp.maximum(aside, 0.0) ** 2 + jnp.maximum(above, 0.0) ** 2 + MIN_SQUARE), most)


def signed_box_distance(points: Float[Array, "*n 3"], half: Float[Array, " 3"]) -> Float[Array, "*n"]:
    """Return the signed distance of points to a box about the origin, in the box's axes.

    Args:
        points: Points (m).
        half: Half sizes of the box (m).

    Returns:
        Distances (m), negative inside.
    """
    out = jnp.abs(points) - half
    most = jnp.max(out, axis=-1)
    return jnp.where(most > 0, _length(jnp.maximum(out, 0.0)), most)


def _vector(numbers: Any, dtype: Any) -> Array:
    """A vector of plain or traced numbers."""
    return jnp.stack([jnp.asarray(x, dtype) for x in numbers])


def _with_height(plane: Float[Array, "n 2"], height: Any) -> Float[Array, "n 3"]:
    """Extend vectors of the x-y plane by a third component."""
    return jnp.concatenate([plane, jnp.full_like(plane[:, :1], height)], axis=1)


def _turn_left(plane: Float[Array, "n 2"]) -> Float[Array, "n 2"]:
    """Turn vectors of the x-y plane by 90 degrees counterclockwise: outward normals of a clockwise polygon."""
    return jnp.stack([-plane[:, 1], plane[:, 0]], axis=1)


def _dot(a: Array, b: Array) -> Array:
    return jnp.sum(a * b, axis=-1)


def _length(a: Array) -> Array:
    return jnp.sqrt(_dot(a, a) + MIN_SQUARE)

"""Charts: coordinates in which plans say where feet and base are to be, offered by obstacles (and by manoeuvres)."""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float

from sweep.core.vectors import Number
from sweep.models.frames import WORLD

Forward = tuple[float, float]  # the way that robots come, in the plane
ALONG_X, ALONG_Y = (1.0, 0.0), (0.0, -1.0)


class Chart(NamedTuple):
    """Places by coordinates that have names."""

    names: tuple[str, ...]
    # the point (m) in `frame` of: what offers the chart; -1 or 1, the leg's side, as it mirrors places; the unit of
    # lengths (m); how deep below the surface (m); the coordinates
    at: Callable[..., Float[Array, " 3"]]
    frame: int = WORLD  # in which feet go there, and bases; see `sweep/models/frames.py`
    standing_frame: int | None = None  # in which feet stand there, if in another one
    # nose up (rad), of a base, by: what offers the chart; the unit; the coordinates. Without it the number after the
    # coordinates says it (deg), or it stays
    pitch: Callable[..., Number] | None = None
    # the point (m) that bases go round by as much as they pitch, by the same
    pivot: Callable[..., Float[Array, " 3"]] | None = None
    optional: int = 0  # of the last coordinates, which are 0 where they are not said

    def base_names(self) -> tuple[str, ...]:
        """Names of a base's numbers."""
        return self.names if self.pitch else (*self.names, "pitch")


def edge_chart(edge: Callable[[Any], tuple[Number, Number]]) -> Chart:
    """A chart for bases of robots that come along -y, from a point at (y, z) (m) in the plane x = 0."""

    def at(owner: Any, side: float, unit: Number, depth: Number, ahead: Number, above: Number) -> Float[Array, " 3"]:
        y, z = edge(owner)
        return point(0.0, y - ahead * unit, z + above * unit)

    return Chart(("ahead", "above"), at)


def approach_charts(foot: Callable[[Any], Number], forward: Forward = ALONG_Y) -> dict[str, Chart]:
    """Charts of the floor before what robots come to, whose foot is so far along their way (m).

    For feet, and for bases.
    """

    def on_floor(owner: Any, side: float, unit: Number, depth: Number, aside: Number, before: Number) -> Array:
        return point_ahead(forward, side * aside * unit, foot(owner) - before * unit, -depth)

    def base(owner: Any, side: float, unit: Number, depth: Number, before: Number, above: Number) -> Array:
        return point_ahead(forward, 0.0, foot(owner) - before * unit, above * unit)

    return {"floor": Chart(("aside", "before"), on_floor), "foot": Chart(("before", "above"), base)}


def level_ground_charts(
    edge: Callable[[Any], tuple[Number, Number]], forward: Forward = ALONG_X, frame: int = WORLD
) -> tuple[Chart, Chart]:
    """Charts of level ground from an edge on, so far along robots' way and so high (m): for feet, and for bases."""

    def on_ground(owner: Any, side: float, unit: Number, depth: Number, aside: Number, ahead: Number) -> Array:
        along, up = edge(owner)
        return point_ahead(forward, side * aside * unit, along + ahead * unit, up - depth)

    def base(owner: Any, side: float, unit: Number, depth: Number, ahead: Number, above: Number) -> Array:
        along, up = edge(owner)
        return point_ahead(forward, 0.0, along + ahead * unit, up + above * unit)

    return Chart(("aside", "ahead"), on_ground, frame), Chart(("ahead", "above"), base, frame)


def rearing_base_chart(length: Number) -> Chart:
    """A chart for bases of a `length` (m) that pitch up before what they come to along -y.

    Their front edge goes up a vertical line, their rear edge along a level one, and their centre goes round where these
    cross, so far ahead of the origin and above it.
    """

    def crossing(owner: Any, unit: Number, ahead: Number, above: Number, pitch: Number) -> Float[Array, " 3"]:
        return point(0.0, -ahead * unit, above * unit)

    def at(owner: Any, side: float, unit: Number, depth: Number, ahead: Number, above: Number, pitch: Number) -> Array:
        angle = nose_up(owner, unit, ahead, above, pitch)
        return crossing(owner, unit, ahead, above, pitch) + length / 2 * point(0.0, jnp.cos(angle), jnp.sin(angle))

    def nose_up(owner: Any, unit: Number, ahead: Number, above: Number, pitch: Number) -> Array:
        return jnp.radians(jnp.asarray(pitch, float))

    return Chart(("ahead", "above", "pitch"), at, pitch=nose_up, pivot=crossing)


def point_ahead(forward: Forward, aside: Number, ahead: Number, up: Number) -> Float[Array, " 3"]:
    """A point to the left of where robots look that come through the origin, ahead, and up (m)."""
    x, y = forward
    return point(ahead * x - aside * y, ahead * y + aside * x, up)


def point(x: Number, y: Number, z: Number) -> Float[Array, " 3"]:
    """A vector of numbers that may be traced."""
    return jnp.stack([jnp.asarray(value, float) for value in (x, y, z)])

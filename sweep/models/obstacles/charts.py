"""Charts: named coordinates in which plan files give footholds and base poses; offered by obstacles and manoeuvres."""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float

from sweep.core.vectors import Number
from sweep.models.frames import WORLD_FRAME

ForwardDirection = tuple[float, float]  # horizontal unit vector of the direction in which robots approach
ALONG_X, ALONG_Y = (1.0, 0.0), (0.0, -1.0)


class Chart(NamedTuple):
    """Named coordinates in which plans give footholds or base poses on an obstacle, with the map to metres."""

    names: tuple[str, ...]
    # the point (m) in `frame` of: what offers the chart; -1 or 1, the leg's side, as it mirrors places; the unit of
    # lengths (m); how deep below the surface (m); the coordinates
    at: Callable[..., Float[Array, " 3"]]
    frame: int = WORLD_FRAME  # in which feet go there, and bases; see `sweep/models/frames.py`
    standing_frame: int | None = None  # in which feet stand there, if in another one
    # nose up (rad), of a base, by: what offers the chart; the unit; the coordinates. Without it the number after the
    # coordinates says it (deg), or it stays
    pitch: Callable[..., Number] | None = None
    # the point (m) that bases go round by as much as they pitch, by the same
    pivot: Callable[..., Float[Array, " 3"]] | None = None
    optional_count: int = 0  # of the last coordinates, which are 0 where they are not said

    def base_coordinate_names(self) -> tuple[str, ...]:
        """Names of the coordinates that give a base pose in this chart, including `pitch`."""
        return self.names if self.pitch else (*self.names, "pitch")


def edge_chart(edge: Callable[[Any], tuple[Number, Number]]) -> Chart:
    """Make named coordinates for base positions relative to an edge at (y, z) (m) that robots approach along -y."""

    def at(owner: Any, side: float, unit: Number, depth: Number, ahead: Number, above: Number) -> Float[Array, " 3"]:
        y, z = edge(owner)
        return stack_components(0.0, y - ahead * unit, z + above * unit)

    return Chart(("ahead", "above"), at)


def approach_charts(foot: Callable[[Any], Number], forward: ForwardDirection = ALONG_Y) -> dict[str, Chart]:
    """Make named coordinates on the floor in front of an obstacle: `floor` for feet and `foot` for bases.

    Args:
        foot: Distance (m) of the obstacle's foot from the origin along `forward`, from the obstacle.
        forward: Direction in which robots approach.
    """

    def on_floor(owner: Any, side: float, unit: Number, depth: Number, aside: Number, before: Number) -> Array:
        return point_ahead(forward, side * aside * unit, foot(owner) - before * unit, -depth)

    def base(owner: Any, side: float, unit: Number, depth: Number, before: Number, above: Number) -> Array:
        return point_ahead(forward, 0.0, foot(owner) - before * unit, above * unit)

    return {"floor": Chart(("aside", "before"), on_floor), "foot": Chart(("before", "above"), base)}


def level_ground_charts(
    edge: Callable[[Any], tuple[Number, Number]], forward: ForwardDirection = ALONG_X, frame: int = WORLD_FRAME
) -> tuple[Chart, Chart]:
    """Make named coordinates for feet and bases on level ground beyond an edge.

    Args:
        edge: Distance (m) of the edge from the origin along `forward`, and its height (m), from the obstacle.
        forward: Direction in which robots approach.
        frame: Number of the frame in which the points are given.

    Returns:
        A chart for feet, and one for bases.
    """

    def on_ground(owner: Any, side: float, unit: Number, depth: Number, aside: Number, ahead: Number) -> Array:
        along, up = edge(owner)
        return point_ahead(forward, side * aside * unit, along + ahead * unit, up - depth)

    def base(owner: Any, side: float, unit: Number, depth: Number, ahead: Number, above: Number) -> Array:
        along, up = edge(owner)
        return point_ahead(forward, 0.0, along + ahead * unit, up + above * unit)

    return Chart(("aside", "ahead"), on_ground, frame), Chart(("ahead", "above"), base, frame)


def rearing_base_chart(length: Number) -> Chart:
    """Make named coordinates for a base of `length` (m) that rears up in front of an obstacle approached along -y.

    The base's front edge moves up a vertical line and its rear edge along a level line; its centre goes round the point
    where these lines cross, whose coordinates are `ahead` and `above`.
    """

    def crossing(owner: Any, unit: Number, ahead: Number, above: Number, pitch: Number) -> Float[Array, " 3"]:
        return stack_components(0.0, -ahead * unit, above * unit)

    def at(owner: Any, side: float, unit: Number, depth: Number, ahead: Number, above: Number, pitch: Number) -> Array:
        angle = nose_up(owner, unit, ahead, above, pitch)
        return crossing(owner, unit, ahead, above, pitch) + length / 2 * stack_components(
            0.0, jnp.cos(angle), jnp.sin(angle)
        )

    def nose_up(owner: Any, unit: Number, ahead: Number, above: Number, pitch: Number) -> Array:
        return jnp.radians(jnp.asarray(pitch, float))

    return Chart(("ahead", "above", "pitch"), at, pitch=nose_up, pivot=crossing)


def point_ahead(forward: ForwardDirection, aside: Number, ahead: Number, up: Number) -> Float[Array, " 3"]:
    """Return a point in world axes from its distances aside, ahead (along the robots' approach) and up.

    Args:
        forward: Direction in which robots approach.
        aside: To the left of that direction (m).
        ahead: Along that direction, from the origin (m).
        up: Height (m).

    Returns:
        The point (m, world axes).
    """
    x, y = forward
    return stack_components(ahead * x - aside * y, ahead * y + aside * x, up)


def stack_components(x: Number, y: Number, z: Number) -> Float[Array, " 3"]:
    """Stack three numbers, which may be traced, into a vector (3,).

    Args:
        x: First component.
        y: Second component.
        z: Third component.

    Returns:
        The vector, in the unit of its components.
    """
    return jnp.stack([jnp.asarray(value, float) for value in (x, y, z)])

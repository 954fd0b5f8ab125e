"""The robot: sizes and masses (monograph 1.1, 1.1.1)."""

import jax.numpy as jnp
from jaxtyping import Array, Float

from sweep.core.parameters import choice, parameters, quantity
from sweep.models.legs import N_LEGS

# m, of a shin's end, beside its radius, that tapers to the foot: it touches the face that it stands on, if it leans
FOOT_LENGTH = 0.04
PIN_RADIUS = 2e-3  # m, of the pin that is solid of that end all the same, up to a link's radius from the foot


@parameters
class Robot:
    """Parameters of the six-legged robot: a box body, and legs of coxa (l0), thigh (l1) and shin (l2).

    Legs are numbered 1-2 rear, 3-4 middle, 5-6 front, odd on the right. Base axes: x forward, y left, z up.
    """

    body_length: float = quantity(1.05, "m", above=0)  # a_r, from the rear hips to the front ones
    body_width: float = quantity(0.5, "m", above=0)  # b_r, between the hips of the two sides
    body_height: float = quantity(0.1, "m", above=0)  # c_r, thickness of the box
    body_mass: float = quantity(10.0, "kg", above=0)  # m_b, of the box without its legs
    # where the legs are mounted: on the box's corners and sides, or on a circle
    mounts: str = choice("rectangle", "rectangle", "circle")
    mount_radius: float = quantity(0.525, "m", above=0)  # b_p of (1.1.5), used by circular mounts
    leg_axes: str = choice("sides", "sides", "radial")  # alpha is measured from the y axis, or from the mount's radius
    legs: str = choice("two_link", "two_link", "three_link")  # without or with a coxa (1.1.1)
    coxa: float = quantity(0.0, "m", at_least=0)  # l0, length of the link between alpha and beta where there is one
    thigh: float = quantity(0.52, "m", above=0)  # l1, length of the link between beta and gamma
    shin: float = quantity(0.335, "m", above=0)  # l2, length of the link between gamma and the foot
    # of the cylinders that thighs and shins are, for their inertia and for what they touch
    link_radius: float = quantity(0.015, "m", above=0)
    # depth of the fork at a knee, into which the thigh folds: so near to its axis thigh and shin pass each other
    fork_ratio: float = quantity(0.3, "l2", at_least=0, at_most=1)
    hip_clearance: float = quantity(0.05, "m", at_least=0)  # so near to its hip a thigh passes the base: half of c_r
    coxa_mass: float = quantity(0.1, "kg", above=0)  # of one coxa, where there is one
    thigh_mass: float = quantity(0.5, "kg", above=0)  # of one thigh
    shin_mass: float = quantity(0.5, "kg", above=0)  # of one shin
    knees: str = choice("outward", "outward", "mirror")  # for feet on the inner side of their hip, see formulas.leg


def base_half_size(robot: Robot) -> Float[Array, " 3"]:
    """Return half length, half width and half height of the base (m)."""
    return 0.5 * jnp.stack([jnp.asarray(s, float) for s in (robot.body_length, robot.body_width, robot.body_height)])


def leg_keepout_half_size(robot: Robot) -> Float[Array, " 3"]:
    """Return half sizes (m) of the box that legs must not enter: the base, less a margin through which thighs sweep.

    Hips lie on the sides of the base. Between the hips the sides stand back by a link's radius, so that a thigh which
    turns along a side passes it.
    """
    return base_half_size(robot) - robot.link_radius * jnp.array([1.0, 1.0, 0.0])


def total_mass(robot: Robot) -> Array | float:
    """Return the mass of the whole robot (kg)."""
    coxa = robot.coxa_mass if robot.legs == "three_link" else 0.0
    return robot.body_mass + N_LEGS * (coxa + robot.thigh_mass + robot.shin_mass)


def length_unit(robot: Robot) -> Array | float:
    """Return the length unit of plans (m): thigh plus shin, scaled to be the base length of the monograph's robot."""
    return (robot.thigh + robot.shin) * (1.05 / 0.855)


def link_names(robot: Robot) -> tuple[str, ...]:
    """Return the names of a leg's links, from the hip outwards."""
    return ("coxa", "thigh", "shin") if robot.legs == "three_link" else ("thigh", "shin")

"""A homogeneous ball that lies on the floor and is free to roll (monograph 3.1)."""

from typing import TYPE_CHECKING, ClassVar

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from sweep.core.parameters import choice, parameters, quantity
from sweep.models.frames import WORLD_FRAME, body_frame_number, koenig_frame_number
from sweep.models.obstacles.base import ObstacleDefaults
from sweep.models.obstacles.charts import Chart, Number, stack_components
from sweep.models.obstacles.geoms import add_rolling_contact, add_solids
from sweep.models.obstacles.surface import BodyPoses, FreeBodyState, RollingResistance, Surface, identity_poses
from sweep.models.solids import HalfSpace, Solid, Sphere

if TYPE_CHECKING:
    import mujoco

FLOOR, BALL = range(2)


def point_at_elevation(
    obstacle: "Ball", side: float, unit: Number, depth: Number, aside: Number, elevation: Number
) -> Float[Array, " 3"]:
    """Return a foothold on the ball, R `aside` of the middle plane, at an elevation (deg): 0 behind, 90 on top."""
    angle, out = jnp.radians(jnp.asarray(elevation, float)), jnp.asarray(aside, float)
    round_ = jnp.sqrt(1 - out**2)
    return (obstacle.radius - depth) * stack_components(-round_ * jnp.cos(angle), side * out, round_ * jnp.sin(angle))


def cap_point(
    obstacle: "Ball", side: float, unit: Number, depth: Number, aside: Number, ahead: Number
) -> Float[Array, " 3"]:
    """Return a foothold on the ball's upper half (m), `aside` and `ahead` of the ball's centre (in radii)."""
    x, y = (jnp.asarray(part, float) for part in (ahead, side * aside))
    return (obstacle.radius - depth) * stack_components(x, y, jnp.sqrt(1 - x**2 - y**2))


def floor_point(
    obstacle: "Ball", side: float, unit: Number, depth: Number, aside: Number, ahead: Number
) -> Float[Array, " 3"]:
    """Return a foothold on the floor (m), `aside` and `ahead` of the ball's centre (in radii)."""
    return stack_components(ahead * obstacle.radius, side * aside * obstacle.radius, -obstacle.radius - depth)


def tangent_base_position(
    obstacle: "Ball", side: float, unit: Number, depth: Number, elevation: Number, distance: Number, ahead: Number = 0.0
) -> Float[Array, " 3"]:
    """Return a base position (m) given as a distance along a tangent to a circle about the ball's centre.

    Args:
        obstacle: The ball.
        side: Side of the leg, unused.
        unit: Unit of lengths (m), unused.
        depth: Depth below the surface (m), unused.
        elevation: Elevation of the tangent's point (deg): 0 behind the ball, 90 on top.
        distance: Radius of the circle (R).
        ahead: Displacement along the tangent (R).

    Returns:
        The base's centre relative to the ball's (m).
    """
    angle = jnp.radians(jnp.asarray(elevation, float))
    sin, cos = jnp.sin(angle), jnp.cos(angle)
    return obstacle.radius * stack_components(-distance * cos + ahead * sin, 0.0, distance * sin + ahead * cos)


def tangent_pitch(obstacle: "Ball", unit: Number, elevation: Number, distance: Number, ahead: Number = 0.0) -> Array:
    """Return the pitch (rad, nose up) of a base that `tangent_base_position` places along a tangent.

    Args:
        obstacle: The ball.
        unit: Unit of lengths (m), unused.
        elevation: Elevation of the tangent's point (deg).
        distance: Radius of the circle (R), unused.
        ahead: Displacement along the tangent (R), unused.

    Returns:
        The pitch (rad, nose up).
    """
    return jnp.radians(90 - jnp.asarray(elevation, float))


def pitch_pivot(obstacle: "Ball", unit: Number, *numbers: Number) -> Float[Array, " 3"]:
    """Return the point (m) about which bases of `tangent_base_position` turn: the ball's centre."""
    return jnp.zeros(3)


@parameters
class Ball(ObstacleDefaults):
    """A free ball on the floor, by default of radius 0.84 m and 100 kg.

    At the start it rests on the world's origin, or rolls over it."""

    kind: str = choice("ball", "ball")
    radius: float = quantity(0.84, "m", above=0)  # R, of the ball that the robot stands on
    mass: float = quantity(100.0, "kg", above=0)  # M, of the ball that the robot stands on
    rolling_friction: float = quantity(4e-4, "m", at_least=0)  # f_s: moment against rolling over the normal force
    spinning_friction: float = quantity(4e-4, "m", at_least=0)  # the same about the vertical
    floor_grip: float = quantity(1.0, "-", at_least=0)  # multiplies the friction coefficient of ball and floor
    speed: float = quantity(0.0, "m/s")  # of its centre at the start, with which it rolls
    course: float = quantity(0.0, "rad")  # direction of that speed, from the world's x axis

    # of feet, then of bases, from the ball's centre
    charts: ClassVar = {
        "ball": Chart(("aside", "elevation"), point_at_elevation, koenig_frame_number(0), body_frame_number(0)),
        "cap": Chart(("aside", "ahead"), cap_point, koenig_frame_number(0), body_frame_number(0)),
        "ground": Chart(("aside", "ahead"), floor_point, koenig_frame_number(0), WORLD_FRAME),
        "tangent": Chart(
            ("elevation", "distance", "ahead"),
            tangent_base_position,
            koenig_frame_number(0),
            pitch=tangent_pitch,
            pivot=pitch_pivot,
            optional_count=1,
        ),
    }
    sizes_learnable_from_height = ("radius",)
    forward = (1.0, 0.0)
    free_bodies = ("ball",)
    contact_sites = (("ball", 0),)

    def add_to(self, spec: "mujoco.MjSpec", friction: float) -> None:
        """Add the floor and the balls to a MuJoCo spec."""
        leaves, bodies = self.batched_model_fields(), []
        for name, place in zip(self.free_bodies, np.asarray(self.start().position, float), strict=True):
            mass, inertia = (np.asarray(leaves[field][name], float) for field in ("body_mass", "body_inertia"))
            body = spec.worldbody.add_body(
                name=name, pos=place, ipos=[0, 0, 0], explicitinertial=True, mass=float(mass), inertia=inertia
            )
            body.add_freejoint(name=name)
            bodies.append(body)
        for name, body in self.contact_sites:
            bodies[body].add_site(name=name)
        resistance = [friction * self.floor_grip, self.spinning_friction, self.rolling_friction]
        add_solids(spec, self.solids(identity_poses(len(bodies))), friction, self.free_bodies)
        add_rolling_contact(spec.worldbody, bodies, self.radius, resistance)

    def batched_model_fields(self) -> dict[str, dict[str, Array]]:
        """Return the fields of the MuJoCo model that hold the ball's mass and inertia, by field and body."""
        inertia = 2 / 5 * self.mass * self.radius**2
        return {
            "body_mass": {"ball": jnp.asarray(self.mass)},
            "body_inertia": {"ball": jnp.broadcast_to(jnp.asarray(inertia), (3,))},
        }

    def start(self) -> FreeBodyState:
        """Return the start state of a ball that rolls without slip."""
        direction = jnp.stack([jnp.cos(self.course), jnp.sin(self.course), jnp.zeros_like(jnp.cos(self.course))])
        velocity = self.speed * direction
        turn = jnp.cross(jnp.array([0.0, 0.0, 1.0]), velocity) / self.radius
        position = jnp.array([0.0, 0.0, 1.0]) * self.radius
        return FreeBodyState(position[None], jnp.array([[1.0, 0.0, 0.0, 0.0]]), velocity[None], turn[None])

    def solids(self, bodies: BodyPoses) -> tuple[Solid, ...]:
        """Return floor and ball as solids, for distance computations."""
        floor = HalfSpace(name="floor", normal=(0.0, 0.0, 1.0))
        return floor, Sphere(name="ball", radius=self.radius, centre=bodies.position[0], body=0)

    def surface(self, points: Float[Array, "n 3"], owner: tuple[int, ...], bodies: BodyPoses) -> Surface:
        """Return the contact surface at points (m): that of floor or ball, whichever contains the point more deeply.

        A point that belongs to the ball is its centre and touches only the floor, one radius below.
        """
        own = np.array(owner) >= 0
        dtype = points.dtype
        radius = jnp.asarray(self.radius, dtype)
        offset = points - bodies.position[0]
        distance = jnp.sqrt(jnp.sum(offset**2, axis=-1) + 1e-12)
        over, inside = -points[:, 2], radius - distance
        on_ball = ~own & (inside > over)
        up = jnp.array([0.0, 0.0, 1.0], dtype)
        rolls = jnp.asarray(own, dtype)
        return Surface(
            depth=jnp.where(on_ball, inside, over + rolls * radius),
            normal=jnp.where(on_ball[:, None], offset / distance[:, None], up),
            face=jnp.where(on_ball, BALL, FLOOR).astype(jnp.int32),
            body=jnp.where(on_ball, 0, -1).astype(jnp.int32),
            friction_scale=jnp.where(own, jnp.asarray(self.floor_grip, dtype), 1.0),
            rolling=RollingResistance(rolls * radius, rolls * self.rolling_friction, rolls * self.spinning_friction),
        )

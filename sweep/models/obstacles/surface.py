"""The interface of obstacles to contact, planning, metrics and rendering: surfaces, solids, and poses of free
bodies."""

from typing import TYPE_CHECKING, ClassVar, NamedTuple, Protocol, runtime_checkable

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from sweep.core.rotations import matrix, rotate
from sweep.models.solids import Solid

if TYPE_CHECKING:
    import mujoco

    from sweep.models.obstacles.charts import Chart

IMPACT_STIFFNESS = 1e6  # N/m, of the contact that an obstacle's `impact_damping` is a share of the critical damping of
FOOT_RADIUS = 1e-3  # m, of the native engine's spheres: a larger one rolls under the drives and drifts


class FreeBodyState(NamedTuple):
    """Poses and velocities of the obstacle's k free bodies, world axes; made by engines and estimators."""

    position: Float[Array, "k 3"]  # m, of the body frame, which is at the mass centre
    quat: Float[Array, "k 4"]
    velocity: Float[Array, "k 3"]  # m/s
    turn: Float[Array, "k 3"]  # rad/s


class BodyPoses(NamedTuple):
    """Poses of the obstacle's k free bodies without their velocities, world axes."""

    position: Float[Array, "k 3"]  # m, of the body frame
    rotation: Float[Array, "k 3 3"]  # body to world


def body_poses(free: FreeBodyState) -> BodyPoses:
    """Return the poses of free bodies from their state, without the velocities."""
    return BodyPoses(free.position, matrix(free.quat))


def empty_free_body_state() -> FreeBodyState:
    """Return an empty state, for obstacles without free bodies."""
    return FreeBodyState(jnp.zeros((0, 3)), jnp.zeros((0, 4)), jnp.zeros((0, 3)), jnp.zeros((0, 3)))


def identity_poses(count: int) -> BodyPoses:
    """Return `count` body poses at the origin without rotation, to get an obstacle's solids in body axes."""
    return BodyPoses(jnp.zeros((count, 3)), jnp.asarray(np.tile(np.eye(3), (count, 1, 1))))


class RollingResistance(NamedTuple):
    """Radius and resistance moments of n contact points that are centres of rolling spheres; zeros for other points."""

    radius: Float[Array, " n"]  # m, of the sphere
    roll: Float[Array, " n"]  # m, moment against rolling over the normal force
    spin: Float[Array, " n"]  # m, moment against turning about the normal over the normal force


class Surface(NamedTuple):
    """Surface of the obstacle nearest to each of n points: depth, normal and contact data, world axes."""

    depth: Float[Array, " n"]  # m, positive inside the solid, negative outside (speculative contact)
    normal: Float[Array, "n 3"]  # outward
    face: Int[Array, " n"]  # which face: a change of face drops the anchor
    body: Int[Array, " n"]  # index of the free body that owns the face, -1 for the fixed world
    friction_scale: Float[Array, " n"]  # multiplies the friction coefficient, 1 on ordinary ground
    rolling: RollingResistance | None = None  # None where nothing rolls
    damping: Float[Array, " n"] | None = None  # N s/m, added to that of the contact; None where there is no more


class Obstacle(Protocol):
    """The interface of an obstacle, on which the robot stands or climbs; implemented by parameter dataclasses."""

    charts: ClassVar[dict[str, "Chart"]]  # coordinates for plan tables, by name

    @property
    def kind(self) -> str:
        """Name of the obstacle in the configuration."""
        ...

    @property
    def free_bodies(self) -> tuple[str, ...]:
        """Names of the obstacle's bodies that move freely, in the order of `BodyPoses`."""
        ...

    @property
    def contact_sites(self) -> tuple[tuple[str, int], ...]:
        """Names of the MuJoCo sites at which free bodies may touch the world, each with the index of its body.

        A body may touch in several places at once: a ball that meets a wall as it lies on the floor has two sites at
        its centre, which `surface` tells apart by their order.
        """
        ...

    @property
    def forward(self) -> tuple[float, float]:
        """Horizontal unit vector of the direction in which robots approach the obstacle."""
        ...

    @property
    def heights(self) -> tuple[str, ...]:
        """Names of the size parameters that are heights of footholds; plans assume them larger while they are
        uncertain."""
        ...

    @property
    def sizes_learnable_from_height(self) -> tuple[str, ...]:
        """Names of the size parameters that the robot can estimate from how high free bodies lie on the floor."""
        ...

    @property
    def sizes_learnable_from_feet(self) -> tuple[str, ...]:
        """Names of sizes that the robot can estimate from feet on free bodies; without free bodies, all sizes."""
        ...

    def add_to(self, spec: "mujoco.MjSpec", friction: float) -> None:
        """Add the obstacle's geoms, bodies and sites to a MuJoCo spec; contact geoms are shrunk by `FOOT_RADIUS`."""
        ...

    def batched_model_fields(self) -> dict[str, dict[str, Array]]:
        """Return the MuJoCo model fields that depend on sizes and masses, by field and by body or site name."""
        ...

    def solids(self, bodies: BodyPoses) -> tuple[Solid, ...]:
        """Return the solids of the obstacle, with its free bodies at the poses `bodies`."""
        ...

    def external_wrench(self, free: FreeBodyState) -> Float[Array, "k 6"] | None:
        """Return force (N) and torque (N m) on each free body other than weight and contact, world axes; None if there
        are none.

        Every physics step calls it if there are free bodies.
        """
        ...

    def surface(self, points: Float[Array, "n 3"], owner: tuple[int, ...], bodies: BodyPoses) -> Surface:
        """Return the contact surface at points (m, world axes) of the free bodies `owner`, or (-1) of the robot."""
        ...


@runtime_checkable
class MovingObstacle(Obstacle, Protocol):
    """An obstacle that has free bodies."""

    def start(self) -> FreeBodyState:
        """Return the state of the free bodies at the start of a rollout."""
        ...


@runtime_checkable
class LandmarkedObstacle(MovingObstacle, Protocol):
    """An obstacle whose free bodies the robot observes by points (landmarks) other than their mass centres."""

    @property
    def landmarks(self) -> Float[Array, "k 3"]:
        """Point of each free body that the robot observes (m, body axes, from the mass centre)."""
        ...


def landmarks(obstacle: Obstacle) -> Float[Array, "k 3"]:
    """Return the observed point of each free body (m, body axes, from the mass centre); zeros by default."""
    return obstacle.landmarks if isinstance(obstacle, LandmarkedObstacle) else jnp.zeros((len(obstacle.free_bodies), 3))


def landmark_state(obstacle: Obstacle, free: FreeBodyState) -> FreeBodyState:
    """Convert poses and velocities of free bodies from their mass centres to the observed points (landmarks).

    Args:
        obstacle: The obstacle.
        free: State at the mass centres (world axes).

    Returns:
        State at the landmarks (world axes).
    """
    return _shift(free, obstacle.landmarks) if isinstance(obstacle, LandmarkedObstacle) else free


def state_from_landmarks(obstacle: Obstacle, marks: FreeBodyState) -> FreeBodyState:
    """Convert poses and velocities of free bodies from observed points (landmarks) to their mass centres.

    Args:
        obstacle: The obstacle.
        marks: State at the landmarks (world axes).

    Returns:
        State at the mass centres (world axes).
    """
    return _shift(marks, -obstacle.landmarks) if isinstance(obstacle, LandmarkedObstacle) else marks


def _shift(free: FreeBodyState, by: Float[Array, "k 3"]) -> FreeBodyState:
    arm = rotate(free.quat, by)
    return free._replace(position=free.position + arm, velocity=free.velocity + jnp.cross(free.turn, arm))


def free_start_state(obstacle: Obstacle) -> FreeBodyState:
    """Return the state of an obstacle's free bodies at the start of a rollout; empty if it has none."""
    if not obstacle.free_bodies:
        return empty_free_body_state()
    assert isinstance(obstacle, MovingObstacle), f"{obstacle.kind} lacks a member of MovingObstacle"
    return obstacle.start()


def surface_at(obstacle: Obstacle, points: Float[Array, "n 3"], bodies: BodyPoses) -> Surface:
    """Return the obstacle's contact surface (depth, normal, friction) at points of the robot.

    Args:
        obstacle: The obstacle.
        points: Points of the robot, such as feet (m, world axes).
        bodies: Poses of the free bodies.
    """
    return obstacle.surface(points, (-1,) * points.shape[0], bodies)


def critical_damping(mass: Array | float) -> Array:
    """Return the critical damping (N s/m) of a contact of stiffness `IMPACT_STIFFNESS` between a body of `mass` (kg)
    and the world."""
    return 2 * jnp.sqrt(IMPACT_STIFFNESS * mass)

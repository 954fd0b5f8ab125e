"""What a point feels of an obstacle; the interface that contact, planning, metrics and pictures share."""

from typing import TYPE_CHECKING, ClassVar, NamedTuple, Protocol, runtime_checkable

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from sweep.core.rotations import matrix, rotate
from sweep.models.solids import Solid

if TYPE_CHECKING:
    import mujoco

    from sweep.models.obstacles.charts import Chart

STIFFNESS = 1e6  # N/m, of the contact that an obstacle's `impact_damping` is a share of the critical damping of
FOOT_RADIUS = 1e-3  # m, of the native engine's spheres: a larger one rolls under the drives and drifts


class FreeState(NamedTuple):
    """Pose and motion of the obstacle's free bodies, world axes."""

    position: Float[Array, "k 3"]  # m, of the body frame, which is at the mass centre
    quat: Float[Array, "k 4"]
    velocity: Float[Array, "k 3"]  # m/s
    turn: Float[Array, "k 3"]  # rad/s


class BodyPoses(NamedTuple):
    """The poses of free bodies alone."""

    position: Float[Array, "k 3"]  # m, of the body frame
    rotation: Float[Array, "k 3 3"]  # body to world


def body_poses(free: FreeState) -> BodyPoses:
    """The poses of free bodies in motion."""
    return BodyPoses(free.position, matrix(free.quat))


def no_free_bodies() -> FreeState:
    """The state of no free bodies at all."""
    return FreeState(jnp.zeros((0, 3)), jnp.zeros((0, 4)), jnp.zeros((0, 3)), jnp.zeros((0, 3)))


def identity_poses(count: int) -> BodyPoses:
    """Poses of free bodies seen from their own axes."""
    return BodyPoses(jnp.zeros((count, 3)), jnp.asarray(np.tile(np.eye(3), (count, 1, 1))))


class RollingResistance(NamedTuple):
    """How those of n contact points roll that are centres of spheres; zeros elsewhere."""

    radius: Float[Array, " n"]  # m, of the sphere
    roll: Float[Array, " n"]  # m, moment against rolling over the normal force
    spin: Float[Array, " n"]  # m, moment against turning about the normal over the normal force


class Surface(NamedTuple):
    """The surface nearest to each of n points, world axes."""

    depth: Float[Array, " n"]  # m, positive inside the solid, negative outside (speculative contact)
    normal: Float[Array, "n 3"]  # outward
    face: Int[Array, " n"]  # which face: a change of face drops the anchor
    body: Int[Array, " n"]  # index of the free body that owns the face, -1 for the fixed world
    friction_scale: Float[Array, " n"]  # multiplies the friction coefficient, 1 on ordinary ground
    rolling: RollingResistance | None = None  # None where nothing rolls
    damping: Float[Array, " n"] | None = None  # N s/m, added to that of the contact; None where there is no more


class Obstacle(Protocol):
    """An obstacle is a parameter dataclass with these members."""

    charts: ClassVar[dict[str, "Chart"]]  # in which plans of files tell places of feet and bases, by name, if any

    @property
    def kind(self) -> str:
        """Its name in the configuration."""
        ...

    @property
    def free_bodies(self) -> tuple[str, ...]:
        """Names of its bodies with a free joint, in the order of `Bodies`."""
        ...

    @property
    def contact_sites(self) -> tuple[tuple[str, int], ...]:
        """Sites of its free bodies that touch the rest of the world, with the index of their body.

        A body may touch in several places at once: a ball that meets a wall as it lies on the floor has two sites at
        its centre, which `surface` tells apart by their order.
        """
        ...

    @property
    def forward(self) -> tuple[float, float]:
        """The way that robots come, in the plane."""
        ...

    @property
    def heights(self) -> tuple[str, ...]:
        """Sizes that say how high something is where feet are set down: planned for as larger while uncertain."""
        ...

    @property
    def lying(self) -> tuple[str, ...]:
        """Sizes that are known by how high its free bodies lie on the floor."""
        ...

    @property
    def stood_on(self) -> tuple[str, ...]:
        """Sizes that feet tell that stand on its free bodies; where it has none feet tell all sizes."""
        ...

    def add_to(self, spec: "mujoco.MjSpec", friction: float) -> None:
        """Put its geoms, bodies and sites in the spec; contact geoms are shrunk by `FOOT_RADIUS`."""
        ...

    def batched_model_fields(self) -> dict[str, dict[str, Array]]:
        """Varying arrays of its free bodies by model field and body (or site) name."""
        ...

    def solids(self, bodies: BodyPoses) -> tuple[Solid, ...]:
        """What it consists of, its free bodies where `bodies` says. Plain sizes stay plain numbers."""
        ...

    def external_wrench(self, free: FreeState) -> Float[Array, "k 6"] | None:
        """Force (N) and torque (N m) on each free body beside weight and contact, world axes; None where there is none.

        Asked at every physics step, only where there are free bodies.
        """
        ...

    def surface(self, points: Float[Array, "n 3"], owner: tuple[int, ...], bodies: BodyPoses) -> Surface:
        """Where `points` stand; `owner` is the free body that a point belongs to, -1 for the robot."""
        ...


@runtime_checkable
class MovingObstacle(Obstacle, Protocol):
    """An obstacle that has free bodies."""

    def start(self) -> FreeState:
        """The free bodies at the start."""
        ...


@runtime_checkable
class LandmarkedObstacle(MovingObstacle, Protocol):
    """One whose free bodies are seen by other points than their mass centres."""

    @property
    def landmarks(self) -> Float[Array, "k 3"]:
        """Middles of what is seen of each (m, its own axes from the mass centre)."""
        ...


def landmarks(obstacle: Obstacle) -> Float[Array, "k 3"]:
    """By which its free bodies are seen, as in `Marked`: mass centres, as of balls, where it says nothing else."""
    return obstacle.landmarks if isinstance(obstacle, LandmarkedObstacle) else jnp.zeros((len(obstacle.free_bodies), 3))


def landmark_state(obstacle: Obstacle, free: FreeState) -> FreeState:
    """Its landmarks, in the axes of free bodies that are as in `free`."""
    return _shifted(free, obstacle.landmarks) if isinstance(obstacle, LandmarkedObstacle) else free


def state_from_landmarks(obstacle: Obstacle, marks: FreeState) -> FreeState:
    """The inverse of `marked`: its free bodies where they have their landmarks as in `marks`."""
    return _shifted(marks, -obstacle.landmarks) if isinstance(obstacle, LandmarkedObstacle) else marks


def _shifted(free: FreeState, by: Float[Array, "k 3"]) -> FreeState:
    arm = rotate(free.quat, by)
    return free._replace(position=free.position + arm, velocity=free.velocity + jnp.cross(free.turn, arm))


def free_start_state(obstacle: Obstacle) -> FreeState:
    """Its free bodies at the start, where it has any."""
    if not obstacle.free_bodies:
        return no_free_bodies()
    assert isinstance(obstacle, MovingObstacle), f"{obstacle.kind} lacks a member of MovingObstacle"
    return obstacle.start()


def surface_at(obstacle: Obstacle, points: Float[Array, "n 3"], bodies: BodyPoses) -> Surface:
    """The obstacle at points of the robot (m, world axes)."""
    return obstacle.surface(points, (-1,) * points.shape[0], bodies)


def critical_damping(mass: Array | float) -> Array:
    """Of a contact (N s/m) whose bodies move as one of `mass` (kg) against something fixed."""
    return 2 * jnp.sqrt(STIFFNESS * mass)

"""Scenes for this package's step: an obstacle of bodies whose points touch planes, with the robot standing beside.

All scenes have one form, with room for the same bodies and points, so that one program simulates them side by side.
"""

import dataclasses
from collections.abc import Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from jax.typing import ArrayLike
from jaxtyping import Array, Float

from sweep.config.experiment import compose
from sweep.manoeuvres.walking.walk import level_stance
from sweep.models.case import Case
from sweep.models.contact import Contact
from sweep.models.obstacles.base import ObstacleDefaults
from sweep.models.obstacles.surface import BodyPoses, FreeBodyState, RollingResistance, Surface
from sweep.models.posture import joint_targets
from validity.scenes import BODIES, TOUCHES, UP, Body, History, Scene, Touch, rotate_vectors
from validity.simulation import simulate

BESIDE = (0.0, 2.0, 0.0)  # m, where the robot stands: bodies are as far from its base as a raft's ends are
NOWHERE = Touch(0, (0.0, 0.0, 0.0), 0.0, offset=-1e6)
IDLE = Body(1.0, (1.0, 1.0, 1.0), (0.0, 0.0, 0.0))


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Points(ObstacleDefaults):
    """The bodies and points of a scene: k bodies, m points of each."""

    mass: Array
    inertia: Array
    force: Array
    at: Array  # (k m, 3), as all below
    friction: Array
    normal: Array
    offset: Array
    on: Array
    radius: Array

    kind = "points"
    free_bodies = tuple(f"body{k}" for k in range(BODIES))
    contact_sites = tuple((f"point{i}", i // TOUCHES) for i in range(BODIES * TOUCHES))

    def add_to(self, spec: mujoco.MjSpec, friction: float) -> None:
        """Bodies without geoms: C MuJoCo only weighs them here."""
        for k, name in enumerate(self.free_bodies):
            body = spec.worldbody.add_body(name=name, explicitinertial=True, mass=float(self.mass[k]),
                                           inertia=np.asarray(self.inertia[k]), ipos=[0, 0, 0])  # fmt: skip
            body.add_freejoint(name=name)
        for i, (name, body) in enumerate(self.contact_sites):
            spec.body(self.free_bodies[body]).add_site(name=name, pos=np.asarray(self.at[i]))

    def batched_model_fields(self) -> dict[str, dict[str, Array]]:
        """Masses, inertias and points."""
        return {
            "body_mass": dict(zip(self.free_bodies, self.mass, strict=True)),
            "body_inertia": dict(zip(self.free_bodies, self.inertia, strict=True)),
            "site_pos": {name: self.at[i] for i, (name, _) in enumerate(self.contact_sites)},
        }

    def solids(self, bodies: BodyPoses) -> tuple:
        """Nothing that is drawn."""
        return ()

    def external_wrench(self, free: FreeBodyState) -> Float[Array, "k 6"]:
        """The constant forces."""
        return jnp.concatenate([self.force, jnp.zeros_like(self.force)], axis=-1)

    def surface(self, points: Float[Array, "n 3"], owner: tuple[int, ...], bodies: BodyPoses) -> Surface:
        """The plane of every point; the robot's feet, which come first, feel the floor."""
        feet = len(owner) - len(self.contact_sites)
        normal, origin = self.normal, jnp.zeros_like(self.normal)
        for k in range(BODIES):
            mine = (self.on == k)[:, None]
            normal = jnp.where(mine, self.normal @ bodies.rotation[k].T, normal)
            origin = jnp.where(mine, bodies.position[k], origin)
        depth = self.offset + self.radius - jnp.sum(normal * (points[feet:] - origin), axis=-1)

        def with_feet(values: Array, of_feet: ArrayLike) -> Array:
            of_feet = jnp.broadcast_to(jnp.asarray(of_feet, values.dtype), (feet, *values.shape[1:]))
            return jnp.concatenate([of_feet, values])

        none = jnp.zeros(len(owner), points.dtype)
        return Surface(
            depth=with_feet(depth, -points[:feet, 2]),
            normal=with_feet(normal, jnp.array(UP)),
            face=jnp.zeros(len(owner), jnp.int32),
            body=with_feet(self.on, -1.0).astype(jnp.int32),
            friction_scale=with_feet(self.friction, 1.0),
            rolling=RollingResistance(with_feet(self.radius, 0.0), none, none),
        )


def points(scene: Scene) -> Points:
    """A scene as an obstacle."""
    bodies = [*scene.bodies, *[IDLE] * (BODIES - len(scene.bodies))]
    touches = [touch for k in range(BODIES) for touch in _room([t for t in scene.touches if t.body == k])]
    fields = {name: np.array([getattr(body, name) for body in bodies], float) for name in ("mass", "inertia", "force")}
    names = ("at", "friction", "normal", "offset", "on", "radius")
    return Points(**fields, **{name: np.array([getattr(t, name) for t in touches], float) for name in names})  # pyright: ignore


def _room(touches: list[Touch]) -> list[Touch]:
    return touches + [NOWHERE] * (TOUCHES - len(touches))


class Batch(NamedTuple):
    """Scenes before the step: the case with its swept leaves, its structure, and how all begins."""

    case: Case
    nominal: Case
    q: np.ndarray
    v: np.ndarray
    joints: np.ndarray  # (6, 3) rad, that the robot is told


def batch(scenes: Sequence[Scene]) -> Batch:
    """Scenes side by side."""
    base = compose([]).case
    obstacles = [points(scene) for scene in scenes]
    nominal = dataclasses.replace(base, obstacle=obstacles[0], contact=Contact())
    stance, _ = level_stance(nominal, 0.3, 0.525)
    joints, _ = joint_targets(nominal.robot, stance)
    q, v = start(scenes)
    q[:, :25] = np.concatenate([stance.position + jnp.array(BESIDE), stance.quat, joints.ravel()])
    case = dataclasses.replace(nominal, obstacle=jax.tree.map(lambda *x: np.stack(x, axis=-1), *obstacles))
    return Batch(case, nominal, q, v, np.asarray(joints))


def simulate_scenes(
    scenes: Sequence[Scene], h: float = 2e-3, iterations: int = 2, double: bool = False, fused: bool = False
) -> list[History]:
    """Return scenes simulated by this package's step up to the end of the longest, each cut to its own end."""
    return simulate_batch(scenes, batch(scenes), h, iterations, double, fused)


def simulate_batch(
    scenes: Sequence[Scene], begun: Batch, h: float, iterations: int, double: bool, fused: bool
) -> list[History]:
    """Return the same of an existing batch."""
    case, nominal, q, v, joints = begun
    steps = max(round(scene.seconds / h) for scene in scenes)
    kind = np.float64 if double else np.float32
    references = np.broadcast_to(joints.astype(kind), (steps, 6, 3))
    with jax.enable_x64(double):
        found = simulate(case, nominal, q.astype(kind), references, h, v, iterations, fused)
    return [
        _history(scene, found.q[:, row], found.v[:, row], found.residual[:, row], h) for row, scene in enumerate(scenes)
    ]


def start(scenes: Sequence[Scene]) -> tuple[np.ndarray, np.ndarray]:
    """Configurations and velocities of the bodies, after those of the robot, which are zero."""
    q, v = np.zeros((len(scenes), 25 + 7 * BODIES)), np.zeros((len(scenes), 24 + 6 * BODIES))
    q[:, 28::7] = 1.0
    for row, scene in enumerate(scenes):
        for k, body in enumerate(scene.bodies):
            q[row, 25 + 7 * k : 32 + 7 * k] = [*body.position, *body.quat]
            v[row, 24 + 6 * k : 30 + 6 * k] = [*body.velocity, *body.turn]
    return q, v


def _history(scene: Scene, q: np.ndarray, v: np.ndarray, residual: np.ndarray, h: float) -> History:
    steps, count = round(scene.seconds / h), len(scene.bodies)
    q, v = (
        q[:steps, 25 : 25 + 7 * count].reshape(steps, count, 7),
        v[:steps, 24 : 24 + 6 * count].reshape(steps, count, 6),
    )
    time = h * (1 + np.arange(steps))
    history = History(time, q[..., :3], q[..., 3:], v[..., :3], v[..., 3:], np.zeros(0), float(residual[:steps].max()))
    return history._replace(load=loads(scene, history))


def loads(scene: Scene, h: History) -> np.ndarray:
    """Normal forces of the contact law at a history's end (N)."""
    out = []
    for touch in scene.touches:
        place, arm, normal = (
            h.position[-1, touch.body],
            rotate_vectors(h.quat[-1, touch.body], np.array(touch.at)),
            np.array(touch.normal),
        )
        speed = h.velocity[-1, touch.body] + rotate_vectors(
            h.quat[-1, touch.body], np.cross(h.turn[-1, touch.body], touch.at)
        )
        if touch.on >= 0:
            normal, place = rotate_vectors(h.quat[-1, touch.on], normal), place - h.position[-1, touch.on]
            speed = speed - h.velocity[-1, touch.on]
            speed = speed - rotate_vectors(
                h.quat[-1, touch.on],
                np.cross(h.turn[-1, touch.on], rotate_vectors(_inverse(h.quat[-1, touch.on]), place + arm)),
            )
        depth = touch.offset + touch.radius - normal @ (place + arm)
        out.append(max(0.0, Contact().stiffness * depth - Contact().damping * normal @ speed))
    return np.array(out)


def _inverse(quat: np.ndarray) -> np.ndarray:
    return quat * np.array([1, -1, -1, -1])

"""Explicit integration of the contact law (1.2.2) of rigid bodies: double precision, small steps, no solver.

Independent of the step that it checks: it takes only gravity and the law's stiffness and damping from `sweep`.
"""

from collections.abc import Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike
from jaxtyping import Array

from sweep.core.constants import GRAVITY
from validity.scenes import BODIES, LAW, TOUCHES, Body, History, Scene, Touch

STEP, KEPT = 1e-5, 1e-3  # s: of the integration, and between what is kept


class Constants(NamedTuple):
    """Constants of k bodies and n touches."""

    mass: ArrayLike
    inertia: ArrayLike
    force: ArrayLike
    body: ArrayLike
    at: ArrayLike
    friction: ArrayLike
    normal: ArrayLike
    offset: ArrayLike
    on: ArrayLike
    radius: ArrayLike


class State(NamedTuple):
    """State of the bodies and touches."""

    position: Array
    quat: Array
    velocity: Array
    turn: Array  # own axes
    stretch: Array  # (n, 3) m, of the tangential springs, world axes
    load: Array  # (n,) N


def integrate(scenes: Sequence[Scene], step: float = STEP) -> list[History]:
    """Return the histories of scenes by the contact law, side by side."""
    every, longest = round(KEPT / step), max(scene.seconds for scene in scenes)
    with jax.enable_x64(True):
        given, begun = (
            jax.tree.map(lambda *x: jnp.stack(x), *parts) for parts in zip(*map(_begun, scenes), strict=True)
        )
        advance = jax.vmap(lambda given, state: _advance(given, state, step))

        def ahead(state: State, _: None) -> tuple[State, State]:
            state = jax.lax.fori_loop(0, every, lambda _, s: advance(given, s), state)
            return state, state

        found = jax.jit(lambda s: jax.lax.scan(ahead, s, length=round(longest / KEPT))[1])(begun)
    out = []
    for k, scene in enumerate(scenes):
        n, bodies = round(scene.seconds / KEPT), len(scene.bodies)
        position, quat, velocity, turn = (np.asarray(x)[:n, k, :bodies] for x in found[:4])
        load = np.asarray(found.load)[n - 1, k, : len(scene.touches)]
        out.append(History(KEPT * (1 + np.arange(n)), position, quat, velocity, turn, load))
    return out


def _begun(scene: Scene) -> tuple[Constants, State]:
    bodies = [*scene.bodies, *[Body(1.0, (1.0,) * 3, (0.0,) * 3)] * (BODIES - len(scene.bodies))]
    idle = [Touch(0, (0.0,) * 3, 0.0, offset=-1e9)] * (BODIES * TOUCHES - len(scene.touches))

    def all_of(name: str, parts: Sequence[Body | Touch]) -> np.ndarray:
        return np.array([getattr(part, name) for part in parts])

    touches = [*scene.touches, *idle]
    of_bodies = {name: all_of(name, bodies) for name in ("mass", "inertia", "force")}
    of_touches = {name: all_of(name, touches) for name in Touch._fields}
    moving = {name: jnp.asarray(all_of(name, bodies), float) for name in ("position", "quat", "velocity", "turn")}
    still = {"stretch": jnp.zeros((len(touches), 3)), "load": jnp.zeros(len(touches))}
    return Constants(**of_bodies, **of_touches), State(**moving, **still)


def _matrix(quat: Array) -> Array:
    w, x, y, z = quat
    cross = jnp.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return jnp.eye(3) + 2 * w * cross + 2 * cross @ cross


def _advance(given: Constants, state: State, h: float) -> State:
    given = Constants(*map(jnp.asarray, given))
    axes = jax.vmap(_matrix)(state.quat)
    spin = jnp.einsum("kij,kj->ki", axes, state.turn)
    moves, body, on = (given.on >= 0)[:, None], given.body, given.on  # pyright: ignore

    normal = jnp.where(moves, jnp.einsum("nij,nj->ni", axes[on], given.normal), given.normal)
    arm = jnp.einsum("nij,nj->ni", axes[body], given.at) - given.radius[:, None] * normal  # pyright: ignore
    point = state.position[body] + arm
    other = jnp.where(moves, point - state.position[on], point)
    speed = state.velocity[body] + jnp.cross(spin[body], arm)
    speed = speed - jnp.where(moves, state.velocity[on] + jnp.cross(spin[on], other), 0.0)
    rising = jnp.sum(speed * normal, axis=-1)
    depth = given.offset - jnp.sum(normal * other, axis=-1)
    load = jnp.maximum(0.0, LAW.stiffness * depth - LAW.damping * rising)

    passing = speed - rising[:, None] * normal
    stretch = state.stretch - jnp.sum(state.stretch * normal, axis=-1, keepdims=True) * normal
    pull = LAW.stiffness * stretch - LAW.damping * passing
    size, most = jnp.linalg.norm(pull, axis=-1), given.friction * load
    slips = size > most
    pull = jnp.where(slips, most / jnp.maximum(size, 1e-30), 1.0)[:, None] * pull
    stretch = jnp.where(slips[:, None], pull / LAW.stiffness, stretch - h * passing)
    stretch = jnp.where((load > 0)[:, None], stretch, 0.0)

    pull = jnp.where((load > 0)[:, None], pull, 0.0) + load[:, None] * normal
    own, its = jnp.eye(BODIES)[body].T, jnp.where(moves, jnp.eye(BODIES)[on], 0.0).T
    force = own @ pull - its @ pull + given.force + given.mass[:, None] * jnp.array([0.0, 0.0, -GRAVITY])  # pyright: ignore
    torque = own @ jnp.cross(arm, pull) - its @ jnp.cross(other, pull)
    velocity = state.velocity + h * force / given.mass[:, None]  # pyright: ignore
    torque = jnp.einsum("kji,kj->ki", axes, torque) - jnp.cross(state.turn, given.inertia * state.turn)
    turn = state.turn + h * torque / given.inertia
    return State(state.position + h * velocity, _turned(state.quat, turn, h), velocity, turn, stretch, load)


def _turned(quat: Array, turn: Array, h: float) -> Array:
    w, u = quat[:, :1], quat[:, 1:]
    half = 0.5 * h * turn
    new = [w - jnp.sum(u * half, axis=-1, keepdims=True), u + w * half + jnp.cross(u, half)]
    new = jnp.concatenate(new, axis=-1)
    return new / jnp.linalg.norm(new, axis=-1, keepdims=True)

"""What the controller is told of the state: bias, noise and delay; and where it takes free bodies to be by that."""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from sweep.core.rotations import conjugate, exponential, logarithm, multiply
from sweep.models.control import Control
from sweep.models.noise import Noise
from sweep.models.obstacles.surface import FreeState

# folded into a key to draw errors of the free bodies, of the feet's load, and of what turns
FREE, LOAD, RATES = 1, 2, 3
DOUBT = 4.0  # deviations of what is measured on a foot in the air that do not yet make it stand


class Observation(NamedTuple):
    """What the controller sees of the robot and of the obstacle's free bodies. World axes."""

    position: Float[Array, " 3"]  # m, of the base
    quat: Float[Array, " 4"]  # base to world
    velocity: Float[Array, " 3"]  # m/s, of the base
    spin: Float[Array, " 3"]  # rad/s, of the base, base axes
    angles: Float[Array, "6 3"]  # rad, of the joints
    rates: Float[Array, "6 3"]  # rad/s
    joint_error: Float[Array, "6 3"]  # rad, measured minus true joint angle: what the drives' feedback suffers
    loaded: Bool[Array, " 6"]  # which feet carry load, for sure
    free: FreeState
    load: Float[Array, " 6"] | float = np.inf  # N, on each foot, along the normal
    perhaps: Bool[Array, " 6"] | None = None  # which do by what is measured; None: those that are loaded


class Biases(NamedTuple):
    """Constant errors of what is measured of the robot in a rollout."""

    position: Float[Array, " 3"]  # m
    turn: Float[Array, " 3"]  # rad
    velocity: Float[Array, " 3"]  # m/s
    joint: Float[Array, "6 3"]  # rad
    load: Float[Array, " 6"]  # N


class Sensors(NamedTuple):
    """A rollout's biases and the true observations before this one, newest first."""

    bias: Biases
    free_bias: Float[Array, "k 4 3"]  # of position, orientation, velocity and turning
    past: Observation  # leaves (delay_buffer, ...), at least one


def biases(noise: Noise, key: Array) -> Biases:
    """Draw those of one rollout."""
    keys = jax.random.split(key, 4)
    shapes = ((3,), (3,), (3,), (6, 3))
    sizes = (noise.position_bias, noise.orientation_bias, noise.velocity_bias, noise.joint_bias)
    draws = zip(keys, sizes, shapes, strict=True)
    position, turn, velocity, joint = (size * jax.random.normal(k, shape, float) for k, size, shape in draws)
    offsets = [[getattr(noise, f"{what}_offset_{axis}") for axis in "xyz"] for what in ("position", "orientation")]
    shift, tilt = (jnp.stack([jnp.asarray(x, float) for x in three]) for three in offsets)
    load = noise.load_bias * jax.random.normal(jax.random.fold_in(key, LOAD), (6,), float)
    return Biases(position + shift, turn + tilt, velocity, joint, load)


def free_biases(noise: Noise, key: Array, free: FreeState) -> Float[Array, "k 4 3"]:
    """Those of the free bodies' position, orientation, velocity and turning."""
    sizes = (noise.body_position_bias, noise.body_orientation_bias, noise.body_velocity_bias, noise.body_turn_bias)
    return _scatter(jax.random.fold_in(key, FREE), sizes, free)


def install(noise: Noise, key: Array, truth: Observation) -> Sensors:
    """The biases that `key` draws; before the rollout's start everything was as `truth`."""
    past = jax.tree.map(lambda x: jnp.broadcast_to(x, (max(noise.delay_buffer, 1), *x.shape)), truth)
    return Sensors(biases(noise, key), free_biases(noise, key, truth.free), past)


def observe(noise: Noise, sensors: Sensors, truth: Observation, key: Array) -> tuple[Sensors, Observation]:
    """Delayed, biased and noisy view of `truth`; joint errors act in the drives and are not delayed."""
    past = jax.tree.map(lambda new, old: jnp.concatenate([new[None], old[:-1]]), truth, sensors.past)

    def delayed(delay: Array | float, new: Any, old: Any) -> Any:
        late = jnp.clip(jnp.round(delay).astype(jnp.int32), 0, noise.delay_buffer)
        return jax.tree.map(lambda now, before: jnp.where(late == 0, now, before[jnp.maximum(late - 1, 0)]), new, old)

    seen = delayed(noise.delay, truth, sensors.past)
    free = delayed(noise.body_delay, truth.free, sensors.past.free)
    load = delayed(noise.delay + noise.load_delay, truth.load, sensors.past.load) + sensors.bias.load
    sizes = (noise.body_position_noise, noise.body_orientation_noise, noise.body_velocity_noise, noise.body_turn_noise)
    error = sensors.free_bias + _scatter(jax.random.fold_in(key, FREE), sizes, free)
    dtype = truth.position.dtype
    draw = jax.random.normal(key, (33,), dtype)
    rates = jax.random.normal(jax.random.fold_in(key, RATES), (21,), dtype)
    joint_error = sensors.bias.joint + noise.joint_noise * draw[9:27].reshape(6, 3)
    turn = sensors.bias.turn + noise.orientation_noise * draw[3:6]
    seen = seen._replace(
        position=seen.position + sensors.bias.position + noise.position_noise * draw[:3],
        quat=multiply(exponential(turn), seen.quat),
        velocity=seen.velocity + sensors.bias.velocity + noise.velocity_noise * draw[6:9],
        spin=seen.spin + noise.spin_noise * rates[:3],
        angles=seen.angles + joint_error,
        rates=seen.rates + noise.joint_rate_noise * rates[3:].reshape(6, 3),
        joint_error=joint_error,
        load=load + noise.load_noise * draw[27:],
        free=FreeState(
            free.position + error[:, 0],
            multiply(exponential(error[:, 1]), free.quat),
            free.velocity + error[:, 2],
            free.turn + error[:, 3],
        ),
    )
    return sensors._replace(past=past), seen


def weighed(control: Control, noise: Noise, seen: Observation) -> Observation:
    """`seen`, and which feet carry load by what is measured: for sure, where `noise` is believed, and perhaps."""
    doubt = DOUBT * jnp.sqrt(jnp.square(noise.load_noise) + jnp.square(noise.load_bias))
    perhaps = seen.load > control.load_threshold
    return seen._replace(loaded=seen.load > control.load_threshold + doubt, perhaps=perhaps)


def behind(noise: Noise, period: float) -> Array | float:
    """By how much later (s) loads are seen than places."""
    return noise.load_delay * period


def untold(noise: Noise, period: float) -> Array | float:
    """For how long (s) a foot stands before its load is known."""
    return (noise.delay + noise.load_delay) * period


def _scatter(key: Array, sizes: tuple[Array | float, ...], free: FreeState) -> Float[Array, "k 4 3"]:
    """Errors of the free bodies of the given deviations; the key is one that nothing of the robot draws from."""
    return jnp.stack(sizes)[:, None] * jax.random.normal(key, (*free.position.shape[:1], 4, 3), free.position.dtype)


class Observer(NamedTuple):
    """Two filters in a row: after one alone, feet that stand on a body would still change speed at every tick."""

    first: FreeState
    second: FreeState


def followed(observer: Observer, seen: FreeState, time: Array | float, period: float) -> Observer:
    """The poses a control tick of `period` (s) on: complementary filters.

    They go on with the measured velocities and are drawn to the measured poses, each with half of the time constant
    `time` (s), so that steady motion is followed without lag. With 0 s they are the measured ones.
    """
    first = _drawn(observer.first, seen, time / 2, period)
    return Observer(first, _drawn(observer.second, first, time / 2, period))


def _drawn(estimate: FreeState, to: FreeState, time: Array | float, period: float) -> FreeState:
    share = period / jnp.maximum(time, period)
    position = estimate.position + period * to.velocity
    quat = multiply(exponential(period * to.turn), estimate.quat)
    off = logarithm(multiply(to.quat, conjugate(quat)))
    quat = multiply(exponential(share * off), quat)
    # rounded products of thousands of ticks lose their length, and with it the feet that stand on the body their place
    quat = quat / jnp.linalg.norm(quat, axis=-1, keepdims=True)
    return to._replace(position=position + share * (to.position - position), quat=quat)

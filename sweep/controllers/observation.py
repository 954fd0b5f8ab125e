"""Sensor model: measurements of the controller from the true state, with bias, noise and delay.

Also holds the filter that smooths the measured poses of an obstacle's free bodies (balls, rafts, ladders).
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Bool, Float

from sweep.core.rotations import conjugate, exponential, logarithm, multiply
from sweep.models.noise import Noise
from sweep.models.obstacles.surface import FreeBodyState

FREE, LOAD, RATES = 1, 2, 3  # folded into a rollout's key to draw the errors of free bodies, of foot loads and of rates


class Observation(NamedTuple):
    """Measured state of the robot and of the obstacle's free bodies in one control tick, world axes.

    Made by `observe`; the engines also make one without errors from the true state.
    """

    position: Float[Array, " 3"]  # m, of the base
    quat: Float[Array, " 4"]  # base to world
    velocity: Float[Array, " 3"]  # m/s, of the base
    spin: Float[Array, " 3"]  # rad/s, angular velocity of the base, base axes
    angles: Float[Array, "6 3"]  # rad, joint angles
    rates: Float[Array, "6 3"]  # rad/s, joint rates
    joint_error: Float[Array, "6 3"]  # rad, measured minus true joint angle; acts on the feedback of the drives
    loaded: Bool[Array, " 6"]  # feet that surely carry load
    free: FreeBodyState
    load: Float[Array, " 6"] | float = np.inf  # N, measured load on each foot, along the surface normal
    maybe_loaded: Bool[Array, " 6"] | None = None  # feet that may carry load; None: same as `loaded`


class SensorBiases(NamedTuple):
    """Constant sensor errors of one rollout in world axes, drawn by `draw_sensor_biases`."""

    position: Float[Array, " 3"]  # m
    turn: Float[Array, " 3"]  # rad, rotation vector
    velocity: Float[Array, " 3"]  # m/s
    joint: Float[Array, "6 3"]  # rad
    load: Float[Array, " 6"]  # N, of each foot


class SensorState(NamedTuple):
    """State of the sensors in a rollout: constant errors, and the true observations of past ticks in a ring buffer.

    Made by `init_sensors`.
    """

    bias: SensorBiases | None  # None where sensors are late, but without errors
    free_bias: (
        Float[Array, "k 4 3"] | None
    )  # bias of each free body's position, orientation, velocity, angular velocity
    history: Observation | None  # leaves (delay_buffer, ...): tick k is at k % delay_buffer; None without a delay


def draw_sensor_biases(noise: Noise, key: Array) -> SensorBiases:
    """Draw the constant errors of all sensors of the robot for one rollout.

    Args:
        noise: standard deviations of the biases, and fixed offsets that are added.
        key: random key of the rollout.

    Returns:
        Biases in world axes.
    """
    keys = jax.random.split(key, 4)
    shapes = ((3,), (3,), (3,), (6, 3))
    sizes = (noise.position_bias, noise.orientation_bias, noise.velocity_bias, noise.joint_bias)
    draws = zip(keys, sizes, shapes, strict=True)
    position, turn, velocity, joint = (size * jax.random.normal(k, shape, float) for k, size, shape in draws)
    offsets = [[getattr(noise, f"{kind}_offset_{axis}") for axis in "xyz"] for kind in ("position", "orientation")]
    shift, tilt = (jnp.stack([jnp.asarray(x, float) for x in three]) for three in offsets)
    load = noise.load_bias * jax.random.normal(jax.random.fold_in(key, LOAD), (6,), float)
    return SensorBiases(position + shift, turn + tilt, velocity, joint, load)


def draw_free_body_biases(noise: Noise, key: Array, free: FreeBodyState) -> Float[Array, "k 4 3"]:
    """Draw the constant errors of the measured poses and velocities of free bodies for one rollout.

    Args:
        noise: standard deviations of the biases.
        key: random key of the rollout.
        free: state of the k free bodies; only their number and precision matter.

    Returns:
        Errors of position (m), orientation (rad, rotation vector), velocity (m/s) and angular velocity (rad/s) of each
        body, (k, 4, 3), world axes.
    """
    sizes = (noise.body_position_bias, noise.body_orientation_bias, noise.body_velocity_bias, noise.body_turn_bias)
    return _draw_body_errors(jax.random.fold_in(key, FREE), sizes, free)


def init_sensors(noise: Noise, key: Array, truth: Observation, has_errors: bool = True) -> SensorState:
    """Return the sensors' state at the start: drawn biases, and a history filled with the state at the start.

    Args:
        noise: sensor errors and the length of the delay buffer, which is at least the longest delay in ticks.
        key: random key of the rollout.
        truth: true state at the start; the state before the start is taken to be the same.
        has_errors: whether any error is drawn or given; else the sensors only have delays.

    Returns:
        The sensors for the first tick.
    """
    history = None
    if noise.delay_buffer:
        history = jax.tree.map(lambda x: jnp.broadcast_to(x, (noise.delay_buffer, *x.shape)), truth)
    if not has_errors:
        return SensorState(None, None, history)
    return SensorState(draw_sensor_biases(noise, key), draw_free_body_biases(noise, key, truth.free), history)


def observe(
    noise: Noise, sensors: SensorState, truth: Observation, key: Array, tick: Array | int
) -> tuple[SensorState, Observation]:
    """Return the sensor measurement of a true state, with delay, bias and noise.

    Joint errors act on the feedback of the drives in the same tick, hence they are not delayed.

    Args:
        noise: sensor errors; delays are in control ticks.
        sensors: biases and history of the rollout.
        truth: true state in this tick.
        key: random key of the tick.
        tick: number of the tick, from 0 on; the same for all rollouts of a batch.

    Returns:
        The sensors with `truth` added to the history, and the measurement. Its `loaded` is the delayed true contact;
        the closed loop detects contact by the measured load.
    """
    history, number, size = sensors.history, jnp.asarray(tick, jnp.int32), jnp.int32(noise.delay_buffer)

    def delayed(delay: Array | float, select: Callable[[Observation], Any]) -> Any:
        if history is None:
            return select(truth)
        late = jnp.clip(jnp.round(delay).astype(jnp.int32), 0, size)
        slot = lax.rem(number + size - late, size)
        return jax.tree.map(
            lambda newest, earlier: jnp.where(late == 0, newest, earlier[slot]), select(truth), select(history)
        )

    obs = delayed(noise.delay, lambda observation: observation)
    free = delayed(noise.body_delay, lambda observation: observation.free)
    load = delayed(noise.delay + noise.load_delay, lambda observation: observation.load)
    if history is not None:
        slot = lax.rem(number, size)
        history = jax.tree.map(lambda new, old: lax.dynamic_update_index_in_dim(old, new, slot, 0), truth, history)
    sensors = sensors._replace(history=history)
    if sensors.bias is None or sensors.free_bias is None:
        return sensors, obs._replace(joint_error=jnp.zeros_like(obs.joint_error), load=load, free=free)
    load = load + sensors.bias.load
    sizes = (noise.body_position_noise, noise.body_orientation_noise, noise.body_velocity_noise, noise.body_turn_noise)
    error = sensors.free_bias + _draw_body_errors(jax.random.fold_in(key, FREE), sizes, free)
    dtype = truth.position.dtype
    draw = jax.random.normal(key, (33,), dtype)
    rates = jax.random.normal(jax.random.fold_in(key, RATES), (21,), dtype)
    joint_error = sensors.bias.joint + noise.joint_noise * draw[9:27].reshape(6, 3)
    turn = sensors.bias.turn + noise.orientation_noise * draw[3:6]
    obs = obs._replace(
        position=obs.position + sensors.bias.position + noise.position_noise * draw[:3],
        quat=multiply(exponential(turn), obs.quat),
        velocity=obs.velocity + sensors.bias.velocity + noise.velocity_noise * draw[6:9],
        spin=obs.spin + noise.spin_noise * rates[:3],
        angles=obs.angles + joint_error,
        rates=obs.rates + noise.joint_rate_noise * rates[3:].reshape(6, 3),
        joint_error=joint_error,
        load=load + noise.load_noise * draw[27:],
        free=FreeBodyState(
            free.position + error[:, 0],
            multiply(exponential(error[:, 1]), free.quat),
            free.velocity + error[:, 2],
            free.turn + error[:, 3],
        ),
    )
    return sensors, obs


def foot_load_delay_s(noise: Noise, period: float) -> Array | float:
    """Return the delay (s) of measured foot loads relative to measured positions.

    Args:
        noise: believed sensor errors, with delays in control ticks.
        period: control period (s).
    """
    return noise.load_delay * period


def touchdown_detection_delay_s(noise: Noise, period: float) -> Array | float:
    """Return the time (s) from a touchdown until the measured load can show it.

    Args:
        noise: believed sensor errors, with delays in control ticks.
        period: control period (s).
    """
    return (noise.delay + noise.load_delay) * period


def _draw_body_errors(key: Array, sizes: tuple[Array | float, ...], free: FreeBodyState) -> Float[Array, "k 4 3"]:
    """Normal errors of each free body, from a stream of random numbers that no error of the robot uses."""
    return jnp.stack(sizes)[:, None] * jax.random.normal(key, (*free.position.shape[:1], 4, 3), free.position.dtype)


class FreeBodyFilterState(NamedTuple):
    """State of the filter for measured poses of free bodies: two complementary filters in series.

    With a single filter, feet that stand on a body would still get a jump in velocity at every tick. Made by the
    tracker for manoeuvres on free bodies.
    """

    first: FreeBodyState
    second: FreeBodyState


def update_free_body_filter(
    observer: FreeBodyFilterState, measured: FreeBodyState, time_constant: Array | float, period: float
) -> FreeBodyFilterState:
    """Advance the filter for measured poses of free bodies by one control tick.

    Each of the two complementary filters integrates the measured velocities and is corrected towards the pose before it
    with half of the time constant. Steady motion is therefore followed without lag.

    Args:
        observer: state of the filter.
        measured: measured state of the free bodies, world axes.
        time_constant: of both filters together (s); 0 passes the measurement through.
        period: control period (s).

    Returns:
        The new state; its `second` is the filtered pose with the measured velocities.
    """
    first = _filter_step(observer.first, measured, time_constant / 2, period)
    return FreeBodyFilterState(first, _filter_step(observer.second, first, time_constant / 2, period))


def _filter_step(
    estimate: FreeBodyState, measured: FreeBodyState, time_constant: Array | float, period: float
) -> FreeBodyState:
    share = period / jnp.maximum(time_constant, period)
    position = estimate.position + period * measured.velocity
    quat = multiply(exponential(period * measured.turn), estimate.quat)
    error = logarithm(multiply(measured.quat, conjugate(quat)))
    quat = multiply(exponential(share * error), quat)
    # Normalise: rounding over thousands of ticks would change the length, and shift feet that stand on the body.
    quat = quat / jnp.linalg.norm(quat, axis=-1, keepdims=True)
    return measured._replace(position=position + share * (measured.position - position), quat=quat)

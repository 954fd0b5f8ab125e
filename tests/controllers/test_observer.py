"""The observer of free bodies: exact at 0 s, without lag in steady motion, and quiet under noise."""

import jax
import jax.numpy as jnp
import numpy as np

from sweep.controllers.observation import FreeBodyFilterState, update_free_body_filter
from sweep.core.rotations import conjugate, exponential, logarithm, multiply
from sweep.models.obstacles.surface import FreeBodyState

PERIOD, TIME = 0.004, 0.1  # s
SPEED, TURN = jnp.array([[0.1, -0.2, 0.0]]), jnp.array([[0.0, 0.15, 0.1]])  # m/s, rad/s


def rolling(k: jax.Array | int) -> FreeBodyState:
    """A body in steady motion at tick k."""
    return FreeBodyState(SPEED * PERIOD * k, exponential(TURN * PERIOD * k), jnp.asarray(SPEED), jnp.asarray(TURN))


@jax.jit
def errors(start: FreeBodyFilterState, shaken: jax.Array) -> jax.Array:
    """Of observed place (m) and attitude (rad), one row per tick, the attitude seen wrongly by `shaken` (rad)."""

    def tick(observer: FreeBodyFilterState, now: tuple) -> tuple[FreeBodyFilterState, jax.Array]:
        k, shake = now
        true = rolling(k)
        observer = update_free_body_filter(
            observer, true._replace(quat=multiply(exponential(shake), true.quat)), TIME, PERIOD
        )
        turn = logarithm(multiply(observer.second.quat, conjugate(true.quat)))
        return observer, jnp.concatenate([observer.second.position - true.position, turn], axis=-1)[0]

    return jax.lax.scan(tick, start, (jnp.arange(len(shaken)), shaken[:, None]))[1]


def test_no_time_takes_the_measured_poses():
    seen = update_free_body_filter(FreeBodyFilterState(rolling(0), rolling(0)), rolling(50), 0.0, PERIOD).second
    np.testing.assert_allclose(seen.position, rolling(50).position, atol=1e-6)
    np.testing.assert_allclose(seen.quat, rolling(50).quat, atol=1e-6)


def test_steady_motion_is_followed_without_lag():
    """A wrong start is forgotten; a plain low-pass would stay behind by speed times time, 20 mm and 15 mrad."""
    off = errors(FreeBodyFilterState(rolling(100), rolling(100)), jnp.zeros((300, 3)))
    assert np.abs(off[0]).max() > 0.05
    np.testing.assert_allclose(off[-1], 0, atol=1e-5)


def test_noise_of_the_attitude_is_quietened():
    """Two filters of share a in a row, b = 1 - a, leave a (1 + b^2)/(1 + b)^3 of the variance of white noise.

    From tick to tick 2 a^3/(1 + b)^3 of it. 2000 ticks of three axes tell the deviations within 10 %.
    """
    size, share = 0.01, 2 * PERIOD / TIME
    shaken = size * np.random.default_rng(0).normal(size=(2200, 3))
    off, keep = (
        np.asarray(errors(FreeBodyFilterState(rolling(0), rolling(0)), jnp.asarray(shaken)))[200:, 3:],
        1 - share,
    )
    expected = share * (1 + keep**2) / (1 + keep) ** 3, 2 * share**3 / (1 + keep) ** 3
    measured = off.std(), np.diff(off, axis=0).std()
    np.testing.assert_allclose(measured, size * np.sqrt(expected), rtol=0.1)


def test_rounding_does_not_turn_into_stretching():
    """After two minutes of single precision the axes of a trembling body have unit length.

    Without it they are longer by 4e-5, and feet 1 m from the body's centre are held 0.1 mm off: a force of 10 N.
    """
    leans = np.random.default_rng(0).uniform(1.25, 1.36, 64)
    quat, still = exponential(jnp.asarray(leans)[:, None] * jnp.array([-1.0, 0.0, 0.0])), jnp.zeros((64, 3))
    rest = FreeBodyState(still, quat, still, still)
    shaken = jnp.asarray(1e-4 * np.random.default_rng(1).normal(size=(30_000, 64, 3)))  # rad/s

    def tick(observer: FreeBodyFilterState, turn: jax.Array) -> tuple[FreeBodyFilterState, None]:
        return update_free_body_filter(observer, rest._replace(turn=turn), TIME, PERIOD), None

    seen = jax.jit(lambda start: jax.lax.scan(tick, start, shaken)[0])(FreeBodyFilterState(rest, rest)).second
    assert seen.quat.dtype == jnp.float32
    np.testing.assert_allclose(np.linalg.norm(np.asarray(seen.quat, float), axis=-1), 1, atol=5e-7)

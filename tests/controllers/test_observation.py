"""Measurement errors: none when off, constant biases, fresh noise at every tick, and a delay of whole ticks."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from sweep.controllers.observation import Observation, init_sensors, observe
from sweep.core.rotations import exponential, multiply
from sweep.engines.closed_loop import required_sensing_mode
from sweep.fused.trace import ArrayLayout, trace_program
from sweep.models.noise import Noise
from sweep.models.obstacles.surface import FreeBodyState

KEY = jax.random.key(3)
FREE = FreeBodyState(jnp.zeros((1, 3)), jnp.array([[1.0, 0, 0, 0]]), jnp.zeros((1, 3)), jnp.zeros((1, 3)))


def truth(x: float) -> Observation:
    level, still, joints = jnp.array([1.0, 0, 0, 0]), jnp.zeros(3), jnp.zeros((6, 3))
    return Observation(jnp.full(3, float(x)), level, jnp.full(3, -float(x)), still, joints, joints, joints,
                       jnp.arange(6) < x, FREE, jnp.full(6, float(x)))  # fmt: skip


def watch(noise: Noise, key=KEY, ticks: int = 8) -> list[Observation]:
    """What is seen of a truth that counts the ticks, from 1 on."""
    sensors, seen = init_sensors(noise, key, truth(0)), []
    for k in range(1, ticks + 1):
        sensors, one = observe(noise, sensors, truth(k), jax.random.fold_in(key, k), k - 1)
        seen.append(one)
    return seen


def test_off_means_exact():
    assert required_sensing_mode(Noise()) == "exact"
    for k, seen in enumerate(watch(Noise()), start=1):
        for a, b in zip(jax.tree.leaves(seen), jax.tree.leaves(truth(k)), strict=True):
            np.testing.assert_allclose(a, b, atol=1e-9)


@pytest.mark.parametrize("delay", [0, 1, 3])
def test_delay_counts_ticks(delay):
    """Before anything else was seen, the start was; joint errors act in the drives and are not delayed."""
    noise = Noise(delay=float(delay), delay_buffer=4, joint_bias=0.1)
    assert required_sensing_mode(noise) == "noisy"
    seen = watch(noise)
    np.testing.assert_allclose([float(s.position[0]) for s in seen], np.maximum(np.arange(1, 9) - delay, 0))
    assert [int(s.loaded.sum()) for s in seen] == list(np.clip(np.arange(1, 9) - delay, 0, 6))
    assert np.all(np.asarray(seen[0].joint_error) != 0)


def test_late_sensors_without_errors_need_no_random_numbers():
    """What is measured is the same as by sensors whose errors are zero."""
    noise = Noise(delay=2.0, load_delay=1.0, body_delay=3.0, delay_buffer=3)
    assert required_sensing_mode(noise) == "late"
    assert required_sensing_mode(dataclasses.replace(noise, load_bias=np.zeros(3))) == "noisy"
    late, zero = (init_sensors(noise, KEY, truth(0), has_errors) for has_errors in (False, True))
    for k in range(1, 9):
        late, one = observe(noise, late, truth(k), KEY, k - 1)
        zero, other = observe(noise, zero, truth(k), KEY, k - 1)
        jax.tree.map(np.testing.assert_array_equal, one, other)


def test_an_offset_is_a_constant_error_that_is_given():
    noise = Noise(position_offset_y=0.02, orientation_offset_z=0.1, position_bias=0.0)
    assert required_sensing_mode(noise) == "noisy"
    for k, seen in enumerate(watch(noise), start=1):
        np.testing.assert_allclose(seen.position - truth(k).position, [0, 0.02, 0], atol=1e-6)
        turned = multiply(exponential(jnp.array([0.0, 0.0, 0.1])), truth(k).quat)
        np.testing.assert_allclose(seen.quat, turned, atol=1e-6)


def test_a_longer_buffer_changes_nothing():
    one, other = (watch(Noise(delay=2.0, delay_buffer=n, position_noise=0.01)) for n in (2, 5))
    for a, b in zip(one, other, strict=True):
        assert np.array_equal(a.position, b.position)


def test_the_longest_delay_that_may_be_asked_for_can_be_fused():
    noise = Noise(delay=50.0, load_delay=50.0, delay_buffer=100)

    def tick(given, sensors, number):
        sensors, seen = observe(dataclasses.replace(noise, delay=given[0]), sensors, truth(2), given[1], number)
        return sensors, {"load": jnp.asarray(seen.load)}

    one, sensors = jax.eval_shape(lambda: ((jnp.zeros(()), KEY), init_sensors(noise, KEY, truth(0))))

    def somewhere(arrays, _):
        return [ArrayLayout(0, x.shape, np.dtype(x.dtype).name) for x in arrays], 0

    trace_program(tick, one, sensors, somewhere, share_memory=False, group=6)  # else it raises `Unsupported`


def test_biases_stay_and_noise_does_not():
    biased = np.array([s.position - k for k, s in enumerate(watch(Noise(position_bias=0.5)), start=1)])
    assert np.all(np.abs(biased[0]) > 0)
    np.testing.assert_allclose(biased, np.broadcast_to(biased[0], biased.shape), atol=1e-6)
    noisy = np.array([s.velocity + k for k, s in enumerate(watch(Noise(velocity_noise=0.5)), start=1)])
    assert len(np.unique(noisy)) == noisy.size
    load = np.array([s.load - k for k, s in enumerate(watch(Noise(load_bias=3.0)), start=1)])
    np.testing.assert_allclose(load, np.broadcast_to(load[0], load.shape), atol=1e-5)
    assert 1 < np.std(load[0]) < 6


@pytest.mark.parametrize(
    ("field", "of"),
    [
        ("position", lambda s: s.position),
        ("velocity", lambda s: s.velocity),
        ("joint", lambda s: s.joint_error),
        ("orientation", lambda s: 2 * s.quat[1:]),
        ("spin", lambda s: s.spin),
        ("joint_rate", lambda s: s.rates),
        ("load", lambda s: s.load),
        ("body_position", lambda s: s.free.position),
        ("body_orientation", lambda s: 2 * s.free.quat[:, 1:]),
        ("body_velocity", lambda s: s.free.velocity),
        ("body_turn", lambda s: s.free.turn),
    ],
)
def test_noise_has_the_given_deviation(field, of):
    """400 ticks: the deviation of 1200 normal numbers, or more, is within 8 % of the true one, 4 standard errors."""
    noise = dataclasses.replace(Noise(), **{f"{field}_noise": 0.02})
    sensors = init_sensors(noise, KEY, truth(0))
    draw = jax.jit(jax.vmap(lambda k: of(observe(noise, sensors, truth(0), jax.random.fold_in(KEY, k), k)[1])))
    assert np.std(draw(jnp.arange(400))) == pytest.approx(0.02, rel=0.08)


def test_another_key_sees_otherwise():
    noise = Noise(position_noise=0.01, position_bias=0.01)
    a, b, c = (watch(noise, jax.random.key(k), 1)[0].position for k in (1, 1, 2))
    assert np.array_equal(a, b)
    assert not np.array_equal(a, c)


def test_the_robot_its_feet_and_the_bodies_have_delays_of_their_own():
    def late(k):
        return truth(k)._replace(free=FREE._replace(position=jnp.full((1, 3), float(k))))

    noise = Noise(delay=1.0, load_delay=2.0, body_delay=4.0, delay_buffer=4)
    sensors = init_sensors(noise, KEY, late(0))
    for k in range(1, 9):
        sensors, seen = observe(noise, sensors, late(k), KEY, k - 1)
        assert float(seen.position[0]) == pytest.approx(max(k - 1, 0))
        assert float(seen.free.position[0, 0]) == pytest.approx(max(k - 4, 0))
        np.testing.assert_allclose(seen.load, max(k - 3, 0))

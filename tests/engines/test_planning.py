"""Starts with a search for forces, taken apart, against the same by XLA alone."""

from concurrent.futures import ThreadPoolExecutor

import jax
import jax.numpy as jnp
import numpy as np

from sweep.controllers import forces
from sweep.engines import devices, planning
from sweep.engines.planning import Planning

FEET = jnp.array([[-0.5, 0.5], [0.0, 0.5], [0.5, 0.5], [-0.5, -0.5], [0.0, -0.5], [0.5, -0.5]])


def start(world, belief, key):
    """Forces of a robot between walls, its mass centre off the middle; the rest is of its key."""
    draw = jax.random.uniform(key)
    arm = jnp.concatenate([FEET + 0.05 * draw, jnp.full((6, 1), -belief)], axis=1)
    normal = jnp.concatenate([jnp.zeros((6, 1)), -jnp.sign(FEET[:, 1:]), jnp.zeros((6, 1))], axis=1)
    stands, zero = jnp.arange(6) != 1, jnp.zeros((6, 3))
    pose = forces.StaticPose(arm, normal, stands, jnp.broadcast_to(0.1 * jnp.eye(3), (6, 3, 3)), zero, jnp.array(600.0))
    found = forces.distribute(pose, forces.Bounds(world, 60.0, 5.0, 1e3), "friction")
    return found, {"draw": draw, "lowest": jnp.min(arm) * found.imbalance, "bound": world}


def many(one, more):
    return jax.vmap(one, in_axes=(0, None, *[0] * (1 + more)))


def test_forces_are_those_that_xla_finds():
    """To what single precision leaves of a search for a centre: 3e-3 of the largest force."""
    n = 37  # rollouts, no whole number of lanes
    arrays = jnp.linspace(0.02, 0.6, n), jnp.array(0.4), jax.random.split(jax.random.key(3), n)
    whole, rest = jax.jit(many(start, 0))(*arrays)
    begin = planning.lowered(start, arrays, many, searches=True, by_host=True)
    with ThreadPoolExecutor() as pool:
        apart, others = Planning.of(*begin.compiled(pool)())(*arrays)
    assert jax.tree.map(jnp.shape, (apart, others)) == jax.tree.map(lambda x: x.shape, begin.out_info)
    held = np.asarray(whole.imbalance) < 0.01
    assert 5 < held.sum() < n - 5  # too little friction, and enough
    np.testing.assert_array_equal(np.asarray(apart.imbalance) < 0.01, held)
    np.testing.assert_allclose(apart.force[held], whole.force[held], atol=3e-3 * float(jnp.abs(whole.force).max()))
    np.testing.assert_array_equal(others["draw"], rest["draw"])
    np.testing.assert_allclose(others["lowest"][held], rest["lowest"][held], atol=2e-3)
    np.testing.assert_array_equal(others["bound"], arrays[0])


def test_one_search_for_all_rollouts_is_left_to_xla():
    arrays = jnp.linspace(0.02, 0.6, 3), jnp.array(0.4), jax.random.split(jax.random.key(3), 3)

    def shared(world, belief, key):
        return start(0.5, belief, jax.random.key(0)), world + jax.random.uniform(key)

    assert planning.lowered(start, arrays, many, searches=True, by_host=True).search is not None
    assert planning.lowered(shared, arrays, many, searches=True, by_host=True).search is None


def test_some_rollouts_at_a_time_are_all_of_them(monkeypatch):
    monkeypatch.setattr(devices, "PLANNED", 8)

    def begun(world, belief, key, bodies):
        return {"base": jnp.sin(world * belief) + jnp.arange(3.0), "draw": jax.random.normal(key), "bodies": bodies}

    keys, bodies = jax.random.split(jax.random.key(0), 24), jnp.zeros((24, 0, 7))
    arrays = jnp.float32(2.0), jnp.arange(24.0), keys, bodies
    many = jax.vmap(begun, (None, 0, 0, 0))(*arrays)
    jax.tree.map(np.testing.assert_array_equal, jax.jit(devices.in_turns(begun, 24))(*arrays), many)

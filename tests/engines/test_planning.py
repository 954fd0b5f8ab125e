"""Starts with a search for forces, its search by this package's compiler, against the same by XLA alone."""

from concurrent.futures import ThreadPoolExecutor
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np

from sweep.backends import devices
from sweep.engines import planning
from sweep.engines.planning import CompiledPlanning
from sweep.planning import forces

FEET = jnp.array([[-0.5, 0.5], [0.0, 0.5], [0.5, 0.5], [-0.5, -0.5], [0.0, -0.5], [0.5, -0.5]])


def start(world, belief, key):
    """Forces of a robot between walls, its mass centre off the middle; the rest is of its key."""
    draw = jax.random.uniform(key)
    arm = jnp.concatenate([FEET + 0.05 * draw, jnp.full((6, 1), -belief)], axis=1)
    normal = jnp.concatenate([jnp.zeros((6, 1)), -jnp.sign(FEET[:, 1:]), jnp.zeros((6, 1))], axis=1)
    stands, zero = jnp.arange(6) != 1, jnp.zeros((6, 3))
    pose = forces.ForcePlanningPose(
        arm, normal, stands, jnp.broadcast_to(0.1 * jnp.eye(3), (6, 3, 3)), zero, jnp.array(600.0)
    )
    bounds = forces.ForceBounds(*(jnp.asarray(bound, float) for bound in forces.ForceBounds(world, 60.0, 5.0, 1e3)))
    sought = jax.tree.map(lambda x: x[None], forces.ForceProblem(pose, bounds))
    found = forces.evaluate_forces(pose, forces.make_force_search("friction")(sought)[0])
    return found, {"draw": draw, "lowest": jnp.min(arm) * found.imbalance, "bound": world}


def many(one):
    return jax.vmap(one, in_axes=(0, None, 0))


def begun(arrays):
    """What a batch starts with where all is the host's."""
    with ThreadPoolExecutor() as pool:
        form, parts = planning.start_compilation(pool, start, arrays, many, has_forces=True, use_numpy=True)
        return form, CompiledPlanning.from_programs(*parts())


def test_forces_are_those_that_xla_finds():
    """To what single precision leaves of a search for a centre: 3e-3 of the largest force."""
    n = 37  # rollouts, no whole number of lanes
    arrays = jnp.linspace(0.02, 0.6, n), jnp.array(0.4), jax.random.split(jax.random.key(3), n)
    whole, rest = jax.jit(many(start))(*arrays)
    form, begin = begun(arrays)
    apart, others = begin(*arrays)
    assert jax.tree.map(jnp.shape, (apart, others)) == jax.tree.map(lambda x: x.shape, form)
    held = np.asarray(whole.imbalance) < 0.01
    assert 5 < held.sum() < n - 5  # too little friction, and enough
    np.testing.assert_array_equal(np.asarray(apart.imbalance) < 0.01, held)
    np.testing.assert_allclose(apart.force[held], whole.force[held], atol=3e-3 * float(jnp.abs(whole.force).max()))
    np.testing.assert_array_equal(others["draw"], rest["draw"])
    np.testing.assert_allclose(others["lowest"][held], rest["lowest"][held], atol=2e-3)
    np.testing.assert_array_equal(others["bound"], arrays[0])


def test_one_search_is_made_for_all_rollouts_of_the_same_pose():
    """The bound alone differs, and forces do; where nothing differs, they are searched for once."""
    key = jax.random.key(3)
    arrays = jnp.full(3, 0.5), jnp.array(0.4), jnp.stack([key] * 3)
    _, begin = begun(arrays)
    (search,) = begin.searches.values()
    searched, enter = [], search.load_batch
    search.load_batch = lambda given, carried, width: searched.append(width) or enter(given, carried, width)
    several = begin(*arrays)[0].force
    external = {name: partial(planning._search_forces, search) for name in begin.searches}
    once = begin.program(1, np.float32(0.5), np.float32(0.4), key, external=external)
    assert searched == [3, 1]
    np.testing.assert_array_equal(several, np.repeat(once[0].force, 3, axis=0))


def test_some_rollouts_at_a_time_are_all_of_them(monkeypatch):
    monkeypatch.setattr(devices, "PLANNING_WIDTH", 8)

    def of_one(world, belief, key, bodies):
        return {"base": jnp.sin(world * belief) + jnp.arange(3.0), "draw": jax.random.normal(key), "bodies": bodies}

    keys, bodies = jax.random.split(jax.random.key(0), 24), jnp.zeros((24, 0, 7))
    arrays = jnp.float32(2.0), jnp.arange(24.0), keys, bodies
    many = jax.vmap(of_one, (None, 0, 0, 0))(*arrays)
    jax.tree.map(np.testing.assert_array_equal, jax.jit(devices.vmap_in_chunks(of_one, 24))(*arrays), many)

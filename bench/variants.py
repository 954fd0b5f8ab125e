"""Model variants made per second: `leaves` of a batch against MJX's `put_model` one by one.

To run: `python bench/variants.py`.

Lengths, masses and radius of the links and friction vary.
"""

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import jax
import numpy as np
from mujoco import mjx

from sweep.backends import devices
from sweep.cli.commands.bench import measure_wall_time
from sweep.config.experiment import compose
from sweep.dynamics import interface as dynamics
from sweep.dynamics import mjx as mjx_dynamics
from sweep.engines import batching
from sweep.models.case import Case
from sweep.models.scene import compile_model

BATCH, ONE_BY_ONE = 65536, 40


def variants(nominal: Case, count: int) -> Case:
    """Return `count` cases with each size within 20 % of its nominal value."""
    robot, u = nominal.robot, np.random.default_rng(0).uniform
    names = ("body_length", "body_width", "body_mass", "thigh", "shin", "thigh_mass", "shin_mass", "link_radius")
    sizes = {name: getattr(robot, name) * u(0.8, 1.2, count) for name in names}
    return replace(nominal, robot=replace(robot, **sizes), contact=replace(nominal.contact, friction=u(0.2, 1, count)))


def seconds(work: Callable[[], object]) -> float:
    """Return the shortest of three runs (s)."""
    return min(measure_wall_time(lambda: jax.block_until_ready(work())) for _ in range(3))


def main() -> None:
    """Print both."""
    devices.configure_jax()
    nominal = compose(["robot=base"]).case
    top, batch = dynamics.build_model_topology(nominal), variants(nominal, BATCH)
    model = mjx.put_model(top.model)
    make = jax.jit(
        jax.vmap(partial(mjx_dynamics.parameter_dependent_fields, top, model), in_axes=(devices.vmap_in_axes(batch),))
    )
    arrays = devices.to_jax_arrays(batch)
    rate = BATCH / seconds(lambda: make(arrays))
    several = [batching.rollout_parameters(batch, k) for k in range(ONE_BY_ONE)]
    single = ONE_BY_ONE / seconds(lambda: [mjx.put_model(compile_model(case, geoms=False)) for case in several])
    print(f"leaves: {rate:,.0f} variants/s\nput_model: {single:,.0f} variants/s")


if __name__ == "__main__":
    main()

"""What free bodies did, of ways that are given."""

from types import SimpleNamespace
from typing import Any, cast

import jax.numpy as jnp
import pytest

from sweep.metrics import free_bodies
from sweep.models.obstacles.surface import FreeBodyState

DRIVE = SimpleNamespace(drives_body=True, obstacle_speed=lambda duration: 0.1, lateral_offset=lambda way: abs(way[1]))
WORLD = SimpleNamespace(manoeuvre=DRIVE)


def moment(time: float, stage: int, phase: float, duration: list[float]) -> Any:
    """A ball that goes along x at 0.1 m/s, in a stage of a plan."""
    still = jnp.zeros((1, 3))
    free = FreeBodyState(still.at[0, 0].set(0.1 * time), jnp.array([[1.0, 0.0, 0.0, 0.0]]), still, still)
    tick = SimpleNamespace(actual=SimpleNamespace(free=free, position=jnp.zeros(3)))
    plan = SimpleNamespace(duration=jnp.array(duration))
    ended = jnp.asarray(False)
    now = {"stage": stage, "phase": phase, "plan": plan, "time": time, "period": 0.01, "finished": ended}
    return SimpleNamespace(report=tick, world=WORLD, **now)


def test_the_final_speed_of_what_is_driven_is_told_although_a_stage_ends_before_its_time():
    duration = [100.0, 14.0]
    found = free_bodies.begin(cast(Any, moment(0.0, 0, 0.0, duration).report.actual))
    for stage, time in ((0, 1.0), *((1, 1.0 + k) for k in range(15))):
        found = free_bodies.update(found, moment(time, stage, (time - 1) / 14, duration))
    at = SimpleNamespace(world=WORLD, time=15.0, plan=SimpleNamespace(duration=jnp.array(duration)))
    assert free_bodies.compute(found, cast(Any, at))["obstacle_speed_mps"] == pytest.approx(0.1, rel=0.01)

"""How balls meet, of ways that are given."""

from types import SimpleNamespace
from typing import Any, cast

import jax.numpy as jnp
import pytest

from sweep.metrics import two_balls
from sweep.models.obstacles.surface import FreeBodyState
from sweep.models.obstacles.two_balls import TwoBalls

DURATION = [10.0, 20.0]
WORLD = TwoBalls(gap=0.5)


def moment(time: float) -> Any:
    """The first ball goes at 0.1 m/s to the second and rests there; that goes on at 0.02 m/s then."""
    speed, way = (0.1, 0.1 * time) if time < 5.05 else (0.0, 0.5)
    leaves = 0.02 * max(0.0, time - 10)
    still, start = jnp.zeros((2, 3)), WORLD.start()
    place = start.position.at[:, 0].add(jnp.array([way, leaves]))
    free = FreeBodyState(place, start.quat, still.at[0, 0].set(speed), still)
    stage = int(time >= DURATION[0])
    phase = (time - DURATION[0] * stage) / DURATION[stage]
    plan = SimpleNamespace(laws=("roll", "over"), duration=jnp.array(DURATION))
    tick = SimpleNamespace(actual=SimpleNamespace(free=free))
    world = SimpleNamespace(obstacle=WORLD)
    when = SimpleNamespace(stage=stage, phase=phase, time=time, period=0.1, finished=jnp.asarray(time > 29))
    return SimpleNamespace(report=tick, plan=plan, world=world, **vars(when))


def test_their_meeting_their_parting_and_the_end_of_the_second_are_told():
    found = two_balls.begin(cast(Any, moment(0.0).report.actual))
    for k in range(301):
        found = two_balls.update(found, moment(0.1 * k))
    told = two_balls.compute(found, cast(Any, SimpleNamespace(time=30.0)))
    assert told["meeting_speed_mps"] == pytest.approx(0.1, rel=0.01)
    assert told["balls_apart_max_m"] == pytest.approx(0.4, abs=1e-4)
    assert told["second_ball_x_m"] == pytest.approx(2 * WORLD.radius + 0.5 + 0.4, abs=1e-4)
    assert told["second_ball_speed_mps"] == pytest.approx(0.02, rel=0.01)

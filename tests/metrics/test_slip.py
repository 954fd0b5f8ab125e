"""Slip is counted from where feet really are."""

from types import SimpleNamespace

import jax.numpy as jnp
import numpy as np
import pytest

from sweep.metrics import slip
from sweep.metrics.tick import RolloutStart
from sweep.models.obstacles.ball import Ball
from sweep.models.obstacles.plane import Plane
from sweep.models.obstacles.surface import body_poses, empty_free_body_state, surface_at

WORLD = SimpleNamespace(obstacle=Plane())
FEET = np.array([[0.3 * leg, 0.2, 0.0] for leg in range(6)])


def rollout(ticks, world=WORLD, free=empty_free_body_state):
    """Largest slip of ticks of (feet, loaded, legs that swing, phase), free bodies being as in `free()`."""
    start = RolloutStart(world, None, jnp.zeros(3), jnp.array([1.0, 0, 0, 0]), jnp.asarray(FEET), free(), jnp.zeros(()))
    state = slip.METRIC.begin(start)
    for feet, loaded, swing, phase in ticks:
        truth = SimpleNamespace(loaded=jnp.asarray(loaded))
        tick = SimpleNamespace(joints=jnp.asarray(feet)[:, None], actual=truth, bodies=body_poses(free()))
        plan = SimpleNamespace(swing=jnp.asarray(swing)[None])
        now = SimpleNamespace(world=world, plan=plan, stage=0, finished=jnp.asarray(False), phase=phase, report=tick)
        state = slip.METRIC.update(state, now)
    return float(state.largest_slip)


ALL, NONE = np.ones(6, bool), np.zeros(6, bool)
FIRST = np.arange(6) == 0


def test_a_foot_that_stands_elsewhere_than_planned_does_not_slip():
    aside = FEET + np.array([0.05, 0.0, 0.0])  # as where legs are longer than believed
    assert rollout([(aside, NONE, NONE, 0.0), (aside, ALL, NONE, 0.1)]) == 0


def test_a_standing_foot_slips_from_where_it_took_hold_also_when_it_chatters():
    aside = FEET + 0.03 * FIRST[:, None] * np.array([1.0, 0, 0])
    moved = [(FEET, ALL, NONE, 0.0), (FEET + (aside - FEET) / 2, ~FIRST, NONE, 0.1), (aside, ALL, NONE, 0.2)]
    assert rollout(moved) == pytest.approx(0.03, abs=1e-6)


def test_a_swing_takes_hold_where_it_lands():
    landed = FEET + 0.2 * FIRST[:, None] * np.array([1.0, 0, 0])
    swing = [(FEET, ALL, NONE, 0.0), (landed, ~FIRST, FIRST, 0.4), (landed, ALL, FIRST, 0.9), (landed, ALL, NONE, 0.1)]
    assert rollout(swing) == 0
    on = landed + 0.01 * FIRST[:, None] * np.array([0, 1.0, 0])
    assert rollout([*swing, (on, ALL, NONE, 0.2)]) == pytest.approx(0.01, abs=1e-6)


def test_a_foot_that_passes_from_a_ball_to_the_floor_has_gone_as_far_as_it_did():
    """In the wedge between both, which is nearer tells nothing of how far the foot went."""
    ball = Ball()
    feet = [np.where(FIRST[:, None], [0.2, 0.0, height], FEET + np.array([5.0, 0, 0])) for height in (0.023, 0.005)]
    assert [int(surface_at(ball, jnp.asarray(each), body_poses(ball.start())).body[0]) for each in feet] == [0, -1]
    passes = [(each, FIRST, NONE, 0.5) for each in feet]
    assert rollout(passes, SimpleNamespace(obstacle=ball), ball.start) == pytest.approx(0.018, abs=1e-6)

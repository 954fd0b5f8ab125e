"""What a stage has left of its patience goes over into how far off its feet hang."""

from types import SimpleNamespace

import jax.numpy as jnp
import numpy as np
import pytest

from sweep.metrics import landing
from sweep.metrics.tick import RolloutStart
from sweep.models.obstacles.plane import Plane
from sweep.models.obstacles.surface import body_poses, empty_free_body_state

WORLD = SimpleNamespace(obstacle=Plane())
FEET = np.array([[0.3 * leg, 0.2, 0.0] for leg in range(6)])
ALL, FIRST = np.ones(6, bool), np.arange(6) == 0
PERIOD, PATIENCE = 0.01, 0.5
# the first leg swings for a second, then all stand, then it swings for half a second
PLAN = SimpleNamespace(
    duration=jnp.array([1.0, 0.2, 0.5, 1.0]),
    swing=jnp.asarray([FIRST, ~ALL, FIRST, ~ALL]),
    patience=jnp.asarray(PATIENCE),
)


def reserve(*stages):
    """Of stages of (how long they take, how high the first foot is at the end of each and whether it is loaded)."""
    zero = jnp.zeros(())
    start = RolloutStart(
        WORLD, None, jnp.zeros(3), jnp.array([1.0, 0, 0, 0]), jnp.asarray(FEET), empty_free_body_state(), zero
    )
    state, time = landing.METRIC.begin(start), 0
    for number, (takes, height, lands) in enumerate(stages):
        feet = FEET + height * FIRST[:, None] * np.array([0, 0, 1.0])
        loaded = ALL if lands else ~FIRST
        truth = SimpleNamespace(loaded=jnp.asarray(loaded))
        tick = SimpleNamespace(
            joints=jnp.asarray(feet)[:, None], actual=truth, bodies=body_poses(empty_free_body_state())
        )
        for _ in range(round(takes / PERIOD)):
            time += 1
            now = SimpleNamespace(world=WORLD, plan=PLAN, stage=jnp.int32(number), finished=jnp.asarray(False),
                                  report=tick, time=time * PERIOD, period=PERIOD)  # fmt: skip
            state = landing.update(state, now)
    return float(landing.METRIC.compute(state, None)["landing_reserve_min"])


STANDS = (0.2, 0.0, True)


@pytest.mark.parametrize(
    ("swing", "left"),
    [
        ((1.0, 0.0, True), 1.0),
        ((1.2, 0.0, True), 0.6),
        ((1.0 + PATIENCE, 0.0, True), 0.0),
        ((1.0 + PATIENCE, 1e-5, False), -5e-4),
        ((1.0 + PATIENCE, 5e-3, False), -0.25),
    ],
)
def test_patience_goes_over_into_how_far_off_a_foot_hangs(swing, left):
    assert reserve(swing, STANDS) == pytest.approx(left, abs=1e-4)


def test_the_worst_landing_counts_and_a_foot_may_hang_that_is_to_stand():
    hangs = (0.2, 0.1, False)  # as the fourth foot of a table may
    assert reserve((1.1, 0.0, True), hangs, (0.5, 0.0, True), STANDS) == pytest.approx(0.8, abs=1e-4)
    assert reserve((1.1, 0.0, True), STANDS, (0.8, 0.0, True), STANDS) == pytest.approx(0.4, abs=1e-4)

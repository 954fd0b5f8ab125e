"""Sizes of GPU kernels beside those stored: speed that a metric or a change of the compiler costs is seen here."""

import jax.numpy as jnp
import kernel_counts
import pytest

from sweep import metrics
from sweep.core.metric import Metric

RENEW = "\nIf that is meant, renew the counts and say why in the commit: make kernels"
DEFAULT = "walk_tripod"


@pytest.mark.parametrize(
    "name",
    [
        pytest.param(x, marks=[] if x in (DEFAULT, *kernel_counts.MODELS) else pytest.mark.slow)
        for x in (*kernel_counts.SCENARIOS, *kernel_counts.MODELS)
    ],
)
def test_kernels_are_as_large_as_stored(name):
    changed = kernel_counts.changed_counts(name, kernel_counts.scenario_counts(name))
    assert not changed, "\n".join(changed) + RENEW


def test_a_metric_that_carries_where_all_joints_were_exceeds_the_stored_counts(monkeypatch):
    naive = Metric(
        lambda start: (jnp.zeros((6, 3, 3)), jnp.zeros(())),
        lambda state, ctx: (
            ctx.report.joints,
            jnp.maximum(state[1], jnp.max(jnp.linalg.norm(ctx.report.joints - state[0], axis=-1))),
        ),
        lambda state, rollout: {"joint_step_max_m": state[1]},
        {"joint_step_max_m": "farthest that a joint went in a tick"},
    )
    monkeypatch.setattr(metrics, "METRICS", (*metrics.METRICS, naive))
    counts = kernel_counts.text_counts(*kernel_counts.kernel_printer(DEFAULT))
    changed = kernel_counts.changed_counts(DEFAULT, counts)
    assert {line.split()[1] for line in changed} >= {"loads", "stores", "carried"}, changed

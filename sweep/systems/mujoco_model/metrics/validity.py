"""Validity of a rollout: its numbers stay finite, and no buffer of the engine is full."""

import numpy as np

from sweep.core.metric import EVERY_COLUMN, Cause, Metric, array_namespace, make_begin_with_constants
from sweep.systems.mujoco_model.tick import Array, ModelRollout, ModelTick


def update(state: Array, ctx: ModelTick) -> Array:
    """Update whether all positions and velocities have been finite in all physics steps."""
    total = ctx.steps["qpos"].sum(axis=(1, 2)) + ctx.steps["qvel"].sum(axis=(1, 2))
    return state & array_namespace(total).isfinite(total)


def compute(state: Array, rollout: ModelRollout) -> dict[str, Array]:
    """Return by column 1 where a rollout is invalid: a number was not finite or a MuJoCo buffer was full."""
    finite = state & np.isfinite(np.stack([*rollout.columns.values()])).all(axis=0) & ~rollout.is_not_finite
    return {"not_finite": (~finite).astype(float), "buffer_full": rollout.is_buffer_full.astype(float)}


def _invalid(name: str, sentence: str) -> Cause:
    return Cause(name, sentence, name, 0.0, key="", known_at="end", invalid=True)


METRIC = Metric(
    make_begin_with_constants(lambda finite: finite, True),
    update,
    compute,
    {
        "not_finite": "1 where a number was not finite",
        "buffer_full": "1 where MuJoCo's buffer for contacts or constraints was full",
    },
    causes=(
        _invalid("not_finite", "a number of the simulation or controller was not finite"),
        _invalid("buffer_full", "MuJoCo's buffer for contacts or constraints was full"),
    ),
    reads=(EVERY_COLUMN,),
)

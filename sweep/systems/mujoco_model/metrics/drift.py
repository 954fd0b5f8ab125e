"""Lateral drift of the base from the commanded direction."""

from sweep.core.metric import make_end_metric
from sweep.systems.mujoco_model.tick import Array, ModelRollout


def compute(state: tuple[()], rollout: ModelRollout) -> dict[str, Array]:
    """Return how far the base moved to the left of the commanded direction (m), by column."""
    way = (rollout.end_qpos - rollout.start_qpos)[:, rollout.parts.base_position]
    return {"drift_m": way @ rollout.parts.left}


METRIC = make_end_metric(compute, {"drift_m": "way of the base to the left of `direction`"}, needs=("base",))

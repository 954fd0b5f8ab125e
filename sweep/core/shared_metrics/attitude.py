"""Tilt of the base: the largest and the final angle between its upward axis and the vertical."""

from typing import Any, NamedTuple

from sweep.core.metric import Array, CommonRollout, CommonStart, CommonTick, Metric, array_namespace


class TiltState(NamedTuple):
    """State of the tilt metric: largest tilt so far (deg), and the last orientation of the base."""

    largest_tilt: Array
    quat: Array


def begin(start: CommonStart) -> TiltState:
    """Return the initial state: no tilt yet."""
    return TiltState(start.constant_state(0.0), start.base_quat)


def update(state: TiltState, ctx: CommonTick) -> TiltState:
    """Update the largest tilt (deg) and the base's last orientation."""
    tilt = ctx.tilt_deg
    return TiltState(array_namespace(tilt).maximum(state.largest_tilt, tilt), ctx.base_quat[..., -1, :])


def tilt_deg(quat: Array, xp: Any) -> Array:
    """Return the angles (...) in degrees between body z axis and vertical.

    Args:
        quat: Unit quaternions (4, ...): their components first.
        xp: NumPy or jax.numpy, which computes them.

    Returns:
        Angles in deg.
    """
    w, x, y, z = quat
    return xp.degrees(xp.arctan2(xp.sqrt(x**2 + y**2 + 1e-14), xp.sqrt(w**2 + z**2 + 1e-14)) * 2)


def compute(state: TiltState, rollout: CommonRollout) -> dict[str, Array]:
    """Return the largest and the final tilt (deg), by column."""
    xp = array_namespace(state.quat)
    return {"tilt_max_deg": state.largest_tilt, "end_tilt_deg": tilt_deg(xp.moveaxis(state.quat, -1, 0), xp)}


METRIC = Metric(
    begin,
    update,
    compute,
    {
        "tilt_max_deg": "largest tilt of the base from its commanded vertical, or from that of the start where "
        "nothing commands one",
        "end_tilt_deg": "tilt of the base from the vertical at the end",
    },
    needs=("base",),
)

"""Contact forces as arrows, the same in the MCAP file and in the pictures."""

import numpy as np

FORCE_SCALE = 5e-3  # m of arrow per N
FORCE_SHOWN = 0.5  # N, smaller forces have no arrow
ARROW_RADIUS = 0.02  # m, more than a link's, or a leg would hide its force
FORCE_COLOR = (0.90, 0.62, 0.0)  # red, green, blue


def arrow_tips(position: np.ndarray, force: np.ndarray, longest: float = np.inf) -> np.ndarray:
    """Tips (..., 3), m, of the arrows that start at `position` (..., 3); small forces have them at the start.

    Where the largest force would have an arrow of more than `longest` m, all are shorter in proportion.
    """
    size = np.linalg.norm(force, axis=-1, keepdims=True)
    scale = min(FORCE_SCALE, longest / max(float(np.nanmax(size, initial=0.0)), 1e-9))
    return position + scale * np.where(size > FORCE_SHOWN, force, 0.0)

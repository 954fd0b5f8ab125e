"""Contact forces as arrows, the same in the MCAP file and in the pictures."""

import numpy as np

FORCE_SCALE = 5e-3  # m of arrow per N
FORCE_SHOWN = 0.5  # N, smaller forces have no arrow
ARROW_RADIUS = 0.02  # m, more than a link's, or a leg would hide its force
FORCE_COLOR = (0.90, 0.62, 0.0)  # red, green, blue


def arrow_tips(position: np.ndarray, force: np.ndarray) -> np.ndarray:
    """Tips (..., 3), m, of the arrows that start at `position` (..., 3); small forces have them at the start."""
    shown = np.linalg.norm(force, axis=-1, keepdims=True) > FORCE_SHOWN
    return position + FORCE_SCALE * np.where(shown, force, 0.0)

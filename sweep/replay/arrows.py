"""Size and colour of contact-force arrows, shared by MCAP files and rendered pictures."""

import numpy as np

FORCE_SCALE = 5e-3  # m of arrow per N
FORCE_SHOWN = 0.5  # N, smaller forces have no arrow
ARROW_RADIUS = 0.02  # m, more than a link's, or a leg would hide its force
FORCE_COLOR = (0.90, 0.62, 0.0)  # red, green, blue


def arrow_tips(position: np.ndarray, force: np.ndarray, longest: float = np.inf) -> np.ndarray:
    """Return the end points of arrows that show forces, in m.

    Args:
        position: Starts of the arrows (..., 3), m.
        force: Forces (..., 3), N.
        longest: Length (m) that the longest arrow may have; if it is longer, all are scaled down.

    Returns:
        Tips (..., 3), m; equal to the start for forces below `FORCE_SHOWN`.
    """
    size = np.linalg.norm(force, axis=-1, keepdims=True)
    scale = min(FORCE_SCALE, longest / max(float(np.nanmax(size, initial=0.0)), 1e-9))
    return position + scale * np.where(size > FORCE_SHOWN, force, 0.0)

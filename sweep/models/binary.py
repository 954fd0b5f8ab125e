"""Compiled MuJoCo models as bytes."""

import mujoco
import numpy as np


def model_bytes(model: mujoco.MjModel) -> bytes:
    """All that is in a compiled model, as MuJoCo's MJB file has it."""
    content = np.zeros(mujoco.mj_sizeModel(model), np.uint8)
    mujoco.mj_saveModel(model, None, content)
    return content.tobytes()

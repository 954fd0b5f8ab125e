"""Compiled MuJoCo models as bytes."""

import mujoco
import numpy as np


def model_bytes(model: mujoco.MjModel) -> bytes:
    """Serialize a compiled model in MuJoCo's MJB format."""
    content = np.zeros(mujoco.mj_sizeModel(model), np.uint8)
    mujoco.mj_saveModel(model, None, content)
    return content.tobytes()

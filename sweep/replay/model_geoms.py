"""Names, motion and colours of bodies and geoms of a MuJoCo model, shared by all pictures."""

import mujoco
import numpy as np

VISIBLE_GROUPS = 3  # MuJoCo's viewers draw the groups 0-2


def body_name(model: mujoco.MjModel, body: int) -> str:
    """Return the name of a body, which is also the name of its frame in Foxglove."""
    return mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_BODY, body) or f"body_{body}"


def moving_body_ids(model: mujoco.MjModel) -> np.ndarray:
    """Return the ids of the bodies that can move in the world."""
    return np.flatnonzero(model.body_weldid != 0)


def geom_color(model: mujoco.MjModel, geom: int) -> tuple[float, ...]:
    """Return red, green, blue and opacity of a geom, from 0 to 1; a texture counts as its mean colour."""
    material = int(model.geom_matid[geom])
    return tuple((model.geom_rgba[geom] if material < 0 else _material_rgba(model, material)).tolist())


def _material_rgba(model: mujoco.MjModel, material: int) -> np.ndarray:
    rgba = model.mat_rgba[material].astype(float)
    texture = int(model.mat_texid[material, mujoco.mjtTextureRole.mjTEXROLE_RGB])
    if texture >= 0:
        channels, start = int(model.tex_nchannel[texture]), int(model.tex_adr[texture])
        pixels = int(model.tex_height[texture]) * int(model.tex_width[texture])
        colors = model.tex_data[start : start + channels * pixels].reshape(pixels, channels)
        rgba[:3] *= colors[:, :3].mean(axis=0) / 255
    return rgba

"""Drawing of trace frames by MuJoCo in a separate process: `python -m sweep.replay.draw JOB` writes raw RGB to stdout.

The OpenGL library is chosen when `mujoco` is imported, and importing it with a missing one fails, so the process that
draws must not be the one that simulates. It imports nothing that imports `mujoco`.
"""

import sys
from pathlib import Path
from typing import Any

import numpy as np

from sweep.replay.arrows import ARROW_RADIUS, FORCE_COLOR

NO_OPENGL = 3  # exit status: this OpenGL library does not work here
MODEL_FILE, ARRAYS_FILE = "model.mjb", "frames.npz"  # files in the folder JOB
ARROW_RGBA = np.array([*FORCE_COLOR, 1.0], np.float32)


def draw_job_folder(job: Path) -> int:
    """Draw the frames described in the folder `job` (a model and arrays); return the exit status."""
    try:
        import mujoco

        mujoco.GLContext(16, 16).make_current()
    except Exception as error:  # mujoco passes on all exceptions of its OpenGL wrapper
        print(f"{type(error).__name__}: {error}", file=sys.stderr)
        return NO_OPENGL
    model = mujoco.MjModel.from_binary_path(str(job / MODEL_FILE))
    with np.load(job / ARRAYS_FILE) as arrays:
        draw_frames(model, dict(arrays))
    return 0


def draw_frames(model: Any, arrays: dict[str, np.ndarray]) -> None:
    """Draw frames and write each to stdout as bytes of shape (height, width, 3).

    Shadows are left out: they flicker, and take more time than all the rest.

    Args:
        model: The MuJoCo model.
        arrays: `qpos` (N, nq); `look_at` (N, 3), m; `distance` () of the camera, m; `azimuth` and `elevation` (), deg;
            `size` (2,), width and height in pixels; `tails` and `tips` (N, 6, 3) of the force arrows, m, where arrows
            of zero length are not drawn; `samples` () per pixel.
    """
    import mujoco

    width, height = map(int, arrays["size"])
    model.vis.global_.offwidth, model.vis.global_.offheight = width, height
    model.vis.quality.offsamples = int(arrays["samples"])
    data, camera = mujoco.MjData(model), mujoco.MjvCamera()
    camera.distance, camera.azimuth, camera.elevation = (
        float(arrays[key]) for key in ("distance", "azimuth", "elevation")
    )
    with mujoco.Renderer(model, height, width) as renderer:
        for k, qpos in enumerate(arrays["qpos"]):
            data.qpos[:] = qpos
            mujoco.mj_kinematics(model, data)
            mujoco.mj_comPos(model, data)
            mujoco.mj_camlight(model, data)
            camera.lookat[:] = arrays["look_at"][k]
            renderer.update_scene(data, camera)
            renderer.scene.flags[mujoco.mjtRndFlag.mjRND_SHADOW] = 0
            for tail, tip in zip(arrays["tails"][k], arrays["tips"][k], strict=True):
                if np.any(tail != tip):
                    _add_arrow(renderer.scene, tail, tip)
            sys.stdout.buffer.write(renderer.render().tobytes())


def _add_arrow(scene: Any, tail: np.ndarray, tip: np.ndarray) -> None:
    import mujoco

    geom = scene.geoms[scene.ngeom]
    mujoco.mjv_initGeom(geom, mujoco.mjtGeom.mjGEOM_ARROW, np.zeros(3), np.zeros(3), np.zeros(9), ARROW_RGBA)
    # MuJoCo draws an arrow half as long as its connector
    mujoco.mjv_connector(geom, mujoco.mjtGeom.mjGEOM_ARROW, ARROW_RADIUS, tail, 2 * tip - tail)
    scene.ngeom += 1


if __name__ == "__main__":
    sys.exit(draw_job_folder(Path(sys.argv[1])))

"""A trace in MuJoCo's own viewer."""

import os
import sys
import time

from sweep.core.errors import InputError
from sweep.engines.base import Trace
from sweep.trace.sampling import finite_frames

HOLD = 1.0  # s, before it begins again


def screen() -> bool:
    """Whether there is one to show things on."""
    return sys.platform != "linux" or bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))


def check() -> None:
    """Raise `InputError` where there is no screen to show it on."""
    if not screen():
        raise InputError("--mujoco needs a screen: DISPLAY is not set. Without it the page shows the same")


def play(trace: Trace) -> None:
    """Play the trace again and again until the window is closed."""
    import mujoco.viewer

    data, frames = mujoco.MjData(trace.model), finite_frames(trace)
    with mujoco.viewer.launch_passive(trace.model, data) as window:
        while window.is_running():
            start = time.perf_counter()
            for k in range(frames):
                if not window.is_running():
                    return
                data.qpos[:], data.time = trace.qpos[k], trace.time[k]
                mujoco.mj_forward(trace.model, data)
                window.sync()
                time.sleep(max(0.0, trace.time[k] - (time.perf_counter() - start)))
            time.sleep(HOLD)

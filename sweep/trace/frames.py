"""Pictures of a trace: PNG frames and MP4, drawn by MuJoCo without a screen."""

import importlib.util
import itertools
import os
import subprocess
import sys
import tempfile
from collections.abc import Callable, Generator
from contextlib import suppress
from functools import partial
from pathlib import Path

import mujoco
import numpy as np
from matplotlib.image import imsave
from PIL import Image, ImageDraw, ImageFont

from sweep.core.files import write_atomically
from sweep.core.parameters import InputError
from sweep.core.spacing import evenly_spaced_indices
from sweep.engines.base import Trace
from sweep.trace.arrows import arrow_tips
from sweep.trace.contact_forces import surfaces
from sweep.trace.draw import ARRAYS, MODEL, NO_OPENGL
from sweep.trace.sampling import at_rate, base_pose, finite_frames

SIZE = (960, 544)  # pixels, multiples of 16 as video codecs want
SMALL = (424, 240)  # of a frame of a strip
IN_A_ROW = 4  # frames of a strip, which should be full rows
STILL = 4  # samples of a pixel of a picture that is looked at
VIDEO_RATE = 25  # frames per second, simulated and shown
CAMERA_DISTANCE = 1.7  # in units of the distance between the robot's farthest feet at the start, at least
AROUND = 2.0  # the same in units of a model's extent, where no feet are known
FIELD = np.tan(np.radians(22.5)) * np.array([SIZE[0] / SIZE[1], 1.0])  # half of MuJoCo's 45 deg, over the distance
LONGEST_ARROW = 1.6  # m
FILLED = 0.9  # of half the picture's width and height, by the feet at most
AZIMUTHS = (125.0, -125.0, 55.0, -55.0)  # deg, of the camera's sight, in order of preference
ELEVATION = -22.0  # deg
LIBRARIES = {"egl": "libegl1 libegl-mesa0 libgl1-mesa-dri", "osmesa": "libosmesa6"}  # Debian packages


def write_png(folder: str | Path, trace: Trace, outcome: str = "", number: int = 8) -> list[Path]:
    """Write `number` frames, evenly spaced over the trace, named by their time; raises `InputError` without OpenGL.

    Time and stage stand on each, and what came of it all.
    """
    folder, chosen = Path(folder), evenly_spaced_indices(finite_frames(trace), number)
    folder.mkdir(parents=True, exist_ok=True)
    paths = [folder / f"t{trace.time[k]:07.3f}s.png" for k in chosen]
    for path, picture, k in zip(paths, render(trace, chosen), chosen, strict=True):
        write_atomically(path, partial(imsave, arr=captioned(picture, caption(trace, k, outcome))))
    return paths


def caption(trace: Trace, k: int, outcome: str = "", title: str = "") -> str:
    """What it is of, time, stage and outcome of the frame `k`, in a line."""
    stage = trace.stages[trace.stage[k]] if 0 <= trace.stage[k] < len(trace.stages) else ""
    return "   ".join(part for part in (title, f"{trace.time[k]:.2f} s", stage, outcome) if part)


def known(trace: Trace, k: int, outcome: str) -> str:
    """The outcome from its cause on, or in the last frame where it has none; empty before."""
    cause = float(trace.metrics.get("t_cause_s", np.nan))
    return outcome if trace.time[k] >= (trace.time[-1] if np.isnan(cause) else cause) else ""


def captioned(picture: np.ndarray, text: str) -> np.ndarray:
    """The picture with a line of text at its lower left."""
    image = Image.fromarray(picture)
    pen, size = ImageDraw.Draw(image), max(12, image.height // 22)
    font, place = ImageFont.load_default(size), (size // 2, image.height - size // 2)
    pen.text(place, text, "white", font, anchor="ls", stroke_width=max(1, size // 10), stroke_fill="black")
    return np.asarray(image)


def write_strip(path: str | Path, trace: Trace, chosen: np.ndarray, outcome: str = "") -> None:
    """Write the frames with the indices `chosen` side by side, at most `IN_A_ROW` in a row; raises as `render` does."""
    small = [
        captioned(np.asarray(Image.fromarray(picture).resize(SMALL)), caption(trace, k, outcome))
        for picture, k in zip(render(trace, chosen), chosen, strict=True)
    ]
    rows = [np.concatenate(row, axis=1) for row in itertools.batched(small, IN_A_ROW)]
    write_atomically(Path(path), partial(Image.fromarray(np.concatenate(rows)).quantize(128).save, optimize=True))


def write_video(
    path: str | Path,
    trace: Trace,
    title: str = "",
    outcome: str = "",
    progress: Callable[[int, int], None] = lambda done, of: None,
) -> None:
    """Write an MP4 in real time; raises `InputError` without OpenGL or without the `video` extra.

    `title` says what it is of; time and stage stand beside it, and from the time of the cause on what came of it.
    `progress` is told how many pictures of how many are drawn.
    """
    need_ffmpeg()
    write_atomically(Path(path), partial(_write_video, trace=trace, title=title, outcome=outcome, progress=progress))


def _write_video(path: Path, trace: Trace, title: str, outcome: str, progress: Callable[[int, int], None]) -> None:
    import imageio_ffmpeg

    # imageio_ffmpeg's own writer forks, which may hang a process that runs JAX
    raw = ["-f", "rawvideo", "-pix_fmt", "rgb24", "-s", f"{SIZE[0]}x{SIZE[1]}", "-r", str(VIDEO_RATE), "-i", "-"]
    encoded = ["-c:v", "libx264", "-crf", "20", "-pix_fmt", "yuv420p", "-movflags", "+faststart", str(path)]
    command = [imageio_ffmpeg.get_ffmpeg_exe(), "-y", "-loglevel", "error", *raw, *encoded]
    chosen = at_rate(trace, VIDEO_RATE)
    pictures = render(trace, chosen, samples=0)
    first = next(pictures)  # before there is a file, so that a failure to draw leaves none
    # of a pipe that breaks ffmpeg says why, and it ends
    with suppress(BrokenPipeError), subprocess.Popen(command, stdin=subprocess.PIPE) as process:
        assert process.stdin is not None
        for done, (k, picture) in enumerate(zip(chosen, itertools.chain([first], pictures), strict=True), start=1):
            process.stdin.write(captioned(picture, caption(trace, k, known(trace, k, outcome), title)).tobytes())
            progress(done, len(chosen))
    if process.returncode:
        raise OSError(f"ffmpeg ends with {process.returncode}")


def need_ffmpeg() -> None:
    """Raise `InputError` where the `video` extra is not installed."""
    if importlib.util.find_spec("imageio_ffmpeg") is None:
        raise InputError("a video needs ffmpeg: pip install 'insect-sweep[video]'")


def render(trace: Trace, chosen: np.ndarray, samples: int = STILL) -> Generator[np.ndarray, None, None]:
    """Pictures (height, width, 3), uint8, of the frames with the indices `chosen`, one after the other.

    A pixel is the mean of `samples`; 0 takes half the time. The camera follows the base; contact forces are drawn as
    arrows. Raises `InputError` where neither EGL nor OSMesa works.
    """
    with tempfile.TemporaryDirectory() as job:
        _write_job(Path(job), trace, chosen, samples)
        for backend in LIBRARIES:
            if (yield from _pictures(job, backend)):
                return
    packages = " or ".join(f"`{names}`" for names in LIBRARIES.values())
    raise InputError(f"pictures need OpenGL without a screen: install the Debian packages {packages}")


def _write_job(job: Path, trace: Trace, chosen: np.ndarray, samples: int) -> None:
    azimuth = min(AZIMUTHS, key=partial(_hidden, trace, chosen))
    mujoco.mj_saveModel(trace.model, str(job / MODEL), None)
    np.savez(
        job / ARRAYS,
        qpos=trace.qpos[chosen],
        look_at=_looked_at(trace, chosen),
        distance=_distance(trace, chosen, azimuth),
        azimuth=azimuth,
        elevation=ELEVATION,
        size=SIZE,
        samples=samples,
        tails=trace.foot_position[chosen],
        tips=_tips(trace, chosen),
    )


def _tips(trace: Trace, chosen: np.ndarray) -> np.ndarray:
    """Tips (N, 6, 3) of the arrows at the feet (m)."""
    return arrow_tips(trace.foot_position[chosen], trace.foot_force[chosen], LONGEST_ARROW)


def _looked_at(trace: Trace, chosen: np.ndarray) -> np.ndarray:
    """What is in the middle of the pictures (m), (N, 3): half of the mean way from the base to its feet."""
    base = base_pose(trace)[chosen, :3]
    if not trace.foot_position.shape[1]:
        return base
    return base + 0.5 * np.mean(trace.foot_position[chosen] - base[:, None], axis=(0, 1))


def _sight(azimuth: float) -> np.ndarray:
    """Axes (3, 3) of a camera that looks that way: right, up, and from what it looks at towards itself."""
    angle, slope = np.radians(azimuth), np.radians(ELEVATION)
    away = -np.array([np.cos(angle) * np.cos(slope), np.sin(angle) * np.cos(slope), np.sin(slope)])
    right = np.array([np.sin(angle), -np.cos(angle), 0.0])
    return np.stack([right, np.cross(away, right), away])


def _distance(trace: Trace, chosen: np.ndarray, azimuth: float) -> float:
    """From which all feet of the frames `chosen`, and the arrows at them, are in the picture (m).

    Where none are known, all of the model as it is at its start.
    """
    if not trace.foot_position.shape[1]:
        return AROUND * float(trace.model.stat.extent)
    start, ends = trace.foot_position[0], np.concatenate([trace.foot_position[chosen], _tips(trace, chosen)], axis=1)
    offset = ends - _looked_at(trace, chosen)[:, None]
    across, towards = offset @ _sight(azimuth)[:2].T, offset @ _sight(azimuth)[2]
    needed = towards + np.max(np.abs(across) / (FILLED * FIELD), axis=-1)
    return max(CAMERA_DISTANCE * np.linalg.norm(start[:, None] - start, axis=-1).max(), needed.max())


def _hidden(trace: Trace, chosen: np.ndarray, azimuth: float) -> int:
    """How many of some points between the camera, and base and feet, the obstacle hides, over the frames `chosen`."""
    if not trace.foot_position.shape[1]:  # nor is an obstacle
        return 0
    way = _distance(trace, chosen, azimuth) * np.linspace(0.2, 1, 9)[:, None] * _sight(azimuth)[2]
    seen = np.concatenate([base_pose(trace)[chosen, None, :3], trace.foot_position[chosen]], axis=1)
    points = (seen[:, :, None] + way).reshape(len(chosen), -1, 3)
    return int(np.sum(np.asarray(surfaces(trace, points, chosen).depth) > 0))


def _pictures(job: str, backend: str) -> Generator[np.ndarray, None, bool]:
    """Pictures as the drawing process makes them; returns whether this OpenGL library works at all."""
    width, height = SIZE
    command = [sys.executable, "-m", "sweep.trace.draw", job]
    environment = {**os.environ, "MUJOCO_GL": backend}
    with tempfile.TemporaryFile("w+") as errors:
        with subprocess.Popen(command, env=environment, stdout=subprocess.PIPE, stderr=errors) as process:
            assert process.stdout is not None
            drawn, length = 0, width * height * 3
            while len(pixels := process.stdout.read(length)) == length:
                yield np.frombuffer(pixels, np.uint8).reshape(height, width, 3)
                drawn += 1
        if process.returncode == 0:
            return True
        if drawn == 0 and (process.returncode == NO_OPENGL or process.returncode < 0):
            return False
        errors.seek(0)
        raise RuntimeError(f"drawing failed: {errors.read().strip()[-500:]}")

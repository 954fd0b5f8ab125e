"""Offscreen rendering of traces with MuJoCo: PNG pictures and MP4 videos."""

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

from sweep.contract.engine import Trace
from sweep.contract.trace_frames import base_pose, count_finite_frames, frames_at_rate
from sweep.core.files import write_atomically
from sweep.core.parameters import InputError
from sweep.core.spacing import evenly_spaced_indices
from sweep.replay.arrows import arrow_tips
from sweep.replay.draw import ARRAYS_FILE, MODEL_FILE, NO_OPENGL

PICTURE_SIZE = (960, 544)  # pixels; video codecs need multiples of 16
STRIP_PICTURE_SIZE = (424, 240)  # pixels of a picture in a strip
PICTURES_PER_ROW = 4  # pictures in a row of a strip
STILL_SAMPLES = 4  # samples per pixel of a still picture
VIDEO_RATE = 25  # frames per second, simulated and shown
CAMERA_DISTANCE = 1.7  # least distance, in units of the distance between the robot's farthest feet at the start
MODEL_DISTANCE = 2.0  # distance in units of a model's extent, for a model without feet
HALF_FIELD = np.tan(np.radians(22.5)) * np.array(
    [PICTURE_SIZE[0] / PICTURE_SIZE[1], 1.0]
)  # half of MuJoCo's 45 deg, per unit of distance
LONGEST_ARROW = 1.6  # m
MAX_SPAN = 0.9  # largest share of half the picture's width and height that the feet span
AZIMUTHS = (125.0, -125.0, 55.0, -55.0)  # deg, viewing directions of the camera in order of preference
ELEVATION = -22.0  # deg
OPENGL_PACKAGES = {"egl": "libegl1 libegl-mesa0 libgl1-mesa-dri", "osmesa": "libosmesa6"}  # Debian packages


def write_png(folder: str | Path, trace: Trace, outcome: str = "", count: int = 8) -> list[Path]:
    """Write pictures at evenly spaced times of a trace, each with its time, stage and outcome.

    Args:
        folder: Where to write them; created if missing.
        trace: The rollout.
        outcome: Outcome or cause, written on every picture.
        count: Number of pictures.

    Returns:
        Paths of the pictures, named by their time.

    Raises:
        InputError: Neither EGL nor OSMesa works.
    """
    folder, chosen = Path(folder), evenly_spaced_indices(count_finite_frames(trace), count)
    folder.mkdir(parents=True, exist_ok=True)
    paths = [folder / f"t{trace.time[k]:07.3f}s.png" for k in chosen]
    for path, picture, k in zip(paths, render(trace, chosen), chosen, strict=True):
        write_atomically(path, partial(imsave, arr=add_caption(picture, format_caption(trace, k, outcome))))
    return paths


def format_caption(trace: Trace, k: int, outcome: str = "", title: str = "") -> str:
    """Return the caption of frame `k`: title, time, stage and outcome in one line."""
    stage = trace.stages[trace.stage[k]] if 0 <= trace.stage[k] < len(trace.stages) else ""
    return "   ".join(part for part in (title, f"{trace.time[k]:.2f} s", stage, outcome) if part)


def outcome_at_frame(trace: Trace, k: int, outcome: str) -> str:
    """Return the outcome as caption text for frames at or after its time; empty before.

    The outcome is shown from the time of its cause on, or in the last frame if there is none.

    Args:
        trace: The rollout.
        k: Index of the frame.
        outcome: Outcome or cause in words.
    """
    cause = float(trace.metrics.get("t_cause_s", np.nan))
    return outcome if trace.time[k] >= (trace.time[-1] if np.isnan(cause) else cause) else ""


def add_caption(picture: np.ndarray, text: str) -> np.ndarray:
    """Return the picture (height, width, 3) with a line of text at its lower left."""
    image = Image.fromarray(picture)
    pen, size = ImageDraw.Draw(image), max(12, image.height // 22)
    font, place = ImageFont.load_default(size), (size // 2, image.height - size // 2)
    pen.text(place, text, "white", font, anchor="ls", stroke_width=max(1, size // 10), stroke_fill="black")
    return np.asarray(image)


def write_filmstrip(path: str | Path, trace: Trace, frames: np.ndarray, outcome: str = "") -> None:
    """Write pictures of some frames into one image, at most `PICTURES_PER_ROW` in a row.

    Args:
        path: The file, a PNG.
        trace: The rollout.
        frames: Indices of the frames.
        outcome: Outcome or cause, written on every picture.

    Raises:
        InputError: Neither EGL nor OSMesa works.
    """
    small = [
        add_caption(np.asarray(Image.fromarray(picture).resize(STRIP_PICTURE_SIZE)), format_caption(trace, k, outcome))
        for picture, k in zip(render(trace, frames), frames, strict=True)
    ]
    rows = [np.concatenate(row, axis=1) for row in itertools.batched(small, PICTURES_PER_ROW)]
    write_atomically(Path(path), partial(Image.fromarray(np.concatenate(rows)).quantize(128).save, optimize=True))


def write_video(
    path: str | Path,
    trace: Trace,
    title: str = "",
    outcome: str = "",
    progress: Callable[[int, int], None] = lambda done, of: None,
) -> None:
    """Write a video (MP4) of a trace in real time.

    Args:
        path: The file.
        trace: The rollout.
        title: Name of the rollout, written on every picture beside time and stage.
        outcome: Outcome or cause, written from the time of the cause on.
        progress: Receives the number of drawn pictures and of all.

    Raises:
        InputError: Neither EGL nor OSMesa works, or the `video` extra is not installed.
    """
    require_ffmpeg()
    write_atomically(Path(path), partial(_write_video, trace=trace, title=title, outcome=outcome, progress=progress))


def _write_video(path: Path, trace: Trace, title: str, outcome: str, progress: Callable[[int, int], None]) -> None:
    import imageio_ffmpeg

    # imageio_ffmpeg's own writer forks, which may hang a process that runs JAX
    raw = [
        "-f",
        "rawvideo",
        "-pix_fmt",
        "rgb24",
        "-s",
        f"{PICTURE_SIZE[0]}x{PICTURE_SIZE[1]}",
        "-r",
        str(VIDEO_RATE),
        "-i",
        "-",
    ]
    encoded = ["-c:v", "libx264", "-crf", "20", "-pix_fmt", "yuv420p", "-movflags", "+faststart", str(path)]
    command = [imageio_ffmpeg.get_ffmpeg_exe(), "-y", "-loglevel", "error", *raw, *encoded]
    chosen = frames_at_rate(trace, VIDEO_RATE)
    pictures = render(trace, chosen, samples=0)
    first = next(pictures)  # before there is a file, so that a failure to draw leaves none
    # a pipe breaks when ffmpeg ends, which prints the reason
    with suppress(BrokenPipeError), subprocess.Popen(command, stdin=subprocess.PIPE) as process:
        assert process.stdin is not None
        for done, (k, picture) in enumerate(zip(chosen, itertools.chain([first], pictures), strict=True), start=1):
            process.stdin.write(
                add_caption(picture, format_caption(trace, k, outcome_at_frame(trace, k, outcome), title)).tobytes()
            )
            progress(done, len(chosen))
    if process.returncode:
        raise OSError(f"ffmpeg ends with {process.returncode}")


def require_ffmpeg() -> None:
    """Raise `InputError` where the `video` extra is not installed."""
    if importlib.util.find_spec("imageio_ffmpeg") is None:
        raise InputError("a video needs ffmpeg: pip install 'insect-sweep[video]'")


def render(trace: Trace, frames: np.ndarray, samples: int = STILL_SAMPLES) -> Generator[np.ndarray, None, None]:
    """Yield a picture (height, width, 3), uint8, of each given frame of a trace.

    The camera follows the base; contact forces are drawn as arrows.

    Args:
        trace: The rollout.
        frames: Indices of the frames.
        samples: Samples per pixel; 0 takes half the time.

    Raises:
        InputError: Neither EGL nor OSMesa works.
    """
    with tempfile.TemporaryDirectory() as job:
        _write_job(Path(job), trace, frames, samples)
        for backend in OPENGL_PACKAGES:
            if (yield from _read_pictures(job, backend)):
                return
    packages = " or ".join(f"`{names}`" for names in OPENGL_PACKAGES.values())
    raise InputError(f"pictures need OpenGL without a screen: install the Debian packages {packages}")


def _write_job(job: Path, trace: Trace, frames: np.ndarray, samples: int) -> None:
    azimuth = min(AZIMUTHS, key=partial(_count_hidden_points, trace, frames))
    mujoco.mj_saveModel(trace.model, str(job / MODEL_FILE), None)
    np.savez(
        job / ARRAYS_FILE,
        qpos=trace.qpos[frames],
        look_at=_look_at(trace, frames),
        distance=_camera_distance(trace, frames, azimuth),
        azimuth=azimuth,
        elevation=ELEVATION,
        size=PICTURE_SIZE,
        samples=samples,
        tails=trace.foot_position[frames],
        tips=_tips(trace, frames),
    )


def _tips(trace: Trace, frames: np.ndarray) -> np.ndarray:
    """Tips (N, 6, 3) of the force arrows at the feet, m."""
    return arrow_tips(trace.foot_position[frames], trace.foot_force[frames], LONGEST_ARROW)


def _look_at(trace: Trace, frames: np.ndarray) -> np.ndarray:
    """Centres (N, 3) of the pictures, m: halfway along the mean vector from the base to its feet."""
    base = base_pose(trace)[frames, :3]
    if not trace.foot_position.shape[1]:
        return base
    return base + 0.5 * np.mean(trace.foot_position[frames] - base[:, None], axis=(0, 1))


def _camera_axes(azimuth: float) -> np.ndarray:
    """Axes (3, 3) of the camera in the world: right, up, and from the centre of the picture towards the camera."""
    angle, slope = np.radians(azimuth), np.radians(ELEVATION)
    away = -np.array([np.cos(angle) * np.cos(slope), np.sin(angle) * np.cos(slope), np.sin(slope)])
    right = np.array([np.sin(angle), -np.cos(angle), 0.0])
    return np.stack([right, np.cross(away, right), away])


def _camera_distance(trace: Trace, frames: np.ndarray, azimuth: float) -> float:
    """Least distance (m) of the camera at which all feet of the frames, and their arrows, are in the picture.

    For a model without feet, a multiple of its extent.
    """
    if not trace.foot_position.shape[1]:
        return MODEL_DISTANCE * float(trace.model.stat.extent)
    start, ends = trace.foot_position[0], np.concatenate([trace.foot_position[frames], _tips(trace, frames)], axis=1)
    offset = ends - _look_at(trace, frames)[:, None]
    across, towards = offset @ _camera_axes(azimuth)[:2].T, offset @ _camera_axes(azimuth)[2]
    needed = towards + np.max(np.abs(across) / (MAX_SPAN * HALF_FIELD), axis=-1)
    return max(CAMERA_DISTANCE * np.linalg.norm(start[:, None] - start, axis=-1).max(), needed.max())


def _count_hidden_points(trace: Trace, frames: np.ndarray, azimuth: float) -> int:
    """Count sampled points between the camera and base or feet that lie inside the obstacle, over all frames."""
    if trace.contacts is None:
        return 0
    way = _camera_distance(trace, frames, azimuth) * np.linspace(0.2, 1, 9)[:, None] * _camera_axes(azimuth)[2]
    seen = np.concatenate([base_pose(trace)[frames, None, :3], trace.foot_position[frames]], axis=1)
    points = (seen[:, :, None] + way).reshape(len(frames), -1, 3)
    return int(np.sum(trace.contacts.penetration_depth(trace, points, frames) > 0))


def _read_pictures(job: str, backend: str) -> Generator[np.ndarray, None, bool]:
    """Yield the pictures of the drawing process; return whether its OpenGL library works."""
    width, height = PICTURE_SIZE
    command = [sys.executable, "-m", "sweep.replay.draw", job]
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

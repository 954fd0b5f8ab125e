"""Pictures: chosen frames, what is drawn, and what is said where drawing is impossible."""

import dataclasses
import resource
import subprocess

import numpy as np
import pytest
from matplotlib.image import imread

from sweep.contract.trace_frames import base_pose, count_finite_frames, frames_at_rate, frames_at_times
from sweep.core.parameters import InputError
from sweep.core.spacing import evenly_spaced_indices
from sweep.replay import rendering
from sweep.replay.arrows import FORCE_SCALE


def _arrow_columns(picture: np.ndarray) -> np.ndarray:
    """Columns of the picture that hold the arrows' orange; the rest of the scene is grey, blue and dark red."""
    r, g, b = picture.astype(int).transpose(2, 0, 1)
    return np.flatnonzero(((r > 40) & (b < 0.35 * r) & (g > 0.6 * r) & (g < 0.8 * r)).any(axis=0))


@pytest.fixture(scope="module")
def drawable(trace):
    try:
        next(rendering.render(trace, np.array([0])))
    except InputError as error:
        pytest.skip(f"no OpenGL here: {error}")
    return trace


def test_frames_nearest_to_times(trace):
    np.testing.assert_array_equal(frames_at_times(trace, np.array([-1.0, 0.0101, 0.5, 9.0])), [0, 2, 124, 249])
    assert len(frames_at_rate(trace, 25.0)) == 25
    np.testing.assert_array_equal(frames_at_rate(trace, 1e4), np.arange(250))
    np.testing.assert_array_equal(evenly_spaced_indices(count_finite_frames(trace), 3), [0, 124, 249])


def test_only_finite_frames_are_chosen(trace):
    qpos = trace.qpos.copy()
    qpos[1:] = np.inf
    broken = dataclasses.replace(trace, qpos=qpos)
    assert count_finite_frames(broken) == 1
    few = evenly_spaced_indices(count_finite_frames(broken), 4)
    for chosen in (frames_at_times(broken, np.array([0.0, 5.0])), frames_at_rate(broken, 25.0), few):
        assert set(chosen.tolist()) == {0}


def test_png_frames(drawable, tmp_path):
    paths = rendering.write_png(tmp_path / "png", drawable, count=3)
    assert [path.name for path in paths] == ["t000.004s.png", "t000.500s.png", "t001.000s.png"]
    picture = imread(paths[0])
    assert picture.shape[:2] == rendering.PICTURE_SIZE[::-1]
    assert picture[..., :3].std() > 0.05  # not one flat colour


def test_stills_say_when_what_and_how_it_ended(drawable):
    (plain,) = rendering.render(drawable, np.array([124]))
    line = rendering.format_caption(drawable, 124, "slipped")
    assert line.startswith("0.50 s   ")
    assert line.endswith(f"{drawable.stages[drawable.stage[124]]}   slipped")
    changed = np.any(rendering.add_caption(plain, line) != plain, axis=2)
    assert changed[-60:].any()  # at the bottom
    assert not changed[:-60].any()


def test_a_film_tells_the_outcome_when_it_comes(trace):
    cause = dataclasses.replace(trace, metrics={"t_cause_s": 0.5})
    assert [rendering.outcome_at_frame(cause, k, "slipped") for k in (0, 123, 124, 249)] == [
        "",
        "",
        "slipped",
        "slipped",
    ]
    assert [rendering.outcome_at_frame(trace, k, "success") for k in (0, 248, 249)] == ["", "", "success"]


def test_a_video_takes_less_time_than_what_it_shows(drawable):
    start = resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime
    number = sum(1 for _ in rendering.render(drawable, np.arange(0, 250, 5), samples=0))
    seconds = resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime - start  # of the processor, with starting to draw
    assert number / rendering.VIDEO_RATE > 0.5 * (seconds - 1.5)


def test_forces_are_drawn_to_scale(drawable):
    """An arrow ends where another one begins that starts at its computed tip."""
    force = np.zeros_like(drawable.foot_force)

    def columns(foot):
        feet = drawable.foot_position.copy()
        feet[:, 4] = foot
        (picture,) = rendering.render(
            dataclasses.replace(drawable, foot_position=feet, foot_force=force), np.array([0])
        )
        return _arrow_columns(picture)

    start = np.array([-0.3, 0.0, 0.7])
    force[:, 4] = [80.0, 0, 0]
    first, second = columns(start), columns(start + FORCE_SCALE * force[0, 4])
    assert min(np.ptp(first), np.ptp(second)) > 40
    ends = sorted([first.min(), first.max(), second.min(), second.max()])
    assert ends[2] - ends[1] < 0.2 * np.ptp(first)


def test_feet_are_in_the_picture(trace, monkeypatch):
    """Also where they are farther from the base than at the start, and on the camera's side."""
    seen = {}

    def taken(folder, backend):
        seen.update(np.load(f"{folder}/{rendering.ARRAYS_FILE}"))
        yield from ()
        return True

    monkeypatch.setattr(rendering, "_read_pictures", taken)
    feet = trace.foot_position.copy()
    feet[124] += 2.5 * (feet[124] - base_pose(trace)[124, None, :3])
    list(rendering.render(dataclasses.replace(trace, foot_position=feet), np.array([0, 124])))
    turn, rise = np.radians([seen["azimuth"], seen["elevation"]])
    ahead = np.array([np.cos(turn) * np.cos(rise), np.sin(turn) * np.cos(rise), np.sin(rise)])
    right = np.cross(ahead, [0, 0, 1]) / np.cos(rise)
    from_camera = feet[[0, 124]] - seen["look_at"][:, None] + seen["distance"] * ahead
    high = np.tan(np.radians(45 / 2)) * (from_camera @ ahead)
    assert (np.abs(from_camera @ np.cross(right, ahead)) < high).all()
    assert (np.abs(from_camera @ right) < high * rendering.PICTURE_SIZE[0] / rendering.PICTURE_SIZE[1]).all()


def test_caller_may_stop_early(drawable):
    pictures = rendering.render(drawable, np.arange(50))
    assert next(pictures).dtype == np.uint8
    pictures.close()  # must not wait for the other 49


def test_video(drawable, tmp_path):
    ffmpeg = pytest.importorskip("imageio_ffmpeg", reason="the video extra is not installed")
    short = dataclasses.replace(drawable, qpos=np.where(drawable.time[:, None] < 0.2, drawable.qpos, np.nan))
    rendering.write_video(tmp_path / "walk.mp4", short)
    rendering.write_video(tmp_path / "told.mp4", short, "row 42", "slipped")
    first = ["-frames:v", "1", "-f", "rawvideo", "-pix_fmt", "rgb24", "-"]
    plain, told = (
        np.frombuffer(
            subprocess.run(
                [ffmpeg.get_ffmpeg_exe(), "-i", tmp_path / name, *first], capture_output=True, check=True
            ).stdout,
            np.uint8,
        ).reshape(*rendering.PICTURE_SIZE[::-1], 3)
        for name in ("walk.mp4", "told.mp4")
    )
    changed = (np.abs(plain.astype(int) - told) > 60).any(axis=2)
    assert changed[-60:].any()
    assert not changed[:-60].any()
    assert ffmpeg.count_frames_and_secs(str(tmp_path / "walk.mp4"))[0] == len(
        frames_at_rate(short, rendering.VIDEO_RATE)
    )


def test_missing_opengl_names_the_packages(trace, monkeypatch, tmp_path):
    monkeypatch.setattr(rendering, "OPENGL_PACKAGES", {"nonsense": "some-package"})
    with pytest.raises(InputError, match="Debian packages `some-package`"):
        rendering.write_png(tmp_path, trace)


def test_missing_ffmpeg_names_the_extra(trace, monkeypatch, tmp_path):
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    with pytest.raises(InputError, match=r"insect-sweep\[video\]"):
        rendering.write_video(tmp_path / "walk.mp4", trace)
    assert not list(tmp_path.iterdir())

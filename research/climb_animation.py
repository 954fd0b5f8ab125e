"""Draws research/figures/climb.gif: two climbs up a pole, replayed beside the map of where climbs succeed.

python research/climb_animation.py

The map is that of research/data/pole_map.json. The two climbs are simulated again and drawn by MuJoCo off screen.
"""

import io
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure
from PIL import Image

from sweep.config.experiment import compose
from sweep.contract.engine import Trace
from sweep.contract.trace_frames import frames_at_times
from sweep.replay.rendering import add_caption, render
from sweep.runs.batches import Batch, make_engine

RESEARCH = Path(__file__).parent
PATH = RESEARCH / "figures" / "climb.gif"
HEIGHT, REPLAY_WIDTH, MAP_WIDTH = 320, 520, 360  # pixels
REPLAY_BOX = (38, 0, 922, 544)  # of a rendered picture, with the sides of a replay
PICTURE_TIME = 0.12  # s, for which each picture of the animation is shown
STEP = 0.5  # s, simulated between two pictures
HOLD = 12  # pictures, for which the end of a climb stays on screen
RADIUS = 0.41  # a_r, of the pole: a row of the map
CLIMBS = {1.0125: "success", 0.3: "failure: slipped"}  # friction -> outcome
AFTER_CAUSE = 2.0  # s, for which a climb that has failed is shown on
COLOURS = 64
BLUE, RED = "#56b4e9", "#d55e00"  # success and failure


def trace_climb(friction: float) -> Trace:
    """Simulate one climb of the map, with its states over time.

    Args:
        friction: Coefficient between feet and pole in the simulated world; the planner believes the nominal one.

    Returns:
        States, forces and stages of the rollout.
    """
    body_length = compose(["scenario=pole_climb"]).case.robot.body_length
    exp = compose(["scenario=pole_climb", f"obstacle.radius={RADIUS * body_length}"])
    world = replace(exp.case, contact=replace(exp.case.contact, friction=friction))
    one = Batch(replace(exp.settings, width=1), world, exp.case, np.zeros(1, int))
    return make_engine(exp, one).trace(world, exp.case, one.streams, 0)


def draw_map(friction: float, marker: str) -> Image.Image:
    """Draw the map of successes with a mark at one friction.

    Args:
        friction: Where the mark stands, at the radius of the climbs.
        marker: Matplotlib's name of its shape.

    Returns:
        The picture, `MAP_WIDTH` by `HEIGHT` pixels.
    """
    grid = json.loads((RESEARCH / "data" / "pole_map.json").read_text(encoding="utf-8"))["map"]
    (_, frictions), (_, radii) = grid["values"].items()
    figure = Figure((MAP_WIDTH / 100, HEIGHT / 100), dpi=100)
    ax = figure.add_axes((0.17, 0.16, 0.79, 0.73))
    ax.pcolormesh(frictions, radii, np.array(grid["success"]), cmap=ListedColormap([RED, BLUE]), vmin=0, vmax=1)
    ax.plot(friction, RADIUS, marker, ms=13, mfc="white", mec="black", mew=1.5, clip_on=False, zorder=9)
    ax.set_xlabel("friction of the pole")
    ax.set_ylabel("radius of the pole / body length")
    tried, succeed = (sum(map(sum, grid[key])) for key in ("valid", "success"))
    ax.set_title(f"{succeed} of {tried} climbs succeed (blue)", fontsize=11)
    file = io.BytesIO()
    figure.savefig(file)
    return Image.open(file).convert("RGB")


def frames_of_climb(friction: float, outcome: str) -> list[Image.Image]:
    """Draw all pictures of one climb: the replay at the left, the map at the right.

    Args:
        friction: Of the pole, in the simulated world.
        outcome: What the caption says as soon as the outcome is known.

    Returns:
        Pictures, `STEP` simulated seconds apart; the last one `HOLD` times more.
    """
    trace = trace_climb(friction)
    known = float(trace.time[-1])
    end = known
    if outcome != "success":
        known = float(trace.metrics["slipped_time_s"])
        end = min(known + AFTER_CAUSE, end)
    chosen = frames_at_times(trace, np.append(np.arange(0, end, STEP), end))
    pictures = []
    for k, picture in zip(chosen, render(trace, chosen), strict=True):
        over = trace.time[k] >= known
        text = f"friction {friction:.1f}   {trace.time[k]:.1f} s   {outcome if over else ''}"
        replay = add_caption(np.asarray(Image.fromarray(picture).crop(REPLAY_BOX)), text)
        both = Image.new("RGB", (REPLAY_WIDTH + MAP_WIDTH, HEIGHT), "white")
        both.paste(Image.fromarray(replay).resize((REPLAY_WIDTH, HEIGHT), Image.Resampling.LANCZOS), (0, 0))
        both.paste(draw_map(friction, "X" if over and outcome != "success" else "o"), (REPLAY_WIDTH, 0))
        pictures.append(both)
    return pictures + pictures[-1:] * HOLD


def write_gif(pictures: list[Image.Image], path: Path) -> None:
    """Write pictures as one GIF with one palette, repeated for ever."""
    palette = pictures[len(pictures) // 3].quantize(COLOURS)
    flat = [picture.quantize(palette=palette, dither=Image.Dither.NONE) for picture in pictures]
    shown = round(1000 * PICTURE_TIME)
    flat[0].save(path, save_all=True, append_images=flat[1:], duration=shown, loop=0, optimize=True)


if __name__ == "__main__":
    write_gif([picture for climb in CLIMBS.items() for picture in frames_of_climb(*climb)], PATH)
    print(PATH, PATH.stat().st_size)

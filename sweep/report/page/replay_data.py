"""Replays as a page stores them: each robot model once, and the states of each rollout as a line of text."""

import json
from collections.abc import Iterable, Iterator
from typing import Any, NamedTuple

import pandas as pd

from sweep.core.errors import InputError
from sweep.core.files import deflate_to_base64
from sweep.replay.motion import thin_motion
from sweep.report import replays
from sweep.report.page.data import sample_row_indices
from sweep.runs.results import Results

MAX_THINNING = 4  # frames of which one is kept at least, where all of them do not fit
COPIED_KEYS = ("step", "frames", "scales", "force_scale", "stages", "equal", "of", "why")  # of a replay as it is
# of a replay that was kept before these were
LATER_DEFAULTS = {"torque_scale": 0.0, "torque_limit": None, "margin_scale": 0.0, "limits": [], "friction_scale": 0.0,
                  "signals": [], "pushes": []}  # fmt: skip


class ShownReplay(NamedTuple):
    """A replay that is embedded in the page."""

    row_index: int  # of its row among those of the results, -1 where it is not one of them
    row: pd.Series
    replay: dict[str, Any]  # see `replays.keep`
    title: str = ""


class PageReplays(NamedTuple):
    """All replays that a page embeds: descriptions, states as text, and robot models."""

    descriptions: list[dict[str, Any]]
    streams: list[str]
    models: str
    omitted_count: int  # for want of room


def read_shown_replays(results: Results) -> Iterator[ShownReplay]:
    """Read the replays in the study's folder that the page will embed."""
    return (ShownReplay(place, results.rows.iloc[place], replay) for place, replay in replays.read_replays(results))


def describe_replays(results: Results, shown: Iterable[ShownReplay], room: int) -> PageReplays:
    """Collect the data of replays for the page's script.

    Args:
        results: study with its rows.
        shown: replays, the most important first.
        room: characters that their states may take; beyond it they get fewer frames, and then some are left out.
    """
    places = {int(place): k for k, place in enumerate(sample_row_indices(len(results.rows)))}
    shown = thin_replays_to_size(list(shown), room)
    about, streams, models, left_out, size = [], [], {}, 0, 0
    for place, row, replay, title in shown:
        size += len(replay["states"])
        if size > room:
            left_out += 1
            continue
        bodies = json.dumps(replay["bodies"], separators=(",", ":"))
        streams.append(replay["states"])
        about.append(
            {
                **{name: replay[name] for name in COPIED_KEYS},
                **{name: replay.get(name, value) for name, value in LATER_DEFAULTS.items()},
                "model": models.setdefault(bodies, len(models)),
                "row": places.get(place, -1),
                "point": row["point_id"],
                "kind": str(row["cause"]) if row["outcome"] != "success" else "success",
                "title": title,
            }
        )
    return PageReplays(about, streams, deflate_to_base64(f"[{','.join(models)}]".encode()), left_out)


def thin_replays_to_size(shown: list[ShownReplay], room: int) -> list[ShownReplay]:
    """Drop frames of replays until their text fits into `room` characters; at least one in `MAX_THINNING` stays."""
    thin = shown
    for every in range(1, MAX_THINNING + 1):
        thin = [one._replace(replay=_thin(one, every)) if every > 1 else one for one in shown]
        if sum(len(one.replay["states"]) for one in thin) <= room:
            break
    return thin


def _thin(one: ShownReplay, every: int) -> dict[str, Any]:
    try:
        return thin_motion(one.replay, every)
    except ValueError as error:  # of a file that may come from a stranger
        raise InputError(f"the replay of {one.row['point_id']} cannot be read: {error}") from None

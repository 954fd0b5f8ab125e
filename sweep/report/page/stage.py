"""Replays as a page holds them: bodies that several have once, and the streams of states as lines of text."""

import json
from collections.abc import Iterable, Iterator
from typing import Any, NamedTuple

import pandas as pd

from sweep.core.files import encode_text
from sweep.report import replays
from sweep.report.page.data import sampled
from sweep.runs.results import Results
from sweep.trace.motion import thinned

THINNEST = 4  # frames of which one is kept at least, where all of them do not fit
TOLD = ("step", "frames", "scales", "force_scale", "stages", "equal", "of", "why")  # of a replay as it is
# of a replay that was kept before these were
LATER = {"torque_scale": 0.0, "torque_limit": None, "margin_scale": 0.0, "limits": [], "friction_scale": 0.0}


class Shown(NamedTuple):
    """A replay that the page plays."""

    place: int  # of its row among those of the results, -1 where it is not one of them
    row: pd.Series
    replay: dict[str, Any]  # see `replays.keep`
    title: str = ""


class Replays(NamedTuple):
    """All replays that a page has."""

    about: list[dict[str, Any]]
    streams: list[str]
    models: str
    left_out: int  # for want of room


def replays_of(results: Results) -> Iterator[Shown]:
    """Those that the folder keeps."""
    return (Shown(place, results.rows.iloc[place], replay) for place, replay in replays.kept(results))


def stage_directions(results: Results, shown: Iterable[Shown], room: int) -> Replays:
    """What the script is told of replays, and their streams in the same order.

    Where these take more than `room` characters they have fewer frames, and then some are left out.
    """
    places = {int(place): k for k, place in enumerate(sampled(len(results.rows)))}
    shown = fitted(list(shown), room)
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
                **{name: replay[name] for name in TOLD},
                **{name: replay.get(name, value) for name, value in LATER.items()},
                "model": models.setdefault(bodies, len(models)),
                "row": places.get(place, -1),
                "point": row["point_id"],
                "kind": str(row["cause"]) if row["outcome"] != "success" else "success",
                "title": title,
            }
        )
    return Replays(about, streams, encode_text(f"[{','.join(models)}]".encode()), left_out)


def fitted(shown: list[Shown], room: int) -> list[Shown]:
    """Replays with no more frames than there is room for, and no fewer than one in `THINNEST`."""
    thin = shown
    for every in range(1, THINNEST + 1):
        thin = [one._replace(replay=thinned(one.replay, every) if every > 1 else one.replay) for one in shown]
        if sum(len(one.replay["states"]) for one in thin) <= room:
            break
    return thin

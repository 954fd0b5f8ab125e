"""Trace single runs into tables, research/data/traced_tables.json: `python research/traced_tables.py`.

Events of the way up a ladder, with friction and torque that the planned forces ask for and what drives and feet bear;
how long parts of the way over a ball take; how hard the right middle leg's drives work on ways from a pole to a ledge.
"""

import json
import time
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path

import jax
import numpy as np
from jaxtyping import Bool
from one_run import traced

from sweep.config.experiment import Experiment
from sweep.contract.engine import Trace
from sweep.core.constants import GRAVITY
from sweep.core.files import write_atomically
from sweep.core.provenance import version_record
from sweep.models.robot import total_mass
from sweep.systems.hexapod.plots import BOOK_TORQUE

PATH = Path(__file__).parent / "data" / "traced_tables.json"
EVENTS = {  # of the book: ours, and where its feet go
    "3": ("front1", "rung 1"),
    "4, 5": ("tilt1 middle1", "floor"),
    "6": ("front3", "rung 3"),
    "7, 8": ("middle2 rear1 middle3", "floor, floor, rung 2"),
    "9": ("front4", "rung 4"),
    "10, 11, 12": ("middle4 rear2 rear3 middle5", "rung 1, floor one by one, rung 3"),
    "13, 14": ("up1 front5", "rung 5"),
    "15, 16, 17": ("up2 middle6 rear4 rear5", "rung 2, rung 1 one by one"),
    "21, 22": ("up3 middle7 rear6 rear7", "rung 3, rung 2 one by one"),
    "18": ("middle8", "rung 4"),
    "19": ("front6", "ledge"),
    "27, 28": ("up4 rear8 rear9", "rung 3 one by one"),
    "25": ("up5 front7", "farther on the ledge"),
    "29": ("middle11 up6", "ledge"),
    "32, 33": ("middle12 rear10 rear11", "rung 5, rung 4 one by one"),
    "34, 35": ("up7 middle13 over1", "ledge"),
    "36": ("rear12 rear13", "rung 5 one by one"),
    "37, 38": ("middle14 front8", "farther on the ledge"),
    "39, 40, 41": ("over2 rear14", "ledge"),
    "42, 43, 44, 45": ("middle15 front9 over3", "farther on the ledge"),
}
MIDDLE = 3  # the right middle leg
OVER = {  # of the way over a ball: the stage that a part begins with, and how long it takes in print (3.4.3)
    "climbing, from the front feet's first landing on": ("turn1", "16.6"),
    "calming the ball": ("calm1", "5.8"),
    "along": ("drive1", "not in fig. 3.4.8"),
    "coming down": ("lower", "17.2"),
    "walking on": ("away.3-4", ""),
}
LEDGE = {"on to the pole": "on.front.load", "gallop": "gallop1.front.load", "edge": "edge.front.load",
         "over the edge": "over.front.load", "on the top": "top.middle.load", "on to the ledge": "ledge.back.load",
         "away": "away.1-4-5.load"}  # fmt: skip
DEVICES: set[str] = set()


def told(*words: str) -> tuple[Experiment, Trace]:
    """One nominal run, whose device is noted."""
    exp, trace = traced(*words)
    DEVICES.add(exp.system.device(exp.settings))
    return exp, trace


def among(names: tuple[str, ...], ours: str) -> Bool[np.ndarray, " s"]:
    """Which stages belong to an event, the loading before each of its swings among them. Raises `ValueError`."""
    moves = [name.removeprefix("climb.").removesuffix(".load") for name in names]
    if missing := set(ours.split()) - {*moves}:
        raise ValueError(f"no stage of the plan is called {', '.join(sorted(missing))}")
    return np.isin(moves, ours.split())


def events() -> Iterator[list[str]]:
    """Tables 2.2 to 2.5: what our events are called, and what they take."""
    yield ["event of tables 2.2 to 2.5", "here", "feet to", "friction planned", "torque planned (N m)", "F/P",
           "torque (N m)"]  # fmt: skip
    exp, trace = told("scenario=ladder_climb")
    case, manoeuvre = exp.case, exp.case.manoeuvre
    plan = jax.jit(manoeuvre.plan_without_forces)(case)
    planned = jax.jit(manoeuvre.force_plan)(case, plan).optimum
    weight = float(GRAVITY * total_mass(case.robot))
    for event, (ours, to) in EVENTS.items():
        stages, frames = among(plan.names, ours), among(trace.stages, ours)[trace.stage]
        friction, torque = (float(np.max(np.asarray(effort)[stages])) for effort in (planned.friction, planned.torque))
        pressed = float(np.linalg.norm(trace.foot_force[frames], axis=-1).max()) / weight
        borne = float(np.abs(trace.joint_torque[frames]).max())
        names = ", ".join(f"`{name}`" for name in ours.split())
        yield [event, names, to, f"{friction:.2f}", f"{torque:.0f}", f"{pressed:.2f}", f"{borne:.0f}"]


def split(trace: Trace, begins: list[str]) -> Iterator[np.ndarray]:
    """Frames of each part, which goes from the first stage of a name after the part before to the next part."""
    firsts = [0]
    for name in begins:
        firsts.append(trace.stages.index(name, firsts[-1]))
    for first, after in pairwise([*firsts[1:], len(trace.stages)]):
        yield np.flatnonzero((trace.stage >= first) & (trace.stage < after))


def over() -> Iterator[list[str]]:
    """How long the parts of the way over a ball take, here and in print."""
    yield ["part", "here, s", "print, s"]
    _, trace = told("scenario=ball_over")
    tick = float(np.median(np.diff(trace.time)))
    for (part, (_, printed)), frames in zip(
        OVER.items(), split(trace, [name for name, _ in OVER.values()]), strict=True
    ):
        yield [part, f"{tick * len(frames):.1f}", printed]


def torques() -> Iterator[list[str]]:
    """Mean and 99th percentile of joints' torques in the parts of the ways to a ledge, in units of `BOOK_TORQUE`."""
    yield ["part", *(f"{ledge}: {joint}" for ledge in ("lower", "higher") for joint in "αβγ")]
    parts: dict[str, list[str]] = {name: [] for name in LEDGE}
    for ledge in ("below", "above"):
        _, trace = told(f"scenario=pole_ledge_{ledge}", "engine=native")
        for cells, frames in zip(parts.values(), split(trace, list(LEDGE.values())), strict=True):
            asked = np.abs(trace.joint_torque.reshape(-1, 6, 3)[frames, MIDDLE - 1]) / BOOK_TORQUE
            cells += [
                f"{mean:.2f} ({high:.2f})"
                for mean, high in zip(asked.mean(0), np.percentile(asked, 99, 0), strict=True)
            ]
    yield from ([name, *cells] for name, cells in parts.items())


if __name__ == "__main__":
    start = time.monotonic()
    tables = {made.__name__: list(made()) for made in (events, over, torques)}
    data = {
        "command": "python research/traced_tables.py",
        "engine": "mjx, torques native",
        **version_record(),
        "devices": sorted(DEVICES),
        "seconds": round(time.monotonic() - start),
        "tables": tables,
    }
    write_atomically(PATH, f"{json.dumps(data, indent=1, ensure_ascii=False)}\n".encode())

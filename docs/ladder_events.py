"""Table of events of the way up a ladder, what is planned and what it comes to: `python docs/ladder_events.py`.

Friction and torque that the planned forces ask for, and what drives and feet bear on the nominal climb, which is run
once on `mjx`; kept as docs/data/ladder_events.json.
"""

import json
import time
from dataclasses import replace
from pathlib import Path

import jax
import numpy as np
from jaxtyping import Bool

from sweep.core.constants import GRAVITY
from sweep.core.files import write_whole
from sweep.core.provenance import made_with
from sweep.models.robot import total_mass
from sweep.runs.batches import Batch, make_engine
from sweep.study.config import compose

PATH = Path(__file__).parent / "data" / "ladder_events.json"
COLUMNS = ["event of tables 2.2 to 2.5", "here", "feet to", "friction planned", "torque planned (N m)", "F/P",
           "torque (N m)"]  # fmt: skip
EVENTS = {  # of the book: ours, and where its feet go
    "3": ("front1", "rung 1"),
    "4, 5": ("tilt1 middle1", "floor"),
    "6": ("front3", "rung 3"),
    "7, 8": ("middle2 rear1 middle3", "floor, floor, rung 2"),
    "9": ("front4", "rung 4"),
    "10, 11, 12": ("middle4 rear2 rear3 middle5", "rung 1, floor one by one, rung 3"),
    "13, 14": ("up1 front5", "rung 5"),
    "15, 16, 17": ("up2 middle6 rear4 rear5", "rung 2, rung 1 one by one"),
    "18": ("up3 middle7", "rung 4"),
    "19": ("front6", "ledge"),
    "21, 22": ("middle8 rear6 rear7", "rung 3, rung 2 one by one"),
    "20, 23": ("up4 middle9", "rung 5"),
    "26, 27, 28": ("middle10 rear8 rear9", "rung 4, rung 3 one by one"),
    "25": ("up5 front7", "farther on the ledge"),
    "29": ("middle11 up6", "ledge"),
    "32, 33": ("middle12 rear10 rear11", "rung 5, rung 4 one by one"),
    "34, 35": ("up7 middle13 over1", "ledge"),
    "36": ("rear12 rear13", "rung 5 one by one"),
    "37, 38": ("middle14 front8", "farther on the ledge"),
    "39, 40, 41": ("over2 rear14", "ledge"),
    "42, 43, 44, 45": ("middle15 front9 over3", "farther on the ledge"),
}


def among(names: tuple[str, ...], ours: str) -> Bool[np.ndarray, " s"]:
    """Which stages belong to an event, the loading before each of its swings among them. Raises `ValueError`."""
    moves = [name.removeprefix("climb.").removesuffix(".load") for name in names]
    if missing := set(ours.split()) - {*moves}:
        raise ValueError(f"no stage of the plan is called {', '.join(sorted(missing))}")
    return np.isin(moves, ours.split())


if __name__ == "__main__":
    start = time.monotonic()
    exp = compose(["scenario=ladder_climb"])
    case, manoeuvre = exp.case, exp.case.manoeuvre
    plan = jax.jit(manoeuvre.way)(case)
    planned = jax.jit(manoeuvre.course)(case, plan).planned
    one = Batch(replace(exp.settings, width=1), case, case, np.zeros(1, int))
    trace = make_engine(exp, one).trace(case, case, one.streams, 0)
    weight = float(GRAVITY * total_mass(case.robot))
    table = [COLUMNS]
    for event, (ours, to) in EVENTS.items():
        stages, frames = among(plan.names, ours), among(trace.stages, ours)[trace.stage]
        asked = (float(np.max(np.asarray(effort)[stages])) for effort in (planned.friction, planned.torque))
        pressed = float(np.linalg.norm(trace.foot_force[frames], axis=-1).max()) / weight
        torque = float(np.abs(trace.joint_torque[frames]).max())
        told = [f"{next(asked):.2f}", f"{next(asked):.0f}", f"{pressed:.2f}", f"{torque:.0f}"]
        table.append([event, ", ".join(f"`{name}`" for name in ours.split()), to, *told])
    data = {
        "command": "python docs/ladder_events.py",
        "engine": exp.settings.name,
        **made_with(),
        "devices": [exp.system.device(exp.settings)],
        "seconds": round(time.monotonic() - start),
        "tables": {"events": table},
    }
    write_whole(PATH, f"{json.dumps(data, indent=1)}\n".encode())

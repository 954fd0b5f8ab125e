"""Files of research/data: of tables that one command makes, and such that processes side by side add to."""

import json
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import filelock

from sweep.core.files import write_whole
from sweep.core.provenance import made_with
from sweep.engines.run_id import device
from sweep.engines.settings import EngineSettings

DATA = Path(__file__).parents[1] / "research" / "data"

SCENARIOS = "scenarios"
BY = ("code", "commit")  # what each was made with; of several the names of all
Scenarios = Mapping[str, dict[str, Any]]  # by name, each with what it was made with, its device and seconds


def read(file: Path) -> Scenarios:
    """The scenarios of a file; none where it is not there."""
    return json.loads(file.read_text(encoding="utf-8"))[SCENARIOS] if file.exists() else {}


def joined(scenarios: Iterable[Mapping[str, Any]], key: str) -> str:
    """All that scenarios have under a key."""
    return ", ".join(sorted({name for one in scenarios for name in one.get(key, "").split(", ") if name}))


def add(file: Path, name: str, found: dict[str, Any], command: str, tables: Callable[[Scenarios], Any]) -> None:
    """Put a scenario into a file, and write anew what the file says of all."""
    with filelock.FileLock(file.with_suffix(".lock")):
        every = dict(sorted({**read(file), name: found}.items()))
        about = {key: joined(every.values(), key) for key in BY}
        whole = {
            "command": command,
            "engine": "`mjx`",
            "devices": sorted({one["device"] for one in every.values()}),
            **about,
            "seconds": round(sum(one["seconds"] for one in every.values())),
            "tables": tables(every),
            SCENARIOS: every,
        }
        write_whole(file, (json.dumps(whole, indent=1) + "\n").encode())


def keep(name: str, engines: Sequence[str], start: float, tables: Mapping[str, list[list[str]]]) -> None:
    """Write what `python bench/NAME.py` found, tables with their heads first; `start` is of `time.perf_counter`."""
    about = {
        "command": f"python bench/{name}.py",
        "engine": " and ".join(f"`{engine}`" for engine in engines) or "none",
        "devices": sorted({device(EngineSettings(name=engine)) for engine in engines or ("native",)}),
        **made_with(),
        "seconds": round(time.perf_counter() - start),
        "tables": tables,
    }
    write_whole(DATA / f"{name}.json", (json.dumps(about, indent=1, ensure_ascii=False) + "\n").encode())

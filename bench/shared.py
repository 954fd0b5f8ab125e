"""Files of research/data: tables made by one command, and tables that several processes add to."""

import json
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import filelock

from sweep.backends.run_id import describe_device
from sweep.contract.engine_settings import EngineSettings
from sweep.core.files import write_atomically
from sweep.core.provenance import version_record

RESEARCH = Path(__file__).parents[1] / "research"
DATA, FIGURES = RESEARCH / "data", RESEARCH / "figures"
Table = list[list[str]]  # columns, then rows

SCENARIOS = "scenarios"
BY = ("code", "commit")  # versions that each was made with; several are joined
Scenarios = Mapping[str, dict[str, Any]]  # content by name, with versions, device and seconds


def read_scenarios(file: Path) -> Scenarios:
    """Return the scenarios of a file; none if it does not exist."""
    return json.loads(file.read_text(encoding="utf-8"))[SCENARIOS] if file.exists() else {}


def join_values(scenarios: Iterable[Mapping[str, Any]], key: str) -> str:
    """Return all values that scenarios have under a key, joined by commas."""
    return ", ".join(sorted({name for one in scenarios for name in one.get(key, "").split(", ") if name}))


def add_scenario(
    file: Path,
    name: str,
    content: dict[str, Any],
    command: str,
    tables: Callable[[Scenarios], Any],
    engine: str = "`mjx`",
) -> None:
    """Add a scenario to a file, and update what the file says of all."""
    with filelock.FileLock(file.with_suffix(".lock")):
        every = dict(sorted({**read_scenarios(file), name: content}.items()))
        about = {key: join_values(every.values(), key) for key in BY}
        whole = {
            "command": command,
            "engine": engine,
            "devices": sorted({one["device"] for one in every.values()}),
            **about,
            "seconds": round(sum(one["seconds"] for one in every.values())),
            "tables": tables(every),
            SCENARIOS: every,
        }
        write_atomically(file, (json.dumps(whole, indent=1) + "\n").encode())


def write_tables(name: str, engines: Sequence[str], start: float, tables: Mapping[str, Table]) -> None:
    """Write the tables of `python bench/NAME.py`.

    Args:
        name: name of the file without suffix.
        engines: names of the engines used.
        start: `time.perf_counter()` at the start.
        tables: tables by name, with their heads first.
    """
    about = {
        "command": f"python bench/{name}.py",
        "engine": " and ".join(f"`{engine}`" for engine in engines) or "none",
        "devices": sorted({describe_device(EngineSettings(name=engine)) for engine in engines or ("native",)}),
        **version_record(),
        "seconds": round(time.perf_counter() - start),
        "tables": tables,
    }
    write_atomically(DATA / f"{name}.json", (json.dumps(about, indent=1, ensure_ascii=False) + "\n").encode())

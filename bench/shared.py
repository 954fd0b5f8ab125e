"""A file of docs/data that processes side by side add to."""

import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import filelock

from sweep.core.files import write_whole

SCENARIOS = "scenarios"
Scenarios = Mapping[str, dict[str, Any]]  # by name, each with what it was made with, its device and seconds


def read(file: Path) -> Scenarios:
    """The scenarios of a file; none where it is not there."""
    return json.loads(file.read_text(encoding="utf-8"))[SCENARIOS] if file.exists() else {}


def add(file: Path, name: str, found: dict[str, Any], command: str, tables: Callable[[Scenarios], Any]) -> None:
    """Put a scenario into a file, and write anew what the file says of all."""
    with filelock.FileLock(file.with_suffix(".lock")):
        every = dict(sorted({**read(file), name: found}.items()))
        about = {key: ", ".join(sorted({one[key] for one in every.values()})) for key in ("code", "commit")}
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

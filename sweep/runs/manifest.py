"""The list of a folder's files that count: what is not in it, or is not as it says, is no result.

Only the command that holds the folder's lock writes it. A worker names its part by what the part holds and hands the
entry to the command, so that one whose command died or went on without it can do no harm: its part is not listed.
"""

import json
import time
from collections.abc import Buffer, Iterable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

from sweep.core import files
from sweep.core.errors import InputError

MANIFEST, POINTS = "manifest.txt", "points.parquet"
PARTS, HISTORIES, LAST_STATES = "parts", "histories", "last_states"
SUBFOLDERS = (PARTS, HISTORIES, LAST_STATES)  # the only folders of files that the manifest lists
CHECK = 16  # digits of a line's own digest, before it
RETRY_PAUSES = (0.01, 0.05, 0.2, 0.5)  # s that who adds a line is given to finish it


@dataclass(frozen=True)
class Entry:
    """A file of the folder as it was when it was finished."""

    file: str  # below the folder
    length: int  # bytes
    sha256: str  # digest of its content
    batches: tuple[int, ...] = ()  # that a part holds
    study: str = ""  # digest of what all rows of the folder share
    labels: str = ""  # digest of the thresholds that the rows were judged by
    run_ids: tuple[str, ...] = ()  # of its rows

    def find_problem(self, content: Buffer) -> str | None:
        """What is wrong with the file, if anything is."""
        length = memoryview(content).nbytes
        if length != self.length:
            return f"{length} bytes instead of {self.length}"
        return None if files.digest(content) == self.sha256 else "its content has changed"


def format_line(entry: Entry) -> str:
    """`entry` as text, after a digest of it."""
    text = json.dumps(asdict(entry))
    return f"{files.digest(text.encode())[:CHECK]} {text}"


def parse(folder: Path) -> tuple[list[Entry], list[int]]:
    """The entries, and the numbers of the lines that are damaged.

    Raises `InputError` where a sound line names a file that is none of a study's.
    """
    try:
        content = _settled(files.path_in(folder, MANIFEST))
    except FileNotFoundError:
        return [], []
    entries, damaged = [], []
    for number, row in enumerate(content.removesuffix(b"\n").split(b"\n"), 1):
        check, _, text = row.partition(b" ")
        if check == files.digest(text)[:CHECK].encode():
            entries.append(_parse_entry(folder, number, text))
        else:
            damaged.append(number)
    if content and not content.endswith(b"\n") and not damaged:
        damaged.append(len(entries))
    return entries, damaged


def _parse_entry(folder: Path, number: int, text: bytes) -> Entry:
    where = f"{folder / MANIFEST}, line {number}"
    try:
        values = json.loads(text)
        batches, run_ids = (tuple(values[name]) for name in ("batches", "run_ids"))
        entry = Entry(**{**values, "batches": batches, "run_ids": run_ids})
        words, numbers = (entry.file, entry.sha256, entry.study, entry.labels, *run_ids), (entry.length, *batches)
        if {*map(type, words)} != {str} or {*map(type, numbers)} != {int}:
            raise TypeError
    except (ValueError, KeyError, TypeError, RecursionError):
        raise InputError(f"{where} is no entry of a study's file") from None
    place, _, name = entry.file.rpartition("/")
    if entry.file != POINTS and (place not in SUBFOLDERS or name in ("", ".", "..")):
        allowed = f"{POINTS}, or a file in {', '.join(SUBFOLDERS)}"
        raise InputError(f"{where} names {entry.file!r}, which is not allowed: {allowed}")
    return entry


def _settled(path: Path) -> bytes:
    """The content of `path`, whose last line may be half there while a command that runs adds it."""
    for pause in RETRY_PAUSES:
        if (content := path.read_bytes()).endswith(b"\n"):
            return content
        time.sleep(pause)
    return path.read_bytes()


def read(folder: Path) -> list[Entry]:
    """The entries of `folder`, in the order in which they were written. Raises `InputError` where one is damaged."""
    entries, damaged = parse(folder)
    if damaged:
        raise InputError(f"{folder / MANIFEST} is damaged in line {damaged[0]}: `sweep run` as before mends it")
    return entries


def add(folder: Path, *entries: Entry) -> None:
    """From now on `entries` count, all at once. Raises `Fault`."""
    files.append_line(files.path_in(folder, MANIFEST), "\n".join(map(format_line, entries)))


def rewrite(folder: Path, entries: Iterable[Entry]) -> None:
    """From now on `entries` count and no others. Raises `Fault`."""
    files.write_atomically(
        files.path_in(folder, MANIFEST), "".join(f"{format_line(entry)}\n" for entry in entries).encode()
    )


def select_current_parts(entries: Sequence[Entry], labels: str) -> list[Entry]:
    """The parts judged by the thresholds `labels`, in the order of their batches, each batch once."""
    seen: set[int] = set()
    found = []
    for entry in entries:
        if entry.batches and entry.labels == labels and not seen.intersection(entry.batches):
            seen.update(entry.batches)
            found.append(entry)
    return sorted(found, key=lambda entry: entry.batches[0])

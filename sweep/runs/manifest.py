"""The manifest: a list of the valid files of a study's folder with their digests.

Only the command that holds the folder's lock writes the manifest. A worker writes its part, names it by a digest of its
content, and returns the entry to the command. A worker whose command died, or stopped waiting, does no harm, as nobody
lists its part.
"""

import json
import re
import time
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from sweep.core import files
from sweep.core.errors import InputError

MANIFEST_FILE, POINTS_FILE = "manifest.txt", "points.parquet"
PARTS_FOLDER, HISTORIES_FOLDER, LAST_STATES_FOLDER = "parts", "histories", "last_states"
VERDICTS_FOLDER = "verdicts"  # of what later commands say of rows
SUBFOLDERS = (PARTS_FOLDER, HISTORIES_FOLDER, LAST_STATES_FOLDER, VERDICTS_FOLDER)  # of listed files
FILE_NAME = re.compile(rf"({'|'.join(SUBFOLDERS)})/\w[\w.-]{{,200}}", re.ASCII)  # names of listed files
MAX_NAME_LENGTH = 200  # characters of another name in messages
DIGEST_DIGITS = 16  # digits of the digest at the start of a line
# a listed file has at most so many bytes, and so many more for each rollout of its study: in a table of rollouts, and
# in a recording of ticks
FIXED_BYTES, BYTES_PER_ROLLOUT, BYTES_PER_RECORDING = 2**26, 2**15, 2**26
RETRY_PAUSES = (0.01, 0.05, 0.2, 0.5)  # s, in which another command may finish the last line


@dataclass(frozen=True)
class ManifestEntry:
    """A line of the manifest (list of a folder's files): a file with its digest and size at the time of writing."""

    file: str  # path below the folder
    length: int  # size in bytes
    sha256: str  # digest of its content
    batches: tuple[int, ...] = ()  # numbers of the batches in a part; empty for other files
    study: str = ""  # digest of what all rows of the folder share
    labels: str = ""  # digest of the thresholds that judged the rows
    run_ids: tuple[str, ...] = ()  # ids of the runs of its rows

    def max_file_size(self, rollouts: int) -> int:
        """Return the largest size (bytes) that the file can have if its study plans `rollouts` rollouts."""
        is_table = self.batches or self.file == POINTS_FILE
        return FIXED_BYTES + rollouts * (BYTES_PER_ROLLOUT if is_table else BYTES_PER_RECORDING)

    def find_file_mismatch(self, path: Path, rollouts: int) -> str | None:
        """Compare size and content of a file with this manifest entry; return what differs, or None.

        Args:
            path: The file. It is not read if it is larger than its study warrants, such as 1 TB of zeros.
            rollouts: How many rollouts its study plans.

        Returns:
            What differs, or None.

        Raises:
            OSError: The file cannot be read.
        """
        if (length := path.stat().st_size) != self.length:
            return f"{length} bytes instead of {self.length}"
        if length > (most := self.max_file_size(rollouts)):
            return f"{length:,} bytes, more than the {most:,} that {rollouts:,} planned rollouts can take"
        return None if files.digest_file(path) == self.sha256 else "its content has changed"


def format_line(entry: ManifestEntry) -> str:
    """Format a manifest entry as a line: a digest of the text, then the text (JSON)."""
    text = json.dumps(asdict(entry))
    return f"{files.digest(text.encode())[:DIGEST_DIGITS]} {text}"


def parse_manifest(folder: Path) -> tuple[list[ManifestEntry], list[int]]:
    """Read a folder's manifest (list of files); return its entries and the numbers of damaged lines.

    Returns:
        The sound entries, and the numbers (from 1) of the damaged lines.

    Raises:
        InputError: A sound line names a file that cannot belong to a study.
    """
    try:
        content = _read_when_complete(files.path_inside_folder(folder, MANIFEST_FILE))
    except FileNotFoundError:
        return [], []
    entries, damaged = [], []
    for number, row in enumerate(content.removesuffix(b"\n").split(b"\n"), 1):
        check, _, text = row.partition(b" ")
        if check == files.digest(text)[:DIGEST_DIGITS].encode():
            entries.append(_parse_entry(folder, number, text))
        else:
            damaged.append(number)
    if content and not content.endswith(b"\n") and not damaged:
        damaged.append(len(entries))
    return entries, damaged


def entry_from_json(values: Mapping[str, Any]) -> ManifestEntry:
    """Make a manifest entry from parsed JSON values.

    Args:
        values: Members of `ManifestEntry` by name.

    Raises:
        ValueError: A member has another type.
        KeyError: A member is missing.
        TypeError: There are other members.
    """
    batches, run_ids = (tuple(values[name]) for name in ("batches", "run_ids"))
    entry = ManifestEntry(**{**values, "batches": batches, "run_ids": run_ids})
    words, numbers = (entry.file, entry.sha256, entry.study, entry.labels, *run_ids), (entry.length, *batches)
    if {*map(type, words)} != {str} or {*map(type, numbers)} != {int} or not all(0 <= n < 2**63 for n in numbers):
        raise ValueError("a member of another type")
    return entry


def _parse_entry(folder: Path, number: int, text: bytes) -> ManifestEntry:
    where = f"{folder / MANIFEST_FILE}, line {number}"
    try:
        entry = entry_from_json(json.loads(text))
    except (ValueError, KeyError, TypeError, RecursionError):
        raise InputError(f"{where} is no entry of a study's file") from None
    if entry.file != POINTS_FILE and not FILE_NAME.fullmatch(entry.file):
        allowed = f"{POINTS_FILE}, or a file in {', '.join(SUBFOLDERS)}"
        shown = entry.file if len(entry.file) < MAX_NAME_LENGTH else f"{entry.file[:MAX_NAME_LENGTH]}..."
        raise InputError(f"{where} names {shown!r}, which is not allowed: {allowed}")
    return entry


def _read_when_complete(path: Path) -> bytes:
    """Return the content of the manifest; wait for a last line that another command is still writing."""
    for pause in RETRY_PAUSES:
        if (content := files.read_bytes_limited(path)).endswith(b"\n"):
            return content
        time.sleep(pause)
    return files.read_bytes_limited(path)


def read_manifest(folder: Path) -> list[ManifestEntry]:
    """Return the entries of a folder's manifest in the order of its lines. Raises `InputError` if a line is damaged."""
    entries, damaged = parse_manifest(folder)
    if damaged:
        raise InputError(
            f"{folder / MANIFEST_FILE} is damaged in line {damaged[0]}: repeat the same `sweep run` to repair it"
        )
    return entries


def append_entries(folder: Path, *entries: ManifestEntry) -> None:
    """Append entries to the manifest in one write. Raises `Fault` if the disk fails."""
    files.append_line(files.path_inside_folder(folder, MANIFEST_FILE), "\n".join(map(format_line, entries)))


def rewrite_manifest(folder: Path, entries: Iterable[ManifestEntry]) -> None:
    """Replace all entries of the manifest atomically. Raises `Fault` if the disk fails."""
    files.write_atomically(
        files.path_inside_folder(folder, MANIFEST_FILE),
        "".join(f"{format_line(entry)}\n" for entry in entries).encode(),
    )


def select_current_parts(entries: Sequence[ManifestEntry], labels: str) -> list[ManifestEntry]:
    """Select the manifest entries of the files that hold a folder's current rows.

    Args:
        entries: Entries of the manifest.
        labels: Digest of the thresholds that judged the rows.

    Returns:
        One part a batch, the first listed, in the order of their batches.
    """
    seen: set[int] = set()
    parts = []
    for entry in entries:
        if entry.batches and entry.labels == labels and not seen.intersection(entry.batches):
            seen.update(entry.batches)
            parts.append(entry)
    return sorted(parts, key=lambda entry: entry.batches[0])

"""Read the rows that a subcommand needs, and write its output. Slow imports wait until a function needs them."""

import sys
from collections.abc import Iterable, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from sweep.core.errors import InputError
from sweep.core.files import write_atomically

if TYPE_CHECKING:
    import pandas as pd


def read_matching_rows(folder: Path, condition: str | None, columns: Sequence[str] | None = None) -> "pd.DataFrame":
    """Read the rows of a study that meet a condition.

    Args:
        folder: Folder of the study.
        condition: Condition on columns; None for all rows.
        columns: Columns to read, besides those of the condition; None for all.
    """
    from sweep.core.expressions import condition_columns, condition_mask
    from sweep.runs import results, store
    from sweep.study.study import attach_axis_names

    exp = results.load_experiment(folder)
    if columns is not None:
        columns = [*columns, *condition_columns(results.make_empty_row_table(folder, exp), condition)]
    rows = attach_axis_names(store.read_rows(folder, columns), exp.study.axes)
    found = rows[condition_mask(rows, condition)].reset_index(drop=True) if condition else rows
    if len(found) < len(rows) and found.empty:
        warn_of_no_match(folder, condition, len(rows))
    return found


def warn_of_no_match(folder: Path, condition: str | None, number: int) -> None:
    """Print to standard error that none of `number` rows meets a condition."""
    print(f"sweep: none of {number} rows of {folder} matches {condition!r}", file=sys.stderr)


def save_output(path: Path, content: bytes | Iterable[bytes]) -> None:
    """Write output, whole or in pieces, to the path of `-o`; `-` is the standard output.

    Raises `InputError` where the file is part of a study's folder.
    """
    from sweep.runs import manifest, store

    named, folder = (
        path.name in (store.STUDY_FILE, store.POINTS_FILE, manifest.MANIFEST_FILE, store.LOG_FILE),
        path.parent,
    )
    if not named and folder.name in store.SUBFOLDERS:
        named, folder = True, folder.parent
    if named and (folder / store.STUDY_FILE).exists():
        raise InputError(f"-o = {path} is not allowed: a study's own file")
    to = Path("/dev/stdout") if path == Path("-") else path
    write_atomically(to, content if isinstance(content, bytes) else partial(_write_pieces, pieces=content))


def _write_pieces(path: Path, pieces: Iterable[bytes]) -> None:
    with path.open("wb") as file:
        file.writelines(pieces)

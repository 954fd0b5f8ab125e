"""Batch experiments with six-legged robots: where does a manoeuvre succeed, and how sure are we?

from sweep import load, run
"""

from typing import TYPE_CHECKING

from sweep.core.errors import Fault, InputError
from sweep.core.version import VERSION  # first of all: it notes the time

if TYPE_CHECKING:
    from collections.abc import Sequence
    from os import PathLike

    import pandas as pd

__version__ = VERSION
__all__ = ["Fault", "InputError", "load", "run"]


def run(*overrides: str) -> "pd.DataFrame":
    """Run the study that `overrides` select, as `sweep run` does, and return its finished rows as a data frame.

    Studies are kept in their folder, so a second call finishes or only reads them; a nominal rollout is one row
    and leaves no files. Raises `sweep.InputError`, whose message is one line.
    """
    from sweep import api  # the simulator takes seconds to import

    return api.run(list(overrides))


def load(
    folder: "str | PathLike[str]", where: str | None = None, columns: "Sequence[str] | None" = None
) -> "pd.DataFrame":
    """Return the finished rows of a study's folder, a row for each rollout and a column for each parameter or metric.

    Args:
        folder: Folder of results.
        where: Condition that chooses rows, such as `friction > 0.8`.
        columns: Names of columns or axes. Only these are read, so that two columns of a million rows take a second.

    Returns:
        The table. `attrs["units"]` has the unit of every column with a dimension, `attrs["study"]` the study's name.
        Of all columns, `rows.sweep` draws and replays rows (see `sweep.api.RowsAccessor`).

    Raises:
        InputError: The folder is damaged, or a name is unknown.
    """
    from sweep import api

    return api.load(folder, where, columns)

"""Batch experiments with six-legged robots: where does a manoeuvre succeed, and how sure are we?

from sweep import load, run
"""

from typing import TYPE_CHECKING

from sweep.core.errors import Fault, InputError
from sweep.core.version import VERSION  # first of all: it notes the time

if TYPE_CHECKING:
    from os import PathLike

    import pandas as pd

__version__ = VERSION
__all__ = ["Fault", "InputError", "load", "run"]


def run(*overrides: str) -> "pd.DataFrame":
    """Simulate what `sweep run` with the same `overrides` would, and give its rows as `load` does.

    Studies are kept in their folder, so a second call finishes or only reads them; a nominal rollout is one row
    and leaves no files. Raises `sweep.InputError`, whose message is one line.
    """
    from sweep import api  # the simulator takes seconds to import

    return api.run(list(overrides))


def load(folder: "str | PathLike[str]", where: str | None = None) -> "pd.DataFrame":
    """Finished rows of a study's folder that match `where`: one row a rollout, one column a parameter or figure.

    `attrs["units"]` has the unit of every column with a dimension, `attrs["study"]` the study's name. `rows.sweep`
    draws and replays them (see `sweep.api.Accessor`). Raises `sweep.InputError`.
    """
    from sweep import api

    return api.load(folder, where)

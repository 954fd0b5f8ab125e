"""Draws that are sought where failures are, in rounds: each is drawn by what the rows of those before it showed.

A search is a generator of rounds of draws that is sent what each of them showed, and returns what it has come to. It
is a function of the seed and of that alone, so that an interrupted study goes on where it was, and whoever has the
rows has the search.
"""

from collections.abc import Generator, Mapping
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from sweep.core.errors import InputError
from sweep.core.expressions import column, evaluate

if TYPE_CHECKING:
    import pandas as pd

KINDS = ("importance", "subset")
DIGITS = 6  # of what draws follow from: they are the same on machines whose last bits differ
EDGE = 2.0**-32  # of shares: no distribution is asked for its infinite ends
LEAD = "margin"  # what subset simulation goes by if not told


class Draws(NamedTuple):
    """A round of draws that are to be simulated."""

    shares: Float[np.ndarray, "n d"]  # quantiles, before axes are correlated
    numbers: Int[np.ndarray, " n"]  # of the draws: each has noise of its own
    columns: Mapping[str, np.ndarray]  # (n,) what else is kept of each, by the names of axes without a path


class Seen(NamedTuple):
    """What the rollouts of a round showed."""

    failed: Bool[np.ndarray, " n"]  # invalid ones among them
    lead: Float[np.ndarray, " n"]  # what shrinks before anything breaks

    def part(self, where: slice) -> "Seen":
        """The same of some of the draws."""
        return Seen(self.failed[where], self.lead[where])


Search = Generator[Draws, Seen, Any]


def seen(rows: "pd.DataFrame", draws: Draws, lead: str) -> Seen:
    """What the rows of a round showed. `lead` is a column, or what is reckoned from some; raises `InputError`."""
    here = rows.set_index("replicate").loc[draws.numbers]
    try:
        values = evaluate(lead, lambda name: here[column(here, name)].to_numpy())
        found = np.broadcast_to(np.asarray(values, dtype=float), len(here))
    except InputError:
        raise
    except (SyntaxError, TypeError, ValueError):
        raise InputError(f"study.design.lead = {lead!r} is not allowed: a column of numbers, such as {LEAD}") from None
    return Seen((here["outcome"] != "success").to_numpy(), found)


def replayed(search: Search, rows: "pd.DataFrame", lead: str) -> Any:
    """What a search came to in `rows`; None where they end before it."""
    try:
        draws = next(search)
        while np.isin(draws.numbers, rows["replicate"]).all():
            draws = search.send(seen(rows, draws, lead))
    except StopIteration as end:
        return end.value
    return None

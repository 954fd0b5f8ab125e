"""Adaptive sampling of failures: each round draws from a proposal fitted to the rows of earlier rounds.

A search is a generator: it yields rounds of draws, receives a summary of each round, and returns its result. It
depends on the seed and the summaries alone, so an interrupted study continues where it was, and the search can be
replayed from stored rows.
"""

from collections.abc import Generator, Mapping
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from sweep.core.errors import InputError
from sweep.core.expressions import evaluate_expression, find_column

if TYPE_CHECKING:
    import pandas as pd

PROPOSAL_DECIMALS = 6  # decimals of proposals, so that draws are equal on machines whose last bits differ
MIN_QUANTILE = 2.0**-32  # of quantiles, so that none is infinite
DEFAULT_LEAD_COLUMN = "margin"  # column that subset simulation follows by default


class RoundDraws(NamedTuple):
    """Parameter draws of one round of adaptive sampling: the search yields them, and the study simulates them."""

    quantiles: Float[np.ndarray, "n d"]  # quantiles, before axes are correlated
    numbers: Int[np.ndarray, " n"]  # of the draws: each has noise of its own
    columns: Mapping[str, np.ndarray]  # (n,) what else is kept of each, by the names of axes without a path


class RoundSummary(NamedTuple):
    """Outcomes of the rollouts of one round, from which adaptive sampling chooses the next draws."""

    failed: Bool[np.ndarray, " n"]  # invalid ones among them
    lead: Float[np.ndarray, " n"]  # the smaller, the nearer to failure

    def select_draws(self, rows: slice) -> "RoundSummary":
        """Return the outcomes of some of the round's draws, chosen by a slice."""
        return RoundSummary(self.failed[rows], self.lead[rows])


SearchGenerator = Generator[RoundDraws, RoundSummary, Any]


def summarize_round(rows: "pd.DataFrame", draws: RoundDraws, lead: str) -> RoundSummary:
    """Return which draws of a round failed, and their values of `lead`, a metric that shrinks towards failure.

    Args:
        rows: Finished rows of the study, including those of the round.
        draws: The n draws of the round.
        lead: A column, or an expression of columns, whose value shrinks towards failure.

    Returns:
        Failures and values of `lead`, both (n,) and in the order of the draws.

    Raises:
        InputError: `lead` is no number of the rows.
    """
    here = rows.set_index("replicate").loc[draws.numbers]
    try:
        values = evaluate_expression(lead, lambda name: here[find_column(here, name)].to_numpy())
        found = np.broadcast_to(np.asarray(values, dtype=float), len(here))
    except InputError:
        raise
    except (SyntaxError, TypeError, ValueError):
        raise InputError(
            f"study.design.lead = {lead!r} is not allowed: a column of numbers, such as {DEFAULT_LEAD_COLUMN}"
        ) from None
    return RoundSummary((here["outcome"] != "success").to_numpy(), found)

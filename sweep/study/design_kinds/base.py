"""The interface of study designs: how parameters are drawn, and which statistics the rows allow.

A design is a subclass of `Design`, or of `AdaptiveDesign` if it decides about its next points from finished rows. Its
dataclass fields are settings of its own under `study.design`. All other rooms ask the design of a study, and name none.
"""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple, Protocol, Self

import numpy as np
from jaxtyping import Bool, Float, Int

from sweep.core.errors import InputError
from sweep.study.adaptive_sampling import (
    DEFAULT_LEAD_COLUMN,
    MIN_QUANTILE,
    RoundDraws,
    RoundSummary,
    SearchGenerator,
    summarize_round,
)

if TYPE_CHECKING:
    import pandas as pd


GRIDS = FULL, ONE_AT_A_TIME = "full", "one_at_a_time"  # how listed axes are combined


class SamplingUnit(NamedTuple):
    """Unit that a design draws independently, such as a draw or a trajectory; its rows count as one observation."""

    name: str
    # whether draws of a unit are spread more evenly than independent ones: intervals then follow from the spread
    # between units, and a test that takes draws for independent is safe
    is_even: bool = False
    # whether units are independent of each other, rather than spread more evenly over the axes
    is_independent: bool = True

    @property
    def plural(self) -> str:
        """Return the plural of the unit's name."""
        return f"{self.name[:-1]}ies" if self.name.endswith("y") else f"{self.name}s"


DRAW = SamplingUnit("draw")  # with all its replicates and grid points
EVEN_DRAW = SamplingUnit("draw", is_independent=False)  # likewise, of a design whose draws fill space evenly


class SensitivityMethod(StrEnum):
    """Sensitivity indices that can be estimated from the draws of a design."""

    GIVEN_DATA = "from any draws that follow the distributions: PAWN, RBD-FAST"
    SOBOL_INDICES = "Sobol indices, from blocks A, A with one column of B for each axis, B"
    ELEMENTARY_EFFECTS = "elementary effects, from trajectories that change one axis after the other"
    NONE = "none"

    @property
    def needs_special_design(self) -> bool:
        """Whether the indices need draws of a special design."""
        return self in (SensitivityMethod.SOBOL_INDICES, SensitivityMethod.ELEMENTARY_EFFECTS)


class TrajectoryGrid(NamedTuple):
    """Grid of quantiles on which the trajectories of Morris' method move."""

    levels: int  # values of an axis
    low: float  # smallest quantile
    high: float  # largest quantile

    @property
    def step(self) -> float:
        """Length of a step of Morris' trajectories, as a share of the range between lowest and highest quantile."""
        return self.levels / (2 * (self.levels - 1))


class DrawContext(NamedTuple):
    """What a design receives from its study to make draws: seed, names and distributions."""

    axes: tuple[str, ...]  # names of the drawn axes
    seed: int  # of all draws
    study: str = ""  # its name, for messages


class FailureEstimate(Protocol):
    """An estimate of the probability of failure; `str()` of it gives one line with row counts and advice."""

    @property
    def probability(self) -> float:
        """The estimated probability of failure."""
        ...

    @property
    def interval(self) -> tuple[float, float]:
        """Lower and upper end of the 95 % interval; NaN where it is unknown."""
        ...

    @property
    def is_reliable(self) -> bool:
        """Whether the estimate can be trusted; if not, its text says why."""
        ...


@dataclass(frozen=True)
class Design(ABC):
    """Base class of designs: how listed values are combined, and how parameters with a distribution are drawn."""

    kind: ClassVar[str]  # how drawn axes are sampled
    meaning: ClassVar[str]  # in one line: what to use it for
    num_meaning: ClassVar[str] = ""  # what `num` counts, if not draws
    position: ClassVar[int] = 100  # in lists of kinds; kinds of one position are sorted by name

    # what the draws allow
    follows_distributions: ClassVar[bool] = True  # whether every draw follows the distributions of the axes
    has_independent_draws: ClassVar[bool] = False  # whether, besides, draws do not depend on each other
    is_low_discrepancy: ClassVar[bool] = False  # whether draws form a sequence that fills space evenly
    gives_rate: ClassVar[bool] = True  # whether some draws are a plain sample, see `select_rate_draws`
    allows_correlation: ClassVar[bool] = True  # whether `study.design.correlation` may relate axes
    sensitivity: ClassVar[SensitivityMethod] = SensitivityMethod.GIVEN_DATA
    trajectory_grid: ClassVar[TrajectoryGrid | None] = None  # of designs for elementary effects

    # how a stored study can be extended
    can_add_draws: ClassVar[bool] = False  # whether a larger `num` leaves the first draws as they are
    growing_settings: ClassVar[tuple[str, ...]] = ("num",)  # settings that may change between runs into one folder

    grid: str = FULL  # of listed axes, one of `GRIDS`
    num: int = 0  # draws
    # one, other, coefficient: of pairs of drawn axes, by the normals of a Gaussian copula
    correlation: tuple[Any, ...] = ()

    def check(self, drawn: Sequence[str], listed: Sequence[str]) -> None:
        """Raise `InputError` if a setting of the design is not allowed or does not fit the varied parameters (axes).

        Args:
            drawn: Names of the axes with a distribution.
            listed: Names of the axes with listed values.
        """
        if self.correlation and not self.allows_correlation:
            raise InputError(
                f"study.design.correlation is not allowed with {self.kind}, which varies one axis at a time"
            )
        least = 1 if drawn else 0
        if self.num < least:
            of = f" for {', '.join(drawn)}" if drawn else ""
            raise InputError(f"study.design.num = {self.num} is not allowed: at least {least}{of}")
        if self.num and not drawn:
            raise InputError(f"study.design.num = {self.num} is not allowed: no axis has a distribution")

    @property
    def is_full_grid(self) -> bool:
        """Whether every combination of listed values is a point (a full grid)."""
        return self.grid == FULL

    @property
    def is_one_at_a_time(self) -> bool:
        """Whether each listed axis varies alone, with all others at nominal values."""
        return self.grid == ONE_AT_A_TIME

    @property
    def precision_warning(self) -> str | None:
        """Text of a warning if the design's settings make its statistics less precise, else None."""
        return None

    @property
    def sampling_unit(self) -> SamplingUnit:
        """The unit that the design draws independently, such as a single draw or a trajectory."""
        return DRAW

    def block_size(self, d: int) -> int:
        """Return the number of consecutive draws that depend on each other, for `d` drawn axes."""
        return 1

    def count_draws(self, d: int) -> int:
        """Return the number of draws for `d` drawn axes; the maximum for adaptive designs."""
        return self.num * self.block_size(d)

    def unit_numbers(self, draws: Int[np.ndarray, " n"], d: int) -> Int[np.ndarray, " n"] | None:
        """Return for each draw the number of the sampling unit (draws that depend on each other) that holds it.

        Args:
            draws: Numbers of draws.
            d: Number of drawn axes.

        Returns:
            The same number for draws that depend on each other; None if the draws are no random sample.
        """
        return draws // self.block_size(d)

    def select_rate_draws(self, draws: Int[np.ndarray, " n"], d: int) -> Bool[np.ndarray, " n"]:
        """Return which draws (n,) are a plain random sample, whose share of successes estimates the success rate.

        Args:
            draws: Numbers of draws.
            d: Number of drawn axes.
        """
        return np.full(len(draws), self.gives_rate)

    def resize_to_min_draws(self, least: int, d: int) -> Self:
        """Return a copy of the design with the smallest setting `num` that makes at least `least` draws of `d` axes."""
        return replace(self, num=-(-least // replace(self, num=1).count_draws(d)))

    @abstractmethod
    def sample(self, ctx: DrawContext) -> Float[np.ndarray, "n d"]:
        """Draw uniform numbers from 0 to 1 (quantiles) for all drawn axes.

        Args:
            ctx: Axes and seed. Take all randomness from the seed.

        Returns:
            A row for each of the n = `count_draws` draws and a column for each axis.
        """

    def correlate_quantiles(
        self, shares: Float[np.ndarray, "n d"], root: Float[np.ndarray, "d d"]
    ) -> Float[np.ndarray, "n d"]:
        """Correlate independent quantiles by a Gaussian copula.

        Args:
            shares: Quantiles.
            root: Lower Cholesky root of the correlation matrix.

        Returns:
            The quantiles of the correlated axes.
        """
        from scipy.special import ndtr, ndtri  # slow to import

        return np.clip(ndtr(ndtri(shares) @ root.T), MIN_QUANTILE, 1 - MIN_QUANTILE)


class AdaptiveDesign(Design):
    """Base class of designs that search for failures: each round of draws depends on rows of earlier rounds."""

    columns: ClassVar[tuple[str, ...]]  # what it stores of each draw, as `axis.NAME`
    follows_distributions: ClassVar[bool] = False
    gives_rate: ClassVar[bool] = False
    sensitivity: ClassVar[SensitivityMethod] = SensitivityMethod.NONE

    def check(self, drawn: Sequence[str], listed: Sequence[str]) -> None:
        """Raise `InputError` if an axis has listed values, or the name of a column that the design stores.

        Args:
            drawn: Names of the axes with a distribution.
            listed: Names of the axes with listed values.
        """
        super().check(drawn, listed)
        if listed:
            raise InputError(f"study.design.kind = {self.kind} is not allowed with listed axes: {', '.join(listed)}")
        if taken := {*drawn} & {*self.columns}:
            raise InputError(f"study.axes.{min(taken)} is not allowed: {self.kind} has a column of that name")

    def unit_numbers(self, draws: Int[np.ndarray, " n"], d: int) -> None:
        """Return None in place of numbers of independent units: all adaptive draws depend on earlier failures."""

    def sample(self, ctx: DrawContext) -> Float[np.ndarray, "n d"]:
        """Return the draws of the first round of adaptive sampling, as quantiles (n, d)."""
        return next(self.start_search(ctx)).quantiles

    @abstractmethod
    def start_search(self, ctx: DrawContext) -> SearchGenerator:
        """Start the search for failures: a generator that yields rounds of draws and receives their outcomes."""

    @property
    @abstractmethod
    def min_round_size(self) -> int:
        """Number of rollouts in the smallest round, which determines the batch width."""

    @abstractmethod
    def estimate_failure(self, rows: "pd.DataFrame", ctx: DrawContext) -> FailureEstimate:
        """Estimate the probability of failure.

        Args:
            rows: All rows of the study.
            ctx: Axes and seed of the study.

        Raises:
            InputError: The search is not finished.
        """

    @abstractmethod
    def weigh_rows(
        self, rows: "pd.DataFrame", ctx: DrawContext
    ) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
        """Return weights that turn rows drawn adaptively into estimates for the nominal distribution.

        Args:
            rows: All rows of the study.
            ctx: Axes and seed of the study.

        Returns:
            Two arrays (n,). With the first as weights, rows represent the nominal distribution. The second is each
            row's share in the failure probability, up to a common factor; 0 for rows that do not count as failures.

        Raises:
            InputError: The search is not finished.
        """

    def summarize_finished_round(self, rows: "pd.DataFrame", draws: RoundDraws) -> RoundSummary:
        """Return which draws of a round failed, and their values of the metric that shrinks towards failure.

        Args:
            rows: Finished rows of the study, including those of the round.
            draws: The draws of the round.

        Returns:
            Failures, and the column that shrinks towards failure.

        Raises:
            InputError: The column is no number of the rows.
        """
        return summarize_round(rows, draws, DEFAULT_LEAD_COLUMN)

    def replay_search(self, rows: "pd.DataFrame", ctx: DrawContext) -> Any:
        """Run the search for failures again with the outcomes of stored rows, without simulating.

        Args:
            rows: Finished rows of the study.
            ctx: Axes and seed of the study.

        Returns:
            The result of the search; None where rows of a round are missing.
        """
        search = self.start_search(ctx)
        try:
            draws = next(search)
            while np.isin(draws.numbers, rows["replicate"]).all():
                draws = search.send(self.summarize_finished_round(rows, draws))
        except StopIteration as end:
            return end.value
        return None

"""Study design: scrambled Sobol sequences, whose draws fill space evenly."""

import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from sweep.core.errors import InputError
from sweep.study.design_kinds.base import EVEN_DRAW, Design, DrawContext, SamplingUnit

SCRAMBLE = SamplingUnit("scramble", is_even=True)


@dataclass(frozen=True)
class Sobol(Design):
    """Draws from scrambled Sobol sequences, taken from each independent scramble in turn; new draws come last."""

    kind: ClassVar[str] = "sobol"
    meaning: ClassVar[str] = (
        "means of smooth columns with the least scatter; `num` a power of 2, with several `scrambles`"
    )
    num_meaning: ClassVar[str] = "those of one scramble"
    position: ClassVar[int] = 2
    is_low_discrepancy: ClassVar[bool] = True
    can_add_draws: ClassVar[bool] = True

    scrambles: int = 1  # independent repetitions, which tell its error

    def check(self, drawn: Sequence[str], listed: Sequence[str]) -> None:
        """Raise `InputError` if the number of scrambles is 0.

        Args:
            drawn: Names of the axes with a distribution.
            listed: Names of the axes with listed values.
        """
        super().check(drawn, listed)
        if self.scrambles < 1:
            raise InputError(f"study.design.scrambles = {self.scrambles} is not allowed: at least 1")

    @property
    def precision_warning(self) -> str | None:
        """A warning if `num` is not a power of 2, or None."""
        return warn_of_unbalanced_draws(self.num)

    @property
    def sampling_unit(self) -> SamplingUnit:
        """The scramble, which is the unit drawn independently.

        One scramble has no spread. Independent draws vary more, so that their interval is safe.
        """
        return SCRAMBLE if self.scrambles > 1 else EVEN_DRAW

    def count_draws(self, d: int) -> int:
        """Return the number of draws in all scrambles."""
        return self.num * self.scrambles

    def unit_numbers(self, draws: np.ndarray, d: int) -> np.ndarray:
        """Return the number (n,) of the scrambled sequence that each draw is from; with one sequence, that of the draw.

        Args:
            draws: Numbers of draws (n,).
            d: Number of drawn axes.
        """
        return draws % self.scrambles if self.scrambles > 1 else draws

    def sample(self, ctx: DrawContext) -> np.ndarray:
        """Draw from all scrambled Sobol sequences in turn."""
        from scipy.stats import qmc  # slow to import

        d = len(ctx.axes)
        with warnings.catch_warnings(action="ignore", category=UserWarning):  # of its balance: see `warning`
            rngs = [np.random.default_rng([ctx.seed, k]) for k in range(self.scrambles)]
            parts = [qmc.Sobol(d, rng=rng).random(self.num) for rng in rngs]
        return np.stack(parts, axis=1).reshape(-1, d)


def warn_of_unbalanced_draws(num: int) -> str | None:
    """Return a warning if the number of draws of a Sobol sequence is not a power of 2, else None."""
    if num & (num - 1):
        return f"study.design.num = {num} is not a power of 2: estimates from Sobol draws get less precise"
    return None


DESIGNS = {"sobol": Sobol}

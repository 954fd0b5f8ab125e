"""Study design: Saltelli's blocks of d + 2 draws for Sobol indices, which share coordinates of two samples A and B."""

import warnings
from typing import ClassVar

import numpy as np

from sweep.study.design_kinds.base import Design, DrawContext, SamplingUnit, SensitivityMethod
from sweep.study.design_kinds.sobol import warn_of_unbalanced_draws


class Saltelli(Design):
    """Saltelli's design for Sobol indices: blocks of a draw A, d copies of A with one value of a draw B, and B."""

    kind: ClassVar[str] = "saltelli"
    meaning: ClassVar[str] = "Sobol indices"
    num_meaning: ClassVar[str] = "the base sample N of N (d + 2)"
    position: ClassVar[int] = 3
    follows_distributions: ClassVar[bool] = False
    allows_correlation: ClassVar[bool] = False
    sensitivity: ClassVar[SensitivityMethod] = SensitivityMethod.SOBOL_INDICES

    @property
    def precision_warning(self) -> str | None:
        """A warning if `num` is not a power of 2, or None."""
        return warn_of_unbalanced_draws(self.num)

    @property
    def sampling_unit(self) -> SamplingUnit:
        """The block of d + 2 draws, whose rows count as one observation."""
        return SamplingUnit("block", is_independent=False)

    def block_size(self, d: int) -> int:
        """Return the number of draws in a block: d + 2."""
        return d + 2

    def select_rate_draws(self, draws: np.ndarray, d: int) -> np.ndarray:
        """Return which draws (n,) belong to sample A (the first of each block) and form a plain sample."""
        return draws % self.block_size(d) == 0

    def sample(self, ctx: DrawContext) -> np.ndarray:
        """Draw the blocks of samples A and B from a Sobol sequence."""
        from SALib.sample import sobol  # slow to import

        problem = {"num_vars": len(ctx.axes), "names": [*ctx.axes], "bounds": [[0.0, 1.0]] * len(ctx.axes)}
        with warnings.catch_warnings(action="ignore", category=UserWarning):  # of its balance: see `warning`
            return sobol.sample(problem, self.num, calc_second_order=False, seed=ctx.seed)


DESIGNS = {"saltelli": Saltelli}

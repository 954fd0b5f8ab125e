"""Study design: Latin hypercube, one draw in each of `num` equally likely strata of every axis."""

from typing import ClassVar

import numpy as np

from sweep.study.design_kinds.base import EVEN_DRAW, Design, DrawContext, SamplingUnit


class LatinHypercube(Design):
    """Latin hypercube sampling: one draw in each of `num` strata of every axis; another `num` changes every draw."""

    kind: ClassVar[str] = "latin_hypercube"
    meaning: ClassVar[str] = "rates and means with less scatter; the number of draws is fixed"
    position: ClassVar[int] = 1
    growing_settings: ClassVar[tuple[str, ...]] = ()

    @property
    def sampling_unit(self) -> SamplingUnit:
        """The single draw counts as one observation; draws fill each axis more evenly than independent ones."""
        return EVEN_DRAW

    def sample(self, ctx: DrawContext) -> np.ndarray:
        """Draw quantiles (n, d), one in each of n equal strata of every axis."""
        from scipy.stats import qmc  # slow to import

        return qmc.LatinHypercube(len(ctx.axes), rng=np.random.default_rng([ctx.seed])).random(self.num)

    def correlate_quantiles(self, shares: np.ndarray, root: np.ndarray) -> np.ndarray:
        """Correlate draws by reordering alone, so that every stratum keeps its draw (Iman and Conover 1982).

        Args:
            shares: Quantiles (n, d).
            root: Lower Cholesky root of the correlation matrix (d, d).

        Returns:
            The quantiles of the correlated axes (n, d).
        """
        from scipy.special import ndtri  # slow to import

        places = np.argsort(np.argsort(ndtri(shares) @ root.T, axis=0), axis=0)
        return np.take_along_axis(np.sort(shares, axis=0), places, axis=0)


DESIGNS = {"latin_hypercube": LatinHypercube}

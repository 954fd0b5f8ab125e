"""Study design: independent draws from the distributions of the axes."""

from typing import ClassVar

import numpy as np

from sweep.study.design_kinds.base import Design, DrawContext
from sweep.study.point_ids import text_hash

RARE_PROBABILITY = 0.1  # failure probability from which on independent draws are as good as a search


class MonteCarlo(Design):
    """Independent random draws; adding draws or one more axis leaves the existing draws as they are."""

    kind: ClassVar[str] = "monte_carlo"
    meaning: ClassVar[str] = "rates; you can add draws later"
    position: ClassVar[int] = 0
    has_independent_draws: ClassVar[bool] = True
    can_add_draws: ClassVar[bool] = True

    def sample(self, ctx: DrawContext) -> np.ndarray:
        """Draw independent uniform numbers, from a separate random stream for each axis."""
        rngs = [np.random.default_rng([ctx.seed, int(text_hash(name))]) for name in ctx.axes]
        return np.stack([rng.random(self.num) for rng in rngs], axis=1)


def advise_independent_draws(probability: float) -> str:
    """Return advice to use independent draws if failures are not rare; else an empty text."""
    return (
        f"; it is not rare: study.design.kind={MonteCarlo.kind} is as precise" if probability > RARE_PROBABILITY else ""
    )


DESIGNS = {"monte_carlo": MonteCarlo}

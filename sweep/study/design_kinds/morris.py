"""Study design: Morris' trajectories for elementary effects, which change one axis after the other."""

from typing import ClassVar

import numpy as np

from sweep.study.design_kinds.base import Design, DrawContext, SamplingUnit, SensitivityMethod, TrajectoryGrid


class Morris(Design):
    """Morris' screening design: trajectories of d + 1 draws, each of which changes one axis, on a grid of quantiles.

    The grid leaves out 0 and 1, where some distributions are infinite.
    """

    kind: ClassVar[str] = "morris"
    meaning: ClassVar[str] = "screening of many axes"
    num_meaning: ClassVar[str] = "paths"
    position: ClassVar[int] = 4
    follows_distributions: ClassVar[bool] = False
    gives_rate: ClassVar[bool] = False
    allows_correlation: ClassVar[bool] = False
    sensitivity: ClassVar[SensitivityMethod] = SensitivityMethod.ELEMENTARY_EFFECTS
    trajectory_grid: ClassVar[TrajectoryGrid] = TrajectoryGrid(4, 0.005, 0.995)

    @property
    def sampling_unit(self) -> SamplingUnit:
        """The trajectory, which is the unit drawn independently."""
        return SamplingUnit("trajectory")

    def block_size(self, d: int) -> int:
        """Return the number of draws in a trajectory: d + 1."""
        return d + 1

    def sample(self, ctx: DrawContext) -> np.ndarray:
        """Draw the trajectories, as quantiles of the axes."""
        from SALib.sample import morris  # slow to import

        grid = self.trajectory_grid
        problem = {"num_vars": len(ctx.axes), "names": [*ctx.axes], "bounds": [[grid.low, grid.high]] * len(ctx.axes)}
        return morris.sample(problem, self.num, num_levels=grid.levels, seed=ctx.seed)


DESIGNS = {"morris": Morris}

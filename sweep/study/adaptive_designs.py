"""Settings of adaptive designs, and the search that each of them runs."""

import numpy as np

from sweep.core.errors import InputError
from sweep.study import adaptive_sampling, importance_sampling, subset_simulation
from sweep.study.designs import Axis, Design


def check_design(design: Design, axes: tuple[Axis, ...]) -> None:
    """Check the settings of an adaptive design.

    Args:
        design: The design, of kind `importance` or `subset`.
        axes: Axes of the study.

    Raises:
        InputError: A setting is not allowed, or an axis is listed or has a reserved name.
    """
    if listed := [a.name for a in axes if a.values is not None]:
        raise InputError(f"study.design.kind = {design.kind} is not allowed with listed axes: {', '.join(listed)}")
    if taken := {a.name for a in axes} & {"weight", "round", "run", "level", "step", "chain"}:
        raise InputError(f"study.axes.{min(taken)} is not allowed: {design.kind} has a column of that name")
    if not 1 <= design.wide <= 5:
        raise InputError(f"study.design.wide = {design.wide:g} is not allowed: from 1 to 5")
    for key in ("rounds", "runs"):
        if (value := getattr(design, key)) < 1:
            raise InputError(f"study.design.{key} = {value} is not allowed: at least 1")
    if not adaptive_sampling.EDGE < design.target < 1:
        raise InputError(
            f"study.design.target = {design.target:g} is not allowed: above {adaptive_sampling.EDGE:.2g} and below 1"
        )
    steps = 1 / design.share if design.share > 0 else 0
    if not 0 < design.share <= 0.5 or abs(steps - round(steps)) > 1e-9:
        raise InputError(
            f"study.design.share = {design.share:g} is not allowed: 1 divided by a whole number of at least 2"
        )
    if design.kind == "importance" and design.num < 2:  # of which one alone tells no error
        raise InputError(f"study.design.num = {design.num} is not allowed: at least 2")
    if design.kind == "subset" and (design.num < subset_simulation.FEWEST * steps or design.num % round(steps)):
        least = f"a multiple of {steps:.0f}, at least {subset_simulation.FEWEST * steps:.0f}"
        raise InputError(
            f"study.design.num = {design.num} is not allowed: {least}with study.design.share = {design.share:g}"
        )


def make_search(axes: tuple[Axis, ...], design: Design, seed: int) -> adaptive_sampling.Search:
    """Start the search of an adaptive design, a generator of rounds of draws.

    Args:
        axes: Axes of the study; those with a distribution are drawn.
        design: The design, of kind `importance` or `subset`.
        seed: Seed of all draws.

    Returns:
        The search, see `sweep.study.adaptive_sampling`.
    """
    drawn = sum(axis.distribution is not None for axis in axes)
    if design.kind == "subset":
        return subset_simulation.start_search(drawn, design.level_settings, design.runs, seed)
    return importance_sampling.start_search(drawn, design.num, design.wide, design.rounds, seed)


def extreme_draws(axes: tuple[Axis, ...]) -> adaptive_sampling.Draws:
    """Return two draws with all drawn axes at the lower, and at the upper ends of their ranges."""
    drawn = sum(axis.distribution is not None for axis in axes)
    return adaptive_sampling.Draws(np.repeat([[0.0], [1.0]], drawn, axis=1), np.arange(2), {})

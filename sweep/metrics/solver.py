"""Validity of the simulation: finite numbers, residual of the contact solver, energy balance.

Every bound is relative to what it doubts, so that a large robot on a long way is not trusted less than a small one.
"""

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from sweep.core.constants import GRAVITY
from sweep.core.metric import Cause, Metric
from sweep.metrics.tick import MetricContext, RolloutEnd, RolloutStart
from sweep.models.robot import total_mass

# The bounds are from 1,500 rollouts with sizes wrong by up to 2 %, each again at half the time step: below 0.4 of the
# weight 1 in 690 outcomes differed, from there to 2 weights 4 in 140; no success was unsettled for more than 0.3 % of
# its time, nor gained more than 1e-4.
UNSETTLED_RESIDUAL = 0.1  # of the weight, a residual that counts for the share of ticks


class SolverValidity(NamedTuple):
    """State of the metrics for numerical validity: finiteness, contact-solver residual (N), energies and works (J)."""

    is_finite: Bool[Array, ""]
    largest_residual: Float[Array, ""]
    unsettled_time: Float[Array, ""]
    start_energy: Float[Array, ""]
    total_work: Float[Array, ""]
    drive_work: Float[Array, ""]
    largest_energy_growth: Float[Array, ""]
    largest_growth_ratio: Float[Array, ""]


def begin(start: RolloutStart) -> SolverValidity:
    """Return the state of the validity metrics before the first tick: all numbers finite, no residual."""
    zero = jnp.zeros((), start.energy.dtype)
    return SolverValidity(jnp.asarray(True), zero, zero, start.energy, zero, zero, zero, zero)


def update(state: SolverValidity, ctx: MetricContext) -> SolverValidity:
    """Update the contact solver's residual, and the growth of energy beyond the work of drives and pushes."""
    tick, robot = ctx.report, ctx.world.robot
    weight = GRAVITY * total_mass(robot)
    work, effort = state.total_work + tick.work, state.drive_work + tick.positive_work
    gain = jnp.maximum(tick.energy - state.start_energy - work, 0.0)
    finite = jnp.isfinite(tick.energy) & jnp.all(jnp.isfinite(tick.joints))
    return SolverValidity(
        state.is_finite & finite,
        jnp.maximum(state.largest_residual, tick.residual),
        state.unsettled_time + ctx.period * (tick.residual > UNSETTLED_RESIDUAL * weight),
        state.start_energy,
        work,
        effort,
        jnp.maximum(state.largest_energy_growth, gain),
        jnp.maximum(state.largest_growth_ratio, gain / (effort + weight * robot.body_length)),
    )


def compute(state: SolverValidity, rollout: RolloutEnd) -> dict[str, Array]:
    """Return the largest contact-solver residual in N and over the weight, and the growth of energy, by column."""
    return {
        "finite": state.is_finite,
        "solver_residual_max_n": state.largest_residual,
        "solver_residual_over_weight": state.largest_residual / (GRAVITY * total_mass(rollout.world.robot)),
        "solver_unsettled_share": state.unsettled_time / jnp.maximum(rollout.time, 1e-9),
        "energy_gain_max_j": state.largest_energy_growth,
        "energy_gain_ratio": state.largest_growth_ratio,
    }


METRIC = Metric(
    begin,
    update,
    compute,
    {
        "finite": "whether energy and joints were finite throughout",
        "solver_residual_max_n": "largest force that the contact solver left unexplained",
        "solver_residual_over_weight": "largest unexplained contact force over the robot's weight",
        "solver_unsettled_share": f"share of time with an unexplained contact force above {UNSETTLED_RESIDUAL:g} of "
        "the weight",
        "energy_gain_max_j": "largest growth of mechanical energy beyond the drives' work",
        "energy_gain_ratio": "largest growth over the drives' positive work until then and the energy that "
        "lifts the robot by its length",
    },
    (
        Cause("not_finite", "a number was not finite", "finite", 1.0, key="", below=True, invalid=True),
        Cause(
            "solver",
            "the contact solver left more than solver_residual_max of the weight unexplained",
            "solver_residual_over_weight",
            2.0,
            key="solver_residual_max",
            invalid=True,
        ),
        Cause(
            "unsettled",
            "the contact solver was unsettled for more than solver_unsettled_share_max of the time",
            "solver_unsettled_share",
            0.005,
            known_at="end",
            invalid=True,
        ),
        Cause(
            "energy",
            "mechanical energy grew beyond the drives' work by more than energy_gain_ratio_max",
            "energy_gain_ratio",
            0.005,
            invalid=True,
        ),
    ),
)

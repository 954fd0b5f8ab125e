"""Score of a plan's free numbers, from the deficits of its margins over draws of the belief, without physics.

A margin has an aim. Its deficit is the amount by which it falls short of the aim, in units that make margins
comparable.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from fnmatch import fnmatchcase
from typing import Any, NamedTuple, cast

import jax
import jax.numpy as jnp
import numpy as np

from sweep.controllers.plan import Plan
from sweep.core.errors import InputError, require_choice
from sweep.models.case import Case
from sweep.models.obstacles.ball import Ball
from sweep.planning import ball_margins, forces, kinematic_margins, plan_table
from sweep.planning.forces import LOAD, PlannedForces

# default aims (m, rad/s, shares of the weight); a margin without an aim does not count
DEFAULT_AIMS = {
    "base": 0.02,
    "links": 0.003,
    "legs": 0.025,
    "body": 0.02,
    "fold": 0.003,
    "reach": 0.01,
    "swing": 0.015,
    "rate": -6.0,
    "edge": 0.02,
    "support": 0.02,
    "hold": 0.01,
}
DEFAULT_SCALE = 0.01  # m, unit of the deficit of a margin
SCALES = {"rate": 1.0, "hold": 0.01, "speed": 0.02}  # units of the deficits of other margins than lengths
CAP_TOLERANCE = 0.1  # units of deficit that a margin may lose by `PlanScore.cap_aims_at_margins`
MIN_PHASES, MAX_PHASE_INTERVAL = (
    11,
    0.05,
)  # least number of phases of a stage; largest time between them (s), some cm of a swing
WORST_PHASES, DRAWS_PER_CALL = (
    3,
    8,
)  # phases of a stage that linear programs consider; draws that a core evaluates together
DIFFERENCE_SHARE, EQUAL_DEFICIT = (
    0.1,
    1e-3,
)  # share of a number's step for a finite difference; deficits that differ by less are equal
MAX_DEFICIT = 1e3  # largest deficit, also that of nan
TICK_PERIOD, DURATION_FACTOR = (
    0.04,
    1.05,
)  # tick (s) of a plan on a ball; its duration over that of its stages, as it may wait
BALL_MARGINS = ("zmp", "speed")  # margins that only a plan on a ball has
SETS_NDIM = 3  # axes of sets of numbers: set, draw, number
MANOEUVRE = "manoeuvre"  # first word of paths outside the plan table


class MarginAim(NamedTuple):
    """Least value that an optimized plan's margin (such as reach) should have in stages whose names match a pattern."""

    margin: str
    stages: str  # pattern of their names
    value: float


class PlanScore:
    """Margins of a plan, and how far they miss their aims, as functions of its free numbers and draws of the belief.

    The worst phases of every stage count. A plan on a ball is played by its tracker. Other plans are posed by inverse
    kinematics at evenly spaced phases of a stage. Their number is that of the last pattern in `moments` that matches
    the stage, or at least `MIN_PHASES`, and `MAX_PHASE_INTERVAL` in time.

    Args:
        case: The nominal case.
        free: Paths of the free numbers.
        aims: Aims beside those of `DEFAULT_AIMS`; a later aim of the same margin and stage takes precedence.
        patterns: Patterns of the stages that count.
        moments: Numbers of phases by pattern of the stage.
        hold: Whether the force reserve counts too.
        width: Largest number of sets of numbers in a call of `margins`.

    Raises:
        InputError: A pattern or a margin matches nothing, or the plan has no forces to search for.
    """

    def __init__(
        self,
        case: Case,
        free: Sequence[str],
        aims: Sequence[MarginAim],
        patterns: Sequence[str],
        moments: Sequence[tuple[str, int]],
        hold: bool,
        width: int,
    ):
        plan = jax.eval_shape(case.manoeuvre.plan, jax.tree.map(jnp.asarray, case))
        names, judged = plan.names, [name for name, law in zip(plan.names, plan.laws, strict=True) if law != LOAD]
        asked = [("--stages", text) for text in patterns] + [("--moments", text) for text, _ in moments]
        for flag, pattern in (*asked, *(("--need", aim.stages) for aim in aims)):
            if not any(fnmatchcase(name, pattern) for name in judged):
                raise InputError(f"{flag} = {pattern} names no stage of {', '.join(judged)}")
        self._is_on_ball = type(case.obstacle) is Ball  # a ball that leans on something is taken to rest
        if hold and not case.manoeuvre.plans_forces:
            raise InputError(f"--forces is not allowed: manoeuvre.kind = {case.manoeuvre.kind} plans none")
        if hold and self._is_on_ball:
            raise InputError("--forces is not allowed: plans on a ball have no static contact forces")
        available = (
            *kinematic_margins.PoseMargins._fields,
            *(BALL_MARGINS if self._is_on_ball else ("hold",) if hold else ()),
        )
        for aim in aims:
            require_choice(aim.margin, available, f"--need: margin {aim.margin}")
        chosen = [k for k, name in enumerate(names) if name in judged and any(fnmatchcase(name, p) for p in patterns)]
        self.stages = [names[k] for k in chosen]
        self.aims = [MarginAim(margin, "*", value) for margin, value in DEFAULT_AIMS.items()] + list(aims)
        self.case, self._free, self._width = case, tuple(free), width
        self._formulas = plan_table.formula_values(case)
        time = np.asarray(jax.jit(lambda: case.manoeuvre.plan(case).duration)(), float)
        self._ticks = math.ceil(DURATION_FACTOR * time.sum() / TICK_PERIOD) + len(names)
        counts = np.maximum(np.ceil(time[chosen] / MAX_PHASE_INTERVAL).astype(int) + 1, MIN_PHASES)
        for pattern, count in moments:
            counts = np.where([fnmatchcase(name, pattern) for name in self.stages], count, counts)
        self._at = np.array(chosen), counts, hold
        self._caps: dict[str, np.ndarray] = {}

        self._margins = jax.jit(jax.vmap(jax.vmap(self._worst_margins, (0, None))))
        self._deficit_gradients = jax.jit(jax.vmap(jax.value_and_grad(self._squared_deficit), (None, 0)))

    def margins(self, numbers: np.ndarray, draws: Case) -> dict[str, np.ndarray]:
        """Return the least value of each margin (such as reach) in each stage, for each draw of the belief.

        Args:
            numbers: Free numbers (free,); (draws or 1, free); or up to `width` sets of them (sets, draws or 1, free).
            draws: Beliefs, with arrays (draws,) as leaves.

        Returns:
            Margins (draws, stages) by name; with sets (sets, draws, stages).
        """
        count, single = len(draws.robot.body_length), numbers.ndim < SETS_NDIM  # pyright: ignore[reportArgumentType]
        sets = np.broadcast_to(numbers, (1 if single else len(numbers), count, len(self._free)))
        padded = sets[np.minimum(np.arange(self._width), len(sets) - 1)]  # all calls have one shape
        found = _map_draws(self._margins, padded.swapaxes(0, 1), draws)
        chosen = 0 if single else slice(len(sets))
        return {key: value[:, :, 0].swapaxes(0, 1)[chosen] for key, value in found.items()}

    def worst_draw_score(self, margins: Mapping[str, np.ndarray]) -> np.ndarray:
        """Return the score (...) to minimize: squared margin deficits in the worst draw, summed over all stages.

        Args:
            margins: Margins (..., draws, stages) by name.
        """
        return np.sum(
            np.clip(np.nan_to_num(self.margin_deficits(margins)).max(axis=-2), 0.0, MAX_DEFICIT) ** 2, axis=-1
        )

    def margin_deficits(self, margins: Mapping[str, Any]) -> Any:
        """Return by how much margins (reach, clearance, ...) fall short of the values that they should have.

        Args:
            margins: Margins (..., stages) by name.

        Returns:
            Deficits (..., margins x stages); negative where the margin exceeds its aim. A unit is 1 cm, or that of
            `SCALES`.
        """
        aims = {key: self.aim_by_stage(key) for key in sorted(margins)}
        return jnp.concatenate([(aim - _nan_to_worst(margins[key])) / SCALES.get(key, DEFAULT_SCALE)
                                for key, aim in aims.items() if np.isfinite(aim).any()], axis=-1)  # fmt: skip

    def cap_aims_at_margins(self, numbers: np.ndarray, draws: Case) -> None:
        """Lower the wanted value of each margin to what the plan with given numbers reaches in the first draw.

        Args:
            numbers: Free numbers (free,).
            draws: Beliefs, with arrays (draws,) as leaves.
        """
        reached = self.margins(numbers, draws)
        self._caps = {key: value[0] - CAP_TOLERANCE * SCALES.get(key, DEFAULT_SCALE) for key, value in reached.items()}

    def squared_deficit_gradients(self, numbers: np.ndarray, draws: Case) -> tuple[np.ndarray, np.ndarray]:
        """Return for each draw the sum of squared margin deficits, and its gradient with respect to the plan's numbers.

        Args:
            numbers: Free numbers (free,).
            draws: Beliefs, with arrays (draws,) as leaves.

        Returns:
            Sums (draws,) and gradients (draws, free).
        """
        deficit, gradient = (np.asarray(x, float) for x in self._deficit_gradients(jnp.asarray(numbers), draws))
        return deficit, np.nan_to_num(gradient, posinf=0.0, neginf=0.0)

    def deficit_finite_differences(
        self, numbers: np.ndarray, draws: Case, steps: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return the margin deficits at the worst phases, and their derivatives by the plan's numbers, by differences.

        Numbers that affect no stage in common are moved together.

        Args:
            numbers: Free numbers of every draw (draws, free).
            draws: Beliefs, with arrays (draws,) as leaves.
            steps: Steps (free,); a difference takes a fraction of one.

        Returns:
            Deficits (draws, phases, margins x stages) and slopes (draws, phases, margins x stages, free).
        """
        count, stages = len(steps), len(self.stages)
        first = jax.tree.map(lambda x: x[:1], draws)
        alone = self._deficits_of_sets(
            numbers[:1, None] + DIFFERENCE_SHARE * steps * np.eye(count + 1, count, -1), first
        )[0]
        touched = ~np.isclose(alone[1:], alone[0], 0.0, EQUAL_DEFICIT).reshape(count, -1, stages).all(axis=1)
        group = group_independent_numbers(touched)
        moves = np.where(np.arange(-1, group.max() + 1)[:, None] == group, DIFFERENCE_SHARE * steps, 0.0)
        deficit = self._deficits_of_sets(numbers[:, None] + moves, draws)
        known = np.where(np.isfinite(deficit), deficit, np.nan)
        more = np.nan_to_num(np.moveaxis(known[:, 1:] - known[:, :1], 1, -1))[..., group]
        return deficit[:, 0], more * np.tile(touched.T, (deficit.shape[-1] // stages, 1)) / (DIFFERENCE_SHARE * steps)

    def _deficits_of_sets(self, numbers: np.ndarray, draws: Case) -> np.ndarray:
        """Deficits (draws, sets, phases, margins x stages) at the worst phases, for numbers (draws, sets, free)."""
        repeated = jax.tree.map(lambda x: np.repeat(x, numbers.shape[1], axis=0), draws)
        margins = _map_draws(self._margins, numbers.reshape(-1, 1, numbers.shape[-1]), repeated)
        deficit = np.asarray(self.margin_deficits({key: value[:, 0] for key, value in margins.items()}))
        return deficit.reshape(*numbers.shape[:2], *deficit.shape[1:])

    def _squared_deficit(self, numbers: jax.Array, belief: Case) -> jax.Array:
        """Summed squared deficit of one draw, differentiable."""
        deficit = self.margin_deficits(self._worst_margins(numbers, belief))[0]
        counts = jnp.isfinite(deficit) & (deficit > 0)
        return jnp.sum(jnp.where(counts, deficit, 0.0) ** 2)

    def aim_by_stage(self, margin: str) -> np.ndarray:
        """Return the value that a margin should have in each stage, (stages,); minus infinity where none is set."""
        values = np.full(len(self.stages), -np.inf)
        for aim in self.aims:
            if aim.margin == margin:
                values = np.where([fnmatchcase(stage, aim.stages) for stage in self.stages], aim.value, values)
        return np.minimum(values, self._caps.get(margin, np.inf))

    def _worst_margins(self, numbers: jax.Array, belief: Case) -> dict[str, jax.Array]:
        """Margins (phases, stages) of one draw at the worst phases of every stage, the worst first."""
        for path, value in zip(self._free, numbers, strict=True):
            belief = replace_plan_value(belief, path, value, self._formulas)
        plan = belief.manoeuvre.plan(belief)
        return self._played_margins(belief, plan) if self._is_on_ball else self._posed_margins(belief, plan)

    def _posed_margins(self, belief: Case, plan: Plan) -> dict[str, jax.Array]:
        chosen, moments, hold = self._at

        def worst_phases(function: Callable[..., dict[str, jax.Array]], counts: np.ndarray) -> dict[str, jax.Array]:
            phases = np.concatenate([np.linspace(0, 1, n) for n in counts])
            by_phase = jax.vmap(function)(jnp.repeat(chosen, counts), jnp.asarray(phases))
            most = max(WORST_PHASES, *counts)
            index = (np.cumsum(counts) - counts)[:, None] + np.minimum(np.arange(most), counts[:, None] - 1)
            return {
                key: -jax.lax.top_k(-mask_non_minima(_nan_to_worst(x)[index]), WORST_PHASES)[0].T
                for key, x in by_phase.items()
            }

        margins = worst_phases(lambda k, u: kinematic_margins.planned_margins(belief, plan, k, u)._asdict(), moments)
        if hold:
            bounds = cast(PlannedForces, belief.manoeuvre).force_bounds(belief)
            knots = np.full(len(chosen), forces.KNOTS)
            margins |= worst_phases(
                lambda k, u: {"hold": kinematic_margins.planned_force_reserve(belief, plan, k, u, bounds)}, knots
            )
        return margins

    def _played_margins(self, belief: Case, plan: Plan) -> dict[str, jax.Array]:
        chosen, count = self._at[0], len(plan.names)
        played = ball_margins.play_plan_kinematically(belief, plan, TICK_PERIOD, self._ticks)
        margins = ball_margins.stage_minima(played, count)._asdict()
        speed = jnp.max(jnp.linalg.norm(played.free.velocity, axis=-1), axis=1)
        zmp = jax.ops.segment_min(ball_margins.zmp_margin(played, TICK_PERIOD), played.stage, count)  # m
        margins |= zip(
            BALL_MARGINS, (zmp, -jax.ops.segment_max(speed, played.stage, count)), strict=True
        )  # m/s, negative
        return {key: value[None, chosen] for key, value in margins.items()}


def group_independent_numbers(touched: np.ndarray) -> np.ndarray:
    """Assign n numbers to groups so that numbers of one group affect disjoint sets of results.

    Args:
        touched: What each number affects (n, m), bool.

    Returns:
        Group of each number (n,).
    """
    group, taken = np.zeros(len(touched), int), np.zeros(touched.shape, bool)
    for k, row in enumerate(touched):
        group[k] = np.argmin((taken & row).any(axis=1))
        taken[group[k]] |= row
    return group


def _nan_to_worst(margin: Any) -> jax.Array:
    """Replace nan by minus infinity, the worst margin."""
    return jnp.where(jnp.isnan(margin), -jnp.inf, margin)


def mask_non_minima(margin: jax.Array) -> jax.Array:
    """Set all margins (stages, phases) that are not local minima over the phases of a stage to infinity.

    All others become infinite.
    """
    before, after = (jnp.pad(margin, ((0, 0), ends), constant_values=jnp.inf) for ends in ((1, 0), (0, 1)))
    return jnp.where((margin <= before[:, :-1]) & (margin < after[:, 1:]), margin, jnp.inf)


def _map_draws(function: Callable[..., Any], numbers: np.ndarray, draws: Case) -> Any:
    """Call `function` with a few draws at a time, on all cores; concatenate the results."""
    count = len(numbers)
    parts = np.minimum(np.arange(0, count, DRAWS_PER_CALL)[:, None] + np.arange(min(DRAWS_PER_CALL, count)), count - 1)

    def evaluate(index: np.ndarray) -> Any:
        return jax.tree.map(np.asarray, function(numbers[index], jax.tree.map(lambda x: x[index], draws)))

    with ThreadPoolExecutor() as pool:
        return jax.tree.map(lambda *x: np.concatenate(x)[:count], *pool.map(evaluate, parts))


def replace_plan_value(case: Case, path: str, value: Any, formulas: Mapping[str, float]) -> Case:
    """Return the case (all parameters of a rollout) with another value for one number of its plan.

    Args:
        case: The case.
        path: Path of a number of the plan table, see `PlanTable.replace_number`, or of the manoeuvre
            (`manoeuvre.NAME`).
        value: The value.
        formulas: Values of the numbers that formulas give.
    """
    group, _, name = path.partition(".")
    if group == MANOEUVRE:
        return replace(case, manoeuvre=replace(case.manoeuvre, **{name: value}))  # pyright: ignore[reportArgumentType]
    return replace(case, plan=case.plan.replace_number(path, value, formulas))


def broadcast_over_draws(belief: Case, count: int) -> Case:
    """Return a belief (controller's parameters) whose arrays all have a leading axis of `count` draws.

    Args:
        belief: The belief, whose leaves are numbers or arrays (count,).
        count: Number of draws.
    """
    return jax.tree.map(lambda x: jnp.broadcast_to(jnp.asarray(x, float), (count,)), belief)


def relative_size_changes(belief: Case, sizes: Mapping[str, float]) -> np.ndarray:
    """Return the relative differences between the robot and obstacle sizes of each draw and reference sizes.

    Args:
        belief: The belief, with arrays (draws,) as varied leaves.
        sizes: Reference sizes (k) by path.

    Returns:
        Relative changes (draws, k).
    """
    off = [np.asarray(plan_table.parameter_value(belief, path), float) / at - 1 for path, at in sizes.items()]
    return np.stack(off, axis=1) if off else np.zeros((len(np.atleast_1d(belief.robot.body_length)), 0))


def least_margins(margins: Mapping[str, np.ndarray]) -> dict[str, float]:
    """Return the least finite value of each margin (reach, clearance, ...) over all draws and stages."""
    least = {key: float(np.min(value)) for key, value in margins.items()}
    return {key: value for key, value in least.items() if np.isfinite(value)}

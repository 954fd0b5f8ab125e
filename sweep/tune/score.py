"""What a plan lacks by other numbers: its margins over draws, against what is aimed at, without physics."""

import math
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from fnmatch import fnmatchcase
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from sweep.controllers import forces
from sweep.controllers.forces import LOAD, PlannedForces
from sweep.controllers.plan import Plan
from sweep.core.errors import InputError, require_choice
from sweep.models import plan_table
from sweep.models.case import Case
from sweep.models.obstacles.ball import Ball
from sweep.tune import planned, played

# what is aimed at if not told (m, rad/s, shares of the weight); a margin without an aim counts for nothing
AIMS = {
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
ALIKE = {"rate": 1.0, "hold": 0.01, "speed": 0.02}  # that count alike; else m:
LENGTH = 0.01  # m
SLACK = 0.1  # of what counts alike, that a margin may lose where numbers only follow sizes
MOMENTS, APART = 11, 0.05  # of a stage, at least; s, at most, in which a leg that swings goes some centimetres
WORST, AT_ONCE = 3, 8  # moments of a stage that linear programs look at; draws that a core looks at together
MOVED, SAME = 0.1, 1e-3  # of its step, by which a number moves for a difference; what is no difference
UNKNOWN = 1e3  # the most that a margin lacks, as one that is not a number
PERIOD, TIMES = 0.04, 1.05  # s, of a tick in which a plan on a ball is played; its time, with that of waiting
PLAYED = ("zmp", "speed")  # margins of such a plan alone
SETS = 3  # axes of sets of numbers: set, draw, number
MANOEUVRE = "manoeuvre"  # beginning of paths that are not the table's


class Aim(NamedTuple):
    """What a margin should be at least."""

    margin: str
    stages: str  # pattern of their names
    value: float


class Score:
    """Margins at the worst moment of every stage, and what they lack in the worst draw, by the plan's free numbers.

    Plans on a ball are played by their tracker, with the ball where it rolls to; others are posed as they are planned,
    at as many `moments` of a stage as the last pattern says that names it, or else at least `MOMENTS`, `APART` in time.
    Raises `InputError` where no stage or margin is named as asked, or the plan's forces are not searched for.
    """

    def __init__(
        self,
        case: Case,
        free: Sequence[str],
        aims: Sequence[Aim],
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
        self._plays = type(case.obstacle) is Ball  # what leans on something, or on another ball, is taken to rest
        if hold and not isinstance(case.manoeuvre, PlannedForces):
            raise InputError(f"--forces is not allowed: manoeuvre.kind = {case.manoeuvre.kind} plans none")
        if hold and self._plays:
            raise InputError("--forces is not allowed: a plan on a ball is played, not held")
        told = (*planned.Margins._fields, *(PLAYED if self._plays else ("hold",) if hold else ()))
        for aim in aims:
            require_choice(aim.margin, told, f"--need: margin {aim.margin}")
        chosen = [k for k, name in enumerate(names) if name in judged and any(fnmatchcase(name, p) for p in patterns)]
        self.stages = [names[k] for k in chosen]
        self.aims = [Aim(margin, "*", value) for margin, value in AIMS.items()] + list(aims)
        self.case, self._free, self._width = case, tuple(free), width
        self._formulas = plan_table.formula_values(case)
        time = np.asarray(jax.jit(lambda: case.manoeuvre.plan(case).duration)(), float)
        self._ticks = math.ceil(TIMES * time.sum() / PERIOD) + len(names)
        counts = np.maximum(np.ceil(time[chosen] / APART).astype(int) + 1, MOMENTS)
        for pattern, count in moments:
            counts = np.where([fnmatchcase(name, pattern) for name in self.stages], count, counts)
        self._at = np.array(chosen), counts, hold
        self._kept: dict[str, np.ndarray] = {}

        self._margins = jax.jit(jax.vmap(jax.vmap(self._left, (0, None))))
        self._descent = jax.jit(jax.vmap(jax.value_and_grad(self._lack), (None, 0)))

    def margins(self, numbers: np.ndarray, draws: Case) -> dict[str, np.ndarray]:
        """Margins (..., draws, stages) by name, for numbers (..., draws or 1, free) or (free,).

        Of sets of numbers, a leading axis, there are at most `width`.
        """
        count, single = len(draws.robot.body_length), numbers.ndim < SETS  # pyright: ignore[reportArgumentType]
        sets = np.broadcast_to(numbers, (1 if single else len(numbers), count, len(self._free)))
        padded = sets[np.minimum(np.arange(self._width), len(sets) - 1)]  # all calls have one shape
        found = _in_parts(self._margins, padded.swapaxes(0, 1), draws)
        chosen = 0 if single else slice(len(sets))
        return {key: value[:, :, 0].swapaxes(0, 1)[chosen] for key, value in found.items()}

    def lacks(self, margins: Mapping[str, np.ndarray]) -> np.ndarray:
        """Sums (...) over stages and margins (..., draws, stages) of squares of what the worst draw lacks."""
        return np.sum(np.clip(np.nan_to_num(self.lacking(margins)).max(axis=-2), 0.0, UNKNOWN) ** 2, axis=-1)

    def lacking(self, margins: Mapping[str, Any]) -> Any:
        """What margins (..., stages) with an aim lack (..., margins x stages), in what counts alike."""
        aims = {key: self.aimed(key) for key in sorted(margins)}
        return jnp.concatenate([(aim - _known(margins[key])) / ALIKE.get(key, LENGTH)
                                for key, aim in aims.items() if np.isfinite(aim).any()], axis=-1)  # fmt: skip

    def keep(self, numbers: np.ndarray, draws: Case) -> None:
        """Aim no higher than at what numbers keep in the first draw, less a little."""
        kept = self.margins(numbers, draws)
        self._kept = {key: value[0] - SLACK * ALIKE.get(key, LENGTH) for key, value in kept.items()}

    def descent(self, numbers: np.ndarray, draws: Case) -> tuple[np.ndarray, np.ndarray]:
        """What every draw lacks (draws,) by numbers (free,), and the gradients of that (draws, free)."""
        lack, gradient = (np.asarray(x, float) for x in self._descent(jnp.asarray(numbers), draws))
        return lack, np.nan_to_num(gradient, posinf=0.0, neginf=0.0)

    def slopes(self, numbers: np.ndarray, draws: Case, steps: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """What draws lack at worst moments (draws, moments, margins x stages) by their numbers (draws, free), and its
        slopes (..., free), by differences of a part of `steps`: numbers that touch no stage in common move together.
        """
        count, stages = len(steps), len(self.stages)
        first = jax.tree.map(lambda x: x[:1], draws)
        alone = self._lacks(numbers[:1, None] + MOVED * steps * np.eye(count + 1, count, -1), first)[0]
        touched = ~np.isclose(alone[1:], alone[0], 0.0, SAME).reshape(count, -1, stages).all(axis=1)
        group = groups(touched)
        moves = np.where(np.arange(-1, group.max() + 1)[:, None] == group, MOVED * steps, 0.0)
        lack = self._lacks(numbers[:, None] + moves, draws)
        known = np.where(np.isfinite(lack), lack, np.nan)
        more = np.nan_to_num(np.moveaxis(known[:, 1:] - known[:, :1], 1, -1))[..., group]
        return lack[:, 0], more * np.tile(touched.T, (lack.shape[-1] // stages, 1)) / (MOVED * steps)

    def _lacks(self, numbers: np.ndarray, draws: Case) -> np.ndarray:
        """What draws lack at worst moments (draws, sets, moments, margins x stages) by sets (draws, sets, free)."""
        each = jax.tree.map(lambda x: np.repeat(x, numbers.shape[1], axis=0), draws)
        found = _in_parts(self._margins, numbers.reshape(-1, 1, numbers.shape[-1]), each)
        lack = np.asarray(self.lacking({key: value[:, 0] for key, value in found.items()}))
        return lack.reshape(*numbers.shape[:2], *lack.shape[1:])

    def _lack(self, numbers: jax.Array, belief: Case) -> jax.Array:
        """The same as `lacks`, of one draw, to be differentiated."""
        lack = self.lacking(self._left(numbers, belief))[0]
        return jnp.sum(jnp.where(jnp.isfinite(lack) & (lack > 0), lack, 0.0) ** 2)  # what is infinite says nothing

    def aimed(self, margin: str) -> np.ndarray:
        """What is aimed at in every stage (S,); the last aim that names it counts, -inf without one."""
        found = np.full(len(self.stages), -np.inf)
        for aim in self.aims:
            if aim.margin == margin:
                found = np.where([fnmatchcase(stage, aim.stages) for stage in self.stages], aim.value, found)
        return np.minimum(found, self._kept.get(margin, np.inf))

    def _left(self, numbers: jax.Array, belief: Case) -> dict[str, jax.Array]:
        """Margins (moments, S) of one draw, at the worst moments of every stage, the worst first."""
        for path, value in zip(self._free, numbers, strict=True):
            belief = changed(belief, path, value, self._formulas)
        plan = belief.manoeuvre.plan(belief)
        return self._of_played(belief, plan) if self._plays else self._of_posed(belief, plan)

    def _of_posed(self, belief: Case, plan: Plan) -> dict[str, jax.Array]:
        chosen, moments, hold = self._at

        def worst(function: Callable[..., dict[str, jax.Array]], counts: np.ndarray) -> dict[str, jax.Array]:
            phases = np.concatenate([np.linspace(0, 1, n) for n in counts])
            seen = jax.vmap(function)(jnp.repeat(chosen, counts), jnp.asarray(phases))
            most = max(WORST, *counts)
            own = (np.cumsum(counts) - counts)[:, None] + np.minimum(np.arange(most), counts[:, None] - 1)
            return {key: -jax.lax.top_k(-lows(_known(x)[own]), WORST)[0].T for key, x in seen.items()}

        found = worst(lambda k, u: planned.margins(belief, plan, k, u)._asdict(), moments)
        if hold:
            assert isinstance(belief.manoeuvre, PlannedForces)
            bounds, knots = belief.manoeuvre.force_bounds(belief), np.full(len(chosen), forces.KNOTS)
            found |= worst(lambda k, u: {"hold": planned.holding(belief, plan, k, u, bounds)}, knots)
        return found

    def _of_played(self, belief: Case, plan: Plan) -> dict[str, jax.Array]:
        chosen, count = self._at[0], len(plan.names)
        seen = played.play(belief, plan, PERIOD, self._ticks)
        found = played.by_stage(seen, count)._asdict()
        speed = jnp.max(jnp.linalg.norm(seen.free.velocity, axis=-1), axis=1)
        zmp = jax.ops.segment_min(played.zero_moment(seen, PERIOD), seen.stage, count)  # m
        found |= zip(PLAYED, (zmp, -jax.ops.segment_max(speed, seen.stage, count)), strict=True)  # m/s, negative
        return {key: value[None, chosen] for key, value in found.items()}


def groups(touched: np.ndarray) -> np.ndarray:
    """Groups (n,) of what touches (n, m), where two of the same touch nothing in common."""
    group, taken = np.zeros(len(touched), int), np.zeros(touched.shape, bool)
    for k, own in enumerate(touched):
        group[k] = np.argmin((taken & own).any(axis=1))
        taken[group[k]] |= own
    return group


def _known(margin: Any) -> jax.Array:
    """The same, where it is no number the worst that there is."""
    return jnp.where(jnp.isnan(margin), -jnp.inf, margin)


def lows(margin: jax.Array) -> jax.Array:
    """Margins (S, moments) where they are least among their neighbours, the last of equal ones; others infinite."""
    before, after = (jnp.pad(margin, ((0, 0), ends), constant_values=jnp.inf) for ends in ((1, 0), (0, 1)))
    return jnp.where((margin <= before[:, :-1]) & (margin < after[:, 1:]), margin, jnp.inf)


def _in_parts(function: Callable[..., Any], numbers: np.ndarray, draws: Case) -> Any:
    """Of numbers (draws, ...) and draws, a few at a time, on all cores."""
    count = len(numbers)
    parts = np.minimum(np.arange(0, count, AT_ONCE)[:, None] + np.arange(min(AT_ONCE, count)), count - 1)

    def part(own: np.ndarray) -> Any:
        return jax.tree.map(np.asarray, function(numbers[own], jax.tree.map(lambda x: x[own], draws)))

    with ThreadPoolExecutor() as pool:
        return jax.tree.map(lambda *x: np.concatenate(x)[:count], *pool.map(part, parts))


def changed(case: Case, path: str, value: Any, formulas: Mapping[str, float]) -> Case:
    """With another number: of the plan's table, see `PlanTable.with_value`, or of the manoeuvre, as the path says."""
    group, _, name = path.partition(".")
    if group == MANOEUVRE:
        return replace(case, manoeuvre=replace(case.manoeuvre, **{name: value}))  # pyright: ignore[reportArgumentType]
    return replace(case, plan=case.plan.with_value(path, value, formulas))


def stacked(belief: Case, count: int) -> Case:
    """What is believed in `count` draws, with a leading axis where it is the same in all of them."""
    return jax.tree.map(lambda x: jnp.broadcast_to(jnp.asarray(x, float), (count,)), belief)


def shares(believed: Case, sizes: Mapping[str, float]) -> np.ndarray:
    """By how much draws differ from `sizes`, as shares of them (draws, k)."""
    off = [np.asarray(plan_table.parameter_value(believed, path), float) / at - 1 for path, at in sizes.items()]
    return np.stack(off, axis=1) if off else np.zeros((len(np.atleast_1d(believed.robot.body_length)), 0))


def worst(margins: Mapping[str, np.ndarray]) -> dict[str, float]:
    """The least of each margin over draws and stages, of those that say anything."""
    least = {key: float(np.min(value)) for key, value in margins.items()}
    return {key: value for key, value in least.items() if np.isfinite(value)}

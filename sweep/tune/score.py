"""What a plan lacks by other numbers: its margins over draws, against what is aimed at, without physics."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from fnmatch import fnmatchcase
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from sweep.controllers import forces
from sweep.controllers.forces import PlannedForces
from sweep.controllers.plan import Plan
from sweep.core.errors import InputError
from sweep.models import plan_table
from sweep.models.case import Case
from sweep.models.obstacles.ball import Ball
from sweep.tune import planned, played

# what is aimed at if not told (m, rad/s, N m, shares of the weight); a margin without an aim counts for nothing
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
    "friction": 0.0,
    "torque": 0.0,
    "balance": -0.002,
}
ALIKE = {"rate": 1.0, "friction": 0.02, "torque": 10.0, "balance": 0.01, "speed": 0.02}  # that count alike; else m:
LENGTH = 0.01  # m
UNKNOWN = 1e3  # what a margin lacks that is not a number
PERIOD, TIMES = 0.04, 1.05  # s, of a tick in which a plan on a ball is played; its time, with that of waiting
FRICTION = 2.5  # that forces may use, so that what is lacking is known where the believed one is too little
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
    at as many `moments` of a stage as the last pattern says that names it.
    Raises `InputError` where no stage is named as asked, or the manoeuvre plans no forces that are asked for.
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
        names = jax.eval_shape(case.manoeuvre.plan, jax.tree.map(jnp.asarray, case)).names
        chosen = [k for k, name in enumerate(names)
                  if any(fnmatchcase(name, p) for p in patterns) and not name.endswith(".load")]  # fmt: skip
        if not chosen:
            raise InputError(f"--stages = {' '.join(patterns)} names no stage of {', '.join(names)}")
        if hold and not isinstance(case.manoeuvre, PlannedForces):
            raise InputError(f"--forces is not allowed: manoeuvre.kind = {case.manoeuvre.kind} plans none")
        self.stages = [names[k] for k in chosen]
        self.aims = [Aim(margin, "*", value) for margin, value in AIMS.items()] + list(aims)
        self._free, self._width = tuple(free), width
        counts = [next(n for pattern, n in reversed(moments) if fnmatchcase(name, pattern)) for name in self.stages]
        self._at = np.array(chosen), np.array(counts), hold
        self._plays = type(case.obstacle) is Ball  # what leans on something, or on another ball, is taken to rest
        time = jax.jit(lambda: jnp.sum(case.manoeuvre.plan(case).duration))() if self._plays else 0.0
        self._ticks = math.ceil(TIMES * float(time) / PERIOD) + len(names)
        self._margins = jax.jit(jax.vmap(jax.vmap(self._left), (0, None)))
        self._descent = jax.jit(jax.vmap(jax.value_and_grad(self._lack)))

    def margins(self, numbers: np.ndarray, draws: Case) -> dict[str, np.ndarray]:
        """Margins (..., draws, stages) by name, for numbers (..., draws or 1, free) or (free,).

        Of sets of numbers, a leading axis, there are at most `width`.
        """
        count, single = len(draws.robot.body_length), numbers.ndim < SETS  # pyright: ignore[reportArgumentType]
        sets = np.broadcast_to(numbers, (1 if single else len(numbers), count, len(self._free)))
        padded = sets[np.minimum(np.arange(self._width), len(sets) - 1)]  # all calls have one shape
        found = self._margins(jnp.asarray(padded), draws)
        return {key: np.asarray(value, float)[0 if single else slice(len(sets))] for key, value in found.items()}

    def lacks(self, margins: Mapping[str, np.ndarray]) -> np.ndarray:
        """Sums (...) over stages and margins (..., draws, stages) of squares of what the worst draw lacks."""
        total = np.zeros(next(iter(margins.values())).shape[:-2])
        for key, value in margins.items():
            lack = (self.aimed(key) - np.min(value, axis=-2)) / ALIKE.get(key, LENGTH)
            total += np.sum(np.where(np.isnan(lack), UNKNOWN, np.maximum(lack, 0.0)) ** 2, axis=-1)
        return total

    def descent(self, numbers: np.ndarray, draws: Case) -> tuple[np.ndarray, np.ndarray]:
        """What every draw lacks (draws,) by numbers of its own (draws, free), and the gradients of that."""
        lack, gradient = (np.asarray(x, float) for x in self._descent(jnp.asarray(numbers), draws))
        return lack, np.nan_to_num(gradient, posinf=0.0, neginf=0.0)

    def _lack(self, numbers: jax.Array, belief: Case) -> jax.Array:
        """The same as `lacks`, of one draw, to be differentiated."""
        total = jnp.zeros(())
        for key, value in self._left(numbers, belief).items():
            if not np.isfinite(aim := self.aimed(key)).any():
                continue  # what counts for nothing may have no slope
            lack = (jnp.asarray(np.where(np.isfinite(aim), aim, 0.0)) - value) / ALIKE.get(key, LENGTH)
            counts = np.isfinite(aim) & jnp.isfinite(value) & (lack > 0)  # what is infinite says nothing
            total += jnp.sum(jnp.where(counts, lack, 0.0) ** 2)
        return total

    def aimed(self, margin: str) -> np.ndarray:
        """What is aimed at in every stage (S,); the last aim that names it counts, -inf without one."""
        found = np.full(len(self.stages), -np.inf)
        for aim in self.aims:
            if aim.margin == margin:
                found = np.where([fnmatchcase(stage, aim.stages) for stage in self.stages], aim.value, found)
        return found

    def _left(self, numbers: jax.Array, belief: Case) -> dict[str, jax.Array]:
        """Margins (S,) of one draw."""
        for path, value in zip(self._free, numbers, strict=True):
            belief = changed(belief, path, value)
        plan = belief.manoeuvre.plan(belief)
        return self._of_played(belief, plan) if self._plays else self._of_posed(belief, plan)

    def _of_posed(self, belief: Case, plan: Plan) -> dict[str, jax.Array]:
        chosen, moments, hold = self._at

        def worst(
            function: Callable[..., planned.Margins | planned.Holding], counts: np.ndarray
        ) -> dict[str, jax.Array]:
            phases = np.concatenate([np.linspace(0, 1, n) for n in counts])
            seen = jax.vmap(function)(jnp.repeat(chosen, counts), jnp.asarray(phases))
            own = (np.cumsum(counts) - counts)[:, None] + np.minimum(np.arange(max(counts)), counts[:, None] - 1)
            return {key: jnp.min(value[own], axis=1) for key, value in seen._asdict().items()}

        found = worst(lambda k, u: planned.margins(belief, plan, k, u), moments)
        if hold:
            bounds = _bounds(belief)
            found |= worst(lambda k, u: planned.holding(belief, plan, k, u, bounds), np.full(len(chosen), forces.KNOTS))
        return found

    def _of_played(self, belief: Case, plan: Plan) -> dict[str, jax.Array]:
        chosen, count = self._at[0], len(plan.names)
        seen = played.play(belief, plan, PERIOD, self._ticks)
        found = played.by_stage(seen, count)._asdict()
        speed = jnp.max(jnp.linalg.norm(seen.free.velocity, axis=-1), axis=1)
        found["zmp"] = jax.ops.segment_min(played.zero_moment(seen, PERIOD), seen.stage, count)  # m
        found["speed"] = -jax.ops.segment_max(speed, seen.stage, count)  # m/s, of the ball, negative
        return {key: value[chosen] for key, value in found.items()}


def changed(case: Case, path: str, value: Any) -> Case:
    """With another number: of the plan's table, or of the manoeuvre where the path says so."""
    group, _, name = path.partition(".")
    if group == MANOEUVRE:
        return replace(case, manoeuvre=replace(case.manoeuvre, **{name: value}))  # pyright: ignore[reportArgumentType]
    return replace(case, plan=case.plan.changed(path, value))


def _bounds(belief: Case) -> forces.Bounds:
    """Of forces that hold the robot."""
    how = belief.manoeuvre
    assert isinstance(how, PlannedForces)
    return forces.Bounds(FRICTION, how.torque_share * belief.drive.torque_limit, how.least_normal)


def stacked(belief: Case, count: int) -> Case:
    """What is believed in `count` draws, with a leading axis where it is the same in all of them."""
    return jax.tree.map(lambda x: jnp.broadcast_to(jnp.asarray(x, float), (count,)), belief)


def shares(believed: Case, sizes: Mapping[str, float]) -> np.ndarray:
    """By how much draws differ from `sizes`, as shares of them (draws, k)."""
    off = [np.asarray(plan_table.size(believed, path), float) / at - 1 for path, at in sizes.items()]
    return np.stack(off, axis=1) if off else np.zeros((len(np.atleast_1d(believed.robot.body_length)), 0))


def worst(margins: Mapping[str, np.ndarray]) -> dict[str, float]:
    """The least of each margin over draws and stages, of those that say anything."""
    least = {key: float(np.min(value)) for key, value in margins.items()}
    return {key: value for key, value in least.items() if np.isfinite(value)}

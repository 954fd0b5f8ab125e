"""Outcomes of MuJoCo models: conditions on metrics, written as for `--where`."""

import ast
from collections.abc import Collection, Mapping, Sequence
from contextlib import suppress
from typing import Any, NamedTuple

import numpy as np

from sweep.core.errors import InputError, require_choice
from sweep.core.expressions import evaluate, evaluate_condition
from sweep.core.outcomes import FAILURE, INVALID, SUCCESS

GOAL, MISSED, UNTRUSTED = "goal", "goal_missed", "untrusted"
INVALID_CAUSES = {  # figures that are 1 where they hold
    "not_finite": "a number of the simulation or controller was not finite",
    "buffer_full": "MuJoCo's buffer for contacts or constraints was full",
}


class Condition(NamedTuple):
    """A cause of failure or invalidity, which holds where its condition does; for the goal, where it does not."""

    cause: str
    key: str  # in `outcome`
    text: str

    @property
    def meaning(self) -> str:
        """What the condition means, in words."""
        return f"not {self.text}" if self.cause == MISSED else self.text

    def evaluate(self, figures: Mapping[str, np.ndarray]) -> np.ndarray:
        """Return which rows (n,) the cause holds for."""
        found = np.asarray(evaluate(self.text, figures.__getitem__))
        return ~found if self.cause == MISSED else found

    @property
    def threshold(self) -> tuple[str, float, bool] | None:
        """Metric, threshold, and whether the cause holds below it, of a condition `metric < number`; else None."""
        match ast.parse(self.text, mode="eval").body:
            case ast.Compare(ast.Name(name), [ast.Lt() | ast.LtE() | ast.Gt() | ast.GtE() as sign], [number]):
                with suppress(ValueError, TypeError):
                    value = float(ast.literal_eval(number))
                    return name, value, isinstance(sign, ast.Lt | ast.LtE) != (self.cause == MISSED)
            case _:
                pass
        return None

    def margin(self, figures: Mapping[str, np.ndarray]) -> np.ndarray:
        """How far rows are from it, in units of its number, at most 1; negative where it holds. NaN of no plain one."""
        if self.threshold is None:
            return np.full(len(next(iter(figures.values()))), np.nan)
        name, value, below = self.threshold
        left = (figures[name] - value) * (1 if below else -1)
        return np.minimum(left / (abs(value) or 1.0), 1.0)


def parse_conditions(given: Mapping[str, Any], figures: Collection[str]) -> tuple[Condition, ...]:
    """The conditions of a configuration in its order, but doubt first and the goal last. Raises `InputError`."""

    def look_up(name: str) -> np.ndarray:
        require_choice(name, figures, name)
        return np.ones(1)

    found = []
    for key, text in given.items():
        if key in (*INVALID_CAUSES, MISSED, UNTRUSTED, SUCCESS, FAILURE) or not str(key).isidentifier():
            raise InputError(f"outcome.{key} is not allowed: a new name for a failure, {GOAL} or {INVALID}")

        evaluate_condition(str(text), look_up, f"outcome.{key} = {text!r}", "'tilt_max_deg > 60'")
        found.append(Condition({GOAL: MISSED, INVALID: UNTRUSTED}.get(key, str(key)), str(key), str(text)))
    if {one.key for one in found} <= {INVALID}:
        such = "such as {fell: tilt_max_deg > 60}, or a goal"
        raise InputError(f"outcome is empty: it needs a failure, {such}")
    return tuple(sorted(found, key=lambda one: (one.cause != UNTRUSTED, one.cause == MISSED)))


def judge(
    figures: Mapping[str, np.ndarray], limits: tuple[Condition, ...], stages: Sequence[str]
) -> dict[str, np.ndarray]:
    """The labels of each row: doubts first, then the first condition that holds; see `System.judge`."""
    every = [*(Condition(name, "", f"{name} > 0") for name in INVALID_CAUSES), *limits]
    causes, keys = np.array([(one.cause, one.key) for one in every], dtype=object).T
    holds = np.stack([one.evaluate(figures) for one in every])
    any_held, first = holds.any(axis=0), holds.argmax(axis=0)
    judged = [one for one in limits if one.cause != UNTRUSTED]
    doubts, margins = len(every) - len(judged), np.stack([one.margin(figures) for one in judged])
    nearest = np.argmin(np.nan_to_num(margins, nan=np.inf), axis=0)
    return {
        "outcome": np.where(any_held, np.where(first < doubts, INVALID, FAILURE), SUCCESS).astype(object),
        "cause": np.where(any_held, causes[first], ""),
        "stage": np.where(any_held, stages[0], "").astype(object),
        "t_cause_s": np.full(len(first), np.nan),
        "limit": np.where(any_held, keys[first], ""),
        "margin": np.take_along_axis(margins, nearest[None], axis=0)[0],
        "margin_of": keys[doubts:][nearest],
    }

"""Causes of failure that a user writes as conditions on metrics, in the language of `--where`."""

import ast
from collections.abc import Collection, Mapping
from contextlib import suppress
from typing import Any, NamedTuple

import numpy as np

from sweep.core.errors import InputError, require_choice
from sweep.core.expressions import evaluate_condition, evaluate_expression
from sweep.core.outcomes import FAILURE, GOAL_MISSED, INVALID, SUCCESS, CauseVerdicts, ColumnArrays

GOAL, UNTRUSTED = "goal", "untrusted"


class Condition(NamedTuple):
    """A cause of failure or invalidity given as a condition on metrics; for goals, a condition that must hold."""

    cause: str
    threshold_key: str  # in `outcome`
    text: str

    @property
    def meaning(self) -> str:
        """Description of the cause in words, for tables of causes."""
        return f"not {self.text}" if self.cause == GOAL_MISSED else self.text

    def judge_rows(self, columns: ColumnArrays) -> CauseVerdicts:
        """Judge n rows by their final metrics: where this cause applies, and with which margin."""
        found = np.asarray(evaluate_expression(self.text, columns.__getitem__))
        holds = ~found if self.cause == GOAL_MISSED else found
        invalid, none = self.cause == UNTRUSTED, np.zeros(holds.shape, int)
        margin = None if invalid else self.margin(columns)
        return CauseVerdicts(self.cause, self.threshold_key, invalid, holds, np.full(holds.shape, np.inf), none, margin)

    @property
    def threshold(self) -> tuple[str, float, bool] | None:
        """Metric, threshold and direction of a simple condition such as `metric < number`; else None."""
        match ast.parse(self.text, mode="eval").body:
            case ast.Compare(ast.Name(name), [ast.Lt() | ast.LtE() | ast.Gt() | ast.GtE() as sign], [number]):
                with suppress(ValueError, TypeError):
                    value = float(ast.literal_eval(number))
                    return name, value, isinstance(sign, ast.Lt | ast.LtE) != (self.cause == GOAL_MISSED)
            case _:
                pass
        return None

    def margin(self, columns: ColumnArrays) -> np.ndarray:
        """Return how far each of n rows is from the threshold, divided by the threshold, at most 1; NaN without one."""
        if self.threshold is None:
            return np.full(len(next(iter(columns.values()))), np.nan)
        name, value, below = self.threshold
        left = (columns[name] - value) * (1 if below else -1)
        return np.minimum(left / (abs(value) or 1.0), 1.0)


def parse_conditions(
    config: Mapping[str, Any], columns: Collection[str], reserved_names: Collection[str]
) -> tuple[Condition, ...]:
    """Read the causes that a configuration gives as conditions on metrics.

    Args:
        config: Conditions by key of `outcome`.
        columns: Columns that they may name.
        reserved_names: Names of causes that the system defines itself.

    Returns:
        The conditions in their order, but that of invalidity first and the goal last.

    Raises:
        InputError: A key or a condition is not allowed.
    """

    def look_up(name: str) -> np.ndarray:
        require_choice(name, columns, name)
        return np.ones(1)

    found = []
    for key, text in config.items():
        if key in (*reserved_names, GOAL_MISSED, UNTRUSTED, SUCCESS, FAILURE) or not str(key).isidentifier():
            raise InputError(f"outcome.{key} is not allowed: a new name for a failure, {GOAL} or {INVALID}")

        evaluate_condition(str(text), look_up, f"outcome.{key} = {text!r}", "'tilt_max_deg > 60'")
        found.append(Condition({GOAL: GOAL_MISSED, INVALID: UNTRUSTED}.get(key, str(key)), str(key), str(text)))
    if {one.threshold_key for one in found} <= {INVALID}:
        such = "such as {fell: tilt_max_deg > 60}, or a goal"
        raise InputError(f"outcome is empty: it needs a failure, {such}")
    return tuple(sorted(found, key=lambda one: (one.cause != UNTRUSTED, one.cause == GOAL_MISSED)))

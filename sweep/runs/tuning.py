"""Searches for a plan's numbers, which go on after an interruption.

By CMA-ES, whose state are the scores so far, or by gradients, where numbers are many, as those that follow sizes are.
"""

import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from sweep.core.errors import InputError, suggest
from sweep.core.files import write_whole
from sweep.study.config import Experiment
from sweep.study.study import is_static, parameter_columns, points

STEP = 0.02  # first step of a number that is free, where none is told
STEPS = {"pitch": 2.0, "elevation": 2.0}  # deg, by the last word of its path
BOUND = ("time", "seconds", "first", "last", "arc", "rung", "depth")  # words of numbers that are free only with a step
ENOUGH = 1e-9  # score at which nothing is lacking
LEAST = 1e-6  # first steps, below which the search is over
RATE, SLOWER = 0.1, 60  # of Adam: first steps by which numbers move at first, and after how many steps they slow down
RIDGE = 1e-3  # what a number's own first step from where it was costs: what helps nothing stays
EVERY = 10  # steps after which they are kept
FAR, UNKNOWN = 20.0, 1e3  # the longest gradient that a draw has, and the most that it lacks


def free_numbers(numbers: Mapping[str, float], patterns: Sequence[str]) -> dict[str, float]:
    """First steps by path, of numbers named by `PATTERN` or `PATTERN=STEP`. Raises `InputError`."""
    found: dict[str, float] = {}
    for text in patterns:
        pattern, sign, step = text.partition("=")
        try:
            steps = {path: float(step) if sign else STEPS.get(path.rpartition(".")[2], STEP)
                     for path in numbers if fnmatchcase(path, pattern)
                     and (sign or path.rpartition(".")[2] not in BOUND)}  # fmt: skip
        except ValueError:
            raise InputError(f"--free = {text} is not allowed: a pattern, or PATTERN=STEP") from None
        if not steps or min(steps.values()) <= 0:
            raise InputError(f"--free = {text} frees no number{suggest(pattern, numbers).partition(' (allowed')[0]}")
        found |= steps
    return found


def draws(exp: Experiment, seed: int) -> tuple[Any, int]:
    """What is believed in the points of the experiment's study, and how many they are. Raises `InputError`."""
    table = points(replace(exp.study, seed=seed), exp.system, exp.settings)
    columns = parameter_columns(table)
    for column in columns:
        if is_static(column, exp.system, exp.settings):
            raise InputError(f"axis {column} cannot be drawn for a plan: it changes its stages")
    return exp.system.sides({c: table[c].to_numpy(float) for c in columns})[1], len(table)


def search(
    scores: Callable[[np.ndarray], np.ndarray],
    first: np.ndarray,
    steps: np.ndarray,
    how: Mapping[str, Any],  # seed, population, generations, and what else makes it another search
    log: Path,
    progress: Callable[[int, float], None],
) -> tuple[np.ndarray, float]:
    """The best numbers (n,) that were found from `first` on, and their score.

    `log` keeps the scores of every generation: a search that finds some of its own takes them, and the same steps, as
    before. `progress` is told generations and the best score so far. Raises `InputError` where the log is of another
    search.
    """
    try:
        import cma
    except ImportError:
        raise InputError("sweep tune needs the package cma: pip install 'insect-sweep[tune]'") from None
    told = list(known(log, {key: value for key, value in how.items() if key != "generations"}))
    options = {"popsize": how["population"], "seed": how["seed"], "verbose": -9, "ftarget": ENOUGH, "tolx": LEAST}
    strategy = cma.CMAEvolutionStrategy(np.zeros(len(first)), 1.0, options)
    best, least = first, np.inf
    for k in range(how["generations"]):
        asked = np.array(strategy.ask())
        if k < len(told):
            found = np.array(told[k])
        else:
            found = scores(first + steps * asked)
            with log.open("a", encoding="utf-8") as file:
                file.write(json.dumps(found.tolist()) + "\n")
        strategy.tell(list(asked), found.tolist())
        if found.min() < least:
            best, least = first + steps * asked[found.argmin()], float(found.min())
        progress(k + 1, least)
        if strategy.stop():
            break
    return best, least


class ByGradients(NamedTuple):
    """Where a search by gradients is: numbers and slopes (n, 1 + k), in first steps and in their largest shares."""

    done: int  # steps
    least: float  # mean of what the draws lack, at the best so far
    at: np.ndarray
    best: np.ndarray
    mean: np.ndarray  # of the gradients
    square: np.ndarray  # mean of their squares

    def next(self, mean: float, down: np.ndarray) -> "ByGradients":
        """A step of Adam on, where draws lack `mean` and the gradient is `down`."""
        k = self.done + 1
        least, best = (mean, self.at) if mean < self.least else (self.least, self.best)
        first, second = 0.9 * self.mean + 0.1 * down, 0.99 * self.square + 0.01 * down**2
        way = first / (1 - 0.9**k) / (np.sqrt(second / (1 - 0.99**k)) + 1e-12)
        return ByGradients(k, least, self.at - RATE * min(1.0, (SLOWER / k) ** 0.5) * way, best, first, second)


def fit(
    descent: Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]],
    first: np.ndarray,
    steps: np.ndarray,
    shares: np.ndarray,
    how: Mapping[str, Any],
    log: Path,
    progress: Callable[[int, float], None],
) -> tuple[np.ndarray, np.ndarray]:
    """Numbers (n,), and slopes (n, k) by which they follow the shares (draws, k) of sizes, from `first` on.

    `descent` tells what every draw lacks by its numbers (draws, n), and the gradients of that. The mean over the draws
    is what descends; a draw counts no more than `FAR`: one that is out of reach says more than all others. `log`
    keeps the last step, from which an interrupted search goes on. Raises `InputError` where it is of another search.
    """
    spread = np.maximum(np.abs(shares).max(axis=0), 1e-12)
    by = np.column_stack([np.ones(len(shares)), shares / spread])
    begun = json.dumps({key: value for key, value in how.items() if key != "generations"})
    now = kept(log, begun) or ByGradients(0, np.inf, *(np.zeros((len(first), by.shape[1])) for _ in range(4)))
    while now.done < how["generations"]:
        lack, gradients = descent(first + steps * (by @ now.at.T))
        gradients = steps * gradients
        gradients /= np.maximum(1.0, np.linalg.norm(gradients, axis=1, keepdims=True) / FAR)
        mean = float(np.mean(np.minimum(np.nan_to_num(lack, nan=UNKNOWN), UNKNOWN)))
        now = now.next(mean, gradients.T @ by / len(by) + 2 * RIDGE * now.at)
        if now.done % EVERY == 0 or now.done == how["generations"]:
            state = [now.done, now.least, *(part.tolist() for part in now[2:])]
            write_whole(log, f"{begun}\n{json.dumps(state)}\n".encode())
        progress(now.done, now.least)
    best = steps[:, None] * now.best
    return first + best[:, 0], best[:, 1:] / spread


def kept(log: Path, begun: str) -> ByGradients | None:
    """The last step that a log keeps. Raises `InputError` where it is of another search."""
    if not log.exists():
        return None
    how, state = log.read_text(encoding="utf-8").splitlines()
    if how != begun:
        raise InputError(f"{log} is of another search: remove it, or choose another out")
    done, least, *parts = json.loads(state)
    return ByGradients(done, least, *map(np.array, parts))


def known(log: Path, how: Mapping[str, Any]) -> Iterator[list[float]]:
    """Scores of the generations that are done, of a log that is begun here. Raises `InputError`."""
    lines = log.read_text(encoding="utf-8").split("\n") if log.exists() else []
    begun = json.dumps(how)
    if len(lines) < 2:  # a line is whole with its end
        log.write_text(begun + "\n", encoding="utf-8")
        return
    if lines[0] != begun:
        raise InputError(f"{log} is of another search: remove it, or choose another out")
    log.write_text("\n".join(lines[:-1]) + "\n", encoding="utf-8")
    yield from map(json.loads, lines[1:-1])

"""Searches for a plan's numbers, which go on after an interruption.

By CMA-ES, whose state are the scores so far, by gradients where numbers are many, and how numbers follow sizes by
linear programs, each of which brings down what margins lack by their slopes where the one before has ended.
"""

import json
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import replace
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from sweep.core.errors import InputError, suggest
from sweep.core.files import append_line, write_atomically
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
PRICE = 2e-3  # of a number that is its first step away in the farthest draw: what hardly helps does not pay
REST, HALF = 0.1, 5.0  # what all that a draw lacks counts beside the worst of it; cost at which more counts half
BAND = 1.0  # by how much a margin is over its aim, as lacks are counted, to be left out of a linear program
RADIUS, WIDEST, TRIES = 0.5, 2.0, 6  # first steps that a program may go: at first, at most; and halvings that are tried


def free_numbers(
    numbers: Mapping[str, float], patterns: Sequence[str], formulas: Collection[str] = ()
) -> dict[str, float]:
    """First steps by path, of numbers named by `PATTERN`, which are no formulas, or `PATTERN=STEP`.

    Raises `InputError`."""
    found: dict[str, float] = {}
    for text in patterns:
        pattern, sign, step = text.partition("=")
        try:
            steps = {path: float(step) if sign else STEPS.get(path.rpartition(".")[2], STEP)
                     for path in numbers if fnmatchcase(path, pattern)
                     and (sign or (path.rpartition(".")[2] not in BOUND and path not in formulas))}  # fmt: skip
        except ValueError:
            raise InputError(f"--free = {text} is not allowed: a pattern, or PATTERN=STEP") from None
        if not steps or min(steps.values()) <= 0:
            raise InputError(f"--free = {text} frees no number{suggest(pattern, numbers).partition(' (allowed')[0]}")
        found |= steps
    return found


def draw_beliefs(exp: Experiment, seed: int) -> tuple[Any, int]:
    """What is believed in the points of the experiment's study, and how many they are. Raises `InputError`."""
    table = points(replace(exp.study, seed=seed), exp.system, exp.settings)
    columns = parameter_columns(table)
    for column in columns:
        if is_static(column, exp.system, exp.settings):
            raise InputError(f"axis {column} cannot be drawn for a plan: it changes its stages")
    return exp.system.sides({c: table[c].to_numpy(float) for c in columns})[1], len(table)


def search_by_cma(
    scores: Callable[[np.ndarray], np.ndarray],
    first: np.ndarray,
    steps: np.ndarray,
    settings: Mapping[str, Any],  # seed, population, generations, and what else makes it another search
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
    told = resume_log(log, settings)
    options = {
        "popsize": settings["population"],
        "seed": settings["seed"],
        "verbose": -9,
        "ftarget": ENOUGH,
        "tolx": LEAST,
    }
    strategy = cma.CMAEvolutionStrategy(np.zeros(len(first)), 1.0, options)
    best, least = first, np.inf
    for k in range(settings["generations"]):
        asked = np.array(strategy.ask())
        if k < len(told):
            found = np.array(told[k])
        else:
            found = scores(first + steps * asked)
            append_log(log, found.tolist())
        strategy.tell(list(asked), found.tolist())
        if found.min() < least:
            best, least = first + steps * asked[found.argmin()], float(found.min())
        progress(k + 1, least)
        if strategy.stop():
            break
    return best, least


class AdamState(NamedTuple):
    """Where a search by gradients is: numbers (n,), in first steps."""

    steps: int  # steps
    least: float  # mean of what the draws lack, at the best so far
    at: np.ndarray
    best: np.ndarray
    mean: np.ndarray  # of the gradients
    square: np.ndarray  # mean of their squares

    def step(self, mean: float, down: np.ndarray) -> "AdamState":
        """A step of Adam on, where draws lack `mean` and the gradient is `down`."""
        k = self.steps + 1
        least, best = (mean, self.at) if mean < self.least else (self.least, self.best)
        first, second = 0.9 * self.mean + 0.1 * down, 0.99 * self.square + 0.01 * down**2
        way = first / (1 - 0.9**k) / (np.sqrt(second / (1 - 0.99**k)) + 1e-12)
        return AdamState(k, least, self.at - RATE * min(1.0, (SLOWER / k) ** 0.5) * way, best, first, second)


def search_by_gradients(
    descent: Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]],
    first: np.ndarray,
    steps: np.ndarray,
    settings: Mapping[str, Any],
    log: Path,
    progress: Callable[[int, float], None],
) -> np.ndarray:
    """Numbers (n,) from `first` on, by gradients.

    `descent` tells what every draw lacks by numbers, and the gradients of that (draws, n). The mean over the draws
    is what descends; a draw counts no more than `FAR`: one that is out of reach says more than all others. `log`
    keeps steps, from the last of which an interrupted search goes on. Raises `InputError` where it is of another one.
    """
    told = resume_log(log, settings)
    done, least, *parts = told[-1] if told else (0, np.inf, *np.zeros((4, len(first))))
    now = AdamState(done, least, *map(np.array, parts))
    while now.steps < settings["generations"]:
        lack, gradients = descent(first + steps * now.at)
        gradients = steps * gradients
        gradients /= np.maximum(1.0, np.linalg.norm(gradients, axis=1, keepdims=True) / FAR)
        mean = float(np.mean(np.minimum(np.nan_to_num(lack, nan=UNKNOWN), UNKNOWN)))
        now = now.step(mean, gradients.mean(axis=0) + 2 * RIDGE * now.at)
        if now.steps % EVERY == 0 or now.steps == settings["generations"]:
            append_log(log, [now.steps, now.least, *(part.tolist() for part in now[2:])])
        progress(now.steps, now.least)
    return first + steps * now.best


def fit_size_slopes(
    deficits: Callable[[np.ndarray], np.ndarray],
    slopes: Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]],
    steps: np.ndarray,
    shares: np.ndarray,
    settings: Mapping[str, Any],
    log: Path,
    progress: Callable[[int, float], None],
) -> np.ndarray:
    """Slopes (n, k) by which numbers follow the shares (draws, k) of sizes, by linear programs one after the other.

    `lacking` tells what margins lack (draws, margins) where every draw's numbers have moved (draws, n); `slopes` that
    at some moments (draws, moments, margins), and its slopes (..., n). A program goes no farther than a radius, which
    halves until `cost` is less; where it never is, the search is over. `log` keeps what each finds, from where an
    interrupted search goes on. Raises `InputError` where it is of another search.
    """
    spread = np.maximum(np.abs(shares).max(axis=0), 1e-12)
    by, told = shares / spread, resume_log(log, settings)
    radius, at = told[-1] if told else (RADIUS, np.zeros((len(steps), len(spread))))
    at = np.array(at)  # first steps, in draws of the largest shares
    least = cost(deficits(steps * (by @ at.T))).mean()
    for k in range(len(told), settings["generations"]):
        progress(k, least)
        lack, slope = slopes(steps * (by @ at.T))
        for tried in radius / 2.0 ** np.arange(TRIES):
            to = solve_linear_program(lack, slope * steps, by, at, tried)
            if (found := cost(deficits(steps * (by @ to.T))).mean()) < least:
                break
        else:
            break
        least, at, radius = found, to, min(1.5 * tried, WIDEST)
        append_log(log, [radius, at.tolist()])
    return steps[:, None] * at / spread


def cost(deficit: np.ndarray) -> np.ndarray:
    """The most that a draw lacks (draws,), of its margins (draws, margins), and a little of all; beyond `HALF` less."""
    deficit = np.clip(np.nan_to_num(deficit), 0.0, UNKNOWN)
    return HALF * np.log1p((deficit.max(axis=-1) + REST * deficit.sum(axis=-1)) / HALF)


def solve_linear_program(
    deficit: np.ndarray, slope: np.ndarray, by: np.ndarray, at: np.ndarray, radius: float
) -> np.ndarray:
    """Where (n, k), within a radius of `at`, the mean `cost` is least if all goes on by its slopes.

    A linear program: where, up and down of nothing, what each margin of a draw lacks, and the most of every draw.
    """
    from scipy.optimize import linprog  # slow to import
    from scipy.sparse import block_array, csr_array, eye_array, kron

    near = np.isfinite(deficit) & (deficit > -BAND)
    draw, _, margin = np.nonzero(near)
    pairs, pair = np.unique(draw * deficit.shape[-1] + margin, return_inverse=True)
    row, number = np.nonzero(slope[near])
    count, wide = len(by), slope.shape[-1] * len(by)
    moves = csr_array((slope[near][row, number], (row, number * count + draw[row])), (len(draw), wide))
    moves @= kron(eye_array(slope.shape[-1]), by)

    def of(column: np.ndarray, width: int) -> Any:
        return csr_array((-np.ones(len(column)), (np.arange(len(column)), column)), (len(column), width))

    rows = block_array([[moves, -moves, of(pair, len(pairs)), None],
                        [None, None, eye_array(len(pairs)), of(pairs // deficit.shape[-1], count)]])  # fmt: skip
    weight = np.exp(-cost(deficit.max(axis=1)) / HALF) / count
    price = np.concatenate([np.full(2 * at.size, PRICE), REST * weight[pairs // deficit.shape[-1]], weight])
    both = np.concatenate([at.ravel(), -at.ravel()])
    near_by = np.maximum(np.stack([both - radius, both + radius], axis=1), 0.0)
    bounds = np.concatenate([near_by, np.tile([0.0, np.inf], (len(pairs) + count, 1))])
    found = linprog(
        price, rows, np.concatenate([moves @ at.ravel() - deficit[near], np.zeros(len(pairs))]), bounds=bounds
    )
    up, down = found.x[: 2 * at.size].reshape(2, *at.shape)
    return up - down


def resume_log(log: Path, settings: Mapping[str, Any]) -> list[Any]:
    """What a log keeps of a search, which it begins to here. Raises `InputError` where it is of another one."""
    begun = json.dumps({key: value for key, value in settings.items() if key != "generations"})
    try:
        lines = log.read_text(encoding="utf-8").split("\n")[:-1] if log.exists() else []  # one is whole with its end
        told = [json.loads(line) for line in lines[1:]]
    except ValueError:
        raise InputError(f"{log} is damaged: remove it, or choose another out") from None
    if told and lines[0] != begun:
        raise InputError(f"{log} is of another search: remove it, or choose another out")
    write_atomically(log, ("\n".join([begun, *lines[1:]]) + "\n").encode())
    return told


def append_log(log: Path, entry: list[Any]) -> None:
    """Add what was found to a log, as a line."""
    append_line(log, json.dumps(entry))

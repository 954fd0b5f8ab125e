"""Optimisation of a plan's numbers by one of four methods, all of which resume after an interruption.

CMA-ES minimizes the score of the worst draw. Gradient descent (Adam) serves many free numbers. Sequential linear
programming finds how numbers follow sizes: each program lowers the margins' deficits by their slopes at the point where
the program before ended. Rounds of rollouts change numbers at random and move them to where rollouts end better. A log
beside the plan's file holds the state of the search.
"""

import json
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import replace
from fnmatch import fnmatchcase
from importlib import import_module
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from sweep.config.experiment import Experiment
from sweep.core.errors import InputError, format_name_suggestion
from sweep.core.files import append_line, write_atomically
from sweep.study.study import make_points, needs_recompilation, parameter_columns

DEFAULT_STEP = 0.02  # first step of a free number for which none is given
STEP_BY_WORD = {"pitch": 2.0, "elevation": 2.0}  # first steps (deg) by the last word of a number's path
STEP_REQUIRED = (
    "time",
    "seconds",
    "first",
    "last",
    "arc",
    "rung",
    "depth",
)  # last words of numbers freed only with a step
# CMA-ES ends at this score, or below this step size in first steps
TARGET_SCORE, MIN_STEP = 1e-9, 1e-6
# Adam: first learning rate in first steps, and the number of steps after which it falls as their square root
LEARNING_RATE, RATE_DECAY_STEPS = 0.1, 60
RIDGE = 1e-3  # cost of a number one first step from its start, so that numbers without effect stay
LOG_INTERVAL = 10  # steps between entries of the log
MAX_GRADIENT, MAX_DEFICIT = 20.0, 1e3  # largest norm of a draw's gradient, and largest deficit
# linear programs
STEP_COST = 2e-3  # cost of a number one first step away in the farthest draw, so that numbers with little effect stay
SUM_WEIGHT, COST_SCALE = (
    0.1,
    5.0,
)  # weight of the sum of deficits beside the largest one; cost at which its growth halves
MAX_SURPLUS = 1.0  # margins whose deficit is below minus this are left out of a program
FIRST_RADIUS, MAX_RADIUS, MAX_HALVINGS = (
    0.5,
    2.0,
    6,
)  # trust radius in first steps: first, largest; and how often it is halved
# rounds of rollouts
NOISE, FIRST_MOVE = 0.3, 0.3  # random change of a number; its largest move in a round; both in first steps
MOVE_DECAY_ROUNDS = 10  # rounds after which moves fall as the square root of their number
KEPT_SHARE = 0.7  # of earlier rounds in the mean effect
CHANCE = 2.0  # standard errors: an effect as large is trusted half, and its number makes half of the largest move


def parse_free_plan_numbers(
    numbers: Mapping[str, float], patterns: Sequence[str], formulas: Collection[str] = ()
) -> dict[str, float]:
    """Parse `--free`: the numbers of a plan to optimise, and their initial step sizes.

    Args:
        numbers: All numbers of the plan by path.
        patterns: `PATTERN`, which skips numbers that formulas give and those in `STEP_REQUIRED`, or `PATTERN=STEP`.
        formulas: Paths of numbers that formulas give.

    Returns:
        First step of each free number by path, in the unit of the number.

    Raises:
        InputError: A pattern matches nothing, or its step is not a positive number.
    """
    first_steps: dict[str, float] = {}
    for text in patterns:
        pattern, sign, step = text.partition("=")
        try:
            steps = {path: float(step) if sign else STEP_BY_WORD.get(path.rpartition(".")[2], DEFAULT_STEP)
                     for path in numbers if fnmatchcase(path, pattern)
                     and (sign or (path.rpartition(".")[2] not in STEP_REQUIRED and path not in formulas))}  # fmt: skip
        except ValueError:
            raise InputError(f"--free = {text} is not allowed: a pattern, or PATTERN=STEP") from None
        if not steps or min(steps.values()) <= 0:
            suggestion = format_name_suggestion(pattern, numbers).partition(" (allowed")[0]
            raise InputError(f"--free = {text} matches no number of the plan{suggestion}")
        first_steps |= steps
    return first_steps


def draw_beliefs(exp: Experiment, seed: int) -> tuple[Any, int]:
    """Draw the parameter values that the controller assumes (beliefs) and for which a plan is tuned.

    Args:
        exp: Experiment of the study.
        seed: Seed of the draws.

    Returns:
        The belief, with arrays (draws,) as varied leaves, and the number of draws.

    Raises:
        InputError: An axis changes the stages of the plan.
    """
    table = make_points(replace(exp.study, seed=seed), exp.system, exp.settings)
    columns = parameter_columns(table)
    for column in columns:
        if needs_recompilation(column, exp.system, exp.settings):
            raise InputError(f"axis {column} cannot be drawn for a plan: it changes its stages")
    return exp.system.make_world_and_belief({c: table[c].to_numpy(float) for c in columns})[1], len(table)


def search_by_cma(
    scores: Callable[[np.ndarray], np.ndarray],
    first: np.ndarray,
    steps: np.ndarray,
    settings: Mapping[str, Any],
    log: Path,
    progress: Callable[[int, float], None],
) -> tuple[np.ndarray, float]:
    """Find the numbers of a plan with the lowest score by CMA-ES; return these numbers and their score.

    Args:
        scores: Function from numbers (population, n) to their scores (population,).
        first: Numbers (n,) at which the search begins.
        steps: First steps (n,), in the units of the numbers.
        settings: `seed`, `population`, `generations`, and what else identifies the search.
        log: File with the scores of every generation; an interrupted search reads it and takes the same steps again.
        progress: Receives the number of generations and the least score so far.

    Returns:
        The best numbers (n,) and their score.

    Raises:
        InputError: The log belongs to another search, or the package `cma` is missing.
    """
    try:
        cma = import_module("cma")  # whose types take a checker half a minute
    except ImportError:
        raise InputError("sweep tune needs the package cma: pip install 'insect-sweep[tune]'") from None
    entries = resume_search_log(log, settings)
    options = {
        "popsize": settings["population"],
        "seed": settings["seed"],
        "verbose": -9,
        "ftarget": TARGET_SCORE,
        "tolx": MIN_STEP,
    }
    strategy = cma.CMAEvolutionStrategy(np.zeros(len(first)), 1.0, options)
    best, least = first, np.inf
    for k in range(settings["generations"]):
        asked = np.array(strategy.ask())
        if k < len(entries):
            values = np.array(entries[k])
        else:
            values = scores(first + steps * asked)
            append_log(log, values.tolist())
        strategy.tell(list(asked), values.tolist())
        if values.min() < least:
            best, least = first + steps * asked[values.argmin()], float(values.min())
        progress(k + 1, least)
        if strategy.stop():
            break
    return best, least


class AdamState(NamedTuple):
    """State of a gradient search: numbers (n,) in units of their first steps, and Adam's moments."""

    steps: int  # number of steps so far
    best_deficit: float  # mean deficit of the draws at `best`
    current: np.ndarray  # present numbers
    best: np.ndarray
    gradient_mean: np.ndarray  # running mean of the gradients
    gradient_square_mean: np.ndarray  # running mean of their squares

    def step(self, mean: float, down: np.ndarray) -> "AdamState":
        """Return the state after one step of Adam.

        Args:
            mean: Mean deficit of the draws at the present numbers.
            down: Its gradient (n,), in units of first steps.
        """
        k = self.steps + 1
        least, best = (mean, self.current) if mean < self.best_deficit else (self.best_deficit, self.best)
        first, second = 0.9 * self.gradient_mean + 0.1 * down, 0.99 * self.gradient_square_mean + 0.01 * down**2
        direction = first / (1 - 0.9**k) / (np.sqrt(second / (1 - 0.99**k)) + 1e-12)
        return AdamState(
            k,
            least,
            self.current - LEARNING_RATE * min(1.0, (RATE_DECAY_STEPS / k) ** 0.5) * direction,
            best,
            first,
            second,
        )


def search_by_gradients(
    descent: Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]],
    first: np.ndarray,
    steps: np.ndarray,
    settings: Mapping[str, Any],
    log: Path,
    progress: Callable[[int, float], None],
) -> np.ndarray:
    """Find the numbers of a plan with the smallest mean margin deficit over all draws, by Adam.

    A draw's gradient is cut to the length `MAX_GRADIENT`, so that draws out of reach do not outweigh all others.

    Args:
        descent: Function from numbers (n,) to the deficit (draws,) of every draw and its gradients (draws, n).
        first: Numbers (n,) at which the search begins.
        steps: First steps (n,), in the units of the numbers.
        settings: `generations`, and what else identifies the search.
        log: File with the state every few steps, from which an interrupted search resumes.
        progress: Receives the number of steps and the least mean deficit so far.

    Returns:
        The best numbers (n,).

    Raises:
        InputError: The log belongs to another search.
    """
    entries = resume_search_log(log, settings)
    done, least, *parts = entries[-1] if entries else (0, np.inf, *np.zeros((4, len(first))))
    now = AdamState(done, least, *map(np.array, parts))
    while now.steps < settings["generations"]:
        lack, gradients = descent(first + steps * now.current)
        gradients = steps * gradients
        gradients /= np.maximum(1.0, np.linalg.norm(gradients, axis=1, keepdims=True) / MAX_GRADIENT)
        mean = float(np.mean(np.minimum(np.nan_to_num(lack, nan=MAX_DEFICIT), MAX_DEFICIT)))
        now = now.step(mean, gradients.mean(axis=0) + 2 * RIDGE * now.current)
        if now.steps % LOG_INTERVAL == 0 or now.steps == settings["generations"]:
            append_log(log, [now.steps, now.best_deficit, *(part.tolist() for part in now[2:])])
        progress(now.steps, now.best_deficit)
    return first + steps * now.best


def fit_plan_slopes_over_sizes(
    deficits: Callable[[np.ndarray], np.ndarray],
    slopes: Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]],
    steps: np.ndarray,
    shares: np.ndarray,
    settings: Mapping[str, Any],
    log: Path,
    progress: Callable[[int, float], None],
) -> np.ndarray:
    """Fit how a plan's numbers should change with sizes of robot and obstacle, by sequential linear programming.

    A program moves no farther than a trust radius, which halves until the mean `margin_deficit_cost` falls; if it
    never does, the search ends.

    Args:
        deficits: Function from the change of every draw's numbers (draws, n) to deficits (draws, margins).
        slopes: Function from the same to deficits at the worst moments (draws, moments, margins) and their slopes
            (draws, moments, margins, n).
        steps: First steps (n,), in the units of the numbers.
        shares: Relative changes (draws, k) of the sizes.
        settings: `generations`, and what else identifies the search.
        log: File with the result of every program, from which an interrupted search resumes.
        progress: Receives the number of programs and the least mean cost so far.

    Returns:
        Slopes (n, k): change of each number per relative change of each size.

    Raises:
        InputError: The log belongs to another search.
    """
    spread = np.maximum(np.abs(shares).max(axis=0), 1e-12)
    by, entries = shares / spread, resume_search_log(log, settings)
    radius, at = entries[-1] if entries else (FIRST_RADIUS, np.zeros((len(steps), len(spread))))
    at = np.array(at)  # slopes in first steps, per largest share of a draw
    least = margin_deficit_cost(deficits(steps * (by @ at.T))).mean()
    for k in range(len(entries), settings["generations"]):
        progress(k, least)
        lack, slope = slopes(steps * (by @ at.T))
        for tried in radius / 2.0 ** np.arange(MAX_HALVINGS):
            to = solve_linear_program(lack, slope * steps, by, at, tried)
            if (mean_cost := margin_deficit_cost(deficits(steps * (by @ to.T))).mean()) < least:
                break
        else:
            break
        least, at, radius = mean_cost, to, min(1.5 * tried, MAX_RADIUS)
        append_log(log, [radius, at.tolist()])
    return steps[:, None] * at / spread


def search_by_rollouts(
    draw: Callable[[int], tuple[Any, np.ndarray]],
    scores: Callable[[Any, np.ndarray], np.ndarray],
    steps: np.ndarray,
    settings: Mapping[str, Any],
    log: Path,
    progress: Callable[[int, float], None],
) -> np.ndarray:
    """Find how a plan's numbers should follow given shares of each draw, such as sizes, so that rollouts end better.

    A number changes in a draw by the sum of its slopes times the draw's shares. In each round every draw is simulated
    twice, with random changes of all numbers, of opposite signs. Each slope then moves in the direction in which scores
    rose, and the less, the more the rise may be chance.

    Args:
        draw: Function from the number of a round to its draws and their shares (draws, k), such as relative changes
            of sizes; a column of ones stands for a change that is the same in all draws.
        scores: Function from draws and two changes of every draw's numbers (2, draws, n) to scores (2, draws).
        steps: First steps (n,), in the units of the numbers.
        settings: `seed`, `generations` (rounds), and what else identifies the search.
        log: File with the state after every round, from which an interrupted search resumes.
        progress: Receives the number of rounds and the mean score of the last round.

    Returns:
        Slopes (n, k): changes of the numbers per unit of each share.

    Raises:
        InputError: The log belongs to another search.
    """
    entries = resume_search_log(log, settings)
    spread = np.maximum(np.abs(draw(0)[1]).max(axis=0), 1e-12)
    shape = len(steps), len(spread)
    last, *parts = entries[-1] if entries else (np.nan, *np.zeros((3, *shape)))
    at, effect, variance = (np.array(part) for part in parts)  # in first steps, per largest share of a draw
    for k in range(len(entries), settings["generations"]):
        progress(k, last)
        draws, shares = draw(k)
        by = shares / spread
        noise = NOISE * np.random.default_rng([settings["seed"], k]).standard_normal((len(by), shape[0]))
        above, below = scores(draws, steps * (by @ at.T + np.stack([noise, -noise])))
        last = float(np.mean(above + below) / 2)
        single = ((above - below) / (2 * NOISE**2))[:, None, None] * noise[:, :, None] * by[:, None]
        single /= np.maximum((by**2).mean(axis=0), 1e-12)
        effect = KEPT_SHARE * effect + (1 - KEPT_SHARE) * single.mean(axis=0)
        variance = KEPT_SHARE**2 * variance + (1 - KEPT_SHARE) ** 2 * single.var(axis=0) / len(by)
        significance = effect / np.sqrt(np.maximum(variance, 1e-30))
        move = FIRST_MOVE * min(1.0, (MOVE_DECAY_ROUNDS / (k + 1)) ** 0.5)
        at = at + move * np.sign(significance) * significance**2 / (significance**2 + CHANCE**2)
        append_log(log, [last, at.tolist(), effect.tolist(), variance.tolist()])
    return steps[:, None] * at / spread


def margin_deficit_cost(deficit: np.ndarray) -> np.ndarray:
    """Return the cost (draws,) of margin deficits (draws, margins): the largest of each draw plus a small share of
    their sum.

    Costs above `COST_SCALE` grow logarithmically, so that draws out of reach do not outweigh all others.
    """
    deficit = np.clip(np.nan_to_num(deficit), 0.0, MAX_DEFICIT)
    return COST_SCALE * np.log1p((deficit.max(axis=-1) + SUM_WEIGHT * deficit.sum(axis=-1)) / COST_SCALE)


def solve_linear_program(
    deficit: np.ndarray, slope: np.ndarray, by: np.ndarray, present_slopes: np.ndarray, radius: float
) -> np.ndarray:
    """Return the slopes (n, k) of plan numbers by sizes, near given ones, that minimize the linearized cost of draws.

    The variables are the positive and negative parts of the slopes, the deficit of each margin of a draw, and the
    largest deficit of each draw.

    Args:
        deficit: Deficits (draws, moments, margins) at `present_slopes`.
        slope: Their slopes (draws, moments, margins, n), in units of first steps.
        by: Sizes of the draws (draws, k), scaled to at most 1.
        present_slopes: Present slopes (n, k).
        radius: Largest change of a slope, in first steps.
    """
    from scipy.optimize import linprog  # slow to import
    from scipy.sparse import block_array, csr_array, eye_array, kron

    near = np.isfinite(deficit) & (deficit > -MAX_SURPLUS)
    draw, _, margin = np.nonzero(near)
    pairs, pair = np.unique(draw * deficit.shape[-1] + margin, return_inverse=True)
    row, number = np.nonzero(slope[near])
    count, wide = len(by), slope.shape[-1] * len(by)
    moves = csr_array((slope[near][row, number], (row, number * count + draw[row])), (len(draw), wide))
    moves @= kron(eye_array(slope.shape[-1]), by)

    def minus_column(column: np.ndarray, width: int) -> Any:
        return csr_array((-np.ones(len(column)), (np.arange(len(column)), column)), (len(column), width))

    largest = minus_column(pairs // deficit.shape[-1], count)
    rows = block_array([[moves, -moves, minus_column(pair, len(pairs)), None],
                        [None, None, eye_array(len(pairs)), largest]])  # fmt: skip
    weight = np.exp(-margin_deficit_cost(deficit.max(axis=1)) / COST_SCALE) / count
    price = np.concatenate(
        [np.full(2 * present_slopes.size, STEP_COST), SUM_WEIGHT * weight[pairs // deficit.shape[-1]], weight]
    )
    both = np.concatenate([present_slopes.ravel(), -present_slopes.ravel()])
    near_by = np.maximum(np.stack([both - radius, both + radius], axis=1), 0.0)
    bounds = np.concatenate([near_by, np.tile([0.0, np.inf], (len(pairs) + count, 1))])
    solution = linprog(
        price,
        rows,
        np.concatenate([moves @ present_slopes.ravel() - deficit[near], np.zeros(len(pairs))]),
        bounds=bounds,
    )
    up, down = solution.x[: 2 * present_slopes.size].reshape(2, *present_slopes.shape)
    return up - down


def resume_search_log(log: Path, settings: Mapping[str, Any]) -> list[Any]:
    """Read the log of an interrupted search, or start a new log.

    Args:
        log: The file.
        settings: What identifies the search; `generations` may differ.

    Returns:
        The entries so far.

    Raises:
        InputError: The log is damaged or of another search.
    """
    header = json.dumps({key: value for key, value in settings.items() if key != "generations"})
    try:
        # a line without its end was cut off by an interruption
        lines = log.read_text(encoding="utf-8").split("\n")[:-1] if log.exists() else []
        entries = [json.loads(line) for line in lines[1:]]
    except ValueError:
        raise InputError(f"{log} is damaged: remove it, or choose another out") from None
    if entries and lines[0] != header:
        raise InputError(f"{log} belongs to another search: remove it, or choose another out")
    write_atomically(log, ("\n".join([header, *lines[1:]]) + "\n").encode())
    return entries


def append_log(log: Path, entry: list[Any]) -> None:
    """Append an entry to a search's log, as one line."""
    append_line(log, json.dumps(entry))

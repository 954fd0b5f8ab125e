"""A search for a plan's numbers by CMA-ES, which goes on after an interruption: the scores so far are its state."""

import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any

import numpy as np

from sweep.core.errors import InputError, suggest
from sweep.study.config import Experiment
from sweep.study.study import is_static, parameter_columns, points

STEP = 0.02  # first step of a number that is free, where none is told
STEPS = {"pitch": 2.0, "elevation": 2.0}  # deg, by the last word of its path
BOUND = ("time", "seconds", "first", "last", "arc", "rung", "depth")  # words of numbers that are free only with a step
ENOUGH = 1e-9  # score at which nothing is lacking
LEAST = 1e-6  # first steps, below which the search is over


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

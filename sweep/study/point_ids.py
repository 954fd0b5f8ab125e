"""Identifiers and noise streams of rollouts, computed for a million rows at once."""

import hashlib
from typing import TYPE_CHECKING

import numpy as np

from sweep.contract.system import SIDES, System, split_side_prefix

if TYPE_CHECKING:
    import pandas as pd

HASHED_DIGITS = 12  # of a number that count
CHUNK = 1 << 14  # rows that are hashed at a time, whose numbers fit into the cache of a core
MOST_POWER = 300  # of ten; the smallest numbers are scaled by two powers
_POWERS = 10.0 ** np.arange(-MOST_POWER, MOST_POWER + 1)


def replicate_noise_seeds(seed: int, replicates: int) -> np.ndarray:
    """Return the numbers (replicates,) of the replicates' random noise streams; adding replicates changes no other."""
    return (np.random.SeedSequence(seed).generate_state(replicates, np.uint64) >> np.uint64(1)).astype(np.int64)


def row_noise_seeds(seed: int, table: "pd.DataFrame") -> np.ndarray:
    """Return the number (n,) of each row's random noise stream, hashed from its values and replicate number.

    Args:
        seed: Seed of the study.
        table: Values of the rows, by column.

    Returns:
        Numbers (n,) that seed the noise.
    """
    total = np.full(len(table), text_hash(f"seed {seed}"))
    for column in table.columns:
        total += _hashes(str(column), table[column].to_numpy())
    return (_mixed(total) >> np.uint64(1)).astype(np.int64)


def point_ids(hashes: np.ndarray) -> np.ndarray:
    """Return the ids (n,) of points as 16 hexadecimal digits, from their hashes (n,)."""
    text = hashes.astype(">u8").tobytes().hex()
    return np.frombuffer(text.encode(), "S16").astype("U16")


def point_hashes(table: "pd.DataFrame", system: System) -> np.ndarray:
    """Return a 64-bit hash (n,) of all physical inputs and the replicate number of every row.

    The hash is a sum over inputs of hashes of name and value, so it is the same whether an input is varied or nominal.
    How a row is simulated does not matter. Inputs that were added later count only where they differ from their
    default, so that ids of earlier rows stay valid.

    Args:
        table: Points, one row for each rollout.
        system: The system, which knows the nominal inputs.

    Returns:
        Numbers (n,) of 64 bits.
    """
    paths = [path for side, path in map(split_side_prefix, table.columns) if path.partition(".")[0] in system.groups]
    nominal = {f"{side}.{path}": value for side in SIDES for path, value in system.iterate_physical_inputs(paths)}
    varied: dict[str, str] = {}
    for column in sorted(table.columns, key=lambda c: c.startswith(tuple(f"{s}." for s in SIDES))):  # a side's own win
        side = column.partition(".")[0]
        if side in SIDES:
            varied[column] = column
        elif side in system.groups:
            varied |= {f"{side}.{column}": column for side in SIDES}
    shared = np.zeros(1, np.uint64)
    for key, value in nominal.items():
        if key not in varied:
            shared += _hashes(key, np.asarray([value]))
    for path, value in system.inputs_left_out_of_point_ids(paths):
        for side in SIDES:
            shared -= _hashes(f"{side}.{path}", np.asarray([value]))
    keys: dict[str, list[str]] = {"replicate": ["replicate"]}
    for key, column in varied.items():
        keys.setdefault(column, []).append(key)
    columns = {column: table[column].to_numpy() for column in keys}
    found = np.empty(len(table), np.uint64)
    for first in range(0, len(table), CHUNK):
        rows = slice(first, first + CHUNK)
        total = np.full(len(found[rows]), shared[0])
        for column, names in keys.items():
            parts = _value_hashes(columns[column][rows])
            for key in names:
                total += _mixed(parts + text_hash(key))
        found[rows] = _mixed(total)
    return found


def _hashes(key: str, values: np.ndarray) -> np.ndarray:
    """Hash the values (n,) of one input; numbers count to `HASHED_DIGITS` significant digits."""
    return _mixed(_value_hashes(values) + text_hash(key))


def _value_hashes(values: np.ndarray) -> np.ndarray:
    """Hash values (n,), whatever input they belong to; see `_hashes`."""
    import pandas as pd

    if values.dtype.kind in "fiu":
        mantissa, exponent = _decimal(values.astype(float))
        return _mixed(mantissa.astype(np.uint64) + _mixed(exponent.astype(np.uint64)))
    codes, names = pd.factorize(values.astype(object))
    return np.asarray([text_hash(str(name)) for name in names], np.uint64)[codes]


def _decimal(values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Split numbers into a mantissa of `HASHED_DIGITS` digits and a decimal exponent, both whole numbers."""
    size = np.abs(values)
    exponent = np.floor(np.log10(np.where(size > 0, size, 1.0))).astype(np.int64)
    shift = HASHED_DIGITS - 1 - exponent
    most = np.minimum(shift, MOST_POWER)
    mantissa = np.rint(values * _power_of_ten(most) * _power_of_ten(shift - most)).astype(np.int64)
    carried = np.abs(mantissa) == 10**HASHED_DIGITS  # 9.9999... rounded up, or a logarithm rounded down
    return np.where(carried, mantissa // 10, mantissa), np.where(mantissa == 0, 0, exponent + carried)


def _power_of_ten(exponent: np.ndarray) -> np.ndarray:
    return _POWERS.take(exponent + MOST_POWER, mode="clip")  # from a table, as to compute them takes ten times as long


def text_hash(text: str) -> np.uint64:
    """Hash a text to a 64-bit integer."""
    return np.uint64(int.from_bytes(hashlib.blake2b(text.encode(), digest_size=8).digest()))


def _mixed(x: np.ndarray) -> np.ndarray:
    """Mix bits so that every bit of the result depends on every bit of `x` (finalizer of SplitMix64)."""
    x = np.asarray(x, np.uint64) + np.uint64(0x9E3779B97F4A7C15)
    x = (x ^ (x >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    x = (x ^ (x >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return x ^ (x >> np.uint64(31))

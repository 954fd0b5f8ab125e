"""Comparison of finished rows with the points table, since a folder may be untrusted or edited."""

from collections.abc import Collection

import numpy as np
import pandas as pd

from sweep.core.errors import InputError
from sweep.study.size_limits import MAX_STUDY_ROLLOUTS

KEY_COLUMNS = ["batch", "slot"]  # columns that identify a row of the points table
INTEGER_COLUMNS = ("replicate", "stream", "group", "batch", "slot", "width")  # with whole numbers
MAX_BATCHES, MAX_SLOTS = 2**31, 2**32  # upper bounds of batch and slot numbers in a key


class PointsByBatch:
    """Points of a folder (`points.parquet`) with their batch and slot (position in the batch), indexed by batch."""

    def __init__(self, assigned: pd.DataFrame, name: str):
        """Check the assigned points, and sort them by batch and slot.

        Args:
            assigned: Some or all columns of `points.parquet`, `batch` and `slot` among them; one row for each rollout.
            name: The file, for messages.

        Raises:
            InputError: A column that places rows holds no whole numbers, or impossible ones.
        """
        for column in KEY_COLUMNS:
            if column not in assigned:
                raise InputError(f"{name} has no column {column}")
        for column in INTEGER_COLUMNS:
            if column in assigned and assigned[column].dtype.kind not in "iu":
                raise InputError(f"{name} is not allowed: column {column} holds no whole numbers")
        for column, least, most in (
            ("batch", 0, MAX_BATCHES),
            ("slot", 0, MAX_STUDY_ROLLOUTS),
            ("width", 1, MAX_STUDY_ROLLOUTS + 1),
        ):
            if column in assigned and len(odd := assigned[column][~assigned[column].between(least, most - 1)]):
                raise InputError(f"{name} is not allowed: {column} = {odd.iloc[0]}, from {least} to {most - 1}")
        keys = batch_slot_keys(assigned)
        if not _is_increasing(keys):
            order = np.argsort(keys, kind="stable")
            assigned, keys = assigned.iloc[order], keys[order]
        self.rows, self.keys = assigned, keys
        self._batches = assigned["batch"].to_numpy()

    def batches(self) -> set[int]:
        """Return the numbers of all assigned batches."""
        return set(np.unique(self._batches).tolist())

    def select_batches(self, batches: Collection[int]) -> tuple[pd.DataFrame, np.ndarray]:
        """Return the points of some batches, sorted by batch and position in it, and an integer sort key of each."""
        numbers = np.sort(np.fromiter(batches, dtype=np.int64, count=len(batches)))
        first, last = (np.searchsorted(self._batches, numbers, side) for side in ("left", "right"))
        if len(numbers) and (first[1:] == last[:-1]).all():  # one after the other
            places = slice(first[0], last[-1])
        else:
            places = np.concatenate([np.arange(a, b) for a, b in zip(first, last, strict=True)] or [np.zeros(0, int)])
        return self.rows.iloc[places], self.keys[places]

    def row_differences(self, rows: pd.DataFrame, batches: Collection[int]) -> list[str]:
        """List the differences between finished rows and the assigned points.

        Args:
            rows: Finished rows, with all columns that the points table has.
            batches: Numbers of the batches that `rows` should hold in full.

        Returns:
            A phrase for each of: missing columns, repeated, surplus and missing rows, inputs that differ; empty where
            the rows are as assigned.
        """
        if lacking := [name for name in self.rows.columns if name not in rows]:
            return [f"column {lacking[0]} is missing"]
        for column in KEY_COLUMNS:
            if rows[column].dtype.kind not in "iu":
                return [f"column {column} holds no whole numbers"]
        there = batch_slot_keys(rows)
        expected, wanted = self.select_batches(batches)
        if _is_increasing(wanted) and np.array_equal(there, wanted):
            return _differing_inputs(rows, expected)
        found, here, assigned = [], pd.Index(there), pd.Index(wanted)
        parts = (
            (rows[here.duplicated()], "repeated"),
            (rows[~here.isin(assigned)], "not planned"),
            (expected[~assigned.isin(here)], "missing"),
        )
        for part, words in parts:
            if len(part):
                verb = "row is" if len(part) == 1 else "rows are"
                found.append(f"{len(part)} {verb} {words}, such as {_describe_row(part.iloc[0])}")
        if not assigned.is_unique:
            return [*found, "rows are planned twice"]
        both = here.isin(assigned) & ~here.duplicated()
        return found + _differing_inputs(rows[both], expected.iloc[assigned.get_indexer(here[both])])


def batch_slot_keys(rows: pd.DataFrame) -> np.ndarray:
    """Return an integer (n,) that sorts rows by batch and slot (position in it); -1 where one is out of range."""
    batch, slot = (rows[column].to_numpy() for column in KEY_COLUMNS)
    possible = (batch >= 0) & (batch < MAX_BATCHES) & (slot >= 0) & (slot < MAX_SLOTS)
    return np.where(possible, batch.astype(np.int64) * MAX_SLOTS + slot.astype(np.int64), -1)


def _is_increasing(keys: np.ndarray) -> bool:
    return bool((np.diff(keys) > 0).all())


def _differing_inputs(rows: pd.DataFrame, assigned: pd.DataFrame) -> list[str]:
    """A phrase for each column of the points in which rows, paired by their order, differ."""
    found = []
    for name in assigned.columns if len(assigned) else ():
        a, b = rows[name].array, assigned[name].array
        differ = np.flatnonzero(np.asarray(a != b, dtype=bool))
        differ = differ[~(pd.isna(a[differ]) & pd.isna(b[differ]))] if len(differ) else differ
        if len(differ):
            number, point = differ[0], _describe_row(assigned.iloc[differ[0]])
            found.append(f"{name} differs in {len(differ)} rows, such as {point}: {a[number]} instead of {b[number]}")
    return found


def _describe_row(row: pd.Series) -> str:
    place = f"batch {row['batch']}, slot {row['slot']}"
    return f"point {row['point_id']} ({place})" if "point_id" in row else place

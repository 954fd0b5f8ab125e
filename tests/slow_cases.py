"""Cases of a parametrised test that its own job runs, since the fast ones beside them check most of the same."""

from collections.abc import Collection, Iterable
from typing import Any

import pytest


def mark_slow_cases(cases: Iterable[Any], slow: Collection[Any]) -> list[Any]:
    """Return the cases of `parametrize` or of a fixture, those in `slow` with the marker `slow`."""
    return [
        pytest.param(*(case if isinstance(case, tuple) else (case,)), marks=pytest.mark.slow) if case in slow else case
        for case in cases
    ]

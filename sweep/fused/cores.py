"""Number of processor cores that this process may use."""

import os


def count_cores() -> int:
    """Return the number of CPU cores that this process may use; on macOS, which cannot restrict it, all cores."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1

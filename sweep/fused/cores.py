"""Number of processor cores that this process may use."""

import os


def count_cores() -> int:
    """Number of CPU cores that this process may use; macOS, which has no affinity of processes, offers all."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1

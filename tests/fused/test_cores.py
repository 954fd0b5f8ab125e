"""Cores that a process may use."""

import os

from sweep.fused.cores import count_cores


def test_cores_are_counted_where_processes_have_no_affinity(monkeypatch):
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: {3, 5, 7}, raising=False)
    assert count_cores() == 3
    monkeypatch.delattr(os, "sched_getaffinity")  # as on macOS
    assert count_cores() == os.cpu_count()

"""What is said while a study runs: numbers first, and a remaining time without the time to compile."""

import time
from io import StringIO

import pandas as pd
import pytest
from rich.console import Console

from sweep.cli import run_progress
from sweep.core import progress


@pytest.fixture
def clock(monkeypatch):
    now = [100.0]
    monkeypatch.setattr(time, "perf_counter", lambda: now[0])
    return now


def test_the_remaining_time_is_known_after_the_first_batch_and_counts_down(clock):
    pace = run_progress.RemainingTimeEstimate(40)
    assert pace.remaining_s() is None
    assert pace.remaining_text() == "-:-- left"
    with progress.time_compilation():
        clock[0] += 60.0
    clock[0] += 30.0
    pace.add_finished_rollouts(10)
    assert pace.remaining_s() == pytest.approx(90.0)  # 3 s a rollout: the minute of compiling does not count
    clock[0] += 1.0
    assert pace.remaining_text() == "1:29 left"
    clock[0] += 9.0
    pace.add_finished_rollouts(10)  # the next batch took a third of the time
    assert pace.remaining_s() == pytest.approx(20.0)
    clock[0] += 50.0
    assert pace.remaining_s() == 0.0


def test_numbers_come_first_in_eighty_columns(monkeypatch):
    screen = StringIO()
    narrow = Console(file=screen, force_terminal=True, width=80)
    monkeypatch.setattr(run_progress, "Console", lambda **_: narrow)
    with run_progress.report_progress(
        "a_study_whose_name_is_long", 96, "a_scenario for batches of a_study on an_engine" * 2
    ):
        pass
    line = next(line for line in screen.getvalue().splitlines() if "0/96" in line)
    assert line.index("0/96") < line.index("-:-- left") < line.index("a_study")


def test_outcomes_are_counted_and_no_share_of_them_looks_like_a_rate(monkeypatch):
    screen = StringIO()
    wide = Console(file=screen, force_terminal=True, width=200)
    monkeypatch.setattr(run_progress, "Console", lambda **_: wide)
    with run_progress.report_progress("rare", 8, "a_scenario") as report:
        report(pd.DataFrame({"outcome": ["success"] * 3 + ["failure", "invalid"]}))
    assert "3 succeeded, 1 failed, 1 invalid" in screen.getvalue()
    assert "%" not in screen.getvalue()

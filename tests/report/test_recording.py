"""A run ends with replays of a few rollouts, and the page opens on them."""

import subprocess
import sys
import time

import pytest
from small_study import start

from sweep.cli import live_page
from sweep.cli.main import main
from sweep.report import replay_selection, replays, representative
from sweep.runs import results, store

MAP = ["run", "study=walk_map", "study.expect=[]", "study.axes.friction.num=6", "study.axes.step.num=5",
       "engine.width=16"]  # fmt: skip


def files(folder):
    return sorted(file.name for file in (folder / replays.REPLAYS_FOLDER).glob("*.json"))


class PageProcess:
    """What stands for the process that rewrites the page: it says whether the folder is in use."""

    def __init__(self, folder, told):
        self.folder, self.told = folder, told
        told.append("locked at its start" if store.is_folder_locked(folder) else "free at its start")

    def wait(self):
        self.told.append("locked at its end" if store.is_folder_locked(self.folder) else "free at its end")


def test_a_run_records_replays_of_its_most_informative_rollouts_once(
    fake_engine, recorded, tmp_path, capsys, monkeypatch
):
    out = tmp_path / "study"
    pages = []
    monkeypatch.setattr(live_page, "start_page_process", lambda folder: PageProcess(folder, pages))
    assert main([*MAP, f"out={out}", "--report"]) == 0
    assert pages == ["locked at its start", "free at its end"]
    printed = capsys.readouterr()
    assert printed.out.endswith(f"{out}/report.html\n")
    assert (out / "report.html").read_text().count('"why"') == 6
    assert "6 replays recorded in" in printed.err
    found = results.read_results(out)
    shown = [found.rows.iloc[place] for place, _ in replays.read_replays(found)]
    assert len(shown) == 6
    assert {row["outcome"] for row in shown} == {"success", "failure"}
    assert "success" in {replay["why"].removeprefix("typical of ") for _, replay in replays.read_replays(found)}
    before = files(out)
    (out / replays.REPLAYS_FOLDER / before[0]).unlink()
    assert main([*MAP, f"out={out}"]) == 0  # resumes: only what is missing
    assert "1 replays recorded in" in capsys.readouterr().err
    assert files(out) == before


@pytest.mark.slow
def test_the_page_of_a_run_is_rewritten_as_rows_arrive(tmp_path):
    page = tmp_path / "report.html"
    process = start(tmp_path, "--report", FAKE_SECONDS="5")
    while not page.exists() and process.poll() is None:
        time.sleep(0.05)
    assert "The study runs: " in page.read_text()
    assert process.communicate(timeout=240)[0].endswith(f"{page}\n")
    assert process.returncode == 0
    assert "The study runs: " not in page.read_text()


@pytest.mark.parametrize("flags", [["study.replays=0"], ["--limit", "10"], ["--dry-run"]])
def test_no_replays_are_recorded_where_none_are_asked_for_or_rows_are_missing(flags, fake_engine, recorded, tmp_path):
    assert main([*MAP, *flags, f"out={tmp_path}"]) == 0
    assert not files(tmp_path)


def test_a_study_that_cannot_be_recorded_is_complete_all_the_same(fake_engine, recorded, tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(fake_engine_class(), "traces", refuse)
    assert main([*MAP, f"out={tmp_path}"]) == 0
    assert "sweep: no replays recorded: no room" in capsys.readouterr().err
    assert len(store.read_rows(tmp_path)) == 30


def fake_engine_class():
    from fake_engine import FakeEngine

    return FakeEngine


def refuse(*_):
    raise MemoryError("no room")


def test_the_first_replays_are_the_nominal_one_a_success_the_main_causes_and_a_pair_at_the_boundary(folder):
    found = results.read_results(folder)
    found.rows["duration_s"] = 5.0
    rows = replay_selection.choose_replays(found, 6)
    assert rows["why"].iloc[0].endswith("nominal parameters")
    number = {one.kind: one.number for one in representative.find_representatives(found)}
    causes = sorted((kind for kind in number if kind != "success"), key=number.get, reverse=True)
    alike = [why for why in rows["why"] if why.startswith("typical of")]
    assert alike == [f"typical of {kind.replace('_', ' ')}" for kind in ("success", *causes)]
    assert set(rows[rows["why"].str.startswith("next to the boundary")]["outcome"]) == {"success", "failure"}


def test_a_run_waits_for_no_plotting_library():
    loaded = "import sys, sweep.cli.execution; sys.exit('matplotlib' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", loaded], check=False).returncode == 0

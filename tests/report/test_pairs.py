"""Two studies on one page: what differs is what `sweep compare` counts, on one pair of axes, replays side by side."""

import shutil
from dataclasses import replace

import numpy as np
import pytest
from browser import CHROMIUM, Browser
from conftest import simulated

from sweep.analysis import compare
from sweep.cli.main import main
from sweep.report import pairs
from sweep.runs import results


@pytest.fixture(scope="module")
def folders(tmp_path_factory):
    """A study, and the same judged by a limit that nothing reaches, so that more of B succeed."""
    out = tmp_path_factory.mktemp("two")
    axes = ["study.axes.friction.num=6", "study.axes.step.num=5"]
    assert simulated(out / "a", *axes) == 0
    shutil.copytree(out / "a", out / "b")
    assert main(["relabel", str(out / "b"), "tilt_max_deg<50"]) == 0
    return out / "a", out / "b"


def test_a_pair_is_told_by_what_came_of_both(folders):
    a, b = map(results.read_results, folders)
    outcome, cause = b.rows["outcome"].to_numpy(copy=True), b.rows["cause"].to_numpy(copy=True)
    won = np.flatnonzero(a.rows["outcome"] == "success")
    outcome[won[0]], cause[won[0]], outcome[won[1]], cause[won[1]] = "failure", "fell", "invalid", "solver"
    shuffled = b.rows.assign(outcome=outcome, cause=cause).sample(frac=1, random_state=0)
    found, table = pairs.join_pairs(a, replace(b, rows=shuffled))
    flips, counts = compare.count_flips(table), found.rows["cause"].value_counts()
    assert (counts[pairs.ONLY_A], counts[pairs.ONLY_B], counts[pairs.INVALID_IN_ONE]) == (flips.lost, flips.gained, 1)
    assert flips.lost == 1
    assert flips.gained > 2
    assert "McNemar" not in pairs.pairs_headline(table)  # the points of a grid are no sample
    tested = compare.count_flips(table, np.arange(len(table)))
    assert f"McNemar p = {tested.p_value:.2g}" in pairs.pairs_headline(table, np.arange(len(table)))
    (figure,) = pairs.difference_figure(found, table)
    assert len(figure.data) == len(a.rows) - 1  # without the invalid one
    maps = figure.draw().axes[:3]
    assert {ax.get_xlim() for ax in maps} == {maps[0].get_xlim()}
    change = np.ma.asarray(maps[2].collections[0].get_array())
    assert ((change == 1).sum(), (change == -1).sum(), change.mask.sum()) == (flips.gained, 1, 1)


def test_the_page_of_two_is_written(folders, capsys, tmp_path):
    assert main(["report", *map(str, folders), "-o", str(tmp_path)]) == 0
    page = (tmp_path / "report_b.html").read_text()
    a, b = map(results.read_results, folders)
    assert str(compare.count_flips(compare.pair_rows(a.rows, b.rows))) in page
    assert 'id="difference"' in page
    assert main(["report", *map(str, folders), "--pictures"]) == 2
    assert "--pictures, --x and --y are not allowed with a second folder" in capsys.readouterr().err


@pytest.fixture
def flips(folders, fake_engine, tmp_path):
    """The page of both in a browser, with replays of three flips."""
    if CHROMIUM is None:
        pytest.skip("needs a browser: apt-get install chromium")
    assert main(["report", *map(str, folders), "--replays", "3", "-o", str(tmp_path)]) == 0
    browser = Browser(tmp_path / "profile")
    browser.open(tmp_path / "report_b.html")
    browser.until("performance.getEntriesByName('map').length && document.querySelector('#replay-list').value")
    yield browser
    assert browser.errors == []
    browser.close()


SHOWN = "['#replay-list', '#replay-with'].map(s => document.querySelector(s).selectedOptions[0].textContent)"


@pytest.mark.browser
def test_flips_play_in_both(folders, flips):
    one, other = ({path.name.split("-")[1] for path in (folder / "replays").iterdir()} for folder in folders)
    assert one == other
    assert len(one) == 3
    a, b = (results.read_results(folder).rows["outcome"].eq("success").sum() for folder in folders)
    titles = flips.run("[...document.querySelectorAll('#sides [role=img]')].map((one) => one.ariaLabel)")
    assert f"A, a: {a} of 30 succeed" in titles[0]
    assert f"B, b: {b} of 30 succeed" in titles[1]
    flips.until("document.querySelector('#sides-key canvas').width && 1")
    inked = """[...document.querySelectorAll('#sides .over')].map((one) => one.getContext('2d')
        .getImageData(0, 0, one.width, one.height).data.reduce((sum, byte) => sum + byte, 0))"""
    left, top, _, _ = flips.place("#sides .over")
    before = flips.run(inked)
    flips.mouse("Moved", left + 90, top + 60)
    ringed = flips.run(inked)
    assert [after > was for after, was in zip(ringed, before, strict=True)] == [True, True]
    words = flips.run("document.querySelector('#sides .tip').innerText")
    assert "A\nfell" in words
    assert "B\nslipped" in words
    flips.click(left + 90, top + 60)
    flips.until(f"{SHOWN}.map((text) => text[0]).join('') === 'AB'")
    one, other = flips.run(SHOWN)
    assert one.startswith("A fell")
    assert other.startswith("B success")


@pytest.mark.browser
def test_no_pair_comes_beside_a_replay_that_was_chosen_later(flips):
    """A row is clicked whose replay is unpacked late; another replay is chosen from the list before that."""
    flips.run("""window.late_ = 0; const unpack = Response.prototype.arrayBuffer; let first = true;
        Response.prototype.arrayBuffer = async function () {
            const late = first; first = false; const bytes = await unpack.call(this);
            if (late) await new Promise((done) => setTimeout(() => { late_ = 1; done() }, 500));
            return bytes }""")
    left, top, _, _ = flips.place("#map-over")
    before = flips.run(SHOWN)
    flips.click(left + 80, top + 30)
    flips.run("""(() => { const list = document.querySelector('#replay-list');
        window.later_ = [...list.options].map((one) => one.value).find((one) => one !== list.value);
        list.value = later_; list.dispatchEvent(new Event('change')) })()""")
    flips.until("late_")
    flips.run("new Promise((done) => setTimeout(done, 200))")
    assert flips.run("document.querySelector('#replay-list').value === later_")
    assert flips.run(SHOWN)[1] == before[1] == "nothing"

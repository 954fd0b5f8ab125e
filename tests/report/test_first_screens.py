"""What a reader sees first: each kind of study answers its question without scrolling, on a laptop and on a phone.

The pictures are left in build/first_screens, to be looked at.
"""

import shutil
from pathlib import Path

import fake_engine
import numpy as np
import pytest
from browser import CHROMIUM, Browser
from conftest import simulated
from moved import moved
from own_rollouts import write_texts
from test_audit import EngineOfItsOwn
from test_push_map import MODEL, SINE, STUDY

from sweep.cli.main import main
from sweep.report import replays
from sweep.runs import results

pytestmark = [
    pytest.mark.slow,
    pytest.mark.browser,
    pytest.mark.skipif(CHROMIUM is None, reason="needs a browser: apt-get install chromium"),
]

PICTURES = Path(__file__).parents[2] / "build" / "first_screens"
SCREENS = {"laptop": (1280, 800), "phone": (390, 844)}  # px
OWN_AXES = ["~study.axes.friction", "~study.axes.step"]
FRICTION = "{path: contact.friction, side: world, distribution: {kind: uniform, from: 0.3, to: 1.2}}"
STEP = "{path: manoeuvre.half_step_ratio, distribution: {kind: uniform, from: 0.03, to: 0.12}}"
MASS = "{path: robot.body_mass, distribution: {kind: uniform, from: 8.0, to: 12.0}}"
RARE = "{path: contact.friction, side: world, distribution: {kind: normal, mean: 0.8, std: 0.1}}"
ALONE = {
    "ground": "{path: contact.friction, side: world, values: [0.2, 0.3, 0.4, 0.5, 0.6, 0.8, 1.0]}",
    "stride": "{path: manoeuvre.half_step_ratio, values: [0.03, 0.06, 0.09, 0.12, 0.15]}",
    "mass": "{path: robot.body_mass, values: [8.0, 9.0, 10.0, 11.0, 12.0]}",
    "damping": "{path: drive.damping, values: [500.0, 514.26, 530.0]}",
}


def axes(**values):
    """Overrides that put these axes in place of those of the study."""
    return [*OWN_AXES, *(f"+study.axes.{name}={value}" for name, value in values.items())]


def page_of(folder, replayed=0):
    """The page of a study with some replays."""
    rows = results.read_results(folder).rows
    for place in np.linspace(0, len(rows) - 1, replayed).astype(int):
        replays.write_replay(folder, rows.iloc[place], moved())
    assert main(["report", str(folder)]) == 0
    return folder / "report.html"


def grid(out):
    assert simulated(out, "study.axes.friction.num=24", "study.axes.step.num=20") == 0
    return page_of(out, 6)


def one_axis(out):
    friction = "{path: contact.friction, side: world, from: 0.1, to: 1.2, num: 12}"
    assert simulated(out, *axes(ground=friction), "study.replicates=8", "noise.position_noise=0.001") == 0
    return page_of(out, 4)


def one_at_a_time(out):
    assert simulated(out, *axes(**ALONE), "study.design={grid: one_at_a_time}") == 0
    return page_of(out, 4)


def draws(out):
    assert simulated(out, *axes(ground=FRICTION, stride=STEP, mass=MASS), "study.design={num: 512}") == 0
    return page_of(out, 6)


def rare(out):
    assert simulated(out, *axes(low=RARE), "study.design={kind: importance, num: 256}", "study.replays=0") == 0
    return page_of(out)


def certified(out):
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("sweep.engines.make_engine", fake_engine.FakeEngine)
        assert simulated(out, *axes(ground=FRICTION, stride=STEP), "study.design={num: 1024}") == 0
        patch.setattr("sweep.engines.make_engine", fake_engine.FakeEngine)
        assert main(["certify", str(out), "--rollouts", "1500"]) == 0
    return page_of(out, 4)


def comparison(out):
    assert simulated(out / "a", "study.axes.friction.num=12", "study.axes.step.num=10") == 0
    shutil.copytree(out / "a", out / "b")
    assert main(["relabel", str(out / "b"), "tilt_max_deg<50"]) == 0
    assert main(["report", "a", "b", "-o", "."]) == 0
    return out / "report_b.html"


def league(out):
    damping = "+study.axes.damping={path: drive.damping, values: [500.0, 514.26, 530.0]}"
    assert simulated(out, damping, "study.axes.friction.num=12", "study.axes.step.num=10") == 0
    assert main(["league", str(out), "--axis", "damping", "--page", str(out / "league.html")]) == 0
    return out / "league.html"


def engines(out):
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("sweep.engines.make_engine", EngineOfItsOwn)
        study = [*axes(ground=FRICTION, stride=STEP), "study.expect=[]", "study.design={num: 400}", "study.replays=0"]
        assert main(["run", "study=walk_map", *study, f"out={out}"]) == 0
        assert main(["audit", str(out), "--engines", "all"]) == 0
    return page_of(out)


def push_map(out):
    write_texts({"model.xml": MODEL, "still.py": SINE, "study.yaml": STUDY})
    assert main(["run", "study=study.yaml", "out=map", "study.replays=0", "~study.axes.body"]) == 0
    return page_of(out / "map")


# what answers the question of each kind of study
KINDS = {
    grid: "#map-over",
    one_axis: "#curves canvas",
    one_at_a_time: "#curves canvas",  # that of the largest effect
    draws: "#map-over",
    rare: "#estimate-chart",
    certified: "#map-over",
    comparison: "#sides",
    league: "#league",
    engines: "#engines svg",
    push_map: "#push_map svg",
}


@pytest.fixture(scope="module")
def browser(tmp_path_factory):
    one = Browser(tmp_path_factory.mktemp("profile"))
    yield one
    one.close()


@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.__name__)
def test_the_first_screen_answers(kind, browser, axe, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    page = kind(tmp_path)
    assert page.stat().st_size < 1_000_000
    PICTURES.mkdir(parents=True, exist_ok=True)
    for name, (width, height) in SCREENS.items():
        browser.resize(width, height)
        browser.open(page)
        browser.until("performance.getEntriesByName('map').length || !!document.querySelector('#league')")
        browser.run("new Promise((done) => setTimeout(done, 300))")
        browser.picture(PICTURES / f"{kind.__name__}_{name}.png")
        top, bottom = (
            browser.run(f"""(() => {{ const box = document.querySelector('{KINDS[kind]}').getBoundingClientRect();
            return [box.top, box.bottom] }})()""")
        )
        assert 0 < top < bottom
        assert bottom <= height, (
            f"{kind.__name__} on a {name}: the answer ends {bottom - height:.0f} px below the screen"
        )
    browser.run("document.querySelectorAll('details').forEach((one) => (one.open = true))")
    browser.run(f"(() => {{ {axe}; return 0 }})()")
    assert browser.run("axe.run().then((all) => all.violations.map((one) => [one.id, one.nodes[0].html]))") == []
    assert browser.errors == []

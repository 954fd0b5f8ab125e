"""The page in a real browser: what it shows, how it answers to mouse, keys and touch, and what it does not run."""

import json
import os
import time
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from browser import CHROMIUM, Browser
from moved import body_places, moved

from sweep.report import page, replays
from sweep.report.page.stage import Shown
from sweep.runs import results
from sweep.trace.motion import bodies, motion

pytestmark = [
    pytest.mark.browser,
    pytest.mark.skipif(CHROMIUM is None, reason="needs a browser: apt-get install chromium"),
]
# what a quiet machine of two cores keeps; SWEEP_SLOW says how many times as long one that others share may take
SLOW = float(os.environ.get("SWEEP_SLOW", "10"))
FIRST_PAINT, FRAME = 1000 * SLOW, 50 * SLOW  # ms
FRAMES = """window.frames_ = []; window.last_ = performance.now();
(function next(now) { frames_.push(now - last_); last_ = now; requestAnimationFrame(next) })(last_)"""


@pytest.fixture(scope="module")
def browser(tmp_path_factory):
    one = Browser(tmp_path_factory.mktemp("profile"))
    yield one
    one.close()


@pytest.fixture(scope="module")
def file(wide):
    return page.write(results.read(wide), wide / "report.html")


@pytest.fixture
def shown(browser, file):
    browser.open(file)
    browser.until("performance.getEntriesByName('map').length")
    yield browser
    assert browser.errors == []
    assert [address for address in browser.asked if not address.startswith(("file:", "data:", "blob:"))] == []


def plot(browser):
    """The map's plotting area in the window."""
    left, top, width, height = browser.place("#map-over")
    return left + 64, top + 12, width - 78, height - 60


def passing(browser):
    """How many rows pass the filters, and how many there are."""
    words = browser.run("document.querySelector('#passing').textContent").split()
    return (int(words[1]),) * 2 if words[0] == "all" else (int(words[0]), int(words[2]))


def test_it_is_small_and_painted_soon(shown, file):
    assert file.stat().st_size < 5e6
    first, drawn = shown.until("""(() => { const paint = performance.getEntriesByName("first-contentful-paint")[0];
        return paint && [paint.startTime, performance.getEntriesByName("map")[0].startTime] })()""")
    print(f"first paint {first:.0f} ms, map {drawn:.0f} ms")
    assert max(first, drawn) < FIRST_PAINT
    assert shown.run("document.querySelectorAll('.live .still').length") > 0
    assert shown.run("getComputedStyle(document.querySelector('.still')).display") == "none"


def test_the_pointer_tells_a_rollout(shown):
    left, top, width, height = plot(shown)
    shown.mouse("Moved", left + 0.5 * width, top + 0.9 * height)
    text = shown.until("!document.querySelector('#map-tip').hidden && document.querySelector('#map-tip').textContent")
    assert text.startswith("success")
    assert "friction (world)" in text
    assert "slip max" in text
    assert " m" in text
    shown.mouse("Moved", left + 0.02 * width, top + 0.1 * height)
    assert shown.until("document.querySelector('#map-tip strong').textContent").startswith("failure: fell")


def test_a_brush_filters_every_view_fast(shown):
    left, top, width, height = plot(shown)
    shown.run(FRAMES)
    shown.drag(left + 0.25 * width, top + 0.25 * height, left + 0.75 * width, top + 0.75 * height, steps=30)
    chosen, every = passing(shown)
    assert every == 128 * 128
    assert chosen / every == pytest.approx(0.25, abs=0.02)
    # of what the page draws itself: that of a screen is not there, and a busy machine has gaps of its own
    found = np.array(shown.run("frames_"))
    print(f"brush: median {np.median(found):.0f} ms a frame, 90 % {np.quantile(found, 0.9):.0f} ms")
    assert np.median(found) < FRAME
    counts = shown.run("[...document.querySelectorAll('#kinds .soft')].map(e => Number(e.textContent))")
    assert sum(counts) == chosen
    assert len(shown.run("[...document.querySelectorAll('#filters button')].map(e => e.textContent)")) == 2
    shown.place("#list")
    shown.until(f"document.querySelector('#list-pages').textContent.includes('of {chosen}')")
    shown.run("document.querySelectorAll('#kinds button')[0].click()")
    assert passing(shown)[0] == chosen - counts[0]
    shown.run("document.querySelector('#clear').click()")
    assert passing(shown)[0] == every


def test_a_click_opens_the_nearest_replay_and_says_so(shown):
    left, top, width, height = plot(shown)
    shown.click(left + 0.6 * width, top + 0.6 * height)
    note = shown.until("document.querySelector('#replay-note').textContent")
    assert note.startswith("Another row: the one you chose has no replay.")
    assert "friction (world)" in note
    number = shown.run("document.querySelector('#replay-list').value")
    shown.until("document.querySelector('#play').getAttribute('aria-label') === 'pause'")
    moving = shown.run("document.querySelector('#clock').textContent")
    shown.until(f"document.querySelector('#clock').textContent !== '{moving}'")
    # the row that has the replay says nothing of another one
    about = json.loads(shown.run("document.querySelector('#data').textContent"))
    row = about["replays"][int(number)]["row"]
    x, y = row // 128, row % 128
    shown.click(left + (x + 0.5) / 128 * width, top + (1 - (y + 0.5) / 128) * height)
    shown.until("document.querySelector('#replay-note').textContent === ''")


def test_time_is_scrubbed_and_the_view_turned(shown):
    picture = "document.querySelector('#scene-a').toDataURL().length"
    shown.until(f"{picture} > 20000")
    left, top, width, height = shown.place("#strip")
    shown.click(left + 0.6 * width, top + height / 2)
    assert shown.until("document.querySelector('#clock').textContent") == "3.00 s"
    assert shown.run("document.querySelector('#stage').textContent") == "walk"
    shown.run("document.querySelector('#scrub').focus()")
    shown.key("ArrowRight")
    assert float(shown.run("document.querySelector('#clock').textContent").split()[0]) > 3
    whole = "document.querySelector('#scene-a').toDataURL()"
    before = shown.run(whole)
    left, top, width, height = shown.place("#scene-a")
    shown.drag(left + 100, top + 100, left + 220, top + 130)
    turned = shown.run(whole)
    assert turned != before
    for kind, points in (("Start", [(300, 300)]), ("Move", [(360, 300)]), ("End", [])):
        touches = [{"x": left + 0.1 * x, "y": top + 0.1 * y} for x, y in points]
        shown.send("Input.dispatchTouchEvent", type=f"touch{kind}", touchPoints=touches)
    assert shown.run(whole) != turned
    shown.run("""(() => { const other = document.querySelector("#replay-with");
        other.value = "2"; other.dispatchEvent(new Event("change")) })()""")
    shown.until("getComputedStyle(document.querySelector('#scene-b')).display === 'block'")


def test_the_keyboard_does_what_the_mouse_does(shown):
    shown.run("document.querySelector('#map-over').focus()")
    shown.key("ArrowRight")
    first = shown.until("document.querySelector('#told').textContent")
    shown.key("ArrowRight")
    assert shown.until("document.querySelector('#told').textContent") != first
    for _ in range(3):
        shown.key("ArrowUp", shift=True)
    assert passing(shown)[0] == 4
    shown.key("Escape")
    assert passing(shown)[0] == 128 * 128
    shown.key("Enter")
    shown.until("document.querySelector('#replay-note').textContent")
    names = shown.run("[...document.querySelectorAll('canvas[tabindex]')].every(e => e.getAttribute('aria-label'))")
    assert names


@pytest.mark.parametrize(("width", "dark"), [(400, False), (1400, True)])
def test_it_fits_the_screen(browser, file, width, dark):
    browser.resize(width, 900, dark)
    browser.open(file)
    browser.until("performance.getEntriesByName('map').length")
    assert browser.run("document.documentElement.scrollWidth <= innerWidth")
    back = browser.run("getComputedStyle(document.body).backgroundColor")
    assert (max(map(int, back[4:-1].split(","))) < 60) == dark
    browser.until("document.querySelector('#scene-a').toDataURL().length > 20000")  # below the window's end at first
    browser.resize(1400, 1000)


def test_names_of_others_run_nothing(browser, wide, tmp_path):
    evil = '"\'></script><script>window.hacked=1</script><img src=x onerror="window.hacked=2">'
    found = results.read(wide)
    rows = found.rows.head(400).assign(**{"world.obstacle.kind": "plane"})
    rows.loc[:9, ["outcome", "cause", "stage"]] = ["failure", "fell", evil]
    rows.loc[10:19, "world.obstacle.kind"] = evil
    rows = rows.rename(columns={"slip_max_m": "<script>window['hacked']=3</script>_m"})
    study = replace(found.exp.study, name=evil + "x" * 2**20, axes=())
    bad = results.Results(wide, found.stored, replace(found.exp, study=study), rows.infer_objects(), evil, 400)
    path = tmp_path / "evil.html"
    shown = Shown(0, rows.iloc[0], {**replays.content(rows.iloc[0], moved()), "why": evil, "stages": [evil]}, evil)
    path.write_text(page.render(bad, [shown]))
    browser.open(path)
    browser.until("performance.getEntriesByName('map').length")
    left, top, width, height = plot(browser)
    for share in np.linspace(0.05, 0.95, 12):
        browser.mouse("Moved", left + share * width, top + 0.5 * height)
    assert browser.run("typeof window.hacked") == "undefined"
    assert browser.run("document.querySelectorAll('script').length") == 3
    assert browser.run("document.documentElement.scrollWidth <= innerWidth")
    # the policy holds whatever gets in: no other script, no network
    browser.run("""(() => { const s = document.createElement("script"); s.textContent = "window.hacked = 4";
        document.body.append(s) })()""")
    assert browser.run("typeof window.hacked") == "undefined"
    assert browser.run("fetch('https://example.com/').then(() => 'sent', () => 'refused')") == "refused"
    assert not [address for address in browser.asked if address.startswith("http")]


def test_bodies_are_where_mujoco_has_them(shown):
    """The script's own reading and kinematics, which is not on the page by name, as the module that it is made from."""
    trace = moved("scenario=ball_balance")
    told = {**motion(trace), "bodies": bodies(trace.model)}
    frame = 30
    found = places_by_script(shown, told, frame)
    assert np.abs(np.array(found) - body_places(trace, frame)).max() < 3e-3


def places_by_script(browser, told, frame):
    from importlib.resources import files

    from sweep.report.page.script import EXPORT, IMPORT

    source = files("sweep.report.page")
    names = ("numbers.js", "data.js", "kinematics.js")
    modules = "\n".join(EXPORT.sub("", IMPORT.sub("", (source / name).read_text())) for name in names)
    return browser.run(f"""(async () => {{ {modules}
        const told = {json.dumps(told)};
        const motion = readMotion(told, await inflate(told.states));
        const state = stateAt(motion, {frame + 1} * motion.step);
        return posesOf(told.bodies, state).map((pose) => Array.from(pose.pos)) }})()""")


def test_on_paper_the_figures_stand(browser, folder, tmp_path):
    browser.open(page.write(results.read(folder), tmp_path / "report.html"))
    browser.until("performance.getEntriesByName('map').length")
    browser.send("Emulation.setEmulatedMedia", media="print")
    found = browser.run("""[...document.querySelectorAll("figure > svg, figure > img")].map(s => [s.parentNode.id,
        s.getBoundingClientRect().width, s.getBoundingClientRect().height])""")
    explored = browser.run("getComputedStyle(document.querySelector('#explore')).display")
    browser.send("Emulation.setEmulatedMedia", media="")
    names = ["map-1", "map-2", "map-3", "effects", "causes", "distributions"]
    assert [one[0] for one in found if not one[0].startswith("typical")] == names
    for key, width, height in found:
        assert (width > 300, height > 150) == (True, True), key
    assert explored == "none"
    assert browser.errors == []


def test_a_million_rows_are_densities(browser, wide, tmp_path):
    found = results.read(wide)
    rows = pd.concat([found.rows] * 3, ignore_index=True)
    path = page.write(replace(found, rows=rows), tmp_path / "many.html")
    browser.open(path)
    browser.until("document.querySelector('#map-key').textContent.includes('49152 rollouts counted')")
    left, top, width, height = plot(browser)
    start = time.perf_counter()
    browser.drag(left + 10, top + 10, left + 0.5 * width, top + 0.5 * height)
    chosen, every = passing(browser)
    assert every == 20_000
    assert chosen / every == pytest.approx(0.25, abs=0.03)
    assert time.perf_counter() - start < 5 * SLOW

"""The page in a real browser: what it shows, how it answers to mouse, keys and touch, and what it does not run."""

import base64
import io
import json
import re
import runpy
import sys
from dataclasses import replace
from importlib.resources import files
from pathlib import Path
from xml.etree import ElementTree

import mujoco
import numpy as np
import pandas as pd
import pytest
from browser import CHROMIUM, Browser
from conftest import simulated
from moved import arm, body_places, moved
from PIL import Image
from scipy.stats import ks_2samp

from sweep.cli.main import main
from sweep.contract.engine import Push, TimeSeriesGroup
from sweep.core.expressions import condition_mask
from sweep.engines.contact_forces import measured_contact_forces
from sweep.metrics.outcome import FAILURE_MEANINGS
from sweep.replay.motion import FRICTION_LEVELS, MARGIN_LEVELS, describe_bodies, encode_motion
from sweep.report import page, replays
from sweep.report.page.replay_data import ShownReplay
from sweep.runs import results

sys.path.insert(0, str(Path(__file__).parents[2] / "research"))
import example_pages  # pyright: ignore[reportMissingImports]

pytestmark = [
    pytest.mark.browser,
    pytest.mark.skipif(CHROMIUM is None, reason="needs a browser: apt-get install chromium"),
]

LEGENDED = ("Map", "Every rollout", "Causes by stage")  # views whose pictures have the legend of outcomes
STEP = "manoeuvre.half_step_ratio"
EXAMPLES = sorted((Path(__file__).parents[2] / "research" / "examples").glob("*/report.html"))


@pytest.fixture(scope="module")
def browser(tmp_path_factory):
    one = Browser(tmp_path_factory.mktemp("profile"))
    yield one
    one.close()


@pytest.fixture(scope="module")
def file(wide):
    return page.write_page(results.read_results(wide), wide / "report.html")


@pytest.fixture(scope="module")
def repeated(folder, tmp_path_factory):
    """The page of three parameters and two replicates of each point, of which one has a replay; and both rows."""
    found = results.read_results(folder)
    rows = found.rows[found.rows.duplicated(found.axes, keep=False)].sort_values(found.axes)
    one, other = (found.rows.loc[place] for place in rows.index[:2])
    path = tmp_path_factory.mktemp("repeated") / "report.html"
    path.write_text(page.render_page(found, [ShownReplay(rows.index[0], one, replays.replay_content(one, moved()))]))
    return path, one, other


@pytest.fixture(scope="module")
def uneven(tmp_path_factory):
    """A page of a grid whose first axis goes up in powers of two, and its rows."""
    out = tmp_path_factory.mktemp("uneven")
    assert simulated(out, "study.axes.friction.values=[0.1,0.2,0.4,0.8,1.6]", "study.axes.step.num=5") == 0
    found = results.read_results(out)
    return page.write_page(found, out / "report.html"), found.rows


@pytest.fixture(scope="module")
def rare(tmp_path_factory):
    """A search for failures, which lie where friction is low."""
    out = tmp_path_factory.mktemp("rare")
    low = "{path: contact.friction, side: world, distribution: {kind: normal, mean: 0.8, std: 0.1}}"
    axes = ["~study.axes.step", "~study.axes.friction", f"+study.axes.low={low}"]
    assert simulated(out, *axes, "study.design={kind: importance, num: 256}", "study.replays=0") == 0
    return out


@pytest.fixture
def gridded(browser, uneven):
    browser.open(uneven[0])
    browser.until("performance.getEntriesByName('map').length")
    yield browser
    assert browser.errors == []


@pytest.fixture
def shown(browser, file):
    browser.open(file)
    browser.until("performance.getEntriesByName('map').length")
    browser.until("document.querySelectorAll('.history').length")  # a replay's plots move what lies below them
    yield browser
    assert browser.errors == []
    assert [address for address in browser.asked if not address.startswith(("file:", "data:", "blob:"))] == []


@pytest.mark.parametrize("example", EXAMPLES, ids=lambda path: path.parent.name)
def test_a_shipped_example_shows_and_plays(browser, example):
    browser.open(example)
    browser.until("performance.getEntriesByName('map').length")
    browser.until("document.querySelector('#scene-a').width && document.querySelectorAll('.history').length")
    start = browser.run("Number(document.querySelector('#scrub').value)")
    browser.run("document.querySelector('#play').click()")
    browser.until(f"Number(document.querySelector('#scrub').value) > {start} + 0.2")
    assert browser.errors == []


def test_the_minified_script_of_a_wheel_plays(browser, tmp_path, monkeypatch):
    minified = runpy.run_path(str(Path(__file__).parents[2] / "setup.py"))["minify_page_script"]()
    monkeypatch.setattr(example_pages, "bundle_script", lambda: minified)
    path = tmp_path / "report.html"
    path.write_text(example_pages.renewed(EXAMPLES[0].read_text(encoding="utf-8")), encoding="utf-8")
    test_a_shipped_example_shows_and_plays(browser, path)


def plot(browser):
    """The map's plotting area in the window."""
    left, top, width, height = browser.place("#map-over")
    return left + 64, top + 12, width - 78, height - 60


def middle(pixels, x, y):
    """What is drawn within a glyph's size of a place."""
    return pixels[round(y) - 5 : round(y) + 6, round(x) - 5 : round(x) + 6]


def left_over(browser, rows, axis="world.contact.friction"):
    """The values of an axis that pass the filters, as the page's condition chooses them; all filters go."""
    browser.run("document.querySelector('#copy').click()")
    told = browser.run("document.querySelector('#copied').textContent")
    found = sorted(rows.loc[condition_mask(rows, re.fullmatch("--where '(.*)'", told)[1]), axis].unique())
    browser.run("document.querySelector('#clear').click()")
    return found


def drawing(browser, name):
    """What a view is saved as, as SVG."""
    browser.run(
        "URL.createObjectURL = (blob) => { window.last_ = blob; return 'blob:none' };"
        "HTMLAnchorElement.prototype.click = () => {}; window.last_ = null;"
        f"[...document.querySelectorAll('.save')].find((one) => one.title === 'save \"{name}\" as SVG').click()"
    )
    browser.until("Boolean(window.last_)")
    return browser.run("last_.text()")


def has_first_figure_on_first_screen(browser, path, selector):
    """Whether a figure ends above the lower end of the window, on a small laptop and on a phone."""
    bottoms = []
    for width, height in ((1280, 800), (390, 844)):
        browser.resize(width, height)
        browser.open(path)
        browser.until("performance.getEntriesByName('map').length")
        browser.picture(path.with_name(f"{path.stem}_{width}.png"))
        bottom = browser.run(f"document.querySelector({json.dumps(selector)}).getBoundingClientRect().bottom")
        bottoms.append(bottom <= height)
    browser.resize(1400, 1000)
    return all(bottoms)


def passing(browser):
    """How many rows pass the filters, and how many there are."""
    words = browser.run("document.querySelector('#passing').textContent").replace(",", "").split()
    return (int(words[1]),) * 2 if words[0] == "all" else (int(words[0]), int(words[2]))


def kind_counts(browser):
    """The numbers beside the kinds."""
    counts = "[...document.querySelectorAll('#kinds .soft')].map(e => Number(e.textContent.replace(/,/g, '')))"
    return browser.run(counts)


def chosen(browser, selector, value):
    """Choose an option of a selection list."""
    browser.run(f"""(() => {{ const list = document.querySelector({json.dumps(selector)});
        list.value = {json.dumps(value)}; list.dispatchEvent(new Event("change")) }})()""")


def rescaled(browser, title, scale):
    """Give the axes of a column another scale by the menu of the parallel coordinates."""
    browser.run("document.querySelector('.axis-menu').open = true")
    browser.until("document.querySelector('.axis-menu select').options.length")
    browser.run(f"""(() => {{ const line = [...document.querySelectorAll(".axis-menu li")].find(
        (one) => one.textContent.includes({json.dumps(title)}));
        const list = line.querySelector("select");
        list.value = {json.dumps(scale)}; list.dispatchEvent(new Event("change")) }})()""")
    browser.run("document.querySelector('.axis-menu').open = false")


def colours(browser, selector="#map-base"):
    """The colours of a canvas, as red, green, blue by pixel, after all that is due has been drawn."""
    browser.run("new Promise(done => requestAnimationFrame(() => requestAnimationFrame(done)))")
    url = browser.run(f"document.querySelector('{selector}').toDataURL()")
    return np.asarray(Image.open(io.BytesIO(base64.b64decode(url.split(",")[1]))).convert("RGB"))


def test_kinds_are_named_by_what_the_map_shows(browser, tmp_path):
    """The same colour, glyph and ink as cells have, and the marks where the map is made of these."""
    folder = tmp_path / "study"
    values = "study.axes.friction.values=[0.5,0.6,0.7,0.8,0.9,1.0]"
    assert simulated(folder, values, "study.axes.step.num=5") == 0
    found = results.read_results(folder)
    causes = dict(enumerate(FAILURE_MEANINGS))
    rows = found.rows.copy()
    rows["outcome"] = ["failure" if place in causes else "success" for place in range(len(rows))]
    rows["cause"] = [causes.get(place, "") for place in range(len(rows))]
    browser.open(page.write_page(replace(found, rows=rows), tmp_path / "report.html"))
    browser.until("performance.getEntriesByName('map').length")
    names = browser.run("[...document.querySelectorAll('#kinds button')].map((one) => one.childNodes[1].textContent)")
    assert set(names) == {"success", *(cause.replace("_", " ") for cause in FAILURE_MEANINGS)}
    left, top, width, height = (np.array(plot(browser)) - [*browser.place("#map-over")[:2], 0, 0]).tolist()
    whole = colours(browser)
    x, y = (np.unique(rows[name], return_inverse=True) for name in found.numeric_grid_columns)
    for number, name in enumerate(names):
        swatch = colours(browser, f"#kinds button:nth-child({number + 1}) canvas")
        place = list(rows["cause"]).index("" if name == "success" else name.replace(" ", "_"))
        wide, high = width / len(x[0]), height / len(y[0])
        # the last line of a cell is a gap
        at = left + (x[1][place] + 0.5) * wide - 0.5, top + height - (y[1][place] + 0.5) * high - 0.5
        cell = [middle(whole, at[0] + i, at[1] + j) for i in (-1, 0, 1) for j in (-1, 0, 1)]
        shown = middle(swatch, swatch.shape[1] / 2, swatch.shape[0] / 2)
        assert any(np.array_equal(shown, one) for one in cell), name
        assert (len(np.unique(shown.reshape(-1, 3), axis=0)) > 1) == (name != "success")
    before = colours(browser, "#kinds canvas")
    chosen(browser, "#map-y", "slip_max_m")
    after = colours(browser, "#kinds canvas")
    assert not np.array_equal(before, after)
    assert (after[0, 0] == after[-1, -1]).all()  # paper about a mark


def test_it_is_small_and_live(shown, file):
    assert file.stat().st_size < 1.2e6
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


def test_a_brush_filters_every_view(shown):
    left, top, width, height = plot(shown)
    shown.drag(left + 0.25 * width, top + 0.25 * height, left + 0.75 * width, top + 0.75 * height, steps=30)
    chosen, every = passing(shown)
    assert every == 128 * 128
    assert chosen / every == pytest.approx(0.25, abs=0.02)
    counts = kind_counts(shown)
    assert sum(counts) == chosen
    assert len(shown.run("[...document.querySelectorAll('#filters button')].map(e => e.textContent)")) == 2
    shown.place("#list")
    shown.until(f"document.querySelector('#list-pages').textContent.includes('of {chosen:,}')")
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


def test_however_often_one_clicks_a_frame_is_drawn_once(shown):
    """Of each frame's callbacks one is the player's, and one may draw views."""
    shown.run("""window.frames_ = new Map(); window.plain_ = requestAnimationFrame;
        window.requestAnimationFrame = (f) => plain_((now) => {
            frames_.set(now, 1 + (frames_.get(now) ?? 0)); f(now) })""")
    left, top, width, height = plot(shown)
    for share in np.linspace(0.1, 0.9, 50):
        shown.click(left + share * width, top + 0.3 * height)
    shown.until("document.querySelector('#play').getAttribute('aria-label') === 'pause'")
    shown.run("frames_.clear()")
    shown.until("frames_.size > 8")
    assert max(shown.run("[...frames_.values()]")) <= 2


def test_the_replay_that_was_chosen_last_is_shown(shown):
    """Whichever is unpacked last: here the one chosen before it."""
    shown.until("document.querySelector('#replay-list').value")
    shown.run("""window.late_ = 0; const unpack = Response.prototype.arrayBuffer; let first = true;
        Response.prototype.arrayBuffer = async function () {
            const late = first; first = false; const bytes = await unpack.call(this);
            if (late) await new Promise((done) => setTimeout(() => { late_ = 1; done() }, 300));
            return bytes };
        const list = document.querySelector('#replay-list');
        const others = [...list.options].map((one) => one.value).filter((one) => one && one !== list.value).slice(0, 2);
        window.last_ = others[1];
        for (const one of others) { list.value = one; list.dispatchEvent(new Event('change')) }""")
    shown.until("late_")
    shown.run("new Promise((done) => setTimeout(done, 100))")
    assert shown.run("document.querySelector('#replay-list').value === last_")


def test_the_page_is_laid_out_ten_times_a_second_while_a_replay_plays(shown):
    """A frame is drawn on canvases; words beside them change no more often than one can read."""
    shown.run("""window.said_ = []; new MutationObserver(() => said_.push(document.querySelector('#clock').textContent))
        .observe(document.querySelector('#clock'), { childList: true }); document.querySelector('#play').click()""")
    shown.until("said_.length > 12")
    times = [float(text.split()[0]) for text in shown.run("said_")]
    assert len(times) <= 10 * (times[-1] - times[0]) + 2


def test_the_address_keeps_what_is_looked_at(shown):
    chosen(shown, "#map-y", "slip_max_m")
    chosen(shown, "#map-colour", "margin")
    shown.run("document.querySelectorAll('#kinds button')[0].click()")
    left, top, width, height = plot(shown)
    shown.drag(left + 0.2 * width, top + 0.1 * height, left + 0.6 * width, top + 0.9 * height)
    shown.click(*shown.place("#strip")[:2])
    found = passing(shown)
    shown.until("['hide=success', '..', 'colour=margin', 'time='].every(one => location.hash.includes(one))")
    shown.run("window.before_ = true; location.reload()")
    shown.until("!window.before_ && performance.getEntriesByName('map').length")
    assert passing(shown) == found
    assert shown.run("['x', 'y', 'colour'].map(n => document.querySelector('#map-' + n).value)") == [
        "world.contact.friction", "slip_max_m", "margin"]  # fmt: skip


def test_scales_and_axes_of_lines_are_in_the_address(gridded):
    """Chosen by the switch of the map and by the menu of the lines; titles say the scale."""
    assert "friction (world) (not to scale)" in drawing(gridded, "Map")  # as it goes up in powers of two
    chosen(gridded, "#map-x + .scale", "log")
    assert "friction (world) (log)" in drawing(gridded, "Map")
    chosen(gridded, "#map-colour", "margin")
    gridded.run("""(() => { document.querySelector(".axis-menu").open = true;
        const find = document.querySelector(".axis-menu input[type=search]");
        find.value = "slip"; find.dispatchEvent(new Event("input")) })()""")
    found = "[...document.querySelectorAll('.axis-menu li')].filter((one) => !one.hidden)"
    assert gridded.run(f"{found}.every((one) => one.textContent.includes('slip'))")
    gridded.run(f"{found}[0].querySelector('input').click()")
    gridded.run(f"{found}[0].querySelector('button').click()")
    gridded.until("['scale=', 'line=slip', 'inverted'].every((one) => location.hash.includes(one))")
    before = re.sub(r"mark\d+", "mark", drawing(gridded, "Every rollout"))
    gridded.run("window.before_ = true; location.reload()")
    gridded.until("!window.before_ && performance.getEntriesByName('map').length")
    assert gridded.run("document.querySelector('#map-x + .scale').value") == "log"
    assert re.sub(r"mark\d+", "mark", drawing(gridded, "Every rollout")) == before
    assert "slip max" in before


def test_a_line_is_told_and_replayed_where_the_pointer_is(shown):
    left, top, width, height = shown.place("#lines-over")
    shown.mouse("Moved", left + 46 + 0.5 * (width - 92), top + 0.5 * height)
    text = shown.until("document.querySelector('#lines-over + .tip').textContent")
    assert "friction (world)" in text
    shown.click(left + 46 + 0.5 * (width - 92), top + 0.5 * height)
    shown.until("location.hash.includes('point=')")
    point = shown.run("new URLSearchParams(location.hash.slice(1)).get('point')")
    assert point in text  # the row that was told is the one that was chosen
    shown.until("document.querySelector('#play').getAttribute('aria-label') === 'pause'")


def test_a_value_of_a_further_axis_is_kept_and_a_replay_of_a_repeated_point_is_told(browser, repeated):
    path, _, other = repeated
    browser.open(path)
    browser.until("performance.getEntriesByName('map').length")
    chosen(browser, "#map-slices select", "530")
    browser.until("location.hash.includes('drive.damping=%40530')")
    point = other["point_id"][: page.data.POINT_ID_DIGITS]
    browser.run(f"window.before_ = true; location.hash += '&point={point}'; location.reload()")
    browser.until("!window.before_ && performance.getEntriesByName('map').length")
    note = browser.until("document.querySelector('#replay-note').textContent")
    assert note.endswith("This is the nearest that has one: the same values with other noise.")
    assert browser.run("document.querySelector('#map-slices select').value") == "530"


def test_rows_and_filters_are_taken_away(shown, wide):
    left, top, width, height = plot(shown)
    shown.drag(left + 0.2 * width, top + 0.1 * height, left + 0.6 * width, top + 0.9 * height)
    number = passing(shown)[0]
    shown.run(
        "window.given_ = []; URL.createObjectURL = (blob) => { given_.push(blob); return 'blob:none' };"
        "HTMLAnchorElement.prototype.click = () => {}"
    )
    shown.run("document.querySelector('#csv').click()")
    table = pd.read_csv(io.StringIO(shown.run("given_[0].text()")))
    assert len(table) == number
    rows = results.read_results(wide).rows
    assert set(table["point_id"]) <= set(rows["point_id"].str[: page.data.POINT_ID_DIGITS])
    shown.run("document.querySelector('#copy').click()")
    told = shown.run("document.querySelector('#copied').textContent")
    assert condition_mask(rows, re.fullmatch("--where '(.*)'", told)[1]).sum() == number


@pytest.mark.parametrize("form", ["PNG", "SVG"])
def test_every_view_is_saved(shown, form):
    """Seen or not, all that is drawn in its panel."""
    shown.until("document.querySelectorAll('.history').length")
    shown.run(
        "window.given_ = {}; URL.createObjectURL = (blob) => last_ = blob;"
        "HTMLAnchorElement.prototype.click = function () { given_[this.download] = last_ };"
        f"[...document.querySelectorAll('.save[title]')].filter(e => e.textContent === '{form}')"
        ".reduce((before, one) => before.then(() => { one.click(); "
        f"return new Promise(done => {{ const wait = () => given_[one.title.split('\"')[1] + '.{form.lower()}']"
        " ? done() : setTimeout(wait, 20); wait() }) }), Promise.resolve())"
    )
    names = ("Map", "Replay", "Over time", "Every rollout", "Causes by stage", "What matters", "Rate of success",
             "Failures beside successes")  # fmt: skip
    assert shown.run("Object.keys(given_)") == [f"{name}.{form.lower()}" for name in names]
    for name, words in zip(names, (
        "step [a_r]", "0.10 s", "torque of γ [N·m]", "margin", "walk", "friction (world)", "rate of success",
        "slip max [m]"), strict=True):  # fmt: skip
        blob = f"given_['{name}.{form.lower()}']"
        if form == "SVG":
            drawing = ElementTree.fromstring(shown.run(f"{blob}.text()"))
            said = [one.text or "" for one in drawing.iter("{http://www.w3.org/2000/svg}text")]
            assert said[0].endswith(f": {name}")
            assert any(text.startswith("success ") for text in said) == (name in LEGENDED), name
            assert any(words in (one.text or "") for one in drawing.iter("{http://www.w3.org/2000/svg}text")), name
        else:
            seen = shown.run(f"createImageBitmap({blob}).then((one) => [one.width, one.height])")
            assert min(seen) > 60, name
            if name == "Map":
                width = shown.run("document.querySelector('#map-base').clientWidth")
                assert seen[0] == pytest.approx(2 * width, abs=2)
    if form == "SVG":  # it looks as the canvas does
        seen, area = colours(shown), np.s_[14:-50, 66:-16]
        height, width, _ = seen.shape
        shown.run(f"""given_['Map.svg'].text().then((text) => {{ const one = new Image(); one.id = "drawing";
            one.src = "data:image/svg+xml," + encodeURIComponent(text); document.body.append(one);
            return one.decode() }}).then(() => {{ const paper = document.createElement("canvas"); paper.id = "redrawn";
            [paper.width, paper.height] = [{width}, {height}]; document.body.append(paper);
            const text = decodeURIComponent(document.querySelector("#drawing").src);
            const head = Number(/data-head="([0-9.]+)"/.exec(text)[1]);
            paper.getContext("2d").drawImage(document.querySelector("#drawing"), 0, -head) }})""")
        again = colours(shown, "#redrawn")
        assert (np.abs(seen[area].astype(int) - again[area]).max(axis=-1) > 60).mean() < 0.01


@pytest.mark.parametrize("form", ["cells", "marks"])
def test_a_small_map_is_saved_as_vectors(gridded, uneven, form):
    """A path for each rollout; the head names what was simulated."""
    if form == "marks":
        chosen(gridded, "#map-y", "slip_max_m")
    text = drawing(gridded, "Map")
    assert "<image" not in text
    fill = page.data.outcome_kinds_for_page(results.read_results(uneven[0].parent))[0]["colour"]
    red, green, blue = (int(fill[k : k + 2], 16) for k in (1, 3, 5))
    won = (uneven[1]["outcome"] == "success").sum()
    assert text.count(f'fill="rgba({red},{green},{blue},1)"') == won + 1  # and the legend's
    assert "robot hexapod" in text
    assert "n = 25 rollouts" in text


def test_what_goes_with_a_replay_is_told_over_time(shown):
    shown.until("document.querySelectorAll('.history').length")
    titles = shown.run("[...document.querySelectorAll('.history canvas[role]')].map(e => e.getAttribute('aria-label'))")
    for words in (
        "margin to the nearest limit",
        "force on a foot [N]",
        "used share of a foot's available friction",
        "slip of a standing foot",
        "height of a foot",
        "x of the base",
        "y of the base",
        "height of the base",
        "path from above",
        "path from the side",
        "tilt",
        "torque of α",
        "joint γ",
    ):
        assert any(words in title for title in titles), words
    left, top, width, height = shown.place(".history .over")
    shown.click(left + 44 + 0.5 * (width - 52), top + height / 2)
    assert shown.until("document.querySelector('#clock').textContent") == "2.50 s"


def test_plots_over_time_are_read_and_zoomed(shown):
    pictures = drawing(shown, "Over time")
    assert "height of the base [m], in steps of 0.001" in pictures  # which does not change: no stairs of rounding
    assert re.search(r">90</text>", pictures)  # the force of a foot where the cursor is
    left, top, width, height = shown.place(".history .over")
    shown.send("Input.dispatchMouseEvent", type="mousePressed", x=left + 44, y=top + 60, button="left", buttons=1,
               clickCount=1, modifiers=8)  # fmt: skip
    for kind in ("mouseMoved", "mouseReleased"):
        shown.send("Input.dispatchMouseEvent", type=kind, x=left + 44 + 0.4 * (width - 52), y=top + 60, button="left",
                   buttons=1, modifiers=8)  # fmt: skip
    shown.until("/span=0.00..2.0/.test(location.hash)")
    shown.click(left + 44 + 0.5 * (width - 52), top + height / 2)
    assert shown.until("document.querySelector('#clock').textContent") == "1.00 s"
    shown.run("location.reload()")
    shown.until("!('last_' in window) && document.querySelectorAll('.history').length")
    shown.run("document.querySelector('#histories-all').click()")
    shown.until("!location.hash.includes('span')")


def test_a_second_replay_lies_dashed_over_the_first(shown):
    """In every panel, as many lines as the first one has."""
    shown.until("document.querySelectorAll('.history').length")
    dashed = r'<path[^>]* stroke-dasharray="4 3"'
    assert not re.findall(dashed, drawing(shown, "Over time"))
    chosen(shown, "#replay-with", "2")
    shown.until("getComputedStyle(document.querySelector('#scene-b')).display === 'block'")
    panels = drawing(shown, "Over time").split("<svg ")[2::2]  # whose cursors are drawings of their own
    titles = shown.run("[...document.querySelectorAll('.history canvas[role]')].map(e => e.getAttribute('aria-label'))")
    assert len(panels) == len(titles)
    for title, panel in zip(titles, panels, strict=True):
        many = 7 if title.startswith("path from") else 1 if " base " in title or "margin" in title else 6
        assert len(re.findall(dashed, panel)) == many, title


def test_captions_of_narrow_pictures_are_cut_and_not_squeezed(shown):
    chosen(shown, "#replay-with", "2")
    shown.until("getComputedStyle(document.querySelector('#scene-b')).display === 'block'")
    words = list(ElementTree.fromstring(drawing(shown, "Replay")).iter("{http://www.w3.org/2000/svg}text"))
    assert not [one.text for one in words if "textLength" in one.attrib]
    assert any((one.text or "").endswith("…") for one in words)


def test_feet_and_base_are_told_where_mujoco_has_them(shown):
    trace = moved()
    told = {**encode_motion(trace), "bodies": describe_bodies(trace.model, 6)}
    found = by_script(
        shown,
        told,
        """const reel = { model: told.bodies, motion: readMotion(told, told.bodies, await inflate(told.states)) };
        return replayPaths(reel, 0)""",
    )
    data = mujoco.MjData(trace.model)
    for frame in (0, 30, 49):
        data.qpos[:] = trace.qpos[frame]
        mujoco.mj_kinematics(trace.model, data)
        feet = [data.site(f"foot{leg}").xpos for leg in range(1, 7)]
        assert np.abs(np.array(found["feet"])[:, frame] - feet).max() < 5e-3
        assert found["base"][frame] == pytest.approx(trace.qpos[frame, :3], abs=1e-3)


def test_escape_shows_all(shown):
    every = passing(shown)
    shown.run("document.querySelectorAll('#kinds button')[1].click()")
    assert passing(shown) < every
    shown.run("document.querySelector('#map-over').focus()")
    shown.key("Escape")
    assert passing(shown) == every
    assert shown.run("document.querySelectorAll('#kinds button')[1].getAttribute('aria-pressed')") == "true"


def test_a_rate_over_marks_differs_from_place_to_place(shown):
    chosen(shown, "#map-y", "slip_max_m")
    chosen(shown, "#map-colour", "rate")
    shown.until("document.querySelector('#map-key').textContent.includes('bins')")
    pixels = colours(shown)[20:-60, 70:-20].reshape(-1, 3).astype(int)
    blue, yellow = (np.abs(pixels - one).sum(axis=1).min() < 40 for one in ((0, 34, 78), (254, 232, 56)))
    assert (blue, yellow) == (True, True)  # none of a bin's rollouts succeed, and all of another's


def records():
    """The keys of the records that the script says it reads."""
    text = (files("sweep.report.page") / "data.js").read_text()
    found = re.findall(r"@typedef \{object\} (\w+)\n((?: \* @property .*\n)+)", text)
    return {name: set(re.findall(r"@property \{.*\} \[?(\w+)", body)) for name, body in found}


def test_python_writes_the_keys_that_the_script_reads(browser, refined, rare):
    """Both ways: a key that the script lacks is never read, and one that Python lacks is missed."""
    told, folder = records(), refined
    found = results.read_results(folder)
    text = page.render_page(
        found,
        [ShownReplay(0, found.rows.iloc[0], replays.replay_content(found.rows.iloc[0], moved()))],
        live=page.LiveProgress("The study runs", 5.0),
    )
    assert "The study runs. This page reloads itself." in text
    about = json.loads(re.search(r'id="data">(.*?)</script>', text)[1])
    rows = pd.concat([found.rows] * (page.data.MAX_ROWS // len(found.rows) + 1), ignore_index=True)
    many = page.data.page_data(replace(found, rows=rows))
    for name, one in (("About", about), ("Kind", about["kinds"][0]), ("Mesh", about["refined_cells"]),
                      ("Shown", about["replays"][0]), ("Arrow", about["arrow"]), ("Binned", many["densities"][0]),
                      ("Theory", about["theory"][0])):  # fmt: skip
        assert set(one) == told[name], name
    estimate = page.opening.describe_estimate(results.read_results(rare))
    assert estimate
    assert set(estimate[0]) == told["Estimate"]
    assert set(estimate[0]["modes"][0]) == told["Mode"]
    for one in about["columns"]:
        assert set(one) <= told["ColumnFormat"]


def test_a_refined_map_has_cells(browser, refined, tmp_path):
    browser.open(page.write_page(results.read_results(refined), tmp_path / "refined.html"))
    browser.until("performance.getEntriesByName('map').length")
    assert "Cells as refinement left them" in browser.run("document.querySelector('#map-key').textContent")
    assert browser.errors == []


def test_there_is_no_gap_between_cells_for_the_pointer(browser, tmp_path):
    """A click on a line between two of them would let go of what was chosen."""
    assert simulated(tmp_path / "study", "study.axes.friction.num=33", "study.axes.step.num=17") == 0
    browser.open(page.write_page(results.read_results(tmp_path / "study"), tmp_path / "report.html"))
    browser.until("performance.getEntriesByName('map').length")
    left, top, width, height = plot(browser)
    for x, y in np.random.default_rng(0).uniform(0.02, 0.98, (40, 2)):
        browser.mouse("Moved", left + x * width, top + y * height)
        assert not browser.run("document.querySelector('#map-tip').hidden"), (x, y)


def test_a_range_is_of_whole_values_of_a_grid(gridded, uneven):
    """However a drag begins and ends between them, in the map, along lines whatever their scale, and in histograms."""
    rows = uneven[1]
    left, top, width, height = plot(gridded)
    for start, end in ((0.25, 0.75), (0.39, 0.61)):  # five columns of equal width
        gridded.drag(left + start * width, top + height + 20, left + end * width, top + height + 20)
        assert left_over(gridded, rows) == [0.2, 0.4, 0.8]
    canvas = "#distributions-live canvas[aria-label^='friction']"
    left, top, width, height = gridded.place(canvas)
    gridded.drag(left + 10 + 0.3 * (width - 20), top + 30, left + 10 + 0.7 * (width - 20), top + 30)
    assert left_over(gridded, rows) == [0.2, 0.4, 0.8]

    def told(key):
        gridded.key(key)
        return gridded.run("document.querySelector('#told').textContent")

    def dragged(start, end):
        gridded.drag(at, top + 52 + (1 - start) * high, at, top + 52 + (1 - end) * high)
        return left_over(gridded, rows)

    left, top, width, height = gridded.place("#lines-over")
    gridded.run("document.querySelector('#lines-over').focus()")
    first, second, third = told("Escape"), told("ArrowRight"), told("ArrowRight")
    number = [one.startswith("friction") for one in (first, second, third)].index(True)
    at, high = left + 46 + number / 2 * (width - 92), height - 82
    assert dragged(0.15, 0.5) == [0.4, 0.8]
    gridded.click(at, top + 10)  # inverted
    assert dragged(0.3, 0.7) == [0.4, 0.8]
    gridded.click(at, top + 10)  # upright
    rescaled(gridded, "friction (world)", "log")
    gridded.place("#lines-over")
    assert dragged(0.45, 0.8) == [0.4, 0.8]
    assert dragged(0.9, 1.0) == [1.6]
    words = ElementTree.fromstring(drawing(gridded, "Every rollout")).iter("{http://www.w3.org/2000/svg}text")
    assert "1" in [one.text for one in words]  # of its decades
    gridded.place("#lines-over")
    gridded.drag(at, top + 10, at, top + height + 30)  # dropped
    for _ in range(3):
        told("ArrowLeft")
    assert not [one for one in (told("Escape"), told("ArrowRight")) if one.startswith("friction")]


def test_a_histogram_of_a_grid_has_a_bin_for_each_value(shown):
    found = by_script(
        shown,
        {},
        """const grid = [0.1, 0.2, 0.4, 0.8, 1.6], values = [...grid, NaN];
        return Array.from(binRows({ values }, grid.length, equalCellScale(Float64Array.from(grid), 1).to))""",
    )
    assert found == [0, 1, 2, 3, 4, 255]


def test_axes_of_a_margin_are_bent_about_zero(shown):
    """Along lines and in histograms as on the map: even within 0.1, and logarithmic beyond."""
    low, high = -5.0, 1.0
    found = by_script(
        shown,
        {},
        f"""const column = {{ low: {low}, high: {high}, scale: "symlog", linear: 0.1 }}, along = axisMapping(column);
        const values = [-5, -1, -0.1, 0, 0.1, 1];
        return [values.map(along.to), values.map((one) => along.back(along.to(one))), axisTicks(column, 9)]
        """,
    )
    bent = np.arcsinh(np.array([-5, -1, -0.1, 0, 0.1, 1]) / 0.1)
    assert found[0] == pytest.approx((bent - bent[0]) / (bent[-1] - bent[0]))
    assert found[1] == pytest.approx([-5, -1, -0.1, 0, 0.1, 1])
    assert {0, -0.1, 0.1, -1, 1} <= set(found[2])


def test_the_ticks_of_a_margin_reach_both_ends(shown):
    low, high = -6.0, 0.67
    text = f"return axisTicks({{ low: {low}, high: {high}, scale: 'symlog', linear: 0.1 }}, 8)"
    found = by_script(shown, {}, text)
    assert found == sorted(found)
    assert found[0] == -5
    assert found[-1] == 0.5
    assert 0 in found


def test_numbers_along_an_axis_differ_and_rounding_is_no_range(shown):
    text = """const same = { low: 0.8134, high: 0.8134 * (1 + 1e-12), scale: "linear", linear: 0.1 };
        return [formatApart([0.1, 0.10001, 0.10002]), axisMapping(same).to(same.high)]"""
    words, middle_share = by_script(shown, {}, text)
    assert words == ["0.1", "0.10001", "0.10002"]
    assert middle_share == 0.5


def test_a_histogram_is_not_crushed_by_outliers(shown):
    text = """const values = Float64Array.from({ length: 1001 }, (_, k) => (k === 1000 ? 1e6 : k / 1000));
        const column = { values, low: 0, high: 1e6 }, order = Uint32Array.from(values.keys());
        return clippedRange(order, column)"""
    low, high = by_script(shown, {}, text)
    assert low == 0
    assert 0.98 < high < 1


def test_a_screen_reader_hears_the_parts_of_a_description_apart(shown):
    shown.run("document.querySelector('#map-over').focus()")
    shown.key("ArrowRight")
    told = shown.run("document.querySelector('#told').textContent")
    parts = shown.run("[...document.querySelectorAll('#map-tip dt, #map-tip dd')].map((one) => one.textContent)")
    assert ", ".join(f"{name} {value}" for name, value in zip(parts[::2], parts[1::2], strict=True)) in told


def test_where_a_margin_is_zero_there_is_a_line(gridded, uneven):
    """Along a linear figure to the last bits; on a page between the cells of both signs, and nowhere else."""
    pieces = by_script(
        gridded,
        {},
        """const cells = Float64Array.of(0, 1, 2, 3), axis = { cells, to: (value) => value / 3 };
        const rows = Int32Array.from({ length: 16 }, (_, k) => k);
        const here = { form: "cells", x: axis, y: axis, outlines: [], rows, cell: rows };
        return zeroLines(here, (row) => (row % 4) + 2 * Math.floor(row / 4) - 3.3)""",
    )
    ends = np.reshape(pieces, (-1, 2))
    assert len(ends) >= 8
    assert ends[:, 0] + 2 * ends[:, 1] == pytest.approx(3.3 / 3)
    rows = uneven[1]
    chosen(gridded, "#map-colour", "margin")
    gridded.until("document.querySelector('#map-key').textContent.includes('line on the map is at 0')")
    bar = colours(gridded, "#map-key canvas")
    assert bar[5, 60].max() < 90 < bar[5, 50].min()  # a mark where it is 0
    left, top, width, height = plot(gridded) - np.array([*gridded.place("#map-over")[:2], 0, 0])
    seen = colours(gridded)[round(top) : round(top + height), round(left) : round(left + width)].astype(int)
    dark = np.argwhere(np.abs(seen - [28, 32, 36]).max(axis=-1) < 12)
    assert len(dark) > 100
    x, y = (np.unique(rows[name], return_inverse=True)[1] for name in ("world.contact.friction", STEP))
    margin = np.zeros((5, 5))
    margin[y, x] = rows["margin"]
    for j, i in dark[::10]:  # the four middles around it are not of one sign
        across, up = np.clip(np.floor([i / width * 5 - 0.5, (height - j) / height * 5 - 0.5]).astype(int), 0, 3)
        around = margin[max(up - 1, 0) : up + 3, max(across - 1, 0) : across + 3]
        assert around.min() <= 0 < around.max(), (i, j)


def test_rates_of_a_grid_are_up_to_a_value_and_those_of_draws_also_by_number(browser, uneven, tmp_path):
    """A grid is run in the order of its axes: its first rollouts are no sample of it."""
    even = "distribution: {kind: uniform, from: 0.05, to: 0.15}"
    axes = ["~study.axes.step", f"+study.axes.drawn={{path: {STEP}, {even}}}", "~study.axes.friction"]
    assert simulated(tmp_path, *axes, "study.design={kind: monte_carlo, num: 60}") == 0
    drawn = page.write_page(results.read_results(tmp_path), tmp_path / "report.html")
    options = "[...document.querySelector('#rates-by').options].map((one) => [one.value, one.selected])"
    of_page = {}
    for name, path in (("grid", uneven[0]), ("draws", drawn)):
        browser.open(path)
        browser.until("document.querySelectorAll('#rates-by option').length")
        of_page[name] = browser.run(options)
    chosen = {name: next(key for key, selected in listed if selected) for name, listed in of_page.items()}
    assert chosen["grid"] in results.read_results(uneven[0].parent).axes
    assert "" not in [key for key, _ in of_page["grid"]]
    assert chosen["draws"] == ""


def test_a_study_of_each_parameter_alone_opens_on_the_outcomes_along_each(browser, tmp_path):
    axes = ["study.axes.friction.values=[0.2,0.4,0.6,1.0]", "study.axes.step.values=[0.09,0.1,0.11]"]
    assert simulated(tmp_path, *axes, "study.design={grid: one_at_a_time}") == 0
    found = results.read_results(tmp_path)
    path = page.write_page(found, tmp_path / "report.html")
    assert has_first_figure_on_first_screen(browser, path, "#curves")
    browser.open(path)
    browser.until("performance.getEntriesByName('map').length")
    tops = browser.run("['#curves', '#map'].map((one) => document.querySelector(one).getBoundingClientRect().top)")
    assert tops[0] < tops[1]
    labels = browser.run("[...document.querySelectorAll('#curves canvas')].map((one) => one.ariaLabel)")
    assert [label.partition(" ")[0] for label in labels] == ["friction", "step"]  # the larger effect first
    left, top, width, _ = browser.place("#curves canvas")
    left, width = left + 48, width - 58  # without the margins for numbers
    browser.mouse("Moved", left + 0.02 * width, top + 30)
    alone = found.rows[found.rows[STEP] == 0.1]
    failed = alone[(alone["world.contact.friction"] == 0.2)]["cause"].iloc[0]
    assert failed in browser.run("document.querySelector('#curves-tip').textContent")
    browser.drag(left + 0.02 * width, top + 30, left + 0.3 * width, top + 30)
    low = found.rows[found.rows["world.contact.friction"] <= 0.4]
    browser.until(f"document.querySelector('#passing').textContent.startsWith('{len(low)} of ')")
    assert browser.errors == []


def test_a_search_for_failures_opens_on_its_estimate_and_modes(browser, rare, tmp_path):
    """A click on a mode selects its rollouts in every view, and is told to be no condition of a command."""
    found = results.read_results(rare)
    path = page.write_page(found, tmp_path / "report.html")
    assert has_first_figure_on_first_screen(browser, path, "#estimate-chart")
    browser.open(path)
    browser.until("performance.getEntriesByName('map').length")
    tops = browser.run(
        "['#estimate-chart', '#map'].map((one) => document.querySelector(one).getBoundingClientRect().top)"
    )
    assert tops[0] < tops[1]
    (about, column) = page.opening.describe_estimate(found)
    words = [one.text for one in ElementTree.fromstring(drawing(browser, "Probability of failure")).iter() if one.text]
    assert any(word.startswith(f"{about['probability']:.3g}") for word in words)
    left, top, width, _ = browser.place("#estimate-chart")
    browser.mouse("Moved", left + 0.3 * width, top + 130)
    assert about["modes"][0]["label"] in browser.run("document.querySelector('#estimate-tip').textContent")
    browser.click(left + 0.3 * width, top + 130)
    assert passing(browser) == ((column.codes == 0).sum(), len(found.rows))
    browser.run("document.querySelector('#copy').click()")
    assert "only this page has it" in browser.run("document.querySelector('#copied').textContent")
    browser.until("location.hash.includes('failure+mode=0..0')")
    left, top, width, _ = browser.place("#estimate-chart")
    browser.click(left + 0.3 * width, top + 130)
    assert passing(browser)[0] == len(found.rows)
    assert browser.errors == []


def test_names_of_theories_do_not_lie_on_each_other(browser, refined, tmp_path):
    found = results.read_results(refined)
    (theory,) = found.exp.study.theory
    names = [f"limit {k} of friction" for k in range(4)]
    study = replace(found.exp.study, theory=tuple(replace(theory, label=name) for name in names))
    browser.open(page.write_page(replace(found, exp=replace(found.exp, study=study)), tmp_path / "theories.html"))
    browser.until("performance.getEntriesByName('map').length")
    words = ElementTree.fromstring(drawing(browser, "Map")).iter("{http://www.w3.org/2000/svg}text")
    at = {one.text: (float(one.attrib["x"]), float(one.attrib["y"])) for one in words if one.text in names}
    assert len(at) == 4
    heights = sorted(y for _, y in at.values())
    assert min(np.diff(heights)) >= 31  # a line is free between two


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


def test_lines_of_rollouts_keep_off_the_names_at_the_ends_of_an_axis(browser, tmp_path):
    browser.open(
        page.write_page(results.read_results(Path(__file__).parents[1] / "data/ci_smoke"), tmp_path / "engines.html")
    )
    browser.until("performance.getEntriesByName('map').length")
    drawn = list(ElementTree.fromstring(drawing(browser, "Every rollout")).iter())
    upper, lower = (next(float(one.attrib["y"]) for one in drawn if one.text == name) for name in ("native", "mjx"))
    lines = [re.findall(r"[-\d.]+", one.attrib["d"])[1::2] for one in drawn if one.attrib.get("d", "").count("L") > 2]
    heights = np.array([height for line in lines for height in line], dtype=float)
    assert len(heights) > 36
    assert upper < heights.min()
    assert heights.max() < lower


def test_axes_of_lines_are_arranged(shown):
    def first():
        shown.run("document.querySelector('#lines-over').focus()")
        shown.key("Escape")
        return shown.run("document.querySelector('#told').textContent").split(":")[0]

    before = first()
    left, top, width, height = shown.place("#lines-over")  # where it lies with the focus
    shown.drag(left + 46, top + 10, left + width - 46, top + 10)
    assert first() != before
    shown.run("document.querySelector('#lines-reset').click()")
    assert first() == before
    shown.click(left + 46, top + 10)  # inverted: the upper half has the low values
    shown.drag(left + 46, top + 60, left + 46, top + 0.5 * height)
    low, high = re.search(
        r": ([\d.]+) to ([\d.]+)", shown.run("document.querySelector('#filters').textContent")
    ).groups()
    assert float(low) < 0.1
    assert float(high) < 0.8


def test_a_tap_on_a_phone_tells_the_row_and_shows_the_replay(browser, file):
    browser.resize(400, 900)
    browser.open(file)
    browser.until("performance.getEntriesByName('map').length")
    left, top, width, height = plot(browser)
    for kind, points in (("Start", [{"x": left + width / 2, "y": top + height / 2}]), ("End", [])):
        browser.send("Input.dispatchTouchEvent", type=f"touch{kind}", touchPoints=points)
    browser.until("document.querySelector('#replay').getBoundingClientRect().top < 100")
    assert browser.run("document.querySelector('#map-tip').textContent").startswith("success")
    browser.resize(1400, 1000)


def test_every_histogram_is_drawn_on_a_phone(browser, file):
    """Those below the window's end, too, when the first one comes into sight."""
    browser.resize(400, 500)
    browser.open(file)
    browser.until("performance.getEntriesByName('map').length")
    browser.place("#distributions-live canvas")
    blank = """[...document.querySelectorAll('#distributions-live canvas')].filter((one) => !new Uint32Array(
        one.getContext('2d').getImageData(0, 0, one.width, one.height).data.buffer).some(Boolean)).length"""
    browser.until(f"document.querySelectorAll('#distributions-live canvas').length > 4 && {blank} === 0", 5)
    browser.resize(1400, 1000)


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


def test_map_and_replay_fit_a_small_screen(browser, file):
    """With their axes and the play button, scrolled to."""
    browser.resize(1280, 800)
    browser.open(file)
    browser.until("performance.getEntriesByName('map').length")
    browser.run("document.querySelector('#explore').scrollIntoView({block: 'start', behavior: 'instant'})")
    ends = browser.run("""['#map-base', '#scene-a', '#strip', '#play'].map(
        (one) => document.querySelector(one).getBoundingClientRect()).map((box) => [box.top, box.bottom])""")
    browser.resize(1400, 1000)
    for top, bottom in ends:
        assert 0 <= top < bottom <= 800
    assert has_first_figure_on_first_screen(browser, file, "#map-base")


def test_what_is_played_is_filmed(shown):
    shown.run(
        "window.given_ = []; URL.createObjectURL = (blob) => { given_.push(blob); return 'blob:none' };"
        "HTMLAnchorElement.prototype.click = () => {}; document.querySelector('#record').click()"
    )
    shown.until("document.querySelector('#record').getAttribute('aria-pressed') === 'true'")
    at = shown.run("document.querySelector('#clock').textContent")
    shown.until(f"document.querySelector('#clock').textContent !== '{at}'")
    shown.run("new Promise((done) => setTimeout(done, 500)).then(() => document.querySelector('#record').click())")
    shown.until("given_.length")
    assert shown.run("given_[0].type").startswith("video/webm")
    head = shown.run("given_[0].arrayBuffer().then((b) => [...new Uint8Array(b.slice(0, 4))])")
    assert head == [0x1A, 0x45, 0xDF, 0xA3]  # of Matroska, which WebM is


def test_a_film_of_two_shows_both(shown):
    shown.run(
        "HTMLCanvasElement.prototype.captureStream = ((plain) => function (rate) { window.filmed_ = this;"
        " return plain.call(this, rate) })(HTMLCanvasElement.prototype.captureStream)"
    )
    chosen(shown, "#replay-with", "2")
    shown.until("getComputedStyle(document.querySelector('#scene-b')).display === 'block'")
    shown.run("document.querySelector('#record').click()")
    shown.until("document.querySelector('#play').getAttribute('aria-label') === 'pause'")
    shown.run("document.querySelector('#play').click()")
    shown.run("filmed_.id = 'filmed'; document.body.append(filmed_)")
    both = [colours(shown, f"#scene-{one}") for one in "ab"]
    shown.run("document.querySelector('#record').click()")
    assert np.array_equal(colours(shown, "#filmed"), np.concatenate(both, axis=1))
    assert (both[0] != both[0][0, 0]).any()
    assert (both[0] != both[1]).any()


@pytest.mark.filterwarnings("error:constrained_layout not applied")
def test_names_of_others_run_nothing(browser, wide, tmp_path):
    evil = '"\'></script><script>window.hacked=1</script><img src=x onerror="window.hacked=2">'
    found = results.read_results(wide)
    rows = found.rows.head(400).assign(**{"world.obstacle.kind": "plane"})
    rows.loc[:9, ["outcome", "cause", "stage"]] = ["failure", "fell", evil]
    rows.loc[10:19, "world.obstacle.kind"] = evil
    rows = rows.rename(columns={"slip_max_m": "<script>window['hacked']=3</script>_m"})
    study = replace(found.exp.study, name=evil + "x" * 2**20, axes=())
    bad = results.Results(wide, found.stored, replace(found.exp, study=study), rows.infer_objects(), evil, 400)
    path = tmp_path / "evil.html"
    shown = ShownReplay(
        0, rows.iloc[0], {**replays.replay_content(rows.iloc[0], moved()), "why": evil, "stages": [evil]}, evil
    )
    path.write_text(page.render_page(bad, [shown]))
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


@pytest.mark.parametrize(("trace", "feet"), [(moved("scenario=ball_balance"), 6), (arm(), 0)], ids=["robot", "own"])
def test_bodies_are_where_mujoco_has_them(shown, trace, feet):
    """The script's own reading and kinematics, which is not on the page by name, as the module that it is made from."""
    told = {**encode_motion(trace), "bodies": describe_bodies(trace.model, feet)}
    frame = 30
    found = places_by_script(shown, told, frame)
    assert np.abs(np.array(found) - body_places(trace, frame)).max() < 3e-3


RING = """<mujoco><asset><mesh name="ring" builtin="supertorus" params="24 0.2 1 1" scale=".5 .5 .5"/></asset>
<worldbody><body pos="0 0 1"><freejoint/><geom type="mesh" mesh="ring" rgba="1 0 0 1" zaxis="1 0 0"/>
<geom size=".12" rgba="0 0 1 1" pos="-.5 0 0"/></body></worldbody></mujoco>"""


def test_one_sees_through_the_hole_of_a_mesh(shown):
    """A red ring before a blue ball, which neither hides the other whole nor is painted over it."""
    model = mujoco.MjModel.from_xml_string(RING)
    told = {"bodies": describe_bodies(model, 0), "qpos": model.qpos0.tolist()}
    draw = """const canvas = Object.assign(document.createElement("canvas"), { width: 99, height: 99 });
        const pen = canvas.getContext("2d", { willReadFrequently: true });
        const model = withMeshes(told.bodies);
        const view = { sheet: { pen, width: 99, height: 99 }, eye: [3, 0, 1], focus: 150,
                       axes: [[0, 1, 0], [0, 0, 1], [-1, 0, 0]] };
        const light = { direction: [0, 0, 1], sun: 0.5, scale: 1 };
        drawSurfaces(view, model.geoms, bodyPoses(model, Float64Array.from(told.qpos)), light, null);
        return Array.from(pen.getImageData(0, 49, 99, 1).data)"""
    row = np.reshape(by_script(shown, told, draw), (99, 4))
    seen = "".join({(0, 0, 0): " "}.get(tuple(one > 60 for one in rgb), "rb"[int(rgb[2] > rgb[0])]) for *rgb, _ in row)
    assert re.fullmatch(r" +r{5,} *b{5,} *r{5,} +", seen)


def places_by_script(browser, told, frame):
    return by_script(
        browser,
        told,
        f"""const motion = readMotion(told, told.bodies, await inflate(told.states));
            const state = stateAt(motion, {frame + 1} * motion.step);
            return bodyPoses(told.bodies, state).map((pose) => Array.from(pose.pos))""",
    )


def by_script(browser, told, code):
    """What `code` gives, beside the modules that read a replay, as it is `told`."""
    from sweep.report.page.script import EXPORT_KEYWORD, IMPORT_LINE

    source = files("sweep.report.page")
    names = ("numbers.js", "data.js", "axes.js", "contour.js", "kinematics.js", "path.js", "solids.js")
    names += ("surface.js", "depth.js")
    modules = "\n".join(EXPORT_KEYWORD.sub("", IMPORT_LINE.sub("", (source / name).read_text())) for name in names)
    return browser.run(f"""(async () => {{ {modules}
        const told = {json.dumps(told)};
        {code} }})()""")


def test_what_matters_is_what_the_statistics_tell(shown):
    """Of few rows, too: by SciPy's exact p."""
    rng, sets = np.random.default_rng(0), []
    while len(sets) < 40:
        values, failed = rng.normal(size=32), rng.permutation(32) < 9
        values[failed] += rng.uniform(0.5, 1.2)
        told = ks_2samp(values[failed], values[~failed]).pvalue
        if not 0.04 < told < 0.06:  # between which the page only estimates
            sets.append((values.tolist(), failed.astype(int).tolist(), bool(told < 0.05)))
    order = "values.map((_, k) => k).sort((a, b) => values[a] - values[b])"
    code = f"return told.map(([values, sides]) => kolmogorovSmirnov({order}, values, (row) => sides[row]).significant)"
    assert by_script(shown, sets, code) == [told for *_, told in sets]


def test_a_margin_is_read_with_the_limit_that_it_is_to(shown):
    trace = moved()
    told = {**encode_motion(trace), "bodies": describe_bodies(trace.model, 6)}
    read = """const motion = readMotion(told, told.bodies, await inflate(told.states));
        return [Array.from(motion.margin), motion.limits]"""
    margin, limits = by_script(shown, told, read)
    assert np.abs(margin - trace.margin.clip(-1)).max() <= 0.5 / MARGIN_LEVELS + 1e-9
    assert limits == trace.margin_of.tolist()


def test_observations_and_pushes_are_read_as_they_were(shown):
    trace = arm()
    seen = {"observation_phase": np.sin(trace.time), "observation_rate_x": 100 + 0.01 * trace.time}
    groups = (TimeSeriesGroup("phase", "", {"observation_phase": ""}),
              TimeSeriesGroup("rate", "rad/s", {"observation_rate_x": "x"}))  # fmt: skip
    pushes = (Push(1, np.array([0.0, 30.0, 0.0]), 1.0, 1.2), Push(1, np.zeros(3), 1.0, 1.2))
    told = encode_motion(replace(trace, columns=seen, groups=groups, pushes=pushes))
    read = """const motion = readMotion(told, told.bodies, await inflate(told.states));
        const pushes = motion.pushes.map(({ body, force, start, end }) => [body, ...force, start, end]);
        return [pushes, motion.signals.map(({ title, lines, names }) => [title, names, Array.from(lines[0])])]"""
    found, signals = by_script(shown, {**told, "bodies": describe_bodies(trace.model, 0)}, read)
    assert found == [[1, 0, 30, 0, 1, 1.2]]
    assert [(title, names) for title, names, _ in signals] == [("phase", []), ("rate [rad/s]", ["x"])]
    for (*_, values), exact in zip(signals, seen.values(), strict=True):
        assert np.abs(values - exact).max() < np.ptp(exact) / 200


def test_friction_is_read_as_the_share_of_what_there_is(shown):
    trace = moved()
    force = trace.foot_force.copy()  # three feet stand, pulled ahead the more the later
    force[:, ::2, 0] = np.linspace(0, 150, len(force))[:, None]
    trace = replace(trace, foot_force=force)
    told = {**encode_motion(trace), "bodies": describe_bodies(trace.model, 6)}
    read = """const motion = readMotion(told, told.bodies, await inflate(told.states));
        return Array.from(motion.friction)"""
    used = np.nan_to_num(measured_contact_forces(trace).elastic_share)
    assert used.max(axis=0) == pytest.approx([150 / 90, 0] * 3)
    assert np.abs(np.reshape(by_script(shown, told, read), used.shape) - used).max() <= 0.5 / FRICTION_LEVELS + 1e-9


def test_policies_are_sorted_and_their_maps_with_them(browser, folder, axe, tmp_path):
    assert main(["league", str(folder), "--axis", "damping", "--page", str(tmp_path / "league.html")]) == 0
    browser.open(tmp_path / "league.html")
    assert (
        browser.run("document.querySelector('header').innerText").count("500, 514.26 and 530 succeed most often") == 1
    )
    browser.until("document.querySelectorAll('#sides canvas[role=img]').length === 3")
    names = """[[...document.querySelectorAll('#league tbody tr')].map((one) => one.cells[0].textContent),
        [...document.querySelectorAll('#sides .side')].sort((a, b) => a.style.order - b.style.order)
            .map((one) => one.querySelector('canvas').ariaLabel.match(/([\\d.]+): /)[1])]"""
    head = "document.querySelector('#league th button').click()"
    browser.run(head)
    one = browser.run(names)
    browser.run(head)
    other = browser.run(names)
    assert sorted([one[0], other[0]]) == [["500", "514.26", "530"], ["530", "514.26", "500"]]
    assert [one[1], other[1]] == [one[0], other[0]]
    browser.run(f"(() => {{ {axe}; return 0 }})()")
    assert browser.run("axe.run().then((all) => all.violations.map((one) => one.id))") == []
    assert browser.errors == []


@pytest.mark.parametrize(("study", "dark"), [("wide", False), ("wide", True), ("repeated", False), ("rare", False)])
def test_nobody_is_barred(browser, axe, study, file, repeated, rare, tmp_path, dark):
    browser.resize(1400, 1000, dark)
    if study == "rare":
        repeated = [page.write_page(results.read_results(rare), tmp_path / "report.html")]
    browser.open(file if study == "wide" else repeated[0])
    browser.until("performance.getEntriesByName('map').length")
    browser.run("document.querySelectorAll('details').forEach((one) => (one.open = true))")
    browser.run(f"(() => {{ {axe}; return 0 }})()")
    found, sound = browser.run("""axe.run().then((all) => [
        all.violations.map((one) => [one.id, one.nodes[0].html]), all.passes.length])""")
    browser.resize(1400, 1000)
    assert found == []
    assert sound > 20


def test_on_paper_the_figures_stand(browser, repeated):
    browser.open(repeated[0])
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


@pytest.mark.slow
def test_a_million_rows_are_densities(browser, wide, tmp_path):
    found = results.read_results(wide)
    rows = pd.concat([found.rows] * 3, ignore_index=True)
    path = page.write_page(replace(found, rows=rows), tmp_path / "many.html")
    browser.open(path)
    browser.until("document.querySelector('#map-key').textContent.includes('49,152 rollouts counted')")
    assert browser.run("document.querySelector('#passing').textContent") == "all 49,152 rollouts"
    assert kind_counts(browser) == [int((found.rows["outcome"] == word).sum()) * 3 for word in ("success", "failure")]
    left, top, width, height = plot(browser)
    browser.drag(left + 10, top + 10, left + 0.5 * width, top + 0.5 * height)
    chosen, every = passing(browser)
    assert every == 20_000
    assert chosen / every == pytest.approx(0.25, abs=0.03)

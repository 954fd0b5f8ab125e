import json
import re
import shutil
import subprocess

import numpy as np
import pytest
from matplotlib.collections import PolyCollection

from sweep.cli.main import main
from sweep.report import page, slices, typical
from sweep.runs import results, store
from sweep.study.config import compose

BROWSER = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)


@pytest.fixture(scope="module")
def html(folder):
    assert main(["report", str(folder)]) == 0
    return (folder / "report.html").read_text()


def test_the_page_needs_nothing_from_elsewhere(html):
    assert "<script" not in html
    links = re.findall(r"""(?:src|href)=["']([^"']+)|url\(["']?([^"')]+)|@import\s+(\S+)""", html)
    targets = {next(filter(None, link)) for link in links}
    assert targets
    assert all(target.startswith(("#", "data:")) for target in targets)
    identifiers = re.findall(r'\bid="([^"]+)"', html)
    assert len(identifiers) == len(set(identifiers))
    assert {t[1:] for t in targets if t.startswith("#")} <= set(identifiers)


def test_the_page_says_what_was_run_and_what_came_of_it(html, folder):
    rows = store.read_rows(folder)
    success, invalid = (int((rows["outcome"] == word).sum()) for word in ("success", "invalid"))
    assert f"<strong>{success} of {len(rows) - invalid}</strong>" in html
    assert f"{invalid} of 180 are invalid (16.7 %)" in html
    assert html.count(f"Of 180 rollouts {invalid} (16.7 %) are invalid: left out.") == 1  # below the rates
    assert re.search(r"Of \d+ rollouts \d+ \(.+ %\) are invalid: hatched\.", html)  # below the maps
    assert "the base tilted beyond tilt_max_deg" in html
    assert "a number was not finite" in html
    assert store.read_study(folder)["code"] in html
    for cause in ("fell", "not_finite"):
        (point,) = re.findall(rf"sweep replay \S+ (\w+) --mcap {cause}\.mcap", html)
        assert set(rows.loc[rows["point_id"] == point, "cause"]) == {cause}


@pytest.mark.skipif(BROWSER is None, reason="needs a browser: apt-get install chromium")
def test_a_browser_shows_the_figures(html, folder, tmp_path):
    flags = ["--headless", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run",
             "--disable-background-networking", "--disable-component-update", "--disable-sync"]  # fmt: skip
    # the page reports on itself: a copy with a script that measures what the browser laid out
    probe = """<script>addEventListener("load", () => { document.title = JSON.stringify(
        [...document.querySelectorAll("figure svg")].map(s => [s.parentNode.id, s.getBoundingClientRect().width,
        s.getBoundingClientRect().height, s.querySelectorAll("path").length,
        document.documentElement.scrollWidth <= innerWidth])) })</script></body>"""
    copy = tmp_path / "probe.html"
    copy.write_text(html.replace("</body>", probe))
    command = [str(BROWSER), *flags, f"--user-data-dir={tmp_path / 'profile'}", "--window-size=1000,1000"]
    command += ["--dump-dom", copy.as_uri()]
    shown = subprocess.run(command, capture_output=True, text=True, check=True, timeout=120).stdout
    (title,) = re.findall(r"<title>(.*?)</title>", shown)
    found = json.loads(title)
    assert [one[0] for one in found] == ["map-1", "map-2", "map-3", "effects", "causes", "distributions"]
    for key, width, height, paths, fits in found:
        assert (width > 300, height > 150, paths > 10, fits) == (True,) * 4, key


def test_maps_of_three_parameters_are_sections(folder):
    found = results.read(folder)
    maps = list(slices.slices(found))
    assert (maps[0].x, maps[0].y) == ("world.contact.friction", "manoeuvre.half_step_ratio")
    assert [m.beside for m in maps] == ["drive.damping", "manoeuvre.half_step_ratio", "world.contact.friction"]
    table = slices.data(found, maps[0])
    assert len(table) == 6 * 5 * 3
    assert (table["total"] == 2).all()
    rows = found.rows[found.rows["drive.damping"] == 500.0]
    here = table[table["drive.damping"] == 500.0]
    assert here["success"].sum() == (rows["outcome"] == "success").sum()
    assert ((here["low"] <= here["share"]) & (here["share"] <= here["high"])).sum() == here["share"].notna().sum() == 25
    figure = slices.draw(found, maps[0])
    titles = [ax.get_title() for ax in figure.axes[:9]]
    assert titles[3:6] == [f"damping 514.3 N*m*s/rad, {end}" for end in ("lower end", "rate of success", "upper end")]


def test_drawn_points_are_counted_in_bins(folder):
    found = results.read(folder)
    rng = np.random.default_rng(0)
    axes = {name: rng.uniform(0, 1, len(found.rows)) for name in found.numeric[:2]}
    rows = found.rows.drop(columns="drive.damping").assign(**axes)
    (one,) = slices.slices(results.Results(folder, found.stored, found.exp, rows, None))
    table = slices.data(results.Results(folder, found.stored, found.exp, rows, None), one)
    assert table["total"].sum() == len(rows)
    assert len(table) <= 16
    assert "bins" in one.note


def test_the_typical_rollout_is_the_medoid():
    rng = np.random.default_rng(1)
    values = np.vstack([rng.normal(size=(40, 3)), [[0.02, 0.01, 0.0]], [[50.0, 50.0, 50.0]]])
    scaled = typical.standardised(values * [1, 1e3, 1e-6])  # units play no part
    assert typical.medoid(scaled) == 40
    assert typical.medoid(typical.standardised(np.full((3, 2), np.nan))) == 0


def test_the_page_of_one_parameter_and_of_none(fake_engine, tmp_path):
    one = ["run", "study=walk_map", "~study.axes.friction", "study.axes.step.num=3", "study.expect=[]"]
    assert main([*one, f"out={tmp_path / 'one'}"]) == 0
    assert main(["run", "study.replicates=4", "scenario.expect=[]", f"out={tmp_path / 'none'}"]) == 0
    for name in ("one", "none"):
        assert main(["report", str(tmp_path / name)]) == 0
        assert "<h2>Typical rollouts</h2>" in (tmp_path / name / "report.html").read_text()
    assert compose(one[1:]).study.name in page.render(results.read(tmp_path / "one"))


def test_a_refined_map_is_shown_whole(fake_engine, tmp_path):
    axes = ["study.axes.friction.num=5", "study.axes.step.num=5", "study.resolution=0.0625", "study.expect=[]"]
    assert main(["run", "study=walk_map", *axes, f"out={tmp_path}"]) == 0
    found = results.read(tmp_path)
    (one,) = slices.slices(found)
    assert len(one.rows) == 17 * 17 > 2 * len(found.rows)
    assert f"{len(found.rows)} were run" in one.note
    ax = slices.draw(found, one).axes[0]
    cells = [path.get_extents().size for group in ax.findobj(PolyCollection) for path in group.get_paths()]
    assert np.prod(cells, axis=1).sum() == pytest.approx((1.2 - 0.05) * (0.2 - 0.03))
    assert len(ax.lines[0].get_xdata()) == len(found.rows)
    assert "this is not the region's share" in page.render(found)

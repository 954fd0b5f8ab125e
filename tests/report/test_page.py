import re
import sys
from collections import defaultdict
from contextlib import ExitStack
from dataclasses import replace
from importlib.resources import files
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from matplotlib.collections import PolyCollection
from moved import moved

from sweep.cli import live_page
from sweep.cli.main import main
from sweep.config.experiment import compose
from sweep.replay import motion
from sweep.report import figures, page, replay_selection, replays, representative, sections
from sweep.report.page import data, replay_data, script
from sweep.runs import results, store

sys.path.insert(0, str(Path(__file__).parents[2] / "research"))
import example_pages  # pyright: ignore[reportMissingImports]


@pytest.fixture(scope="module")
def html(folder):
    assert main(["report", str(folder)]) == 0
    return (folder / "report.html").read_text()


def test_the_page_needs_nothing_from_elsewhere(html):
    assert html.count("<script") == 3  # data, the page's own script, and states of replays
    outside = re.sub(r"<script.*?</script>", "", html, flags=re.DOTALL)
    links = re.findall(r"""(?:src|href)=["']([^"']+)|url\(["']?([^"')]+)|@import\s+(\S+)""", outside)
    targets = {next(filter(None, link)) for link in links}
    assert targets
    assert all(target.startswith(("#", "data:")) for target in targets)
    identifiers = re.findall(r'\bid="([^"]+)"', html)
    assert len(identifiers) == len(set(identifiers))
    assert {t[1:] for t in targets if t.startswith("#")} <= set(identifiers)


def test_a_name_is_of_one_module_of_the_script():
    """They share one scope, in which a name that is declared twice leaves the page without its script."""
    owners, declared = defaultdict(list), r"^(?:export )?(?:async )?(?:function\*?|class|const|let) (\w+|[\[{].*?[\]}])"
    for file in files("sweep.report.page").iterdir():
        for names in re.findall(declared, file.read_text(), re.MULTILINE) if file.name.endswith(".js") else ():
            for name in re.findall(r"\w+", names):
                owners[name].append(file.name)
    assert len(owners) > 100
    assert {name: where for name, where in owners.items() if len(where) > 1} == {}


@pytest.mark.parametrize("example", example_pages.pages(), ids=lambda path: path.parent.name)
def test_a_shipped_example_has_the_script_and_style_of_today(example):
    text = example.read_text(encoding="utf-8")
    stale = text.replace(script.bundle_script(), "old").replace(script.style_sheet(), "older")
    assert len(stale) == len(text) - len(script.bundle_script() + script.style_sheet()) + len("old" + "older"), (
        "python research/example_pages.py renews them; jobs/paper_tables.sh makes them again"
    )
    assert example_pages.renewed(stale) == text  # with its policy, too, and nothing else of it is another


def test_the_page_says_what_was_run_and_what_came_of_it(html, folder):
    rows = store.read_rows(folder)
    success, invalid = (int((rows["outcome"] == word).sum()) for word in ("success", "invalid"))
    assert f"<strong>{success} of {len(rows) - invalid}</strong>" in html
    assert f"{invalid} of 180 are invalid (16.7 %)" in html
    assert html.count(f"{invalid} of 180 rollouts (16.7 %) are invalid and left out.") == 1  # below the rates
    assert re.search(r"\d+ of \d+ rollouts \(.+ %\) are invalid and hatched\.", html)  # below the maps
    assert "the base tilted beyond 20° (tilt_max_deg)" in html
    assert "a number was not finite" in html
    assert store.read_study(folder)["code"] in html
    for cause in ("fell", "not_finite"):
        (point,) = re.findall(rf"sweep replay \S+ (\w+) --mcap {cause}\.mcap", html)
        assert set(rows.loc[rows["point_id"] == point, "cause"]) == {cause}


def test_maps_of_three_parameters_are_sections(folder):
    found = results.read_results(folder)
    maps = list(sections.list_sections(found))
    assert (maps[0].x, maps[0].y) == ("world.contact.friction", "manoeuvre.half_step_ratio")
    assert [m.panel_parameter for m in maps] == ["drive.damping", "manoeuvre.half_step_ratio", "world.contact.friction"]
    table = sections.section_data(found, maps[0])
    assert len(table) == 6 * 5 * 3
    assert (table["total"] == 2).all()
    rows = found.rows[found.rows["drive.damping"] == 500.0]
    here = table[table["drive.damping"] == 500.0]
    assert here["success"].sum() == (rows["outcome"] == "success").sum()
    assert ((here["low"] <= here["share"]) & (here["share"] <= here["high"])).sum() == here["share"].notna().sum() == 25
    figure = sections.draw_section(found, maps[0])
    titles = [ax.get_title().replace("\n", " ") for ax in figure.axes[:9]]
    assert titles[3:6] == [f"damping 514.3 N·m·s/rad, {end}" for end in ("lower end", "rate of success", "upper end")]


def test_drawn_points_are_counted_in_bins(folder):
    found = results.read_results(folder)
    rng = np.random.default_rng(0)
    axes = {name: rng.uniform(0, 1, len(found.rows)) for name in found.numeric_columns[:2]}
    rows = found.rows.drop(columns="drive.damping").assign(**axes)
    (one,) = sections.list_sections(results.Results(folder, found.stored, found.exp, rows, None))
    table = sections.section_data(results.Results(folder, found.stored, found.exp, rows, None), one)
    assert table["total"].sum() == len(rows)
    assert len(table) <= 16
    assert "bins" in one.note


def test_the_typical_rollout_is_the_medoid():
    rng = np.random.default_rng(1)
    values = np.vstack([rng.normal(size=(40, 3)), [[0.02, 0.01, 0.0]], [[50.0, 50.0, 50.0]]])
    scaled = representative.standardize(values * [1, 1e3, 1e-6])  # units play no part
    assert representative.medoid(scaled) == 40
    assert representative.medoid(representative.standardize(np.full((3, 2), np.nan))) == 0


def test_the_page_of_one_parameter_and_of_none(fake_engine, tmp_path):
    one = ["run", "study=walk_map", "~study.axes.friction", "study.axes.step.num=3", "study.expect=[]"]
    assert main([*one, f"out={tmp_path / 'one'}"]) == 0
    assert main(["run", "study.replicates=4", "scenario.expect=[]", f"out={tmp_path / 'none'}"]) == 0
    for name in ("one", "none"):
        assert main(["report", str(tmp_path / name)]) == 0
        assert "<h2>Representative rollouts</h2>" in (tmp_path / name / "report.html").read_text()
    assert compose(one[1:]).study.name in page.render_page(results.read_results(tmp_path / "one"))


def test_one_success_is_told_without_what_it_does_not_say(fake_engine, tmp_path, capsys):
    assert main(["run", "scenario.expect=[]", f"out={tmp_path}"]) == 0
    assert "1 of 1 succeed (100.0 %), 0 invalid" in capsys.readouterr().out
    text = page.render_page(results.read_results(tmp_path))
    assert "<h2>Figures</h2>" not in text
    assert not re.search(r"interval \d", text)
    assert main(["relabel", str(tmp_path), "tilt_max_deg<50"]) == 0
    assert capsys.readouterr().out == "1 of 1 succeed (100.0 %), 0 invalid (0.0 %)\n"


@pytest.mark.parametrize("listed", ["[0.3, 0.5, 0.7]", "[0.5]"])
def test_only_what_is_drawn_at_one_condition_has_an_interval(fake_engine, tmp_path, listed):
    draws = "{path: manoeuvre.half_step_ratio, distribution: {kind: uniform, from: 0.05, to: 0.15}}"
    axes = [f"study.axes.friction.values={listed}", "~study.axes.step", f"+study.axes.drawn={draws}",
            "study.design={kind: monte_carlo, num: 60}"]  # fmt: skip
    assert main(["run", "study=walk_map", *axes, "study.expect=[]", f"out={tmp_path}"]) == 0
    found = results.read_results(tmp_path)
    (shown,) = figures.effects_figure(found)
    sure = shown.data["low"].notna().groupby(shown.data["axis"]).agg(lambda known: {*known})
    several = "," in listed
    assert sure.get("world.contact.friction", {True}) == {True}  # at each of its values steps are drawn
    assert sure["manoeuvre.half_step_ratio"] == {not several}
    assert ("interval (Wilson) where these are drawn." in shown.caption) == several
    text = page.render_page(found)
    assert ("Without an interval: which points are counted was chosen" in text) == several
    assert f'"sure":{str(not several).lower()}' in text


def test_a_refined_map_is_shown_whole(fake_engine, tmp_path):
    axes = ["study.axes.friction.num=5", "study.axes.step.num=5", "study.resolution=0.0625", "study.expect=[]"]
    assert main(["run", "study=walk_map", *axes, f"out={tmp_path}"]) == 0
    found = results.read_results(tmp_path)
    (one,) = sections.list_sections(found)
    assert len(one.rows) == 17 * 17 > 2 * len(found.rows)
    assert f"{len(found.rows)} were run" in one.note
    ax = sections.draw_section(found, one).axes[0]
    cells = [path.get_extents().size for group in ax.findobj(PolyCollection) for path in group.get_paths()]
    assert np.prod(cells, axis=1).sum() == pytest.approx((1.2 - 0.05) * (0.2 - 0.03))
    assert len(ax.lines[0].get_xdata()) == len(found.rows)
    assert "this is not the share of the region" in page.render_page(found)


def test_columns_are_read_as_they_were(folder):
    """What the script makes of a column's bytes, in Python."""
    rng = np.random.default_rng(0)
    columns = {
        "names": pd.Series(["b", "a", "b"]),
        "levels": pd.Series([0.1, np.nan, 0.3, 0.1]),
        "even": pd.Series(rng.uniform(-3, 5, 4000)),
        "tailed": pd.Series(np.concatenate([rng.normal(size=3999), [1e9]])),
    }
    for name, column in columns.items():
        about, block = data.encode_column(column, 15)
        low, high = np.frombuffer(block, np.uint8).reshape(2, -1).astype(int)
        codes = low + 256 * high
        if name == "names":
            assert [about["names"][k] for k in codes] == column.tolist()
        elif name == "levels":
            assert [about["levels"][k] for k in codes[codes != data.MISSING_CODE]] == [0.1, 0.3, 0.1]
            assert (codes == data.MISSING_CODE).tolist() == column.isna().tolist()
        else:
            found = about["low"] + about["step"] * codes
            found = about["middle"] + about["bend"] * np.sinh(found) if about["bend"] else found
            assert np.abs(found - column).max() < 2e-3 * max(1, np.abs(column).max())
            assert np.median(np.abs(found - column)) < 2e-3


def test_replays_are_typical_then_at_the_boundary_then_extreme(folder):
    found = results.read_results(folder)
    found = replace(found, rows=found.rows.assign(duration_s=5.0))
    rows = replay_selection.choose_replays(found, 12)
    assert [why for why in rows["why"] if why.startswith("typical")] == [
        "typical of success", "typical of fell", "typical of not finite"]  # fmt: skip
    pair = rows[rows["why"].str.startswith("next to the boundary")].iloc[:2]
    assert set(pair["outcome"]) == {"success", "failure"}
    assert rows["why"].str.startswith("largest").any()
    assert rows["point_id"].is_unique
    assert len(replay_selection.choose_replays(found, 500)) == len(found.rows)


def test_rows_keep_slot_and_width_where_the_batch_is_not_too_wide():
    rows = pd.DataFrame({"group": 0, "batch": [0, 1, 1, 2], "slot": [5, 5, 6, 7], "width": [8, 8, 8, 4096]})
    table = replays.pack_rows_into_batches(rows, 512)
    assert table["slot"].tolist() == [5, 5, 6, 0]
    assert table["width"].tolist() == [8, 8, 8, 1]
    assert not table.duplicated(["group", "batch", "width", "slot"]).any()
    assert table["batch"].tolist() == [0, 1, 0, 0]


def test_only_so_many_replays_as_there_is_room_for(folder, tmp_path):
    found = replace(results.read_results(folder), folder=tmp_path)
    for place in (3, 8, 15):
        replays.write_replay(tmp_path, found.rows.iloc[place], moved())
    assert [place for place, _ in replays.read_replays(found)] == [3, 8, 15]
    size = len(replays.read_replay(tmp_path, found.rows.iloc[3])["states"])
    assert size < 6000
    placed = replay_data.describe_replays(found, replay_data.read_shown_replays(found), 3 * size)
    assert [(one["row"], one["frames"]) for one in placed.descriptions] == [(3, 50), (8, 50), (15, 50)]
    placed = replay_data.describe_replays(found, replay_data.read_shown_replays(found), 2 * size)
    assert [one["row"] for one in placed.descriptions] == [3, 8, 15]
    assert all(
        one["frames"] * one["step"] == pytest.approx(5, abs=0.3) and one["frames"] < 50 for one in placed.descriptions
    )
    placed = replay_data.describe_replays(found, replay_data.read_shown_replays(found), size // 2)
    assert placed.omitted_count == 3 - len(placed.streams) > 0


def test_a_long_rollout_takes_no_more_room_than_it_may(monkeypatch):
    """It has fewer frames, evenly spaced to its end, and no fewer than need be."""
    trace, times = moved(), 60
    noise = np.random.default_rng(0)
    same = "foot_force", "foot_position", "qvel", "stage", "margin_of"
    long = {name: np.concatenate([getattr(trace, name)] * times) for name in same}
    long["margin"] = noise.uniform(-1, 1, 50 * times)
    long["joint_torque"] = noise.normal(size=(50 * times, 18))
    long["qpos"] = np.cumsum(noise.normal(0, 0.01, (50 * times, trace.qpos.shape[1])), axis=0)
    long["time"] = 0.1 * (1 + np.arange(50 * times))
    kept = motion.encode_motion(replace(trace, **long))
    every = round(kept["step"] / 0.1)
    assert len(kept["states"]) <= motion.MAX_CHARACTERS
    assert every > 1
    assert kept["frames"] == 50 * times // every
    room = motion.MAX_CHARACTERS
    monkeypatch.setattr(motion, "MAX_CHARACTERS", np.inf)
    whole = motion.encode_motion(replace(trace, **long))
    assert kept == motion.thin_motion(whole, every)
    assert len(motion.thin_motion(whole, every - 1)["states"]) > room


def test_a_thinned_motion_has_the_states_of_its_frames():
    trace = moved()
    kept = "qpos", "qvel", "foot_force", "foot_position", "stage", "margin", "margin_of"
    thin = motion.encode_motion(replace(trace, **{name: getattr(trace, name)[2::3] for name in kept}))
    again = motion.thin_motion(motion.encode_motion(trace), 3)
    assert again["frames"] == thin["frames"] == 16
    assert again["step"] == pytest.approx(0.3)
    assert again["states"] == thin["states"]


def test_a_page_is_rewritten_until_its_run_ends(folder, monkeypatch, capsys):
    seen = []
    with ExitStack() as run:
        run.enter_context(store.lock_folder(folder))
        monkeypatch.setattr(live_page.time, "sleep", lambda _: run.close())
        live_page.watch_run(folder, seen.append)
    assert seen == [page.LiveProgress("The study runs: 180 of 180 rollouts are done", 5.0), None]
    assert live_page.measure_progress(1000, 400, (200, 3.0), 13.0).text.endswith("20.0 a second, about 0:30 min left")
    assert main(["report", str(folder), "--watch", "--replays", "2"]) == 2
    assert "--watch is not allowed with" in capsys.readouterr().err

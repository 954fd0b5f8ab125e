"""Numbers of the pages are those of research/data, and what jobs/paper.yaml makes is what the pages show."""

import fnmatch
import json
import re
import shlex
import sys
from pathlib import Path

import pandas as pd
import pytest
import yaml

from sweep.config.experiment import compose
from sweep.core.errors import InputError
from sweep.core.groups import GROUPS

ROOT = Path(__file__).parents[1]
sys.path[:0] = [str(ROOT / "research"), str(ROOT / "jobs")]

import check_points  # noqa: E402  # pyright: ignore[reportMissingImports]
import cited  # noqa: E402  # pyright: ignore[reportMissingImports]

import paper  # noqa: E402  # pyright: ignore[reportMissingImports]

TARGETS = paper.targets()
PAGES = list(cited.pages())
BY_HAND = ROOT / "tests" / "data" / "tables_by_hand.yaml"


def test_every_block_is_as_its_data_have_it():
    blocks = 0
    for page in PAGES:
        text = page.read_text(encoding="utf-8")
        assert cited.filled(text) == text, f"{page}: python research/cited.py"
        found = cited.BLOCK.findall(text)
        if page.is_relative_to(cited.RESEARCH) and page.name != "README.md":
            assert re.match(r"# .*\n\n<!-- data ?\w*: age -->", text), f"{page}: does not say how old its data are"
        sources = any(form in ("sources", "origin") for _, _, form, *_ in found)
        assert sources or not cited.targets(text), f"{page}: no sources"
        blocks += len(found)
    assert blocks >= 8


def test_other_data_are_another_page(monkeypatch, tmp_path):
    text = "<!-- data pole: rate --> 1 of 2 succeed <!-- end --> and <!-- data pole: along, x -->\nold\n<!-- end -->"
    monkeypatch.setattr(cited, "DATA", tmp_path)
    with pytest.raises(InputError, match="pole has no data"):
        cited.filled(text)
    data = {"success": 3, "valid": 4, "invalid": 1, "along": {"x": [[0.5, 3, 4, 1]]}, "code": "before"}
    (tmp_path / "pole.json").write_text(json.dumps(data))
    assert cited.filled(text) == (
        "<!-- data pole: rate --> 3 of 4 succeed (1 more is invalid) <!-- end --> and "
        "<!-- data pole: along, x -->\n| x | succeed |\n|--:|:--|\n| 0.5 | 3 of 4 (30 to 95 %) |\n<!-- end -->"
    )
    assert cited.outdated(text) == "Measured before the code of this site: pole."
    with pytest.raises(InputError, match="colour is not a form"):
        cited.filled("<!-- data pole: colour --> blue <!-- end -->")


def test_draws_and_cells_are_told_in_tables(monkeypatch, tmp_path):
    monkeypatch.setattr(cited, "DATA", tmp_path)
    figures = {"slip_max_m": [0.001, 0.0123], "clearance_min_m": [-0.002, 0.03], "tilt_max_deg": [0.1, 2]}
    some = {"success": 3, "valid": 4, "causes": {"fell": 1}, "figures": figures}
    grid = {"values": {"world.contact.friction": [0.5, 1], "noise.delay": [0]}, "success": [[1, 4]], "valid": [[3, 4]]}
    along = {"manoeuvre.law": [["tick", 3, 4, 0]], "noise.delay": [[0, 1, 3, 0], [2, 4, 4, 0]]}
    for name, data in {
        "a": some,
        "b": some | {"causes": {}, "figures": {}},
        "c": {"map": grid, "along": along},
    }.items():
        (tmp_path / f"{name}.json").write_text(json.dumps(data))
    head = "| | succeed | others | slip max (mm) | clearance min (mm) | tilt max (°) |"
    assert cited.draws("a b", "slip_max_m clearance_min_m tilt_max_deg").splitlines() == [
        head, "|:--|:--|:--|--:|--:|--:|",
        "| `a` | 3 of 4 (30 to 95 %) | 1 `fell` | 12.3 | -2 | 2 |",
        "| `b` | 3 of 4 (30 to 95 %) |  | | | |",
    ]  # fmt: skip
    assert cited.cells("c").splitlines() == [
        "| delay by friction (world), of 4 | 0.5 | 1 |", "|--:|--:|--:|", "| 0 | 1 of 3 | 4 |",
    ]  # fmt: skip
    assert cited.each("c").splitlines()[2:] == ["| law | tick | 3 of 4 |", "| delay | 0, 2 | 1 of 3, 4 of 4 |"]
    text = "<!-- data a b: draws -->\nold\n<!-- end -->"
    assert cited.targets(text) == {"a", "b"}
    assert cited.filled(text) == f"<!-- data a b: draws -->\n{cited.draws('a b')}\n<!-- end -->"


def strangers(pages, given):
    """A line for each table by hand that is not given, and for each that is given and not there."""
    for page, text in pages.items():
        for head in set(cited.by_hand(text)) - {*given.get(page, [])}:
            yield f"{page}: the table {head} is by hand: make it a block of research/data (research/cited.py)"
    for page, heads in given.items():
        for head in {*heads} - set(cited.by_hand(pages.get(page, ""))):
            yield f"{page}: {head} is not there any more: take it off {BY_HAND.name}"


def test_tables_by_hand_are_those_that_are_given():
    pages = {str(page.relative_to(ROOT)): page.read_text(encoding="utf-8") for page in PAGES}
    told = list(strangers(pages, yaml.safe_load(BY_HAND.read_text(encoding="utf-8"))))
    assert not told, "\n".join(told)


def test_a_table_by_hand_is_told_by_name():
    page, given = "| mass | m |\n|:--|--:|\n| 5 kg | 1.5 |\n", "\n| x |\n|--:|\n| 7 |\n"
    block = f"<!-- data b: draws -->\n{page}<!-- end -->\n{given}"
    assert list(strangers({"a.md": block}, {"a.md": ["| x |"]})) == []
    new, gone = strangers({"a.md": page + given}, {"a.md": ["| x |", "| y |"]})
    assert new.startswith("a.md: the table | mass | m | is by hand: make it a block")
    assert gone.startswith("a.md: | y | is not there any more")


def test_nominal_runs_are_told_with_their_figures(monkeypatch, tmp_path):
    monkeypatch.setattr(cited, "DATA", tmp_path)
    good = {"outcome": "success", "cause": "", "slip_max_m": 0.00123, "tilt_max_deg": 0.5}
    runs = {"a": good, "a:native": {"outcome": "failure", "cause": "fell", "slip_max_m": 0.0}}
    (tmp_path / "nominal.json").write_text(json.dumps({"runs": runs}))
    text = "<!-- data nominal: nominal, a a:native, slip_max_m tilt_max_deg -->\nold\n<!-- end -->"
    assert cited.filled(text).splitlines()[1:-1] == [
        "| | succeeds | slip max (mm) | tilt max (°) |", "|:--|:--|--:|--:|",
        "| `a` | yes | 1.23 | 0.5 |", "| `a`, `native` | `fell` | 0 | |",
    ]  # fmt: skip


def test_rows_are_told_in_groups_and_in_a_grid_of_them(monkeypatch, tmp_path):
    monkeypatch.setattr(cited, "DATA", tmp_path)
    rows = pd.DataFrame(
        [("tick", 1, "success", "", 0.003), ("tick", 1, "success", "", -0.004), ("none", 1, "failure", "fell", 9.0),
         ("tick", 2, "success", "", 2.0), ("none", 2, "failure", "fell", 9.0), ("none", 2, "invalid", "solver", 9.0)],
        columns=["manoeuvre.law", "obstacle.mass", "outcome", "cause", "moved_m"],
    )  # fmt: skip
    target = {"by": ["law", "mass"], "values": {"moved_m": None, "twice_m": "2 * moved_m"}}
    (tmp_path / "a.json").write_text(json.dumps({"groups": paper.groups(rows, target)}))
    assert cited.groups("a", "moved_m twice_m:rms").splitlines() == [
        "| law | mass | succeed | moved (mm) | twice, rms (mm) |", "|--:|--:|:--|--:|--:|",
        "| tick | 1 | 2 of 2 (34 to 100 %) | 3 | 7.07 |", "| none | 1 | `fell` |  |  |",
        "| tick | 2 | yes | 2000 | 4000 |", "| none | 2 | 0 of 1 (0 to 79 %); 1 `fell`, 1 `solver` |  |  |",
    ]  # fmt: skip
    assert cited.grid("a", "law", "moved_m:min").splitlines() == [
        "| mass | law tick | none |", "|--:|--:|--:|", "| 1 | -4 | `fell` |",
        "| 2 | 2000 | 0 of 1 (0 to 79 %); 1 `fell`, 1 `solver` |",
    ]  # fmt: skip


def test_who_learns_is_told_beside_who_believes(monkeypatch, tmp_path):
    monkeypatch.setattr(cited, "DATA", tmp_path)
    rows = [("a", "believes", cited.ROBOT, 3), ("a", "calibrates", cited.ROBOT, 4), ("b", "learns", cited.GROUND, 0)]
    for scenario, robot, (axis, error), success in rows:
        data = {"scenario": scenario, "along": {axis: [[error, success, 4, 1]]}}
        (tmp_path / f"rates_{scenario}_{robot}.json").write_text(json.dumps(data))
    seen = {"scenario": "b", "along": {"noise.delay": [[5, 2, 4, 0]]}}
    (tmp_path / "rates_b_learns_seen.json").write_text(json.dumps(seen))
    assert cited.borne("", "b", "learns", "noise.delay", "5") == "2 of 4"
    assert cited.learned("").splitlines()[2:] == [
        "| `a` | 3 of 4 (30 to 95 %) | 4 of 4 (51 to 100 %) |  |  |", "| `b` |  |  |  | 0 of 4 (0 to 49 %) |",
    ]  # fmt: skip


def test_the_commands_beside_the_sources_figures_say_which_draws():
    commands = [shlex.split(one) for one in re.findall(r"`(sweep run .*?)` \|", cited.compared(""))]
    assert len(commands) > 12
    for _, _, *words in commands:
        study = compose(words[: words.index("--where")] if "--where" in words else words).study
        assert study.seed, words
        assert study.design.num == 128, words


def test_what_is_made_is_shown_and_what_is_shown_is_made():
    shown = set(re.findall(r"figures/(\w+)\.png", "".join(page.read_text(encoding="utf-8") for page in PAGES)))
    made = {pattern for name, one in TARGETS.items() for pattern in figures(name, one)}
    assert {name for name in shown if not any(fnmatch.fnmatch(name, one) for one in made)} == set()
    assert {one for one in made if not fnmatch.filter(shown, one)} == set()


def test_all_data_are_made_by_targets():
    made = {target.get("data", name) for name, target in TARGETS.items()}
    assert {path.stem.removesuffix("_gpu") for path in cited.DATA.glob("*.json")} <= made


def figures(name, target):
    """Patterns of the pictures that a target makes."""
    if "figures" in target:
        found = target["figures"]
        return [found] if isinstance(found, str) else found
    return [name] if target.get("picture", True) else []


@pytest.mark.slow
def test_every_target_can_be_run():
    for name, target in TARGETS.items():
        if "run" in target:
            given = [*target["run"], *target.get("quick", [])]
            assert compose(given).study.axes, name
            assert all(word.split("=")[0] in GROUPS or "." in word for word in given), name
        else:
            assert (ROOT / "research" / target["script"][0]).exists(), name
        assert len(target["budget"]) in (1, 2), name
        assert {"title", "exhibit", "script", "picture"} & set(target), f"{name}: what its map is called"


def test_coarser_studies_take_half_an_hour_on_two_cores():
    budgets = [target["budget"] for target in TARGETS.values() if "alone" not in target]
    assert sum(quick for _, *seconds in budgets for quick in seconds) <= 1800


def test_what_is_beyond_its_interval_is_told_and_kept(monkeypatch, tmp_path):
    monkeypatch.setattr(cited, "DATA", tmp_path)
    one = tmp_path / "one.json"
    of = {"commit": "abc", "code": "one", "quick": False}
    grid = {"values": {"x": [1, 2], "y": [0]}, "success": [[1, 45]], "valid": [[1, 50]]}
    before = of | {"success": 90, "valid": 100, "along": {"x": [[1, 45, 50, 0], [2, 45, 50, 0]]}, "map": grid}
    assert paper.told(one, before) == []
    after = before | {"success": 85, "along": {"x": [[1, 46, 50, 0], [2, 20, 50, 0]]}, "commit": "def", "code": "two"}
    after |= {"map": grid | {"success": [[0, 40]]}}  # a single rollout that ended otherwise, and one of chance
    lines = ["x = 2: 20 of 50 succeed, before 45 of 50", "x and y: 1 of 2 cells"]
    assert paper.told(one, after) == [f"one, {line} (commit abc)" for line in lines]
    assert paper.told(one, after) == [f"one, {line} (commit abc)" for line in lines]  # made again by the same code
    assert json.loads(one.read_text()) == after | {"changed": {"before": "abc", "counts": lines}}
    assert cited.changes("").splitlines()[2:] == [f"| one | def | abc | {line} |" for line in lines]
    assert paper.told(one, after | {"quick": True, "success": 10}) == []  # coarser studies are others


@pytest.mark.slow
def test_what_fails_stops_nothing_else(monkeypatch, tmp_path, capsys):
    """Studies and scripts that there are not, in processes of their own, and two targets of one study in one."""
    same = {"run": ["study=no_such", "engine=fake"], "budget": [2, 2]}
    alone = {"script": ["no_such.py"], "budget": [1, 1]}
    (tmp_path / "paper.yaml").write_text(yaml.safe_dump({"a": same, "drawn": alone, "b": same}))
    monkeypatch.setattr(paper, "JOBS", tmp_path)
    (tmp_path / "robustness.yaml").write_text("{}")
    groups = paper.group_targets({"a": same, "drawn": alone, "b": same})
    assert list(groups) == [{"drawn": alone}, {"a": same, "b": same}]
    assert paper.main(["--jobs", "2", "--out", str(tmp_path)]) == 1
    out = capsys.readouterr().out
    assert [out.count(f"{name} failed: RuntimeError: ") for name in ("a", "b", "drawn")] == [1, 1, 1]
    assert "no_such.py" in out
    assert "study=no_such" in out
    assert paper.main(["--studies", "drawn", "--out", str(tmp_path)]) == 0
    assert paper.main(["no_such_target"]) == paper.main(["--jobs", "0"]) == 2


@pytest.mark.parametrize(("error", "tries"), [("MemoryError", 2), ("RESOURCE_EXHAUSTED: 2 GiB", 2), ("no such", 1)])
def test_what_lacks_memory_is_tried_once_again(monkeypatch, tmp_path, error, tries):
    monkeypatch.setattr(paper, "PAUSE", 0)
    script = f"open({str(tmp_path / 'tries')!r}, 'a').write('.'); raise SystemExit({error!r})"
    with pytest.raises(RuntimeError, match=error):
        paper.run("-c", script)
    assert (tmp_path / "tries").read_text() == "." * tries


def test_coarser_studies_leave_the_pages_alone_and_what_is_drawn_of_all_comes_last(monkeypatch, tmp_path):
    """Scripts in processes of their own, of which one takes no part in what is coarser."""
    here, out = 'from pathlib import Path; here = Path(__file__).with_name("{}.txt"); ', tmp_path / "out"
    (tmp_path / "bench").mkdir()
    (tmp_path / "research").mkdir()
    for name, said in {"first": "1", "all": "here.with_name('first.txt').read_text() + '2'", "long": "3"}.items():
        (tmp_path / "research" / f"{name}.py").write_text(f"{here.format(name)}here.write_text(str({said}))")
    table = {name: {"script": [f"{name}.py"], "budget": [9, 9]} for name in ("all", "first")}
    table["all"]["last"], table["long"] = True, {"script": ["long.py"], "budget": [9]}
    (tmp_path / "paper.yaml").write_text(yaml.safe_dump(table))
    (tmp_path / "robustness.yaml").write_text("{}")
    monkeypatch.setattr(paper, "ROOT", tmp_path)
    monkeypatch.setattr(paper, "JOBS", tmp_path)
    assert paper.main(["--quick", "--jobs", "2", "--out", str(out)]) == 0
    assert (out / "quick" / "research" / "all.txt").read_text() == "12"
    assert not list((tmp_path / "research").glob("*.txt"))
    assert not (out / "quick" / "research" / "long.txt").exists()


def test_shipped_rollouts_end_as_they_did():
    """20 of them, by the commit at hand: `make points`."""
    assert check_points.main([]) == 0


def test_shipped_rollouts_that_end_otherwise_are_told(fake_engine, capsys):
    """The fake engine ends walks by a rule of its own."""
    commits = [name for name in "abcdefghijklmnop" if check_points.choose_rows(name)[0] == "walk_map"]
    one, other = (check_points.choose_rows(name)[1] for name in commits[:2])
    assert set(one["point_id"]) != set(other["point_id"])
    assert check_points.main(commits[:1]) == 4
    told = capsys.readouterr().out.splitlines()
    assert told[0].startswith(f"walk_map, by commit {commits[0]}: {len(told) - 1} of 20 rollouts end otherwise")
    assert {check_points.choose_rows(name)[0] for name in "abcdefghijklmnop"} == set(check_points.STUDIES)

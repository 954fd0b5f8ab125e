"""What a study is headed by: its rate, or the probability of failure that it searched for."""

import re

import pytest

from sweep.analysis import rare
from sweep.cli.main import main
from sweep.report import draws, paper
from sweep.runs import results

RARE = [
    "scenario=walk_tripod", "scenario.expect=[]", "study.name=any", "engine.width=512",
    "study.design={kind: importance, num: 256}",
    "+study.axes.friction={path: contact.friction, side: world, distribution: {kind: normal, mean: 0.8, std: 0.1}}",
    "+study.axes.mass={path: robot.body_mass, side: world, distribution: {kind: normal, mean: 10.0, std: 0.1}}",
]  # fmt: skip


@pytest.fixture
def rare_folder(tmp_path, fake_engine):
    """A study of rare failures on the fake engine; the folder."""
    assert main(["run", *RARE, f"out={tmp_path / 'walk'}"]) in (0, 3)
    return tmp_path / "walk"


def test_a_study_of_rare_failures_is_headed_by_their_probability(rare_folder, tmp_path, capsys):
    found = results.read_results(rare_folder)
    value = rare.estimate_failure_probability(found.rows, found.exp)
    low, high = value.interval
    expected = f"P(failure) = {value.probability:.3g} (95 % interval {low:.2g} to {high:.2g})"
    share = f"{100 * (found.rows['outcome'] == 'success').mean():.1f} %"
    told = {}
    for name, words in {"status": ["status"], "stats": ["stats"], "list": ["list"], "report": ["report"]}.items():
        assert main([*words, str(rare_folder)]) == 0
        told[name] = capsys.readouterr().out
    told["page"] = (rare_folder / "report.html").read_text().partition("<h2>How it was made")[0]
    title = draws.draw_overview(found).get_suptitle()
    told["draws"] = title.replace("\n", " ")
    for name in ("status", "stats", "list", "page", "draws"):
        assert expected in told[name].replace("\n", " "), name
    for text in told.values():
        assert share not in text
        assert not re.search(r"[Rr]ate of success", text.partition('<script type="module">')[0])
    assert "map-1" not in told["page"]
    paper.write_paper(found, tmp_path / "paper")
    main_tex = (tmp_path / "paper/main.tex").read_text()
    assert re.search(r"P\(failure\) is \\\w+Failing\{\}, with a 95", main_tex)
    assert "Rate" not in main_tex + (tmp_path / "paper/numbers.tex").read_text()
    assert share.removesuffix(" %") not in (tmp_path / "paper/tables/success.tex").read_text()

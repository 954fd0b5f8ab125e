import numpy as np
import pandas as pd
import pytest

from sweep.analysis import sequential
from sweep.analysis.compare import SECOND_RUN_MARK
from sweep.cli.main import main
from sweep.runs import store

DRAWS = """scenario: walk_tripod
study:
  name: draws
  design: {num: 16}
  axes:
    friction: {path: contact.friction, side: world, distribution: {kind: uniform, from: 0.05, to: 0.5}}
"""


def pairs(kinds):
    """A pair for each letter: both succeed, lost, gained, none succeeds, invalid."""
    first = {"b": "success", "l": "success", "g": "failure", "n": "failure", "i": "invalid"}
    second = {"b": "success", "l": "failure", "g": "success", "n": "failure", "i": "success"}
    columns = {"outcome": [first[k] for k in kinds], f"outcome{SECOND_RUN_MARK}": [second[k] for k in kinds]}
    return pd.DataFrame({"replicate": range(len(kinds)), **columns})


def test_looking_after_every_pair_keeps_the_level():
    """Of 2,000 comparisons of equals fewer than 5 % are ever decided, however often one looks."""
    kind = np.random.default_rng(0).choice(4, p=[0.8, 0.07, 0.07, 0.06], size=(2000, 3000))
    evidence = sequential.log_e_value(np.cumsum(kind == 1, axis=1), np.cumsum(kind == 2, axis=1))
    assert 0.02 < (evidence >= np.log(20)).any(axis=1).mean() <= 0.05


def test_it_is_a_martingale():
    """After any counts the mean over the next flip, either way as likely, is what it was."""
    b, c = np.meshgrid(np.arange(6), np.arange(6))
    now, lost, gained = (np.exp(sequential.log_e_value(*n)) for n in ((b, c), (b + 1, c), (b, c + 1)))
    np.testing.assert_allclose((lost + gained) / 2, now, rtol=1e-12)


def test_it_stops_at_the_first_pair_that_decides():
    found = sequential.sequential_test(pairs("bblinlbllillnlll" + "ggg"))
    assert found.is_decided
    assert (found.lost, found.gained) == (7, 0)  # 26.8; six in a row are 14.4
    assert (found.pairs, found.invalid, found.unused_pairs) == (12, 2, 5)
    assert found.pairs + found.invalid + found.unused_pairs == len("bblinlbllillnlll" + "ggg")
    shuffled = pairs("bblinlbllillnlll" + "ggg").sample(frac=1, random_state=0)
    assert sequential.sequential_test(shuffled) == found  # in the order of the draws
    assert not sequential.sequential_test(pairs("bblg")).is_decided
    assert "none of 2 pairs is valid" in str(sequential.sequential_test(pairs("ii")))


def test_the_size_of_a_test_looked_at_once():
    """Simulated McNemar tests of that size find the difference about nine times in ten."""
    from scipy.stats import binom

    size = round(sequential.pairs_for_fixed_sample_test(0.12, 0.05))
    kinds = np.random.default_rng(0).multinomial(size, [0.12, 0.05, 0.83], 4000)
    p = 2 * binom.cdf(kinds[:, :2].min(axis=1), kinds[:, :2].sum(axis=1), 0.5)
    assert np.mean(p <= 0.05) == pytest.approx(sequential.TEST_POWER, abs=0.04)  # the exact test is a little weaker


@pytest.mark.slow
def test_two_studies_grow_until_it_is_decided(fake_engine, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "draws.yaml").write_text(DRAWS)
    for name, step in (("a", 0.064), ("b", 0.06)):
        assert main(["run", "study=draws.yaml", f"out={name}", f"manoeuvre.half_step_ratio={step}"]) == 0
    before = store.read_rows(tmp_path / "a")
    anytime = ["compare", "a", "b", "--by", "replicate", "--anytime"]
    capsys.readouterr()
    assert main(anytime) == 0
    assert "not decided" in capsys.readouterr().out
    assert main([*anytime, "--most", "1000"]) == 0
    out = capsys.readouterr().out
    assert "B succeeds more often than A, however often one looked" in out
    a, b = (store.read_rows(tmp_path / name) for name in "ab")
    assert 16 < len(a) == len(b) < 1000
    pd.testing.assert_frame_equal(a.head(16).drop(columns="wall_s"), before.drop(columns="wall_s"))
    assert main(anytime) == 0  # of what is there now
    assert capsys.readouterr().out == out


def test_what_cannot_grow_is_told(fake_engine, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    study = ["run", "study=walk_map", "study.axes.friction.num=6", "study.axes.step.num=5", "study.expect=[]"]
    assert main([*study, "out=a"]) == main([*study, "out=b"]) == 0
    for more in ([], ["--most", "50"]):
        assert main(["compare", "a", "b", "--anytime", *more]) == 2
        assert "the points of a were not drawn at random: they form a grid" in capsys.readouterr().err
    assert main(["compare", "a", "b", "--most", "50"]) == 2
    assert "--most = 50 is for --anytime" in capsys.readouterr().err

import itertools
import shutil

import numpy as np
import pandas as pd
import pytest

from sweep.analysis import compare
from sweep.cli.main import main
from sweep.core.parameters import InputError
from sweep.report import comparison
from sweep.runs import store

STUDY = ["run", "study=walk_map", "study.axes.friction.num=6", "study.axes.step.num=5", "study.expect=[]"]


def rows_of(outcomes, **columns):
    """A row for each letter: s(uccess), f(ailure), i(nvalid)."""
    words = {"s": "success", "f": "failure", "i": "invalid"}
    n = len(outcomes)
    base = {"point_id": [f"p{k}" for k in range(n)], "outcome": [words[o] for o in outcomes],
            "cause": ["" if o == "s" else "fell" for o in outcomes], "stage": "walk", "t_cause_s": np.nan}  # fmt: skip
    return pd.DataFrame({**base, **columns})


def test_flips_are_counted_and_tested_among_valid_pairs():
    pairs = compare.pair_rows(rows_of("ssssssssfi" + "s"), rows_of("sfffffffss" + "i").sample(frac=1, random_state=0))
    found = compare.count_flips(pairs, np.arange(len(pairs)))
    assert (found.pairs, found.tested_pairs, found.lost, found.gained, found.flip_count) == (11, 9, 7, 1, 8)
    assert (found.invalid_a, found.invalid_b, found.invalid_both) == (1, 1, 0)
    assert found.changed_share == pytest.approx(10 / 11)
    assert found.p_value == pytest.approx(2 * (1 + 8) / 2**8)  # two-sided binomial, 1 or fewer of 8
    # Clopper, Pearson: the ends at which 8 or more, and 8 or fewer, of 9 have a probability of 2.5 %
    low, high = found.low, found.high
    assert 9 * low**8 * (1 - low) + low**9 == pytest.approx(0.025)
    assert high**9 == pytest.approx(0.975)


def test_the_exact_test_keeps_its_level():
    """Either direction is as likely: a difference is found in at most a twentieth of the trials."""
    flipped = np.arange(5, 45)
    lost = np.random.default_rng(0).binomial(flipped, 0.5, (25, 40))
    counts = [(k, n - k) for row in lost.tolist() for k, n in zip(row, flipped.tolist(), strict=True)]
    tests = [compare.sign_flip_p_value(np.repeat([1, -1], pair)) for pair in counts]
    assert 0 < np.mean(np.array(tests) <= 0.05) <= 0.05


def test_several_pairs_of_a_draw_are_one_trial_of_the_test():
    """Signs of whole draws are flipped: the p-value is that of all sign patterns, counted one by one."""
    differences = np.array([3, 2, -1, 2, 0, 1, 3])
    signs = np.array(list(itertools.product([-1, 1], repeat=7)))
    exact = np.mean(np.abs(signs @ differences) >= differences.sum())
    assert compare.sign_flip_p_value(differences) == pytest.approx(exact)
    a, b = rows_of("ssssffss" * 4), rows_of("fsffsfss" * 4)
    pairs, rows = compare.pair_rows(a, b), np.repeat(np.arange(8), 4)
    assert compare.count_flips(pairs, rows).p_value > compare.count_flips(pairs, np.arange(32)).p_value


def test_regions_tell_where_outcomes_flip():
    x, y = (v.ravel() for v in np.meshgrid(np.linspace(0, 1, 12), np.linspace(0, 1, 12)))
    axes = {"contact.friction": x, "drive.damping": y}
    a = rows_of(["s"] * 144, **axes)
    b = rows_of(np.where((x < 1 / 3) & (y < 1 / 3), "f", "s"), **axes)
    pairs = compare.pair_rows(a, b)
    table = compare.flips_by_region(pairs, list(axes), np.arange(144))
    assert "p" not in compare.flips_by_region(pairs, list(axes))  # of a grid
    assert (len(table), table["pairs"].sum()) == (9, 144)
    flipped = table[table["flips"] > 0]
    assert flipped["contact.friction"].tolist() == ["0 to 0.2727"]
    assert flipped["p"].item() == pytest.approx(2 / 2**16)
    assert flipped["p_holm"].item() == pytest.approx(9 * 2 / 2**16)
    assert (table.drop(flipped.index)["p_holm"] == 1).all()


def test_pairs_need_one_partner_each():
    a = rows_of("ss", **{"engine.name": ["mjx", "native"]})
    twice = a.assign(point_id="p0")
    assert compare.count_flips(compare.pair_rows(twice, twice[::-1])).pairs == 2  # of equal engines
    with pytest.raises(InputError, match="choose among them with --a"):
        compare.pair_rows(twice.drop(columns="engine.name"), rows_of("s"))
    with pytest.raises(InputError, match="A and B have no rows with equal"):
        compare.pair_rows(a, rows_of("s").assign(point_id="other"))
    with pytest.raises(InputError, match="B has no column"):
        compare.pair_rows(a, rows_of("ss"), ["name"])


def test_another_controller_is_paired_by_what_both_vary():
    """A parameter that is none of the axes renames every point: axes and replicate tell them as well."""
    varied = {"world.contact.friction": [0.1, 0.1, 0.5], "replicate": [0, 1, 2], "engine.width": 4}
    a = rows_of("ssf", **varied)
    b = rows_of("fsf", **varied).assign(point_id=["q0", "q1", "q2"])
    pairs = compare.pair_rows(a, b.iloc[::-1])
    assert compare.count_flips(pairs).lost == 1
    assert comparison.describe_pair_columns(pairs) == " of equal world.contact.friction, replicate"
    assert comparison.describe_pair_columns(compare.pair_rows(a, a)) == ""
    with pytest.raises(InputError, match=r"--by world\.contact\.friction, replicate\)"):
        compare.pair_rows(a, b.assign(replicate=0))
    with pytest.raises(
        InputError, match=r"A and B have no rows with equal .* \(other columns to pair by: none that both vary\)"
    ):
        compare.pair_rows(a, b.rename(columns={"world.contact.friction": "world.robot.shin"}))


def test_drift_is_typical_and_relative():
    a = rows_of("sssf", slip_max_m=[1.0, 2.0, 3.0, 4.0], energy_j=[0.0, 0.0, 0.0, 1.0])
    b = rows_of("sssi", slip_max_m=[1.1, 2.2, 3.3, 900.0], energy_j=[0.0, 0.0, 0.0, 1.0])
    drift = compare.relative_metric_changes(pairs := compare.pair_rows(a, b))
    assert not compare.bit_equal_mask(pairs).any()
    twin = a.assign(slip_max_m=[1.0, np.nextafter(2.0, 3), np.nan, 4.0])
    twins = compare.pair_rows(a.assign(slip_max_m=[1.0, 2.0, np.nan, 4.0]), twin)
    assert compare.bit_equal_mask(twins).tolist() == [True, False, True, True]
    assert drift["slip_max_m"] == pytest.approx(0.1)
    assert drift["energy_j"] == 0


def test_two_folders_on_the_command_line(fake_engine, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert main([*STUDY, "out=a"]) == main([*STUDY, "out=b", "outcome.slip_max_m=0.01"]) == 0
    shutil.copytree("a", "same")
    capsys.readouterr()
    assert main(["compare", "a", "same", "--figures", "0"]) == 0
    out = capsys.readouterr().out
    assert "0 of 30 flip (0.0 %): 0 succeed only in A" in out
    assert "30 of 30 pairs have equal metrics to the last bit" in out
    assert main(["compare", "a", "b", "-o", "flips.csv"]) == 4  # the same figures, a stricter threshold
    out, err = capsys.readouterr()
    flips = pd.read_csv("flips.csv")
    a, b = (store.read_rows(tmp_path / name) for name in "ab")
    lost = (a["outcome"] == "success") & (b["outcome"] == "failure")
    assert len(flips) == lost.sum() > 0
    assert f"{len(flips)} succeed only in A, 0 only in B" in out
    assert "failure (slipped)" in out
    assert "By region (friction (world), half step ratio):" in out
    assert "of the pairs differ, 0.0 % tolerated" in err
    assert main(["compare", "a", "b", "--tolerance", "0.5"]) == 0
    assert main(["compare", "a", "b", "--b", "friction > 0.5", "--tolerance", "1"]) == 4
    assert "of 30 rows of A have no pair in B" in capsys.readouterr().err
    halves = ["--a", "half_step_ratio < 0.04", "--b", "half_step_ratio > 0.19", "--by", "friction"]
    assert main(["compare", "a", "a", *halves, "--tolerance", "1"]) == 0  # another controller at equal friction
    assert "6 pairs; unpaired: 0 rows of A, 0 of B" in capsys.readouterr().out

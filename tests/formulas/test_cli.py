"""`sweep formula` as a user sees it."""

import json

import pytest

from sweep.cli.main import main
from sweep.formulas import FORMULAS


def test_lists_every_formula_in_a_line(capsys):
    assert main(["formula"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert [line.split()[0] for line in lines] == list(FORMULAS)
    assert main(["formula", "2.1.6"]) == 0
    assert capsys.readouterr().out.startswith("corner_balanced ")


def test_prints_inputs_outputs_units_source_and_correction(capsys):
    assert main(["formula", "max_ball", "k_f=0", "b=0"]) == 0
    text = capsys.readouterr().out
    for part in ("monograph (3.1.18-3.1.22)", "corrected: (3.1.22) has", "k_f = 0", "R = 0.855 m"):
        assert part in text


def test_json_holds_the_same(capsys):
    assert main(["formula", "raft_equilibrium", "r_s.0=0.02", "--json"]) == 0
    report = json.loads(capsys.readouterr().out)
    assert report["inputs"]["r_s"]["value"] == [0.02, 0.01, 0.05]
    assert report["outputs"]["depth"]["unit"] == "m"
    assert report["corrected"] is True


def test_sweeps_a_table_with_gaps_and_draws_it(capsys, tmp_path):
    picture = tmp_path / "friction.png"
    assert main(["formula", "corner_balanced", "--sweep", "k=0.9:1.3:3", "--plot", str(picture)]) == 0
    header, outside, inside, _ = capsys.readouterr().out.splitlines()
    assert header.split() == ["k", "k_zeta", "k_tau", "N_u", "N_d"]
    assert outside.split() == ["0.9", "-", "-", "-", "-"]
    assert inside.split()[:2] == ["1.1", "0.151699"]
    assert picture.read_bytes().startswith(b"\x89PNG")


@pytest.mark.parametrize(
    ("argv", "message"),
    [
        (["corner_balanced", "q=1"], "corner_balanced.q is unknown (allowed: eps, k, psi)"),
        (["corner_balanced", "k=-1"], "corner_balanced.k = -1 is not allowed: greater than 0"),
        (["corner_balanced", "k"], "k is not allowed: give inputs as key=value"),
        (["corner_balanced", "k=0.5"], "k must be greater than tan(psi)"),
        (["corner_balanced", "--sweep", "k=0:1"], "key=lo:hi:n"),
        (["corner_balanced", "--sweep", "k=0.1:0.5:3"], "k must be greater than tan(psi)"),
        (["corner_balanced", "--sweep", "q=1:2:3"], "corner_balanced.q is unknown"),
        (["corner_balanced", "--plot", "x.png"], "--plot needs --sweep"),
        (["corner_balanced", "--sweep", "k=1:2:3", "--plot", "no/x.png"], "in a folder that exists"),
        (["corner_balnced"], "did you mean corner_balanced?"),
        (["9.9.9"], "equation 9.9.9 is unknown"),
    ],
)
def test_bad_input_is_one_line_and_exit_2(capsys, argv, message):
    assert main(["formula", *argv]) == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    assert captured.err.count("\n") == 1
    assert message in captured.err

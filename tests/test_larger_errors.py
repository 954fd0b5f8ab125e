"""A probability of rare failures from plain draws of larger errors: near laws whose answer is known; what is kept."""

import json

import numpy as np
import pytest
from rare import Cells, extrapolate
from scipy.optimize import brentq
from scipy.stats import chi2, norm

LAWS = {
    "plane": lambda s: norm.cdf(-3 / s),
    "corner": lambda s: norm.cdf(-2 / s) ** 2,
    "ring": lambda s: chi2.sf((5 / s) ** 2, 8),
}
TARGETS, OF, REPEATS = (1e-2, 1e-3, 1e-4), np.array([20_000, 200_000, 700_000]), 200


def scale(law, p):
    """At which so much fails."""
    return brentq(lambda s: np.log(law(s) / p), 0.3, 10)


@pytest.mark.parametrize("law", LAWS.values(), ids=LAWS)
def test_it_tells_laws_whose_answer_is_known_and_its_intervals_hold(law):
    scales, at = np.array([scale(law, p) for p in TARGETS]), scale(law, 1e-6)
    told, *_ = extrapolate(scales, OF * law(scales), OF, at)
    assert told == pytest.approx(1e-6, rel=0.1)  # the law itself is off by a few percent
    counts = np.random.default_rng(1).binomial(OF, law(scales), (REPEATS, len(OF)))
    ends = np.array([extrapolate(scales, failed, OF, at)[1:] for failed in counts])
    assert 0.91 <= np.mean((ends[:, 0] < 1e-6) & (ends[:, 1] > 1e-6)) <= 0.985


def test_too_few_plain_draws_of_other_code_begin_anew_and_a_line_says_so(tmp_path, capsys):
    told = {"P": 0.01, "failed": 1, "invalid": 0, "seconds": 1.0, "commit": "", "lead": "margin"}
    cells = {"0.01": ("old", 100_000), "0.001": ("old", 5_000), "0.0001": ("new", 700)}
    cells = {p: {"plain": {**told, "code": code, "rollouts": n}} for p, (code, n) in cells.items()}
    about = {"code": "new", "commit": "", "lead": "margin"}
    (tmp_path / "rare.json").write_text(json.dumps({"scenarios": {"walk": {**about, "seconds": 1.0, "cells": cells}}}))
    kept = Cells(tmp_path / "rare.json", "walk", about, True)
    kept.request_plain_draws([*cells, "1e-06"])
    line = f"{tmp_path / 'rare.json'}: walk 0.001 plain begins anew, its 5000 rollouts are of code old\n"
    assert capsys.readouterr().out == line
    assert kept.plain_targets() == ["0.001", "0.0001"]
    assert [kept.cell(p, "plain")["rollouts"] for p in cells] == [100_000, 0, 700]

"""Shares in failing: of laws whose answer is known, from plain draws and from those of importance sampling alike."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pandas as pd
import pytest

from sweep.analysis import failing
from sweep.core.errors import InputError
from sweep.study import design_kinds
from sweep.study.design_kinds.base import DrawContext
from sweep.study.designs import parse_axes, parse_design

NORMAL = {"kind": "normal", "mean": 0, "std": 1}
AXES = parse_axes({name: {"path": f"robot.{name}", "distribution": NORMAL} for name in "abcd"})
COLUMNS = [f"robot.{name}" for name in "abcd"]


def told(kind: str = "monte_carlo") -> Any:
    """What of an experiment is asked for."""
    design = parse_design({"kind": kind, "num": 1000}, AXES)
    sought = design_kinds.is_adaptive_kind(kind)
    search = {"adaptive_design": design, "draw_context": DrawContext(tuple("abcd"), 0)} if sought else {}
    return SimpleNamespace(
        study=SimpleNamespace(axes=AXES, design=design, is_adaptive=sought, points=None, replicates=1, **search)
    )


def rows(u: np.ndarray, failed: np.ndarray, **more: Any) -> pd.DataFrame:
    outcome = np.where(failed, "failure", "success")
    return pd.DataFrame(u, columns=COLUMNS).assign(replicate=np.arange(len(u)), outcome=outcome, **more)


def shares(*given: Any) -> pd.DataFrame:
    table = failing.shapley_failure_shares(*given).set_index("axis").loc[COLUMNS]
    return table.assign(error=(table["high"] - table["low"]) / 2)


def test_what_takes_no_part_has_no_share_and_equals_share_alike():
    u = np.random.default_rng(0).standard_normal((8000, 4))
    found = shares(rows(u, u[:, 0] + u[:, 1] > 2.5), told())
    assert found["share"].iloc[:2].sum() == pytest.approx(1, abs=0.05)
    assert (abs(found["share"].iloc[:2] - 0.5) < found["error"].iloc[:2] + 0.02).all()
    assert found["share"].iloc[2:].isna().all()  # an error as large as the share: no result
    assert (found["high"].iloc[2:] < 0.1).all()
    assert (found["error"] < 0.15).all()


def test_what_acts_only_together_is_seen():
    """A pair whose signs must agree: neither tells anything alone."""
    u = np.random.default_rng(1).standard_normal((4000, 4))
    found = shares(rows(u, u[:, 0] * u[:, 1] > 0), told())
    assert (abs(found["share"].fillna(0) - [0.5, 0.5, 0, 0]) < 0.1).all()
    assert (found["alone"] < 0.15).all()


def test_a_number_that_goes_along_with_another_shares_what_that_does():
    rng = np.random.default_rng(2)
    u = rng.standard_normal((8000, 4))
    u[:, 2] = 0.95 * u[:, 0] + np.sqrt(1 - 0.95**2) * u[:, 2]
    found = shares(rows(u, u[:, 0] > 1.5), told())
    assert found["share"].iloc[0] > found["share"].iloc[2] > 0.2
    assert (abs(found["share"].iloc[[1, 3]].fillna(0)) < 0.1).all()


def test_weights_undo_where_draws_were_sought():
    rng = np.random.default_rng(3)
    wide = 2 * rng.standard_normal((8000, 4))
    weight = np.exp(-0.5 * (wide**2).sum(axis=1) + 0.5 * ((wide / 2) ** 2).sum(axis=1)) * 16
    failed = 2 * wide[:, 0] + wide[:, 1] > 6
    design = {"axis.weight": weight, "axis.round": 2.0}
    sought = shares(rows(wide, failed, **design), told("importance"))
    plain = rng.standard_normal((60_000, 4))
    true = shares(rows(plain, 2 * plain[:, 0] + plain[:, 1] > 6), told())
    assert ((sought["low"] <= true["high"]) & (true["low"] <= sought["high"])).all()
    assert sought["share"].iloc[0] > 0.6


def test_too_little_is_told():
    u = np.random.default_rng(4).standard_normal((100, 4))
    with pytest.raises(InputError, match="need 20 failed and successful draws each, here: 3 and 97"):
        failing.shapley_failure_shares(rows(u, np.arange(100) < 3), told())
    exp = told()
    exp.study.replicates = 10
    with pytest.raises(InputError, match="need 20 failed and successful draws each, here: 3 and 7"):
        failing.shapley_failure_shares(rows(u, np.arange(100) < 30), exp)


def test_a_listed_name_counts_and_draws_that_it_shares_count_once():
    """Of 400 draws at each of four gaits, one gait fails where a draw is large: both decide, nothing else does."""
    axes = parse_axes(
        {"gait": {"path": "manoeuvre.gait", "values": ["w", "x", "y", "z"]}}
        | {name: {"path": f"robot.{name}", "distribution": NORMAL} for name in "ab"}
    )
    exp = told()
    exp.study.axes, exp.study.design = axes, parse_design({"num": 400}, axes)
    u = np.random.default_rng(5).standard_normal((400, 2))
    table = pd.DataFrame(np.tile(u, (4, 1)), columns=["robot.a", "robot.b"])
    table = table.assign(replicate=np.tile(np.arange(400), 4), **{"manoeuvre.gait": np.repeat(list("wxyz"), 400)})
    failed = (table["manoeuvre.gait"] == "w") & (table["robot.a"] > -1)
    found = failing.shapley_failure_shares(table.assign(outcome=np.where(failed, "failure", "success")), exp).set_index(
        "axis"
    )
    assert found.index[0] == "manoeuvre.gait"
    assert found["share"].iloc[0] > 0.7
    idle = found[found.index == "robot.b"]
    assert idle["share"].isna().all()
    assert (idle["high"] < 0.1).all()


def test_shares_lie_between_their_ends_and_within_0_and_1():
    """One number decides alone: its unbiased estimate may exceed 1."""
    for seed in range(8):
        u = np.random.default_rng(seed).standard_normal((128, 4))
        found = failing.shapley_failure_shares(rows(u, u[:, 0] > 0.8), told())
        known = found[found["share"].notna()]
        assert ((known["low"] <= known["share"]) & (known["share"] <= known["high"])).all()
        assert known["share"].between(0, 1).all()
        assert (found["low"] < found["high"]).all()

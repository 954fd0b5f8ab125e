"""Real trials beside simulated rows, where reality is simulated and the answers are known."""

import numpy as np
import pandas as pd
import pytest
from small_study import one_line

from sweep.analysis import trials
from sweep.cli.main import main
from sweep.runs import store
from sweep.study.importance_sampling import effective_sample_size


def test_right_predictions_are_calibrated_and_wrong_ones_are_not():
    """Of 400 sets of trials at the predicted rates about 5 % are called wrong; at rates moved by 0.2 nearly all."""
    rng, called = np.random.default_rng(0), np.zeros(2)
    for _ in range(400):
        predicted = rng.uniform(0.05, 0.95, 150)
        right = rng.random(150) < predicted
        wrong = rng.random(150) < np.clip(predicted - 0.2 * np.sign(predicted - 0.5), 0, 1)
        called += [trials.assess_prediction_calibration(predicted, one).p_value < 0.05 for one in (right, wrong)]
    assert 0.02 < called[0] / 400 < 0.08
    assert called[1] / 400 > 0.9


def test_the_brier_score_of_right_predictions_is_their_variance():
    predicted = np.full(40_000, 0.3)
    found = trials.assess_prediction_calibration(predicted, np.arange(40_000) % 10 < 3)
    assert found.brier == pytest.approx(found.expected_brier) == pytest.approx(0.21)
    curve = trials.reliability_curve(np.repeat([0.1, 0.9], 50), np.repeat([False, True], 50))
    assert curve[["trials", "success"]].to_numpy().tolist() == [[50, 0], [50, 50]]
    assert curve["high"].iloc[0] == pytest.approx(1 - 0.025 ** (1 / 50))  # Clopper-Pearson of 0 of 50


def test_trials_say_which_parameter_reality_has():
    """A trial at c succeeds if c + x < 1.2, and x is 0.72: after the trials x is between 0.7 and 0.8, y anything."""
    rng = np.random.default_rng(0)
    values = pd.DataFrame({"x": rng.random(4000), "y": rng.random(4000)})
    conditions = np.arange(11) / 10
    simulated = (conditions + values[["x"]].to_numpy() < 1.2).astype(float)
    weights = trials.draw_likelihood_weights(simulated, conditions + 0.72 < 1.2, 1e-6)
    table = trials.prior_posterior_table(values, weights).set_index("parameter")
    assert effective_sample_size(weights) == pytest.approx(values["x"].between(0.7, 0.8).sum(), abs=1)
    assert table.loc["x", "mean_after"] == pytest.approx(0.75, abs=0.005)
    assert table.loc["x", "sd_after"] == pytest.approx(0.1 / np.sqrt(12), abs=0.003)
    p = table["p_holm"].to_dict()
    assert p["x"] < 1e-6 < p["y"]


def test_parameters_that_do_not_matter_rarely_move():
    rng, moved = np.random.default_rng(1), 0
    for _ in range(300):
        values = pd.DataFrame(rng.random((200, 3)), columns=["x", "y", "z"])
        weights = trials.draw_likelihood_weights(rng.random((200, 8)), rng.random(8) < 0.5, 0.05)
        moved += (trials.prior_posterior_table(values, weights)["p_holm"] < 0.05).any()
    assert moved / 300 < 0.08


STUDY = """scenario: walk_tripod
study:
  name: draws
  design: {num: 60}
  axes:
    step: {path: manoeuvre.half_step_ratio, side: belief, values: [0.02, 0.05, 0.08, 0.1]}
    friction: {path: contact.friction, side: world, distribution: {kind: uniform, from: 0.05, to: 0.6}}
"""


def test_the_command_finds_the_friction_of_a_simulated_reality(fake_engine, tmp_path, monkeypatch, capsys):
    """The fake engine walks where friction >= 5 step: success at 0.05 and not at 0.08 means 0.25 to 0.4."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "draws.yaml").write_text(STUDY)
    assert main(["run", "study=draws.yaml", "out=draws"]) == 0
    outcomes = ["success", "success", "failure", "failure"]
    real = pd.DataFrame({"step": [0.02, 0.05, 0.08, 0.1] * 3, "outcome": outcomes * 3})
    real.to_csv("real.csv", index=False)
    capsys.readouterr()
    assert main(["trials", "real.csv", "draws", "-o", "out.csv", "--picture", "curve.png"]) == 0
    printed = capsys.readouterr().out
    assert "12 trials at 4 conditions: 50.0 % succeed" in printed
    line = next(line for line in printed.splitlines() if "friction" in line)
    assert 0.25 <= float(line.split("|")[4]) <= 0.4
    rows = store.read_rows(tmp_path / "draws")
    won = (rows["outcome"] == "success")[rows["belief.manoeuvre.half_step_ratio"] == 0.05].sum()
    assert pd.read_csv("out.csv")["predicted"].iloc[1] == pytest.approx((won + 0.5) / 61)
    (tmp_path / "one.csv").write_text("step,outcome\n0.02,success\n")
    assert main(["trials", "one.csv", "draws"]) == 0
    assert "nan" not in capsys.readouterr().out
    for text, message in (
        ("step,outcome\n0.03,success\n", "has no valid row with"),
        ("step,outcome\n0.02,perhaps\n", "outcome = perhaps is not allowed: success or failure"),
        ("step\n0.02\n", "has no column outcome"),
        ("stap,outcome\n0.02,1\n", "stap"),
    ):
        (tmp_path / "bad.csv").write_text(text)
        assert main(["trials", "bad.csv", "draws"]) == 2
        one_line(capsys.readouterr().err, message)

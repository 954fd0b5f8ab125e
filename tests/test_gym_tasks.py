"""Tasks of gymnasium as projects: rewards and lengths are those of the task's own environment."""

from pathlib import Path

import numpy as np
import pytest
from robots import save_perceptron
from small_study import one_line

from sweep.cli.main import main
from sweep.runs import store

gymnasium = pytest.importorskip("gymnasium")
pytest.importorskip("imageio")
onnxruntime = pytest.importorskip("onnxruntime")


@pytest.mark.parametrize(("task", "sizes", "more"), [
    ("Ant-v5", (27, 8), {"include_cfrc_ext_in_observation": False, "contact_cost_weight": 0.0}),
    ("Hopper-v5", (11, 3), {}),
])  # fmt: skip
def test_the_reward_of_a_task_is_that_of_its_environment(tmp_path, monkeypatch, task, sizes, more):
    monkeypatch.chdir(tmp_path)
    save_perceptron("net.onnx", sizes, 0.5)
    assert main(["init", "--gym", task, "--policy", "net.onnx", "made"]) == 0
    env = gymnasium.make(task, reset_noise_scale=0.0, **more)
    network = onnxruntime.InferenceSession("net.onnx", providers=["CPUExecutionProvider"])
    seen, _ = env.reset(seed=0)
    rewards, terminated = [], False
    while len(rewards) < 40 and not terminated:
        (action,) = network.run(None, {"obs": seen[None]})[0]
        before = env.unwrapped.data.qpos[0]
        seen, reward, terminated, _, info = env.step(action)
        ahead = (env.unwrapped.data.qpos[0] - before) / env.unwrapped.dt  # Ant's environment reads an older position
        rewards.append(reward - info["reward_forward"] + ahead)
    monkeypatch.chdir("made")
    duration = 40 * env.unwrapped.dt
    Path("studies/one.yaml").write_text("scenario: own\nstudy: {axes: {error: {path: noise.white, values: [0.0]}}}\n")
    assert (
        main(["run", "study=one", "engine.precision=float64", "~start", f"model.duration={duration}", "out=one"]) == 0
    )
    row = store.read_rows(Path("one")).iloc[0]
    assert row["healthy_steps"] == len(rewards)
    assert row["reward_sum"] == pytest.approx(np.sum(rewards), abs=1e-6)
    assert row["outcome"] == "failure"  # it cannot live for the 1000 steps of the task in so short a time


@pytest.mark.parametrize(("words", "line"), [
    (["--gym", "Ant"], "--gym Ant is unknown: did you mean Ant-v5?"),
    (["--gym", "Ant-v5", "--model"], "--gym is not allowed with --mjcf or --model"),
    (["--gym", "Ant-v5", "--policy", "none.onnx"], "--policy none.onnx is not allowed"),
])  # fmt: skip
def test_a_task_that_cannot_be_is_one_line(tmp_path, monkeypatch, capsys, words, line):
    monkeypatch.chdir(tmp_path)
    assert main(["init", *words, "made"]) == 2
    one_line(capsys.readouterr().err, line)

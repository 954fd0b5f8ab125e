"""Tasks of gymnasium as projects: rewards and lengths are those of the task's own environment."""

from contextlib import contextmanager
from pathlib import Path

import mujoco
import numpy as np
import pytest
from robots import save_perceptron
from small_study import one_line

from sweep.cli.main import main
from sweep.runs import store

gymnasium = pytest.importorskip("gymnasium")
pytest.importorskip("imageio")
onnxruntime = pytest.importorskip("onnxruntime")


@contextmanager
def exact_state(env):
    """Within it, all arrays of the environment's data belong to the end of its last tick."""
    stepped, model = env.data, env.model
    env.data = mujoco.MjData(model)
    for name in ("qpos", "qvel", "ctrl", "qacc_warmstart"):
        getattr(env.data, name)[:] = getattr(stepped, name)
    mujoco.mj_forward(model, env.data)
    mujoco.mj_rnePostConstraint(model, env.data)
    yield
    env.data = stepped


# ticks before Ant touches the ground: MJX turns the friction cones of capsules that are within 30 degrees of upright
AIR = 3


@pytest.mark.parametrize(("task", "sizes", "gain", "engine", "ticks"), [
    ("Ant-v5", (105, 8), 0.5, "native", 40),
    ("Hopper-v5", (11, 3), 0.5, "native", 40),
    pytest.param("Ant-v5", (105, 8), 0.5, "mjx", AIR, marks=pytest.mark.slow),
    pytest.param("Ant-v5", (27, 8), 0.5, "native", 40, marks=pytest.mark.slow),
    pytest.param("Humanoid-v5", (348, 17), 0.2, "native", 40, marks=pytest.mark.slow),
])  # fmt: skip
def test_the_reward_of_a_task_is_that_of_its_environment(tmp_path, monkeypatch, task, sizes, gain, engine, ticks):
    monkeypatch.chdir(tmp_path)
    save_perceptron("net.onnx", sizes, gain)
    assert main(["init", "--gym", task, "--policy", "net.onnx", "made"]) == 0
    env = gymnasium.make(task, reset_noise_scale=0.0).unwrapped
    network = onnxruntime.InferenceSession("net.onnx", providers=["CPUExecutionProvider"])
    env.reset(seed=0)

    def x():
        return env.data.subtree_com[0, 0] if task.startswith("Humanoid") else env.data.qpos[0]

    def contact_cost():
        return env.contact_cost if hasattr(env, "contact_cost") else 0.0

    rewards, terminated = [], False
    while len(rewards) < ticks and not terminated:
        with exact_state(env):
            seen, before = env._get_obs(), x()
        (action,) = network.run(None, {"obs": seen[None, : sizes[0]]})[0]
        action = np.clip(action, env.action_space.low, env.action_space.high)
        _, reward, terminated, _, info = env.step(action)
        # the environment reads forward speed and contact forces of a state within its last physics step
        reward -= info["reward_forward"] + info.get("reward_contact", 0.0)
        with exact_state(env):
            rewards.append(reward + env._forward_reward_weight * (x() - before) / env.dt - contact_cost())
    monkeypatch.chdir("made")
    duration = ticks * env.dt
    Path("studies/one.yaml").write_text("scenario: own\nstudy: {axes: {error: {path: noise.white, values: [0.0]}}}\n")
    assert (
        main(["run", "study=one", f"engine={engine}", "engine.precision=float64", "~start",
              f"model.duration={duration}", "out=one"]) == 0
    )  # fmt: skip
    row = store.read_rows(Path("one")).iloc[0]
    assert row["healthy_steps"] == len(rewards)
    assert row["reward_sum"] == pytest.approx(np.sum(rewards), abs=1e-6)
    assert row["outcome"] == "failure"  # it cannot live for the 1000 steps of the task in so short a time


@pytest.mark.parametrize(("words", "line"), [
    (["--gym", "Ant"], "--gym Ant is unknown: did you mean Ant-v5?"),
    (["--gym", "Ant-v5", "--model"], "--gym is not allowed with --mjcf or --model"),
    (["--gym", "Ant-v5", "--policy", "none.onnx"], "--policy none.onnx is not a file"),
    (["--gym", "Ant-v5", "--policy", "odd.onnx"],
     "odd.onnx is not allowed: it takes 30 numbers; the task observes 105, or 27 without cfrc_ext"),
])  # fmt: skip
def test_a_task_that_cannot_be_is_one_line(tmp_path, monkeypatch, capsys, words, line):
    monkeypatch.chdir(tmp_path)
    save_perceptron("odd.onnx", (30, 8), 0.5)
    assert main(["init", *words, "made"]) == 2
    one_line(capsys.readouterr().err, line)

"""Networks in files of PyTorch: equal to PyTorch itself, and as policies equal to the same network in ONNX."""

from pathlib import Path

import jax
import numpy as np
import pandas as pd
import pytest
from robots import write_project
from small_study import one_line

from sweep.cli.main import main
from sweep.config.experiment import compose
from sweep.runs import batches
from sweep.runs.runner import select_points_to_simulate
from sweep.systems.mujoco_model.torch_network import read_torch_network

torch = pytest.importorskip("torch")
pytest.importorskip("onnxscript")
RECURRENT = """
observation: {obs: [projected_gravity, joint_positions, joint_velocities]}
recurrent:
  - {input: h, output: output_1, shape: [1, 1, 8]}
  - {input: c, output: output_2, shape: [1, 1, 8], start: 0.1}
action: {scale: 0.1, stiffness: 90, damping: 2}
"""


class RecurrentPolicy(torch.nn.Module):
    """An LSTM with its state as inputs and outputs."""

    def __init__(self, inputs: int, outputs: int):
        super().__init__()
        self.cell, self.last = torch.nn.LSTM(inputs, 8), torch.nn.Linear(8, outputs)

    def forward(self, obs: torch.Tensor, h: torch.Tensor, c: torch.Tensor):
        found, (h, c) = self.cell(obs.unsqueeze(0), (h, c))
        return self.last(found.squeeze(0)), h, c


class PolicyWithState(torch.nn.Module):
    """A policy that keeps its state in the module, as some exporters write it."""

    def __init__(self):
        super().__init__()
        self.register_buffer("past", torch.zeros(1, 3))

    def forward(self, obs: torch.Tensor):
        self.past[:] = self.past + obs
        return self.past * 1.0


def save(policy, file, given):
    """Save a module in the form that the file's name says."""
    if file.endswith(".pt2"):
        torch.export.save(torch.export.export(policy, given), file)
    else:
        torch.jit.script(policy).save(file)


@pytest.fixture
def here(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    torch.manual_seed(0)
    return tmp_path


@pytest.mark.parametrize("file", ["walk.pt", "walk.pt2"])
def test_a_network_is_that_of_torch(here, file):
    layers = [torch.nn.Linear(48, 64), torch.nn.ELU(), torch.nn.LayerNorm(64), torch.nn.Linear(64, 32), torch.nn.SiLU()]
    policy = torch.nn.Sequential(*layers, torch.nn.Linear(32, 12), torch.nn.Tanh()).double().eval()
    save(policy, file, (torch.zeros(1, 48, dtype=torch.float64),))
    seen = torch.randn(100, 1, 48, dtype=torch.float64)
    with jax.enable_x64(True):
        evaluate = jax.jit(read_torch_network(file, Path(file)).evaluate)
        (name,) = read_torch_network(file, Path(file)).inputs
        found = [evaluate({name: one.numpy()})["output_0"] for one in seen]
    np.testing.assert_allclose(found, policy(seen).detach().numpy(), atol=1e-12)


@pytest.mark.parametrize("file", ["walk.pt", "walk.pt2"])
def test_a_recurrent_policy_carries_its_state_over_ticks(here, file, capsys):
    write_project(here, RECURRENT, more=f", period: 0.02, controller: {file}", motors=True, legs=1)
    scenario = Path("scenarios/own.yaml")
    scenario.write_text(scenario.read_text().replace("controller: walk.onnx, ", ""))
    policy = RecurrentPolicy(9, 3).eval()
    save(policy, file, (torch.zeros(1, 9), torch.zeros(1, 1, 8), torch.zeros(1, 1, 8)))
    exp = compose(["study=one", "engine.precision=float64"])
    rows = batches.assign_batches(exp, pd.DataFrame(), select_points_to_simulate(exp)).assign(width=1)
    task = batches.make_batch(exp, rows)
    made = exp.system.make_engine(task.settings, task.world, task.belief, None)
    columns = made.trace(task.world, task.belief, task.streams, 0).columns
    seen = np.stack([one for name, one in columns.items() if name.startswith("observation_")], axis=1)
    h, c = torch.zeros(1, 1, 8), torch.full((1, 1, 8), 0.1)
    wanted = []
    for one in torch.tensor(seen, dtype=torch.float32):
        action, h, c = policy(one[None], h, c)
        wanted.append(action[0].detach().numpy())
    found = np.stack([one for name, one in columns.items() if name.startswith("action_")], axis=1)
    assert len(wanted) == 50
    np.testing.assert_allclose(found, wanted, atol=1e-6)
    assert main(["policy", "check", "own"]) == 0
    assert f"| lf_hip     | {wanted[0][1]:.4g}" in capsys.readouterr().out


def test_a_project_of_a_torch_policy_runs(here, monkeypatch):
    write_project(here, "preset: playground\n")
    policy = torch.nn.Sequential(torch.nn.Linear(48, 12), torch.nn.Tanh())
    save(policy, "walk.pt", None)
    assert main(["init", "--policy", "walk.pt", "--mjcf", "robot.xml", "made"]) == 0
    monkeypatch.chdir("made")
    assert main(["run", "study=push_delay", "model.duration=0.04", "study.axes.push.num=2"]) == 0


@pytest.mark.parametrize(("write", "line"), [
    (lambda: torch.save(torch.nn.Linear(48, 12), "walk.pt"), "walk.pt holds no TorchScript: torch.jit.script(policy)"),
    (lambda: save(PolicyWithState(), "walk.pt", None), "walk.pt returns other numbers when it is called again"),
    (lambda: save(torch.nn.Linear(5, 12), "walk.pt", None), "cannot be evaluated for inputs [(1, 3)]"),
])  # fmt: skip
def test_a_file_that_is_no_policy_is_one_line(here, capsys, write, line):
    write_project(here, "observation: [projected_gravity]\naction: {offset: 0.0}\n", more=", controller: walk.pt")
    scenario = Path("scenarios/own.yaml")
    scenario.write_text(scenario.read_text().replace("controller: walk.onnx, ", ""))
    write()
    assert main(["run", "study=one", "out=wrong"]) == 2
    one_line(capsys.readouterr().err, line)
    assert not Path("wrong").exists()

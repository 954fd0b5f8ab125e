import shutil
import subprocess
import tarfile

import fake_engine
import pytest
from moved import moved

import sweep.engines
from sweep.cli.main import main
from sweep.report import replays
from sweep.runs import batches, results

AXE = "4.10.3"


def simulated(out, *overrides):
    """A study of the fake engine in the folder `out`; the exit status of the command."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sweep.engines, "make_engine", fake_engine.FakeEngine)
        batches.clear_engine_cache()
        status = main(["run", "study=walk_map", "study.expect=[]", *overrides, f"out={out}"])
        batches.clear_engine_cache()
    return status


@pytest.fixture(scope="session")
def folder(tmp_path_factory):
    """A study of 180 rollouts of the fake engine: three parameters, two replicates, one invalid column."""
    out = tmp_path_factory.mktemp("study")
    axes = ["study.axes.friction.values=[0.1,0.3,0.5,0.7,0.9,7.0]", "study.axes.step.num=5",
            "+study.axes.damping={path: drive.damping, values: [500.0, 514.26, 530.0]}"]  # fmt: skip
    assert simulated(out, *axes, "noise.position_noise=0.001", "study.replicates=2", "engine.width=60") == 3
    return out


@pytest.fixture(scope="session")
def wide(tmp_path_factory):
    """A map of 16,384 rollouts of the fake engine, of which some have a replay that was moved by hand."""
    out = tmp_path_factory.mktemp("wide")
    assert simulated(out, "study.axes.friction.num=128", "study.axes.step.num=128", "engine.width=8192") == 0
    rows, trace = results.read_results(out).rows, moved("scenario=pole_climb")
    for place in range(64, len(rows), 1000):
        replays.write_replay(out, rows.iloc[place], trace)
    return out


@pytest.fixture(scope="session")
def refined(tmp_path_factory):
    """A map of the fake engine that was refined, with the limit of a theory over it."""
    out = tmp_path_factory.mktemp("refined")
    theory = ("study.theory=[{label: least friction, formula: corner_least_friction, output: k, of: contact.friction, "
              "inputs: {psi: 0.0, eps: 1.1, squeeze: 'manoeuvre.half_step_ratio * 8'}}]")  # fmt: skip
    axes = ["study.axes.friction.num=5", "study.axes.step.num=5", "study.resolution=0.0625", theory]
    assert simulated(out, *axes) == 0
    return out


@pytest.fixture(scope="session")
def axe(tmp_path_factory):
    """The source of axe, which looks for what bars people from a page, where npm can fetch it."""
    folder = tmp_path_factory.mktemp("axe")
    command = ["npm", "pack", "--silent", f"axe-core@{AXE}"]
    if not shutil.which("npm") or subprocess.run(command, cwd=folder, capture_output=True, timeout=60).returncode:
        pytest.skip(f"needs npm and axe-core {AXE}")
    with tarfile.open(folder / f"axe-core-{AXE}.tgz") as packed:
        source = packed.extractfile("package/axe.min.js")
        assert source
        return source.read().decode()

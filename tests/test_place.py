"""Where rollouts go on a machine with a GPU: few to the CPU, those of a folder where its rows are from."""

import jax
import pytest
from small_study import STUDY, without_progress

from sweep.backends import devices
from sweep.cli.main import main
from sweep.fused.llvm import TILE_LANES
from sweep.runs import store

FEW, MANY = ["study.axes.friction.num=4"], ["study.axes.friction.num=5"]  # of 7 half steps
CPU, GPU = "2 x cpu, of some processor", "1 x NVIDIA H100 80GB HBM3"


@pytest.fixture(autouse=True)
def with_a_gpu(monkeypatch, fake_engine):
    """A machine with two cores and a GPU, as long as JAX is told nothing; what it is told is taken back."""
    before = jax.config.jax_platforms
    jax.config.update("jax_platforms", None)
    monkeypatch.setattr(devices, "find_spec", lambda name: name == "jax_plugins")
    monkeypatch.setattr(devices, "NVIDIA_DEVICE_FILES", "/dev/null")
    monkeypatch.setattr(devices, "count_cores", lambda: 2)
    monkeypatch.setattr(devices, "search_devices_in_background", lambda: None)
    yield
    jax.config.update("jax_platforms", before)


def chosen(capsys, *command: str) -> tuple[str | None, str]:
    """What JAX is told by a command, and the lines on standard error that tell of it."""
    jax.config.update("jax_platforms", None)
    assert main([*command]) in (0, 3)
    lines = without_progress(capsys.readouterr().err).splitlines()
    return jax.config.jax_platforms, "\n".join(line for line in lines if "CPU" in line)


def simulated_on(folder, device: str) -> None:
    """Let the rows of a folder be from elsewhere."""
    store.write_study(folder, {**store.read_study(folder), "devices": [device]})


def test_few_rollouts_go_to_the_cpu_and_a_line_says_so(tmp_path, capsys):
    few = ["run", *STUDY, *FEW]
    assert 4 * 7 <= 2 * TILE_LANES < 5 * 7
    told = "sweep: on the CPU, where few rollouts end sooner (set JAX_PLATFORMS=cuda,cpu to use the GPU)"
    assert chosen(capsys, *few, f"out={tmp_path}") == ("cpu", told)
    assert chosen(capsys, "run", *STUDY, *MANY, f"out={tmp_path / 'many'}") == (None, "")
    assert chosen(capsys, *few, "engine.compiler=xla", "--dry-run", f"out={tmp_path / 'xla'}") == (None, "")
    assert chosen(capsys, *few, "study.resolution=0.1", "--dry-run", f"out={tmp_path / 'rounds'}") == (None, "")
    jax.config.update("jax_platforms", "cuda,cpu")  # as by JAX_PLATFORMS
    assert main([*few, f"out={tmp_path / 'forced'}"]) == 0
    assert (jax.config.jax_platforms, "CPU" in capsys.readouterr().err) == ("cuda,cpu", False)


def test_one_rollout_goes_there_but_not_the_first_of_several_runs_of_one_process(capsys):
    told = "sweep: on the CPU, where a rollout ends sooner (set JAX_PLATFORMS=cuda,cpu to use the GPU)"
    assert chosen(capsys, "run", "study.expect=[]") == ("cpu", told)
    assert chosen(capsys, "run", "--multirun", "study.expect=[]", "study.seed=0,1") == (None, "")


def test_a_part_of_many_goes_where_the_rest_will(tmp_path, capsys):
    assert chosen(capsys, "run", *STUDY, *MANY, "--limit", "8", f"out={tmp_path}") == (None, "")


def test_rows_of_a_folder_are_of_one_kind_of_device(tmp_path, capsys):
    folder = f"out={tmp_path / 'rows'}"
    assert chosen(capsys, "run", *STUDY, *FEW, folder)[0] == "cpu"
    simulated_on(tmp_path / "rows", CPU)
    told = f"sweep: on the CPU, as the rows of {tmp_path / 'rows'} were (set JAX_PLATFORMS=cuda,cpu to use the GPU)"
    assert chosen(capsys, "run", *STUDY, *MANY, folder) == ("cpu", told)
    assert chosen(capsys, "audit", str(tmp_path / "rows"), "--points", "1", "--ways", "again") == ("cpu", told)
    simulated_on(tmp_path / "rows", GPU)
    assert chosen(capsys, "run", *STUDY, *FEW, folder) == (None, "")
    assert chosen(capsys, "audit", str(tmp_path / "rows"), "--points", "1", "--ways", "half_step") == (None, "")

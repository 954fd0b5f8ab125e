import shutil
import signal
import subprocess
import sys
from pathlib import Path

import jax
import pytest
from fake_engine import FakeEngine
from small_study import STUDY, content

import sweep.engines
from sweep.backends import devices
from sweep.cli import execution
from sweep.cli.main import main
from sweep.runs import batches

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT / "bench"))  # scenes that are measured are tested, too
devices.configure_jax()  # before any test uses JAX: the CPU is split as for the command line
signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell's background job ignores it, and all that it starts


@pytest.fixture(scope="module")
def double():
    """A module's tests in double precision."""
    with jax.enable_x64(True):
        yield


@pytest.fixture(scope="session", autouse=True)
def unrecorded():
    """Studies that tests run in this process record no replays, which takes seconds each; yields what records them."""
    with pytest.MonkeyPatch.context() as patch:
        record = execution.record_study_replays
        patch.setattr(execution, "record_study_replays", lambda *_: None)
        yield record


@pytest.fixture
def recorded(unrecorded, monkeypatch):
    """Studies of this test record replays, as they do for users."""
    monkeypatch.setattr(execution, "record_study_replays", unrecorded)


@pytest.fixture
def fake_engine(monkeypatch, request):
    """Every engine that is made is a fake one, of another class where a test is parametrised by one."""
    monkeypatch.setattr(sweep.engines, "make_engine", getattr(request, "param", FakeEngine))
    batches.clear_engine_cache()
    yield
    batches.clear_engine_cache()


@pytest.fixture(scope="session")
def whole(tmp_path_factory):
    """The rows of an undisturbed run of the small study."""
    folder = tmp_path_factory.mktemp("whole")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sweep.engines, "make_engine", FakeEngine)
        batches.clear_engine_cache()
        assert main(["run", *STUDY, f"out={folder}"]) == 0
        batches.clear_engine_cache()
    return content(folder)


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config, log):
    """Keep a file's tests in one process: compiled engines are shared within a module."""
    from xdist.scheduler import LoadFileScheduling

    return LoadFileScheduling(config, log)


@pytest.fixture(scope="session")
def built(tmp_path_factory) -> Path:
    """A folder with the sdist, and the wheel that is made of it."""
    folder, tree = tmp_path_factory.mktemp("dist"), tmp_path_factory.mktemp("tree")
    for name in ("sweep", "conf"):  # a checkout's own list of sources, of builds before, would hide what is not found
        shutil.copytree(ROOT / name, tree / name, ignore=shutil.ignore_patterns("__pycache__"))
    for name in ("pyproject.toml", "setup.py", "README.md", "LICENSE", ".git"):
        (tree / name).symlink_to(ROOT / name)
    asked = [sys.executable, "-m", "build", "--no-isolation", "--outdir", folder, tree]
    done = subprocess.run(asked, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout[-2000:] + done.stderr[-2000:]
    return folder

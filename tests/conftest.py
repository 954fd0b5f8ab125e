import pytest
from fake_engine import FakeEngine

import sweep.engines
from sweep import batches
from sweep.engines import devices

devices.configure()  # before any test uses JAX: the CPU is split as for the command line


@pytest.fixture
def fake_engine(monkeypatch):
    """Every engine that is made is a fake one."""
    monkeypatch.setattr(sweep.engines, "make", FakeEngine)
    batches.forget_engine()
    yield
    batches.forget_engine()


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config, log):
    """Keep a file's tests in one process: compiled engines are shared within a module."""
    from xdist.scheduler import LoadFileScheduling

    return LoadFileScheduling(config, log)

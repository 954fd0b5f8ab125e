import pytest
from fake_engine import FakeEngine

import sweep.engines


@pytest.fixture
def fake_engine(monkeypatch):
    """Every engine that is made is a fake one."""
    monkeypatch.setattr(sweep.engines, "make", FakeEngine)

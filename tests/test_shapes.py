"""Arrays have the shapes that annotations promise: cheap tests again, with every call checked (`make shapes`: more)."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

pytest.importorskip("beartype")  # of the extra dev

HERE = Path(__file__).parent
CHEAP = ("controllers/test_gaits.py", "controllers/test_tracker.py", "controllers/test_observer.py",
         "formulas/test_statics.py", "models/test_leg.py", "models/test_contact.py")  # fmt: skip
LIES = """
import jax.numpy as jnp
import pytest
from jaxtyping import TypeCheckError
from sweep.core.rotations import IDENTITY
from sweep.models.posture import feet_in_world
from sweep.models.robot import Robot

@pytest.mark.parametrize(("angles", "fits"), [(jnp.zeros((6, 3)), True), (jnp.zeros((3, 6)), False)])
def test_call(angles, fits):
    try:
        feet_in_world(Robot(), jnp.zeros(3), jnp.array(IDENTITY), angles)
    except TypeCheckError:
        assert not fits
    else:
        assert fits
"""


def pytest_with_shapes(*words):
    env = {**os.environ, "PYTHONPATH": os.pathsep.join([str(HERE), os.environ.get("PYTHONPATH", "")])}
    run = [sys.executable, "-m", "pytest", "-q", "-x", "-p", "shapes", "-p", "no:cacheprovider", *map(str, words)]
    return subprocess.run(run, cwd=HERE.parent, env=env, capture_output=True, text=True, check=False)


def test_cheap_tests_pass_with_every_call_checked(tmp_path):
    (tmp_path / "test_lies.py").write_text(LIES)
    done = pytest_with_shapes(*(HERE / name for name in CHEAP), tmp_path / "test_lies.py")
    assert done.returncode == 0, done.stdout[-3000:]

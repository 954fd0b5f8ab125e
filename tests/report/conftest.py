import fake_engine
import pytest

import sweep.engines
from sweep.cli.main import main
from sweep.runs import batches


@pytest.fixture(scope="session")
def folder(tmp_path_factory):
    """A study of 180 rollouts of the fake engine: three parameters, two replicates, one invalid column."""
    out = tmp_path_factory.mktemp("study")
    axes = ["study.axes.friction.values=[0.1,0.3,0.5,0.7,0.9,7.0]", "study.axes.step.num=5",
            "+study.axes.damping={path: drive.damping, values: [500.0, 514.26, 530.0]}"]  # fmt: skip
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sweep.engines, "make", fake_engine.FakeEngine)
        batches.forget_engine()
        rest = ["study.expect=[]", "noise.position_noise=0.001", "study.replicates=2", "engine.width=60", f"out={out}"]
        assert main(["run", "study=walk_map", *axes, *rest]) == 3
        batches.forget_engine()
    return out

import resource
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from fake_engine import FakeEngine

from sweep.cli.main import main

COMMANDS = """
import sys, sweep
from sweep.cli.main import main
folder = sys.argv[1]
assert len(sweep.load(folder)) == 1_000_000
assert main(["table", folder, "--format", "csv", "-o", folder + "/table.csv"]) == 0
assert main(["report", folder]) == 0
"""


class MeasuringEngine(FakeEngine):
    """Figures of which no two are alike: neither text nor files of them are shorter than a robot's."""

    def run(self, world, belief, streams):
        values = np.random.default_rng(0).normal(size=(20, self.width)).astype(np.float32)
        return super().run(world, belief, streams) | {f"figure_{k}_m": v for k, v in enumerate(values)}


@pytest.mark.slow
@pytest.mark.parametrize("fake_engine", [MeasuringEngine], indirect=True)
def test_a_million_rows_are_loaded_tabled_and_reported_in_four_gigabytes(fake_engine, tmp_path):
    axes = ["study.axes.friction.num=1000", "study.axes.step.num=1000", "engine.width=8192", "study.expect=[]"]
    assert main(["run", "study=walk_map", *axes, f"out={tmp_path}"]) == 0
    subprocess.run([sys.executable, "-c", COMMANDS, str(tmp_path)], check=True)
    assert resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss < 4 * 2**20  # KiB
    assert Path(tmp_path / "report.html").stat().st_size < 2**21
    assert Path(tmp_path / "map.svg").stat().st_size < 2**18

"""A fast engine with an analytic region of success, and the command line run with it (for tests in a subprocess)."""

import os
import signal
import sys
import time
from dataclasses import replace

import numpy as np
from faultless import faultless

import sweep.engines
from sweep.contract.system import split_side_prefix


class FakeEngine:
    """Slips where the world's friction is below five times the believed half step ratio; NaN at a friction of 7."""

    stages = ("stand", "walk")
    duration = 10.0

    def __init__(self, settings, world, belief, limits):
        self.world = world
        self.period = settings.control_period
        self.dynamics = "none"
        self.devices = 1
        self.width = settings.width or 8

    def rollout_bytes(self):
        return 2048

    def find_inactive_parameters(self, sides, ends):
        """Return all columns but the two that `run` reads, and what obstacles and sensors may have."""
        read = ("contact.friction", "manoeuvre.half_step_ratio", "obstacle.", "noise.")
        return {c for c in ends if not split_side_prefix(c)[1].startswith(read)}

    def run(self, world, belief, streams):
        friction, ratio = np.broadcast_arrays(world.contact.friction, belief.manoeuvre.half_step_ratio)
        friction, ratio = (np.broadcast_to(v, (self.width,)).astype(float) for v in (friction, ratio))
        assert streams.shape == (self.width,)
        time.sleep(float(os.environ.get("FAKE_SECONDS", "0")))
        if self.width > int(os.environ.get("FAKE_ROOM", "1000000")):
            raise MemoryError
        if os.environ.get("FAKE_DEATH") and np.any(friction == float(os.environ["FAKE_DEATH"])):
            os.kill(os.getpid(), signal.SIGKILL)
        if (mark := os.environ.get("FAKE_STOP")) and np.any(friction == 1.2) and not os.path.exists(mark):
            open(mark, "w").close()  # stopped once, as by SIGSTOP or a file system that does not answer
            os.kill(os.getpid(), signal.SIGSTOP)
        tilt = np.where(friction < 5 * ratio, 40.0, 1.0) * np.where(friction == 7, np.nan, 1.0)
        good = {name: np.full(self.width, value) for name, value in faultless(self.world).items()}
        return good | {
            "tilt_max_deg": tilt, "slip_max_m": 0.08 * ratio / (friction + 0.01), "end_stage": np.ones(self.width),
            "clearance_min_m": np.full(self.width, 0.05), "noise_draw": streams % 1000 / 1000,
            "duration_s": np.full(self.width, self.duration),
        }  # fmt: skip

    def run_with_time_series(self, world, belief, streams, slots, watch):
        """Return time series in which every column is the time; the rollout is not finite from half of it on."""
        figures = self.run(world, belief, streams)
        time = self.period * watch.every * (1 + np.arange(int(self.duration / self.period / watch.every + 1e-9)))
        samples = np.tile(time[:, None, None], (1, len(slots), len(watch.columns)))
        broken = np.isnan(figures["tilt_max_deg"][slots]) & (time[:, None] > self.duration / 2)
        return figures, np.where(broken[..., None], np.nan, samples)

    def trace(self, world, belief, streams, slot):
        return self.traces(world, belief, streams, 1)[slot]

    def traces(self, world, belief, streams, every):
        """Return the same motion for every row, with the row's metrics."""
        from moved import moved

        figures, trace = self.run(world, belief, streams), moved()
        rows = [{name: values[slot] for name, values in figures.items()} for slot in range(self.width)]
        return [replace(trace, stages=self.stages, metrics=row) for row in rows]


def install():
    sweep.engines.make_engine = FakeEngine


def dask_setup(worker):
    """Install the fake engine in Dask workers that preload this module."""
    install()


if __name__ == "__main__":
    from sweep.cli.main import main

    install()
    sys.exit(main(sys.argv[1:]))

"""Fake engines with failures four standard deviations away, whose probability is known, and the axes of their study."""

import numpy as np
from fake_engine import FakeEngine

FAR = 4.0  # standard deviations to the nearest failure
AXES = (
    "study.axes={friction: {path: contact.friction, side: world, distribution: {kind: normal, mean: 0.8, std: 0.01}}, "
    "mass: {path: robot.body_mass, side: world, distribution: {kind: normal, mean: 10, std: 0.1}}}"
)


class LeadingEngine(FakeEngine):
    """Tilts more with lower friction and mass, and fails where both are four standard deviations low."""

    def run(self, world, belief, streams):
        figures = super().run(world, belief, streams)
        u = [np.broadcast_to(v, (self.width,)) for v in (world.contact.friction, world.robot.body_mass)]
        away = ((u[0] - 0.8) / 0.01 + (u[1] - 10.0) / 0.1) / np.sqrt(2)
        return figures | {"tilt_max_deg": 10 - 10 * away / FAR, "slip_max_m": np.zeros(self.width)}


class CliffEngine(LeadingEngine):
    """Fails at the same place, without any warning before."""

    def run(self, world, belief, streams):
        figures = super().run(world, belief, streams)
        return figures | {"tilt_max_deg": np.where(figures["tilt_max_deg"] > 20, 40.0, 1.0)}

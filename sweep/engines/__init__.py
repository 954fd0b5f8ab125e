"""Engines run batches of rollouts: `mjx` (the primary one) and `native` (C MuJoCo, the second opinion)."""

from sweep.engines.base import Engine
from sweep.engines.settings import EngineSettings
from sweep.metrics.outcome import Thresholds
from sweep.models.case import Case


def make(settings: EngineSettings, world: Case, belief: Case, limits: Thresholds | None = None) -> Engine:
    """The engine of a scenario.

    `world` and `belief` give its structure, and plain numbers for a nominal plan; `limits` say when to note a cause.
    """
    if world.control.calibrate == "simulated":
        from sweep.engines.calibration_rollout import Calibrating

        return Calibrating(make, settings, world, belief, limits or Thresholds())
    if settings.name == "native":
        from sweep.engines.native import Native

        return Native(settings, world, belief, limits)
    from sweep.engines.mjx import Mjx

    return Mjx(settings, world, belief, limits)

"""Engines simulate batches of rollouts: `mjx`, the primary one, and `native` (C MuJoCo), the independent check."""

from sweep.contract.engine import Engine
from sweep.contract.engine_settings import EngineSettings
from sweep.metrics.outcome import OutcomeThresholds
from sweep.models.case import Case


def make_engine(settings: EngineSettings, world: Case, belief: Case, limits: OutcomeThresholds | None = None) -> Engine:
    """Make the engine that the settings name, which simulates batches of a scenario's rollouts.

    Args:
        settings: engine, time steps, precision and batch width.
        world: nominal parameters of the simulated side; they fix the structure of the compiled programs.
        belief: nominal parameters that the planner receives.
        limits: thresholds of the metrics that end a success; by default the standard ones.

    Returns:
        The engine. Its programs are compiled at the first batch.

    Raises:
        InputError: The nominal parameters admit no plan, or the settings do not fit the scenario.
    """
    if world.control.calibrate == "simulated":
        from sweep.engines.calibration_rollout import CalibratingEngine

        return CalibratingEngine(make_engine, settings, world, belief, limits or OutcomeThresholds())
    if settings.name == "native":
        from sweep.engines.native import NativeEngine

        return NativeEngine(settings, world, belief, limits)
    from sweep.engines.mjx import MjxEngine

    return MjxEngine(settings, world, belief, limits)

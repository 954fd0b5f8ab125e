"""Engines run batches of rollouts: `mjx` (the primary one) and `native` (C MuJoCo, the second opinion)."""

from sweep.case import Case
from sweep.engines.base import Engine
from sweep.engines.settings import EngineSettings


def make(settings: EngineSettings, world: Case, belief: Case) -> Engine:
    """The engine of a scenario; `world` and `belief` give its structure, and plain numbers for a nominal plan."""
    if settings.name == "native":
        from sweep.engines.native import Native

        return Native(settings, world, belief)
    from sweep.engines.mjx import Mjx

    return Mjx(settings, world, belief)

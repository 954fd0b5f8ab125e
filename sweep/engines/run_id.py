"""How a row was simulated: rows are equal bit for bit only at an equal `run_id`."""

import hashlib

import jax

from sweep.core import provenance
from sweep.engines import devices
from sweep.engines.settings import EngineSettings


def device(settings: EngineSettings) -> str:
    """Kind of the devices an engine runs on, and how many share a batch."""
    devices.configure()
    return f"{jax.device_count()} x {jax.devices()[0].device_kind}" if settings.name == "mjx" else "cpu"


def run_id(settings: EngineSettings) -> str:
    """Hash of how a row is simulated: engine, steps, precision, width, device, code."""
    content = repr((settings, device(settings), provenance.code_version()))
    return hashlib.blake2b(content.encode(), digest_size=6).hexdigest()

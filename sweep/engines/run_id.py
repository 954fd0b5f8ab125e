"""How a row was simulated: rows are equal bit for bit only at an equal `run_id`."""

import hashlib
import os

import jax

from sweep.core import provenance
from sweep.engines import devices
from sweep.engines.settings import EngineSettings

# of the environment, which change what is compiled or drawn
FLAGS = (
    "XLA_FLAGS",
    "JAX_ENABLE_X64",
    "JAX_DEFAULT_PRNG_IMPL",
    "JAX_THREEFRY_PARTITIONABLE",
    "JAX_DISABLE_MOST_OPTIMIZATIONS",
)


def device(settings: EngineSettings) -> str:
    """Kind of the devices an engine runs on, how many share a batch, and what else changes the code made for them."""
    devices.configure()
    native = settings.name == "native"
    parts = ["cpu" if native else f"{jax.device_count()} x {jax.devices()[0].device_kind}"]
    if native or jax.default_backend() == "cpu":
        parts.append(provenance.processor())
    if not native:
        parts += [f"{name}={os.environ[name]}" for name in FLAGS if os.environ.get(name)]
    return ", ".join(parts)


def run_id(settings: EngineSettings, *more: str) -> str:
    """Hash of how a row is simulated: engine, steps, precision, width, device, code, and what `more` tells."""
    content = repr((settings, device(settings), provenance.code_version(), *more))
    return hashlib.blake2b(content.encode(), digest_size=6).hexdigest()

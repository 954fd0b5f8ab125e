"""The `run_id` of a row: a hash of everything that changes its bits, so that rows with equal `run_id` repeat bit for
bit."""

import hashlib
import os

import jax

from sweep.backends import devices
from sweep.contract.engine_settings import EngineSettings
from sweep.core import provenance

# environment variables that change compiled code or random numbers
ENVIRONMENT_VARIABLES = (
    "XLA_FLAGS",
    "JAX_ENABLE_X64",
    "JAX_DEFAULT_PRNG_IMPL",
    "JAX_THREEFRY_PARTITIONABLE",
    "JAX_DISABLE_MOST_OPTIMIZATIONS",
)


def describe_device(settings: EngineSettings) -> str:
    """Describe the devices of an engine: kind, number that share a batch, and settings that change compiled code."""
    devices.configure_jax()
    native = settings.name == "native"
    parts = ["cpu" if native else f"{jax.device_count()} x {jax.devices()[0].device_kind}"]
    if native or jax.default_backend() == "cpu":
        parts.append(provenance.processor_id())
    if not native:
        parts += [f"{name}={os.environ[name]}" for name in ENVIRONMENT_VARIABLES if os.environ.get(name)]
    return ", ".join(parts)


def run_id(settings: EngineSettings, *extra: str) -> str:
    """Return a hash of all that rounding depends on: engine, time steps, precision, batch width, device and code.

    Args:
        settings: settings of the engine.
        extra: more text to hash, from the system.
    """
    content = repr((settings, describe_device(settings), provenance.code_version(), *extra))
    return hashlib.blake2b(content.encode(), digest_size=6).hexdigest()

"""What made a row: code, libraries, device. Rows are equal bit for bit only at an equal `run_id`."""

import ast
import functools
import hashlib
import subprocess
from importlib import metadata
from pathlib import Path

from sweep.engines.settings import EngineSettings

SIMULATION = ("models", "controllers", "engines", "metrics", "formulas", "case.py", "parameters.py")
LIBRARIES = ("mujoco", "mujoco-mjx", "jax", "jaxlib", "numpy")


def device(settings: EngineSettings) -> str:
    """Kind of the devices an engine runs on, and how many share a batch."""
    import jax  # slow to import

    from sweep.engines import devices

    devices.configure()

    return f"{jax.device_count()} x {jax.devices()[0].device_kind}" if settings.name == "mjx" else "cpu"


@functools.cache
def code_version() -> str:
    """Hash of what the simulation's sources say, comments and docstrings apart, and of its libraries' versions."""
    root = Path(__file__).parent
    files = sorted(
        file for name in SIMULATION for file in (root.glob(name) if "." in name else (root / name).rglob("*.py"))
    )
    content = hashlib.blake2b(digest_size=6)
    for file in files:
        content.update(f"{file.relative_to(root)}\n{statements(file.read_text())}\n".encode())
    content.update(repr(versions()).encode())
    return content.hexdigest()


def statements(source: str) -> str:
    """`source` in one format, without comments and docstrings."""
    tree = ast.parse(source)
    for node in ast.walk(tree):
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef) and ast.get_docstring(node, clean=False):
            node.body = node.body[1:] or [ast.Pass()]
    return ast.unparse(tree)


def versions() -> dict[str, str]:
    """Versions of the libraries that a rollout's numbers depend on."""
    return {name: metadata.version(name) for name in LIBRARIES}


@functools.cache
def commit() -> str:
    """The checkout's commit, marked where files differ from it; empty outside a checkout."""
    found = subprocess.run(
        ["git", "describe", "--always", "--dirty", "--abbrev=12"],
        cwd=Path(__file__).parent, capture_output=True, text=True, check=False,
    )  # fmt: skip
    return found.stdout.strip()


def run_id(settings: EngineSettings) -> str:
    """Hash of how a row is simulated: engine, steps, precision, width, device, code."""
    content = repr((settings, device(settings), code_version()))
    return hashlib.blake2b(content.encode(), digest_size=6).hexdigest()

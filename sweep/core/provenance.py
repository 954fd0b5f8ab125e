"""What made a row: code, libraries, device. Rows are equal bit for bit only at an equal `run_id`."""

import ast
import functools
import hashlib
import subprocess
from importlib import metadata
from pathlib import Path

from sweep import STARTED
from sweep.core import project
from sweep.engines.settings import EngineSettings

ROOT = Path(__file__).parents[1]
SIMULATION = (  # what can change a row
    "models", "controllers", "dynamics", "engines", "metrics", "formulas", "core/rotations.py", "core/parameters.py",
)  # fmt: skip
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
    content = hashlib.blake2b(digest_size=6)
    for file in _sources():
        content.update(f"{file.relative_to(ROOT)}\n{statements(file.read_text())}\n".encode())
    for file in project.module_sources():
        content.update(statements(file.read_text()).encode())
    content.update(repr(versions()).encode())
    return content.hexdigest()


def edited() -> bool:
    """Whether any of the simulation's sources was written after this process began: what runs may be older."""
    return any(file.stat().st_ctime > STARTED for file in (*_sources(), *project.module_sources()))


def _sources() -> list[Path]:
    return sorted(
        file for name in SIMULATION for file in (ROOT.glob(name) if "." in name else (ROOT / name).rglob("*.py"))
    )


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
    """The commit that was installed, else the checkout's, marked where files differ from it; empty where unknown."""
    installed = ROOT / "commit.txt"  # written into a wheel: a folder around it may be a checkout of something else
    if installed.exists():
        return installed.read_text().strip()
    found = subprocess.run(
        ["git", "describe", "--always", "--dirty", "--abbrev=12"],
        cwd=ROOT, capture_output=True, text=True, check=False,
    )  # fmt: skip
    return found.stdout.strip()


def run_id(settings: EngineSettings) -> str:
    """Hash of how a row is simulated: engine, steps, precision, width, device, code."""
    content = repr((settings, device(settings), code_version()))
    return hashlib.blake2b(content.encode(), digest_size=6).hexdigest()

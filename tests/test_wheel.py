"""What is handed to whoever installs the package: its files, and what it asks for besides."""

import ast
import re
import runpy
import subprocess
import sys
import tarfile
import tomllib
import zipfile
from importlib.metadata import packages_distributions
from pathlib import Path

from sweep.report.page.script import bundle_script

ROOT = Path(__file__).parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
TOOLS = ("sweep/report/page/.prettierrc.json", "sweep/report/page/package.json", "sweep/report/page/tsconfig.json")
PAGE_SCRIPT = "sweep/report/page/main.js"  # all modules in one


def test_a_wheel_holds_every_file_of_the_package_and_no_other(built):
    names = zipfile.ZipFile(next(built.glob("*.whl"))).namelist()
    packed = {name for name in names if ".dist-info/" not in name}
    there = {
        file.relative_to(ROOT) for part in ("sweep", "conf") for file in (ROOT / part).rglob("*") if file.is_file()
    }
    tree = {str(file) for file in there if "__pycache__" not in file.parts}
    tree = {re.sub("^conf/", "sweep/conf/", name) for name in tree} - set(TOOLS)
    modules = {name for name in tree if name.endswith(".js")}
    assert packed - {"sweep/commit.txt"} == tree - modules | {PAGE_SCRIPT}


def test_the_pages_script_is_minified_in_a_wheel_and_readable_in_an_sdist(built):
    script = zipfile.ZipFile(next(built.glob("*.whl"))).read(PAGE_SCRIPT).decode()
    assert script == runpy.run_path(str(ROOT / "setup.py"))["minify_page_script"]()
    assert len(script) < len(bundle_script()) / 2
    with tarfile.open(next(built.glob("*.tar.gz"))) as source:
        assert sum(name.endswith(".js") for name in source.getnames()) > 20


def test_the_commit_is_in_both(built):
    wheel = zipfile.ZipFile(next(built.glob("*.whl")))
    with tarfile.open(next(built.glob("*.tar.gz"))) as source:
        (name,) = (name for name in source.getnames() if name.endswith("sweep/commit.txt"))
        file = source.extractfile(name)
        assert file is not None
        assert file.read() == wheel.read("sweep/commit.txt") != b""


def test_what_is_imported_is_declared():
    asked = [*PROJECT["dependencies"], *(one for extra in PROJECT["optional-dependencies"].values() for one in extra)]
    declared = {_plain(re.split(r"[\[<>=~! ]", one)[0]) for one in asked}
    where = packages_distributions()
    missing = {
        f"{file.relative_to(ROOT)}: {name}"
        for file in (ROOT / "sweep").rglob("*.py")
        for name in _imported(file) - set(sys.stdlib_module_names) - {"sweep"}
        if not {_plain(one) for one in where.get(name, [name])} & declared
    }
    assert not missing


def test_the_lock_has_hashes_and_the_versions_of_development_and_no_address():
    lock = (ROOT / "requirements.lock").read_text()
    assert "://" not in lock
    locked = dict(re.findall(r"^(\S+)==(\S+)", lock, re.MULTILINE))
    assert lock.count("==") == len(locked) <= lock.count("--hash=sha256:")
    pinned = dict(line.split("==") for line in (ROOT / "constraints.txt").read_text().split())
    pinned = {_plain(name): version for name, version in pinned.items()}
    assert locked == {name: pinned[_plain(name)] for name in locked}
    assert {_plain(re.split(r"[\[<>=~! ]", one)[0]) for one in PROJECT["dependencies"]} <= {*map(_plain, locked)}


WITHOUT_EXTRAS = """
import importlib, pkgutil, sys
import sweep
sys.modules.update(dict.fromkeys(sys.argv[1].split()))
for one in pkgutil.walk_packages(sweep.__path__, "sweep."):
    if "template" not in one.name and not one.name.endswith("__main__"):
        try:
            importlib.import_module(one.name)
        except ImportError:
            print(one.name)
"""


def test_only_the_modules_of_an_extra_need_it():
    """A base install runs and reports a study: what it does not install is imported in these modules alone."""
    asked = [re.split(r"[<>=~! ]", one)[0] for extra in PROJECT["optional-dependencies"].values() for one in extra]
    extras = {_plain(one) for one in asked if "[" not in one}
    modules = [name for name, owners in packages_distributions().items() if {_plain(one) for one in owners} & extras]
    assert {"foxglove", "dask", "onnx"} <= set(modules)
    command = [sys.executable, "-c", WITHOUT_EXTRAS, " ".join(modules)]
    needing = subprocess.run(command, capture_output=True, text=True, check=True).stdout.splitlines()
    needing = [line for line in needing if line.startswith("sweep.")]  # MJX prints, too
    assert needing == ["sweep.replay.mcap", "sweep.replay.shapes"]


def _imported(file: Path) -> set[str]:
    found = set()
    for node in ast.walk(ast.parse(file.read_text())):
        match node:
            case ast.Import():
                found |= {one.name for one in node.names}
            case ast.ImportFrom(module=str(module)):
                found.add(module)
    return {name.partition(".")[0] for name in found}


def _plain(name: str) -> str:
    return re.sub(r"[-_.]+", "-", name).lower()

"""What is handed to whoever installs the package: its files, and what it asks for besides."""

import ast
import re
import shutil
import subprocess
import sys
import tarfile
import tomllib
import zipfile
from importlib.metadata import packages_distributions
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
TOOLS = ("sweep/report/page/.prettierrc.json", "sweep/report/page/package.json", "sweep/report/page/tsconfig.json")


@pytest.fixture(scope="module")
def built(tmp_path_factory) -> Path:
    """A folder with the sdist, and the wheel that is made of it."""
    folder, tree = tmp_path_factory.mktemp("dist"), tmp_path_factory.mktemp("tree")
    for name in ("sweep", "conf"):  # a checkout's own list of sources, of builds before, would hide what is not found
        shutil.copytree(ROOT / name, tree / name, ignore=shutil.ignore_patterns("__pycache__"))
    for name in ("pyproject.toml", "setup.py", "README.md", "LICENSE", ".git"):
        (tree / name).symlink_to(ROOT / name)
    asked = [sys.executable, "-m", "build", "--no-isolation", "--outdir", folder, tree]
    done = subprocess.run(asked, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout[-2000:] + done.stderr[-2000:]
    return folder


def test_a_wheel_holds_every_file_of_the_package_and_no_other(built):
    names = zipfile.ZipFile(next(built.glob("*.whl"))).namelist()
    packed = {name for name in names if ".dist-info/" not in name}
    there = {
        file.relative_to(ROOT) for part in ("sweep", "conf") for file in (ROOT / part).rglob("*") if file.is_file()
    }
    tree = {str(file) for file in there if "__pycache__" not in file.parts}
    tree = {re.sub("^conf/", "sweep/conf/", name) for name in tree} - set(TOOLS)
    assert packed - {"sweep/commit.txt"} == tree


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

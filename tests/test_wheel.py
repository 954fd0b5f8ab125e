"""What is handed to whoever installs the package: its files, and what it asks for besides."""

import ast
import re
import sys
import tarfile
import tomllib
import zipfile
from importlib.metadata import packages_distributions
from pathlib import Path

ROOT = Path(__file__).parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
TOOLS = ("sweep/report/page/.prettierrc.json", "sweep/report/page/package.json", "sweep/report/page/tsconfig.json")


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

"""The tutorials, followed to the letter from the wheel in an empty folder: commands, files and what they print.

`make wheel` installs the wheel alone and follows the tutorials marked `wheel` there. The tutorial of a learned policy
needs an extra: it is followed from an unpacked wheel, beside the libraries of development.
"""

import os
import re
import shutil
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

PAGES = sorted((Path(__file__).parents[1] / "docs" / "tutorials").glob("*.md"))
BLOCK = re.compile(r"```(\w+)\n(.*?)```", re.DOTALL)
FILE = re.compile(r"[#%] ([\w/]+\.(?:yaml|py|tex))\n")
NUMBER = re.compile(r"(?<![\w.])-?\d+(?:\.\d+)?(?:e[-+]\d+)?")
SMALL, ALIKE = 1e-3, 0.5  # numbers below it are not compared; largest relative difference: another processor flips some


INSTALLED = os.environ.get("SWEEP_WHEEL_ENV")  # an environment in which the wheel is installed


@pytest.fixture(scope="module")
def environment(request, tmp_path_factory):
    """Return variables by which `sweep` and `python` are the wheel's, and the folder that holds the package."""
    plain = {**os.environ, "MPLBACKEND": "agg"}
    if INSTALLED:
        return {**plain, "PATH": f"{INSTALLED}/bin{os.pathsep}{os.environ['PATH']}"}, INSTALLED
    home, built = tmp_path_factory.mktemp("wheel"), request.getfixturevalue("built")
    zipfile.ZipFile(next(built.glob("*.whl"))).extractall(home / "site")
    (home / "bin").mkdir()
    for name, words in (("sweep", "-m sweep.cli"), ("python", "")):
        (home / "bin" / name).write_text(f'#!/bin/sh\nexec {sys.executable} {words} "$@"\n')
        (home / "bin" / name).chmod(0o755)
    path = f"{home / 'bin'}{os.pathsep}{os.environ['PATH']}"
    return {**plain, "PATH": path, "PYTHONPATH": str(home / "site")}, str(home)


def shell(command: str, folder: Path, env: dict[str, str]) -> str:
    """Run a command line and return what it prints."""
    done = subprocess.run(["bash", "-c", command], cwd=folder, env=env, capture_output=True, text=True, check=False)
    assert done.returncode == 0, (command, done.stdout, done.stderr)
    return done.stdout


def words(line: str) -> str:
    """Return a line without its numbers and the width of its columns."""
    return " ".join(NUMBER.sub("#", line).split())


def assert_printed(expected: list[str], printed: list[str], command: str) -> None:
    """Assert that the expected lines were printed in this order; `...` stands for others."""
    rest = iter(printed)
    for line in expected:
        if line != "...":
            start = words(line.removesuffix("..."))
            found = next((one for one in rest if words(one)[: len(start)] == start), None)
            assert found is not None, (command, line, printed)
            for a, b in zip(map(float, NUMBER.findall(line)), map(float, NUMBER.findall(found)), strict=False):
                size = max(abs(a), abs(b))
                assert size < SMALL or abs(a - b) <= ALIKE * size, (command, line, found)


@pytest.mark.parametrize(
    "page",
    [page if page.stem == "learned_policy" else pytest.param(page, marks=pytest.mark.wheel) for page in PAGES],
    ids=lambda page: page.stem,
)
def test_a_tutorial_does_what_it_says(page, environment, tmp_path):
    env, home = environment
    assert shell("python -c 'import sweep; print(sweep.__file__)'", tmp_path, env).startswith(home)
    folder = tmp_path
    for kind, body in BLOCK.findall(page.read_text(encoding="utf-8")):
        if kind == "console":
            for part in re.split(r"^\$ ", body, flags=re.MULTILINE)[1:]:
                command, *expected = part.rstrip("\n").split("\n")
                if command.startswith("cd "):
                    folder = folder / command.removeprefix("cd ")
                else:
                    assert_printed(expected, shell(command, folder, env).splitlines(), command)
        else:
            (folder / FILE.match(body)[1]).write_text(body, encoding="utf-8")
    if (folder / "article.tex").exists() and shutil.which("pdflatex"):
        shell("pdflatex -interaction=nonstopmode -halt-on-error article.tex", folder, env)

"""What pyproject.toml cannot say: the packages, one of which lies elsewhere, and the commit of a build."""

import subprocess
from pathlib import Path

from setuptools import find_packages, setup
from setuptools.command.build_py import build_py
from setuptools.command.sdist import sdist

HERE = Path(__file__).parent


def write_commit(package: Path) -> None:
    """Add commit.txt: rows that an installation simulates say so; an editable one asks its checkout instead."""
    if not (HERE / ".git").exists():  # a build of an sdist, which has the file already
        return
    command = ["git", "describe", "--always", "--dirty", "--abbrev=12"]
    found = subprocess.run(command, cwd=HERE, capture_output=True, text=True, check=False)
    if found.stdout:
        (package / "commit.txt").write_text(found.stdout)


class BuildWithCommit(build_py):
    """For a wheel."""

    def run(self) -> None:
        """Build as ever, then write it."""
        super().run()
        if not self.editable_mode:
            write_commit(Path(self.build_lib) / "sweep")


class SourceWithCommit(sdist):
    """For an sdist."""

    def make_release_tree(self, base_dir: str, files: list[str]) -> None:
        """Lay out its files as ever, then write it."""
        super().make_release_tree(base_dir, files)
        write_commit(Path(base_dir) / "sweep")


setup(
    packages=[*find_packages(include=["sweep", "sweep.*"]), "sweep.conf"],
    package_dir={"sweep.conf": "conf"},
    cmdclass={"build_py": BuildWithCommit, "sdist": SourceWithCommit},
)

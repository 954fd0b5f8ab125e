"""Write into a wheel which commit it is made from: rows that it simulates say so."""

import subprocess
from pathlib import Path

from setuptools import setup
from setuptools.command.build_py import build_py


class BuildWithCommit(build_py):
    """Adds sweep/commit.txt; an editable installation asks its checkout instead."""

    def run(self) -> None:
        """Build as ever, then write it."""
        super().run()
        command = ["git", "describe", "--always", "--dirty", "--abbrev=12"]
        found = subprocess.run(command, cwd=Path(__file__).parent, capture_output=True, text=True, check=False)
        if found.stdout and not self.editable_mode:
            (Path(self.build_lib) / "sweep" / "commit.txt").write_text(found.stdout)


setup(cmdclass={"build_py": BuildWithCommit})

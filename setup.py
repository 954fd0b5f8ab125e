"""What pyproject.toml cannot say: packages, one of which lies elsewhere, the commit, and the page's minified script."""

import runpy
import subprocess
from pathlib import Path

from setuptools import find_packages, setup
from setuptools.command.build_py import build_py
from setuptools.command.sdist import sdist

HERE = Path(__file__).parent
PAGE = Path("sweep", "report", "page")


def write_commit(package: Path) -> None:
    """Add commit.txt: rows that an installation simulates say so; an editable one asks its checkout instead."""
    if not (HERE / ".git").exists():  # a build of an sdist, which has the file already
        return
    command = ["git", "describe", "--always", "--dirty", "--abbrev=12"]
    found = subprocess.run(command, cwd=HERE, capture_output=True, text=True, check=False)
    if found.stdout:
        (package / "commit.txt").write_text(found.stdout)


def minify_page_script() -> str:
    """Return the bundled script of the page without comments and spaces, and with short local names.

    Inside braces the names of the modules are local, too.

    Raises:
        ImportError: the minifier is not installed.
    """
    import minify

    bundle = runpy.run_path(str(HERE / PAGE / "script.py"))["bundle_modules"](HERE / PAGE)
    return minify.string("application/javascript", f"{{{bundle}}}")


def replace_page_modules(folder: Path) -> None:
    """Replace the modules of the page's script in a built package by one minified module.

    Without the minifier, which conda-forge has not, the readable modules stay. They do the same.
    """
    try:
        script = minify_page_script()
    except ImportError:
        print("the page's script stays readable: minify-go is not installed")
        return
    for module in folder.glob("*.js"):
        module.unlink()
    (folder / "main.js").write_text(script, encoding="utf-8")


class BuildPackage(build_py):
    """For a wheel."""

    def run(self) -> None:
        """Build as ever, then add the commit and minify the page's script."""
        super().run()
        if not self.editable_mode:
            write_commit(Path(self.build_lib) / "sweep")
            replace_page_modules(Path(self.build_lib) / PAGE)


class SourceWithCommit(sdist):
    """For an sdist."""

    def make_release_tree(self, base_dir: str, files: list[str]) -> None:
        """Lay out its files as ever, then write it."""
        super().make_release_tree(base_dir, files)
        write_commit(Path(base_dir) / "sweep")


if __name__ == "__main__":
    setup(
        packages=[*find_packages(include=["sweep", "sweep.*"]), "sweep.conf"],
        package_dir={"sweep.conf": "conf"},
        cmdclass={"build_py": BuildPackage, "sdist": SourceWithCommit},
    )

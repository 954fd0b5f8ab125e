"""Write the version of a release into every file that states it: `python jobs/set_version.py 0.3.0 [DOI]`.

A DOI takes its place in CITATION.cff and .zenodo.json. Without one, a DOI of an earlier version is removed.
"""

import re
import sys
from datetime import UTC, datetime
from pathlib import Path

ROOT = Path(__file__).parents[1]
STATED = {
    "pyproject.toml": (r'^version = ".*"$', 'version = "{version}"'),
    "sweep/core/version.py": (r'^VERSION = ".*"$', 'VERSION = "{version}"'),
    "CITATION.cff": (r"^version: .*$", "version: {version}"),
    ".zenodo.json": (r'^  "version": ".*",$', '  "version": "{version}",'),
    "packaging/conda/recipe.yaml": (r'^  version: ".*"$', '  version: "{version}"'),
}


def main() -> int:
    """Replace the version in each file; fail where one states none."""
    version, *doi = sys.argv[1:]
    if not re.fullmatch(r"\d+\.\d+\.\d+((a|b|rc)\d+)?", version):
        print(f"set_version: {version} is not allowed: MAJOR.MINOR.PATCH, such as 0.3.0", file=sys.stderr)
        return 2
    if doi and not re.fullmatch(r"10\.\d{4,}/\S+", doi[0]):
        print(f"set_version: {doi[0]} is not allowed: a DOI, such as 10.5281/zenodo.1234567", file=sys.stderr)
        return 2
    for name, (old, new) in STATED.items():
        _replace(name, old, new.format(version=version))
    _replace("CITATION.cff", r"^date-released: .*$", f"date-released: {datetime.now(UTC):%Y-%m-%d}")
    cited = f"doi: {doi[0]}" if doi else "# doi: of the archived release"
    _replace("CITATION.cff", r"^(# )?doi: .*$", cited)
    archived = f',\n  "doi": "{doi[0]}"' if doi else ""
    _replace(".zenodo.json", r'("version": "[^"]*")(,\n  "doi": "[^"]*")?', rf"\g<1>{archived}")
    return 0


def _replace(name: str, old: str, new: str) -> None:
    text, count = re.subn(old, new, (ROOT / name).read_text(encoding="utf-8"), flags=re.MULTILINE)
    if count != 1:
        raise SystemExit(f"set_version: {name} has {count} lines like {old}")
    (ROOT / name).write_text(text, encoding="utf-8")


if __name__ == "__main__":
    sys.exit(main())

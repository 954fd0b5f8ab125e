"""The paper about the project: what it cites is there, and it is of the version that is installed."""

import json
import re
from pathlib import Path

import yaml

from sweep import __version__

ROOT = Path(__file__).parents[1]
TEXT, BOOKS = ((ROOT / "paper" / name).read_text(encoding="utf-8") for name in ("paper.md", "paper.bib"))


def test_every_work_is_cited_and_every_citation_is_a_work():
    head, body = TEXT.split("---\n")[1:3]
    cited = set(re.findall(r"@([a-z]+\d{4})", body))
    assert cited == set(re.findall(r"^@\w+\{(\w+),", BOOKS, re.MULTILINE))
    for figure in re.findall(r"!\[.*?\]\((.*?)\)", body):
        assert (ROOT / "paper" / figure).is_file()
    assert {"title", "tags", "authors", "affiliations", "date", "bibliography"} <= yaml.safe_load(head).keys()
    assert 250 < len(body.split()) < 1000


def test_the_version_is_one():
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text(encoding="utf-8"))
    zenodo = json.loads((ROOT / ".zenodo.json").read_text(encoding="utf-8"))
    assert citation["version"] == zenodo["version"] == __version__
    assert citation["title"] == zenodo["title"]
    assert f'version = "{__version__}"' in (ROOT / "pyproject.toml").read_text(encoding="utf-8")
    assert f"## {__version__}" in (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")

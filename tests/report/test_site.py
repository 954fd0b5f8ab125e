"""The site of the documents, as a reader sees it."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
from browser import CHROMIUM, Browser

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    pytest.importorskip("mkdocs")
    out = tmp_path_factory.mktemp("site")
    command = [sys.executable, "-m", "mkdocs", "build", "-q", "-d", str(out)]
    quiet = {**os.environ, "NO_MKDOCS_2_WARNING": "1"}
    built = subprocess.run(command, cwd=ROOT, env=quiet, capture_output=True, text=True)
    assert (built.returncode, built.stdout + built.stderr) == (0, "")
    return out


def test_the_site_has_its_pages(site):
    for name in ("index", "reference/parameters", "reference/python", "studies"):
        assert (site / f"{name}.html").stat().st_size > 10_000, name


def test_every_page_can_be_navigated_to():
    named = set(re.findall(r": (\S+\.md)$", (ROOT / "mkdocs.yml").read_text(), re.MULTILINE))
    pages = {str(page.relative_to(ROOT / "docs")) for page in (ROOT / "docs").rglob("*.md")}
    evidence = {str(page.relative_to(ROOT)) for page in (ROOT / "research").rglob("*.md")}
    assert pages - {"README.md"} | evidence <= named


@pytest.mark.slow
@pytest.mark.browser
@pytest.mark.skipif(CHROMIUM is None, reason="needs a browser: apt-get install chromium")
def test_every_page_shows_its_pictures(site, tmp_path):
    browser, shown = Browser(tmp_path), 0
    for page in sorted(site.rglob("*.html")):
        if page.is_relative_to(site / "research" / "examples") and page.name == "report.html":
            continue  # an example of a report, with pictures of its own
        browser.open(page)
        pictures = browser.run("""Promise.all([...document.images].map(i => { i.loading = "eager";
            return i.decode().then(() => "", () => i.getAttribute("src") ?? "none") }))""")
        assert not any(pictures), (page.relative_to(site), pictures)
        shown += len(pictures)
    browser.close()
    assert shown > 10

"""Build hook of mkdocs: adds the overview, generated reference pages and the evidence under research/ to the site."""

import re
import sys
from pathlib import Path
from typing import Any

from mkdocs.structure.files import File, Files  # pyright: ignore[reportMissingImports]

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT / "research"))
import cited  # noqa: E402

ANALYSIS = """# Statistics from Python

Functions that take tables of rows, such as those of `sweep.load`. They may change between versions.

::: sweep.analysis.stats
::: sweep.analysis.sensitivity
::: sweep.analysis.screening
::: sweep.analysis.intervals
"""
SHOWN = {".md", ".png", ".svg", ".gif", ".html"}  # of research/


def on_files(files: Files, config: Any) -> Files:
    """Add the pages that are not in docs/.

    Args:
        files: Files of docs/, as mkdocs found them.
        config: Configuration of the site.

    Returns:
        `files` with the overview, results, the functions of sweep.analysis, and research/.
    """
    pages = {
        "index.md": link_from_root((ROOT / "README.md").read_text(encoding="utf-8")),
        "results.md": (ROOT / "results" / "README.md").read_text(encoding="utf-8"),
        "analysis.md": ANALYSIS,
    }
    for name, content in pages.items():
        files.append(File.generated(config, name, content=content))
    for path in sorted((ROOT / "research").rglob("*")):
        if path.suffix in SHOWN:
            name = str(path.relative_to(ROOT))
            files.append(File(name, str(ROOT), config.site_dir, config.use_directory_urls))
    return files


def on_page_markdown(markdown: str, page: Any, **_: Any) -> str:
    """Rewrite links for the site's layout, and state on each page which of its data are older than the code.

    Args:
        markdown: Source of the page.
        page: The page, as mkdocs knows it.

    Returns:
        The source with links inside the site; links to other files of the repository become plain text.
    """
    source = page.file.src_uri
    if note := cited.outdated(markdown):
        title, _newline, rest = markdown.partition("\n")
        markdown = f"{title}\n\n*{note}*\n{rest}" if source.startswith("research/") else f"{markdown}\n\n{note}\n"
    if source.startswith("research/"):
        up = "../" * source.count("/")  # to the root of the repository, and to that of the site
        markdown = markdown.replace(f"]({up}docs/", f"]({up}")
        inside = ""
    else:
        up = "../" * (source.count("/") + 1)  # to the root of the repository; that of the site is one less
        inside = up[3:]
        markdown = markdown.replace(f"]({up}research/", f"]({inside}research/")
        if source == "index.md":
            return markdown
    markdown = markdown.replace(f"]({up}README.md)", f"]({up if source.startswith('research/') else inside}index.md)")
    outside = rf"\[([^\]]*)\]\({re.escape(up)}(?:bench|jobs|sweep|tests|conf|results)[^)]*\)"
    return re.sub(outside, r"\1", markdown)


def link_from_root(text: str) -> str:
    """The README as a page of the site: links into docs/ lose that folder, links to other files become plain text."""
    text = text.replace("](docs/", "](")
    return re.sub(r"(?<!!)\[([^\[\]]*)\]\((?!https://)((?![\w/]+\.md)[^)]*|bench/[^)]*)\)", r"\1", text)

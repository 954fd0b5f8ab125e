"""Pages of the site that lie elsewhere or are made: overview, results, parameters. A hook of mkdocs."""

import re
from pathlib import Path
from typing import Any

import cited  # beside this, where mkdocs finds it
from mkdocs.structure.files import File, Files  # pyright: ignore[reportMissingImports]

ROOT = Path(__file__).parents[1]
PYTHON = """# From Python

`from sweep import load, run` gives studies as pandas tables, and `rows.sweep` their pictures.

::: sweep.run
::: sweep.load
::: sweep.api.Accessor
::: sweep.analysis.stats
::: sweep.analysis.sensitivity
::: sweep.analysis.screening
::: sweep.analysis.intervals
"""


def on_files(files: Files, config: Any) -> Files:
    """Add the pages that are not in docs/."""
    from sweep.study import reference

    pages = {
        "index.md": inward((ROOT / "README.md").read_text(encoding="utf-8")),
        "results.md": (ROOT / "results" / "README.md").read_text(encoding="utf-8"),
        "parameters.md": reference.page(),
        "python.md": PYTHON,
    }
    for name, content in pages.items():
        files.append(File.generated(config, name, content=content))
    return files


def on_page_markdown(markdown: str, page: Any, **_: Any) -> str:
    """Links to the README lead to the overview; those to files beside docs/ become words; older data are told."""
    markdown += f"\n\n{cited.outdated(markdown)}\n"
    up = "../" * (page.file.src_uri.count("/") + 1)
    markdown = markdown.replace(f"]({up}README.md)", f"]({up[3:]}index.md)")
    return re.sub(rf"\[([^\]]*)\]\({re.escape(up)}[^)]*\)", r"\1", markdown)


def inward(text: str) -> str:
    """The README as a page of docs/: links and pictures of docs/ are beside it, other links become words."""
    text = text.replace("](docs/", "](")
    return re.sub(r"(?<!!)\[([^\[\]]*)\]\((?!https://)((?![\w/]+\.md)[^)]*|bench/[^)]*)\)", r"\1", text)

"""Puts the page's script and style of today into the pages of research/examples: `python research/example_pages.py`.

What the pages hold stays. Where the script reads something new, or the page's frame has changed, they are made again by
jobs/paper_tables.sh, as research/examples/README.md says.
"""

import re
from pathlib import Path

from markupsafe import escape

from sweep.report.page.script import bundle_script, content_security_policy, style_sheet

EXAMPLES = Path(__file__).parent / "examples"
PARTS = (
    r'(?<=<script type="module">).*?(?=</script>)',
    r"(?<=<style>).*?(?=</style>\n</head>)",
    r'(?<=<meta http-equiv="Content-Security-Policy" content=").*?(?=">)',
)


def renewed(text: str) -> str:
    """A page with the script and style of today, and the policy that lets them alone run."""
    style, script = style_sheet(), bundle_script()
    for pattern, part in zip(PARTS, (script, style, str(escape(content_security_policy(style, script)))), strict=True):
        text, count = re.subn(pattern, lambda _, part=part: part, text, flags=re.DOTALL)
        assert count == 1, f"{count} times {pattern}"
    return text


def pages() -> list[Path]:
    """All of them."""
    return sorted(EXAMPLES.glob("*/report.html"))


if __name__ == "__main__":
    for page in pages():
        text = page.read_text(encoding="utf-8")
        if (new := renewed(text)) != text:
            page.write_text(new, encoding="utf-8")
            print(page)

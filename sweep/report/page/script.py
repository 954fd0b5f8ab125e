"""Templates, script and style sheet of pages, and the content security policy that allows no other script or style."""

import base64
import hashlib
import re
from functools import cache
from graphlib import TopologicalSorter
from importlib.resources import files
from importlib.resources.abc import Traversable

import jinja2

IMPORT_LINE = re.compile(r'^import \{[^}]*\} from "\./([\w-]+\.js)";\n', re.MULTILINE)
EXPORT_KEYWORD = re.compile(r"^export (?=(?:async )?(?:function\*?|const|class) )", re.MULTILINE)


def load_page_template(name: str) -> jinja2.Template:
    """Load an HTML template of this package, such as `page.html.j2`; it escapes all values except `Markup`."""
    environment = jinja2.Environment(
        autoescape=True, undefined=jinja2.StrictUndefined, trim_blocks=True, lstrip_blocks=True
    )
    return environment.from_string((files(__package__) / name).read_text(encoding="utf-8"))


@cache
def bundle_script() -> str:
    """Return the page's script: all JavaScript modules of this package, which are one minified module in a wheel."""
    return bundle_modules(files(__package__))


def bundle_modules(folder: Traversable) -> str:
    """Bundle the JavaScript modules of a folder into one script in the order of their imports."""
    sources = {file.name: file.read_text(encoding="utf-8") for file in folder.iterdir() if file.name.endswith(".js")}
    order = TopologicalSorter({name: IMPORT_LINE.findall(text) for name, text in sources.items()}).static_order()
    return "\n".join(EXPORT_KEYWORD.sub("", IMPORT_LINE.sub("", sources[name])).strip() for name in order)


@cache
def style_sheet() -> str:
    """Return the content of the page's style sheet."""
    return (files(__package__) / "style.css").read_text(encoding="utf-8")


def content_security_policy(style: str, script: str) -> str:
    """Return the content security policy of the page: no network, and only the given style and script.

    Styles of single elements are allowed, as figures have them, and data URLs of pictures.
    """
    rules = {
        "default-src": "'none'",
        "script-src": content_security_hash(script),
        "style-src": content_security_hash(style),
        "style-src-attr": "'unsafe-inline'",
        "img-src": "data:",
        "base-uri": "'none'",
        "form-action": "'none'",
    }
    return "; ".join(f"{name} {value}" for name, value in rules.items())


def content_security_hash(text: str) -> str:
    """Return the hash by which a content security policy allows a script or style."""
    return f"'sha256-{base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()}'"

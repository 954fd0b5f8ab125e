"""Names and docstrings of the package as CONTRIBUTING asks for them, read from the source."""

import ast
import functools
import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PACKAGE = ROOT / "sweep"
IRREGULAR = {
    "told", "seen", "begun", "kept", "held", "led", "meant", "borne", "crept", "driven", "found", "sought",
    "chosen", "written", "made", "gone", "said", "known", "shown", "drawn", "taken", "given", "sent", "spent",
    "built", "fallen", "lain", "stood", "thrown",
}  # fmt: skip
ADVERBS = {
    "of", "among", "within", "between", "towards", "under", "over", "behind", "beside", "around", "at", "on", "by",
    "to", "from", "with", "above", "below", "along", "aside", "ahead", "apart", "beyond", "nowhere", "elsewhere",
    "evenly", "once", "whole", "untold", "lacks", "silent", "few",
}  # fmt: skip
NO_PARTICIPLES = {
    "embed", "seed", "speed", "feed", "need", "shed", "screen", "open", "token", "then", "when", "even", "seven",
}  # fmt: skip
DESCRIBED = re.compile(r"^\s*(Args|Returns|Raises|Yields):", re.MULTILINE)
# names that break a rule, each with the reason why it stays
ALLOWED: dict[str, str] = {}


def is_odd(name: str) -> bool:
    """Whether a name is a bare participle, preposition or adverb."""
    word = name.strip("_")
    participle = re.fullmatch(r"[a-z]{3,}(ed|en)", word) is not None and word not in NO_PARTICIPLES
    return participle or word in IRREGULAR | ADVERBS or word.split("_")[0] == "of"


def name_of(path: Path) -> str:
    return ".".join(("sweep", *path.relative_to(PACKAGE).with_suffix("").parts)).removesuffix(".__init__")


TREES = {name_of(path): ast.parse(path.read_text()) for path in PACKAGE.rglob("*.py") if "template" not in str(path)}


def room(module: str) -> str:
    return [*module.split("."), ""][1]


ROOMS = sorted({room(module) for module in TREES} - {""})


def public_functions(module: str):
    """Module-level functions and methods: their owner, "" for a module, and the node."""
    for parent in [TREES[module], *(n for n in TREES[module].body if isinstance(n, ast.ClassDef))]:
        for node in parent.body:
            if isinstance(node, ast.FunctionDef) and not node.name.startswith("_"):
                yield (parent.name if isinstance(parent, ast.ClassDef) else ""), node


@functools.cache
def names_across_rooms() -> set[tuple[str, str]]:
    """Names that a module of another room imports, or reaches as attributes of an imported module."""
    across = set()
    for module, tree in TREES.items():
        modules = {}
        for node in ast.walk(tree):
            if isinstance(node, ast.ImportFrom) and node.module in TREES | {"sweep": None}:
                for alias in node.names:
                    target = f"{node.module}.{alias.name}"
                    if target in TREES:
                        modules[alias.asname or alias.name] = target
                    else:
                        across.add((module, node.module, alias.name))
        for node in ast.walk(tree):
            if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name) and node.value.id in modules:
                across.add((module, modules[node.value.id], node.attr))
    return {(owner, name) for user, owner, name in across if room(user) != room(owner)}


@pytest.mark.parametrize("place", ROOMS)
def test_functions_are_verbs_or_nouns(place):
    odd = {
        ".".join(filter(None, (module, owner, node.name)))
        for module in TREES
        if room(module) == place
        for owner, node in public_functions(module)
        if is_odd(node.name)
    }
    assert odd == {name for name in ALLOWED if room(name) == place}


def test_functions_that_other_rooms_call_state_arguments_or_results():
    """With two parameters or more they have Args, Returns, Raises or Yields."""
    described = {
        f"{module}.{node.name}": DESCRIBED.search(ast.get_docstring(node) or "") is not None
        for module in TREES
        for owner, node in public_functions(module)
        if not owner and (module, node.name) in names_across_rooms()
        if len(node.args.args + node.args.kwonlyargs) >= 2
    }
    assert len(described) > 100
    assert [name for name, is_described in described.items() if not is_described] == []


@pytest.mark.parametrize(
    ("name", "odd"),
    [("told", True), ("behind", True), ("of_case", True), ("checked", True), ("load", False), ("speed", False),
     ("foot_load_delay_s", False), ("surface_at", False), ("compute", False)],
)  # fmt: skip
def test_odd_names_are_recognised(name, odd):
    assert is_odd(name) == odd


@pytest.mark.parametrize(
    ("subject", "said"),
    [
        ("report: describe SVG output", ""),
        ("metrics,dynamics: rename contexts", ""),
        ("Bear streams that are closed", "`area: imperative`"),
        ("report: describe SVG output.", "`area: imperative`"),
        ("report: " + "a" * 65, "73 characters, at most 72"),
        ("report: " + "a" * 64, ""),
    ],
)
def test_subjects_of_commits_are_checked(subject, said, tmp_path):
    """In a repository of its own, the commits after the first one."""

    def git(*words):
        who = ("-c", "user.name=a", "-c", "user.email=a@example.com")
        subprocess.run(["git", *who, *words], cwd=tmp_path, check=True, capture_output=True)

    git("init", "-q")
    git("commit", "-q", "--allow-empty", "-m", "A first one, which is not asked for")
    git("commit", "-q", "--allow-empty", "-m", subject, "-m", "Body: with any text.")
    run = subprocess.run([sys.executable, str(ROOT / "jobs/check_subjects.py"), "HEAD~1..HEAD"],
                         cwd=tmp_path, capture_output=True, text=True)  # fmt: skip
    assert (run.returncode, said in run.stdout) == (int(bool(said)), True), run.stdout + run.stderr

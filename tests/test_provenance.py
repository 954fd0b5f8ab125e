import subprocess
import sys
from pathlib import Path

import pytest
from small_study import STUDY, content

from sweep.backends.run_id import run_id
from sweep.cli.main import main
from sweep.contract.engine_settings import EngineSettings
from sweep.core import provenance
from sweep.core.provenance import normalize_source

SOURCE = '''"""What it does."""
def f(x):
    """What f does."""
    return x + 1  # why
class C:
    """What C is."""
'''
# what a worker has imported when it has simulated a batch on either engine
WORKER = """
import subprocess
import sys
import sweep.runs.runner, sweep.engines.mjx, sweep.engines.native
print(*(m.__file__ for name, m in sys.modules.items() if name.split(".")[0] == "sweep" and m.__file__), sep="\\n")
"""


def test_words_and_format_do_not_change_the_version_of_the_code_and_all_else_does():
    formatted = "def f(\n    x,\n):\n    # why\n    return (x + 1)\n\n\nclass C:\n    pass\n"
    assert normalize_source(SOURCE) == normalize_source(formatted)
    for old, new in (("x + 1", "x + 2"), ("x + 1", "x + 1.0"), ("f(x)", "f(x, y)"), ("class C", "class D")):
        assert normalize_source(SOURCE) != normalize_source(SOURCE.replace(old, new))


def test_rows_of_the_same_sources_are_of_this_code_whatever_the_libraries(monkeypatch):
    here, others = provenance.library_versions(), provenance.library_versions() | {"jax": "0.1"}
    version = provenance.code_version()  # which a process works out once
    monkeypatch.setattr(provenance, "library_versions", lambda: others)
    elsewhere = provenance.code_version.__wrapped__()
    assert elsewhere != version
    assert provenance.is_current_code(elsewhere, others)
    assert not provenance.is_current_code(elsewhere, here)


def test_what_judges_and_searches_a_plan_is_in_the_version_of_a_search(monkeypatch):
    real, version = provenance._read, provenance.plan_search_version()
    for edited in (
        "planning/score.py",
        "planning/kinematic_margins.py",
        "runs/tuning.py",
        "controllers/plan.py",
        "cli/plan_rollouts.py",
    ):

        def read(file, edited=edited):
            imports, said = real(file)
            return imports, said + "\nvalues *= 2" * (file == provenance.SOURCE_FOLDER / edited)

        monkeypatch.setattr(provenance, "_read", read)
        assert provenance.plan_search_version.__wrapped__() != version, edited


def test_every_module_that_stores_programs_is_in_their_version():
    """Else programs of an older version of the code would be loaded."""
    files = provenance.SOURCE_FOLDER.rglob("*.py")
    stores = {file for file in files if "program_cache.load_or_compile(" in file.read_text()}
    assert len(stores) > 3
    assert stores <= set(provenance.list_source_files(provenance.PROGRAM_MODULES))


def test_every_module_that_a_worker_runs_is_in_the_version_of_the_code(monkeypatch):
    loaded = subprocess.run([sys.executable, "-c", WORKER], check=True, capture_output=True, text=True).stdout.split()
    sources = provenance.list_source_files(provenance.WORKER_MODULES)
    assert {Path(file) for file in loaded if not file.endswith("conf/__init__.py")} <= set(sources)
    named = {file.relative_to(provenance.SOURCE_FOLDER).as_posix() for file in sources}
    assert {"study/study.py", "study/point_ids.py", "runs/batches.py", "study/clusters.py"} <= named
    assert {
        "systems/hexapod/__init__.py",
        "systems/mujoco_model/mjx.py",
        "metrics/slip.py",
        "engines/native.py",
    } <= named
    assert not [name for name in named if name.startswith(("cli", "report", "replay"))]
    real, version = provenance._read, provenance.code_version()
    for edited in (None, *sorted(sources)[::25]):  # one in 25: each takes half a second
        asked = set()

        def read(file, edited=edited, asked=asked):
            asked.add(file)
            imports, said = real(file)
            return imports, said + "\nvalues *= 2" * (file == edited)

        monkeypatch.setattr(provenance, "_read", read)
        provenance.code_version.cache_clear()
        assert (provenance.code_version() != version) == (edited is not None), edited
        assert set(sources) <= asked
    provenance.code_version.cache_clear()


AGAIN = """
import ast
from sweep.core import provenance
parse, parsed = ast.parse, []
ast.parse = lambda *given: parsed.append(1) or parse(*given)
provenance.sources_changed()
print(provenance.code_version(), len(parsed))
"""


def test_what_sources_say_is_read_again_without_being_parsed(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    first, again = (
        subprocess.run([sys.executable, "-c", AGAIN], check=True, capture_output=True, text=True).stdout.split()
        for _ in range(2)
    )
    assert first == [provenance.code_version(), str(len(provenance.list_source_files(provenance.WORKER_MODULES)))]
    assert again == [first[0], "0"]


@pytest.mark.usefixtures("fake_engine")
def test_another_processor_is_another_run_and_said(tmp_path, monkeypatch, capsys):
    settings = EngineSettings()
    here = run_id(settings)
    with monkeypatch.context() as patch:
        patch.setenv("XLA_FLAGS", "--xla_cpu_max_isa=SSE4_2")
        assert run_id(settings) != here
    assert main(["run", *STUDY, f"out={tmp_path}", "--limit", "8"]) == 0
    assert "last bit" not in capsys.readouterr().err
    monkeypatch.setattr(provenance, "processor_id", lambda: "another processor")
    assert run_id(settings) != here
    assert main(["run", *STUDY, f"out={tmp_path}"]) == 0
    assert "equal rollouts may differ in the last bit between them" in (error := capsys.readouterr().err)
    assert "another processor" in error
    assert content(tmp_path)["run_id"].nunique() == 2


def test_a_commit_is_marked_where_what_makes_rows_differs(tmp_path, monkeypatch):
    """`make paper` draws pictures into the checkout that it runs in."""
    for name in ("sweep/core.py", "conf/study.yaml", "research/data.json"):
        (tmp_path / name).parent.mkdir()
        (tmp_path / name).write_text("1\n")
    git = ["git", "-C", str(tmp_path), "-c", "user.name=a", "-c", "user.email=a@example.org"]
    for words in (["init", "-q"], ["add", "."], ["commit", "-qm", "a"]):
        subprocess.run([*git, *words], check=True)
    monkeypatch.setattr(provenance, "SOURCE_FOLDER", tmp_path / "sweep")
    plain = provenance.find_commit.__wrapped__()
    assert len(plain) == 12
    (tmp_path / "research/data.json").write_text("2\n")
    assert provenance.find_commit.__wrapped__() == plain
    (tmp_path / "conf/study.yaml").write_text("2\n")
    assert provenance.find_commit.__wrapped__() == f"{plain}-dirty"
    monkeypatch.setenv("PATH", str(tmp_path))  # a machine without git
    assert provenance.find_commit.__wrapped__() == ""

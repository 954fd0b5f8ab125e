"""The reference pages say what the code says."""

import sys
from pathlib import Path

import pytest

from sweep.cli.main import main
from sweep.config.experiment import compose
from sweep.core.metric import merge_columns
from sweep.systems.mujoco_model.metrics import METRICS

DOCS = Path(__file__).parents[1] / "docs"
sys.path.append(str(DOCS))

import reference_pages  # noqa: E402  # pyright: ignore[reportMissingImports]


@pytest.fixture(scope="module")
def made():
    return reference_pages.pages()


def test_every_page_is_current(made):
    assert {file.name for file in (DOCS / "reference").glob("*.md")} == {*made}
    for name, text in made.items():
        told = f"docs/reference/{name} is not what the code says: run `python docs/reference_pages.py`"
        assert (DOCS / "reference" / name).read_text(encoding="utf-8") == text, told


def test_no_entry_is_without_a_meaning(made):
    for name in ("columns.md", "causes.md", "cli.md", "exit_codes.md", "study_file.md", "formats.md", "python.md"):
        rows = [line for line in made[name].splitlines() if line.startswith("| `")]
        wanted = -3 if name == "exit_codes.md" else -2
        assert not [row for row in rows if not row.split(" |")[wanted].strip()], name


def test_metrics_of_an_own_model_are_described(monkeypatch, tmp_path):
    assert main(["init", "--model", str(tmp_path / "quad")]) == 0
    monkeypatch.chdir(tmp_path / "quad")
    assert {*compose(["study=grip"]).system.metric_names} <= {*merge_columns(METRICS)}

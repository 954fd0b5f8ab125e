"""What a terminal of 80 columns shows: whole words, and what there is no room for is named."""

import os
import pty
import re
import subprocess
import sys
from contextlib import suppress

import pandas as pd
import pytest

from sweep.cli.commands import make_parser, shipped_command_names
from sweep.cli.main import main
from sweep.config import reference
from sweep.core.terminal import HIDDEN_COLUMNS_HINT, fit_markdown_to_width
from sweep.report.tables import markdown_table

WIDTH = 80


def words(text: str) -> set[str]:
    return set(re.findall(r"[^\s|:─-]{2,}", text))


@pytest.mark.parametrize("width", [80, 60])
def test_the_reference_breaks_between_words(width):
    whole = reference.parameters_page()
    shown = fit_markdown_to_width(whole, width)
    assert max(map(len, shown.splitlines())) <= width
    assert words(shown) - words(whole) <= words(
        f"Not shown for lack of width: default unit allowed{HIDDEN_COLUMNS_HINT}."
    )


def test_columns_that_are_left_out_are_named_and_the_kept_ones_stay():
    wide = {f"a parameter with a name {k}": ["some-value-without-a-gap"] for k in range(6)}
    rows = markdown_table(pd.DataFrame({**wide, "outcome": ["success"]}))
    shown = fit_markdown_to_width(rows, WIDTH, ["outcome"], "look elsewhere")
    assert max(map(len, shown.splitlines())) <= WIDTH
    assert "success" in shown
    assert shown.count("some-value-without-a-gap") == 2
    assert "name 5: look elsewhere." in " ".join(shown.split())


def test_counts_shares_and_units_are_told_in_one_way():
    rows = pd.DataFrame({"total": [16384], "share": [0.25], "low": [0.2], "high": [float("nan")]})
    assert [cell.strip() for cell in markdown_table(rows).splitlines()[-1].split("|")[1:-1]] == [
        "16,384",
        "25.0 %",
        "20.0 %",
        "",
    ]
    assert "| N·m/rad " in reference.describe_parameter_or_column("drive")
    assert "N*m" not in reference.parameters_page()


def test_a_share_comes_with_its_interval(fake_engine, tmp_path, capsys, monkeypatch):
    axes = ["study.axes.friction.num=3", "study.axes.step.num=3", "study.design={grid: one_at_a_time}"]
    axes += ["study.replicates=2"]
    assert main(["run", "study=walk_map", *axes, "study.expect=[]", f"out={tmp_path}"]) == 0
    capsys.readouterr()
    monkeypatch.setattr(sys.stdout, "isatty", lambda: True)
    monkeypatch.setenv("COLUMNS", str(WIDTH))
    monkeypatch.setenv("PAGER", "cat")
    assert main(["stats", str(tmp_path)]) == 0
    told = capsys.readouterr().out
    assert max(map(len, told.splitlines())) <= WIDTH
    assert re.search(r"^axis .* share +low +high", told, re.MULTILINE)


def run_in_terminal(*words: str, **environment: str) -> str:
    """What a command prints to a terminal of 80 columns."""
    reader, writer = pty.openpty()
    command = [sys.executable, "-m", "sweep.cli", *words]
    with subprocess.Popen(command, stdout=writer, env={**os.environ, "COLUMNS": str(WIDTH), **environment}) as process:
        os.close(writer)
        text = b""
        with suppress(OSError), os.fdopen(reader, "rb", buffering=0) as stream:  # the other end closes
            while part := stream.read(1 << 16):
                text += part
    assert process.returncode == 0
    return text.decode()


def test_the_command_knows_that_it_writes_to_a_terminal():
    text = run_in_terminal("describe", "outcome", PAGER="cat")
    assert max(map(len, text.splitlines())) <= WIDTH
    assert "─" in text


@pytest.mark.parametrize(
    ("lines", "pager", "is_paged"),
    [("24", "sed s/^/paged:/", True), ("400", "sed s/^/paged:/", False), ("24", "", False), ("24", "cat", False),
     ("24", "no-such-pager-here 2> /dev/null", False)],
)  # fmt: skip
def test_a_list_that_is_longer_than_the_screen_is_paged(lines, pager, is_paged):
    shown = run_in_terminal("list", LINES=lines, PAGER=pager).replace("\r\n", "\n")
    whole = shown.replace("paged:", "")
    assert shown.count("paged:") == (len(whole.splitlines()) if is_paged else 0)
    assert whole.startswith("scenario=\n  ")
    assert whole.endswith("sweep list study map\n")
    assert max(map(len, whole.splitlines())) <= WIDTH


def test_a_piped_list_is_not_paged():
    command = [sys.executable, "-m", "sweep.cli", "list"]
    environment = {**os.environ, "LINES": "5", "PAGER": "sed s/^/paged:/"}
    done = subprocess.run(command, capture_output=True, text=True, check=True, env=environment)
    assert done.stdout.startswith("scenario=\n")
    assert "paged:" not in done.stdout


def test_help_is_wrapped_and_its_commands_stay_whole(monkeypatch):
    monkeypatch.setenv("COLUMNS", str(WIDTH))
    helps = [make_parser(name).format_help() for name in shipped_command_names()]
    paragraphs = [line for text in helps for line in text.splitlines() if not line.startswith((" ", "usage"))]
    assert max(map(len, paragraphs)) <= WIDTH
    assert any(len(line) > WIDTH for text in helps for line in text.splitlines() if line.startswith("  sweep"))


def test_formulas_are_listed_within_the_width(monkeypatch, capsys):
    monkeypatch.setenv("COLUMNS", str(WIDTH))
    monkeypatch.setenv("PAGER", "cat")
    monkeypatch.setattr(sys.stdout, "isatty", lambda: True)
    assert main(["formula"]) == 0
    assert max(map(len, capsys.readouterr().out.splitlines())) <= WIDTH

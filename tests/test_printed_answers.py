"""How-to pages of the example project, followed to the letter: their files, commands and what these print."""

import re
import shlex
from pathlib import Path

from test_tutorials import assert_printed

from sweep.cli.main import main

HOWTO = Path(__file__).parents[1] / "docs" / "howto"
PROJECT = HOWTO / "example_cart.md"
PAGES = [
    HOWTO / f"{name}.md" for name in ("choose_the_number_of_rollouts", "rank_policies", "compare_with_real_trials")
]
BLOCK = re.compile(r"```(\w+)\n(.*?)```", re.DOTALL)
FILE = re.compile(r"(?:# |<!-- )([\w/]+\.\w+)(?: -->)?\n")


def follow(page, capsys):
    """Write the files of a page into the working folder, and run its commands; return how many it had."""
    count = 0
    for kind, body in BLOCK.findall(page.read_text(encoding="utf-8")):
        if kind != "console":
            named = FILE.match(body)
            assert named, body
            file = Path(named[1])
            file.parent.mkdir(exist_ok=True)
            file.write_text(body[body.index("\n") + 1 :])
            continue
        for part in re.split(r"^\$ ", body, flags=re.MULTILINE)[1:]:
            command, *expected = part.rstrip("\n").split("\n")
            capsys.readouterr()
            code = main(shlex.split(command)[1:])
            said = capsys.readouterr()
            assert code in (0, 4), (command, said.err)
            assert_printed(expected, said.out.splitlines(), command)
            count += 1
    return count


def test_the_pages_of_the_example_project_do_what_they_say(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert follow(PROJECT, capsys) == 4
    for page in PAGES:
        assert follow(page, capsys) > 1

"""What README and docs show is what works: every command is run, every study is loaded, every link leads somewhere."""

import re
import shlex
import shutil
import types
from pathlib import Path

import numpy as np
import pytest
import test_extending
import test_printed_answers
from fake_engine import FakeEngine
from slow_cases import mark_slow_cases

from sweep.cli import main as cli
from sweep.cli.commands import command_names, make_parser
from sweep.config.experiment import compose

ROOT = Path(__file__).parents[1]
GUIDE = [ROOT / "README.md", ROOT / "results/README.md", *sorted((ROOT / "docs").rglob("*.md"))]
EVIDENCE = sorted((ROOT / "research").rglob("*.md"))
PAGES = [*GUIDE, *EVIDENCE]
# followed to the letter by tests of their own
FOLLOWED = {
    ROOT / "docs/own_model.md",
    ROOT / "docs/howto/run_a_learned_policy.md",
    ROOT / "docs/howto/evaluate_a_gymnasium_task.md",
    *(ROOT / f"docs/howto/{name}.md" for name in test_extending.SAID),
    test_printed_answers.PROJECT,
    *test_printed_answers.PAGES,
}
SLOW_NAMES = ["rare_failures", "tour", "compare", "boundary", "howto/search_a_plan", "howto/map_pushes"]  # over 10 s
SLOW_PAGES = [ROOT / f"docs/{name}.md" for name in SLOW_NAMES]
BLOCK = re.compile(r"(?:^    .*\n|^\n(?=    ))+", re.MULTILINE)
FENCE = re.compile(r"```(\w*)\n(.*?)```", re.DOTALL)


class AnyEngine(FakeEngine):
    """The fake engine for any manoeuvre, in wide batches: one that has no half step takes a tenth of the body."""

    def __init__(self, settings, *of):
        super().__init__(settings, *of)
        self.width = settings.width or 256

    def run(self, world, belief, streams):
        if not hasattr(belief.manoeuvre, "half_step_ratio"):
            belief = types.SimpleNamespace(manoeuvre=types.SimpleNamespace(half_step_ratio=0.1))
        world = types.SimpleNamespace(contact=types.SimpleNamespace(friction=np.asarray(world.contact.friction)))
        return super().run(world, belief, streams)


def blocks(page):
    text = page.read_text(encoding="utf-8")
    yield from (re.sub("^    ", "", block, flags=re.MULTILINE).strip("\n") for block in BLOCK.findall(text))
    yield from (body for kind, body in FENCE.findall(text) if kind in ("", "yaml", "console", "sh"))


def commands(page):
    for block in blocks(page):
        for line in re.sub(r"\\\n\s*", " ", block).splitlines():
            yield from (
                part.strip() for part in line.removeprefix("$ ").split(" && ") if re.match(r"(\$ )?sweep ", line)
            )


def samples(page):
    """Blocks that are studies: with `study:` at the beginning of a line."""
    return [block for block in blocks(page) if re.search(r"^study:", block, re.MULTILINE)]


@pytest.mark.parametrize("fake_engine", [AnyEngine], indirect=True)
@pytest.mark.parametrize(
    "page",
    [
        *mark_slow_cases(
            [page for page in GUIDE if page not in FOLLOWED and page.parent.name not in ("reference", "tutorials")],
            SLOW_PAGES,
        ),
        *(pytest.param(page, marks=pytest.mark.slow) for page in EVIDENCE),  # minutes: hundreds of commands
    ],
    ids=lambda page: str(page.relative_to(ROOT)),
)
def test_every_command_of_a_page_works(page, fake_engine, monkeypatch, tmp_path, capsys):
    assert cli.main(["init", str(tmp_path / "lab")]) == 0
    monkeypatch.chdir(tmp_path / "lab")
    Path("research").symlink_to(ROOT / "research")
    Path("my").mkdir()
    shutil.copy("studies/first.yaml", "my/study.yaml")
    for command in commands(page):
        if command.startswith("cd "):
            monkeypatch.chdir(shlex.split(command)[1])
            continue
        words = [re.sub(r"\bNAME\b", "walk_map", word) for word in shlex.split(command, comments=True)[1:]]
        words = [word for word in words if word not in ("...", "|")]
        words = [word.strip("[]") if word.startswith("[--") else word for word in words]
        made = [word for word in words if word.startswith("results/") and words[0] not in ("run", "init")]
        for folder in made:
            if not Path(folder, "study.yaml").exists():
                Path("results").mkdir(exist_ok=True)
                if not Path("results/walk_map/study.yaml").exists():
                    assert cli.main(["run", "study=walk_map", "study.expect=[]"]) == 0
                if folder != "results/walk_map" and folder != "results/":
                    shutil.copytree("results/walk_map", folder)
        words = [word for word in words if word != "--pictures"]  # for which OpenGL would be needed
        try:
            # 1e-5 takes a third of a million rollouts, and tests install TensorBoard's writer alone of all trackers
            if words[0] in ("replay", "view", "bench") or {"1e-5", "--mlflow", "--wandb"} & set(words):
                code = make_parser(words[0]).parse_args(words[1:]) and 0
            else:
                code = cli.main([*words, "--dry-run"] if any(word.startswith("cluster=") for word in words) else words)
        except SystemExit as end:
            code = end.code
        assert code in (0, 3, 4), (command, capsys.readouterr().err)


@pytest.mark.parametrize(
    "page",
    # the files of the latter are the reader's: test_file_axes has a study of this kind
    [
        p
        for p in PAGES
        if p.name not in ("own_model.md", "run_several_policies.md", "example_cart.md", "compare_with_real_trials.md")
        and p.parent.name != "tutorials"
    ],
    ids=lambda page: str(page.relative_to(ROOT)),
)
def test_every_study_of_a_page_loads_as_it_stands(page, monkeypatch, tmp_path):
    for number, sample in enumerate(samples(page)):
        if "scenario: own" in sample and not (tmp_path / "quad").exists():
            cli.main(["init", str(tmp_path / "quad"), "--model"])
            monkeypatch.chdir(tmp_path / "quad")
        file = tmp_path / f"sample_{number}.yaml"
        file.write_text(sample)
        assert compose([f"study={file}"]).study.axes


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_every_link_and_file_of_a_page_is_there(page):
    text = page.read_text(encoding="utf-8")
    for target in re.findall(r"\]\(([^)#\s]+)[^)]*\)", text):
        assert target.startswith("https://") or (page.parent / target).exists(), target
    for line in re.findall(r"^    (?:python |)((?:jobs|docs|bench|research)/\S+)", text, re.MULTILINE):
        assert (ROOT / line).exists(), line
    if page in FOLLOWED:  # its imports may name what the page adds
        return
    for sentence in re.findall(r"^\s*(from sweep[\w.]* import [\w, ]+?)\s*(?:#.*)?$", text, re.MULTILINE):
        exec(sentence, {})


def test_every_command_has_help_and_is_in_the_tour(capsys):
    tour = (ROOT / "docs" / "tour.md").read_text()
    for name in command_names():
        with pytest.raises(SystemExit) as end:
            cli.main([name, "--help"])
        assert end.value.code == 0
        assert f"sweep {name}" in tour, name
    for name in ("relabel", "compare"):
        with pytest.raises(SystemExit):
            cli.main([name, "--help"])
        assert f"example:\n  sweep {name} " in capsys.readouterr().out
    with pytest.raises(SystemExit):
        cli.main(["run", "--help"])
    assert "_schema" not in capsys.readouterr().out
    assert len((ROOT / "README.md").read_text().split()) <= 900


def test_the_guide_can_be_read():
    """Words of the guide, generated reference pages not counted, and the size of docs/ with its pictures."""
    pages = [page for page in (ROOT / "docs").rglob("*.md") if page.parent.name != "reference"]
    words = (word for page in pages for word in page.read_text(encoding="utf-8").split())
    assert sum(any(map(str.isalnum, word)) for word in words) <= 40_000  # bars of tables are no words
    assert sum(file.stat().st_size for file in (ROOT / "docs").rglob("*") if file.is_file()) <= 5_000_000

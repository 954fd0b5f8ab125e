"""Subcommands are found by their files, and by entry points of installed packages."""

import subprocess
import sys

import pytest

from sweep.cli import commands
from sweep.cli.command import Section
from sweep.cli.commands import replay, tune
from sweep.cli.main import main
from sweep.planning import score
from sweep.systems.hexapod.plots import PLOTS

DISK = '''"""`sweep used_elsewhere`: count the files of a folder."""

from pathlib import Path

from sweep.cli.command import Command, Section

COMMAND = Command(Section.READ, "count the files of a folder")


def add_arguments(parser):
    parser.add_argument("folder", type=Path)
    parser.add_argument("--all", action="store_true")


def run(args):
    print(len(list(args.folder.iterdir())), "files")
    return 4 if args.all else 0
'''


@pytest.fixture
def install(tmp_path, monkeypatch):
    """Install a package with one module and entry points of subcommands, as pip would."""

    def write(text, **points):
        site = tmp_path / "site"
        about = site / "disk_usage-1.0.dist-info"
        about.mkdir(parents=True)
        (site / "disk_usage.py").write_text(text)
        (about / "METADATA").write_text("Metadata-Version: 2.1\nName: disk-usage\nVersion: 1.0\n")
        lines = "".join(f"{name} = {module}\n" for name, module in points.items())
        (about / "entry_points.txt").write_text(f"[{commands.ENTRY_POINTS}]\n{lines}")
        monkeypatch.syspath_prepend(site)
        commands.installed_commands.cache_clear()

    yield write
    monkeypatch.undo()
    sys.modules.pop("disk_usage", None)
    commands.installed_commands.cache_clear()


def test_an_installed_package_adds_a_subcommand(install, tmp_path, capsys):
    install(DISK, used_elsewhere="disk_usage")
    (tmp_path / "full").mkdir()
    (tmp_path / "full/file").touch()
    assert main(["used_elsewhere", str(tmp_path / "full")]) == 0
    assert capsys.readouterr().out == "1 files\n"
    assert main(["used_elsewhere", str(tmp_path / "full"), "--all"]) == 4
    assert main(["usage_elsewere"]) == 2
    assert "did you mean used_elsewhere?" in capsys.readouterr().err
    assert main(["completion", "--line", "sweep used_elsewhere --"]) == 0
    assert "--all" in capsys.readouterr().out


def test_help_names_an_installed_subcommand_without_running_its_code(install, capsys):
    install("raise SystemExit('ran')", used_elsewhere="disk_usage")
    with pytest.raises(SystemExit) as end:
        main(["--help"])
    assert end.value.code == 0
    assert "  used_elsewhere disk-usage\n" in capsys.readouterr().out
    assert main(["used_elsewhere"]) == 2
    said = "sweep: subcommand used_elsewhere of disk-usage cannot be imported: SystemExit: ran\n"
    assert capsys.readouterr().err == said


def test_a_module_that_is_no_subcommand_is_one_line(install, capsys):
    install("COMMAND = None\nadd_arguments = None\n", used_elsewhere="disk_usage")
    assert main(["used_elsewhere", "."]) == 2
    assert capsys.readouterr().err == "sweep: subcommand used_elsewhere of disk-usage: disk_usage does not define run\n"


def test_an_installed_package_cannot_replace_a_subcommand(install, capsys):
    install("raise SystemExit('ran')", status="disk_usage")
    assert main(["status", "nowhere"]) == 2
    assert "nowhere is not a folder of results" in capsys.readouterr().err
    assert commands.command_names().count("status") == 1


@pytest.mark.parametrize("folder", [".", "sweep/cli/commands", "commands"])
def test_files_of_a_folder_are_no_subcommands(folder, tmp_path):
    """Neither a project nor a folder of results that somebody sent can add code by a subcommand's name."""
    file = tmp_path / folder / "used_elsewhere.py"
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_text("raise SystemExit('ran')")
    (tmp_path / "sweep.yaml").write_text("modules: []\n")
    (tmp_path / "study.yaml").touch()
    code = "import sys; from sweep.cli.main import main; sys.exit(main(['used_elsewhere', '.']))"
    done = subprocess.run([sys.executable, "-P", "-c", code], cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 2
    assert done.stderr.startswith("sweep: command = used_elsewhere is unknown")


def test_every_subcommand_has_a_section_and_a_line():
    for name in commands.shipped_command_names():
        about = commands.load_command(name).COMMAND
        assert about.section in Section
        assert about.help
        assert "\n" not in about.help


def test_help_and_mistaken_flags_import_nothing_slow():
    slow = ["jax", "matplotlib", "mujoco", "numpy", "pandas", "rich", "scipy"]
    code = f"""import contextlib, sys
from sweep.cli import commands
from sweep.cli.main import main
with contextlib.suppress(SystemExit):
    main(["--help"])
for name in commands.shipped_command_names():
    commands.make_parser(name).format_help()
    if name != "run":  # whose flags Hydra knows
        main([name, "--no-such-flag"])
print("imported", *(name for name in {slow} if name in sys.modules))"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.endswith("imported\n")


def test_names_that_are_written_twice_to_import_nothing_slow_are_equal():
    assert tuple(PLOTS) == replay.REPLAY_PLOTS
    assert (score.MIN_PHASES, score.MAX_PHASE_INTERVAL) == (tune.MIN_MOMENTS, tune.MAX_MOMENT_INTERVAL_S)

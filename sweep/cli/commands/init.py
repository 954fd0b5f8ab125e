"""`sweep init`: create a project."""

import argparse
import shlex
from collections.abc import Iterator
from importlib.resources import files
from importlib.resources.abc import Traversable
from pathlib import Path

from sweep.cli.command import Command, Section
from sweep.cli.exits import DONE
from sweep.core.arguments import Arguments
from sweep.core.errors import InputError
from sweep.core.files import write_atomically

COMMAND = Command(Section.LOOK_UP, "create a project: a folder for your own studies, robots and modules")
DOT_FILE_NAMES = {"gitignore": ".gitignore"}  # files that a package cannot hold under their name


def add_arguments(parser: Arguments) -> None:
    """Add the arguments of `sweep init`: folder, and kind of project."""
    parser.add_argument("dir", nargs="?", help="a new or empty folder (with --policy, default: its name)")
    parser.add_argument(
        "--model", action="store_true", help="with an example MuJoCo model and controller, see docs/own_model.md"
    )
    parser.add_argument("--policy", metavar="FILE", help="with a learned policy: a network such as walk.onnx")
    parser.add_argument("--mjcf", metavar="FILE", help="the MuJoCo model that the policy controls")
    parser.add_argument(
        "--gym", metavar="TASK", help="with a MuJoCo task of gymnasium such as Ant-v5, and --policy if you have one"
    )
    parser.add_argument("--preset", metavar="NAME", default="playground",
                        help="the framework that trained it: playground, playground_gait, mjlab or isaaclab "
                             "(default: playground)")  # fmt: skip


def run(args: argparse.Namespace) -> int:
    """Make a project in a folder without changing existing files; an interrupted one is completed.

    Raises `InputError`.
    """
    if args.dir is None and args.policy:
        args.dir = Path(args.policy).stem
    if args.dir is None:
        raise InputError("dir is needed: a new or empty folder")
    if not str(args.dir).strip():
        raise InputError(f"dir = {str(args.dir)!r} is not allowed: a new or empty folder")
    folder = Path(args.dir)
    if args.gym and (args.mjcf or args.model):
        raise InputError("--gym is not allowed with --mjcf or --model: the task has its model")
    if not args.gym and (bool(args.policy) != bool(args.mjcf) or (args.policy and args.model)):
        raise InputError("--policy and --mjcf need each other, and exclude --model")
    if args.gym:
        from sweep.cli import gym_project

        contents = gym_project.project_files(args.gym, Path(args.policy) if args.policy else None)
        study = "mass"
    elif args.policy:
        from sweep.cli import policy_project

        contents, study = policy_project.project_files(Path(args.policy), Path(args.mjcf), args.preset), "push_delay"
    else:
        source, study = ("template_model", "grip") if args.model else ("template", "first")
        every = template_files(files("sweep.cli") / source)
        contents = {str(Path(*path)): file.read_bytes() for file, path in every}
    wanted = {folder / name: content for name, content in contents.items()}
    there = {path for path in wanted if path.exists()}
    others = [path for path in there if not (path.is_file() and path.read_bytes() == wanted[path])]
    if others or len(there) == len(wanted):
        raise InputError(f"{min(others or there)} is there already: choose an empty folder")
    for path, content in wanted.items():
        path.parent.mkdir(parents=True, exist_ok=True)
        if path not in there:
            write_atomically(path, content)
        print(path)
    check = "sweep policy check own; " if args.policy else ""
    print(f"next: cd {shlex.quote(str(folder))}; {check}sweep run study={study}")
    return DONE


def template_files(folder: Traversable, above: tuple[str, ...] = ()) -> Iterator[tuple[Traversable, tuple[str, ...]]]:
    """Yield each file of a project template with its path in the new project."""
    for entry in sorted(folder.iterdir(), key=lambda e: e.name):
        if entry.is_dir() and entry.name != "__pycache__":
            yield from template_files(entry, (*above, entry.name))
        elif entry.is_file():
            yield entry, (*above, DOT_FILE_NAMES.get(entry.name, entry.name))

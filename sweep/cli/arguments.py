"""Arguments that several subcommands share."""

from pathlib import Path

from sweep.core.arguments import Arguments


def add_folder(parser: Arguments) -> None:
    """Add the positional argument `dir`, a results folder, to a parser."""
    parser.add_argument("dir", type=Path, help="folder of a study, such as results/walk_map")


def add_where(parser: Arguments, text: str = "only rows that match") -> None:
    """Add the option `--where`, a condition on rows, with `text` as its help."""
    parser.add_argument("--where", help=text)


def add_output(parser: Arguments, text: str) -> None:
    """Add the option `-o`, a path to write to, with `text` as its help."""
    parser.add_argument("-o", "--output", type=Path, help=text)


def parse_comma_separated_names(text: str | None) -> list[str] | None:
    """Split a comma-separated list: `a, b` -> [`a`, `b`]."""
    return [name.strip() for name in text.split(",")] if text else None

"""Markdown for a terminal: tables drop columns, and lines break between words."""

import io
import os
import re
import subprocess
import sys
import textwrap
from collections.abc import Collection, Iterator
from itertools import groupby

MAX_UNBROKEN_WIDTH = 14  # a cell of at most so many letters is never broken
COLUMN_GAP = 2  # letters between columns
HIDDEN_COLUMNS_HINT = "use a wider terminal, or `| less -S` for all"


def print_markdown(
    text: str, required: Collection[str] = (), hidden_hint: str = HIDDEN_COLUMNS_HINT, is_paged: bool = False
) -> None:
    """Print Markdown to the standard output, fitted to the terminal's width if it is a terminal.

    Args:
        text: Markdown.
        required: Columns of tables that are never dropped.
        hidden_hint: Where a reader finds dropped columns, for a note.
        is_paged: Whether a terminal shows a text that is longer than its screen in a pager.
    """
    if sys.stdout.isatty():
        from rich.console import Console

        console = Console()
        text = fit_markdown_to_width(text, console.width, required, hidden_hint)
        if is_paged and text.count("\n") >= console.height and show_in_pager(text):
            return
    sys.stdout.write(text)


def show_in_pager(text: str) -> bool:
    """Show a text in the program that `PAGER` names, `less` by default; return whether there was one.

    As git does: `LESS` is FRX unless it is set, so that `less` ends with the text if it fits the screen. An empty
    `PAGER`, or `cat`, turns the pager off.
    """
    command = os.environ.get("PAGER", "less")
    if command.strip() in ("", "cat"):
        return False
    sys.stdout.flush()
    environment = {"LESS": "FRX", **os.environ}
    done = subprocess.run(command, shell=True, input=text.encode(), env=environment, check=False)
    return done.returncode not in (126, 127)  # of a shell that finds no such program


def fit_markdown_to_width(
    text: str, width: int, required: Collection[str] = (), hidden_hint: str = HIDDEN_COLUMNS_HINT
) -> str:
    """Fit Markdown into lines of limited width, without breaking words.

    Args:
        text: Markdown.
        width: Largest width of a line, in characters.
        kept: Columns of tables that are never dropped. As many others as fit are shown, from the left.
        hidden_hint: Where a reader finds dropped columns, for a note.

    Returns:
        The fitted text.
    """
    parts: list[str] = []
    for is_table, group in groupby(text.splitlines(), lambda line: line.startswith("|")):
        lines = list(group)
        parts += (
            fit_table(lines, width, required, hidden_hint) if is_table else [wrap_line(line, width) for line in lines]
        )
    return "\n".join(parts) + "\n"


def wrap_line(line: str, width: int) -> str:
    """Wrap a line between words. Further lines are indented like the text of a list entry.

    Args:
        line: The line.
        width: Largest width, in characters.

    Returns:
        The text with line breaks.
    """
    found = re.match(r" *(- |\S+ {2,})?", line)
    deep = found.end() if found else 0
    return textwrap.fill(line[deep:], width, initial_indent=line[:deep], subsequent_indent=" " * deep,
                         break_long_words=False, break_on_hyphens=False)  # fmt: skip


def fit_table(lines: list[str], width: int, required: Collection[str], hidden_hint: str) -> Iterator[str]:
    """Yield the lines of a Markdown table, without columns that do not fit, and a note that names these columns.

    Args:
        lines: Lines of the table.
        width: Largest width of a line, in characters.
        kept: Columns that are never dropped.
        hidden_hint: Where a reader finds dropped columns.

    Yields:
        Lines of text.
    """
    marks = lines[1].strip("|").split("|")
    heads, *rows = ([cell.strip() for cell in line[1:-1].split(" | ")] for line in (lines[0], *lines[2:]))
    columns = list(zip(heads, *rows, strict=True))
    natural = [max(map(display_width, column)) for column in columns]
    needed = [max(map(unbreakable_width, column)) for column in columns]
    found: list[int] = []
    for k in sorted(range(len(heads)), key=lambda k: heads[k] not in required):
        if sum(needed[j] + COLUMN_GAP for j in (*found, k)) - COLUMN_GAP <= width:
            found.append(k)
    found.sort()
    widths = shrink_column_widths(
        [natural[k] for k in found], [needed[k] for k in found], width - COLUMN_GAP * (len(found) - 1)
    )
    yield from render_table([columns[k] for k in found], [marks[k].endswith("-:") for k in found], widths)
    if left := [head for k, head in enumerate(heads) if k not in found]:
        yield wrap_line(f"Not shown for lack of width: {', '.join(left)}: {hidden_hint}.", width)


def display_width(text: str) -> int:
    """Return the width of a text in terminal cells; a Chinese character takes two."""
    from rich.cells import cell_len

    return cell_len(text)


def unbreakable_width(text: str) -> int:
    """Return the width of the longest word of a table cell, or of the whole cell if it is short."""
    return display_width(text) if display_width(text) <= MAX_UNBROKEN_WIDTH else max(map(display_width, text.split()))


def shrink_column_widths(widths: list[int], needed: list[int], room: int) -> list[int]:
    """Narrow the widest columns until all columns fit.

    Args:
        widths: Widths of the columns; changed in place.
        needed: Least width of each column.
        room: Largest sum of the widths.

    Returns:
        `widths`.
    """
    while sum(widths) > room:
        widest = max((k for k in range(len(widths)) if widths[k] > needed[k]), key=widths.__getitem__)
        widths[widest] -= 1
    return widths


def render_table(columns: list[tuple[str, ...]], right: list[bool], widths: list[int]) -> list[str]:
    """Render a table as lines of text, with a rule below the headings.

    Args:
        columns: Cells of each column, its heading first.
        right: Whether each column is aligned to the right.
        widths: Width of each column, in characters.

    Returns:
        Lines of text.
    """
    from rich import box
    from rich.console import Console
    from rich.table import Table

    drawn = Table(box=box.SIMPLE_HEAD, show_edge=False, pad_edge=False, padding=(0, COLUMN_GAP - 1, 0, 0))
    for (head, *_), aside, width in zip(columns, right, widths, strict=True):
        drawn.add_column(head, justify="right" if aside else "left", width=width)
    for row in zip(*(cells for _, *cells in columns), strict=True):
        drawn.add_row(*row)
    page = io.StringIO()
    Console(file=page, width=sum(widths) + COLUMN_GAP * len(widths), highlight=False, markup=False).print(drawn)
    return [line.rstrip() for line in page.getvalue().splitlines()]

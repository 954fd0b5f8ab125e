"""What a terminal has room for: Markdown with tables of the columns that fit, and lines that break between words."""

import io
import re
import sys
import textwrap
from collections.abc import Collection, Iterator
from itertools import groupby

NUMBER = 14  # letters of a cell at most that stays in one line
GAP = 2  # letters between columns
ELSEWHERE = "a wider terminal, or a file, has them"


def show(text: str, kept: Collection[str] = (), elsewhere: str = ELSEWHERE) -> None:
    """Print Markdown, `fitted` to the terminal; whole where it goes into a file or to another command."""
    if sys.stdout.isatty():
        from rich.console import Console

        text = fitted(text, Console().width, kept, elsewhere)
    sys.stdout.write(text)


def fitted(text: str, width: int, kept: Collection[str] = (), elsewhere: str = ELSEWHERE) -> str:
    """Markdown in lines of at most `width` letters, no word of them broken; what is not a table breaks as it is.

    Of a table the columns `kept` stay, and from the left as many others as there is room for; `elsewhere` says where
    the rest is.
    """
    parts: list[str] = []
    for is_table, group in groupby(text.splitlines(), lambda line: line.startswith("|")):
        lines = list(group)
        parts += table(lines, width, kept, elsewhere) if is_table else [wrapped(line, width) for line in lines]
    return "\n".join(parts) + "\n"


def wrapped(line: str, width: int) -> str:
    """A line in several, those after the first as far in as its text: behind a dash, or the name of an entry."""
    found = re.match(r" *(- |\S+ {2,})?", line)
    deep = found.end() if found else 0
    return textwrap.fill(line[deep:], width, initial_indent=line[:deep], subsequent_indent=" " * deep,
                         break_long_words=False, break_on_hyphens=False)  # fmt: skip


def table(lines: list[str], width: int, kept: Collection[str], elsewhere: str) -> Iterator[str]:
    """A Markdown table, as `fitted` has it."""
    marks = lines[1].strip("|").split("|")
    heads, *rows = ([cell.strip() for cell in line[1:-1].split(" | ")] for line in (lines[0], *lines[2:]))
    columns = list(zip(heads, *rows, strict=True))
    natural = [max(map(letters, column)) for column in columns]
    needed = [max(map(unbroken, column)) for column in columns]
    found: list[int] = []
    for k in sorted(range(len(heads)), key=lambda k: heads[k] not in kept):
        if sum(needed[j] + GAP for j in (*found, k)) - GAP <= width:
            found.append(k)
    found.sort()
    widths = narrowed([natural[k] for k in found], [needed[k] for k in found], width - GAP * (len(found) - 1))
    yield from laid_out([columns[k] for k in found], [marks[k].endswith("-:") for k in found], widths)
    if left := [head for k, head in enumerate(heads) if k not in found]:
        yield wrapped(f"No room for {', '.join(left)}: {elsewhere}.", width)


def letters(text: str) -> int:
    """Cells of a terminal that a text takes; letters of Chinese take two."""
    from rich.cells import cell_len

    return cell_len(text)


def unbroken(text: str) -> int:
    """Letters of its longest part that stays in one line: all of it where it is short."""
    return letters(text) if letters(text) <= NUMBER else max(map(letters, text.split()))


def narrowed(widths: list[int], needed: list[int], room: int) -> list[int]:
    """Widths that fit into `room`, the widest given up first, none below what it needs."""
    while sum(widths) > room:
        widest = max((k for k in range(len(widths)) if widths[k] > needed[k]), key=widths.__getitem__)
        widths[widest] -= 1
    return widths


def laid_out(columns: list[tuple[str, ...]], right: list[bool], widths: list[int]) -> list[str]:
    """Lines of a table, its headings above a rule."""
    from rich import box
    from rich.console import Console
    from rich.table import Table

    drawn = Table(box=box.SIMPLE_HEAD, show_edge=False, pad_edge=False, padding=(0, GAP - 1, 0, 0))
    for (head, *_), aside, width in zip(columns, right, widths, strict=True):
        drawn.add_column(head, justify="right" if aside else "left", width=width)
    for row in zip(*(cells for _, *cells in columns), strict=True):
        drawn.add_row(*row)
    page = io.StringIO()
    Console(file=page, width=sum(widths) + GAP * len(widths), highlight=False, markup=False).print(drawn)
    return [line.rstrip() for line in page.getvalue().splitlines()]

"""Figures at the widths of a paper's column and page, all letters of one size, legends that are never cut."""

from collections.abc import Sequence
from contextlib import AbstractContextManager
from functools import partial
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.figure import Figure
from matplotlib.font_manager import FontProperties, fontManager
from matplotlib.legend_handler import HandlerTuple
from matplotlib.textpath import TextPath
from matplotlib.ticker import MaxNLocator

from sweep.core.files import write_whole

COLUMN, PAGE = 84 / 25.4, 174 / 25.4  # in, as most journals have them
TALL = 7.2  # in, as a page has room for above a caption: a taller figure would be shrunk, and its letters
LETTERS = 8  # points
DPI = 150  # of a picture in pixels
SERIF = ["STIX Two Text", "Times New Roman", "STIXGeneral", "DejaVu Serif"]  # the one but last comes with matplotlib
# where letters come from that are in none of those: the first that is there
OTHER_FONTS = ("Noto Sans CJK SC", "Noto Sans CJK JP", "Source Han Sans SC", "WenQuanYi Zen Hei", "WenQuanYi Micro Hei")
LINE = 1.5  # of a legend, in letters
PANEL = 0.6  # of a column's width, at least, is a panel's: beside it stand numbers, words, and the gap to the next
HANDLE = 6.0  # of a legend's entry beside its text, in letters: handle, gap, and the space to the next column


def lettering(serif: bool = False) -> AbstractContextManager[None]:
    """The context that a figure is drawn and written in: letters of 8 points, with serifs or without."""
    sizes = ("axes.titlesize", "axes.labelsize", "xtick.labelsize", "ytick.labelsize", "legend.fontsize",
             "legend.title_fontsize", "figure.titlesize", "figure.labelsize")  # fmt: skip
    look: dict[Any, Any] = {"font.size": LETTERS, **dict.fromkeys(sizes, LETTERS)}
    look |= {"axes.linewidth": 0.6, "lines.linewidth": 1.0, "hatch.linewidth": 0.5}
    look |= {"xtick.major.width": 0.6, "ytick.major.width": 0.6, "pdf.fonttype": 42, "svg.fonttype": "none"}
    known = {font.name for font in fontManager.ttflist}
    others = [name for name in OTHER_FONTS if name in known][:1]
    look |= {"font.family": ["serif" if serif else "sans-serif", *others]}
    if serif:
        look |= {"font.serif": SERIF, "mathtext.fontset": "stix"}
    return mpl.rc_context(look)


def sheet(height: float, width: float = PAGE) -> Figure:
    """An empty figure, in inches, no taller than a page has room for."""
    return Figure(figsize=(width, min(height, TALL)), layout="constrained")


def save(figure: Figure, path: Path, dpi: int = DPI) -> Path:
    """Write `figure` in the format that the suffix of `path` names, without a date in it; the path."""
    metadata = {"Date": None} if path.suffix == ".svg" else None
    with lettering(), mpl.rc_context({"svg.hashsalt": "sweep"}):
        write_whole(path, partial(figure.savefig, dpi=dpi, metadata=metadata))
    return path


def legend_below(figure: Figure, handles: Sequence[Any]) -> None:
    """A legend below all panels, in as many columns as the figure is wide enough for; it grows by further lines.

    A handle is an artist with a label, or several that are drawn over each other, the first of which has it; of those
    with the same label, as panels have them, one is shown.
    """
    if not handles:
        return
    named = {str((one if hasattr(one, "get_label") else one[0]).get_label()): one for one in handles}
    labels, handles = list(named), list(named.values())
    widths = [wide(label) + HANDLE * LETTERS for label in labels]
    across, high = figure.get_size_inches()
    columns = max((n for n in range(1, len(handles) + 1) if taken(widths, n) <= 72 * across - 2 * LETTERS), default=1)
    lines = -(-len(handles) // columns)
    figure.set_size_inches(across, max(high, min(high + (lines - 1) * LINE * LETTERS / 72, TALL)))
    over = {tuple: HandlerTuple(ndivide=1)}
    figure.legend(handles, labels, loc="outside lower center", ncols=columns, handler_map=over)


def taken(widths: Sequence[float], columns: int) -> float:
    """Width of a legend of entries so wide in so many columns, each filled before the next, as matplotlib does."""
    return sum(max(part) for part in np.array_split(widths, columns))


def wide(text: str) -> float:
    """How wide the widest line of `text` is, in points."""
    lines = [line for line in text.splitlines() if line.strip()]
    return max(
        (TextPath((0, 0), line, LETTERS, prop=FontProperties()).get_extents().width for line in lines), default=0
    )


def spaced(ax: Axes, columns: int) -> None:
    """As many ticks along x, five at most, as leave half a letter between labels in one of a figure's columns."""
    low, high = ax.get_xlim()
    room = PANEL * 72 * ax.figure.get_figure(root=True).get_size_inches()[0] / columns
    for number in range(5, 0, -1):
        ax.xaxis.set_major_locator(MaxNLocator(number))
        ticks = ax.xaxis.get_majorticklocs()
        widest = max(wide(label) for label in ax.xaxis.get_major_formatter().format_ticks(list(ticks)))
        if np.diff(ticks).min() / (high - low) * room > widest + LETTERS / 2:
            return


def counted(axis: Axis) -> None:
    """Ticks at whole numbers, along which something is counted."""
    axis.set_major_locator(MaxNLocator("auto", steps=[1, 2, 5, 10], integer=True))


def folded(text: str, room: float) -> str:
    """`text` in lines that are no wider than `room` points, as far as its words allow."""
    lines = []
    for paragraph in text.splitlines():
        line = ""
        for word in paragraph.split(" "):
            if line and wide(f"{line} {word}") > room:
                lines.append(line)
                line = word
            else:
                line = f"{line} {word}" if line else word
        lines.append(line)
    return "\n".join(lines)

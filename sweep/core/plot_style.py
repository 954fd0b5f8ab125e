"""Style of plots: widths of a paper's column and page, one font size, legends that fit."""

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

from sweep.core.files import write_atomically

COLUMN_WIDTH_IN, PAGE_WIDTH_IN = 84 / 25.4, 174 / 25.4  # in, as most journals have them
MAX_HEIGHT_IN = 7.2  # in, as a page has room for above a caption: a taller figure would be shrunk, and its letters
FONT_SIZE_PT = 8  # points
LEG_COLORS = ("#0072b2", "#e69f00", "#009e73", "#cc79a7", "#56b4e9", "#d55e00")  # Okabe and Ito, safe when colour-blind
DPI = 150  # of a picture in pixels
SERIF = ["STIX Two Text", "Times New Roman", "STIXGeneral", "DejaVu Serif"]  # the one but last comes with matplotlib
# where letters come from that are in none of those: the first that is there
OTHER_FONTS = ("Noto Sans CJK SC", "Noto Sans CJK JP", "Source Han Sans SC", "WenQuanYi Zen Hei", "WenQuanYi Micro Hei")
LEGEND_LINE_HEIGHT = 1.5  # of a legend, in letters
MIN_PANEL_SHARE = (
    0.6  # of a column's width, at least, is a panel's: beside it stand numbers, words, and the gap to the next
)
LEGEND_HANDLE_WIDTH = (
    6.0  # of a legend's entry beside its text, in letters: handle, gap, and the space to the next column
)


def plot_style(serif: bool = False) -> AbstractContextManager[None]:
    """Return the Matplotlib context in which figures are drawn and saved: 8-point text, serif or sans serif."""
    sizes = ("axes.titlesize", "axes.labelsize", "xtick.labelsize", "ytick.labelsize", "legend.fontsize",
             "legend.title_fontsize", "figure.titlesize", "figure.labelsize")  # fmt: skip
    look: dict[Any, Any] = {"font.size": FONT_SIZE_PT, **dict.fromkeys(sizes, FONT_SIZE_PT)}
    look |= {"axes.linewidth": 0.6, "lines.linewidth": 1.0, "hatch.linewidth": 0.5}
    look |= {"xtick.major.width": 0.6, "ytick.major.width": 0.6, "pdf.fonttype": 42, "svg.fonttype": "none"}
    known = {font.name for font in fontManager.ttflist}
    others = [name for name in OTHER_FONTS if name in known][:1]
    look |= {"font.family": ["serif" if serif else "sans-serif", *others]}
    if serif:
        look |= {"font.serif": SERIF, "mathtext.fontset": "stix"}
    return mpl.rc_context(look)


def new_figure(height: float, width: float = PAGE_WIDTH_IN) -> Figure:
    """Make an empty Matplotlib figure with constrained layout.

    Args:
        height: Height in inches, limited to the height of a page.
        width: Width in inches; that of a page by default.

    Returns:
        The figure.
    """
    return Figure(figsize=(width, min(height, MAX_HEIGHT_IN)), layout="constrained")


def save_figure(figure: Figure, path: Path, dpi: int = DPI) -> Path:
    """Save a figure reproducibly: the same plot gives the same bytes.

    Args:
        figure: The figure.
        path: The file; its suffix selects the format.
        dpi: Resolution of raster formats, in pixels per inch.

    Returns:
        `path`.

    Raises:
        InputError: The file cannot be written.
        Fault: The disk failed.
    """
    metadata = {"Date": None} if path.suffix == ".svg" else None
    with plot_style(), mpl.rc_context({"svg.hashsalt": "sweep"}):
        write_atomically(path, partial(figure.savefig, dpi=dpi, metadata=metadata))
    return path


def add_legend_below(figure: Figure, handles: Sequence[Any]) -> None:
    """Add a legend below all panels, in as many columns as fit. The figure grows by the lines after the first.

    Args:
        figure: The figure.
        handles: Artists with labels. An entry may be a tuple of artists drawn over each other, the first with the
            label. Equal labels are shown once.
    """
    if not handles:
        return
    named = {str((one if hasattr(one, "get_label") else one[0]).get_label()): one for one in handles}
    labels, handles = list(named), list(named.values())
    widths = [text_width(label) + LEGEND_HANDLE_WIDTH * FONT_SIZE_PT for label in labels]
    across, high = figure.get_size_inches()
    columns = max(
        (n for n in range(1, len(handles) + 1) if legend_width(widths, n) <= 72 * across - 2 * FONT_SIZE_PT), default=1
    )
    lines = -(-len(handles) // columns)
    figure.set_size_inches(
        across, max(high, min(high + (lines - 1) * LEGEND_LINE_HEIGHT * FONT_SIZE_PT / 72, MAX_HEIGHT_IN))
    )
    over = {tuple: HandlerTuple(ndivide=1)}
    figure.legend(handles, labels, loc="outside lower center", ncols=columns, handler_map=over)


def legend_width(widths: Sequence[float], columns: int) -> float:
    """Return the width of a legend in points, whose entries fill its columns one after the other.

    Args:
        widths: Widths of the entries, in any unit.
        columns: Number of columns.

    Returns:
        The sum of the columns' widths, in the same unit.
    """
    return sum(max(part) for part in np.array_split(widths, columns))


def text_width(text: str) -> float:
    """Return the width of the widest line of a text in points, at the font size of the plots."""
    lines = [line for line in text.splitlines() if line.strip()]
    return max(
        (TextPath((0, 0), line, FONT_SIZE_PT, prop=FontProperties()).get_extents().width for line in lines), default=0
    )


def limit_x_ticks(ax: Axes, columns: int) -> None:
    """Set at most five ticks along x, fewer where their labels would touch.

    Args:
        ax: The panel.
        columns: Number of panels side by side in the figure.
    """
    low, high = ax.get_xlim()
    room = MIN_PANEL_SHARE * 72 * ax.figure.get_figure(root=True).get_size_inches()[0] / columns
    for number in range(5, 0, -1):
        ax.xaxis.set_major_locator(MaxNLocator(number))
        ticks = ax.xaxis.get_majorticklocs()
        widest = max(text_width(label) for label in ax.xaxis.get_major_formatter().format_ticks(list(ticks)))
        if np.diff(ticks).min() / (high - low) * room > widest + FONT_SIZE_PT / 2:
            return


def use_integer_ticks(axis: Axis) -> None:
    """Put ticks at whole numbers only, for an axis of counts."""
    axis.set_major_locator(MaxNLocator("auto", steps=[1, 2, 5, 10], integer=True))


def wrap_text(text: str, room: float) -> str:
    """Break a text between words so that its lines fit a width. A word that is too long stays whole.

    Args:
        text: The text; its line breaks stay.
        room: Width in points, at the font size of the plots.

    Returns:
        The text with further line breaks.
    """
    lines = []
    for paragraph in text.splitlines():
        line = ""
        for word in paragraph.split(" "):
            if line and text_width(f"{line} {word}") > room:
                lines.append(line)
                line = word
            else:
                line = f"{line} {word}" if line else word
        lines.append(line)
    return "\n".join(lines)

"""Rows as text: csv, markdown, LaTeX with booktabs, parquet."""

import io
from collections.abc import Iterator
from csv import writer
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa
from pyarrow.csv import WriteOptions, write_csv

from sweep.analysis.stats import causes, percent
from sweep.core.expressions import column
from sweep.report.labels import name_and_unit, path_words, unique_headings, unique_words, unit_of
from sweep.runs.results import Results
from sweep.study.columns import LABELS, figure_columns
from sweep.study.config import Experiment
from sweep.systems.base import split_side

SIGNS = {"°": r"\textdegree{}", "·": r"$\cdot$", "⁴": r"\textsuperscript{4}", r"a\_r": "$a_r$"}
SHARES = ("share", "low", "high")  # of tables of rates; without a share, low and high are numbers of their own


def render(rows: pd.DataFrame, form: str, names: list[str] | None = None, exp: Experiment | None = None) -> bytes:
    """`rows` of `exp` in one of the forms; `names` chooses columns. Raises `InputError` on an unknown one.

    Headings have units where the form is one to read.
    """
    if names:
        rows = rows[list(dict.fromkeys(column(rows, name) for name in names))]
    elif form in ("markdown", "latex"):  # a page has no room for more; csv and parquet hold everything
        rows = rows[reading(rows)]
    match form:
        case "csv":
            return csv(rows)
        case "parquet":
            content = io.BytesIO()
            rows.to_parquet(content, index=False, compression="zstd")
            return content.getvalue()
        case "latex":
            return latex(rows, exp).encode()
        case _:
            page = page_table(rows, exp) + "\n"
            lines = axis_lines(rows, exp) if exp else []
            lines += causes(rows["cause"], exp.system.cause_meanings(exp.thresholds)) if exp and "cause" in rows else []
            legend = "".join(f"- {line}\n" for line in lines)
            return f"{page}\n{legend}".encode() if legend else page.encode()


def csv(rows: pd.DataFrame) -> bytes:
    """`rows` as CSV, words in quotes; by Arrow, which takes a tenth of pandas' time."""
    content = io.BytesIO()
    header = io.StringIO()
    writer(header, lineterminator="\n").writerow(rows.columns)
    content.write(header.getvalue().encode())
    write_csv(pa.Table.from_pandas(rows, preserve_index=False), content, WriteOptions(include_header=False))
    return content.getvalue()


def axis_lines(rows: pd.DataFrame, exp: Experiment) -> list[str]:
    """A line for each axis whose label in a table does not tell its path: `grip (world): world.contact.friction`."""
    words = unique_words(rows.columns, exp)
    return [f"{words[a.column]}: {a.target}" for a in exp.study.axes
            if a.target and a.column in rows and words[a.column] != path_words(a.target)]  # fmt: skip


def page_table(rows: pd.DataFrame, exp: Experiment | None = None) -> str:
    """`rows` in Markdown, with readable headings and numbers."""
    return shown(rows, exp).to_markdown(index=False, disable_numparse=True)


def reading(rows: pd.DataFrame) -> list[str]:
    """The columns for a page: axes, replicate where there are several, outcome."""
    several = ["replicate"] if rows["replicate"].nunique() > 1 else []
    return [c for c in rows.columns if "." in c] + several + list(LABELS)


def shown(rows: pd.DataFrame, exp: Experiment | None = None) -> pd.DataFrame:
    """`rows` with readable headings and numbers; shares and their ends in per cent, as in every sentence."""
    shares = [c for c in SHARES if c in rows and "share" in rows]
    rows = rows.assign(**{c: [percent(v) if pd.notna(v) else "" for v in rows[c]] for c in shares})
    return rows.map(text).rename(columns=unique_headings(rows.columns, exp))


def text(value: object) -> str:
    """Four digits are enough to read, thousands stand apart; what is not there stays empty."""
    if isinstance(value, int | np.integer) and not isinstance(value, bool):
        return f"{value:,}"
    if isinstance(value, float | np.floating):
        return "" if pd.isna(value) else f"{value:.4g}"
    return "" if value is None or value is pd.NA else str(value)


def latex(rows: pd.DataFrame, exp: Experiment | None = None) -> str:
    """A booktabs table; headings and words escaped."""
    style = shown(rows, exp).style.hide(axis="index")
    style = style.format(escape="latex").format_index(escape="latex", axis="columns")
    aligned = "".join("r" if rows[c].dtype.kind in "fi" else "l" for c in rows)
    return signs(style.to_latex(hrules=True, column_format=aligned))


def signs(escaped: str) -> str:
    """Signs of units in text that is escaped for LaTeX, as pdfLaTeX has them."""
    for sign, word in SIGNS.items():
        escaped = escaped.replace(sign, word)
    return escaped


def one_rollout(exp: Experiment, row: pd.Series) -> str:
    """Outcome and figures of one rollout, a line each with its unit."""
    lines = [(exp.scenario, str(row["outcome"]), "")]
    if row["outcome"] != "success":
        lines.append(("cause", str(row["cause"]), f"in stage {row['stage']}"))
    for name in figure_columns(row.to_frame().T):
        if name in exp.system.bookkeeping_metrics:
            continue
        words, unit = name_and_unit(name)
        lines.append((words, text(row[name]), unit))
    table = pd.DataFrame(lines, columns=["figure", "value", "unit"])
    reason = exp.system.why({str(name): value for name, value in row.items()}, exp.thresholds)
    return table.to_markdown(index=False, disable_numparse=True) + "\n" + (reason and f"\n{reason}\n")


def parameters(results: Results) -> Iterator[dict[str, Any]]:
    """The table of what was varied."""
    words = unique_words(results.axes, results.exp)
    paths = {axis.column: axis.path or "" for axis in results.exp.study.axes}
    for name in results.axes:
        values = results.rows[name]
        side, path = split_side(name)
        path = paths.get(name, path)
        listed = [text(v) for v in sorted(values.unique())]
        extent = ", ".join(listed) if len(listed) <= 6 else f"{listed[0]} to {listed[-1]}"
        own = not name.startswith("axis.")  # else a number that parameters are made from
        usual = text(results.exp.system.nominal(name, results.exp.settings)) if own else ""
        about = {"words": words[name], "path": path, "side": side, "unit": unit_of(name, results.exp)}
        yield {**about, "values": extent, "number": len(listed), "nominal": usual}

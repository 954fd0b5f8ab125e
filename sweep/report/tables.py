"""Export of rows as CSV, Markdown, LaTeX (booktabs) and Parquet."""

import io
import json
from collections.abc import Iterable, Iterator
from csv import writer
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
from pyarrow.csv import WriteOptions, write_csv

from sweep.analysis.stats import format_cause_counts, format_percent
from sweep.config.experiment import Experiment
from sweep.contract.system import split_side_prefix
from sweep.core.expressions import find_column
from sweep.report.labels import column_unit, path_label, split_metric_column, unique_headings, unique_labels
from sweep.runs.results import Results
from sweep.study.columns import LABEL_COLUMNS, metric_columns

LATEX_SIGNS = {"°": r"\textdegree{}", "·": r"$\cdot$", "⁴": r"\textsuperscript{4}", r"a\_r": "$a_r$"}
GROUP_ROWS = 2**16  # rows that a group of a Parquet file has at least, but for the last
SHARE_COLUMNS = ("share", "low", "high")  # of tables of rates; without a share, low and high are numbers of their own


def render_table(rows: pd.DataFrame, form: str, names: list[str] | None = None, exp: Experiment | None = None) -> bytes:
    """Format rows in one of the supported formats.

    Args:
        rows: rows of a study.
        form: `csv`, `markdown`, `latex` or `parquet`.
        names: columns to write. By default CSV and Parquet have all of them, the others those that a page has room for.
        exp: experiment of the study: it gives labels and units to Markdown and LaTeX.

    Raises:
        InputError: a name is no column.
    """
    rows = rows[choose_columns(rows, form, names)]
    match form:
        case "csv":
            return csv_bytes(rows)
        case "parquet":
            return b"".join(iter_parquet_bytes([rows], rows.iloc[:0]))
        case "latex":
            return latex_table(rows, exp).encode()
        case _:
            page = markdown_table(rows, exp) + "\n"
            lines = explain_axis_labels(rows, exp) if exp else []
            lines += (
                format_cause_counts(rows["cause"], exp.system.cause_meanings(exp.thresholds))
                if exp and "cause" in rows
                else []
            )
            legend = "".join(f"- {line}\n" for line in lines)
            return f"{page}\n{legend}".encode() if legend else page.encode()


def choose_columns(rows: pd.DataFrame, form: str, names: list[str] | None) -> list[str]:
    """Choose the columns of a table for a format.

    Args:
        rows: rows of a study.
        form: see `render_table`.
        names: columns that the user asks for; None for the usual ones.

    Raises:
        InputError: a name is no column.
    """
    if names:
        return list(dict.fromkeys(find_column(rows, name) for name in names))
    # a page has no room for more than these; csv and parquet hold everything
    return readable_table_columns(rows) if form in ("markdown", "latex") else list(rows.columns)


def csv_bytes(rows: pd.DataFrame, header: bool = True) -> bytes:
    """Format rows as CSV with quoted words, by Arrow, which is faster than pandas.

    Args:
        rows: a table.
        header: whether the first line has the names of columns.
    """
    content = io.BytesIO()
    if header:
        line = io.StringIO()
        writer(line, lineterminator="\n").writerow(rows.columns)
        content.write(line.getvalue().encode())
    write_csv(pa.Table.from_pandas(rows, preserve_index=False), content, WriteOptions(include_header=False))
    return content.getvalue()


def iter_parquet_bytes(parts: Iterable[pd.DataFrame], empty: pd.DataFrame) -> Iterator[bytes]:
    """Yield rows as the pieces of a Parquet file, in groups of about `GROUP_ROWS` rows to limit memory.

    Args:
        parts: The rows, in order.
        empty: A table without rows that has the columns of all parts, with their types and `attrs`.

    Yields:
        The bytes of the file, piece by piece.
    """
    schema = pa.Schema.from_pandas(empty, preserve_index=False)
    if empty.attrs:
        schema = schema.with_metadata({**schema.metadata, b"PANDAS_ATTRS": json.dumps(empty.attrs).encode()})
    sink = io.BytesIO()

    def take_bytes() -> bytes:
        piece = sink.getvalue()
        sink.seek(0)
        sink.truncate()
        return piece

    # without dictionaries of floats, most of which are distinct: the file is smaller, and written in half the time
    repeated: Any = [field.name for field in schema if not pa.types.is_floating(field.type)]
    with pq.ParquetWriter(pa.PythonFile(sink, "w"), schema, compression="zstd", use_dictionary=repeated) as file:
        for group in _join_small_parts(pa.Table.from_pandas(part, schema, preserve_index=False) for part in parts):
            file.write_table(group)
            yield take_bytes()
    yield take_bytes()


def _join_small_parts(parts: Iterable[pa.Table]) -> Iterator[pa.Table]:
    """Yield the rows of some tables in tables of at least `GROUP_ROWS` rows; the last may have fewer."""
    collected: list[pa.Table] = []
    for part in parts:
        collected.append(part)
        if sum(map(len, collected)) >= GROUP_ROWS:
            yield pa.concat_tables(collected)
            collected.clear()
    if collected:
        yield pa.concat_tables(collected)


def explain_axis_labels(rows: pd.DataFrame, exp: Experiment) -> list[str]:
    """Explain each axis whose label does not show its path: `grip (world): world.contact.friction`."""
    words = unique_labels(rows.columns, exp)
    return [f"{words[a.column]}: {a.parameter_column}" for a in exp.study.axes
            if a.parameter_column and a.column in rows
            and words[a.column] != path_label(a.parameter_column)]  # fmt: skip


def markdown_table(rows: pd.DataFrame, exp: Experiment | None = None) -> str:
    """Format rows as a Markdown table with readable headings and numbers.

    Args:
        rows: a table.
        exp: experiment of the study, if it is known: it names and measures the parameters.
    """
    return format_rows(rows, exp).to_markdown(index=False, disable_numparse=True)


def readable_table_columns(rows: pd.DataFrame) -> list[str]:
    """Return the columns that a readable table shows: parameters, the replicate if there are several, and outcome
    labels."""
    several = ["replicate"] if rows["replicate"].nunique() > 1 else []
    return [c for c in rows.columns if "." in c] + several + list(LABEL_COLUMNS)


def format_rows(rows: pd.DataFrame, exp: Experiment | None = None) -> pd.DataFrame:
    """Format rows with readable headings and numbers; shares and their intervals in per cent."""
    shares = [c for c in SHARE_COLUMNS if c in rows and "share" in rows]
    rows = rows.assign(**{c: [format_percent(v) if pd.notna(v) else "" for v in rows[c]] for c in shares})
    return rows.map(format_value).rename(columns=unique_headings(rows.columns, exp))


def format_value(value: object) -> str:
    """Format a number with four digits and separated thousands; a missing value is empty."""
    if isinstance(value, int | np.integer) and not isinstance(value, bool):
        return f"{value:,}"
    if isinstance(value, float | np.floating):
        return "" if pd.isna(value) else f"{value:.4g}"
    return "" if value is None or value is pd.NA else str(value)


def latex_table(rows: pd.DataFrame, exp: Experiment | None = None) -> str:
    """Format rows as a booktabs table with escaped headings and words."""
    style = format_rows(rows, exp).style.hide(axis="index")
    style = style.format(escape="latex").format_index(escape="latex", axis="columns")
    aligned = "".join("r" if rows[c].dtype.kind in "fi" else "l" for c in rows)
    return unit_signs_to_latex(style.to_latex(hrules=True, column_format=aligned))


def unit_signs_to_latex(escaped: str) -> str:
    """Replace signs in units of escaped text by pdfLaTeX commands."""
    for sign, word in LATEX_SIGNS.items():
        escaped = escaped.replace(sign, word)
    return escaped


def rollout_table(exp: Experiment, row: pd.Series) -> str:
    """Format outcome and metrics of one rollout as a Markdown table, with the reason for the outcome.

    Args:
        exp: experiment of the rollout.
        row: its row.
    """
    lines = [(exp.scenario, str(row["outcome"]), "")]
    if row["outcome"] != "success":
        lines.append(("cause", str(row["cause"]), f"in stage {row['stage']}"))
    for name in metric_columns(row.to_frame().T):
        if name in exp.system.bookkeeping_metrics:
            continue
        words, unit = split_metric_column(name)
        lines.append((words, format_value(row[name]), unit))
    table = pd.DataFrame(lines, columns=["figure", "value", "unit"])
    reason = exp.system.explain_cause({str(name): value for name, value in row.items()}, exp.thresholds)
    return table.to_markdown(index=False, disable_numparse=True) + "\n" + (reason and f"\n{reason}\n")


def varied_parameters(results: Results) -> Iterator[dict[str, Any]]:
    """Yield a dictionary for each varied parameter: label, path, side (world or belief), unit, values and nominal."""
    words = unique_labels(results.axes, results.exp)
    paths = {axis.column: axis.path or "" for axis in results.exp.study.axes}
    for name in results.axes:
        values = results.rows[name]
        side, path = split_side_prefix(name)
        path = paths.get(name, path)
        listed = np.sort(values.unique()) if values.dtype.kind in "fiub" else sorted(values.unique())
        few = len(listed) <= 6
        extent = (", " if few else " to ").join(map(format_value, listed if few else (listed[0], listed[-1])))
        own = not name.startswith("axis.")  # else a number that parameters are made from
        usual = format_value(results.exp.system.nominal_parameter_value(name, results.exp.settings)) if own else ""
        about = {"words": words[name], "path": path, "side": side, "unit": column_unit(name, results.exp)}
        yield {**about, "values": extent, "number": len(listed), "nominal": usual}

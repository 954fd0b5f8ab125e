"""Rows of a study as stored in a page: plain values, and all columns as one block of deflated bytes.

`data.js` reads the block: for each row its kind (success, or a cause) and its stage, a byte each, and the first digits
of its point id; then each column as whole numbers of two bytes, all the low bytes before all the high ones.
"""

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pandas as pd

from sweep.analysis import sensitivity
from sweep.analysis.sample import random_subset_indices
from sweep.contract.system import split_side_prefix
from sweep.core.distinct_values import has_several_values
from sweep.core.files import deflate_to_base64
from sweep.core.json_values import to_json_value
from sweep.report import analytic_curves
from sweep.report.figures import effects_figure, metric_thresholds, metrics_with_threshold_first
from sweep.report.headline import describe_setup
from sweep.report.labels import (
    explain_outcome_kind,
    hover_text,
    label_and_unit,
    outcome_kind,
    shorten_file_names,
    unique_labels,
)
from sweep.report.outcome_style import FAILURE_COLOUR, SUCCESS_COLOUR, find_style
from sweep.report.page.opening import DerivedColumn
from sweep.runs import refine
from sweep.runs.results import Results

MAX_ROWS, SAMPLE_SIZE = 40_000, 20_000  # with more rows than that the page has a sample of them, and maps of densities
MAX_METRICS = 28  # that are on the page, the ones that outcomes are judged by first
MAX_EXACT_VALUES = 1024  # a column with at most so many values has them to the last bit
COARSE_BITS, MAX_FINE_BYTES = (
    12,
    400_000,
)  # bits of a measured number, where all of them take more bytes than `MAX_FINE_BYTES`; else 15
MISSING_CODE = 2**16 - 1
MAX_RANGE_RATIO = 50.0  # a range that is so many times that of the middle half is stored by its inverse hyperbolic sine
DENSITY_BINS, MAX_DENSITY_PAIRS = 128, 3  # of densities along an axis, and how many pairs of parameters have one
POINT_ID_DIGITS = 12  # of a point id: bytes are two of them


def page_data(results: Results, chosen: tuple[str, ...] = (), derived: Sequence[DerivedColumn] = ()) -> dict[str, Any]:
    """Collect the data of the rows for the page's script.

    Args:
        results: study with its rows.
        chosen: columns that the map starts with.
        derived: further columns, which no command knows.

    Returns:
        Plain values, see `About` in `data.js`.
    """
    sampled = sample_row_indices(len(results.rows))
    rows = results.rows.iloc[sampled]
    kinds, axes = outcome_kinds_for_page(results), [*results.categorical_columns, *results.numeric_columns]
    figures = ["margin", "t_cause_s"] if "margin" in rows else []
    figures = [c for c in figures if has_several_values(rows[c])] + metrics_with_threshold_first(results)[:MAX_METRICS]
    bits = COARSE_BITS if len(rows) * len(figures) * 2 > MAX_FINE_BYTES else 15
    coded = [encode_column(rows[c], bits) for c in (*axes, *figures)]
    judged, words = metric_thresholds(results), unique_labels((*axes, *figures), results.exp)
    columns = [
        {
            "key": c,
            "label": words[c],
            "unit": label_and_unit(c, results.exp)[1],
            "path": hover_text(c, results.exp),
            "axis": c in axes,
            "drawn": c not in (*results.numeric_grid_columns, *results.categorical_columns),
            "diverges": c == "margin",
            "limit": judged.get(c),
            **about,
        }
        for c, (about, _) in zip((*axes, *figures), coded, strict=True)
    ]
    columns += [
        {"key": one.name, "label": one.name, "unit": "", "path": "", "axis": False, "drawn": True, "diverges": False}
        | {"limit": None, "derived": True, "names": one.names}
        for one in derived
    ]
    words_of_rows = [
        split_byte_planes(np.where(one.codes[sampled] < 0, MISSING_CODE, one.codes[sampled])) for one in derived
    ]
    # of a map: two listed numbers; elsewhere the script takes what matters most
    first = (
        results.numeric_grid_columns[:2]
        if len(results.numeric_grid_columns) > 1 and not results.is_one_at_a_time
        else []
    )
    stages = [*results.stages, *sorted(set(rows["stage"].astype(str)) - {*results.stages, ""})]
    kind = outcome_kind_indices(rows, kinds).astype(np.uint8)
    stage = 1 + pd.Index(stages).get_indexer(pd.Index(rows["stage"].astype(str)))  # 0: there is none
    ids = b"".join(bytes.fromhex(f"{one[:POINT_ID_DIGITS]:0<{POINT_ID_DIGITS}}") for one in rows["point_id"])
    blocks = [kind.tobytes(), stage.astype(np.uint8).tobytes(), ids, *(block for _, block in coded), *words_of_rows]
    return {
        "name": results.name,
        "folder": str(results.folder),
        "setup": describe_setup(results),
        "total": len(results.rows),
        "rows": len(rows),
        "kinds": kinds,
        "colours": {"success": SUCCESS_COLOUR, "failure": FAILURE_COLOUR},
        "stages": stages,
        "columns": columns,
        "digits": POINT_ID_DIGITS,
        "block": deflate_to_base64(b"".join(blocks)),
        "one_at_a_time": results.is_one_at_a_time,
        "start": [c for c in (*chosen, *first) if c in (*axes, *figures)][:2],
        "theory": list(limit_curves(results, rows)),
        "refined_cells": refined_cells(results) if len(rows) == len(results.rows) else None,
        "effects": total_effects_of_refined_map(results),
        "densities": list(count_rows_in_bins(results, kinds)) if len(rows) < len(results.rows) else [],
    }


def describe_sides(results: Results, sides: Mapping[str, pd.DataFrame], folders: Sequence[str]) -> dict[str, Any]:
    """Describe the outcomes of both rollouts of each pair, for the two maps of a page that compares studies.

    Args:
        results: rows of pairs, see `pairs.join_pairs`; its system names the causes.
        sides: outcome and cause of each pair's rollout, by the name of the side.
        folders: names of the studies.

    Returns:
        Plain values, see `SidesFormat` in `data.js`.
    """
    styles = outcome_kinds_for_page(replace(results, rows=pd.concat(sides.values(), ignore_index=True)))
    some = sample_row_indices(len(results.rows))
    kinds = [outcome_kind_indices(one.iloc[some], styles).astype(np.uint8) for one in sides.values()]
    counts = [one["outcome"].value_counts() for one in sides.values()]
    return {
        "styles": styles,
        "names": list(sides),
        "folders": list(folders),
        "counts": [
            {"success": int(one.get("success", 0)), "valid": int(one.sum() - one.get("invalid", 0))} for one in counts
        ],
        "block": deflate_to_base64(b"".join(one.tobytes() for one in kinds)),
    }


def sample_row_indices(number: int) -> np.ndarray:
    """Return the indices of the rows that a page stores: all, or a random sample if there are too many."""
    return random_subset_indices(number, SAMPLE_SIZE if number > MAX_ROWS else number)


def json_for_script_element(content: Any) -> str:
    """Format JSON for a script element, so that no text in it can end the element or begin a comment."""
    text = json.dumps(to_json_value(content), separators=(",", ":"), ensure_ascii=True, allow_nan=False)
    return text.replace("<", "\\u003c").replace(">", "\\u003e").replace("&", "\\u0026")


def outcome_kind_indices(rows: pd.DataFrame, kinds: list[dict[str, Any]]) -> np.ndarray:
    """Return the index of each row's outcome kind in `kinds`."""
    return pd.Index([one["key"] for one in kinds]).get_indexer(pd.Index(outcome_kind(rows)))


def outcome_kinds_for_page(results: Results) -> list[dict[str, Any]]:
    """Return the outcome kinds that occur in a study, each with its label, colour and shape on the page."""
    counts, system = outcome_kind(results.rows).value_counts(), results.exp.system
    known = [name for name in ("success", *system.cause_names) if name in counts]
    return [
        {
            "key": name,
            "label": name.replace("_", " ") or "no cause",
            "meaning": explain_outcome_kind(name, results.exp) if name in known else "",
            "count": int(counts[name]),
            "colour": find_style(name).colour,
            "shape": find_style(name).shape.round(3).ravel().tolist(),
            "outcome": "success" if name == "success" else "invalid" if name in system.invalid_causes else "failure",
        }
        for name in [*known, *sorted(set(counts.index) - set(known))]
    ]


def encode_column(values: pd.Series, bits: int) -> tuple[dict[str, Any], bytes]:
    """Encode a column as bytes; return a description of the format, and the bytes.

    Few values are listed, others are evenly spaced between two ends.
    """
    if values.dtype.kind not in "fiub":
        codes, levels = pd.factorize(values.astype(str), sort=True)
        return {"names": shorten_file_names([str(one) for one in levels])}, split_byte_planes(np.asarray(codes))
    numbers = values.to_numpy(dtype=float)
    finite = np.isfinite(numbers)
    levels, codes = np.unique(numbers[finite], return_inverse=True)
    whole = np.full(len(numbers), MISSING_CODE)
    if len(levels) <= MAX_EXACT_VALUES and (len(levels) < len(numbers) / 4 or len(numbers) <= MAX_EXACT_VALUES):
        whole[finite] = codes
        return {"levels": levels.tolist()}, split_byte_planes(whole)
    quarter, middle, most = np.percentile(numbers[finite], [25, 50, 75])
    bend = max(float(most - quarter), 1e-12) if np.ptp(levels) > MAX_RANGE_RATIO * (most - quarter) else 0.0
    shown = np.arcsinh((numbers - middle) / bend) if bend else numbers
    low, high = float(np.min(shown[finite])), float(np.max(shown[finite]))
    step = (high - low) / (2**bits - 1) or 1.0
    whole[finite] = np.round((shown[finite] - low) / step)
    return {"low": low, "step": step, "bend": bend, "middle": float(middle)}, split_byte_planes(whole)


def split_byte_planes(values: np.ndarray) -> bytes:
    """Split numbers from 0 to 65535 into bytes: all low bytes, then all high ones."""
    return values.astype("<u2").view(np.uint8).reshape(-1, 2).T.tobytes()


def limit_curves(results: Results, rows: pd.DataFrame) -> Any:
    """Yield the curves of limits that formulas (`study.theory`) predict for one parameter over another."""
    for theory in results.exp.study.theory:
        for of in [c for c in results.numeric_columns if split_side_prefix(c)[1] == theory.of]:
            for along in [c for c in results.numeric_columns if c != of]:
                found = analytic_curves.limit_curve(theory, results.exp, rows, along)
                yield {
                    "label": theory.label,
                    "of": of,
                    "along": along,
                    "at": found["along"].tolist(),
                    "limit": found["limit"].tolist(),
                }


def refined_cells(results: Results) -> dict[str, Any] | None:
    """Return the cells of a map that was refined over two parameters, by the rows at their four corners."""
    study = results.exp.study
    if not study.resolution:
        return None
    found, axes = [], ()
    rows = results.rows.reset_index(drop=True)
    for panel, (_, part) in zip(
        refine.summarize_panels(results.exp, rows), refine.iter_panels(study, rows), strict=True
    ):
        axes = panel.lattice.axes
        if len(axes) != 2:
            return None
        place = np.full(panel.lattice.shape, -1)
        place[panel.lattice.indices(part)] = part.index
        for power, cells in enumerate(panel.cells if panel.rollouts else ()):
            corners = [cells + 2**power * np.array(corner) for corner in ((0, 0), (1, 0), (0, 1), (1, 1))]
            found.append(np.stack([place[tuple(corner.T)] for corner in corners], axis=1))
    cells = np.concatenate(found) if found else np.zeros((0, 4), int)
    cells = cells[(cells >= 0).all(axis=1)]
    return {"axes": [axis.column for axis in axes], "block": deflate_to_base64(cells.astype("<i4").tobytes())}


def single_parameter_curves(results: Results) -> Iterator[dict[str, Any]]:
    """Yield the data of the success curve along each parameter that varies alone in a study.

    The success rate at each value has its interval where the study's rows are a sample. A study of which the page has
    only a sample of rows, or whose results decide where rollouts are placed, has no such parameters.
    """
    rows = results.rows.reset_index(drop=True)
    if results.exp.study.is_sequential or len(sample_row_indices(len(rows))) < len(rows):
        return
    if results.is_one_at_a_time:
        found = [
            (axis.column, centre, part) for axis, centre, part in sensitivity.one_at_a_time_rows(rows, results.exp)
        ]
    elif len(results.axes) == 1 and results.numeric_columns:
        found = [(column, nominal_column_value(results, column), rows) for column in results.numeric_columns]
    else:
        return
    figure = next(effects_figure(results), None)
    for column, nominal, part in found:
        if not has_several_values(part[column]):
            continue
        rates = figure.data[figure.data["axis"] == column].dropna(subset="low") if figure else pd.DataFrame()
        yield {
            "key": column,
            "nominal": nominal,
            "at": rates["value"].tolist() if len(rates) else [],
            "low": rates["low"].tolist() if len(rates) else [],
            "high": rates["high"].tolist() if len(rates) else [],
            "block": deflate_to_base64(part.index.to_numpy().astype("<i4").tobytes()),
        }


def nominal_column_value(results: Results, column: str) -> float | None:
    """Return the nominal value of a parameter's column; None for a number from which parameters are computed."""
    return (
        None
        if column.startswith("axis.")
        else float(results.exp.system.nominal_parameter_value(column, results.exp.settings))
    )


def total_effects_of_refined_map(results: Results) -> dict[str, float] | None:
    """Return the total Sobol indices, computed on the cells of a refined map, by column."""
    if not results.exp.study.resolution:
        return None
    table = refine.total_effects(results.exp, results.rows)
    return dict(zip(table["axis"], table["total"].tolist(), strict=True))


def count_rows_in_bins(results: Results, kinds: list[dict[str, Any]]) -> Any:
    """Yield, for a few pairs of parameters, the number of rows of each outcome kind in each bin."""
    kind = outcome_kind_indices(results.rows, kinds)
    pairs = [(x, y) for k, x in enumerate(results.numeric_columns) for y in results.numeric_columns[k + 1 :]][
        :MAX_DENSITY_PAIRS
    ]
    for x, y in pairs:
        (i, wide, x_ends), (j, high, y_ends) = bin_values(results.rows[x]), bin_values(results.rows[y])
        counts = np.bincount((kind * high + j) * wide + i, minlength=len(kinds) * high * wide)
        yield {
            "x": x,
            "y": y,
            "wide": wide,
            "high": high,
            "x_ends": x_ends,
            "y_ends": y_ends,
            "block": deflate_to_base64(counts.astype("<u4").view(np.uint8).reshape(-1, 4).T.tobytes()),
        }


def bin_values(values: pd.Series) -> tuple[np.ndarray, int, list[float]]:
    """Return the bin of each value, the number of bins, and their outer ends; few evenly spaced values get one bin
    each."""
    levels = np.unique(values)
    low, high = float(levels[0]), float(levels[-1])
    if len(levels) <= DENSITY_BINS and np.allclose(np.diff(levels), (high - low) / (len(levels) - 1)):
        half = (high - low) / (len(levels) - 1) / 2
        return np.searchsorted(levels, values), len(levels), [low - half, high + half]
    place = np.minimum((values.to_numpy(dtype=float) - low) / (high - low) * DENSITY_BINS, DENSITY_BINS - 1).astype(int)
    return place, DENSITY_BINS, [low, high]

"""`sweep report`: a study as one HTML page without external files, for the screen and for paper."""

import base64
import io
import itertools
import re
from collections.abc import Iterable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Any

import matplotlib as mpl
import pandas as pd
import yaml
from markupsafe import Markup
from matplotlib.figure import Figure
from PIL import Image

from sweep.analysis.expectations import judge_expectations
from sweep.analysis.sample import pooled_success_rate
from sweep.analysis.sampling_units import has_independent_rows, independent_unit, interval_method
from sweep.config.experiment import Experiment
from sweep.core.files import path_inside_folder, read_bytes_limited, write_atomically
from sweep.core.outcomes import SUCCESS
from sweep.core.plot_style import LEG_COLORS, plot_style
from sweep.core.progress import LiveProgress
from sweep.replay.arrows import FORCE_SCALE, FORCE_SHOWN
from sweep.report import tables
from sweep.report.figure import StudyFigure
from sweep.report.figures import list_figures
from sweep.report.headline import study_headline
from sweep.report.labels import hover_text, label_with_unit, outcome_kind
from sweep.report.page import data, opening
from sweep.report.page.replay_data import ShownReplay, describe_replays, read_shown_replays
from sweep.report.page.script import bundle_script, content_security_policy, load_page_template, style_sheet
from sweep.report.representative import Representative, find_representatives
from sweep.report.statistics import labelled_sections
from sweep.runs import audit, store
from sweep.runs.results import Results
from sweep.runs.unsearched_values import describe_values_outside_tuned_range
from sweep.study.columns import LABEL_COLUMNS

MAX_TABLE_ROWS, MAX_LINES = 100, 100  # of the table at the end, and of the others
WEBP_QUALITY, MAX_PICTURE_PIXELS = 75, 10_000_000  # of pictures of rollouts
DPI = 140  # of pictures that are for paper alone
MAX_PAGE_CHARACTERS, RESERVED_CHARACTERS = (
    5_000_000,
    700_000,
)  # characters of a page, and of what is neither picture, row nor state
OPENING_FIGURES = ("push_map", "engines")
TELLING = (
    "distance_m",
    "slip_max_m",
    "tilt_max_deg",
    "leg_gap_min_m",
    "clearance_min_m",
    "stability_margin_min_m",
    "torque_peak_beta_nm",
    "t_cause_s",
)


@dataclass(frozen=True)
class PageFigure:
    """A study figure in the form that the HTML page shows."""

    key: str
    title: str
    caption: str
    picture: Markup
    live: bool  # the script shows the same
    opens: bool  # the page opens with it, because it answers the study's question and no view of the script does


def write_page(results: Results, path: Path, **options: Any) -> Path:
    """Write the HTML page of a study to a file.

    Args:
        results: study with its rows.
        path: file to write.
        options: see `render_page`.

    Returns:
        `path`.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    write_atomically(path, render_page(results, **options).encode())
    return path


@dataclass(frozen=True)
class ComparisonPageContent:
    """Headline, figures and tables of a page that compares two studies."""

    name: str
    headline: str
    origin: str  # sentence that names the studies
    figures: list[StudyFigure]
    tables: list[tuple[str, pd.DataFrame]]
    sides: dict[str, pd.DataFrame]  # outcome and cause of each pair's rollout, by the name of the side
    folders: tuple[str, ...]  # names of the studies


def render_page(
    results: Results,
    shown: list[ShownReplay] | None = None,
    chosen: tuple[str, ...] = (),
    opened: int = 0,
    pairs: ComparisonPageContent | None = None,
    live: LiveProgress | None = None,
) -> str:
    """Render the page of a study as HTML.

    Args:
        results: study with its rows; on a page of pairs a row is a pair, and its cause what became of both.
        shown: replays to embed; by default those that the folder has.
        chosen: columns that the map starts with.
        opened: how many of the first replays play when the page opens, at most two.
        pairs: content of a page that compares two studies.
        live: progress of the run that adds rows, if there is one.
    """
    rows = results.rows
    style, script = style_sheet(), bundle_script()
    plates = [make_page_figure(one) for one in (pairs.figures if pairs else list_figures(results))]
    typicals = [
        (one, representative_picture_url(one), list(representative_values(one, results.exp)))
        for one in (() if pairs else find_representatives(results))
    ]
    rate = pooled_success_rate(rows, results.exp)
    # the script's own intervals and tests take every row as independent
    independent = not pairs and has_independent_rows(rows, results.exp)
    estimate = None if pairs else opening.describe_estimate(results)
    region = None if pairs else opening.describe_region(results)
    start = chosen or (tuple(region[0]["start"]) if region else ())
    about = data.page_data(results, start, [found[1] for found in (estimate, region) if found]) | {
        "sure": rate.has_interval and independent,
        "independent": independent,
        "adaptive": results.exp.study.is_adaptive and not pairs,
        "curves": [] if pairs else list(data.single_parameter_curves(results)),
        "sides": data.describe_sides(results, pairs.sides, pairs.folders) if pairs else None,
        "estimate": estimate[0] if estimate else None,
        "region": region[0] if region else None,
    }
    if pairs:
        about["kinds"] = [one | ({"label": "both succeed"} if one["key"] == SUCCESS else {}) for one in about["kinds"]]
    others = [
        style,
        script,
        data.json_for_script_element(about),
        *(one.picture for one in plates),
        *(picture for _, picture, _ in typicals),
    ]
    room = MAX_PAGE_CHARACTERS - RESERVED_CHARACTERS - sum(map(len, others))
    replays = describe_replays(results, read_shown_replays(results) if shown is None else shown, room)
    arrow = {"metres": FORCE_SCALE, "least": FORCE_SHOWN}
    about |= {"replays": replays.descriptions, "models": replays.models, "left_out": replays.omitted_count}
    about |= {"arrow": arrow, "open": opened, "legs": list(LEG_COLORS)}
    about["reload_s"] = live.reload_s if live else 0
    return load_page_template("page.html.j2").render(
        results=results,
        policy=content_security_policy(style, script),
        style=Markup(style),
        script=Markup(script),
        data=Markup(data.json_for_script_element(about | ({"name": pairs.name} if pairs else {}))),
        streams=Markup("\n".join(replays.streams)),
        rate=rate,
        live=live.text if live else "",
        adaptive=results.exp.study.is_adaptive and not pairs,
        headline=study_headline(rows, results.exp) if results.exp.study.is_adaptive else "",
        sure=rate.has_interval,
        independent=independent,
        unit=independent_unit(results.exp.study).name,
        refined_effects=bool(about["effects"]),
        method=interval_method(results.exp.study),
        came=str(outcome_kind(rows).iloc[0]).replace("_", " ") if len(rows) else "",
        watched=[
            (one.title, one.row["cause"] or one.row["outcome"]) for one in shown or () if results.exp.study.single
        ],
        repeated=results.exp.study.replicates > 1,
        curves=about["curves"],
        estimate=about["estimate"],
        region=about["region"],
        plates=plates,
        expectations=[] if pairs else list(expectation_results(results)),
        parameters=list(tables.varied_parameters(results)),
        unsearched=[] if pairs else describe_values_outside_tuned_range(results.exp, rows),
        reasons=[
            (cause, words, int((rows["cause"] == cause).sum())) for cause, words in results.occurring_causes.items()
        ],
        typical=typicals,
        statistics=list(statistics_as_html(pairs.tables if pairs else labelled_sections(results), results.exp)),
        audit=[] if pairs else list(audit.outcome_flip_table(results).itertuples(index=False)),
        pairs=pairs,
        name=pairs.name if pairs else results.name,
        table=first_rows_table(rows.head(MAX_TABLE_ROWS), results.exp),
        configuration=yaml.safe_dump(results.stored["config"], sort_keys=False, allow_unicode=True),
        dates=run_dates(results.folder),
    )


def make_page_figure(figure: StudyFigure) -> PageFigure:
    """Convert a study figure for the page; an image is drawn for print only if the page's script draws it on screen."""
    live = figure.key.startswith("map-") or figure.key in ("draws", "causes", "distributions")
    with plot_style():
        return PageFigure(
            figure.key,
            figure.title,
            figure.caption,
            (png_element if live else svg_element)(figure.draw(), figure.title),
            live,
            figure.key in OPENING_FIGURES,
        )


def expectation_results(results: Results) -> Iterator[tuple[str, str]]:
    """Yield each expectation of the study with `met` or the actual result."""
    expectations = results.exp.study.expect
    for one, line in zip(expectations, judge_expectations(expectations, results.rows, results.exp), strict=True):
        where = f" where {one.where}" if one.where else ""
        yield f"{one.that}{where}: a share from {one.at_least:g} to {one.at_most:g}", line or "met"


def statistics_as_html(
    sections: Iterable[tuple[str, pd.DataFrame | str]], exp: Experiment
) -> Iterator[tuple[str, Markup]]:
    """Yield the titles and contents of statistics as HTML."""
    for title, content in sections:
        if isinstance(content, str):
            yield title, Markup("<p>{}</p>").format(content)
        else:
            note = (
                f"<p class='soft'>The first {MAX_LINES} of {len(content)} lines.</p>"
                if len(content) > MAX_LINES
                else ""
            )
            yield title, Markup(note) + table_as_html(tables.format_rows(content.head(MAX_LINES), exp), index=False)


def representative_values(representative: Representative, exp: Experiment) -> Iterator[tuple[str, str]]:
    """Yield label and value of the parameters and of a few metrics of a representative rollout."""
    names = [*(c for c in representative.row.index if "." in c), *(c for c in TELLING if c in representative.row)]
    for name in names:
        if shown := tables.format_value(representative.row[name]):
            yield label_with_unit(name, exp), shown


def representative_picture_url(representative: Representative) -> str:
    """Return the data URL of a representative rollout's picture; empty if there is none."""
    return picture_url(read_bytes_limited(representative.picture)) if representative.picture.exists() else ""


def picture_url(png: bytes) -> str:
    """Return the data URL of a stored picture as WebP, a third of the PNG; as PNG if it cannot be read."""
    small = io.BytesIO()
    try:
        with Image.open(io.BytesIO(png), formats=["PNG"]) as picture:
            if picture.width * picture.height > MAX_PICTURE_PIXELS:  # of a stranger's folder
                return data_url(png)
            picture.convert("RGB").save(small, "webp", quality=WEBP_QUALITY)
    except (OSError, ValueError, SyntaxError):  # Pillow raises the last for damaged PNG files
        return data_url(png)
    return data_url(small.getvalue(), "webp")


def first_rows_table(rows: pd.DataFrame, exp: Experiment) -> Markup:
    """Return the first rows of the study as an HTML table: identity and outcome first, then parameters."""
    axes = [c for c in tables.readable_table_columns(rows) if c not in LABEL_COLUMNS]
    columns = ["point_id", *LABEL_COLUMNS, *axes]
    return table_as_html(
        tables.format_rows(rows[columns], exp), index=True, hints=[hover_text(c, exp) for c in columns]
    )


def table_as_html(shown: pd.DataFrame, index: bool, hints: Iterable[str] = ()) -> Markup:
    """Format a table as HTML.

    Args:
        shown: words, see `tables.shown`.
        index: whether the index is a column of its own.
        hints: what the head of each column shows on hover; empty for nothing.
    """
    text = shown.to_html(index=index, border=0, escape=True, classes="rows")
    head, end, body = text.partition("</thead>")
    hints = iter([*[""] * index, *hints])
    head = re.sub(
        "<th>", lambda _: Markup('<th title="{}">').format(hint) if (hint := next(hints, "")) else "<th>", head
    )
    return Markup(head + end + body)


def run_dates(folder: Path) -> tuple[str, str]:
    """Return first and last time stamp in a study's log; empty without a log."""
    stamps = []
    with suppress(OSError):
        for line in (
            read_bytes_limited(path_inside_folder(folder, store.LOG_FILE)).decode(errors="replace").splitlines()
        ):
            with suppress(ValueError):  # of a line that begins with none
                datetime.fromisoformat(stamp := line.partition(" ")[0])
                stamps.append(stamp)
    return (stamps[0], stamps[-1]) if stamps else ("", "")


def png_element(figure: Figure, title: str) -> Markup:
    """Convert a figure to an image element with few colours."""
    content, small = io.BytesIO(), io.BytesIO()
    figure.savefig(content, format="png", dpi=DPI)
    Image.open(content).convert("RGB").quantize(64).save(small, "png", optimize=True)
    return Markup('<img src="{}" alt="{}">').format(data_url(small.getvalue()), title)


def data_url(picture: bytes, form: str = "png") -> str:
    """Return the data URL of a picture."""
    return f"data:image/{form};base64,{base64.b64encode(picture).decode()}"


_numbers = itertools.count()


def svg_element(figure: Figure, title: str) -> Markup:
    """Convert a figure to an SVG element with searchable text and unique identifiers."""
    content = io.StringIO()
    own = f"f{next(_numbers)}"
    with mpl.rc_context({"svg.hashsalt": own, "svg.fonttype": "none"}):
        figure.savefig(content, format="svg", metadata={"Date": None, "Creator": None})
    text = content.getvalue()
    text = text[text.index("<svg") :]
    text = re.sub(r"<metadata>.*?</metadata>|<style.*?</style>", "", text, flags=re.DOTALL)  # the page has these
    text = re.sub(r'<g id="[^"]*"', "<g", text)  # names of groups, which repeat; what is referred to has other ones
    label = str(Markup.escape(title))
    return Markup(text.replace("<svg", f'<svg role="img" aria-label="{label}"', 1))

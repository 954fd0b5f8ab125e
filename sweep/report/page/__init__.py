"""`sweep report`: a study as one HTML page that needs nothing beside it, on a screen or on paper."""

import base64
import io
import itertools
import re
from collections.abc import Iterable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from datetime import datetime
from importlib.resources import files
from pathlib import Path
from typing import Any

import jinja2
import matplotlib as mpl
import pandas as pd
import yaml
from markupsafe import Markup
from matplotlib.figure import Figure
from PIL import Image

from sweep.analysis.sample import pooled
from sweep.analysis.stats import broken
from sweep.core.files import path_in, write_atomically
from sweep.core.plot_style import plot_style
from sweep.report import tables
from sweep.report.exhibit import Exhibit
from sweep.report.exhibits import exhibits
from sweep.report.headline import headline
from sweep.report.labels import column_meaning, heading, kind_of
from sweep.report.page import data
from sweep.report.page.script import bundle, policy, style_sheet
from sweep.report.page.stage import Shown, replays_of, stage_directions
from sweep.report.statistics import in_words
from sweep.report.typical import Typical, typical
from sweep.runs import audit, store
from sweep.runs.results import Results
from sweep.study.columns import LABELS
from sweep.study.config import Experiment
from sweep.trace.arrows import FORCE_SCALE, FORCE_SHOWN
from sweep.trace.layout import LEG_COLORS

ROWS, LINES = 100, 100  # of the table at the end, and of the others
DPI = 140  # of pictures that are for paper alone
SIZE, REST = 5_000_000, 700_000  # characters of a page, and of what is neither picture, row nor state
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
class Plate:
    """An exhibit as the page shows it."""

    key: str
    title: str
    caption: str
    picture: Markup
    live: bool  # the script shows the same


def write(results: Results, path: Path, **options: Any) -> Path:
    """Write the page of `results`, with the options of `render`."""
    path.parent.mkdir(parents=True, exist_ok=True)
    write_atomically(path, render(results, **options).encode())
    return path


@dataclass(frozen=True)
class Pairs:
    """What a page of the same points in two studies has in place of what it has of one."""

    name: str
    headline: str
    exhibits: list[Exhibit]
    tables: list[tuple[str, pd.DataFrame]]


def render(
    results: Results,
    shown: list[Shown] | None = None,
    chosen: tuple[str, ...] = (),
    opened: int = 0,
    pairs: Pairs | None = None,
) -> str:
    """The page as HTML, whose map starts with the columns `chosen`.

    It has the replays `shown`, the first `opened` of which, at most two, play from the start, or else those that the
    folder keeps. Of `pairs` a row of `results` is one, and its cause what came of both.
    """
    environment = jinja2.Environment(
        autoescape=True, undefined=jinja2.StrictUndefined, trim_blocks=True, lstrip_blocks=True
    )
    template = environment.from_string((files("sweep.report.page") / "page.html.j2").read_text(encoding="utf-8"))
    rows = results.rows
    style, script = style_sheet(), bundle()
    plates = [plate(one) for one in (pairs.exhibits if pairs else exhibits(results))]
    typicals = [(one, image(one), list(telling(one, results.exp))) for one in (() if pairs else typical(results))]
    rate = pooled(rows, results.exp)
    about = data.data(results, chosen) | {"sure": rate.sure, "adaptive": results.exp.study.is_adaptive and not pairs}
    others = [
        style,
        script,
        data.as_json(about),
        *(one.picture for one in plates),
        *(picture for _, picture, _ in typicals),
    ]
    room = SIZE - REST - sum(map(len, others))
    replays = stage_directions(results, replays_of(results) if shown is None else shown, room)
    arrow = {"metres": FORCE_SCALE, "least": FORCE_SHOWN}
    about |= {"replays": replays.about, "models": replays.models, "left_out": replays.left_out}
    about |= {"arrow": arrow, "open": opened, "legs": list(LEG_COLORS)}
    return template.render(
        results=results,
        policy=policy(style, script),
        style=Markup(style),
        script=Markup(script),
        data=Markup(data.as_json(about | ({"name": pairs.name} if pairs else {}))),
        streams=Markup("\n".join(replays.streams)),
        rate=rate,
        adaptive=results.exp.study.is_adaptive and not pairs,
        headline=headline(rows, results.exp) if results.exp.study.is_adaptive else "",
        sure=rate.sure,
        came=str(kind_of(rows).iloc[0]).replace("_", " ") if len(rows) else "",
        watched=[
            (one.title, one.row["cause"] or one.row["outcome"]) for one in shown or () if results.exp.study.single
        ],
        repeated=results.exp.study.replicates > 1,
        plates=plates,
        expectations=[] if pairs else list(expectations(results)),
        parameters=list(tables.parameters(results)),
        reasons=[(cause, words, int((rows["cause"] == cause).sum())) for cause, words in results.causes_seen.items()],
        typical=typicals,
        statistics=list(titled(pairs.tables if pairs else in_words(results), results.exp)),
        audit=[] if pairs else list(audit.table(results).itertuples(index=False)),
        pairs=pairs,
        name=pairs.name if pairs else results.name,
        table=table(rows.head(ROWS), results.exp),
        configuration=yaml.safe_dump(results.stored["config"], sort_keys=False, allow_unicode=True),
        dates=dates(results.folder),
    )


def plate(one: Exhibit) -> Plate:
    """A figure as the page has it: pixels where the script shows the same, and only paper needs it."""
    live = one.key.startswith("map-") or one.key in ("draws", "causes", "distributions")
    with plot_style():
        return Plate(one.key, one.title, one.caption, (png if live else svg)(one.draw(), one.title), live)


def expectations(results: Results) -> Iterator[tuple[str, str]]:
    """What the study expects of its rows, and whether they keep it."""
    for one in results.exp.study.expect:
        where = f" where {one.where}" if one.where else ""
        lines = broken((one,), results.rows)
        yield f"{one.that}{where}: a share from {one.at_least:g} to {one.at_most:g}", lines[0] if lines else "met"


def titled(sections: Iterable[tuple[str, pd.DataFrame | str]], exp: Experiment) -> Iterator[tuple[str, Markup]]:
    """Titled tables of what the rows say: margins, tolerance to errors, sensitivity, as far as the design can tell."""
    for title, content in sections:
        if isinstance(content, str):
            yield title, Markup("<p>{}</p>").format(content)
        else:
            note = f"<p class='soft'>The first {LINES} of {len(content)} lines.</p>" if len(content) > LINES else ""
            yield title, Markup(note) + as_html(tables.shown(content.head(LINES), exp), index=False)


def telling(one: Typical, exp: Experiment) -> Iterator[tuple[str, str]]:
    """Parameters and a few figures of a typical rollout."""
    names = [*(c for c in one.row.index if "." in c), *(c for c in TELLING if c in one.row)]
    for name in names:
        if shown := tables.text(one.row[name]):
            yield heading(name, exp), shown


def image(one: Typical) -> str:
    """Its picture as a data URL; empty where there is none."""
    return address(one.picture.read_bytes()) if one.picture.exists() else ""


def table(rows: pd.DataFrame, exp: Experiment) -> Markup:
    """The first rows: what identifies them, what came of them, then their axes, which paper may be too narrow for."""
    axes = [c for c in tables.reading(rows) if c not in LABELS]
    columns = ["point_id", *LABELS, *axes]
    return as_html(tables.shown(rows[columns], exp), index=True, hints=[column_meaning(c, exp) for c in columns])


def as_html(shown: pd.DataFrame, index: bool, hints: Iterable[str] = ()) -> Markup:
    """A table as HTML.

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


def dates(folder: Path) -> tuple[str, str]:
    """First and last day and time of the log, which may be damaged; empty without one."""
    stamps = []
    with suppress(OSError):
        for line in path_in(folder, store.LOG).read_text(encoding="utf-8", errors="replace").splitlines():
            with suppress(ValueError):  # of a line that begins with none
                datetime.fromisoformat(stamp := line.partition(" ")[0])
                stamps.append(stamp)
    return (stamps[0], stamps[-1]) if stamps else ("", "")


def png(figure: Figure, title: str) -> Markup:
    """The figure as an image element, in few colours."""
    content, small = io.BytesIO(), io.BytesIO()
    figure.savefig(content, format="png", dpi=DPI)
    Image.open(content).convert("RGB").quantize(64).save(small, "png", optimize=True)
    return Markup('<img src="{}" alt="{}">').format(address(small.getvalue()), title)


def address(picture: bytes) -> str:
    """A PNG picture as a data URL."""
    return f"data:image/png;base64,{base64.b64encode(picture).decode()}"


_numbers = itertools.count()


def svg(figure: Figure, title: str) -> Markup:
    """The figure as an SVG element with text that can be searched, its identifiers unlike those of other figures."""
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

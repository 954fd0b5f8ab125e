"""Export of a study for a paper: LaTeX tables, figures with their data, and a macro for every number."""

import re
import sys
import unicodedata
from collections.abc import Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import partial
from importlib.resources import files
from pathlib import Path

import jinja2
import numpy as np
import pandas as pd

from sweep.analysis import rare
from sweep.analysis.sample import is_random_sample, pooled_success_rate
from sweep.analysis.sampling_units import interval_method
from sweep.core.errors import InputError
from sweep.core.expressions import condition_mask
from sweep.core.files import write_atomically
from sweep.core.plot_style import plot_style
from sweep.report import cells, statistics, tables
from sweep.report.figures import list_figures
from sweep.report.headline import describe_setup
from sweep.report.labels import label_with_unit
from sweep.runs import audit
from sweep.runs.results import Results
from sweep.study.columns import metric_columns
from sweep.study.design_kinds.base import FailureEstimate

MAX_TABLE_LINES = 40  # of a table; longer ones are data only
MAX_CSV_ROWS = 5_000  # more rows than this are kept as parquet
MAX_NAMED_ROWS = 3  # a number that comes from so few rows names them
# what LaTeX knows in UTF-8: Latin letters, what T2A has of Cyrillic ones, and some signs
LATIN, CYRILLIC, PUNCTUATION = 0x17F, "".join(map(chr, range(0x400, 0x460))), "–—‘’“”…€"
# what LuaLaTeX and XeLaTeX take letters from that are not in their own fonts, the first that is there: a whole paper,
# where it has letters of these alphabets, and letters of other scripts alone
ALPHABETS = ("LATIN", "GREEK", "CYRILLIC")
ALPHABET_FONTS = ("CMU Serif", "FreeSerif", "DejaVu Serif")
OTHER_FONTS = ("Noto Serif CJK SC", "Source Han Serif SC", "FandolSong", "WenQuanYi Zen Hei", "WenQuanYi Micro Hei")
DIGIT_WORDS = ("Zero", "One", "Two", "Three", "Four", "Five", "Six", "Seven", "Eight", "Nine")


@dataclass(frozen=True)
class QuotableNumber:
    """A number that a paper may quote, with the rows from which it is computed."""

    name: str  # of its macro
    value: float
    text: str  # as quoted, in LaTeX
    what: str  # what it says of the rows
    where: str | None  # which rows; None: all


def write_paper(results: Results, out: Path, serif: bool = False) -> list[Path]:
    """Write main.tex, numbers.tex, tables and figures, and the data of all of them.

    A line on the standard error names letters of the study's name that pdfLaTeX lacks.

    Args:
        results: study with its rows.
        out: folder; files of an earlier export are replaced.
        serif: whether figures use a font with serifs.

    Returns:
        The files that were written.

    Raises:
        InputError: `out` holds files of someone else.
    """
    shown, summed = list(list_figures(results)), list(summary_tables(results))
    keys, names = [one.key for one in shown], [name for name, *_ in summed]
    own = {"figures": keys, "data": [*keys, *names, "rows", "numbers"], "tables": names}
    _refuse_foreign_files(out, own)
    for folder in own:
        (out / folder).mkdir(parents=True, exist_ok=True)
    paths = [_rows(results, out)]
    for one in shown:
        paths += [out / "data" / f"{one.key}.csv", out / "figures" / f"{one.key}.pdf"]
        write_atomically(paths[-2], one.data.to_csv(index=False).encode())
        with plot_style(serif):
            write_atomically(paths[-1], partial(one.draw().savefig, metadata={"CreationDate": None}))
    texts, captions = {}, {}
    for name, caption, table in summed:
        paths.append(out / "data" / f"{name}.csv")
        write_atomically(paths[-1], table.to_csv(index=False).encode())
        if len(table) <= MAX_TABLE_LINES:
            texts[f"tables/{name}.tex"], captions[name] = tables.latex_table(table, results.exp), caption
    found = rare.estimate_failure_probability(results.rows, results.exp) if results.exp.study.is_adaptive else None
    numbers = list(quotable_numbers(results, found))
    table = pd.DataFrame([vars(one) for one in numbers])
    write_atomically(out / "data" / "numbers.csv", table.to_csv(index=False).encode())
    texts["numbers.tex"] = "".join(macro_definition(results, one, paths[0].name) for one in numbers)
    every = "".join([results.name, *texts.values(), *captions.values(), *(one.title + one.caption for one in shown)])
    every += describe_setup(results)
    cyrillic, unknown, others = find_non_latin_letters(every)
    if unknown:
        font, package = (OTHER_FONTS[0], "noto-cjk") if others else (ALPHABET_FONTS[1], "freefont-otf")
        letters = f"pdflatex cannot print {''.join(unknown)}"
        print(
            f"sweep: {letters}: use lualatex or xelatex with a font such as {font} (Debian: fonts-{package})",
            file=sys.stderr,
        )
    texts["main.tex"] = _template().render(
        cyrillic=hexadecimal_code_points(cyrillic),
        unknown=hexadecimal_code_points(unknown),
        others=others,
        alphabet_fonts=ALPHABET_FONTS if cyrillic or len(others) < len(unknown) else (),
        other_fonts=OTHER_FONTS if others else (),
        results=results,
        prefix=macro_prefix(results),
        figures=shown,
        study=describe_setup(results),
        escape=escape_latex,
        tables=captions,
        sample=is_random_sample(results.rows, results.exp),
        method=escape_latex(interval_method(results.exp.study)),
        beside=sampling_caveat(results, found),
        adaptive=found is not None,
    )
    for name, text in texts.items():
        write_atomically(out / name, text.encode())
    return [*paths, out / "data" / "numbers.csv", *(out / name for name in texts)]


def _refuse_foreign_files(out: Path, expected: Mapping[str, Collection[str]]) -> None:
    """Raise `InputError` if `out` has a main.tex that no export wrote, or unknown files in its folders.

    Of a folder's own files the names are without endings: a study's rows are in another form once they are many.
    """
    first, *_ = _source().encode().splitlines()
    others = [path for path in [out / "main.tex"] if path.is_file() and not path.read_bytes().startswith(first)]
    for folder, names in expected.items():
        others += sorted(path for path in (out / folder).glob("[!.]*") if path.stem not in names)
    if others:
        held = others[0].relative_to(out)
        raise InputError(f"--paper = {out} holds {held}, no part of this paper: give a new folder, or an empty one")


def _rows(results: Results, out: Path) -> Path:
    """All rows, from which the numbers can be recomputed."""
    if len(results.rows) > MAX_CSV_ROWS:
        path = out / "data" / "rows.parquet"
        write_atomically(path, partial(results.rows.to_parquet, index=False, compression="zstd"))
    else:
        path = out / "data" / "rows.csv"
        write_atomically(path, tables.csv_bytes(results.rows))
    return path


def summary_tables(results: Results) -> Iterator[tuple[str, str, pd.DataFrame]]:
    """Yield name, caption and content of each table: parameters, outcomes, and the statistics of the page."""
    rows = results.rows
    if varied := list(tables.varied_parameters(results)):
        columns = ["words", "side", "values", "number", "unit", "nominal"]
        yield "parameters", "What was varied.", pd.DataFrame(varied)[columns].rename(columns={"words": "varied"})
    parts = [("all", rows)]
    for column in results.categorical_columns:
        parts += [(f"{label_with_unit(column, results.exp)} {value}", part) for value, part in rows.groupby(column)]
    lines = []
    for name, part in parts:
        one = pooled_success_rate(part, results.exp)
        shares = ("" if np.isnan(v) else f"{100 * v:.1f}" for v in (one.share, one.low, one.high))
        lines.append((name, one.total, one.invalid, one.successes, *shares))
    method = interval_method(results.exp.study)
    success = pd.DataFrame(lines, columns=["rollouts", "number", "invalid", "succeed", "%", "from", "to"])
    if results.exp.study.is_adaptive:
        yield "success", "Rollouts that the search placed. Their shares do not estimate rates.", success.iloc[:, :4]
    elif (success["from"] == "").all():
        yield "success", "How often rollouts succeed.", success.drop(columns=["from", "to"])
    else:
        yield (
            "success",
            f"How often rollouts succeed, with 95\\,\\% intervals where points were sampled ({method}).",
            success,
        )
    if results.occurring_causes:
        counts = [
            (c.replace("_", " "), words, int((rows["cause"] == c).sum()))
            for c, words in results.occurring_causes.items()
        ]
        table = pd.DataFrame(counts, columns=["cause", "what it means", "rollouts"])
        yield "not-successful", "Rollouts that did not succeed.", table
    if len(again := audit.outcome_flip_table(results)):
        yield (
            "audited",
            r"Rollouts next to the boundary and successes elsewhere, simulated again, with exact 95\,\% intervals.",
            again,
        )
    for number, (title, content) in enumerate(statistics.labelled_sections(results), 1):
        if isinstance(content, pd.DataFrame):
            yield f"statistics-{number}", escape_latex(title) + ".", content


def quotable_numbers(results: Results, failure: FailureEstimate | None) -> Iterator[QuotableNumber]:
    """Yield every number of the text, and those that a paper about the study is likely to quote.

    Args:
        results: study with its rows.
        failure: estimated probability of failure, of a study that searches for failures; None for others.
    """
    rows, start = results.rows, macro_prefix(results)
    one, valid = pooled_success_rate(rows, results.exp), 'outcome != "invalid"'
    for name, count, where in (
        ("Rollouts", one.total, None),
        ("Valid", one.valid_count, valid),
        ("Success", one.successes, 'outcome == "success"'),
        ("Invalid", one.invalid, 'outcome == "invalid"'),
    ):
        yield QuotableNumber(start + name, count, str(count), "number of rows", where)
    share = 'share of outcome == "success"'
    if failure is None:
        yield _percent(start + "Rate", one.share, share, valid)
    if not np.isnan(one.low):
        interval = f"end of the 95 % interval ({interval_method(results.exp.study)}) of the {share}"
        yield _percent(start + "RateLow", one.low, f"lower {interval}", valid)
        yield _percent(start + "RateHigh", one.high, f"upper {interval}", valid)
    if failure is None:
        yield _percent(start + "InvalidRate", one.invalid_share, 'share of outcome == "invalid"', None)
    else:
        for name, value in zip(("", "Low", "High"), (failure.probability, *failure.interval), strict=True):
            what = f"probability of failure{f', its {name.lower()} 95 % end' if name else ''}, sampling corrected"
            shown = "--" if np.isnan(value) else cells.format_number(value, 2)
            yield QuotableNumber(f"{start}Failing{name}", value, shown, what, None)
    for cause in results.occurring_causes:
        where = f'cause == "{cause}"'
        count = int((rows["cause"] == cause).sum())
        yield QuotableNumber(start + macro_name("cause_" + cause), count, str(count), "number of rows", where)
    for axis in results.numeric_columns:
        name = start + macro_name(axis.removesuffix(".name"))
        for word, value in (("Min", rows[axis].min()), ("Max", rows[axis].max())):
            yield QuotableNumber(name + word, float(value), f"{value:.4g}", f"{word.lower()} of {axis}", None)
    won = rows[rows["outcome"] == "success"]
    for figure in metric_columns(rows):
        if figure in results.exp.system.bookkeeping_metrics or won.empty or won[figure].dtype.kind != "f":
            continue
        for word, value in (("Median", won[figure].median()), ("Min", won[figure].min()), ("Max", won[figure].max())):
            what = f"{word.lower()} of {figure}"
            yield QuotableNumber(
                start + macro_name(figure) + word, float(value), f"{value:.4g}", what, 'outcome == "success"'
            )


def sampling_caveat(results: Results, failure: FailureEstimate | None) -> str:
    """Return the sentence that must accompany the numbers if earlier rows decided which points were run."""
    if results.exp.study.is_refined:
        return "Most rollouts were placed next to the boundary, so this is not the share of the region."
    if not failure:
        return ""
    macro = f"\\{macro_prefix(results)}Failing"
    text = f"P(failure) is {macro}{{}}, with a 95\\,\\% interval from {macro}Low{{}} to {macro}High{{}}"
    return text + ("." if failure.is_reliable else ", which is not reliable: \\texttt{sweep stats} says why.")


def _percent(name: str, share: float, meaning: str, where: str | None) -> QuotableNumber:
    return QuotableNumber(name, share, "--" if np.isnan(share) else rf"{100 * share:.1f}\,\%", meaning, where)


def macro_definition(results: Results, number: QuotableNumber, file: str) -> str:
    """Return the LaTeX definition of a number's macro, after a comment that names its rows and how to list them."""
    chosen = results.rows[condition_mask(results.rows, number.where)]
    if extreme := re.fullmatch(r"(min|max) of (\S+)", number.what):
        values = chosen[extreme[2]]
        chosen = chosen[(values == number.value).to_numpy()]
    few = f": {', '.join(chosen['point_id'])}" if 0 < len(chosen) <= MAX_NAMED_ROWS else ""
    where = " and ".join(f"({c})" if results.where and number.where else c for c in (results.where, number.where) if c)
    command = f"sweep table {results.folder} --format csv" + (f" --where '{where}'" if where else "")
    definition = f"\\newcommand{{\\{number.name}}}{{{number.text}}}"
    command = re.sub(r"\s", " ", command)  # a line break would end the comment
    return f"% {number.what}, {len(chosen)} rows of data/{file}{few}\n% {command}\n{definition}\n"


def macro_prefix(results: Results) -> str:
    """Return the prefix of the study's macros: its name in letters that LaTeX allows."""
    word = macro_name(results.name) or "Study"
    return word[0].lower() + word[1:]


def macro_name(text: str) -> str:
    """Return the name of a LaTeX macro: `slip_max_m` -> `SlipMaxM`; digits are spelt out."""
    words = [w[0].upper() + w[1:] for w in re.split(r"[^0-9A-Za-z]+", text) if w]
    return re.sub(r"\d", lambda digit: DIGIT_WORDS[int(digit[0])], "".join(words))


def escape_latex(text: str) -> str:
    """Escape LaTeX's special characters in a text."""
    words = {"\\": "backslash", "~": "asciitilde", "^": "asciicircum", "<": "less", ">": "greater"}
    special = {c: rf"\text{word}{{}}" for c, word in words.items()} | {c: f"\\{c}" for c in "&%$#_{}"}
    return tables.unit_signs_to_latex("".join(special.get(c, c) for c in text))


def find_non_latin_letters(text: str) -> tuple[list[str], list[str], list[str]]:
    """Return the letters of `text` that are Cyrillic (pdfLaTeX has fonts), those without pdfLaTeX fonts, and which of
    these are not European."""
    letters = sorted(letter for letter in set(text) if letter.isprintable() and ord(letter) > LATIN)
    unknown = [letter for letter in letters if letter not in (*CYRILLIC, *PUNCTUATION)]
    others = [letter for letter in unknown if not unicodedata.name(letter, "").startswith(ALPHABETS)]
    return [letter for letter in letters if letter in CYRILLIC], unknown, others


def hexadecimal_code_points(letters: Iterable[str]) -> list[str]:
    """Return hexadecimal code points of letters, as `DeclareUnicodeCharacter` takes them."""
    return [f"{ord(letter):04X}" for letter in letters]


def _template() -> jinja2.Template:
    """LaTeX template; since LaTeX is full of braces, tags are << value >> and <% statement %>."""
    signs = ("<%", "%>", "<<", ">>", "<#", "#>")
    environment = jinja2.Environment(*signs, trim_blocks=True, undefined=jinja2.StrictUndefined)
    return environment.from_string(_source())


def _source() -> str:
    """Text of the template main.tex; its first line marks exports of this program."""
    return (files("sweep.report") / "paper.tex.j2").read_text(encoding="utf-8")

import io
import itertools
import re
import shutil
import subprocess
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from matplotlib.font_manager import fontManager
from matplotlib.text import Text
from slow_cases import mark_slow_cases

from sweep.cli.main import main
from sweep.core.plot_style import MAX_HEIGHT_IN, OTHER_FONTS, new_figure, plot_style
from sweep.report import paper
from sweep.report.figures import list_figures
from sweep.runs import results, store

OTHERS = ["figures/of_another.pdf", "data/of_another.csv", "main.tex"]  # files of somebody else in the folder


@pytest.fixture(scope="module")
def bundle(folder, tmp_path_factory):
    out = tmp_path_factory.mktemp("paper")
    assert main(["export", str(folder), "--paper", str(out)]) == 0
    return out


def test_every_macro_follows_from_the_rows_that_it_names(bundle, folder):
    text = (bundle / "numbers.tex").read_text()
    macros = re.findall(
        r"% (.+), (\d+) rows of data/rows\.csv(?:: (.+))?\n% sweep table \S+ --format csv(?: --where '(.+)')?\n"
        r"\\newcommand\{\\([A-Za-z]+)\}\{(.+)\}",
        text,
    )
    assert len(macros) == text.count("newcommand") == len({name for *_, name, _ in macros})
    rows = pd.read_csv(bundle / "data/rows.csv", keep_default_na=False)
    assert len(rows) == len(store.read_rows(folder)) == 180
    checked = set()
    for what, number, ids, where, name, shown in macros:
        chosen = rows.query(where) if where else rows
        if ids:
            chosen = rows[rows["point_id"].isin(ids.split(", "))]
        word = what.split()[0]
        if what == "number of rows":
            assert int(shown) == len(chosen) == int(number), name
        elif word in ("min", "max", "median"):
            value = pd.to_numeric(chosen[what.split()[-1]]).agg(word)
            assert shown == f"{value:.4g}", name
        elif word == "share":
            label = re.findall(r'"(\w+)"', what)[0]
            assert shown == rf"{100 * (chosen['outcome'] == label).mean():.1f}\,\%", name
        else:
            continue
        checked.add(word)
    assert checked == {"number", "min", "max", "median", "share"}


def test_the_data_of_a_figure_is_what_it_shows(bundle, folder):
    data = pd.read_csv(bundle / "data/map-1.csv")
    rows = store.read_rows(folder)
    cell = data[(data["world.contact.friction"] == 0.7) & (data["drive.damping"] == 500)]
    own = rows[(rows["world.contact.friction"] == 0.7) & (rows["drive.damping"] == 500)]
    won = own.groupby("manoeuvre.half_step_ratio")["outcome"].agg(lambda o: (o == "success").sum())
    assert cell["success"].tolist() == won.tolist()
    assert {p.stem for p in (bundle / "figures").glob("*.pdf")} == {
        "map-1", "map-2", "map-3", "effects", "causes", "distributions",
    }  # fmt: skip
    assert r"\bottomrule" in (bundle / "tables/not-successful.tex").read_text()
    text = (bundle / "main.tex").read_text()
    captions = [line for line in text.splitlines() if line.startswith(r"\caption") and "n = 180 rollouts" in line]
    assert len(captions) == 6
    for words in (r"Scenario walk\_tripod", "robot hexapod", "engine mjx", "; grid;"):
        assert all(words in line for line in captions), words
    assert r"{\usepackage[T1]{fontenc}}{}" in text  # only beside lmodern: T1 alone takes bitmap fonts


SIZES = ("body_length", "body_width", "body_mass", "thigh", "thigh_mass", "shin", "shin_mass")


@pytest.fixture
def drawn(fake_engine, tmp_path):
    """A study of draws of numbers that are long, of many parameters."""
    between = "distribution: {kind: uniform, from: 0.492, to: 0.508}}"
    axes = [f"+study.axes.{name}={{path: {path}, side: world, {between}" for name, path in
            (("friction", "contact.friction"), *((name, f"robot.{name}") for name in SIZES))]  # fmt: skip
    given = ["scenario=walk_tripod", "scenario.expect=[]", "study.name=drawn", "study.design={kind: sobol, num: 32}"]
    assert main(["run", *given, *axes, "engine.width=32", f"out={tmp_path}"]) == 0
    return tmp_path


@pytest.mark.parametrize("study", ["folder", "drawn"])
def test_figures_are_as_wide_as_a_column_or_a_page_and_have_letters_of_one_size(study, request):
    found = results.read_results(request.getfixturevalue(study))
    values = np.linspace(1.35e-4, 2.36e-4, len(found.rows))  # of long numbers
    long = dict.fromkeys(("depth_max_m", "end_drift_m", "fold_gap_min_m"), values)
    rows = found.rows.assign(**long)
    for serif in (False, True):
        for one in list_figures(replace(found, rows=rows)):
            with plot_style(serif):
                figure = one.draw()
                figure.draw_without_rendering()
            assert any(figure.get_size_inches()[0] == pytest.approx(mm / 25.4) for mm in (84, 174)), one.key
            assert figure.get_size_inches()[1] <= MAX_HEIGHT_IN, one.key  # else a page shrinks it, and its letters
            texts = [text for text in figure.findobj(Text) if text.get_text().strip() and text.get_visible()]
            assert {text.get_fontsize() for text in texts} == {8}, one.key
            for axes in figure.axes:  # labels of ticks stand apart
                boxes = [t.get_window_extent() for t in axes.get_xticklabels() if t.get_text() and t.get_visible()]
                inside = [box for box in boxes if axes.bbox.x0 - 1 <= box.x0 + box.width / 2 <= axes.bbox.x1 + 1]
                assert all(a.x1 + 4 <= b.x0 or a.y1 <= b.y0 or b.y1 <= a.y0 or axes.get_xticklabels()[0].get_rotation()
                           for a, b in itertools.pairwise(inside)), one.key  # fmt: skip


def test_figures_have_the_letters_of_a_chinese_name(recwarn):
    if not {font.name for font in fontManager.ttflist} & set(OTHER_FONTS):
        pytest.skip("needs letters: apt-get install fonts-noto-cjk, and none of matplotlib's list of fonts from before")
    with plot_style():
        figure = new_figure(1.0)
        figure.suptitle("步行 Ходьба")
        figure.savefig(io.BytesIO(), format="pdf")
    assert [str(one.message) for one in recwarn] == []


def test_names_and_words_are_fit_for_latex():
    assert paper.macro_name("world.slip_max_2m") == "WorldSlipMaxTwom"
    assert paper.escape_latex("a_b 5 % <x> [°]") == r"a\_b 5 \% \textless{}x\textgreater{} [\textdegree{}]"
    assert paper.escape_latex("[a_r], [m⁴]") == r"[$a_r$], [m\textsuperscript{4}]"


@pytest.mark.parametrize("name", mark_slow_cases(OTHERS, OTHERS[1:]))
def test_a_paper_is_made_anew_in_its_folder_but_not_in_another_s(bundle, folder, tmp_path, name, capsys):
    shutil.copytree(bundle, out := tmp_path / "paper")
    assert main(["export", str(folder), "--paper", str(out)]) == 0
    (out / name).write_text("of others")
    assert main(["export", str(folder), "--paper", str(out)]) == 2
    assert f"holds {name}, no part of this paper: give a new folder" in capsys.readouterr().err
    assert (out / name).read_text() == "of others"


@pytest.fixture(scope="module")
def foreign(folder, tmp_path_factory):
    """The bundle of a study whose name has letters of Russian, Greek and Chinese."""
    out, found = tmp_path_factory.mktemp("foreign"), results.read_results(folder)
    study = replace(found.exp.study, name="Ходьба Βάδισμα 步行_é")
    paths = paper.write_paper(replace(found, exp=replace(found.exp, study=study), rows=found.rows.head(40)), out)
    assert len(set(paths)) == len(paths)  # no figure's data are lost to a table's
    return out


def test_letters_that_latex_lacks_are_declared(foreign):
    text = (foreign / "main.tex").read_text()
    preamble, body = text.split(r"\begin{document}")
    declared = {chr(int(code, 16)) for code in re.findall(r"DeclareUnicodeCharacter\{(\w+)\}", preamble)}
    assert declared == set("步行ХодьбаΒάδισμα")  # the Cyrillic ones only where their encoding is missing
    assert preamble.index("T2A]{fontenc}") < preamble.index(f"{{{ord('Х'):04X}}}") < preamble.index("\\fi")
    assert "Ходьба Βάδισμα 步行" in body


def compiled(folder, program):
    command = [program, "-interaction=nonstopmode", "-halt-on-error", "main.tex"]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, errors="replace", timeout=120)
    assert done.returncode == 0, done.stdout[-2000:]
    log = (folder / "main.log").read_text(errors="replace")
    assert ("Missing character" in log) == ("No font here has all letters" in log)  # of which pdflatex says neither
    assert (folder / "main.pdf").stat().st_size > 10_000


@pytest.mark.parametrize("program", ["pdflatex", "xelatex", "lualatex"])
def test_the_paper_compiles(bundle, foreign, program):
    if not shutil.which(program):
        pytest.skip("needs LaTeX: apt-get install lmodern texlive-latex-recommended texlive-luatex texlive-xetex")
    compiled(bundle, program)
    compiled(foreign, program)

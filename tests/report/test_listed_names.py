"""Listed names, such as gaits and engines: on maps, in what matters, and at the nominal point."""

import json
import re
import shutil
import subprocess
from importlib.resources import files

import numpy as np
import pytest
from conftest import simulated

import sweep.engines
from sweep.cli.main import main
from sweep.config.experiment import compose
from sweep.core.outcomes import GOAL_MISSED
from sweep.metrics.outcome import cause_meanings
from sweep.report import figures, maps, sections
from sweep.report.labels import explain_outcome_kind
from sweep.runs import batches, results

GAITS = [
    "~study.axes.step", "study.axes.friction.from=0.1", "study.axes.friction.to=0.9", "study.axes.friction.num=6",
    "+study.axes.gait={path: manoeuvre.gait, values: [tripod, gallop]}",
    "+study.axes.engine={path: engine.name, values: [mjx, native]}",
]  # fmt: skip


@pytest.fixture(scope="module")
def gaits(tmp_path_factory):
    """A grid of a number and two names on the fake engine."""
    folder = tmp_path_factory.mktemp("gaits")
    assert simulated(folder, *GAITS, "engine.width=6") in (0, 3)
    return results.read_results(folder)


def test_names_are_axes_and_panels_of_maps(gaits):
    figure = maps.success_map(gaits.rows, gaits.stored)
    left, right = figure.axes[:2]
    assert left.get_xlabel() == "friction (world)"
    assert left.get_ylabel() == "gait"
    assert [tick.get_text() for tick in left.get_yticklabels()] == ["tripod", "gallop"]
    assert ("engine mjx" in left.get_title(), "engine native" in right.get_title()) == (True, True)
    pairs = [(one.x, one.y, one.panel_parameter) for one in sections.list_sections(gaits)]
    gait, engine, friction = "manoeuvre.gait", "engine.name", "world.contact.friction"
    assert pairs == [(friction, gait, None), (friction, engine, None), (gait, engine, friction)]
    for one in sections.list_sections(gaits):
        assert sections.draw_section(gaits, one).axes
        assert len(sections.section_data(gaits, one)) == len(one.rows)


def by_node(code):
    """What a script of the page's modules prints, each line as JSON."""
    if not (node := shutil.which("node")):
        pytest.skip("needs node")
    run = subprocess.run([node, "--input-type=module", "-e", code], capture_output=True, text=True, check=True)
    return list(map(json.loads, run.stdout.splitlines()))


def test_cells_of_names_are_of_one_size():
    script = json.dumps(str(files("sweep.report.page") / "axes.js"))
    column = '{ names: ["a", "b"], low: 0, high: 1 }'
    code = f"import {{ makeScale }} from {script}; console.log(JSON.stringify([...makeScale({column}, null, 9).edges]))"
    assert by_node(code) == [[0, 0.5, 1]]


def test_what_matters_counts_names():
    """Distances of names and numbers by the page's own script."""
    script = files("sweep.report.page") / "data.js"
    good = [0] * 30 + [1] * 10
    bad = [0] * 5 + [1] * 35
    even = [0, 1] * 40
    code = f"""
        import {{ nameDistance }} from {json.dumps(str(script))};
        const side = (row) => row < 40 ? 0 : 1;
        for (const values of [{good + bad}, {even}])
          console.log(JSON.stringify(nameDistance({{ names: ["a", "b"], values }}, side)));"""
    differs, alike = by_node(code)
    assert (differs["distance"], differs["significant"]) == (0.625, True)
    assert (alike["distance"], alike["significant"]) == (0, False)


def test_a_level_that_fails_at_the_nominal_point_is_reported(monkeypatch, tmp_path, capsys):
    import fake_engine

    class FailsByGallop(fake_engine.FakeEngine):
        def __init__(self, settings, world, belief, limits):
            super().__init__(settings, world, belief, limits)
            self.gait = world.manoeuvre.gait

        def run(self, world, belief, streams):
            found = super().run(world, belief, streams)
            slip = np.full(self.width, 0.1 if self.gait == "gallop" else 0.0)
            return found | {"slip_max_m": slip, "slipped_time_s": np.where(slip > 0, 0.5, np.inf)}

    monkeypatch.setattr(sweep.engines, "make_engine", FailsByGallop)
    batches.clear_engine_cache()
    line = "gait = gallop fails at the nominal point, before anything else is varied: a standing foot slipped by more"
    study = ["run", "study=walk_map", "study.expect=[]", *GAITS, "engine.width=6", f"out={tmp_path / 'walk'}"]
    assert main([*study, "--dry-run"]) == 0
    told = capsys.readouterr().out
    assert line in told
    assert "gait = tripod fails" not in told
    assert main(study) == 0
    assert line in capsys.readouterr().out
    batches.clear_engine_cache()


def test_describe_says_what_each_gait_is(capsys):
    assert main(["describe", "manoeuvre.gait"]) == 0
    assert "level_gallop: pairs swing in the order front, rear, middle" in capsys.readouterr().out
    assert main(["describe", "manoeuvre=walk"]) == 0
    assert "`gallop`: pairs swing in the order front, middle, rear" in capsys.readouterr().out


def test_causes_print_the_values_of_their_thresholds():
    exp = compose(["scenario=walk_tripod", "outcome.slip_max_m=0.03"])
    assert explain_outcome_kind("slipped", exp) == "a standing foot slipped by more than 0.03 m (slip_max_m)"
    said = cause_meanings(exp.thresholds)
    keyed = [words for cause, words in said.items() if re.search(r"\b\w+_(max|min)\b", words) and cause != GOAL_MISSED]
    assert all(re.search(r"\d.*\(\w+\)$", words) for words in keyed), keyed
    assert said["fell"] == "the base tilted beyond 20° (tilt_max_deg)"


def test_effects_of_draws_are_said_to_be_of_bins(tmp_path):
    drawn = "{path: robot.body_mass, distribution: {kind: uniform, from: 8.0, to: 12.0}}"
    design = "study.design={kind: monte_carlo, num: 96}"
    more = ["~study.axes.friction", "~study.axes.step", f"+study.axes.mass={drawn}", design, "engine.width=96"]
    assert simulated(tmp_path, *more) == 0
    (effects,) = figures.effects_figure(results.read_results(tmp_path))
    assert "in 20 bins of equal width of one parameter" in effects.caption

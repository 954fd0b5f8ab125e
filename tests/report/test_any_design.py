"""Studies of any design and shape go through every command that tells of their rows."""

import numpy as np
import pandas as pd
import pytest
from fake_engine import FakeEngine
from slow_cases import mark_slow_cases

from sweep.cli.commands.report import save_pictures
from sweep.cli.main import main
from sweep.report import draws, figures, maps, sections, statistics
from sweep.report.page import data
from sweep.runs import results

DRAWN = {
    "friction": "{path: contact.friction, side: world, distribution: {kind: uniform, from: 0.1, to: 1.2}}",
    "mass": "{path: robot.body_mass, distribution: {kind: uniform, from: 8.0, to: 12.0}}",
    "damping": "{path: drive.damping, distribution: {kind: uniform, from: 500.0, to: 530.0}}",
    "length": "{path: robot.body_length, relative: 0.02}",
    "shin": "{path: robot.shin, side: world, relative: 0.02}",
    "torque": "{path: drive.torque_limit, distribution: {kind: uniform, from: 140.0, to: 160.0}}",
}
RARE = {  # a rollout fails where friction is three standard deviations low
    "friction": "{path: contact.friction, side: world, distribution: {kind: normal, mean: 0.8, std: 0.1}}",
    "mass": "{path: robot.body_mass, side: world, distribution: {kind: normal, mean: 10.0, std: 0.1}}",
}
LISTED = {
    "friction": "{path: contact.friction, side: world, values: [0.1, 0.5, 0.9]}",
    "step": "{path: manoeuvre.half_step_ratio, values: [0.05, 0.1, 0.15]}",
    "mass": "{path: robot.body_mass, values: [9.0, 11.0]}",
    "damping": "{path: drive.damping, values: [500.0, 530.0]}",
    "bias": "{path: noise.orientation_bias, values: [0.0, 0.01]}",
    "length": "{path: robot.body_length, relative: 0.02, values: [-1.0, 1.0]}",
    "engine": "{path: engine.compiler, values: [xla, fused]}",
}
ZIPPED = {"mass": "{path: robot.body_mass, values: [8.0, 10.0, 12.0], with: friction}"}


def study(axes, *more):
    """Overrides for a study with these axes and no other."""
    return [f"+study.axes.{name}={axis}" for name, axis in axes.items()] + list(more)


def some(axes, *names):
    return {name: axes[name] for name in names}


def drawing(kind, num):
    return f"study.design={{kind: {kind}, num: {num}}}"


STEP = some(LISTED, "step")
DESIGNS = {
    "one_row": study({}),
    "one_row_repeated": study({}, "study.replicates=3", "noise.position_noise=0.001"),
    **{f"listed_{n}": study(dict(list(LISTED.items())[:n])) for n in range(1, 7)},
    "a_name": study(some(LISTED, "friction", "step", "engine")),
    **{f"drawn_{n}": study(dict(list(DRAWN.items())[:n]), drawing("monte_carlo", 24)) for n in range(1, 7)},
    "drawn_400": study(some(DRAWN, "friction", "mass", "damping"), drawing("latin_hypercube", 400)),
    "listed_by_1_drawn": study(some(DRAWN, "friction") | STEP, drawing("monte_carlo", 64)),
    "listed_by_3_drawn": study(some(DRAWN, "friction", "mass", "damping") | some(LISTED, "bias"),
                                drawing("monte_carlo", 64)),
    "listed_by_400_drawn": study(some(DRAWN, "friction", "mass", "damping") | STEP, drawing("monte_carlo", 400)),
    "2_listed_by_3_drawn": study(some(DRAWN, "mass", "damping", "length") | some(LISTED, "friction", "step"),
                                  drawing("sobol", 16)),
    "saltelli": study(some(DRAWN, "friction", "mass"), drawing("saltelli", 8)),
    "importance": study(RARE, "study.design={kind: importance, num: 256}"),
    "subset": study(RARE, "study.design={kind: subset, num: 100, share: 0.5, runs: 3}"),
    "morris": study(some(DRAWN, "friction", "mass"), drawing("morris", 4)),
    "zipped": study(some(LISTED, "friction") | ZIPPED),
    "zipped_by_listed": study(some(LISTED, "friction", "step") | ZIPPED),
    "zipped_by_drawn": study(some(LISTED, "friction") | ZIPPED | some(DRAWN, "damping"), drawing("monte_carlo", 32)),
    "one_at_a_time": study(some(LISTED, "friction", "step", "damping"), "study.design={grid: one_at_a_time}"),
    "refined": study({"friction": "{path: contact.friction, side: world, from: 0.05, to: 1.2, num: 5}",
                      "step": "{path: manoeuvre.half_step_ratio, from: 0.03, to: 0.2, num: 5}"},
                     "study.resolution=0.0625"),
    "refined_by_a_name": study({"friction": "{path: contact.friction, side: world, from: 0.05, to: 1.2, num: 3}",
                                "step": "{path: manoeuvre.half_step_ratio, from: 0.03, to: 0.2, num: 3}",
                                "engine": LISTED["engine"]}, "study.resolution=0.25"),
    "refined_in_three": study({"friction": "{path: contact.friction, side: world, from: 0.05, to: 1.2, num: 3}",
                               "step": "{path: manoeuvre.half_step_ratio, from: 0.03, to: 0.2, num: 3}",
                               "damping": "{path: drive.damping, from: 500.0, to: 530.0, num: 3}"},
                              "study.resolution=0.25"),
    "budgeted": study(some(LISTED, "friction", "step"), "study.budget=60", "study.replicates=2",
                      "noise.position_noise=0.001"),
}  # fmt: skip
# the fast ones have every kind of design and of axis
SLOW_DESIGNS = [
    *("importance", "subset", "listed_by_400_drawn", "drawn_400", "refined_in_three", "refined_by_a_name"),
    *(f"{kind}_{n}" for kind in ("listed", "drawn") for n in (1, 3, 4, 5, 6)),
]
POINTS = {
    "one_point": {"world.contact.friction": [0.5]},
    "points_of_2": {"world.contact.friction": np.linspace(0.1, 1, 20), "robot.body_mass": np.linspace(12, 8, 20)},
    "points_of_4": {
        "world.contact.friction": np.linspace(0.1, 1, 40),
        "robot.body_mass": np.tile([8.0, 9.0, 10.0, 11.0], 10),
        "drive.damping": np.tile([500.0, 530.0], 20),
        "manoeuvre.half_step_ratio": np.repeat([0.05, 0.15], 20),
    },
    "points_of_6": {
        path: np.random.default_rng(number).uniform(low, high, 30)
        for number, (path, low, high) in enumerate(
            [
                ("world.contact.friction", 0.1, 1.2),
                ("robot.body_mass", 8, 12),
                ("drive.damping", 500, 530),
                ("robot.body_length", 1.0, 1.1),
                ("world.robot.shin", 0.33, 0.34),
                ("drive.torque_limit", 140, 160),
            ]
        )
    },
}


COMMANDS = (["report"], ["stats"], ["table"], ["export", "--paper", "paper"])


def ran(folder, *overrides):
    """A study in `folder`."""
    given = ["scenario=walk_tripod", "scenario.expect=[]", "study.name=any", "engine.width=512", *overrides]
    assert main(["run", *given, f"out={folder}"]) in (0, 3)


def of_points(points, folder):
    """The words that run these points, from a file in `folder`."""
    pd.DataFrame(POINTS[points]).to_csv(folder / "points.csv", index=False)
    return "--points", str(folder / "points.csv")


def told(folder):
    """Everything that a page, its pictures and a paper show is made, and every map is one of something."""
    found = results.read_results(folder)
    for one in sections.list_sections(found):
        assert len(one.rows[[one.x, one.y]].drop_duplicates()) > 1, (one.x, one.y, one.note)
    for one in figures.list_figures(found):
        assert one.draw().axes
        assert len(one.data)
    if draws.has_draws_figure(found):
        draws.draw_overview(found)
    elif len(maps.independent_parameters(found.rows)) > 1:
        maps.success_map(found.rows, found.stored)
    assert data.page_data(found)["rows"] == len(found.rows)
    assert main(["stats", str(folder)]) == main(["table", str(folder)]) == 0


class Talkative(FakeEngine):
    """Of more figures than pandas keeps apart without a warning, which is an error here."""

    def run(self, world, belief, streams):
        figures = super().run(world, belief, streams)
        return figures | {f"more_{number}_m": np.full(self.width, 0.1 * number) for number in range(100)}


@pytest.mark.parametrize("fake_engine", [Talkative], indirect=True)
def test_a_study_of_many_figures_is_told(fake_engine, tmp_path):
    ran(tmp_path, *DESIGNS["listed_2"])
    told(tmp_path)


@pytest.mark.parametrize("design", mark_slow_cases(DESIGNS, SLOW_DESIGNS))
def test_a_study_of_any_design_is_told(design, fake_engine, tmp_path):
    ran(tmp_path, *DESIGNS[design])
    told(tmp_path)


@pytest.mark.parametrize("points", POINTS)
def test_points_from_a_file_are_told(points, fake_engine, tmp_path):
    ran(tmp_path / "study", *of_points(points, tmp_path))
    told(tmp_path / "study")
    assert isinstance(save_pictures(results.read_results(tmp_path / "study"), tmp_path, ()), list)


@pytest.mark.parametrize(
    "design",
    [
        "listed_by_3_drawn",
        *(pytest.param(one, marks=pytest.mark.slow) for one in (*DESIGNS, *POINTS) if one != "listed_by_3_drawn"),
    ],
)
def test_every_command_ends_well(design, fake_engine, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    ran(tmp_path / "study", *(of_points(design, tmp_path) if design in POINTS else DESIGNS[design]))
    for name, *more in COMMANDS:
        assert main([name, "study", *more]) == 0, name


def test_sensitivity_indices_of_draws_at_several_conditions_say_how_to_get_them(fake_engine, tmp_path):
    ran(tmp_path, *DESIGNS["listed_by_400_drawn"])
    found = dict(statistics.labelled_sections(results.read_results(tmp_path)))
    assert "sweep stats DIR --where 'step == 0.05'" in found["Sensitivity indices of the draws"]
    assert not any("grid point" in content for content in found.values() if isinstance(content, str))


def test_distributions_show_first_what_tells_failures_from_successes_without_outliers(fake_engine, tmp_path):
    ran(tmp_path, *DESIGNS["drawn_400"])
    found = results.read_results(tmp_path)
    found.rows["tilt_max_deg"] = np.where(found.rows["outcome"] == "success", 1.0, 40.0)
    found.rows.loc[0, "slip_max_m"] = 1e6
    (shown,) = figures.distributions_figure(found)
    assert shown.data["figure"].iloc[0] == "tilt_max_deg"
    assert shown.data.loc[shown.data["figure"] == "slip_max_m", "to"].max() < 10
    assert "slip max" in shown.caption
    assert shown.data.groupby("figure")["rollouts"].sum().eq(len(found.rows)).all()


def test_single_rollouts_of_one_axis_at_a_time_have_no_interval_and_counts_are_whole(fake_engine, tmp_path, capsys):
    for replicates, sure in ((1, False), (2, True)):
        ran(folder := tmp_path / str(replicates), *DESIGNS["one_at_a_time"], f"study.replicates={replicates}")
        shown = {one.key: one for one in figures.list_figures(results.read_results(folder))}
        assert shown["effects"].data["low"].notna().all() == sure
        assert ("Wilson" in shown["effects"].caption) == sure
        for name, axis in (("distributions", "yaxis"), ("causes", "xaxis")):
            ticks = np.concatenate([getattr(ax, axis).get_majorticklocs() for ax in shown[name].draw().axes])
            assert len(ticks)
            assert not (ticks % 1).any()
        capsys.readouterr()
        assert main(["stats", str(folder)]) == 0
        assert ("the others nominal (Wilson" in capsys.readouterr().out) == sure

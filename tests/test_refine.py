import re

import numpy as np
import pandas as pd
import pytest
from fake_engine import FakeEngine
from scipy.ndimage import binary_dilation

import sweep.engines
from sweep.cli.main import main
from sweep.config.experiment import build_experiment, compose
from sweep.runs import refine, store
from sweep.runs.refine import FAILURE_LABEL, MISSING_LABEL, SUCCESS_LABEL, bisect_cells, infer_cell_labels, leaf_cells

FRICTION = "study.axes.friction={path: contact.friction, side: world, from: 0.05, to: 1.2, num: 9}"
STEP = "study.axes.step={path: manoeuvre.half_step_ratio, from: 0.03, to: 0.2, num: 9}"
AXES = ["study=walk_map", "study.expect=[]", FRICTION, STEP]


def explored(truth, halvings):
    """The points that bisection asks for, told the truth round by round."""
    label = np.full(truth.shape, MISSING_LABEL)
    while ((wanted := bisect_cells(label, halvings)) & (label == MISSING_LABEL)).any():
        label[wanted] = truth[wanted]
    return label


def disc(n):
    x, y = np.meshgrid(*[np.linspace(0, 1, n)] * 2, indexing="ij")
    return np.where((x - 0.4) ** 2 + (y - 0.55) ** 2 < 0.09, SUCCESS_LABEL, FAILURE_LABEL)


def test_bisection_finds_a_disc_with_ten_times_fewer_points():
    truth = disc(129)
    label = explored(truth, 4)
    assert (label != MISSING_LABEL).sum() < truth.size / 10
    assert (infer_cell_labels(label, 4) == truth).all()


def test_the_cells_that_are_left_tile_the_map_and_only_the_smallest_disagree():
    truth = disc(129)
    cells = leaf_cells(explored(truth, 4), 4)
    assert len(cells) == 5
    covered = np.zeros((128, 128), dtype=int)
    for power, corners in enumerate(cells):
        for i, j in corners:
            covered[i : i + 2**power, j : j + 2**power] += 1
            alike = np.ptp(truth[i : i + 2**power + 1, j : j + 2**power + 1]) == 0
            assert alike or power == 0
    assert (covered == 1).all()


def test_a_strip_that_leaves_a_cell_through_its_side_is_followed():
    truth = np.full((65, 65), FAILURE_LABEL)
    truth[20:23] = SUCCESS_LABEL  # thinner than a cell of the first grid: seen only where it is met
    truth[16:33, 14:18] = SUCCESS_LABEL  # it joins the strip, and meets two points of the first grid
    label = explored(truth, 4)
    assert (infer_cell_labels(label, 4) == truth).all()


def test_a_boundary_in_three_dimensions_and_along_one():
    x, y, z = np.meshgrid(*[np.arange(33)] * 3, indexing="ij")
    truth = np.where(x + 2 * y + z < 60, SUCCESS_LABEL, FAILURE_LABEL)
    label = explored(truth, 3)
    assert (infer_cell_labels(label, 3) == truth).all()
    assert (label != MISSING_LABEL).mean() < 0.5
    line = np.where(np.arange(1025) < 300, SUCCESS_LABEL, FAILURE_LABEL)
    label = explored(line, 10)
    assert (label != MISSING_LABEL).sum() == 2 + 10
    assert (infer_cell_labels(label, 10) == line).all()


def test_what_the_first_grid_does_not_meet_is_an_island_that_the_audit_can_meet():
    truth = disc(129)
    truth[1:15, 1:15] = SUCCESS_LABEL
    label = explored(truth, 4)
    wrong = infer_cell_labels(label, 4) != truth
    assert 0 < wrong.mean() < 14 * 14 / 129**2 + 1e-9


@pytest.fixture
def counted(monkeypatch):
    """The engines that were made, by width."""
    widths = []

    class Counting(FakeEngine):
        def __init__(self, settings, *others):
            widths.append(settings.width)
            super().__init__(settings, *others)

    monkeypatch.setattr(sweep.engines, "make_engine", Counting)
    return widths


def test_a_refined_map_is_the_grid_with_ten_times_fewer_rollouts(tmp_path, capsys, counted):
    refining = ["study.resolution=0.0078125", "study.audit=200", "engine.width=128"]
    assert main(["run", *AXES, *refining, f"out={tmp_path}"]) == 0
    out = capsys.readouterr().out
    rows = store.read_rows(tmp_path)
    exp = build_experiment(store.read_study(tmp_path)["config"])
    (found,) = refine.summarize_panels(exp, rows)
    assert found.lattice.shape == (129, 129)
    friction, ratio = np.meshgrid(*found.lattice.values, indexing="ij")
    truth = np.where(friction < 5 * ratio, FAILURE_LABEL, SUCCESS_LABEL)
    assert (found.labels == truth).all()
    assert found.rollouts < 129**2 / 10
    assert found.audited == 200
    assert found.missed == 0
    assert found.mislabelled_share_upper_bound == pytest.approx(1 - 0.025 ** (1 / 200))
    assert re.search(
        r"refined: [\d,]+ rollouts, 0 invalid \(0\.0 %\), for a grid of 129 x 129 points, 1\d\.\d times fewer; "
        r"0 of 200 audited",
        out,
    )
    assert len(counted) == 1
    assert main(["stats", str(tmp_path)]) == 0
    share = (truth == SUCCESS_LABEL).mean()
    assert f"{100 * share:.0f}." in capsys.readouterr().out.split("grid's volume that succeeds")[1].split("%")[0]
    assert main(["run", *AXES, *refining, f"out={tmp_path}"]) == 0  # nothing is left to run
    assert len(store.read_rows(tmp_path)) == len(rows)


@pytest.mark.slow
def test_the_walking_map_is_its_whole_grid_with_ten_times_fewer_rollouts(tmp_path):
    """The grid is 16641 rollouts: four minutes on two idle cores."""
    whole = [f"study.axes.{name}.num=129" for name in ("friction", "step")]
    whole += ["study.resolution=0", "study.audit=0"]
    for name, overrides in (("refined", []), ("whole", whole)):
        assert main(["run", "study=walk_map_refined", *overrides, f"out={tmp_path / name}"]) == 0
    exp = build_experiment(store.read_study(tmp_path / "refined")["config"])
    (found,) = refine.summarize_panels(exp, store.read_rows(tmp_path / "refined"))
    grid = store.read_rows(tmp_path / "whole")
    outcome = np.full(found.lattice.shape, "missing", dtype=object)
    outcome[found.lattice.indices(grid)] = grid["outcome"]
    assert found.rollouts < outcome.size / 10
    assert (found.audited, found.missed) == (200, 0)
    wrong = (found.labels == SUCCESS_LABEL) != (outcome == "success")
    near = [binary_dilation(outcome == word, np.ones((3, 3))) for word in ("success", "failure")]
    assert not wrong[~(near[0] & near[1]) & (outcome != "invalid")].any()  # the boundary is within one cell


def test_an_interrupted_refinement_goes_on_where_it_was(tmp_path, monkeypatch, fake_engine):
    refining = [*AXES, "study.resolution=0.05", "study.axes.friction.num=5", "study.axes.step.num=5", "engine.width=16"]
    assert main(["run", *refining, f"out={tmp_path / 'whole'}"]) == 0
    limited = FakeEngine.run

    def breaks(self, world, belief, streams, calls=[]):  # noqa: B006
        calls.append(0)
        if len(calls) == 4:
            raise KeyboardInterrupt
        return limited(self, world, belief, streams)

    monkeypatch.setattr(FakeEngine, "run", breaks)
    assert main(["run", *refining, f"out={tmp_path / 'broken'}"]) == 130
    assert main(["run", *refining, f"out={tmp_path / 'broken'}"]) == 0
    whole, broken = (store.read_rows(tmp_path / name).drop(columns="wall_s") for name in ("whole", "broken"))
    pd.testing.assert_frame_equal(whole, broken)


class NoisyEngine(FakeEngine):
    """Succeeds with a probability that falls from 1 to 0 over friction 0 to 1, by the noise stream."""

    def run(self, world, belief, streams):
        figures = super().run(world, belief, streams)
        friction = np.broadcast_to(world.contact.friction, streams.shape)
        luck = np.random.default_rng(0).permutation(2**16)[streams % 2**16] / 2**16
        return figures | {"tilt_max_deg": np.where(luck < friction, 40.0, 1.0), "slip_max_m": np.zeros_like(luck)}


NOISY = ["+study.axes.f={path: contact.friction, side: world, from: 0.05, to: 0.95, num: 10}", "study.name=noisy",
         "study.replicates=20", "engine.width=512", "study.invalid_max=1"]  # fmt: skip


noisy = pytest.mark.parametrize("fake_engine", [NoisyEngine], indirect=True)


@pytest.mark.slow
@noisy
def test_noisy_points_get_rollouts_until_decided_or_the_budget_is_spent(tmp_path, fake_engine, capsys):
    assert main(["run", *NOISY, "study.level=0.7", "study.budget=6000", f"out={tmp_path}"]) == 0
    rows = store.read_rows(tmp_path)
    assert len(rows) <= 6000
    spent = rows.groupby("world.contact.friction").size()
    assert spent.iloc[[0, 1, -2, -1]].max() <= 90  # far from the level, which is at a friction of 0.3
    assert spent[[0.25, 0.35]].min() > 200
    exp = build_experiment(store.read_study(tmp_path)["config"])
    (found,) = refine.summarize_panels(exp, rows)
    assert found.labels.tolist() == [SUCCESS_LABEL] * 3 + [FAILURE_LABEL] * 7
    assert found.undecided == 0
    assert main(["run", *NOISY, "study.level=0.7", "study.budget=210", f"out={tmp_path / 'small'}"]) == 0
    assert len(store.read_rows(tmp_path / "small")) == 210
    assert "the interval still holds the level" in capsys.readouterr().out


@noisy
def test_draws_grow_where_a_condition_is_not_decided(tmp_path, fake_engine):
    drawn = [*NOISY, "study.replicates=1", "study.design.num=20", "+study.axes.s={path: robot.shin, relative: 0.02}"]
    assert main(["run", *drawn, "study.budget=1000", f"out={tmp_path}"]) == 0
    rows = store.read_rows(tmp_path)
    assert rows.groupby("world.contact.friction").size().max() > 20
    assert rows["robot.shin"].nunique() == rows["replicate"].nunique()


@pytest.mark.parametrize(
    ("overrides", "message"),
    [
        (["study.resolution=0.01", "study.axes.friction.values=[1.0]"], "at least 2 values"),
        (["study.resolution=0.01", "study.where='friction > 1'"], "refinement needs a full grid"),
        (["study.resolution=0.01", "study.design.grid=one_at_a_time"], "axes that vary alone"),
        (["study.resolution=0.01", "study.replicates=2"], "study.budget is missing"),
        (["study.resolution=1"], "below 1"),
        (["study.budget=2", "study.resolution=0.01"], "the first grid takes"),
        (["study.level=1"], "study.level = 1"),
    ],
)
def test_what_cannot_be_refined_is_refused(overrides, message, capsys, tmp_path, fake_engine):
    assert main(["run", *AXES, *overrides, f"out={tmp_path / 'new'}"]) == 2
    assert message in capsys.readouterr().err
    assert not (tmp_path / "new").exists()


def test_the_finest_grid_holds_the_first_one():
    grid = refine.make_lattice(compose([*AXES, "study.resolution=0.01", "study.axes.step.values=[0.1,0.11,0.2]"]).study)
    assert grid.halvings == 7  # the widest cell is 0.9 of its axis
    assert {0.1, 0.11, 0.2} <= set(grid.values[1])

"""Scenes with known answers, within bounds that a wrong step breaks, as each of ten does here."""

import numpy as np
import pytest
from validity import faults, peers, raft, robot
from validity.scenes import SCENES
from validity.tables import law

FIGURES = [f"{scene.name}: {figure.name}" for scene in SCENES for figure in scene.figures if figure.bound is not None]


@pytest.fixture(scope="module")
def errors():
    """Errors and bounds of the step at its default settings."""
    return {name: (error, bound) for name, error, bound in faults.errors(law())}


@pytest.fixture(scope="module")
def wrong():
    """The same of wrong steps, by the name of what is wrong."""
    return faults.errors_with_faults(law())


@pytest.mark.slow
def test_nothing_is_left_out(errors):
    assert set(FIGURES) < set(errors)
    assert len(errors) - len(FIGURES) == 8  # the robot's stances


@pytest.mark.slow
@pytest.mark.parametrize("name", [*FIGURES, "the robot"])
def test_what_is_known_comes_out(errors, name):
    chosen = {key: both for key, both in errors.items() if key == name or (name == "the robot" and key not in FIGURES)}
    assert chosen
    assert faults.broken_bounds([(key, *both) for key, both in chosen.items()]) == {}


@pytest.mark.slow
@pytest.mark.parametrize("name", faults.FAULTS)
def test_each_fault_breaks_a_bound_and_none_breaks_none(wrong, errors, name):
    found = wrong[name]
    assert [figure for figure, *_ in found] == list(errors)
    assert bool(faults.broken_bounds(found)) == (name != "none")


def test_a_raft_heaves_and_rocks_as_closed_forms_say_in_c():
    """Under the water's force at every step, as `test_raft_afloat` asks of this package's own step."""
    motion = raft.by_mujoco(2e-3)
    for figure in raft.figures():
        assert abs(figure.of(motion) - figure.exact) < figure.bound * figure.scale, figure.name


def test_in_c_blocks_stay_and_balls_roll_alike():
    """The same scenes before another engine: what is wrong with a scene would show in both."""
    for scene in (SCENES[0], SCENES[7], SCENES[12]):
        history = peers.by_mujoco(scene, peers.NATIVE)
        for figure in scene.figures:
            assert abs(figure.of(history) - figure.exact) < 0.01 * figure.scale, (scene.name, figure.name)


def test_balance_does_not_say_how_feet_push_but_springs_do():
    """The least forces that balance the weight are another answer: the scene tells them apart."""
    case, rows = robot.rows()
    force = robot.equilibrium(case, rows[0])
    least = robot.least_squares(case, rows[0])
    np.testing.assert_allclose(force.sum(axis=0), least.sum(axis=0), atol=1e-6)
    assert robot.error(case, rows[0], least) > 20 * rows[0].bound

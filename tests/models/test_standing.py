"""A standing robot on flat and tilted ground: it does not creep, holds below its friction angle and slides above it."""

import dataclasses

import numpy as np
import pytest
from validity.simulation import simulate

from sweep.config.experiment import compose
from sweep.controllers.tracker import joint_targets
from sweep.core.constants import GRAVITY
from sweep.engines.closed_loop import start_state
from sweep.models.posture import feet_in_world

STEP, FRICTION, DEGREE = 2e-3, 0.7, np.pi / 180
LIMIT = np.arctan(FRICTION)
SLOPES = np.array([0.0, LIMIT - DEGREE, LIMIT + DEGREE])
FLAT, BELOW, ABOVE = range(3)
SECOND = round(1 / STEP)


@pytest.fixture(scope="module")
def history():
    """Three seconds on each slope, the joints told to stay as they are."""
    nominal = compose(["manoeuvre=stand", f"contact.friction={FRICTION}"]).case
    starts = []
    for slope in SLOPES:
        case = dataclasses.replace(nominal, obstacle=dataclasses.replace(nominal.obstacle, slope=float(slope)))
        starts.append(np.asarray(start_state(case, case, case.manoeuvre.plan(case)).qpos))
    world = dataclasses.replace(nominal, obstacle=dataclasses.replace(nominal.obstacle, slope=SLOPES))
    references = np.broadcast_to(starts[-1][7:].reshape(6, 3), (3 * SECOND, 6, 3))
    return simulate(world, nominal, np.stack(starts).astype(np.float32), references.astype(np.float32))


def drift(history, row):
    """How far the base and the feet went in the last two seconds, and in how long."""
    base = np.linalg.norm(history.q[-1, row, :3] - history.q[SECOND, row, :3])
    feet = np.linalg.norm(history.foot[-1, row] - history.foot[SECOND, row], axis=-1).max()
    return max(base, feet) / 2.0


def test_weight_is_carried(history):
    carried = history.force[-1, FLAT].sum(axis=0)
    np.testing.assert_allclose(
        carried, [0, 0, 16 * GRAVITY], atol=0.5
    )  # N: 1e-7 m of float32 in a spring of 1e6 N/m, a few times


@pytest.mark.parametrize("row", [FLAT, BELOW])
def test_no_creep(history, row):
    assert drift(history, row) < 0.1e-3


def test_slides_with_coulombs_acceleration(history):
    speed = np.linalg.norm(history.v[:, ABOVE, :3], axis=-1)
    measured = (speed[-1] - speed[SECOND]) / (2.0 - STEP)
    expected = GRAVITY * (np.sin(SLOPES[ABOVE]) - FRICTION * np.cos(SLOPES[ABOVE]))
    assert measured == pytest.approx(expected, rel=0.03)


def test_sliding_feet_drag_with_the_limit(history):
    force, normal = history.force[-SECOND:, ABOVE], history.normal[-SECOND:, ABOVE]
    up = np.array([-np.sin(SLOPES[ABOVE]), 0, np.cos(SLOPES[ABOVE])])
    tangential = np.linalg.norm(force - normal[..., None] * up, axis=-1)
    loaded = normal > 1
    assert loaded.mean() > 0.4
    np.testing.assert_allclose(tangential[loaded], FRICTION * normal[loaded], rtol=1e-3)


@pytest.mark.parametrize("share", [1.0, 1.03, 1.05])
def test_a_robot_larger_than_believed_is_lifted_on_to_its_beam(share):
    """Its feet are put up to 30 mm deep in the beam, 4 mm from its sides, which do not push it away."""
    case = compose(["scenario=beam_walk"]).case
    robot, plan = dataclasses.replace(case.robot, thigh=share * case.robot.thigh), case.manoeuvre.plan(case)
    start = start_state(dataclasses.replace(case, robot=robot), case, plan).qpos
    feet = np.asarray(feet_in_world(robot, start[:3], start[3:7], joint_targets(case.robot, plan.start)[0]))
    np.testing.assert_allclose(start[:2], plan.start.position[:2], atol=1e-6)
    np.testing.assert_allclose(feet[[0, 1, 4, 5], 2], case.obstacle.height, atol=1e-6)

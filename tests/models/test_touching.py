"""Free bodies that touch each other and the world: momentum, restitution, loads, and a rod that leans and slides."""

import dataclasses

import mujoco
import numpy as np
import pytest
from touching import Rod, TwoBalls
from validity.simulation import simulate

from sweep.config.experiment import compose
from sweep.core.constants import GRAVITY
from sweep.models.contact import Contact
from sweep.models.obstacles.geoms import add_contact_pair

STEP, SECONDS = 2e-4, 0.8
COLLIDES, DAMPED, BUMPS, SWINGS = range(4)
SPEED, DAMPING, SPRING, ASIDE = 0.5, 4e3, 4e4, 0.05
FIRST, SECOND = slice(24, 27), slice(30, 33)  # of v
POSITION = 32  # of the second ball's x, in q


def restitution(mass: float, damping: float) -> float:
    """Speed after over speed before, of the law's spring and damper, which push as long as their sum does.

    That is for half a period. The step damps by nothing else.
    """
    stiffness = Contact().stiffness
    decay = (Contact().damping + damping) / (2 * mass)
    rate = np.sqrt(stiffness / mass - decay**2)
    return float(np.exp(-np.pi * decay / rate))


@pytest.fixture(scope="module")
def balls():
    """The first ball rolls into the second; once more with damping; the second into the wall; and hangs on a spring."""
    world = TwoBalls(damping=np.array([0.0, DAMPING, DAMPING, 0.0]), spring=np.array([0.0, 0.0, 0.0, SPRING]))  # pyright: ignore
    nominal = dataclasses.replace(compose([]).case, obstacle=TwoBalls())
    q, v = np.zeros((4, 39)), np.zeros((4, 36))
    q[:, 2], q[:, 3], q[:, 28], q[:, 35] = 400.0, 1.0, 1.0, 1.0
    sag = GRAVITY / nominal.contact.stiffness  # m a kilogram
    q[:, 25], q[:, 27], q[:, 34] = -1.1, 0.5 - 200 * sag, 0.5 - 400 * sag
    v[[COLLIDES, DAMPED], 24] = SPEED
    q[BUMPS, POSITION], v[BUMPS, 30] = 3.4, SPEED
    q[SWINGS, 25], q[SWINGS, POSITION] = -4.0, ASIDE
    case = dataclasses.replace(nominal, obstacle=world)
    return simulate(case, nominal, q, np.zeros((round(SECONDS / STEP), 6, 3)), STEP, v, iterations=4)


@pytest.mark.parametrize("row", [COLLIDES, DAMPED])
def test_balls_collide(balls, row):
    """Together they keep their momentum; they part as fast as the damper of the contact leaves them."""
    first, second = balls.v[:, row, FIRST], balls.v[:, row, SECOND]
    momentum = 200 * first + 400 * second
    assert np.abs(momentum[:, :2] - [200 * SPEED, 0.0]).max() < 1e-5 * 200 * SPEED
    wanted = restitution(200 * 400 / 600, DAMPING if row == DAMPED else 0.0)
    assert (second - first)[-1, 0] / SPEED == pytest.approx(wanted, abs=0.005)


def test_ball_leaves_the_wall(balls):
    """The floor carries it all the while."""
    assert -balls.v[-1, BUMPS, 30] / SPEED == pytest.approx(restitution(400, DAMPING), abs=0.005)
    assert np.abs(balls.v[:, BUMPS, 32]).max() < 1e-2 * SPEED


def test_load_swings_a_ball_and_its_work_is_counted(balls):
    """At the frequency of spring and mass; kinetic and potential energy come from the load's work alone."""
    t = STEP * (1 + np.arange(len(balls.q)))
    wanted = ASIDE * np.cos(np.sqrt(SPRING / 400) * t)
    assert np.abs(balls.q[:, SWINGS, POSITION] - wanted).max() < 0.02 * ASIDE
    work, swung = np.cumsum(balls.work[:-1, SWINGS]), balls.v[:-1, SWINGS, 30]
    assert np.ptp(work) == pytest.approx(0.5 * SPRING * ASIDE**2, rel=0.02)
    np.testing.assert_allclose(0.5 * 400 * swung**2, work, atol=0.03 * np.ptp(work))


@pytest.fixture(scope="module")
def rod():
    """Friction over and under what holds the rod: cot(angle) = 2 f / (1 - f^2)."""
    angle, length = np.deg2rad(60.0), Rod().length
    least = np.tan(0.5 * np.arctan(1 / np.tan(angle)))
    nominal = dataclasses.replace(compose([]).case, obstacle=Rod())
    contact = dataclasses.replace(nominal.contact, friction=least * np.array([1.2, 0.8]))
    q = np.zeros((2, 32))
    q[:, 2], q[:, 3] = 400.0, 1.0
    q[:, 25], q[:, 27] = -0.5 * length * np.cos(angle), 0.5 * length * np.sin(angle)
    q[:, 28], q[:, 30] = np.cos(angle / 2), -np.sin(angle / 2)  # its x axis points up and to the wall
    case = dataclasses.replace(nominal, contact=contact)
    return simulate(case, nominal, q.astype(np.float32), np.zeros((1000, 6, 3), np.float32), iterations=4)


def test_rod_holds_and_slides_at_its_friction(rod):
    moved = np.abs(rod.q[:, :, 25] - rod.q[:1, :, 25])
    assert moved[:, 0].max() < 1e-3
    assert moved[-1, 1] > 0.1
    assert rod.residual.max() < 1.0


@pytest.mark.parametrize("row", [COLLIDES, DAMPED, BUMPS])
def test_no_energy_is_gained_in_a_collision(balls, row):
    """Of both, in motion and in the contact; the floor only carries them."""
    moving = 0.5 * (200 * balls.v[:, row, FIRST] ** 2 + 400 * balls.v[:, row, SECOND] ** 2).sum(axis=-1)
    first, second = (balls.q[:, row, k] for k in (25, POSITION))
    depth = np.maximum(second - 3.5 if row == BUMPS else 1.0 - (second - first), 0.0)
    energy = moving + 0.5 * Contact().stiffness * depth**2
    assert (energy - np.minimum.accumulate(energy)).max() < 2e-5 * energy[0]
    assert energy[-1] < 0.96 * energy[0]


@pytest.mark.parametrize("ratio", [1.0, 0.1])
@pytest.mark.parametrize("wall", [False, True])
def test_pairs_in_c_rebound_as_their_damping_says(ratio, wall):
    """Two balls, or one and a wall, without weight, that nothing else lets meet. No energy is gained."""
    spec = mujoco.MjSpec()
    spec.option.gravity, spec.option.timestep = [0, 0, 0], STEP
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    apart = {"contype": 0, "conaffinity": 0}
    for name, x in [("one", 0.0)] if wall else [("one", 0.0), ("other", 1.05)]:
        body = spec.worldbody.add_body(name=name, pos=[x, 0, 0])
        body.add_freejoint()
        body.add_geom(name=name, type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[0.5, 0, 0], mass=100.0, **apart)
    if wall:
        facing = [np.sqrt(0.5), 0, -np.sqrt(0.5), 0]  # its normal, z, turned to -x
        spec.worldbody.add_geom(
            name="other", type=mujoco.mjtGeom.mjGEOM_PLANE, size=[1, 1, 1], pos=[0.55, 0, 0], quat=facing, **apart
        )
    add_contact_pair(spec, "one", "other", 0.5, ratio)
    model = spec.compile()
    data = mujoco.MjData(model)
    data.qvel[0] = SPEED
    fastest = 0.0
    for _ in range(round(SECONDS / STEP)):
        mujoco.mj_step(model, data)
        fastest = max(fastest, float(np.linalg.norm(data.qvel)))
    other = 0.0 if wall else data.qvel[6]
    if not wall:
        assert data.qvel[0] + other == pytest.approx(SPEED, abs=1e-6)
    assert fastest <= SPEED * (1 + 1e-9)
    left = np.exp(-np.pi * ratio / np.sqrt(1 - ratio**2)) if ratio < 1 else 0.0
    assert (other - data.qvel[0]) / SPEED == pytest.approx(left, abs=0.15)

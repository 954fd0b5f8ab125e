"""A ladder that leans on a wall: it stands or slides as statics says, rests still, and keeps its energy."""

import dataclasses

import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
from validity.simulation import simulate

from sweep.config.experiment import compose
from sweep.core.constants import GRAVITY
from sweep.core.errors import InputError
from sweep.core.rotations import matrix
from sweep.models.obstacles.ladder import BARS, FLOOR, LEDGE, WALL, Ladder
from sweep.models.obstacles.surface import landmark_state, state_from_landmarks
from sweep.models.scene import compile_native_model

STEP, SECONDS = 2e-3, 5.0
PLACE, QUAT, MOVES, TURNS = slice(25, 28), slice(28, 32), slice(24, 27), slice(27, 30)  # in q, q, v, v
RESTS, HOLDS, SLIDES = range(3)


def least_friction(ladder: Ladder) -> float:
    """On the floor, with none at the wall: the weight's arm about the lower edge over the wall's, monograph 2.2.

    The edges that touch are on the side of the wall, half a rail's depth from the plane of the mass centre.
    """
    arm = ladder.mass_centre_along_rails * np.cos(ladder.lean) - ladder.rail_depth / 2 * np.sin(ladder.lean)
    return float(arm / (ladder.length * np.sin(ladder.lean)))


def test_least_friction_is_that_of_a_rod():
    """0.134 at 75 degrees, where the mass centre is in the middle and the rails are thin."""
    assert least_friction(Ladder(rungs=1, width=1e-9, rail_depth=1e-6)) == pytest.approx(0.134, abs=5e-4)


@pytest.fixture(scope="module")
def nominal():
    return dataclasses.replace(compose([]).case, obstacle=Ladder())


@pytest.fixture(scope="module")
def history(nominal):
    """The robot is far above and falls freely."""
    ladder, least = nominal.obstacle, least_friction(nominal.obstacle)
    start, q = ladder.start(), np.zeros((3, 32))
    q[:, 2], q[:, 3] = 400.0, 1.0
    q[:, PLACE], q[:, QUAT] = start.position[0], start.quat[0]
    grips = {"floor_grip": np.array([1.0, 1.05 * least, 0.95 * least]), "wall_grip": np.array([1.0, 0.0, 0.0])}
    case = dataclasses.replace(nominal, obstacle=dataclasses.replace(ladder, **grips))
    return simulate(case, nominal, q.astype(np.float32), np.zeros((round(SECONDS / STEP), 6, 3)), STEP, iterations=4)


def test_it_holds_and_slides_at_its_friction(history):
    moved = np.linalg.norm(history.q[:, :, PLACE] - history.q[:1, :, PLACE], axis=-1)
    assert moved[-1, RESTS] < 0.006
    assert moved[-1, HOLDS] < 0.02
    assert moved[:, SLIDES].max() > 0.1
    assert history.residual.max() < 1.0


def test_it_rests_still_after_it_has_fallen_on_its_edges(history):
    """By the slope of its way: single precision lets it jitter by some micrometres."""
    way = history.q[round(1.5 / STEP) :, RESTS, PLACE].astype(float)
    creep, _ = np.polyfit(STEP * np.arange(len(way)), way, 1)
    assert np.linalg.norm(creep) < 1e-6


def test_its_energy_never_rises(history, nominal):
    """Of the ladder by itself, from its motion: the fall's is lost in the contacts, none is gained."""
    ladder = nominal.obstacle
    inertia = np.asarray(ladder.batched_model_fields()["body_inertia"]["ladder"])
    v = history.v[:, RESTS]
    energy = 0.5 * ladder.mass * np.sum(v[:, MOVES] ** 2, axis=-1) + 0.5 * np.sum(inertia * v[:, TURNS] ** 2, axis=-1)
    energy += ladder.mass * GRAVITY * (history.q[:, RESTS, 27] - float(ladder.start().position[0, 2]))
    assert energy.max() < 1e-3 * ladder.mass * GRAVITY * ladder.gap
    assert energy[-1] < -0.5 * ladder.mass * GRAVITY * ladder.gap


@pytest.mark.parametrize("share", [1.05, 0.95])
def test_it_holds_and_slides_in_c(nominal, share):
    """At the same friction; where it holds it creeps no more than in the other engine."""
    ladder = dataclasses.replace(nominal.obstacle, floor_grip=share * least_friction(nominal.obstacle), wall_grip=0.0)
    model = compile_native_model(dataclasses.replace(nominal, obstacle=ladder), 1e-3)
    data, start = mujoco.MjData(model), ladder.start()
    data.qpos[2], data.qpos[PLACE], data.qpos[QUAT] = 400.0, start.position[0], start.quat[0]
    mujoco.mj_step(model, data, 3000)
    settled = data.qpos[PLACE].copy()
    assert (np.linalg.norm(settled - start.position[0]) < 0.02) == (share > 1)
    if share > 1:
        mujoco.mj_step(model, data, 2000)
        assert np.linalg.norm(data.qpos[PLACE] - settled) < 2e-6


def test_mass_and_inertia_are_those_of_its_bars(nominal):
    """As MuJoCo works them out from the boxes that are drawn."""
    model = compile_native_model(nominal, 1e-3)
    spec = mujoco.MjSpec()
    body = spec.worldbody.add_body(name="ladder")
    boxes = [g for g in range(model.ngeom) if model.geom(g).name.startswith(("rail", "rung"))]
    for g in boxes:
        if not model.geom(g).name.endswith("_contact"):
            body.add_geom(type=mujoco.mjtGeom.mjGEOM_BOX, size=model.geom_size[g], pos=model.geom_pos[g], density=1e3)
    other, scale = spec.compile(), nominal.obstacle.mass
    np.testing.assert_allclose(other.body_ipos[1], 0, atol=1e-6)
    inertia = np.sort(other.body_inertia[1]) * scale / other.body_mass[1]
    expected = np.asarray(nominal.obstacle.batched_model_fields()["body_inertia"]["ladder"])
    np.testing.assert_allclose(inertia, np.sort(expected), 1e-5)


def test_feet_feel_rungs_rails_wall_and_ledge(nominal):
    """Each of them deeper than all else: normals are the faces' own, and the ladder's faces belong to it."""
    ladder = nominal.obstacle
    bodies = ladder.start_poses()
    own = np.array([[0.3, 0.0, 0.0], [ladder.width / 2 + 0.001, 0.5, 0.0]])
    own[0, 1] = float(ladder.mass_centre_along_rails) - 3 * ladder.rung_step + 1e-3  # 1 mm under the third rung's top
    others = [[0.0, -1e-3, 1.0], [0.0, -0.3, ladder.ledge_height - 1e-3], [0.0, 2.0, -1e-3]]
    on_it = np.asarray(bodies.position[0]) + own @ np.asarray(bodies.rotation[0]).T
    points = np.concatenate([on_it, others])
    surface = ladder.surface(jnp.asarray(points), (-1,) * 5, bodies)
    np.testing.assert_allclose(surface.depth, 1e-3, atol=1e-6)
    sin, cos = np.sin(ladder.lean), np.cos(ladder.lean)
    wanted = [[0, -cos, sin], [-1, 0, 0], [0, 1, 0], [0, 0, 1], [0, 0, 1]]
    np.testing.assert_allclose(surface.normal, wanted, atol=1e-6)
    assert np.asarray(surface.body).tolist() == [0, 0, -1, -1, -1]
    assert np.asarray(surface.face)[2:].tolist() == [WALL, LEDGE, FLOOR]
    assert np.asarray(surface.face)[:2].min() >= BARS


def test_believed_rungs_are_off_as_of_rails_that_are_seen_at_their_lower_ends():
    """Of rungs 1 % farther apart than believed: from rung to rung by as much more, the lower the higher they are."""
    believed, true = Ladder(), Ladder(rung_step=1.01 * Ladder().rung_step)
    free = true.start()._replace(turn=jnp.array([[0.3, -0.2, 0.1]]))
    seen = state_from_landmarks(believed, landmark_state(true, free))
    up = np.asarray(matrix(free.quat)[0]) @ [0, -1, 0]

    def rungs(ladder, at):
        tops = np.arange(1, 6) * ladder.rung_step - float(ladder.mass_centre_along_rails)
        return np.asarray(at.position[0]) + tops[:, None] * up

    off = (rungs(believed, seen) - rungs(true, free)) @ up
    np.testing.assert_allclose(off, [-0.0042, -0.0084, -0.0126, -0.0168, -0.021], atol=1e-6)
    np.testing.assert_allclose(seen.quat, free.quat)
    shift = np.asarray(seen.position - free.position)[0]
    np.testing.assert_allclose(seen.velocity - free.velocity, [np.cross(free.turn[0], shift)], atol=1e-6)


@pytest.mark.parametrize(
    ("sizes", "said"),
    [({"length": 2.8}, r"obstacle.length = 2.8 .* 2.705 m up"), ({"rungs": 7}, r"obstacle.rungs = 7 .* at most 6")],
)
def test_sizes_that_cannot_be_are_refused(sizes, said):
    with pytest.raises(InputError, match=said):
        Ladder(**sizes).check()

"""Force planning against linear programs, the closed forms of monograph 2.1 and C MuJoCo's statics."""

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
from scipy.optimize import linprog

from sweep.formulas import corner
from sweep.formulas.leg import SIDE_BY_LEG
from sweep.manoeuvres.walking.walk import Stand
from sweep.metrics.outcome import OutcomeThresholds
from sweep.models.case import Case
from sweep.models.contact import Contact
from sweep.models.disturbance import ExecutionFaults
from sweep.models.drive import Drive
from sweep.models.noise import Noise
from sweep.models.obstacles.plane import Plane
from sweep.models.posture import Stance, joint_targets
from sweep.models.robot import Robot
from sweep.models.scene import compile_model
from sweep.planning.force_reserve import force_reserve
from sweep.planning.forces import ForceBounds, ForcePlanningPose, distribute_forces, force_planning_pose, joint_torque

ROBOT = Robot()
UPRIGHT = (0.5**0.5, 0.0, -(0.5**0.5), 0.0)  # x_r up
FACES = 48  # of the pyramid that takes the place of a cone: 0.2 % narrower or wider


def standing(seed: int) -> ForcePlanningPose:
    """On the floor, a corner or a pole, some feet in the air."""
    u = np.random.default_rng(seed).uniform
    along = np.repeat([-u(0.35, 0.6), u(-0.2, 0.2), u(0.35, 0.6)], 2) + u(-0.05, 0.05, 6)
    stands = np.ones(6, bool)
    kind = seed % 3
    if kind == 0:
        feet = np.stack([along, SIDE_BY_LEG * u(0.4, 0.7, 6), np.zeros(6)], -1)
        normal, quat, base = (
            np.tile([0, 0, 1.0], (6, 1)),
            (1.0, 0, 0, 0),
            [u(-0.05, 0.05), u(-0.05, 0.05), u(0.35, 0.6)],
        )
        stands[[0, 3, 4] if seed % 2 else [2]] = False
    else:
        psi = [0.0, np.pi / 4][kind - 1]
        feet = np.stack([np.full(6, u(0.38, 0.48)), SIDE_BY_LEG * u(0.33, 0.42), along], -1)
        normal = np.stack([np.full(6, -np.sin(psi)), SIDE_BY_LEG * np.cos(psi), np.zeros(6)], -1)
        quat, base = UPRIGHT, [0.0, 0, 0]
        lifted = 2 * (seed // 3 % 4)
        stands[lifted : lifted + 2] = False  # from 6 on: none
    stance = Stance(*(jnp.asarray(x, float) for x in (feet, base, quat)))
    return force_planning_pose(ROBOT, stance, jnp.asarray(normal, float), jnp.asarray(stands))


def least_by_program(p: ForcePlanningPose, bounds: ForceBounds, least: str) -> float:
    """The same by a linear program over pyramids, for the friction by bisection; inf where nothing holds."""
    if least != "friction":
        return _program(p, bounds, least)
    low, high = 0.0, float(bounds.friction)
    if not np.isfinite(_program(p, bounds, "torque")):
        return np.inf
    for _ in range(12):
        middle = (low + high) / 2
        holds = np.isfinite(_program(p, bounds._replace(friction=middle), "torque"))
        low, high = (low, middle) if holds else (middle, high)
    return high


def _program(p: ForcePlanningPose, bounds: ForceBounds, least: str) -> float:
    weight = float(p.weight)
    rows, right, balance = [], [], np.zeros((6, 19))
    angles = np.arange(FACES) * 2 * np.pi / FACES
    for i in np.flatnonzero(p.stands):
        arm, normal, own = (np.asarray(x, float) for x in (p.arm[i], p.normal[i], p.own_torque[i] / weight))
        here = slice(3 * i, 3 * i + 3)
        balance[:3, here], balance[3:, here] = np.eye(3), np.cross(arm[None], np.eye(3)).T
        across = np.linalg.svd(normal[None])[2][1:]
        pyramid = np.cos(angles)[:, None] * across[0] + np.sin(angles)[:, None] * across[1] - bounds.friction * normal
        drive = -np.asarray(p.jacobian[i], float).T
        blocks = [
            (pyramid, np.zeros(FACES), 0.0),
            (-normal[None], [-bounds.least_normal / weight], 0.0),
            (normal[None], [0.0 if least == "normal" else bounds.most_normal / weight], float(least == "normal")),
            *((s * drive, (0.0 if least == "torque" else bounds.torque / weight) - s * own, float(least == "torque"))
              for s in (1, -1)),
        ]  # fmt: skip
        for block, limit, level in blocks:
            wide = np.zeros((len(block), 19))
            wide[:, here], wide[:, 18] = block, -level
            rows.append(wide)
            right.append(limit)
    free = [(None, None) if p.stands[k // 3] else (0, 0) for k in range(18)]
    cap = {"torque": bounds.torque, "normal": bounds.most_normal}[least] / weight
    goal = np.eye(19)[18]
    found = linprog(goal, np.concatenate(rows), np.concatenate(right), balance, [0, 0, 1, 0, 0, 0], [*free, (0, cap)])
    return float(found.x[18] * weight) if found.status == 0 else np.inf


@pytest.mark.slow
@pytest.mark.parametrize("least", ["friction", "torque"])
def test_forces_ask_for_hardly_more_than_a_linear_program_finds(least):
    """Within 4 %: the smooth centre's distance to the extreme, and the pyramid's to the cone."""
    poses = [standing(seed) for seed in range(12)]
    bounds = ForceBounds(friction=1.2, torque=200.0, least_normal=2.0, most_normal=3000.0)
    found = jax.jit(jax.vmap(lambda p: distribute_forces(p, bounds, least)))(
        jax.tree.map(lambda *x: jnp.stack(x), *poses)
    )
    best = np.array([least_by_program(p, bounds, least) for p in poses])
    holds = np.isfinite(best)
    assert 0 < holds.sum() < len(poses)  # stances of both kinds
    np.testing.assert_array_equal(np.asarray(found.imbalance) < OutcomeThresholds().imbalance_max, holds)
    got = np.asarray(getattr(found, least))[holds]
    assert np.all(got <= 1.04 * best[holds] + 1e-3)
    assert np.all(got >= 0.99 * best[holds] - 1e-3)
    assert np.all(np.asarray(found.friction)[holds] <= 1.2 * 1.001)
    assert np.all(np.asarray(found.torque)[holds] <= 200.0 * 1.001)


def test_slack_buys_room_to_the_bounds_for_a_little_of_the_effort():
    """Feet bear more evenly on the whole, and friction stays in bounds."""
    poses = jax.tree.map(lambda *x: jnp.stack(x), *(standing(seed) for seed in range(12)))
    bounds = ForceBounds(friction=1.2, torque=200.0, least_normal=2.0, most_normal=3000.0)
    many = jax.jit(jax.vmap(lambda p, slack: distribute_forces(p, bounds._replace(slack=slack), "friction"), (0, None)))
    close, far = many(poses, 0.01), many(poses, 0.3)
    holds = np.asarray(close.imbalance) < OutcomeThresholds().imbalance_max
    normal = [
        np.where(poses.stands, np.sum(found.force * poses.normal, -1), np.inf).min(-1)[holds] for found in (close, far)
    ]
    assert np.mean(normal[1]) > np.mean(normal[0])
    assert np.mean(np.asarray(far.friction - close.friction)[holds]) > 0
    assert np.all(np.asarray(far.friction)[holds] <= 1.2)


@pytest.mark.parametrize("aside", [0.0, 0.1, 0.3, 0.5])  # m; from 0.4 on the mass centre is not over the feet
def test_on_level_ground_the_reserve_is_what_the_lightest_foot_bears_over_the_least(aside):
    feet = jnp.asarray(np.stack([SIDE_BY_LEG * 0.3, [0.4, 0.4, 0.0, 0.0, -0.4, -0.4], np.full(6, -0.5)], -1), float)
    up, none = jnp.tile(jnp.array([0.0, 0.0, 1.0]), (6, 1)), jnp.zeros((6, 3))
    stands = jnp.asarray([True, True, False, False, True, True])

    def at(way):
        shifted = feet + jnp.array([0.0, 1.0, 0.0]) * way
        stance = ForcePlanningPose(shifted, up, stands, jnp.zeros((6, 3, 3)), none, jnp.asarray(100.0))
        return force_reserve(stance, ForceBounds(1.0, 50.0, 5.0))

    value, slope = jax.jit(jax.value_and_grad(at))(aside)
    assert value == pytest.approx((1 - aside / 0.4) / 4 - 0.05, abs=1e-3)
    assert aside == 0 or slope == pytest.approx(-1 / 1.6, rel=0.01)


def test_the_reserve_is_positive_where_forces_hold_and_has_the_slopes_of_small_changes():
    poses = jax.tree.map(lambda *x: jnp.stack(x), *(standing(seed) for seed in range(12)))
    bounds = ForceBounds(friction=1.2, torque=200.0, least_normal=2.0)
    found = jax.jit(jax.vmap(lambda p: distribute_forces(p, bounds, "friction")))(poses)

    def shifted(way, p):
        return force_reserve(p._replace(arm=p.arm + way * jnp.array([1.0, 0.0, 0.0])), bounds)

    there = jax.jit(jax.vmap(jax.value_and_grad(shifted), (None, 0)))
    (less, _), (value, slope), (more, _) = (there(way, poses) for way in (-0.005, 0.0, 0.005))
    np.testing.assert_array_equal(
        np.asarray(value) > 0, np.asarray(found.imbalance) < OutcomeThresholds().imbalance_max
    )
    np.testing.assert_allclose(slope, (more - less) / 0.01, rtol=0.03, atol=0.01)


def on_a_corner(psi: float, eps: float) -> ForcePlanningPose:
    """Four feet of monograph 2.1 on walls at 2 psi, the pairs 1 m apart, the mass centre eps m off."""
    feet = np.zeros((6, 3))
    feet[:4] = [[SIDE_BY_LEG[i] * 0.35, -eps, 0.5 if i < 2 else -0.5] for i in range(4)]
    normal = np.stack([SIDE_BY_LEG * np.cos(psi), np.full(6, np.sin(psi)), np.zeros(6)], -1)
    zero = jnp.zeros((6, 3))
    stands = jnp.asarray([True] * 4 + [False] * 2)
    return ForcePlanningPose(
        jnp.asarray(feet, float), jnp.asarray(normal, float), stands, jnp.zeros((6, 3, 3)), zero, jnp.ones(())
    )


LEAST_NORMAL = jax.jit(lambda p, k: distribute_forces(p, ForceBounds(k, 1.0, most_normal=20.0), "normal"))
LEAST_FRICTION = jax.jit(lambda p, top: distribute_forces(p, ForceBounds(3.0, 1.0, most_normal=top), "friction"))


@pytest.mark.parametrize(("psi", "eps", "k"), [(np.pi / 4, 0.4, 1.1), (np.pi / 4, 0.2, 1.3), (0.0, 0.3, 0.6)])
def test_section_2_1_is_found_again(psi, eps, k):
    """Least squeeze on a corner (2.828 P in the book's example) and on a pole, and the friction that goes with it."""
    squeeze = float(corner.corner_min_squeeze(psi, eps, k).Nhat)
    p = on_a_corner(psi, eps)
    assert float(LEAST_NORMAL(p, k).normal) == pytest.approx(squeeze, rel=0.02)
    assert float(LEAST_FRICTION(p, squeeze).friction) == pytest.approx(k, rel=0.02)


@pytest.mark.parametrize("legs", ["two_link", "three_link"])
def test_joint_torques_are_those_of_the_full_model(legs):
    """Gravity and foot forces at rest as C MuJoCo has them, to the round-off of f32; planned forces carry the base."""
    robot = Robot(legs=legs, coxa=0.05 if legs == "three_link" else 0.0)
    case = Case(robot, Drive(), Contact(), Plane(), Stand(), Noise(), ExecutionFaults())
    feet = np.stack([np.repeat([-0.5, 0.1, 0.55], 2), SIDE_BY_LEG * 0.6, np.zeros(6)], -1)
    stance = Stance(*(jnp.asarray(x, float) for x in (feet, [0.02, -0.01, 0.45], (1.0, 0.0, 0.0, 0.0))))
    p = force_planning_pose(robot, stance, jnp.tile(jnp.array([0.0, 0, 1]), (6, 1)), jnp.ones(6, bool))
    planned = distribute_forces(p, ForceBounds(1.0, 100.0), "torque")

    model = compile_model(case, geoms=False)
    data = mujoco.MjData(model)
    data.qpos[:] = np.concatenate([stance.position, stance.quat, np.ravel(joint_targets(robot, stance)[0])])
    mujoco.mj_forward(model, data)
    needed = data.qfrc_bias.copy()
    for leg, force in enumerate(np.asarray(planned.force)):
        jacobian = np.zeros((3, model.nv))
        mujoco.mj_jacSite(model, data, jacobian, None, model.site(f"foot{leg + 1}").id)
        needed -= jacobian.T @ force
    np.testing.assert_allclose(needed[6:].reshape(6, 3), joint_torque(p, planned.force), atol=2e-3)
    np.testing.assert_allclose(needed[:6], 0.0, atol=0.3)  # N and N m, 0.2 % of the weight

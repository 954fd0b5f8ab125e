"""The robot standing: on three to six feet, at a step's edge, and in the corner below it.

Feet that stand are pushed against each other by stiff drives, and balance does not say how. What must come out is the
equilibrium of weight, drives and contact springs, found here by MuJoCo's kinematics in double precision.
"""

import dataclasses
import io
from collections.abc import Sequence
from contextlib import redirect_stdout
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from jaxtyping import Array, Float

from sweep.config.experiment import compose
from sweep.core.constants import GRAVITY
from sweep.manoeuvres.walking.walk import level_stance
from sweep.models import scene
from sweep.models.case import Case
from sweep.models.legs import JOINT_Q, JOINT_V, N_LEGS
from sweep.models.obstacles.kerb import Kerb
from sweep.models.posture import Stance, joint_targets
from sweep.models.robot import total_mass
from sweep.systems.mujoco_model.mjx import WARP_CONSTRAINTS_PER_CONTACT, WARP_CONTACTS_PER_ROLLOUT
from validity.simulation import simulate

SECONDS, RAMP = 1.0, 0.4
LIFT, SHIFTS = 0.05, 3e-5  # m: of feet that do not stand, and by which targets of those that do are drawn apart
UP, WALL = (0.0, 0.0, 1.0), (-1.0, 0.0, 0.0)
HEIGHT = 0.1  # m, of the kerb


class Spring(NamedTuple):
    """A plane that a foot is in: normal . x = offset."""

    foot: int
    normal: tuple[float, float, float]
    offset: float


class Standing(NamedTuple):
    """How the robot stands, and what its feet are in."""

    name: str
    q: Float[np.ndarray, " 25"]  # at the start
    targets: Float[np.ndarray, "6 3"]  # of its joints, reached within `RAMP`
    springs: tuple[Spring, ...]
    bound: float | None  # on the error of the step, of the weight; None: it does not hold


def rows() -> tuple[Case, list[Standing]]:
    """On six to three feet; front feet on a kerb, nearer and nearer to its edge; below it, pushed against its wall.

    Targets of feet are drawn apart by some hundredths of a millimetre, so that feet push against each other.
    """
    case = dataclasses.replace(compose(["manoeuvre=stand"]).case, obstacle=Kerb(height=HEIGHT))
    _, centres = level_stance(case, 0.3, 0.525)
    front = float(np.asarray(centres)[4, 0])
    sets = {"six": range(6), "five": (0, 1, 2, 4, 5), "four": (0, 1, 4, 5), "three": (0, 3, 4)}
    found = []
    for name, feet in sets.items():
        found.append(_standing(case, f"on {name} feet", [Spring(k, UP, 0.0) for k in feet], _moved(-1.0, 0.0), 0.002))
    for inside, bound in (
        (0.01, 0.002),
        (1e-3, 0.002),
        (1e-4, 0.002),
        (1e-5, None),
    ):  # m; the last is less than its depth
        springs = [Spring(k, UP, HEIGHT if k >= 4 else 0.0) for k in range(N_LEGS)]
        name = f"front feet {1e3 * inside:g} mm from an edge"
        found.append(_standing(case, name, springs, _moved(inside - front, HEIGHT), bound))
    springs = [Spring(k, UP, 0.0) for k in range(N_LEGS)] + [Spring(k, WALL, 0.0) for k in (4, 5)]
    found.append(_standing(case, "front feet in a corner", springs, _moved(-front, 0.0), 0.05, ahead=6e-5))
    return case, found


def _moved(along: float, up: float) -> np.ndarray:
    shift = np.zeros((N_LEGS, 3))
    shift[:, 0], shift[4:, 2] = along, up
    return shift


def _standing(
    case: Case, name: str, springs: Sequence[Spring], moved: np.ndarray, bound: float | None, ahead: float = 0.0
) -> Standing:
    """Its feet in the ground by what bears the weight, from where targets draw them apart; front feet `ahead` (m)."""
    stance, _ = level_stance(case, 0.3, 0.525)
    feet = np.asarray(stance.feet, float) + moved
    stands = sorted({spring.foot for spring in springs})
    off = np.setdiff1d(np.arange(N_LEGS), stands)
    feet[off, 2] += LIFT
    place = np.asarray(stance.position, float) + np.array([moved[0, 0], 0.0, np.mean(moved[:, 2])])
    shifts = np.random.default_rng(0).uniform(-SHIFTS, SHIFTS, (N_LEGS, 3))
    shifts[4:, 0] += ahead

    def angles(feet: np.ndarray) -> np.ndarray:
        aim = Stance(jnp.asarray(feet), jnp.asarray(place), stance.quat)
        return np.asarray(joint_targets(case.robot, aim)[0], float)

    sunk = float(total_mass(case.robot)) * GRAVITY / (len(stands) * case.contact.stiffness)
    q = np.concatenate([place - [0, 0, sunk], [1, 0, 0, 0], angles(feet).ravel()])
    return Standing(name, q, angles(feet + shifts), tuple(springs), bound)


def equilibrium(case: Case, row: Standing) -> Float[np.ndarray, "6 3"]:
    """Forces on the feet (N) where all is in balance: each contact holds where it was at the start."""
    model = scene.compile_model(case, geoms=False)
    data, c = mujoco.MjData(model), float(case.contact.stiffness)
    sites = [model.site(f"foot{k + 1}").id for k in range(N_LEGS)]

    def at(q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """What is left of the balance, and the feet's forces."""
        data.qpos[:] = q
        mujoco.mj_forward(model, data)
        left, forces = -data.qfrc_bias, np.zeros((N_LEGS, 3))
        left[JOINT_V] += float(case.drive.stiffness) * (row.targets.ravel() - q[JOINT_Q])
        for spring in row.springs:
            place, normal = data.site_xpos[sites[spring.foot]], np.array(spring.normal)
            gone = begun[spring.foot] - place
            forces[spring.foot] += c * (
                gone - (gone @ normal) * normal + max(0.0, spring.offset - place @ normal) * normal
            )
        jacobian = np.zeros((3, model.nv))
        for site, force in zip(sites, forces, strict=True):
            mujoco.mj_jacSite(model, data, jacobian, None, site)
            left += jacobian.T @ force
        return left, forces

    data.qpos[:] = row.q
    mujoco.mj_forward(model, data)
    begun, q = data.site_xpos[sites].copy(), row.q.copy()
    for _ in range(20):
        left, slope = at(q)[0], np.zeros((model.nv, model.nv))
        for i, way in enumerate(1e-7 * np.eye(model.nv)):
            ahead = q.copy()
            mujoco.mj_integratePos(model, ahead, way, 1.0)
            slope[:, i] = (at(ahead)[0] - left) / 1e-7
        mujoco.mj_integratePos(model, q, np.linalg.solve(slope, -left), 1.0)
    left, forces = at(q)
    assert np.abs(left).max() < 1e-6, f"{row.name}: no equilibrium"
    return forces


def by_step(
    case: Case,
    rows: Sequence[Standing],
    h: float = 2e-3,
    iterations: int = 2,
    double: bool = False,
    fused: bool = False,
    nominal: Case | None = None,
) -> Float[np.ndarray, "b 6 3"]:
    """Forces on the feet (N) by this package's step, in the mean of the last tenth of a second.

    `nominal` has the structure of a case with swept leaves.
    """
    ramp = np.minimum(np.arange(1, round(SECONDS / h) + 1) * h / RAMP, 1.0)[:, None, None, None]
    begun, targets = (np.stack(x) for x in ([row.q[7:].reshape(6, 3) for row in rows], [row.targets for row in rows]))
    references = begun + ramp * (targets - begun)
    kind = np.float64 if double else np.float32
    q = np.stack([row.q for row in rows]).astype(kind)
    with jax.enable_x64(double):
        found = simulate(case, nominal or case, q, references.astype(kind), h, None, iterations, fused)
    return found.force[-round(0.1 / h) :].mean(axis=0)


def error(case: Case, row: Standing, force: Float[np.ndarray, "6 3"]) -> float:
    """The farthest component from its equilibrium, as a share of the weight."""
    weight = float(total_mass(case.robot)) * GRAVITY
    return float(np.abs(force - equilibrium(case, row)).max() / weight)


def by_native(case: Case, row: Standing) -> Float[np.ndarray, "6 3"]:
    """The same by C MuJoCo as the native engine has it."""
    model = scene.compile_native_model(case, 1e-3)
    data = mujoco.MjData(model)
    data.qpos[:] = row.q
    kept, stiffness = [], float(case.drive.stiffness)
    for k in range(round(SECONDS / 1e-3)):
        told = row.q[7:] + min(1.0, (k + 1) * 1e-3 / RAMP) * (row.targets.ravel() - row.q[7:])
        data.ctrl[:] = stiffness * told
        mujoco.mj_step(model, data)
        kept.append(-data.sensordata[: 3 * N_LEGS].reshape(N_LEGS, 3))
    return np.mean(kept[-100:], axis=0)


def by_mjx(case: Case, rows: Sequence[Standing], impl: str) -> Float[np.ndarray, "b 6 3"]:
    """The native engine's model by MJX, or with `impl="warp"`, on a GPU, by MuJoCo Warp, in single precision."""
    with redirect_stdout(io.StringIO()):  # which it prints as it is imported
        from mujoco import mjx

    spec = scene.build_native_spec(case, 1e-3)
    spec.option.enableflags &= ~int(mujoco.mjtEnableBit.mjENBL_ENERGY)
    for sensor in [*spec.sensors]:  # of contacts, which MJX does not add up
        spec.delete(sensor)
    model = spec.compile()
    data = mujoco.MjData(model)
    rooms = {
        "naconmax": WARP_CONTACTS_PER_ROLLOUT,
        "njmax": WARP_CONSTRAINTS_PER_CONTACT * WARP_CONTACTS_PER_ROLLOUT + model.njnt + 2 * model.nv,
    }
    there, found = mjx.put_model(model, impl=impl), []

    @partial(jax.jit, compiler_options={"xla_backend_optimization_level": 0})  # run a few times
    def stood(now: Any, controls: Array) -> Any:
        def ahead(now: Any, told: Array) -> Any:
            now = mjx.step(there, now.replace(ctrl=told))
            return now, (now.qpos, now.qfrc_constraint)

        return jax.lax.scan(ahead, now, controls)[1]

    ramp = np.minimum(np.arange(1, round(SECONDS / 1e-3) + 1) * 1e-3 / RAMP, 1.0)[:, None]
    for row in rows:
        data.qpos[:] = row.q
        mujoco.mj_forward(model, data)
        begun = mjx.put_data(model, data, impl=impl, **(rooms if impl == "warp" else {}))
        told = float(case.drive.stiffness) * (row.q[7:] + ramp * (row.targets.ravel() - row.q[7:]))
        q, loads = (np.asarray(x[-100:], float).mean(axis=0) for x in stood(begun, jnp.asarray(told, jnp.float32)))
        data.qpos[:] = q
        mujoco.mj_forward(model, data)
        found.append([_on_foot(model, data, leg, loads) for leg in range(N_LEGS)])
    return np.array(found)


def _on_foot(model: mujoco.MjModel, data: mujoco.MjData, leg: int, loads: np.ndarray) -> np.ndarray:
    """The force (3,) on a foot (N) of what contacts `loads` joints with."""
    jacobian, own = np.zeros((3, model.nv)), slice(6 + 3 * leg, 9 + 3 * leg)
    mujoco.mj_jacSite(model, data, jacobian, None, model.site(f"foot{leg + 1}").id)
    return np.linalg.solve(jacobian[:, own].T, loads[own])


def least_squares(case: Case, row: Standing) -> Float[np.ndarray, "6 3"]:
    """The least forces that balance the weight, as if nothing pushed feet against each other."""
    model = scene.compile_model(case, geoms=False)
    data = mujoco.MjData(model)
    data.qpos[:] = row.q
    mujoco.mj_forward(model, data)
    stands = sorted({spring.foot for spring in row.springs})
    centre, blocks = data.subtree_com[1], []
    for foot in stands:
        x, y, z = data.site_xpos[model.site(f"foot{foot + 1}").id] - centre
        blocks.append(np.concatenate([np.eye(3), [[0, -z, y], [z, 0, -x], [-y, x, 0]]]))
    weight = np.array([0, 0, float(total_mass(case.robot)) * GRAVITY, 0, 0, 0])
    forces = np.zeros((N_LEGS, 3))
    forces[stands] = np.linalg.lstsq(np.hstack(blocks), weight)[0].reshape(-1, 3)
    return forces

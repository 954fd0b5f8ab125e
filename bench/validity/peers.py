"""Scenes before MuJoCo: the same bodies, whose points are spheres of a millimetre that meet planes and boxes."""

import io
from contextlib import redirect_stdout
from functools import partial
from importlib.util import find_spec
from typing import Any, NamedTuple

import jax
import mujoco
import numpy as np

from sweep.core.constants import GRAVITY
from sweep.models.obstacles.geoms import STIFF_CONTACT
from sweep.models.obstacles.surface import FOOT_RADIUS
from validity.scenes import History, Scene, Touch

CONES = {"elliptic": mujoco.mjtCone.mjCONE_ELLIPTIC, "pyramidal": mujoco.mjtCone.mjCONE_PYRAMIDAL}


class Settings(NamedTuple):
    """How MuJoCo solves contacts."""

    cone: str
    time_step: float
    impratio: float = 1.0
    stiff: bool = False  # as the native engine's feet, else MuJoCo's own defaults


NATIVE = Settings("elliptic", 1e-3, 100.0, True)
PIECE = 50  # steps of a program of MJX
ELLIPTIC, PYRAMIDAL = Settings("elliptic", 2e-3), Settings("pyramidal", 2e-3)


def model(scene: Scene, settings: Settings) -> mujoco.MjModel:
    """A scene as MuJoCo has it. Points are spheres of `FOOT_RADIUS`, whose planes lie as much lower."""
    spec = mujoco.MjSpec()
    spec.option.gravity, spec.option.timestep = [0, 0, -GRAVITY], settings.time_step
    spec.option.cone, spec.option.impratio = CONES[settings.cone], settings.impratio
    if settings.stiff:
        spec.option.integrator, spec.option.iterations = mujoco.mjtIntegrator.mjINT_IMPLICITFAST, 50
    for k, own in enumerate(scene.bodies):
        body = spec.worldbody.add_body(name=f"body{k}", pos=own.position, quat=own.quat, explicitinertial=True,
                                       mass=own.mass, inertia=own.inertia, ipos=[0, 0, 0])  # fmt: skip
        body.add_freejoint()
    for i, touch in enumerate(scene.touches):
        _add_touch(spec, i, touch, settings)
    return spec.compile()


def _add_touch(spec: mujoco.MjSpec, number: int, touch: Touch, settings: Settings) -> None:
    apart = {"contype": 0, "conaffinity": 0, "mass": 0.0}
    radius = touch.radius or FOOT_RADIUS
    spec.body(f"body{touch.body}").add_geom(
        name=f"point{number}", type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[radius, 0, 0], pos=touch.at, **apart
    )
    normal, quat = np.array(touch.normal), np.zeros(4)
    mujoco.mju_quatZ2Vec(quat, normal)
    place = (touch.offset + touch.radius - radius) * normal
    name = f"plane{number}"
    if touch.on < 0:
        kind = mujoco.mjtGeom.mjGEOM_PLANE
        spec.worldbody.add_geom(name=name, type=kind, size=[1, 1, 1], quat=quat, pos=place, **apart)
    else:
        half = 2.0
        spec.body(f"body{touch.on}").add_geom(
            name=name, type=mujoco.mjtGeom.mjGEOM_BOX, size=[half] * 3, quat=quat, pos=place - half * normal, **apart
        )
    law = {"solref": STIFF_CONTACT["solref"], "solimp": STIFF_CONTACT["solimp"]} if settings.stiff else {}
    friction, condim = [touch.friction, touch.friction, 0.0, 0.0, 0.0], 3 if touch.friction else 1
    spec.add_pair(
        name=f"pair{number}", geomname1=f"point{number}", geomname2=name, condim=condim, friction=friction, **law
    )


def _begun(scene: Scene, made: mujoco.MjModel) -> mujoco.MjData:
    data = mujoco.MjData(made)
    for k, body in enumerate(scene.bodies):
        data.qpos[7 * k : 7 * k + 7] = [*body.position, *body.quat]
        data.qvel[6 * k : 6 * k + 6] = [*body.velocity, *body.turn]
        data.xfrc_applied[k + 1, :3] = body.force
    return data


def by_mujoco(scene: Scene, settings: Settings) -> History:
    """A scene simulated by C MuJoCo."""
    made = model(scene, settings)
    data, steps = _begun(scene, made), round(scene.seconds / settings.time_step)
    q, v = np.zeros((steps, made.nq)), np.zeros((steps, made.nv))
    for i in range(steps):
        mujoco.mj_step(made, data)
        q[i], v[i] = data.qpos, data.qvel
    load, force = np.zeros(len(scene.touches)), np.zeros(6)
    for i, contact in enumerate(data.contact):
        mujoco.mj_contactForce(made, data, i, force)
        load[_touch(made, contact.geom)] += force[0]
    return _history(q, v, settings.time_step, load)


def _touch(made: mujoco.MjModel, geoms: np.ndarray) -> int:
    names = [made.geom(int(g)).name for g in geoms]
    return int(next(name for name in names if name.startswith("point"))[5:])


def _history(q: np.ndarray, v: np.ndarray, h: float, load: np.ndarray) -> History:
    steps, count = len(q), q.shape[1] // 7
    q, v = q.reshape(steps, count, 7), v.reshape(steps, count, 6)
    return History(h * (1 + np.arange(steps)), q[..., :3], q[..., 3:], v[..., :3], v[..., 3:], load)


def by_mjx(scene: Scene, settings: Settings, impl: str = "jax") -> History:
    """The same by MJX, in single precision: its own step, or with `impl="warp"`, on a GPU, MuJoCo Warp's."""
    with redirect_stdout(io.StringIO()):  # which it prints as it is imported
        from mujoco import mjx

    if not any(touch.friction for touch in scene.touches):  # its elliptic cones fail where there are none
        settings = settings._replace(cone="pyramidal")
    made = model(scene, settings)
    there, begun = mjx.put_model(made, impl=impl), _begun(scene, made)
    mujoco.mj_forward(made, begun)
    data, pieces, steps = mjx.put_data(made, begun, impl=impl), [], round(scene.seconds / settings.time_step)
    for _ in range(0, steps, PIECE):
        data, piece = _ahead(there, data)
        pieces.append(piece)
    q, v = (np.concatenate([np.asarray(piece[k], float) for piece in pieces])[:steps] for k in range(2))
    return _history(q, v, settings.time_step, np.full(len(scene.touches), np.nan))


@partial(jax.jit, compiler_options={"xla_backend_optimization_level": 0})  # run a few times
def _ahead(there: Any, data: Any) -> Any:
    """A piece of a scene by MJX; scenes of as many bodies and touches share a program."""
    from mujoco import mjx

    def ahead(data: Any, _: None) -> Any:
        data = mjx.step(there, data)
        return data, (data.qpos, data.qvel)

    return jax.lax.scan(ahead, data, length=PIECE)


def histories(scene: Scene) -> dict[str, History]:
    """A scene by all that simulate beside this package's step."""
    found = {"native": by_mujoco(scene, NATIVE), "C elliptic": by_mujoco(scene, ELLIPTIC)}
    found["C pyramidal"] = by_mujoco(scene, PYRAMIDAL)
    found["MJX elliptic"] = by_mjx(scene, ELLIPTIC)
    return found


def has_warp() -> bool:
    """Whether MuJoCo Warp is there, and a GPU that it is made for."""
    return jax.default_backend() == "gpu" and find_spec("warp") is not None


def by_warp(scene: Scene) -> dict[str, History]:
    """A scene by MuJoCo Warp, where it is there."""
    return {"Warp elliptic": by_mjx(scene, ELLIPTIC, "warp")} if has_warp() else {}

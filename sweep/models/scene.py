"""MuJoCo model of a case, compiled once; the fields that vary are a pure JAX function of the parameters.

`compile_model` makes an `MjModel` (for `native`, for drawing, and once for `mjx`); `leaves` gives the arrays of that
model that depend on parameters, under vmap, so that sizes and masses are swept without compiling anything again.
"""

from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from jaxtyping import Array

from sweep.core.constants import GRAVITY
from sweep.core.parameters import InputError
from sweep.formulas.leg import SIDE_BY_LEG
from sweep.models.case import Case
from sweep.models.collisions import enable_collisions
from sweep.models.legs import JOINT_NAMES, LEGS
from sweep.models.obstacles.geoms import COLLISION_GROUP, RENDER_GROUP, STIFF_CONTACT
from sweep.models.obstacles.surface import FOOT_RADIUS
from sweep.models.posture import leg_mounts
from sweep.models.robot import link_names

_RIGHT, _LEFT = (0.85, 0.33, 0.20, 1.0), (0.20, 0.45, 0.75, 1.0)


def _rod(mass: Array | float, length: Array | float, radius: Array | float) -> tuple[Array, Array]:
    """Moments of inertia of a cylinder about its centre: across and along its axis (kg m^2)."""
    return jnp.asarray(mass * (3 * radius**2 + length**2) / 12), jnp.asarray(mass * radius**2 / 2)


def batched_model_fields(case: Case) -> dict[str, dict[str, Array]]:
    """Return the fields of the MuJoCo model that depend on parameters, for a batch of rollouts or traced parameters.

    Returns:
        Arrays by field of `MjModel`, then by the name of a body, site or (for `dof_armature`) joint.
    """
    robot = case.robot
    zero = jnp.zeros(())
    hips = leg_mounts(robot).hips
    box = jnp.stack([jnp.asarray(s) for s in (robot.body_length, robot.body_width, robot.body_height)])
    out: dict[str, dict[str, Array]] = {
        "body_pos": {},
        "body_ipos": {},
        "body_mass": {"base": jnp.asarray(robot.body_mass)},
        "body_inertia": {"base": robot.body_mass / 12 * (jnp.sum(box**2) - box**2)},
        "site_pos": {},
        "dof_armature": {name: jnp.asarray(case.drive.armature) for name in JOINT_NAMES},
    }
    for leg in LEGS:
        side = float(SIDE_BY_LEG[leg - 1])
        start = hips[leg - 1]
        for link in link_names(robot):
            length, mass = getattr(robot, link), getattr(robot, f"{link}_mass")
            across, along = _rod(mass, length, robot.link_radius)
            body = f"{link}{leg}"
            # at zero angles the coxa points outward, the thigh along -z (left) or z (right), the shin along z
            y, z = {"coxa": (side, 0.0), "thigh": (0.0, -side), "shin": (0.0, 1.0)}[link]
            end = jnp.stack([zero, y * length, z * length])
            out["body_pos"][body] = start
            out["body_ipos"][body] = end / 2
            out["body_mass"][body] = jnp.asarray(mass)
            out["body_inertia"][body] = jnp.stack([across, along, across] if y else [across, across, along])
            start = end
        out["site_pos"][f"foot{leg}"] = start
    for field, values in case.obstacle.batched_model_fields().items():
        out[field].update(values)
    return out


_leaves = jax.jit(batched_model_fields)  # a row of a table of cases would take 50 times as long operation by operation


def compile_model(case: Case, geoms: bool = True) -> mujoco.MjModel:
    """Build and compile the MuJoCo model of robot and obstacle from the parameters of a rollout.

    Args:
        case: Parameters, plain numbers.
        geoms: Whether the model has shapes; the smooth dynamics need none.

    Raises:
        InputError: MuJoCo cannot build these sizes.
    """
    spec = build_spec(case, geoms)
    if not geoms:
        for element in [*spec.pairs, *spec.geoms]:
            spec.delete(element)
    try:
        return spec.compile()
    except ValueError as error:  # such as a mass too small to divide by
        reason = " ".join(str(error).removeprefix("Error: ").split())
        raise InputError(f"robot or obstacle is not allowed: MuJoCo cannot compile its model: {reason}") from None


def find_too_light_bodies(case: Case) -> np.ndarray:
    """Return for which rollouts of a batch MuJoCo would refuse the model, as a body has too little mass or inertia.

    Args:
        case: the case, with varied quantities as arrays (n,).

    Returns:
        Booleans (n,).
    """
    leaves, structure = jax.tree.flatten(case)
    axes = tuple(0 if np.ndim(leaf) else None for leaf in leaves)
    return np.asarray(_least_inertias(structure, axes, leaves)) < mujoco.mjMINVAL


@partial(jax.jit, static_argnums=(0, 1))  # at module level, so that tables checked in chunks compile once
def _least_inertias(structure: Any, axes: tuple[int | None, ...], leaves: list[Any]) -> Array:
    """Return the smallest mass or moment of inertia (n,) of each case of a batch, whose leaves have these axes."""

    def least(*values: Any) -> Array:
        fields = batched_model_fields(jax.tree.unflatten(structure, values))
        parts = [*fields["body_mass"].values(), *fields["body_inertia"].values()]
        return jnp.min(jnp.concatenate([jnp.ravel(part) for part in parts]))

    return jax.vmap(least, in_axes=axes)(*leaves)


def build_spec(case: Case, geoms: bool = True) -> mujoco.MjSpec:
    """Build the MuJoCo spec of robot and obstacle from the parameters of a rollout.

    Args:
        case: Parameters, plain numbers.
        geoms: Whether the robot has shapes.

    Raises:
        InputError: A robot of two links has a coxa.
    """
    robot = case.robot
    spec = mujoco.MjSpec()
    spec.compiler.degree = False
    spec.option.gravity = [0, 0, -GRAVITY]
    spec.memory = 4 << 20
    _add_looks(spec)
    values = jax.tree.map(np.asarray, _leaves(case))
    base = spec.worldbody.add_body(name="base")
    base.add_freejoint(name="root")
    _set_inertia(base, "base", values)
    if geoms:
        half = [robot.body_length / 2, robot.body_width / 2, robot.body_height / 2]
        base.add_geom(type=mujoco.mjtGeom.mjGEOM_BOX, size=half, rgba=(0.35, 0.35, 0.4, 1.0), **_DRAWING)
    for leg in LEGS:
        _add_leg(spec, base, case, leg, values, geoms)
    case.obstacle.add_to(spec, float(case.contact.friction))
    return spec


_DRAWING = {"contype": 0, "conaffinity": 0, "mass": 0.0, "group": RENDER_GROUP}


def _add_looks(spec: mujoco.MjSpec) -> None:
    spec.visual.global_.offwidth, spec.visual.global_.offheight = 1280, 960
    spec.visual.headlight.ambient = [0.45, 0.45, 0.45]
    spec.worldbody.add_light(pos=[2, 3, 8], dir=[-0.2, -0.3, -1], type=mujoco.mjtLightType.mjLIGHT_DIRECTIONAL)
    kinds, looks = mujoco.mjtTexture, mujoco.mjtBuiltin
    for name, kind, look, width, height, one, other in (
        ("ground", kinds.mjTEXTURE_2D, looks.mjBUILTIN_CHECKER, 256, 256, [0.80, 0.83, 0.80], [0.70, 0.74, 0.70]),
        ("sky", kinds.mjTEXTURE_SKYBOX, looks.mjBUILTIN_GRADIENT, 64, 384, [0.93, 0.95, 0.98], [0.72, 0.80, 0.90]),
        ("ball", kinds.mjTEXTURE_CUBE, looks.mjBUILTIN_CHECKER, 96, 96, [0.90, 0.75, 0.45], [0.78, 0.60, 0.34]),
    ):
        spec.add_texture(name=name, type=kind, builtin=look, width=width, height=height, rgb1=one, rgb2=other)
    for name in ("ground", "ball"):
        material = spec.add_material(name=name, texrepeat=[1, 1], texuniform=True)
        material.textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = name


def _set_inertia(body: mujoco.MjsBody, name: str, values: dict[str, dict[str, np.ndarray]]) -> None:
    body.explicitinertial = True
    body.mass = float(values["body_mass"][name])
    body.inertia = _correct_rounding(np.asarray(values["body_inertia"][name], float))
    body.ipos = np.asarray(values["body_ipos"].get(name, np.zeros(3)), float)


def _correct_rounding(inertia: np.ndarray) -> np.ndarray:
    """Moments of inertia (3,), corrected by rounding so that none exceeds the sum of the others."""
    return np.minimum(inertia, np.roll(inertia, 1) + np.roll(inertia, 2))


def _add_leg(
    spec: mujoco.MjSpec,
    base: mujoco.MjsBody,
    case: Case,
    leg: int,
    values: dict[str, dict[str, np.ndarray]],
    geoms: bool,
) -> None:
    """Add the bodies, hinges, drives and foot of one leg."""
    robot, yaw = case.robot, float(leg_mounts(case.robot).yaw[leg - 1])
    names = link_names(robot)
    hinges = {"coxa": ["alpha"], "thigh": ["beta"], "shin": ["gamma"]}
    if "coxa" not in names:
        hinges["thigh"] = ["alpha", "beta"]
    parent = base
    for link in names:
        name = f"{link}{leg}"
        body = parent.add_body(name=name, pos=np.asarray(values["body_pos"][name], float))
        if parent is base:
            body.quat = [np.cos(yaw / 2), 0, 0, np.sin(yaw / 2)]
        _set_inertia(body, name, values)
        for joint in hinges[link]:
            axis = [0, 0, 1] if joint == "alpha" else [1, 0, 0]
            body.add_joint(name=f"{joint}{leg}", axis=axis, armature=case.drive.armature)
            # a motor; the native engine turns it into the clamped servo of (1.2.1)
            spec.add_actuator(name=f"{joint}{leg}", target=f"{joint}{leg}", trntype=mujoco.mjtTrn.mjTRN_JOINT)
        end = 2 * np.asarray(values["body_ipos"][name], float)
        if geoms and np.any(end):
            colour = _LEFT if leg % 2 == 0 else _RIGHT
            body.add_geom(
                type=mujoco.mjtGeom.mjGEOM_CYLINDER,
                fromto=[0, 0, 0, *end],
                size=[robot.link_radius, 0, 0],
                rgba=colour,
                **_DRAWING,
            )
        parent = body
    end = np.asarray(values["site_pos"][f"foot{leg}"], float)
    parent.add_site(name=f"foot{leg}", pos=end, size=[1.2 * robot.link_radius] * 3)
    if geoms:
        parent.add_geom(
            name=f"foot{leg}",
            type=mujoco.mjtGeom.mjGEOM_SPHERE,
            pos=end,
            size=[FOOT_RADIUS, 0, 0],
            contype=1,
            conaffinity=0,
            friction=[0, 0, 0],
            mass=0.0,
            group=COLLISION_GROUP,
            **STIFF_CONTACT,
        )
        force, net = 1 << int(mujoco.mjtConDataField.mjCONDATA_FORCE), 3  # summed over the foot's contacts, world axes
        spec.add_sensor(
            name=f"force{leg}",
            type=mujoco.mjtSensor.mjSENS_CONTACT,
            objtype=mujoco.mjtObj.mjOBJ_GEOM,
            objname=f"foot{leg}",
            intprm=[force, net, 1],
        )


def compile_native_model(case: Case, time_step: float, solid: bool = False) -> mujoco.MjModel:
    """Compile the MuJoCo model for the native engine (C MuJoCo).

    Args:
        case: Parameters, plain numbers.
        time_step: Physics step (s).
        solid: Whether links and base collide, too, not only feet.
    """
    return build_native_spec(case, time_step, solid).compile()


def build_native_spec(case: Case, time_step: float, solid: bool = False) -> mujoco.MjSpec:
    """Build the MuJoCo spec of the native engine (C MuJoCo), with contacts, servos of (1.2.1) and foot force sensors.

    The settings hold a stiff robot still: elliptic cones, impratio 100, stiff contact.

    Args:
        case: Parameters, plain numbers.
        time_step: Physics step (s).
        solid: Whether links and base collide, too, not only feet.
    """
    spec = build_spec(case)
    spec.option.timestep = time_step
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    spec.option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
    spec.option.impratio = 100
    if not case.obstacle.free_bodies:  # legs share no joint until they load the same body
        spec.option.jacobian = mujoco.mjtJacobian.mjJAC_SPARSE
    spec.option.iterations = 50
    spec.option.enableflags |= int(mujoco.mjtEnableBit.mjENBL_ENERGY)
    drive, execution = case.drive, case.execution
    dead, limit = round(float(execution.dead_joint)), execution.torque_scale * drive.torque_limit
    for number, (name, motor) in enumerate(zip(JOINT_NAMES, spec.actuators, strict=True)):
        alive = float(number != dead)
        motor.gainprm[0] = alive  # controls are torques: stiffness times target, and what comes on top
        motor.biastype = mujoco.mjtBias.mjBIAS_AFFINE
        motor.biasprm[1:3] = -alive * drive.stiffness, -alive * drive.damping
        motor.forcelimited, motor.forcerange = True, [-limit, limit]
        spec.joint(name).damping[0] = drive.back_emf
    if solid:
        enable_collisions(spec, case, link_names(case.robot))
    return spec

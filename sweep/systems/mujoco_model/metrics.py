"""Metrics of MuJoCo models, accumulated as sums and extremes over physics steps; names end in their units."""

from typing import Any

import mujoco
import numpy as np

from sweep.contract.engine import Metrics
from sweep.core.constants import GRAVITY, LOADED
from sweep.systems.mujoco_model.model_spec import ModelSpec, angle_deg, array_namespace, cosine_of_tilt

STEPS = ("qpos", "qvel", "actuator_force", "actuator_velocity", "sensordata", "site_xpos")  # what a step tells
BALANCE = ("qacc", "qfrc_smooth", "qfrc_constraint")  # of which `unbalanced` is made, beside M
LIMITED = 0.999  # share of a limit, from which an actuator is at it
COLUMNS = {  # what each metric means; those of a base, feet, collisions or limits where the model has them
    "base_height_min_m": "least height of the first free joint's body",
    "tilt_max_deg": "largest angle of that body from how it stood",
    "travelled_m": "way of that body along `direction`",
    "drift_m": "way of that body to the left of `direction`",
    "speed_mps": "mean speed along `direction`",
    "cost_of_transport": "positive work of the actuators over weight and way along `direction`",
    "slip_max_m": "farthest that a loaded foot moved along the ground",
    "load_max_n": "largest load of a foot",
    "collision_share": "share of the steps in which a sensor of `collisions` touched",
    "collision_impulse_ns": "load of the sensors of `collisions`, added up over time",
    "saturated_share": "share of the steps, over all actuators with a limit of force, at that limit",
    "joint_limit_share": "share of the steps, over all joints with a range, at an end of it",
    "unsolved_share": "share of the steps that the contact solver left unsolved",
    "energy_j": "positive work of the actuators",
    "energy_gained_j": "growth of mechanical energy beyond the work of actuators and pushes",
    "duration_s": "simulated time",
    "not_finite": "1 where a number was not finite",
    "buffer_full": "1 where MuJoCo's buffer for contacts or constraints was full",
}
Tree = dict[str, Any]
BALANCED = 0.01  # share of the forces, up to which those of a step are in balance


class MetricAccumulator:
    """Accumulates the metrics of n rollouts over control ticks, in trees of NumPy or JAX arrays (n, ...).

    Metrics of the base and of touch sensors exist only where the model has these.
    """

    def __init__(self, own: ModelSpec):
        model = own.model
        self._base, self._step = own.base_address, model.opt.timestep
        self._along = np.array(own.config.direction) / np.linalg.norm(own.config.direction)
        self._left = np.cross([0.0, 0.0, 1.0], self._along) if self._along[:2].any() else np.array([0.0, 1.0, 0.0])
        self._left /= np.linalg.norm(self._left)
        self._forced = np.flatnonzero(model.actuator_forcelimited)
        joints = np.flatnonzero(model.jnt_limited.astype(bool) & (model.jnt_type >= int(mujoco.mjtJoint.mjJNT_SLIDE)))
        self._joints, self._places = joints, model.jnt_qposadr[joints]
        self._touch = model.sensor_adr[feet := own.touch_sensors("feet")]
        self._sites = model.sensor_objid[feet]
        self._collide = model.sensor_adr[own.touch_sensors("collisions")]

    def start(self, qpos: Any, qvel: Any) -> Tree:
        """Return the initial accumulator.

        Args:
            qpos: Positions (n, nq).
            qvel: Velocities (n, nv).
        """
        xp, n, feet = array_namespace(qpos), len(qpos), len(self._sites)
        none = xp.zeros_like(qpos[:, 0])
        sums = (
            "steps",
            "power",
            "work",
            "tilt",
            "slip",
            "load",
            "full",
            "ends",
            "unsolved",
            "touched",
            "impulse",
            "pushed",
        )
        down = {"down": xp.zeros((n, feet, 2), qpos.dtype), "loaded": xp.zeros((n, feet), bool)}
        poses = {"start": qpos, "last": qpos, "speed": qvel, "depth": none - np.inf, "finite": xp.ones(n, bool)}
        return dict.fromkeys(sums, none) | down | poses

    @np.errstate(invalid="ignore", over="ignore")
    def update(self, sofar: Tree, steps: Tree, limits: Tree, going: Any) -> Tree:
        """Add one tick to the running metrics.

        Rollouts that are not `going` (n,) are over. `limits` are the models' own: `actuator_forcerange`, `jnt_range`,
        (n, ..., 2).
        """
        qpos, force, number = steps["qpos"], steps["actuator_force"], steps["qpos"].shape[1]
        xp, at = array_namespace(qpos), self._base
        most, sums, new = {}, {"steps": number, "unsolved": steps["unsolved"].sum(axis=1)}, {}
        finite = xp.isfinite(qpos.sum(axis=(1, 2)) + steps["qvel"].sum(axis=(1, 2)))
        power = force * steps["actuator_velocity"]
        if "push_work" in steps:
            sums["pushed"] = steps["push_work"]  # J
        sums |= {"power": xp.maximum(power, 0.0).sum(axis=(1, 2)), "work": power.sum(axis=(1, 2))}
        if at is not None:
            upright = slice(at + 3, at + 7)
            most["depth"] = -qpos[..., at + 2].min(axis=1)
            most["tilt"] = angle_deg(cosine_of_tilt(qpos[..., upright], sofar["start"][:, None, upright]).min(axis=1))
        if len(self._forced):
            sums["full"] = share_at_limit(force[..., self._forced], limits["actuator_forcerange"][:, self._forced])
        if len(self._joints):
            sums["ends"] = share_at_limit(qpos[..., self._places], limits["jnt_range"][:, self._joints])
        if len(self._collide):
            touch = steps["sensordata"][..., self._collide].sum(axis=2)
            sums |= {"touched": (touch > 0).sum(axis=1), "impulse": touch.sum(axis=1)}
        if len(self._sites):
            load = steps["sensordata"][..., self._touch]
            loaded, place = load > LOADED, steps["site_xpos"][:, :, self._sites, :2]
            before = xp.concatenate([sofar["loaded"][:, None], loaded[:, :-1]], axis=1)
            landed = xp.where(loaded & ~before, xp.arange(number)[:, None], -1)
            when = xp.maximum.accumulate(landed, axis=1)[..., None]  # the last step at which it came down
            there = xp.take_along_axis(place, xp.maximum(when, 0), axis=1)
            down = xp.where(when >= 0, there, sofar["down"][:, None])
            moved = xp.hypot(*xp.moveaxis(place - down, -1, 0)) * loaded
            most |= {"load": load.max(axis=(1, 2)), "slip": moved.max(axis=(1, 2))}
            new |= {"down": down[:, -1], "loaded": loaded[:, -1]}
        new |= {name: xp.where(going, xp.maximum(sofar[name], value), sofar[name]) for name, value in most.items()}
        new |= {name: sofar[name] + going * value for name, value in sums.items()}
        ends = {"last": qpos[:, -1], "speed": steps["qvel"][:, -1]}
        new |= {name: xp.where(going[:, None], value, sofar[name]) for name, value in ends.items()}
        return {**sofar, **new, "finite": sofar["finite"] & (~going | finite)}

    def compute(self, sofar: Tree, mass: Any, gained: Any, broken: Any, full: Any) -> Metrics:
        """By name, (n,), of models of a `mass` (n,) kg whose energy is `gained` (n,) J more than at the start.

        `broken` and `full` are what an engine found itself.
        """
        found: Metrics = {}
        sofar = {name: np.asarray(value) for name, value in sofar.items()}
        steps, step = np.maximum(sofar["steps"], 1), self._step
        energy = sofar["power"] * step
        if self._base is not None:
            way = (sofar["last"] - sofar["start"])[:, self._base : self._base + 3]
            along = way @ self._along
            found |= {"base_height_min_m": -sofar["depth"], "tilt_max_deg": sofar["tilt"], "travelled_m": along}
            found |= {"drift_m": way @ self._left, "speed_mps": along / (steps * step)}
            found["cost_of_transport"] = energy / (mass * GRAVITY * np.maximum(np.abs(along), 1e-9))
        if len(self._sites):
            found |= {"slip_max_m": sofar["slip"], "load_max_n": sofar["load"]}
        if len(self._collide):
            found |= {"collision_share": sofar["touched"] / steps, "collision_impulse_ns": sofar["impulse"] * step}
        if len(self._forced):
            found["saturated_share"] = sofar["full"] / steps
        if len(self._joints):
            found["joint_limit_share"] = sofar["ends"] / steps
        found |= {"unsolved_share": sofar["unsolved"] / steps, "energy_j": energy}
        found |= {
            "energy_gained_j": gained - sofar["work"] * step - sofar["pushed"],
            "duration_s": sofar["steps"] * step,
        }
        finite = sofar["finite"] & np.isfinite(np.stack(list(found.values()))).all(axis=0) & ~broken
        return {**found, "not_finite": (~finite).astype(float), "buffer_full": full.astype(float)}


def metric_names(own: ModelSpec) -> tuple[str, ...]:
    """Return the names of the metrics that rollouts of a model have."""
    meter, one = MetricAccumulator(own), np.ones(1)
    still = own.model.qpos0[None], np.zeros((1, own.model.nv))
    return tuple(meter.compute(meter.start(*still), one, one, one == 0, one == 0))


@np.errstate(invalid="ignore", over="ignore")
def is_unbalanced(mass: Any, qacc: Any, smooth: Any, constraint: Any) -> Any:
    """Which steps (...) a solver left unsolved: of M a = f + Jᵀλ more than a small share does not hold.

    `mass` is M (..., nv, nv), `smooth` f and `constraint` Jᵀλ (..., nv). Each of their numbers counts by its own
    inertia, M's diagonal, so that forces and moments are both in √kg m/s². What is left over is the gradient of what
    the solver minimizes, and 0 where it has.
    """
    xp = array_namespace(mass)
    left = (mass @ qacc[..., None])[..., 0] - smooth - constraint
    inertia = xp.diagonal(mass, axis1=-2, axis2=-1)
    left, smooth, constraint = (xp.sqrt((one**2 / inertia).sum(axis=-1)) for one in (left, smooth, constraint))
    return left > BALANCED * (smooth + constraint)


def share_at_limit(values: Any, range_: Any) -> Any:
    """Shares (n,) of values (n, s, k) that are at an end of their ranges (n, k, 2), summed over s."""
    low, high = array_namespace(values).moveaxis(range_[:, None], -1, 0)
    room = (1 - LIMITED) * (high - low)
    return ((values <= low + room) | (values >= high - room)).mean(axis=2).sum(axis=1)

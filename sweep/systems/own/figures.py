"""Figures of an own model's rollouts, as sums and extremes over physics steps; units are at the ends of their names."""

from collections.abc import Mapping
from typing import Any

import mujoco
import numpy as np

from sweep.core.constants import GRAVITY

STEPS = ("qpos", "qvel", "actuator_force", "actuator_velocity", "sensordata", "site_xpos")  # what a tick records
LOADED = 1.0  # N, from which a foot carries load
LIMITED = 0.999  # share of a limit, from which an actuator is at it

MEANING = {
    "base_height_min_m": "least height of the base",
    "tilt_max_deg": "largest angle of the base's upward axis from that at the start",
    "travelled_m": "way of the base along the world's x axis",
    "drift_m": "way of the base along the world's y axis",
    "speed_mps": "mean of the base's speed along x",
    "slip_max_m": "farthest that a loaded foot moved from where it came down",
    "saturated_share": "share of the time that actuators are at a limit of their force",
    "joint_limit_share": "share of the time that joints are at a limit of their range",
    "energy_j": "positive work of the actuators",
    "cost_of_transport": "that energy over weight and way travelled",
    "duration_s": "length of the rollout",
    "not_finite": "1 where a number of the simulation or of the controller was not finite",
    "buffer_full": "1 where MuJoCo's room for contacts or constraints was full",
}
BASE = ("base_height_min_m", "tilt_max_deg", "travelled_m", "drift_m", "speed_mps", "cost_of_transport")
FEET = ("slip_max_m",)
SILENT = ("not_finite", "buffer_full")


class Meter:
    """Figures of n rollouts of a model, told of every tick; those of a base or of feet where there are any.

    `base` is the place of a free joint in `qpos`, None without; `feet` are numbers of touch sensors. What is measured
    so far is a tree of arrays (n, ...), of NumPy or of JAX as those are that it is told of.
    """

    def __init__(self, model: mujoco.MjModel, base: int | None, feet: tuple[int, ...]):
        self._base, self._step = base, model.opt.timestep
        self._forced = np.flatnonzero(model.actuator_forcelimited)
        joints = np.flatnonzero(model.jnt_limited.astype(bool) & (model.jnt_type >= int(mujoco.mjtJoint.mjJNT_SLIDE)))
        self._joints, self._places = joints, model.jnt_qposadr[joints]
        self._touch = model.sensor_adr[list(feet)]
        self._sites = model.sensor_objid[list(feet)]

    def start(self, qpos: Any) -> dict[str, Any]:
        """What is measured at first, of positions (n, nq)."""
        xp, n = namespace(qpos), len(qpos)
        none, feet = xp.zeros_like(qpos[:, 0]), len(self._sites)
        found = dict.fromkeys(("steps", "power", "tilt", "slip", "full", "ends"), none)
        down = {"down": xp.zeros((n, feet, 2), qpos.dtype), "loaded": xp.zeros((n, feet), bool)}
        return found | down | {"start": qpos, "last": qpos, "height": none + np.inf, "finite": xp.ones(n, bool)}

    def update(
        self, sofar: Mapping[str, Any], steps: Mapping[str, Any], limits: Mapping[str, Any], going: Any
    ) -> dict[str, Any]:
        """After a tick: `steps` (n, s, ...) recorded at every physics step; rollouts that are not `going` (n,)
        are over. `limits` are the models' own: `actuator_forcerange`, `jnt_range`, (n, ..., 2).
        """
        qpos, number, new = steps["qpos"], steps["qpos"].shape[1], dict(sofar)
        xp = namespace(qpos)

        def most(name: str, value: Any) -> None:
            new[name] = xp.where(going, xp.maximum(sofar[name], value), sofar[name])

        with np.errstate(invalid="ignore", over="ignore"):
            finite = xp.isfinite(qpos.sum(axis=(1, 2)) + steps["qvel"].sum(axis=(1, 2)))
            new["finite"] = sofar["finite"] & (~going | finite)
            if self._base is not None:
                at, upright = self._base, slice(self._base + 3, self._base + 7)
                low = xp.minimum(sofar["height"], qpos[..., at + 2].min(axis=1))
                new["height"] = xp.where(going, low, sofar["height"])
                most("tilt", angle(level(qpos[..., upright], sofar["start"][:, None, upright]).min(axis=1)))
            if len(self._forced):
                force, range_ = steps["actuator_force"][..., self._forced], limits["actuator_forcerange"][:, None]
                ends = at_end(force, range_[:, :, self._forced])
                new["full"] = sofar["full"] + going * ends.mean(axis=2).sum(axis=1)
            if len(self._joints):
                ends = at_end(qpos[..., self._places], limits["jnt_range"][:, None, self._joints])
                new["ends"] = sofar["ends"] + going * ends.mean(axis=2).sum(axis=1)
            power = xp.maximum(steps["actuator_force"] * steps["actuator_velocity"], 0.0)
            new["power"] = sofar["power"] + going * power.sum(axis=(1, 2))
            if len(self._sites):
                loaded = steps["sensordata"][..., self._touch] > LOADED
                place = steps["site_xpos"][:, :, self._sites, :2]
                before = xp.concatenate([sofar["loaded"][:, None], loaded[:, :-1]], axis=1)
                landed = xp.where(loaded & ~before, xp.arange(number)[:, None], -1)
                when = xp.maximum.accumulate(landed, axis=1)[..., None]  # the last step at which it came down
                there = xp.take_along_axis(place, xp.maximum(when, 0), axis=1)
                down = xp.where(when >= 0, there, sofar["down"][:, None])
                moved = xp.hypot(*xp.moveaxis(place - down, -1, 0)) * loaded
                most("slip", moved.max(axis=(1, 2)))
                new |= {"down": down[:, -1], "loaded": loaded[:, -1]}
        new["steps"] = sofar["steps"] + going * number
        new["last"] = xp.where(going[:, None], qpos[:, -1], sofar["last"])
        return new

    def figures(
        self, sofar: Mapping[str, Any], mass: np.ndarray, broken: np.ndarray, full: np.ndarray
    ) -> dict[str, np.ndarray]:
        """By name, (n,), of models of a `mass` (n,) kg; `broken` and `full` are what an engine found itself."""
        found: dict[str, np.ndarray] = {}
        sofar = {name: np.asarray(value) for name, value in sofar.items()}
        steps = np.maximum(sofar["steps"], 1)
        time, energy = steps * self._step, sofar["power"] * self._step
        if self._base is not None:
            way = (sofar["last"] - sofar["start"])[:, self._base : self._base + 2]
            found |= {
                "base_height_min_m": sofar["height"],
                "tilt_max_deg": sofar["tilt"],
                "travelled_m": way[:, 0],
                "drift_m": way[:, 1],
                "speed_mps": way[:, 0] / time,
                "cost_of_transport": energy / (mass * GRAVITY * np.maximum(np.abs(way[:, 0]), 1e-9)),
            }
        if len(self._sites):
            found["slip_max_m"] = sofar["slip"]
        if len(self._forced):
            found["saturated_share"] = sofar["full"] / steps
        if len(self._joints):
            found["joint_limit_share"] = sofar["ends"] / steps
        found |= {"energy_j": energy, "duration_s": sofar["steps"] * self._step}
        finite = sofar["finite"] & np.isfinite(np.stack(list(found.values()))).all(axis=0) & ~broken
        return {**found, "not_finite": (~finite).astype(float), "buffer_full": full.astype(float)}


def names(model: mujoco.MjModel, base: int | None, feet: tuple[int, ...]) -> tuple[str, ...]:
    """The figures that rollouts of a model have."""
    meter, none = Meter(model, base, feet), np.zeros(1, dtype=bool)
    return tuple(meter.figures(meter.start(model.qpos0[None]), np.ones(1), none, none))


def namespace(array: Any) -> Any:
    """NumPy or JAX's of it, whichever an array is of."""
    return array.__array_namespace__()


def tilt(quat: Any, start: Any) -> Any:
    """Angle (°) between upward axes of two orientations (..., 4), each as it stands in the world."""
    return angle(level(quat, start))


def level(quat: Any, start: Any) -> Any:
    """Cosine of the tilt."""
    a, b = (up(namespace(quat).moveaxis(one, -1, 0)) for one in (quat, start))
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def up(quat: Any) -> tuple[Any, Any, Any]:
    """The upward axis of an orientation (4, ...), each of its components (...)."""
    w, x, y, z = quat
    return 2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)


def angle(cosine: Any) -> Any:
    """In degrees, of a cosine that may be beyond 1 by rounding."""
    xp = namespace(cosine)
    return xp.degrees(xp.arccos(xp.clip(cosine, -1, 1)))


def at_end(values: Any, range_: Any) -> Any:
    """Which values (...) are at an end of their range (..., 2)."""
    low, high = namespace(values).moveaxis(range_, -1, 0)
    room = (1 - LIMITED) * (high - low)
    return (values <= low + room) | (values >= high - room)

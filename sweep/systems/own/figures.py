"""Figures of an own model's rollouts, as sums and extremes over physics steps; units are at the ends of their names."""

from collections.abc import Mapping

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

    `base` is the place of a free joint in `qpos`, None without; `feet` are numbers of touch sensors.
    """

    def __init__(self, model: mujoco.MjModel, base: int | None, feet: tuple[int, ...], qpos: np.ndarray):
        self._model, self._base, n = model, base, len(qpos)
        self._start = qpos.copy()
        self._height, self._tilt = np.full(n, np.inf), np.zeros(n)
        self._full, self._ends, self._energy, self._time = np.zeros(n), np.zeros(n), np.zeros(n), np.zeros(n)
        self._finite = np.ones(n, dtype=bool)
        self._forced = np.flatnonzero(model.actuator_forcelimited)
        joints = np.flatnonzero(model.jnt_limited.astype(bool) & (model.jnt_type >= int(mujoco.mjtJoint.mjJNT_SLIDE)))
        self._joints, self._places = joints, model.jnt_qposadr[joints]
        self._touch = model.sensor_adr[list(feet)]
        self._sites = model.sensor_objid[list(feet)]
        self._down, self._loaded = np.zeros((n, len(feet), 3)), np.zeros((n, len(feet)), dtype=bool)
        self._slip, self._last = np.zeros(n), qpos.copy()

    def update(
        self, steps: Mapping[str, np.ndarray], limits: Mapping[str, np.ndarray], step: float, going: np.ndarray
    ) -> None:
        """After a tick: `steps` (n, s, ...) recorded every `step` seconds; rollouts that are not `going` (n,) are over.

        `limits` are the models' own: `actuator_forcerange`, `jnt_range`, (n, ..., 2).
        """
        qpos, number = steps["qpos"], steps["qpos"].shape[1]
        self._finite &= ~going | np.isfinite(qpos).all(axis=(1, 2)) & np.isfinite(steps["qvel"]).all(axis=(1, 2))
        with np.errstate(invalid="ignore", over="ignore"):
            if self._base is not None:
                at = self._base
                np.minimum(self._height, qpos[..., at + 2].min(axis=1), out=self._height, where=going)
                lean = tilt(qpos[..., at + 3 : at + 7], self._start[:, None, at + 3 : at + 7]).max(axis=1)
                np.maximum(self._tilt, lean, out=self._tilt, where=going)
            if len(self._forced):
                force, range_ = steps["actuator_force"][..., self._forced], limits["actuator_forcerange"][:, None]
                ends = at_end(force, range_[:, :, self._forced])
                self._full += going * ends.mean(axis=2).sum(axis=1) * step
            if len(self._joints):
                ends = at_end(qpos[..., self._places], limits["jnt_range"][:, None, self._joints])
                self._ends += going * ends.mean(axis=2).sum(axis=1) * step
            power = np.maximum(steps["actuator_force"] * steps["actuator_velocity"], 0.0)
            self._energy += going * power.sum(axis=(1, 2)) * step
            for k in range(number if len(self._sites) else 0):
                loaded = steps["sensordata"][:, k, self._touch] > LOADED
                place = steps["site_xpos"][:, k, self._sites]
                self._down = np.where((loaded & ~self._loaded)[..., None], place, self._down)
                moved = np.linalg.norm((place - self._down)[..., :2], axis=2) * loaded
                np.maximum(self._slip, moved.max(axis=1), out=self._slip, where=going)
                self._loaded = loaded
        self._time += going * number * step
        self._last = np.where(going[:, None], qpos[:, -1], self._last)

    def figures(self, mass: np.ndarray, broken: np.ndarray, full: np.ndarray) -> dict[str, np.ndarray]:
        """By name, (n,), of models of a `mass` (n,) kg; `broken` and `full` are MuJoCo's own warnings."""
        found: dict[str, np.ndarray] = {}
        time = np.maximum(self._time, 1e-9)
        if self._base is not None:
            way = self._last[:, self._base : self._base + 2] - self._start[:, self._base : self._base + 2]
            found |= {
                "base_height_min_m": self._height,
                "tilt_max_deg": self._tilt,
                "travelled_m": way[:, 0],
                "drift_m": way[:, 1],
                "speed_mps": way[:, 0] / time,
                "cost_of_transport": self._energy / (mass * GRAVITY * np.maximum(np.abs(way[:, 0]), 1e-9)),
            }
        if len(self._sites):
            found["slip_max_m"] = self._slip
        if len(self._forced):
            found["saturated_share"] = self._full / time
        if len(self._joints):
            found["joint_limit_share"] = self._ends / time
        found |= {"energy_j": self._energy, "duration_s": self._time}
        finite = self._finite & np.isfinite(np.stack(list(found.values()))).all(axis=0) & ~broken
        return {**found, "not_finite": (~finite).astype(float), "buffer_full": full.astype(float)}


def names(model: mujoco.MjModel, base: int | None, feet: tuple[int, ...]) -> tuple[str, ...]:
    """The figures that rollouts of a model have."""
    meter = Meter(model, base, feet, np.tile(model.qpos0, (1, 1)))
    return tuple(meter.figures(np.ones(1), np.zeros(1, dtype=bool), np.zeros(1, dtype=bool)))


def tilt(quat: np.ndarray, start: np.ndarray) -> np.ndarray:
    """Angle (°) between upward axes of two orientations (..., 4), each as it stands in the world."""
    up = [np.stack([2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)], axis=-1)
          for w, x, y, z in (np.moveaxis(quat, -1, 0), np.moveaxis(start, -1, 0))]  # fmt: skip
    return np.degrees(np.arccos(np.clip((up[0] * up[1]).sum(axis=-1), -1, 1)))


def at_end(values: np.ndarray, range_: np.ndarray) -> np.ndarray:
    """Which values (...) are at an end of their range (..., 2)."""
    low, high = np.moveaxis(range_, -1, 0)
    room = (1 - LIMITED) * (high - low)
    return (values <= low + room) | (values >= high - room)

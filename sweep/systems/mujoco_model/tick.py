"""What engines of MuJoCo models report to metrics: a batch of rollouts before, during and after its ticks.

All of them offer what every system offers (see `sweep.core.metric`), and what MuJoCo recorded of each physics step
beside it. Arrays have the rollouts first: (n, ...), those of a report (n, s, ...) for s physics steps.
"""

from collections.abc import Callable, Mapping
from functools import cached_property
from types import MappingProxyType
from typing import Any, NamedTuple

import mujoco
import numpy as np

from sweep.core.constants import FOOT_LOAD_THRESHOLD_N, GRAVITY
from sweep.core.metric import Array, Metric, array_namespace, make_begin_with_constants
from sweep.systems.mujoco_model.model_spec import ModelSpec, arccos_deg, cosine_of_tilt

STEP_FIELDS = (
    "qpos",
    "qvel",
    "actuator_force",
    "actuator_velocity",
    "sensordata",
    "site_xpos",
)  # recorded of each step
LIMIT_SHARE = 0.999  # share of a limit, from which an actuator or a joint is at it


Places = slice | np.ndarray  # of numbers in an array


def as_slice_if_contiguous(numbers: np.ndarray) -> Places:
    """Convert ascending indices without gaps to a slice, which NumPy reads without a copy; return others unchanged."""
    return slice(numbers[0], numbers[-1] + 1) if len(numbers) and np.all(np.diff(numbers) == 1) else numbers


class ModelPartIndices:
    """Indices of a model's parts, such as feet and hinge joints, in MuJoCo's arrays."""

    def __init__(self, own: ModelSpec):
        model = own.model
        self.timestep = model.opt.timestep
        self.has_base = own.base_qpos_address is not None
        first = own.base_qpos_address or 0
        self.base_position, self.base_quat = slice(first, first + 3), slice(first + 3, first + 7)  # in qpos
        free = np.flatnonzero(model.jnt_type == int(mujoco.mjtJoint.mjJNT_FREE))
        dof = int(model.jnt_dofadr[free[0]]) if len(free) else 0
        self.base_velocity = slice(dof, dof + 3)  # in qvel
        self.direction = np.array(own.config.direction) / np.linalg.norm(own.config.direction)
        ahead = self.direction
        self.left = np.cross([0.0, 0.0, 1.0], ahead) if ahead[:2].any() else np.array([0.0, 1.0, 0.0])
        self.left /= np.linalg.norm(self.left)
        hinges = np.flatnonzero(model.jnt_type == int(mujoco.mjtJoint.mjJNT_HINGE))
        self.hinge_dofs = as_slice_if_contiguous(model.jnt_dofadr[hinges])
        on_joints = model.actuator_trntype == int(mujoco.mjtTrn.mjTRN_JOINT)
        hinge_drives = np.flatnonzero(on_joints & np.isin(model.actuator_trnid[:, 0], hinges))
        self.hinge_drives = as_slice_if_contiguous(hinge_drives)
        self.hinge_gears = np.abs(model.actuator_gear[hinge_drives, 0])
        force_limited = np.flatnonzero(model.actuator_forcelimited)
        self.force_limited = as_slice_if_contiguous(force_limited)
        slides = model.jnt_type >= int(mujoco.mjtJoint.mjJNT_SLIDE)
        limited_joints = np.flatnonzero(model.jnt_limited.astype(bool) & slides)
        self.limited_joints = as_slice_if_contiguous(limited_joints)
        self.limited_positions = as_slice_if_contiguous(model.jnt_qposadr[limited_joints])
        feet, collisions = own.touch_sensors("feet"), own.touch_sensors("collisions")
        self.feet_count = len(feet)
        self.foot_sensors = as_slice_if_contiguous(model.sensor_adr[feet])
        self.foot_sites = as_slice_if_contiguous(model.sensor_objid[feet])
        self.collision_sensors = model.sensor_adr[collisions]
        self.terrain = own.config.terrain
        has = {
            "base": self.has_base,
            "hinges": len(hinges),
            "hinge_drives": len(hinge_drives),
            "force_limits": len(force_limited),
            "joint_limits": len(limited_joints),
            "feet": len(feet),
            "collisions": len(collisions),
            "terrain": self.terrain is not None,
        }
        # parts that the model has, of those that `Metric.needs` names
        self.names = frozenset(name for name, there in has.items() if there)


class ModelStart(NamedTuple):
    """Positions of a batch of models before their first tick, from which the metrics' states are made."""

    parts: ModelPartIndices
    qpos: Array  # (n, nq)

    command_direction_varies = False

    @property
    def torque_groups(self) -> int:
        """Number of groups of joints for which peak torques are computed: one for each actuator of a hinge joint."""
        return len(self.parts.hinge_gears)

    @property
    def base_position(self) -> Array:
        """Return the position (n, 3) of the base, the first free joint, at the start (m, world axes)."""
        return self.qpos[:, self.parts.base_position]

    @property
    def base_quat(self) -> Array:
        """Return the orientation (n, 4) of the base, the first free joint, at the start, body to world."""
        return self.qpos[:, self.parts.base_quat]

    def constant_state(self, value: Any) -> Array:
        """Convert a constant to a metric state for each rollout, in the rollouts' precision."""
        xp, value = array_namespace(self.qpos), np.asarray(value)
        dtype = self.qpos.dtype if value.dtype.kind == "f" else value.dtype
        return xp.broadcast_to(xp.asarray(value, dtype), (len(self.qpos), *value.shape))

    def init_touchdown_points(self) -> "GroundTouchdownPoints":
        """Return the touchdown points of the feet before any foot is loaded."""
        feet = self.parts.feet_count
        return GroundTouchdownPoints(
            self.constant_state(np.zeros((feet, 2))), self.constant_state(np.zeros(feet, bool))
        )


class ModelTick:
    """An engine's report of a batch's physics steps since the previous report, with which metrics are updated.

    Args:
        parts: Places of the model's parts.
        steps: Recorded values (n, s, ...) by MuJoCo's name, and `unsolved` (n, s); with pushes `push_work` (n,) in J.
        limits: The models' own limits, `actuator_forcerange` and `jnt_range`, (n, ..., 2); with terrain its fields, see
            `terrain.TerrainBatch.metric_inputs`.
        start: Positions (n, nq) before the first tick.
    """

    def __init__(self, parts: ModelPartIndices, steps: Mapping[str, Array], limits: Mapping[str, Array], start: Array):
        self.parts, self.steps, self.limits, self.start = parts, steps, limits, start
        self.number = steps["qpos"].shape[1]  # of steps

    @property
    def sample_period(self) -> float:
        """Physics time step: the time between two samples (s)."""
        return self.parts.timestep

    @property
    def base_position(self) -> Array:
        """Return the positions (n, s, 3) of the base, the first free joint (m, world axes)."""
        return self.steps["qpos"][..., self.parts.base_position]

    @property
    def base_quat(self) -> Array:
        """Return the orientations (n, s, 4) of the base, the first free joint, body to world."""
        return self.steps["qpos"][..., self.parts.base_quat]

    @property
    def base_velocity(self) -> Array:
        """Return the velocities (n, s, 3) of the base, the first free joint (m/s, world axes)."""
        return self.steps["qvel"][..., self.parts.base_velocity]

    @property
    def ground_height(self) -> Array:
        """Height (n, s) in m of the terrain straight below the base, or of its nearest edge."""
        shape, base = self.parts.terrain, self.base_position
        if shape is None:
            raise TypeError("the model has no terrain")
        place = base[..., :2] - self.limits["ground_place"][:, None, :2]
        return self.limits["ground_place"][:, 2:] + interpolate_heights(
            self.limits["ground"], self.limits["ground_index"][:, None], place, *shape.grid_coordinates
        )

    @property
    def tilt_deg(self) -> Array:
        """Return the largest angle (n,) in deg between the base's upward axis and that at the start."""
        start = self.start[:, None, self.parts.base_quat]
        return arccos_deg(cosine_of_tilt(self.base_quat, start).min(axis=1))

    @property
    def joint_rates(self) -> Array:
        """Return the rates of k hinge joints in s physics steps of n rollouts, (n, s, k) rad/s."""
        return self.steps["qvel"][..., self.parts.hinge_dofs]

    @property
    def joint_torques(self) -> Array:
        """Absolute torques (n, s, k) in N m that actuators exert on hinge joints, one for each pair of these."""
        force = self.steps["actuator_force"][..., self.parts.hinge_drives]
        return array_namespace(force).abs(force) * self.parts.hinge_gears

    @cached_property
    def power(self) -> Array:
        """Mechanical power (n, s, nu) of each actuator in W."""
        return self.steps["actuator_force"] * self.steps["actuator_velocity"]

    @property
    def positive_work(self) -> Array:
        """Positive power (n,) of the actuators in W, summed over physics steps."""
        return array_namespace(self.power).maximum(self.power, 0.0).sum(axis=(1, 2))

    @cached_property
    def foot_loads(self) -> Array:
        """Load (n, s, feet) of each foot in N."""
        return self.steps["sensordata"][..., self.parts.foot_sensors]

    def motion_along_command(self, before: Array) -> tuple[None, int]:
        """Return None and the number of steps; the displacement follows from the end, as the direction is constant."""
        return None, self.number


class GroundTouchdownPoints(NamedTuple):
    """Horizontal positions (m) where the feet last touched down, and which feet are loaded."""

    positions: Array  # (n, feet, 2)
    loaded: Array  # (n, feet)

    def update(self, ctx: ModelTick) -> tuple["GroundTouchdownPoints", Array]:
        """Return the touchdown points after a report, and the largest distance (n, feet) in m of loaded feet."""
        loaded, place = ctx.foot_loads > FOOT_LOAD_THRESHOLD_N, ctx.steps["site_xpos"][:, :, ctx.parts.foot_sites, :2]
        xp = array_namespace(place)
        before = xp.concatenate([self.loaded[:, None], loaded[:, :-1]], axis=1)
        # the last step at which it came down, counted from 1; 0 is that of the place before the report
        when = xp.maximum.accumulate(xp.where(loaded & ~before, 1 + xp.arange(ctx.number)[:, None], 0), axis=1)
        places = xp.concatenate([self.positions[:, None], place], axis=1)
        down_x, down_y = (xp.take_along_axis(places[..., k], when, axis=1) for k in range(2))
        moved = xp.hypot(place[..., 0] - down_x, place[..., 1] - down_y) * loaded
        return GroundTouchdownPoints(xp.stack([down_x[:, -1], down_y[:, -1]], axis=-1), loaded[:, -1]), moved.max(
            axis=1
        )


class ModelRollout(NamedTuple):
    """State of a batch of rollouts after their last tick, as NumPy arrays (n, ...)."""

    parts: ModelPartIndices
    steps: np.ndarray  # number of physics steps
    start_qpos: np.ndarray  # positions (n, nq)
    end_qpos: np.ndarray  # likewise
    mass: np.ndarray  # kg
    energy_gain: np.ndarray  # J, energy at the end less that at the start
    is_not_finite: np.ndarray  # whether the engine found a number that is not finite
    is_buffer_full: np.ndarray  # whether a buffer was full
    columns: Mapping[str, np.ndarray] = MappingProxyType({})  # of the metrics before

    @property
    def time(self) -> np.ndarray:
        """Simulated time of each rollout (s)."""
        return self.steps * self.parts.timestep

    @property
    def weight(self) -> np.ndarray:
        """Weight of each model (N)."""
        return self.mass * GRAVITY

    def integrate_sum(self, total: np.ndarray) -> np.ndarray:
        """Return the integral over time of a quantity that was summed over physics steps."""
        return total * self.parts.timestep

    def share_of_steps(self, count: np.ndarray) -> np.ndarray:
        """Return `count` as a share of the rollout's physics steps."""
        return count / np.maximum(self.steps, 1)

    def displacement_along_command(self, displacement: np.ndarray) -> np.ndarray:
        """Return the component (n,) of displacements (n, 3) along the direction `model.direction`."""
        return displacement @ self.parts.direction


def interpolate_heights(fields: Array, index: Array, place: Array, x: np.ndarray, y: np.ndarray) -> Array:
    """Return terrain heights (m) at places between the points of height fields, on MuJoCo's triangles.

    Args:
        fields: Heights (k, rows, columns).
        index: Number of the field of each place, (n, 1).
        place: Places (n, s, 2) in the fields' axes; those beside a field count as at its edge.
        x: Coordinates (columns,) of the points.
        y: Coordinates (rows,).

    Returns:
        Heights (n, s).
    """
    xp, parts = array_namespace(place), []
    for k, axis in enumerate((x, y)):
        cells = (place[..., k] - axis[0]) / (axis[1] - axis[0])
        cells = xp.clip(xp.nan_to_num(cells), 0, len(axis) - 1)
        cell = xp.minimum(xp.floor(cells), len(axis) - 2).astype(int)
        parts.append((cell, cells - cell))
    (i, u), (j, v) = parts
    index = index.astype(int)
    low, high = fields[index, j, i], fields[index, j + 1, i + 1]
    left, right = fields[index, j + 1, i], fields[index, j, i + 1]
    return low + xp.where(v >= u, v * (left - low) + u * (high - left), u * (right - low) + v * (high - right))


def make_step_share_metric(
    count: Callable[[ModelTick], Array], column: str, meaning: str, needs: tuple[str, ...] = ()
) -> Metric[Array]:
    """Make a metric: the share of physics steps in which a given condition holds.

    Args:
        count: Number of the steps of a report in which it holds, (n,).
        column: Name of the column.
        meaning: Its meaning.
        needs: See `Metric.needs`.
    """
    return Metric(
        make_begin_with_constants(lambda total: total, 0.0),
        lambda total, ctx: total + count(ctx),
        lambda total, rollout: {column: rollout.share_of_steps(total)},
        {column: meaning},
        needs=needs,
    )


def sum_share_at_limit(values: Array, limits: Array) -> Array:
    """Return the share of values (joints or actuators) at an end of their range, summed over physics steps.

    Args:
        values: Numbers (n, s, k).
        limits: Their ranges (n, k, 2).

    Returns:
        Sums over s of the shares of the k numbers, (n,).
    """
    low, high = array_namespace(values).moveaxis(limits[:, None], -1, 0)
    room = (1 - LIMIT_SHARE) * (high - low)
    return ((values <= low + room) | (values >= high - room)).mean(axis=2).sum(axis=1)

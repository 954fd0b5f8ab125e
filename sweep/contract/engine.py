"""The interface of all engines, whatever system they simulate, and the record of a traced rollout."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol

import numpy as np

from sweep.core.errors import InputError

if TYPE_CHECKING:
    import mujoco

SLIDE_JOINT = 2  # mjtJoint.mjJNT_SLIDE; hinges have a larger number, free and ball joints a smaller one
Metrics = dict[str, np.ndarray]  # column name (with its unit) -> one number per rollout
SideMaker = Callable[[Mapping[str, Any]], tuple[Any, Any]]  # world and belief with values by column


class TimeSeriesRequest(NamedTuple):
    """Names of the columns that an engine records over time, and the number of control ticks between samples."""

    columns: tuple[str, ...]
    every: int  # number of control ticks between samples
    max_rollouts: int  # largest number of rollouts recorded at a time, so that one program serves all requests


class FootContacts(Protocol):
    """Contacts of the feet with the ground in a trace, computed by the system that made the trace."""

    def friction_utilization(self, trace: "Trace") -> np.ndarray:
        """Return each foot's share of its friction limit in use, (F, N) for F frames, N feet; NaN without load."""
        ...

    def penetration_depth(self, trace: "Trace", points: np.ndarray, frames: np.ndarray) -> np.ndarray:
        """Return how deep points lie inside the obstacle at each frame of a trace (m); negative outside.

        Args:
            trace: the rollout.
            points: points (K, n, 3), m, world axes.
            frames: indices (K,) of the frames of the trace to which the points belong.

        Returns:
            Depths (K, n).
        """
        ...


class Push(NamedTuple):
    """A constant force at the centre of mass of a body during a part of a traced rollout."""

    body: int  # index in `Trace.model`
    force: np.ndarray  # (3,) N, world axes
    start: float  # s
    end: float  # s


class TimeSeriesGroup(NamedTuple):
    """Time series of a trace that belong in one plot, such as the numbers of an observation term."""

    title: str
    unit: str
    columns: Mapping[str, str]  # name of each line in the plot, by its column in `Trace.columns`


@dataclass(frozen=True)
class Trace:
    """Time series of one simulated rollout, made by `Engine.trace` and `Engine.traces`.

    Each array has F samples, taken at the end of control ticks. World axes and SI units.
    """

    world: Any  # simulated parameters, plain numbers
    belief: Any  # parameters that the planner received
    model: "mujoco.MjModel"  # the world's model, for drawing
    time: np.ndarray  # (F,)
    qpos: np.ndarray  # (F, nq)
    qvel: np.ndarray  # (F, nv)
    joint_target: np.ndarray  # (F, J) of the `hinge_and_slide_joints`; of a user's model its controls
    joint_torque: np.ndarray  # (F, J), peak of the tick
    foot_position: np.ndarray  # (F, N, 3); N = 0 for models without known feet
    foot_target: np.ndarray  # (F, N, 3), as planned
    foot_force: np.ndarray  # (F, N, 3), mean of the tick, on the robot
    base_target: np.ndarray  # (F, 7), planned position and quaternion (w, x, y, z)
    stage: np.ndarray  # (F,) index into `stages`
    margin: np.ndarray  # (F,) to the nearest threshold that is checked in every tick; the last one is the row's
    margin_of: np.ndarray  # (F,) names of these thresholds
    stages: tuple[str, ...]
    metrics: dict[str, Any]  # the row's metrics, as from `run`
    torque_limit: float | None = None  # N m, if it is the same for all joints
    contacts: FootContacts | None = None  # None for models without known feet
    columns: Mapping[str, np.ndarray] = field(default_factory=dict)  # further time series (F,) by name
    groups: tuple[TimeSeriesGroup, ...] = ()  # of these columns
    pushes: tuple[Push, ...] = ()  # of the scenario


class MissingTrace(NamedTuple):
    """Placeholder for the `Trace` (time series) of a rollout whose model cannot be compiled for drawing."""

    reason: str


def hinge_and_slide_joints(model: "mujoco.MjModel") -> np.ndarray:
    """Indices of the hinge and slide joints of a model, in the model's order (for a legged robot leg by leg)."""
    return np.flatnonzero(model.jnt_type >= SLIDE_JOINT)


def count_substeps(period: float, step: float, message: str) -> int:
    """Return the number of physics steps in a control tick; raise `InputError` with `message` unless it is a whole
    number.

    Args:
        period: length of a control tick (s).
        step: length of a physics step (s).
        message: text of the error.

    Raises:
        InputError: The period is no whole multiple of the step.
    """
    if period < step or abs(period / step - round(period / step)) > 1e-6:
        raise InputError(message)
    return round(period / step)


def is_bitwise_equal(a: Any, b: Any) -> bool:
    """Return whether two numbers are equal bit for bit.

    Args:
        a: number or array; it is compared in double precision.
        b: the other one.

    Returns:
        True where all values are equal; NaN equals NaN.
    """
    return bool(np.array_equal(np.asarray(a, dtype=float), np.asarray(b, dtype=float), equal_nan=True))


class Engine(Protocol):
    """A compiled simulation of one scenario; parameters of each rollout are its input data."""

    stages: tuple[str, ...]  # names of the plan's stages
    duration: float  # simulated seconds of a rollout
    width: int  # number of rollouts in a batch; `run` takes exactly so many
    dynamics: str  # source of the smooth dynamics: arrowhead, mjx or C MuJoCo
    devices: int  # number that share a batch; a width that they do not divide evenly uses one

    def rollout_bytes(self) -> int | None:
        """Return the memory (bytes) that plan, state and metrics of a rollout take; None if C code allocates it.

        Temporary arrays within a control tick take several times as much.
        """
        ...

    def find_inactive_parameters(self, sides: SideMaker, ends: Mapping[str, tuple[float, float]]) -> set[str]:
        """Find parameters, by column, that cannot change any metric: the traced program does not read them.

        Args:
            sides: world and belief with values of parameters, by column.
            ends: lowest and highest value of each parameter, by column.

        Returns:
            Columns that the program of a rollout does not read. A column that is not among them may still do nothing.
        """
        ...

    def run(self, world: Any, belief: Any, streams: np.ndarray) -> Metrics:
        """Simulate a batch of rollouts and return their metrics.

        Args:
            world: parameters of the simulated side, numbers or arrays (width,).
            belief: parameters that the planner receives, likewise.
            streams: number of each rollout's noise stream (width,), folded into the random key.

        Returns:
            Metrics by column name, an array (width,) each.

        Raises:
            MemoryError: The device cannot hold the batch.
        """
        ...

    def run_with_time_series(
        self, world: Any, belief: Any, streams: np.ndarray, slots: np.ndarray, watch: TimeSeriesRequest
    ) -> tuple[Metrics, np.ndarray]:
        """Simulate a batch, and record some columns over time for the rollouts at indices `slots`.

        Args:
            world: see `run`.
            belief: see `run`.
            streams: see `run`.
            slots: indices (n,) of the recorded rollouts in the batch.
            watch: columns to record, and the number of control ticks between samples.

        Returns:
            Metrics as from `run`, and samples (samples, n, columns) at the ends of control ticks `watch.every`,
            2 `watch.every`, ... Samples after the end of a rollout are undefined.
        """
        ...

    def trace(self, world: Any, belief: Any, streams: np.ndarray, slot: int) -> Trace:
        """Simulate a batch, and return the full time series (`Trace`) of the rollout at index `slot`."""
        ...

    def traces(self, world: Any, belief: Any, streams: np.ndarray, every: int) -> Sequence[Trace | MissingTrace]:
        """Simulate a batch once, and return a time series (`Trace`) of each of its rollouts.

        Args:
            world: see `run`.
            belief: see `run`.
            streams: see `run`.
            every: number of control ticks between samples.

        Returns:
            A trace for each rollout, or the reason that its model cannot be drawn.
        """
        ...

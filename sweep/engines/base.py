"""What every engine offers, whatever it simulates, and what a traced rollout holds."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol

import numpy as np

from sweep.core.errors import InputError

if TYPE_CHECKING:
    import mujoco

SLIDE = 2  # mjtJoint.mjJNT_SLIDE, before hinges and after joints of more freedoms
Figures = dict[str, np.ndarray]  # column name (with its unit) -> one number per rollout
Sides = Callable[[Mapping[str, Any]], tuple[Any, Any]]  # world and belief with values by column


class Watch(NamedTuple):
    """What is to be recorded of some rollouts of a batch."""

    columns: tuple[str, ...]
    every: int  # control ticks
    most: int  # rollouts that are ever asked for at a time, so that one program serves them all


@dataclass(frozen=True)
class Trace:
    """One rollout, sampled at the end of every control tick, or of one in several. World axes, SI units; F = frames."""

    world: Any  # as it was, plain numbers
    belief: Any  # as the planner was told
    model: "mujoco.MjModel"  # the world's model, for drawing
    time: np.ndarray  # (F,)
    qpos: np.ndarray  # (F, nq)
    qvel: np.ndarray  # (F, nv)
    joint_target: np.ndarray  # (F, J) of the `single_joints`; of an own model its controls
    joint_torque: np.ndarray  # (F, J), peak of the tick
    foot_position: np.ndarray  # (F, N, 3), of a robot whose feet are known
    foot_target: np.ndarray  # (F, N, 3), as planned
    foot_force: np.ndarray  # (F, N, 3), mean of the tick, on the robot
    base_target: np.ndarray  # (F, 7), planned position and quaternion (w, x, y, z)
    stage: np.ndarray  # (F,) index into `stages`
    margin: np.ndarray  # (F,) to the nearest limit that is watched in every tick, as the row's `margin` at its end
    margin_of: np.ndarray  # (F,) names of these limits
    stages: tuple[str, ...]
    figures: dict[str, Any]  # the row's figures, as `run` gives them
    torque_limit: float | None = None  # N m, where all joints have the same


class NoTrace(NamedTuple):
    """Stands for the `Trace` of a rollout whose model cannot be drawn."""

    reason: str


def single_joints(model: "mujoco.MjModel") -> np.ndarray:
    """Numbers of the hinges and slides of a model, in its order; of a legged robot leg by leg."""
    return np.flatnonzero(model.jnt_type >= SLIDE)


def substeps(period: float, step: float, told: str) -> int:
    """Physics steps of a control tick, both in s. Raises `InputError`, in the words `told`, where they do not fit."""
    if period < step or abs(period / step - round(period / step)) > 1e-6:
        raise InputError(told)
    return round(period / step)


def same_bits(a: Any, b: Any) -> bool:
    """Whether two figures are the same to the last bit; all that is not a number is the same."""
    return bool(np.array_equal(np.asarray(a, dtype=float), np.asarray(b, dtype=float), equal_nan=True))


class Engine(Protocol):
    """A compiled simulation of one scenario; parameters come as data."""

    stages: tuple[str, ...]  # names of the plan's stages
    duration: float  # simulated seconds of a rollout
    width: int  # rollouts of one batch; `run` takes exactly so many
    dynamics: str  # where the smooth dynamics come from: arrowhead, mjx or C MuJoCo
    devices: int  # that share a batch; only a width that they divide evenly uses them all

    def rollout_bytes(self) -> int | None:
        """Plan, state and figures of a rollout, None where C keeps them; work within a tick takes several times it."""
        ...

    def find_unread_columns(self, sides: Sides, ends: Mapping[str, tuple[float, float]]) -> set[str]:
        """Find parameters that cannot change a bit of any metric, from the program alone: nothing is simulated.

        Args:
            sides: world and belief with values of parameters, by column.
            ends: lowest and highest value of each parameter, by column.

        Returns:
            Columns that the program of a rollout does not read. A column that is not among them may still do nothing.
        """
        ...

    def run(self, world: Any, belief: Any, streams: np.ndarray) -> Figures:
        """Figures of `width` rollouts; `streams` (width,) are the numbers folded into the noise key.

        Raises `MemoryError` where the device cannot hold the batch.
        """
        ...

    def histories(
        self, world: Any, belief: Any, streams: np.ndarray, slots: np.ndarray, watch: Watch
    ) -> tuple[Figures, np.ndarray]:
        """As `run`, with what is to be watched of the rollouts in `slots` (n,): (samples, n, columns).

        Samples are at the ends of control ticks `watch.every`, twice that, ... of all; those after a rollout's own end
        mean nothing.
        """
        ...

    def trace(self, world: Any, belief: Any, streams: np.ndarray, slot: int) -> Trace:
        """The rollout in `slot` of a batch, recorded."""
        ...

    def traces(self, world: Any, belief: Any, streams: np.ndarray, every: int) -> Sequence[Trace | NoTrace]:
        """Record all rollouts of a batch, which runs once.

        Args:
            world: parameters of the simulated side, numbers or arrays over the batch.
            belief: parameters that the controller believes in, likewise.
            streams: numbers (width,) that are folded into the noise key.
            every: control ticks from one sample to the next.

        Returns:
            A trace for each rollout, or the reason that its model cannot be drawn.
        """
        ...

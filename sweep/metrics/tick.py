"""Input of the hexapod's metrics: the rollout before its first tick, each control tick, and the rollout at its end.

All of them offer what every system offers (see `sweep.core.metric`), so that shared metrics need nothing else, and the
robot's own report beside it.
"""

from collections.abc import Mapping
from types import MappingProxyType
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from sweep.controllers.observation import Observation
from sweep.controllers.plan import Plan
from sweep.core.constants import GRAVITY
from sweep.core.metric import Cause
from sweep.core.outcomes import GOAL_MISSED
from sweep.core.rotations import conjugate, multiply
from sweep.core.shared_metrics.attitude import tilt_deg
from sweep.dynamics.contacts import transform_points_to_body, transform_points_to_world
from sweep.estimation.belief_update import LearnedState
from sweep.models.case import Case
from sweep.models.legs import JOINT_KINDS
from sweep.models.obstacles.surface import BodyPoses, FreeBodyState, surface_at
from sweep.models.posture import Stance
from sweep.models.robot import total_mass

# s; a rollout continues for this time after its plan has ended, and nothing may change then
REST_DURATION_S = 1.0
# a rollout is stopped when this multiple of its plan's duration has passed
MAX_DURATION_FACTOR = 1.2
# s; forces are averaged over it, so that a bounce of the feet is neither a fall nor a slip
FORCE_FILTER_TIME_S = 0.05


class EngineTickReport(NamedTuple):
    """An engine's report of one control tick to the metrics: foot forces, torques, poses; world axes."""

    torque_peak: Float[Array, "6 3"]  # N m, absolute
    saturated: Float[Array, "6 3"]  # share of the tick
    force: Float[Array, "6 3"]  # N, mean, on the feet
    normal: Float[Array, " 6"]  # N, mean
    tangential: Float[Array, " 6"]  # N, size of the mean
    residual: Float[Array, ""]  # N, largest of the solver
    work: Float[Array, ""]  # J, of drives and pushes
    positive_work: Float[Array, ""]  # J, positive drive work only
    power: Float[Array, "6 3"]  # W, of the drives, mean
    energy: Float[Array, ""]  # J, kinetic and potential, at the end
    actual: Observation  # of exact sensors, at the end
    centre_of_mass: Float[Array, " 3"]  # m, of the robot
    joints: Float[Array, "6 k 3"]  # m, along each leg: hip, ..., knee, foot
    bodies: BodyPoses


class RolloutStart(NamedTuple):
    """State of robot and free bodies before the first tick, from which the metrics' states are made."""

    world: Case
    plan: Plan
    position: Float[Array, " 3"]  # m, of the base
    quat: Float[Array, " 4"]
    feet: Float[Array, "6 3"]  # m, actual positions
    free: FreeBodyState
    energy: Float[Array, ""]  # J
    learned: LearnedState = LearnedState()

    command_direction_varies = True
    torque_groups = len(JOINT_KINDS)

    @property
    def base_position(self) -> Float[Array, " 3"]:
        """Return the position (3,) of the base at the start (m, world axes)."""
        return self.position

    @property
    def base_quat(self) -> Float[Array, " 4"]:
        """Return the orientation (4,) of the base at the start, body to world."""
        return self.quat

    def constant_state(self, value: Any) -> Array:
        """Convert a constant to a metric state; floats get the rollout's precision."""
        return jnp.asarray(value, self.feet.dtype if np.asarray(value).dtype.kind == "f" else None)

    def init_touchdown_points(self) -> "BodyTouchdownPoints":
        """Return the touchdown points of the feet before any foot is loaded."""
        return BodyTouchdownPoints.from_rollout_start(self)


class MetricContext(NamedTuple):
    """State, commands and engine's report of the control tick that has just passed, from which metrics are updated."""

    world: Case
    plan: Plan
    stage: Int[Array, ""]
    phase: Float[Array, ""]  # of the stage, 0 to 1
    finished: Bool[Array, ""]  # the plan
    stage_start: Float[Array, " 3"]  # m, planned base when the stage began, in its frame
    target: Stance  # that the tracker commanded
    reference: Stance  # `target` with the base where exact sensors would have it: the true command, see `Command`
    shortfall: Float[Array, ""]  # m, of targets beyond the legs' reach
    report: EngineTickReport
    period: float  # s, of a tick
    time: Float[Array, ""]  # s, at its end
    learned: LearnedState = LearnedState()

    @property
    def sample_period(self) -> float:
        """Length of a control tick (s), the time between samples."""
        return self.period

    @property
    def base_position(self) -> Float[Array, "1 3"]:
        """Return the position (1, 3) of the base at the end of the tick (m, world axes)."""
        return self.report.actual.position[None]

    @property
    def base_quat(self) -> Float[Array, "1 4"]:
        """Return the orientation (1, 4) of the base at the end of the tick, body to world."""
        return self.report.actual.quat[None]

    @property
    def base_velocity(self) -> Float[Array, "1 3"]:
        """Return the velocity (1, 3) of the base at the end of the tick (m/s, world axes)."""
        return self.report.actual.velocity[None]

    @property
    def attitude_error(self) -> Float[Array, " 4"]:
        """Rotation of the base from its reference attitude (quaternion), in the axes of the reference."""
        return multiply(conjugate(self.reference.quat), self.report.actual.quat)

    @property
    def tilt_deg(self) -> Float[Array, ""]:
        """Tilt of the base from its commanded vertical (deg)."""
        return tilt_deg(self.attitude_error, jnp)

    @property
    def joint_rates(self) -> Float[Array, "6 3"]:
        """Joint rates (rad/s) at the end of the tick, of six legs for each of the joints alpha, beta and gamma."""
        return self.report.actual.rates

    @property
    def joint_torques(self) -> Float[Array, "6 3"]:
        """Peak joint torques (N m) in the tick, of six legs for each of the joints alpha, beta and gamma."""
        return self.report.torque_peak

    @property
    def positive_work(self) -> Float[Array, ""]:
        """Positive work of the drives in this tick (J)."""
        return self.report.positive_work

    def motion_along_command(self, before: Float[Array, " 3"]) -> tuple[Float[Array, ""], Float[Array, ""]]:
        """Return the base's motion (m) along the planned direction in this tick, and its duration (s); 0 at rest."""
        way = self.plan.position[self.stage] - self.stage_start
        length = jnp.linalg.norm(way)
        moving = (length > 1e-6) & ~self.finished
        step = (self.report.actual.position - before) @ (way / jnp.maximum(length, 1e-6))
        return jnp.where(moving, step, 0.0), jnp.where(moving, self.period, 0.0)


def remaining_plan_time(ctx: MetricContext) -> Float[Array, ""]:
    """Return the remaining duration of the plan (s), given that stages may have ended early."""
    duration = ctx.plan.duration
    later = jnp.sum(jnp.where(jnp.arange(len(duration)) > ctx.stage, duration, 0.0))
    return later + (1 - ctx.phase) * duration[ctx.stage]


class BodyTouchdownPoints(NamedTuple):
    """Points (m) where the feet touched down, in the axes of the body under each foot, and which feet hold there.

    A foot that slides from one body to another without a swing keeps the point on the first one.
    """

    positions: Float[Array, "6 3"]
    body: Int[Array, " 6"] | None  # -1 is fixed ground; None where there is nothing else
    is_holding: Bool[Array, " 6"]

    @classmethod
    def from_rollout_start(cls, start: RolloutStart) -> "BodyTouchdownPoints":
        """Return the touchdown points of feet that have carried no load yet."""
        body = jnp.full(6, -1, jnp.int32) if len(start.free.position) else None
        return cls(jnp.zeros_like(start.feet), body, jnp.zeros(6, bool))

    def update(self, ctx: MetricContext) -> tuple["BodyTouchdownPoints", Float[Array, " 6"]]:
        """Return the touchdown points after a tick, and the distance (m) of each loaded foot from its point.

        A foot takes hold at its actual position when it is first loaded: after the start, or in the second half of a
        swing. A standing foot that is unloaded for a moment keeps its point, so that chattering does not hide a slip.
        """
        tick = ctx.report
        feet = tick.joints[:, -1]
        swings = ctx.plan.swing[ctx.stage] & ~ctx.finished
        holds = jnp.where(swings, tick.actual.loaded & (ctx.phase > 0.5), self.is_holding | tick.actual.loaded)
        held = holds & self.is_holding
        here = surface_at(ctx.world.obstacle, feet, tick.bodies).body.astype(jnp.int32)
        body = here if self.body is None else jnp.where(held, self.body, here)
        place = jnp.where(held[:, None], self.positions, transform_points_to_body(feet, body, tick.bodies))
        way = jnp.linalg.norm(feet - transform_points_to_world(place, body, tick.bodies), axis=-1)
        return BodyTouchdownPoints(place, None if self.body is None else body, holds), jnp.where(
            holds & tick.actual.loaded, way, 0.0
        )


class FinalIntervalStart(NamedTuple):
    """Positions (m) and time (s) at the start of the plan's last seconds, over which mean velocities are computed."""

    positions: Float[Array, "*k 3"]
    time: Float[Array, ""]

    def update(self, ctx: MetricContext, place: Float[Array, "*k 3"], length: float) -> "FinalIntervalStart":
        """Replace the stored positions and time until the last `length` seconds of the plan begin.

        Args:
            ctx: The tick.
            place: Positions at its end (m).
            length: Duration of the last part (s).
        """
        before = remaining_plan_time(ctx) > length
        return FinalIntervalStart(jnp.where(before, place, self.positions), jnp.where(before, ctx.time, self.time))

    def mean_velocity(self, place: Float[Array, "*k 3"], time: Array) -> Float[Array, "*k 3"]:
        """Return the mean velocity (m/s) over the plan's last seconds, up to positions `place` (m) at `time` (s)."""
        return (place - self.positions) / jnp.maximum(time - self.time, 1e-9)


class RolloutEnd(NamedTuple):
    """World, plan, time and last stage of a rollout after its last tick, from which metrics are computed."""

    world: Case
    plan: Plan
    time: Float[Array, ""]  # s
    stage: Int[Array, ""]
    columns: Mapping[str, Array] = MappingProxyType({})  # of the metrics before

    @property
    def weight(self) -> Array | float:
        """Weight of the robot (N)."""
        return GRAVITY * total_mass(self.world.robot)

    def integrate_sum(self, total: Array) -> Array:
        """Return a sum over ticks unchanged as the integral over time, since engines report integrals of each tick."""
        return total

    def displacement_along_command(self, displacement: Array) -> Array:
        """Raise an error: a displacement along the planned direction is undefined, as that changes between stages."""
        raise NotImplementedError


def make_goal_cause(sentence: str, metric: str, **options: Any) -> Cause:
    """Make a cause of failure for one condition of the manoeuvre's goal, checked when the rollout ends.

    Args:
        sentence: What happened, for messages.
        metric: Name of the metric.
        options: Fields of `Cause`.
    """
    return Cause(GOAL_MISSED, sentence, metric, None, known_at="end", **options)

"""Tracker layers: parts of a plan that modify footholds, stance, command or joint targets in every tick.

A layer is a field of a plan with tables over its stages. It may have a state of its own, which the tracker keeps.
"""

from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from sweep.controllers.frames import points_to_frame, points_to_world
from sweep.controllers.observation import Observation, foot_load_delay_s, touchdown_detection_delay_s
from sweep.controllers.plan import Plan
from sweep.core.rotations import nearest_equivalent_angle
from sweep.formulas import stepping
from sweep.models.drive import ServoCommand
from sweep.models.noise import Noise
from sweep.models.obstacles.surface import FreeBodyState
from sweep.models.posture import Stance, feet_in_world
from sweep.models.robot import Robot

# s after the planned end of a swing, during which all its feet move on into the surface; after it only feet without
# load do.
CREEP_TIME = 0.1
# speed of such a foot over the speed at which all move on
LONE_CREEP_FACTOR = 3.0


class TickContext(NamedTuple):
    """Stage, clock, measurements and plan in one control tick, as tracker layers and feedback laws receive them."""

    robot: Robot  # as believed
    plan: Plan
    last_stage: Int[Array, ""]  # stage number in the last tick
    stage: Int[Array, ""]  # stage number
    clock: Float[Array, ""]  # s since the stage started
    phase: Float[Array, ""]  # of the stage, 0 to 1
    is_first_tick: Bool[Array, ""]  # of the stage
    obs: Observation
    free: FreeBodyState  # reference state of the free bodies, see `Layer.free_body_reference`
    period: float  # s
    joints: Float[Array, "6 3"]  # rad, targets of the last tick
    noise: Noise  # as believed


class Command(NamedTuple):
    """Output of the controller in one tick: joint targets, and the stance that they should produce."""

    joints: Float[Array, "6 3"]  # rad, joint targets
    target: Stance  # stance that the targets should bring about
    phase: Float[Array, ""]  # of the stage, 0 to 1
    shortfall: Float[Array, " 6"]  # m, by which each foot target is out of reach
    # Joints that get a servo law in place of the joint targets, and that law; None: no joint does.
    servo: tuple[Bool[Array, "6 3"], ServoCommand] | None = None
    # `target` with the base where exact sensors would put it, which metrics compare the true pose with; None: the same
    reference: Stance | None = None


class TrackerLayer:
    """Base class of tracker layers, which modify the tracker's commands; by default each method changes nothing.

    The tracker calls the hooks in every tick, in the order in which the layers stand in the plan.
    """

    # whether footholds follow the measured feet, so that they need no shift by the base's error
    anchors_feet: ClassVar = (
        False  # whether footholds follow the feet, which need not be moved with the base's error then
    )

    def init_state(self, start: Stance, joints: Float[Array, "6 3"], free: FreeBodyState) -> Any:
        """Return the tracker layer's state before the first tick.

        Args:
            start: stance of the plan's start, in the frames of its first stage.
            joints: joint angles (rad) of that stance.
            free: free bodies at the start, world axes.
        """
        return None

    def free_body_reference(
        self, plan: Plan, state: Any, stage: Int[Array, ""], clock: Float[Array, ""], free: FreeBodyState
    ) -> FreeBodyState:
        """Return the reference state of the obstacle's free bodies in this stage.

        Args:
            plan: the plan that is followed.
            state: the layer's state.
            stage: stage number.
            clock: s since the stage started.
            free: measured state of the free bodies, or the reference of the layer before, world axes.
        """
        return free

    def on_stage_enter(
        self, stage: Int[Array, ""], state: Any, last_free: FreeBodyState, free: FreeBodyState
    ) -> tuple[Any, FreeBodyState]:
        """Return the layer's state, and the reference state of the free bodies, at the start of a stage.

        Args:
            stage: number of the stage that starts.
            state: the layer's state.
            last_free: reference state of the free bodies in the stage before, world axes.
            free: measured state of the free bodies, world axes.
        """
        return state, free

    def ignores_base_pose(self, stage: Int[Array, ""]) -> Bool[Array, ""] | bool:
        """Return whether the tracker must not correct the feet by the measured base pose in this stage."""
        return False

    def update_footholds(self, ctx: TickContext, feet: Float[Array, "6 3"]) -> Float[Array, "6 3"]:
        """Return the footholds of the current stage (m, in the coordinate frame of each foot) for this tick."""
        return feet

    def extend_late_feet(
        self, plan: Plan, state: Any, stage: Int[Array, ""], clock: Float[Array, ""], feet: Float[Array, "6 3"],
        load_delay: Array | float,
    ) -> Float[Array, "6 3"]:  # fmt: skip
        """Return the commanded feet at the end of a stage; a layer may extend feet whose touchdown is late.

        Args:
            plan: the plan that is followed.
            state: the layer's state.
            stage: stage number.
            clock: s since the stage started.
            feet: planned feet (m, world axes).
            load_delay: lag (s) of measured loads behind measured positions.
        """
        return feet

    def modify_stance(self, ctx: TickContext, state: Any, target: Stance) -> tuple[Any, Stance]:
        """Return the layer's state and the stance to command in place of the planned stance `target` (world axes)."""
        return state, target

    def modify_command(self, ctx: TickContext, state: Any, command: Command) -> tuple[Any, Command]:
        """Return the tracker layer's state, and the command of this tick as the layer modifies it."""
        return state, command

    def modify_joint_targets(self, ctx: TickContext, joints: Float[Array, "6 3"]) -> Float[Array, "6 3"]:
        """Return the joint targets (rad) to send to the drives so that the joints reach the angles `joints`."""
        return joints


class GradualFootholdState(NamedTuple):
    """State of the layer `GradualFootholds`: commanded feet on the way to their new footholds, world axes."""

    command: Float[Array, "6 3"]  # m, feet in the last tick, from the origins of their frames
    offset: Float[Array, "6 3"]  # m, last command before the stage minus the foothold


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class GradualFootholds(TrackerLayer):
    """Tracker layer that moves feet gradually to the footholds of a new stage, so that drives get no jump."""

    time: Float[Array, ""]  # s, duration of the transition

    def init_state(self, start: Stance, joints: Float[Array, "6 3"], free: FreeBodyState) -> GradualFootholdState:
        """Return the layer's state before the first tick, with all feet at their footholds."""
        return GradualFootholdState(start.feet, jnp.zeros_like(start.feet))

    def modify_stance(
        self, ctx: TickContext, state: GradualFootholdState, target: Stance
    ) -> tuple[GradualFootholdState, Stance]:
        """Blend each foot linearly from its last command to its foothold within the layer's `time`."""
        frame, zeros = ctx.plan.foot_frame, jnp.zeros((6, 3))
        before, origin = (points_to_world(zeros, frame[stage], ctx.free) for stage in (ctx.last_stage, ctx.stage))
        left = jnp.where(ctx.is_first_tick, state.command + before - target.feet, state.offset)
        feet = target.feet + jnp.clip(1 - ctx.clock / self.time, 0.0, 1.0) * left
        return GradualFootholdState(feet - origin, left), target._replace(feet=feet)


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class JointSpaceLegs(TrackerLayer):
    """Tracker layer for legs that follow planned joint angles instead of footholds, for each of S stages.

    Made from `Stage.posture`. The state is the joint angles (rad) at the start of the stage.
    """

    held: Bool[Array, "s 6"]  # which legs
    joints: Float[Array, "s 6 3"]  # rad, at the end of the stage

    def init_state(self, start: Stance, joints: Float[Array, "6 3"], free: FreeBodyState) -> Float[Array, "6 3"]:
        """Return the layer's state before the first tick: the joint angles (rad) at the start."""
        return joints

    def modify_command(
        self, ctx: TickContext, state: Float[Array, "6 3"], command: Command
    ) -> tuple[Float[Array, "6 3"], Command]:
        """Move the held legs in a straight line in joint space, accelerating and braking evenly; no reach limits."""
        origin, held = jnp.where(ctx.is_first_tick, ctx.joints, state), self.held[ctx.stage]
        goal = nearest_equivalent_angle(self.joints[ctx.stage], origin)
        posed = origin + stepping.trapezoidal_transfer_timing(ctx.phase, 0.0, 1.0)[0] * (goal - origin)
        joints, target = jnp.where(held[:, None], posed, command.joints), command.target
        feet = feet_in_world(ctx.robot, target.position, target.quat, joints)
        target = target._replace(feet=jnp.where(held[:, None], feet, target.feet))
        shortfall = jnp.where(held, 0.0, command.shortfall)
        return origin, command._replace(joints=joints, target=target, shortfall=shortfall)


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class ForceFeedforward(TrackerLayer):
    """Tracker layer that produces planned foot forces by offsets of joint targets, at K instants of each of S stages.

    A planned force is commanded as an offset of the joint targets. The force acts as planned only if the foothold is
    exactly where the foot stands: with stiff drives, an error of 1 mm is a force as large as the robot's weight.
    Therefore footholds of loaded feet follow the measured feet, and a foot that hangs longer than the others of its
    swing moves on alone, since all feet moving on would push the base away. The state is the distance (m) that each
    foot has moved on alone.

    Made by `PlannedForces.add_force_feedforward`.
    """

    anchors_feet: ClassVar = True
    offset: Float[Array, "s k 6 3"]  # rad, of the joint targets, by which the drives produce the planned torques
    # share of the weight that the planned forces leave unsupported; clearly above 0 where no admissible forces hold the
    # robot
    imbalance: Float[Array, " s"]
    inward: Float[Array, "s 6 3"]  # unit vectors into the surface at the footholds
    creep: Float[Array, ""]  # m/s, of a foot without touchdown at the end of its swing
    anchoring: Float[Array, ""]  # s, time constant with which footholds of loaded feet follow the measured feet

    def init_state(self, start: Stance, joints: Float[Array, "6 3"], free: FreeBodyState) -> Float[Array, " 6"]:
        """Return the initial state: the distance (m) that each foot has crept into the surface, zero."""
        return jnp.zeros(len(joints))

    def on_stage_enter(
        self, stage: Int[Array, ""], state: Float[Array, " 6"], last_free: FreeBodyState, free: FreeBodyState
    ) -> tuple[Float[Array, " 6"], FreeBodyState]:
        """Reset the distances (m) that feet have crept into the surface to zero; free bodies stay as measured."""
        return jnp.zeros_like(state), free

    def modify_stance(
        self, ctx: TickContext, state: Float[Array, " 6"], target: Stance
    ) -> tuple[Float[Array, " 6"], Stance]:
        """Move feet whose touchdown is late farther into the surface, and faster after `CREEP_TIME` seconds.

        A foot that may carry load is excluded, since it would push the base away. The extra motion starts once the
        measured load would have shown a touchdown in time.
        """
        wait = CREEP_TIME + touchdown_detection_delay_s(ctx.noise, ctx.period)
        late = jnp.clip(ctx.clock - ctx.plan.duration[ctx.stage] - wait, 0.0, ctx.period)
        bears = ctx.obs.loaded if ctx.obs.maybe_loaded is None else ctx.obs.maybe_loaded
        state = state + jnp.where(bears, 0.0, LONE_CREEP_FACTOR * self.creep * late)
        load_delay = foot_load_delay_s(ctx.noise, ctx.period)
        feet = self.extend_late_feet(ctx.plan, state, ctx.stage, ctx.clock, target.feet, load_delay)
        return state, target._replace(feet=feet)

    def update_footholds(self, ctx: TickContext, feet: Float[Array, "6 3"]) -> Float[Array, "6 3"]:
        """Shift the footholds of loaded standing feet towards the measured feet.

        The time constant is at least the lag of the loads, so that a foot that just left or landed is not followed by
        mistake for long.
        """
        stage, obs = ctx.stage, ctx.obs
        places = feet_in_world(ctx.robot, obs.position, obs.quat, obs.angles)
        real = points_to_frame(places, ctx.plan.foot_frame[stage], ctx.free)
        time = jnp.maximum(self.anchoring, foot_load_delay_s(ctx.noise, ctx.period))
        share = jnp.where(obs.loaded & ~ctx.plan.swing[stage], jnp.minimum(1.0, ctx.period / time), 0.0)
        return feet + share[:, None] * (real - feet)

    def extend_late_feet(
        self, plan: Plan, state: Float[Array, " 6"], stage: Int[Array, ""], clock: Float[Array, ""],
        feet: Float[Array, "6 3"], load_delay: Array | float,
    ) -> Float[Array, "6 3"]:  # fmt: skip
        """Move swinging feet on into the surface while the stage waits for their touchdown.

        This starts as soon as measured loads may show which feet landed, since feet that move on lift the base off the
        others, and after `CREEP_TIME` at the latest: while feet hang, the base sinks.
        """
        late = jnp.clip(clock - plan.duration[stage] - jnp.minimum(load_delay, CREEP_TIME), 0.0, CREEP_TIME)
        distance = (self.creep * late + state)[:, None] * self.inward[stage]
        return feet + jnp.where(plan.swing[stage][:, None], distance, 0.0)

    def modify_joint_targets(self, ctx: TickContext, joints: Float[Array, "6 3"]) -> Float[Array, "6 3"]:
        """Return the joint targets (rad) plus the offsets that make the drives produce the planned foot forces."""
        return joints + interpolate_stage_values(self.offset, ctx.stage, ctx.phase)


def interpolate_stage_values(
    values: Float[Array, "s k 6 3"], stage: Int[Array, ""], phase: Float[Array, ""]
) -> Float[Array, "6 3"]:
    """Interpolate linearly in time between values given at evenly spaced instants of each stage.

    Args:
        values: values at k evenly spaced moments, from the start to the end of each stage.
        stage: stage number.
        phase: phase of the stage, 0 to 1.
    """
    last = values.shape[1] - 1
    first = jnp.minimum((phase * last).astype(jnp.int32), last - 1)
    share = phase * last - first
    return (1 - share) * values[stage, first] + share * values[stage, first + 1]

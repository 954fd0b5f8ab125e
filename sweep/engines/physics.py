"""The physics steps of one control tick in the `mjx` engine, and their summary for the metrics.

All functions are written for one rollout.
"""

from collections.abc import Callable
from functools import reduce
from operator import add
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from sweep.backends import mujoco_versions
from sweep.contract.engine_settings import EngineSettings
from sweep.core.vectors import Vector
from sweep.dynamics import step as dynamics
from sweep.dynamics import tree
from sweep.dynamics.interface import ModelTopology, SmoothDynamics
from sweep.dynamics.spatial import JointTriple, map_leg_joints
from sweep.dynamics.step import (
    DriveLimits,
    PhysicsState,
    StepReport,
    StepStart,
    pack_physics_state,
    unpack_physics_state,
)
from sweep.engines import batching
from sweep.engines.closed_loop import exact_observation
from sweep.metrics.tick import EngineTickReport
from sweep.models.case import Case
from sweep.models.disturbance import ExecutionFaults
from sweep.models.drive import ServoCommand, interpolate_target
from sweep.models.legs import N_JOINTS, N_LEGS
from sweep.models.obstacles.surface import BodyPoses
from sweep.models.robot import link_names


def dynamics_name(settings: EngineSettings) -> str:
    """Name of the smooth dynamics that the settings select: `arrowhead` or `mjx`."""
    return "arrowhead" if settings.dynamics == "auto" else settings.dynamics


def make_tick_physics(settings: EngineSettings, top: ModelTopology) -> "TickPhysics":
    """Make the object that simulates the physics of a scenario for a control tick.

    Args:
        settings: smooth dynamics, time step and solver iterations.
        top: bodies and joints of the nominal model.
    """
    if dynamics_name(settings) == "arrowhead":
        return TickPhysics(settings, batching.physics_steps_per_tick(settings), tree.tree_dynamics)
    mujoco_versions.require_mjx("engine.dynamics = mjx", "engine.dynamics=auto")
    from sweep.dynamics import mjx

    return TickPhysics(settings, batching.physics_steps_per_tick(settings), mjx.mjx_dynamics(top))


def drive_limits_at_step(world: Case, step: Array, h: float) -> DriveLimits:
    """Return the limits of the drives and the push force (N) during one physics step.

    Args:
        world: the simulated case.
        step: number of the physics step, from the start of the rollout.
        h: length of a physics step (s).

    Returns:
        Gain and torque limit (N m) of each joint, and the push on the base (N, world axes), see `push_force`.
    """
    execution = world.execution
    alive = jnp.arange(N_JOINTS).reshape(N_LEGS, 3) != jnp.round(execution.dead_joint)
    torque = jnp.full((6, 3), execution.torque_scale * world.drive.torque_limit)
    return DriveLimits(alive.astype(torque.dtype), torque, push_force(execution, step, h))


def push_force(execution: ExecutionFaults, step: Array, h: float) -> Float[Array, " 3"]:
    """Return the mean force (N) of the scenario's push on the base during one physics step.

    A step that overlaps the push in part gets that part of its force, so that the impulse is exact for any duration. A
    push shorter than a step has its impulse in one step, or in two.

    Args:
        execution: the push: impulse (N s), direction (rad), beginning and duration (s).
        step: number of the physics step, from the start of the rollout.
        h: length of a physics step (s).

    Returns:
        Force on the base (N, world axes).
    """
    begin, length = (
        _remove_rounding(execution.push_time / h),
        _remove_rounding(execution.push_duration / h),
    )  # physics steps
    since = step - begin
    part = jnp.clip(since + 1, 0, length) - jnp.clip(since, 0, length)
    size = execution.push_impulse / jnp.maximum(execution.push_duration, h) * (part / jnp.minimum(length, 1))
    angle = execution.push_direction
    return size * jnp.stack([jnp.cos(angle), jnp.sin(angle), jnp.zeros_like(jnp.cos(angle))])


def _remove_rounding(steps: Array | float) -> Array:
    """Round a number of steps to the nearest integer if it is within a millionth of it."""
    nearest = jnp.round(steps)
    return jnp.where(jnp.abs(steps - nearest) <= 1e-6 * jnp.abs(steps), nearest, steps)


class TickTotals(NamedTuple):
    """Totals over the physics steps of a control tick: peak torques and solver residual, sums of forces and powers."""

    torque_peak: JointTriple
    saturated: JointTriple
    force: Vector
    normal: Array
    residual: Array
    power: JointTriple  # (l,)
    effort: Array  # (l,), power of driving joints only
    external_power: Array

    def add_step(self, report: StepReport) -> "TickTotals":
        """Return the totals with the report of one more physics step added."""
        return TickTotals(
            map_leg_joints(lambda peak, u: jnp.maximum(peak, jnp.abs(u)), self.torque_peak, report.torque),
            map_leg_joints(add, self.saturated, report.saturated),
            self.force + report.force,
            self.normal + report.normal,
            jnp.maximum(self.residual, report.residual),
            map_leg_joints(add, self.power, report.power),
            reduce(add, (jnp.maximum(p, 0.0) for p in report.power), self.effort),
            self.external_power + report.external_power,
        )


class TickPhysics(NamedTuple):
    """Simulates robot and free bodies from one control tick to the next."""

    settings: EngineSettings
    substeps: int
    smooth_dynamics: Callable[[Case], SmoothDynamics]

    def energy(self, world: Case, state: PhysicsState) -> Array:
        """Return kinetic and potential energy (J) of robot and free bodies in a state."""
        return dynamics.mechanical_energy(self.smooth_dynamics(world), world, unpack_physics_state(state))[0]

    def advance(
        self, world: Case, state: PhysicsState, servo_before: ServoCommand, servo_after: ServoCommand, tick: Array
    ) -> tuple[PhysicsState, EngineTickReport]:
        """Simulate the physics steps of one control tick.

        Args:
            world: simulated parameters.
            state: state before the tick.
            servo_before: drive target at the start of the tick.
            servo_after: drive target at its end; the target goes linearly from one to the other.
            tick: number of the control tick.

        Returns:
            The state after the tick, and its summary. Positions and energy in the summary are those at the start of the
            last physics step, which saves a second pass of kinematics.
        """
        n, h = self.substeps, self.settings.time_step
        smooth_dynamics = self.smooth_dynamics(world)

        def substep(carry: tuple, k: Array) -> tuple[tuple, None]:
            moving, totals, *_ = carry
            servo = interpolate_target(servo_before, servo_after, (k + 1) / n)
            limits = drive_limits_at_step(world, tick * n + k, h)
            moving, report = dynamics.step(smooth_dynamics, world, limits, moving, servo, h, self.settings.iterations)
            return (moving, totals.add_step(report), report.normal, report.start), None

        nothing = _initial_totals(world, state.q.dtype)
        (moving, totals, load, before), _ = jax.lax.scan(
            substep, (unpack_physics_state(state), *nothing), jnp.arange(n)
        )
        state = pack_physics_state(moving)
        force, normal = (1 / n) * totals.force, totals.normal / n
        along = force - normal * before.normal
        return state, EngineTickReport(
            torque_peak=_by_joint(totals.torque_peak),
            saturated=_by_joint(totals.saturated) / n,
            force=force.array(),
            normal=normal,
            tangential=jnp.sqrt(along.dot(along)),
            residual=totals.residual[0],
            work=h * (jnp.sum(reduce(add, totals.power)) + totals.external_power[0]),
            positive_work=h * jnp.sum(totals.effort),
            power=_by_joint(totals.power) / n,
            energy=before.energy[0],
            actual=exact_observation(state.q, state.v, before.bodies.position.shape[0], load),
            centre_of_mass=before.centre_of_mass.array()[0],
            joints=jnp.stack([joint.array() for joint in before.joints], axis=1),
            bodies=before.bodies,
        )


def _initial_totals(world: Case, dtype: jnp.dtype) -> tuple[TickTotals, Array, StepStart]:
    """Totals, foot loads and step start before the first physics step."""
    leg, one, bodies = jnp.zeros(N_LEGS, dtype), jnp.zeros(1, dtype), len(world.obstacle.free_bodies)
    legs, base, three = Vector(leg, leg, leg), Vector(one, one, one), (leg, leg, leg)
    joints = (legs,) * (len(link_names(world.robot)) + 1)
    before = StepStart(
        legs, one, base, joints, BodyPoses(jnp.zeros((bodies, 3), dtype), jnp.zeros((bodies, 3, 3), dtype))
    )
    return TickTotals(three, three, legs, leg, one, three, leg, one), leg, before


def _by_joint(parts: JointTriple) -> Array:
    return jnp.stack(parts, axis=-1)

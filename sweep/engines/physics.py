"""The physics steps of one control tick of `mjx`, and what the metrics want of them. Functions of one rollout."""

import io
from collections.abc import Callable
from contextlib import redirect_stdout
from functools import partial
from typing import NamedTuple, Protocol

import jax
import jax.numpy as jnp
from jaxtyping import Array

from sweep.dynamics import structured, tree_step
from sweep.dynamics.interface import SmoothDynamics, Topology
from sweep.dynamics.step import State, StepReport, kinetic_energy, step
from sweep.dynamics.tree import fits
from sweep.dynamics.tree_step import from_state, to_state
from sweep.engines import batching
from sweep.engines.closed_loop import free_state
from sweep.engines.settings import EngineSettings
from sweep.metrics.metric import Tick
from sweep.models.case import Case
from sweep.models.drive import Servo, towards
from sweep.models.legs import N_LEGS
from sweep.models.obstacles.surface import no_bodies, poses


class Physics(Protocol):
    """A way to simulate the world between two control ticks."""

    def energy(self, world: Case, state: State) -> Array:
        """Kinetic and potential energy (J)."""
        ...

    def advance(self, world: Case, state: State, old: Servo, new: Servo, tick: Array) -> tuple[State, Tick]:
        """The state and the summary after tick number `tick`, what the drives are told going from `old` to `new`.

        Positions and energy in the summary are those at the start of the last step: no kinematics twice.
        """
        ...


def taken(settings: EngineSettings, world: Case) -> str:
    """The smooth dynamics that `settings` mean for `world`."""
    if settings.dynamics == "auto":
        return "arrowhead" if fits(world) else "mjx"
    return settings.dynamics


def make(settings: EngineSettings, top: Topology, world: Case) -> Physics:
    """The physics of a scenario; on ground that does not move, the structured step written out."""
    if taken(settings, world) == "mjx":
        with redirect_stdout(io.StringIO()):  # MJX is slow to import, and prints that
            from sweep.dynamics import mjx as mjx_dynamics

        return General(settings, top, mjx_dynamics.of(top))
    return General(settings, top, structured.of(top)) if top.free else OnFixedGround(settings)


class Totals(NamedTuple):
    """Sums and peaks over the physics steps of a tick."""

    torque_peak: Array
    saturated: Array
    force: Array
    normal: Array
    residual: Array
    work: Array
    effort: Array


class General(NamedTuple):
    """The step for any obstacle, on MJX's smooth dynamics or on the structured ones."""

    settings: EngineSettings
    top: Topology
    smooth_dynamics: Callable[[Case], SmoothDynamics]

    def energy(self, world: Case, state: State) -> Array:
        """Kinetic and potential energy (J)."""
        smooth = self.smooth_dynamics(world)(state.q, state.v)
        return smooth.potential + kinetic_energy(self.top, smooth, state.v)

    def advance(self, world: Case, state: State, old: Servo, new: Servo, tick: Array) -> tuple[State, Tick]:
        """See `Physics`."""
        n, h = batching.substeps(self.settings), self.settings.time_step
        smooth = self.smooth_dynamics(world)

        def substep(state: State, k: Array) -> tuple[State, tuple[Totals, StepReport]]:
            servo = towards(old, new, (k + 1) / n)
            limits = batching.execution_limits(world, (tick * n + k) * h)
            state, report = step(self.top, smooth, world, limits, state, servo, h, self.settings.iterations)
            power = jnp.sum(report.power) + limits.push @ state.v[:3]
            totals = Totals(
                jnp.abs(report.torque), report.saturated, report.forces.force[:N_LEGS], report.forces.normal[:N_LEGS],
                report.residual, h * power, h * jnp.sum(jnp.maximum(report.power, 0.0)),
            )  # fmt: skip
            return state, (totals, report)

        state, (each, reports) = jax.lax.scan(substep, state, jnp.arange(n))
        peak, mean, total = partial(jnp.max, axis=0), partial(jnp.mean, axis=0), partial(jnp.sum, axis=0)
        totals = Totals(peak(each.torque_peak), mean(each.saturated), mean(each.force), mean(each.normal),
                        peak(each.residual), total(each.work), total(each.effort))  # fmt: skip
        return state, self._summary(state, totals, jax.tree.map(lambda x: x[-1], reports))

    def _summary(self, state: State, totals: Totals, last: StepReport) -> Tick:
        smooth, per_leg = last.smooth, self.top.links_per_leg
        links = smooth.links[: N_LEGS * per_leg].reshape(N_LEGS, per_leg, 3)
        joints = jnp.concatenate([links, smooth.point[:N_LEGS, None]], axis=1)
        along = totals.force - totals.normal[:, None] * last.normal[:N_LEGS]
        return Tick(
            torque_peak=totals.torque_peak, saturated=totals.saturated, force=totals.force, normal=totals.normal,
            tangential=jnp.linalg.norm(along, axis=-1), loaded=last.forces.normal[:N_LEGS] > 1.0,
            residual=totals.residual, work=totals.work, effort=totals.effort, energy=last.kinetic + smooth.potential,
            position=state.q[:3], quat=state.q[3:7], velocity=state.v[:3], spin=state.v[3:6],
            angles=state.q[1 + self.top.leg], rates=state.v[self.top.leg], centre_of_mass=smooth.centre_of_mass,
            joints=joints, bodies=smooth.bodies, free=free_state(state.q, state.v, len(self.top.free)),
        )  # fmt: skip


class OnFixedGround(NamedTuple):
    """The step of `star_step`."""

    settings: EngineSettings

    def energy(self, world: Case, state: State) -> Array:
        """Kinetic and potential energy (J)."""
        return tree_step.energy(world, from_state(state))[0]

    def advance(self, world: Case, state: State, old: Servo, new: Servo, tick: Array) -> tuple[State, Tick]:
        """See `Physics`."""
        n, h = batching.substeps(self.settings), self.settings.time_step

        def substep(carry: tuple, k: Array) -> tuple[tuple, None]:
            moving, sums, _ = carry
            servo = towards(old, new, (k + 1) / n)
            limits = batching.execution_limits(world, (tick * n + k) * h)
            moving, report = tree_step.step(world, limits, moving, servo, h, self.settings.iterations)
            return (moving, tree_step.add(sums, report), report.end), None

        nothing = tree_step.nothing(world, state.q.dtype)
        (moving, sums, end), _ = jax.lax.scan(substep, (from_state(state), *nothing), jnp.arange(n))
        return (state := to_state(moving)), self._summary(state, sums, end, n, h)

    def _summary(self, state: State, sums: tree_step.Sums, end: tree_step.End, n: int, h: float) -> Tick:
        force, normal = (1 / n) * sums.force, sums.normal / n
        along = force - normal * end.normal
        legs = (N_LEGS, 3)
        return Tick(
            torque_peak=_by_joint(sums.torque_peak), saturated=_by_joint(sums.saturated) / n, force=force.array(),
            normal=normal, tangential=jnp.sqrt(along.dot(along)), loaded=end.normal_force > 1.0,
            residual=sums.residual[0], work=h * (jnp.sum(sums.power) + sums.push[0]), effort=h * jnp.sum(sums.effort),
            energy=end.energy[0], position=state.q[:3], quat=state.q[3:7], velocity=state.v[:3], spin=state.v[3:6],
            angles=state.q[7:].reshape(legs), rates=state.v[6:].reshape(legs),
            centre_of_mass=end.centre_of_mass.array()[0],
            joints=jnp.stack([joint.array() for joint in end.joints], axis=1), bodies=poses(no_bodies()),
            free=no_bodies(),
        )  # fmt: skip


def _by_joint(parts: tuple[Array, Array, Array]) -> Array:
    return jnp.stack(parts, axis=-1)

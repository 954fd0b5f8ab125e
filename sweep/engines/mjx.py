"""The primary engine: controller, physics and metrics fused in one scan, vmapped over the batch; CPU and GPU alike."""

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import PartitionSpec
from jaxtyping import Array
from mujoco import mjx

from sweep.case import Case
from sweep.controllers.plan import Plan
from sweep.engines import batching, devices
from sweep.engines.base import Figures, Trace
from sweep.engines.pilot import GRACE, Pilot, decide, embark, free_state, is_quiet, measure, most_ticks, start_state
from sweep.engines.settings import EngineSettings
from sweep.metrics import stream
from sweep.metrics.outcome import Thresholds
from sweep.metrics.stream import Tick
from sweep.models import dynamics, scene
from sweep.models.drive import Servo, towards
from sweep.models.step import State, StepReport, kinetic_energy, rest, step

CHUNK = 1.0  # s of simulated time between two looks of the host
N_LEGS = 6


class Carry(NamedTuple):
    """One rollout between two control ticks."""

    state: State
    pilot: Pilot


class Totals(NamedTuple):
    """Sums and peaks over the physics steps of a tick."""

    torque_peak: Array
    saturated: Array
    force: Array
    normal: Array
    residual: Array
    work: Array
    effort: Array


class Mjx:
    """MJX's smooth dynamics with the implicit contact step."""

    def __init__(self, settings: EngineSettings, world: Case, belief: Case, limits: Thresholds | None = None):
        devices.configure()
        self.settings = settings
        self.limits = limits or Thresholds()
        self.substeps = batching.substeps(settings)
        self.width = settings.width or devices.default_width()
        self._mesh = devices.mesh(self.width)
        self.devices = jax.device_count()
        with devices.precision(settings):
            self.topology = dynamics.topology(world)
            self._data = mjx.make_data(self.topology.model)
            plan = batching.nominal_plan(belief)
            self.stages = plan.names
            self.duration = float(GRACE * np.sum(plan.duration))
        self._compiled: dict[Any, tuple[Callable, Callable, Callable]] = {}

    @devices.memory()
    def run(self, world: Case, belief: Case, streams: np.ndarray) -> Figures:
        """Figures of `width` rollouts; stops early when every rollout is over."""
        with devices.precision(self.settings):
            (world, belief, keys), start, chunk, finish = self._prepare(world, belief, streams)
            plans, carry = start(world, belief, keys)
            for tick in range(0, most_ticks(plans, self.settings.control_period), self._chunk_ticks):
                carry, _ = chunk(world, belief, plans, carry, tick, None)
                if bool(jnp.all(carry.pilot.running.over)):
                    break
            return {name: np.asarray(values) for name, values in finish(plans, carry).items()}

    def trace(self, world: Case, belief: Case, streams: np.ndarray, slot: int) -> Trace:
        """The rollout in `slot`, simulated in its batch so that its numbers are those of `run`."""
        with devices.precision(self.settings):
            one = batching.pick(world, slot)
            (world, belief, keys), start, chunk, finish = self._prepare(world, belief, streams)
            plans, carry = start(world, belief, keys)
            records, local = [], self.width // self._mesh.size
            for tick in range(0, most_ticks(plans, self.settings.control_period), self._chunk_ticks):
                carry, record = chunk(world, belief, plans, carry, tick, slot)
                records.append(jax.tree.map(lambda x: np.asarray(x)[:, slot // local], record))
                if bool(carry.pilot.running.over[slot]):
                    break
            figures = {name: np.asarray(values)[slot] for name, values in finish(plans, carry).items()}
        record = jax.tree.map(lambda *parts: np.concatenate(parts), *records)
        return batching.to_trace(scene.compile_model(one), record, self.settings.control_period, self.stages, figures)

    @property
    def _chunk_ticks(self) -> int:
        return max(1, round(CHUNK / self.settings.control_period))

    def _prepare(self, world: Case, belief: Case, streams: np.ndarray) -> tuple:
        """Arguments as arrays of the right type, and the compiled functions for their batch axes."""
        batching.check(streams, self.width)
        axes, quiet = devices.axes((world, belief)), is_quiet(world.noise)
        form = devices.form((world, belief)), quiet
        if form not in self._compiled:
            self._compiled[form] = self._compile(axes, devices.specs((world, belief)), quiet)
        arrays = (*devices.as_arrays((world, belief)), devices.keys(streams))
        return devices.spread(arrays, self._mesh), *self._compiled[form]

    def _compile(self, axes: tuple[Case, Case], specs: tuple, quiet: bool) -> tuple[Callable, Callable, Callable]:
        """`start`, `chunk` and `finish` over a batch whose parameters vary along `axes`, split over the devices."""
        world_axes, belief_axes = axes
        local = self.width // self._mesh.size
        built = (world_axes.robot, world_axes.drive, world_axes.obstacle)
        model_axis = 0 if jax.tree.leaves(built) else None  # one model for the batch, unless it is swept
        varying = partial(dynamics.varying, self.topology)
        models = varying if model_axis is None else jax.vmap(varying, in_axes=(world_axes,))
        tick = jax.vmap(partial(self._tick, quiet=quiet), in_axes=(world_axes, belief_axes, model_axis, 0, 0, None))

        def chunk(world: Case, belief: Case, plans: Plan, carry: Carry, first: Array, slot: Array | None) -> Any:
            fields = models(world)

            def body(carry: Carry, k: Array) -> tuple[Carry, Any]:
                carry, record = tick(world, belief, fields, plans, carry, k)
                if slot is None:
                    return carry, None
                return carry, jax.tree.map(lambda x: x[None, jnp.asarray(slot) % local], record)

            return jax.lax.scan(body, carry, first + jnp.arange(self._chunk_ticks))

        split, whole = PartitionSpec(devices.BATCH), PartitionSpec()
        on_devices = partial(jax.shard_map, mesh=self._mesh, check_vma=False)
        start = on_devices(jax.vmap(self._start, in_axes=(*axes, 0)), in_specs=(*specs, split), out_specs=split)
        recorded = (split, PartitionSpec(None, devices.BATCH))
        chunk = on_devices(chunk, in_specs=(*specs, split, split, whole, whole), out_specs=recorded)
        finish = on_devices(jax.vmap(self._finish), in_specs=(split, split), out_specs=split)
        return jax.jit(start), jax.jit(chunk, donate_argnums=3), jax.jit(finish)

    def _start(self, world: Case, belief: Case, key: Array) -> tuple[Plan, Carry]:
        plan = belief.manoeuvre.plan(belief)
        start = start_state(world, belief, plan)
        model = self._model(dynamics.varying(self.topology, world))
        state = rest(self.topology, start.qpos)._replace(v=start.qvel)
        smooth = dynamics.smooth_dynamics(self.topology, model, self._data, state.q, state.v)
        energy = smooth.potential + kinetic_energy(self.topology, smooth, state.v)
        return plan, Carry(state, embark(world, belief, plan, start, energy, key))

    def _model(self, fields: dict[str, Array]) -> mjx.Model:
        return self.topology.model.replace(**fields)

    def _finish(self, plan: Plan, carry: Carry) -> dict[str, Array]:
        return stream.figures(plan, carry.pilot.running, carry.pilot.tracker.stage)

    def _tick(
        self, world: Case, belief: Case, fields: dict[str, Array], plan: Plan, carry: Carry, tick: Array, quiet: bool
    ) -> tuple[Carry, dict[str, Array]]:
        period = self.settings.control_period
        old = carry.pilot.servo
        pilot, command = decide(world, belief, plan, carry.pilot, tick, period, quiet)
        state, totals, last = self._physics(world, fields, carry.state, old, pilot.servo, tick)
        summary = self._summary(state, totals, last)
        pilot = measure(world, plan, self.limits, pilot, command, summary, period)
        record = batching.record(command, pilot.tracker, summary, state.q)
        return Carry(state, pilot), record

    def _physics(
        self, world: Case, fields: dict[str, Array], state: State, old: Servo, new: Servo, tick: Array
    ) -> tuple[State, Totals, StepReport]:
        """The physics steps of one tick, what the drives are told going from `old` to `new`."""
        n, h = self.substeps, self.settings.time_step
        model = self._model(fields)

        def substep(state: State, k: Array) -> tuple[State, tuple[Totals, StepReport]]:
            servo = towards(old, new, (k + 1) / n)
            limits = batching.execution_limits(world, (tick * n + k) * h)
            state, report = step(self.topology, model, self._data, world, limits, state, servo, h,
                                 self.settings.iterations)  # fmt: skip
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
        return state, totals, jax.tree.map(lambda x: x[-1], reports)

    def _summary(self, state: State, totals: Totals, last: StepReport) -> Tick:
        """Positions and energy are those at the start of the last physics step, 2 ms back: no kinematics twice."""
        smooth = last.smooth
        links = smooth.links[: 6 * self.topology.links_per_leg].reshape(6, self.topology.links_per_leg, 3)
        feet = smooth.point[:N_LEGS]
        along = totals.force - totals.normal[:, None] * last.normal[:N_LEGS]
        return Tick(
            torque_peak=totals.torque_peak, saturated=totals.saturated, force=totals.force, normal=totals.normal,
            tangential=jnp.linalg.norm(along, axis=-1), loaded=last.forces.normal[:N_LEGS] > 1.0,
            residual=totals.residual, work=totals.work, effort=totals.effort, energy=last.kinetic + smooth.potential,
            position=state.q[:3], quat=state.q[3:7], velocity=state.v[:3], spin=state.v[3:6],
            angles=state.q[1 + self.topology.leg], rates=state.v[self.topology.leg],
            centre_of_mass=smooth.centre_of_mass, joints=jnp.concatenate([links, feet[:, None]], axis=1),
            bodies=smooth.bodies, free=free_state(state.q, state.v, len(self.topology.free)),
        )  # fmt: skip

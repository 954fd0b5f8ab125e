"""The primary engine: controller, physics and metrics of a batch fused in one scan; CPU and GPU alike."""

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import PartitionSpec
from jax.stages import Compiled
from jaxtyping import Array

from sweep.controllers.plan import Plan
from sweep.dynamics import interface as dynamics
from sweep.dynamics.step import State, rest
from sweep.engines import batching, devices, physics, program_cache
from sweep.engines.base import Figures, Trace
from sweep.engines.batch_last import batch_last_vmap
from sweep.engines.closed_loop import GRACE, ClosedLoop, act, init, is_quiet, measure, most_ticks, start_state
from sweep.engines.settings import EngineSettings
from sweep.metrics import stream
from sweep.metrics.outcome import Thresholds
from sweep.models.case import Case

CHUNK = 1.0  # s of simulated time between two looks of the host


class Carry(NamedTuple):
    """One rollout between two control ticks."""

    state: State
    loop: ClosedLoop


class Programs(NamedTuple):
    """What a batch runs through, compiled."""

    start: Callable[[Case, Case, Array], tuple[Plan, Carry]]
    chunk: Callable[[Case, Case, Plan, Carry, int, int | None], tuple[Carry, Any]]
    finish: Callable[[Case, Plan, Carry], dict[str, Array]]


class Mjx:
    """The implicit contact step on structured or on MJX's smooth dynamics."""

    def __init__(self, settings: EngineSettings, world: Case, belief: Case, limits: Thresholds | None = None):
        devices.configure()
        self.settings = settings
        self.limits = limits or Thresholds()
        self.substeps = batching.substeps(settings)
        self.dynamics = physics.taken(settings)
        self.width = settings.width or devices.default_width()
        self._mesh = devices.mesh(self.width)
        self.devices = jax.device_count()
        with devices.precision(settings):
            self.topology = dynamics.topology(world)
            self.physics = physics.make(settings, self.topology)
            plan = batching.nominal_plan(belief)
            self.stages = plan.names
            self.duration = float(GRACE * np.sum(plan.duration))
        self._nominal = world, belief
        self._programs: dict[Any, Programs] = {}

    def rollout_bytes(self) -> int:
        """See `Engine`; nothing is compiled for it."""
        with devices.precision(self.settings):
            held = jax.eval_shape(self._start, *devices.as_arrays(self._nominal), jax.random.key(0))
        return sum(x.size * x.dtype.itemsize for x in jax.tree.leaves(held))

    @devices.memory()
    def run(self, world: Case, belief: Case, streams: np.ndarray) -> Figures:
        """Figures of `width` rollouts; stops early when every rollout is over."""
        with devices.precision(self.settings):
            (world, belief, keys), programs = self._prepare(world, belief, streams, None)
            plans, carry = programs.start(world, belief, keys)
            for tick in range(0, most_ticks(plans, self.settings.control_period), self._chunk_ticks):
                carry, _ = programs.chunk(world, belief, plans, carry, tick, None)
                # on the host: among devices it would take their collective operations, which can hang
                if np.all(np.asarray(carry.loop.running.over)):
                    break
            return {name: np.asarray(values) for name, values in programs.finish(world, plans, carry).items()}

    def trace(self, world: Case, belief: Case, streams: np.ndarray, slot: int) -> Trace:
        """The rollout in `slot`, simulated in its batch so that its numbers are those of `run`."""
        with devices.precision(self.settings):
            one = batching.pick(world, slot), batching.pick(belief, slot)
            (world, belief, keys), programs = self._prepare(world, belief, streams, slot)
            plans, carry = programs.start(world, belief, keys)
            records, local = [], self.width // self._mesh.size
            for tick in range(0, most_ticks(plans, self.settings.control_period), self._chunk_ticks):
                carry, record = programs.chunk(world, belief, plans, carry, tick, slot)
                records.append(jax.tree.map(lambda x: np.asarray(x)[:, slot // local], record))
                if bool(carry.loop.running.over[slot]):
                    break
            figures = {name: np.asarray(x)[slot] for name, x in programs.finish(world, plans, carry).items()}
        record = jax.tree.map(lambda *parts: np.concatenate(parts), *records)
        return batching.to_trace(*one, record, self.settings.control_period, self.stages, figures)

    @property
    def _chunk_ticks(self) -> int:
        return max(1, round(CHUNK / self.settings.control_period))

    def _prepare(
        self, world: Case, belief: Case, streams: np.ndarray, slot: int | None
    ) -> tuple[tuple[Case, Case, Array], Programs]:
        """Arguments as arrays of the right type, and the programs for their batch axes; `slot` is recorded."""
        batching.check(streams, self.width)
        quiet = is_quiet(world.noise)
        form = devices.form((world, belief)), quiet, slot is None
        arrays = devices.spread((*devices.as_arrays((world, belief)), devices.keys(streams)), self._mesh)
        if form not in self._programs:
            compiled = partial(self._compile, arrays, quiet, slot)
            made_of, on = (form, *self._made_of), list(self._mesh.devices.flat)
            self._programs[form] = Programs(*program_cache.programs(made_of, on, compiled))
        return arrays, self._programs[form]

    @property
    def _made_of(self) -> tuple:
        """All that the programs depend on beside the form of their arguments; MJX's dynamics hold the nominal model."""
        top = self.topology
        model = dynamics.saved(top.model) if self.dynamics == "mjx" else None
        return self.settings, self.limits, self.width, self.dynamics, top.names, top.owner, model

    def _compile(
        self, arrays: tuple[Case, Case, Array], quiet: bool, slot: int | None
    ) -> tuple[Compiled, Compiled, Compiled]:
        """The programs over batches like `arrays`, split over the devices.

        They are compiled side by side: the compiler needs no Python, which traces the next one meanwhile.
        """
        world, belief, _ = arrays
        axes, specs = devices.axes((world, belief)), devices.specs((world, belief))
        split, whole = PartitionSpec(devices.BATCH), PartitionSpec()
        on_devices = partial(jax.shard_map, mesh=self._mesh, check_vma=False)
        start = on_devices(jax.vmap(self._start, in_axes=(*axes, 0)), in_specs=(*specs, split), out_specs=split)
        recorded = (split, PartitionSpec(None, devices.BATCH))
        chunk = on_devices(self._chunk(axes, quiet), in_specs=(*specs, split, split, whole, whole), out_specs=recorded)
        finish = jax.vmap(self._finish, in_axes=(axes[0], 0, 0))
        finish = on_devices(finish, in_specs=(specs[0], split, split), out_specs=split)
        with ThreadPoolExecutor() as pool:
            begin = jax.jit(start, compiler_options=devices.plan_options()).lower(*arrays)
            started = pool.submit(begin.compile)
            plans, carry = devices.split(begin.out_info, self._mesh)
            go_on = jax.jit(chunk, donate_argnums=3)
            chunked = pool.submit(go_on.lower(world, belief, plans, carry, 0, slot).compile)
            finished = jax.jit(finish).lower(world, plans, carry).compile()
            return started.result(), chunked.result(), finished

    def _chunk(self, axes: tuple[Case, Case], quiet: bool) -> Callable:
        """A second of the batch that a device has, of which the rollout in a slot may be recorded."""
        local = self.width // self._mesh.size
        tick = batch_last_vmap(partial(self._tick, quiet=quiet), (*_last(axes), -1, -1, None), devices.reuse_from())

        def chunk(world: Case, belief: Case, plans: Plan, carry: Carry, first: Array, slot: Array | None) -> Any:
            world, belief, plans, carry = _batch_last((world, belief, plans, carry))

            def body(carry: Carry, k: Array) -> tuple[Carry, Any]:
                carry, record = tick(world, belief, plans, carry, k)
                if slot is None:
                    return carry, None
                return carry, jax.tree.map(lambda x: x[None, ..., jnp.asarray(slot) % local], record)

            carry, records = jax.lax.scan(body, carry, first + jnp.arange(self._chunk_ticks))
            return _batch_first(carry), records

        return chunk

    def _start(self, world: Case, belief: Case, key: Array) -> tuple[Plan, Carry]:
        plan = belief.manoeuvre.plan(belief)
        start = start_state(world, belief, plan)
        state = rest(self.topology, start.qpos)._replace(v=start.qvel)
        energy = self.physics.energy(world, state)
        return plan, Carry(state, init(world, belief, plan, start, energy, key))

    def _finish(self, world: Case, plan: Plan, carry: Carry) -> dict[str, Array]:
        return stream.figures(world, plan, carry.loop.running, carry.loop.tracker.stage)

    def _tick(
        self, world: Case, belief: Case, plan: Plan, carry: Carry, tick: Array, quiet: bool
    ) -> tuple[Carry, dict[str, Array]]:
        period = self.settings.control_period
        old = carry.loop.servo
        loop, command = act(world, belief, plan, carry.loop, tick, period, quiet)
        state, summary = self.physics.advance(world, carry.state, old, loop.servo, tick)
        loop = measure(world, plan, self.limits, loop, command, summary, tick, period)
        record = batching.record(command, loop.tracker, summary, state.q, state.v)
        return Carry(state, loop), record


def _last(axes: Any) -> Any:
    """Batch axes of what has been put `_batch_last`."""
    return jax.tree.map(lambda _: -1, axes)


def _batch_last(tree: Any) -> Any:
    """Leaves that vary over the batch with that axis last; the others are plain numbers."""
    return jax.tree.map(lambda x: jnp.moveaxis(x, 0, -1) if jnp.ndim(x) else x, tree)


def _batch_first(tree: Any) -> Any:
    return jax.tree.map(lambda x: jnp.moveaxis(x, -1, 0), tree)

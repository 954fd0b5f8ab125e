"""The primary engine: controller, physics and metrics of a tick in one program, by this package's compiler or XLA."""

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

from sweep.controllers.belief_update import replan_rest
from sweep.controllers.plan import Plan
from sweep.core.errors import InputError
from sweep.core.progress import timed_part
from sweep.dynamics import interface as dynamics
from sweep.dynamics.free_bodies import start_at_rest
from sweep.dynamics.step import PhysicsState, state_at_rest
from sweep.engines import batching, devices, fused_loop, physics, planning, program_cache
from sweep.engines.base import Figures, Watch
from sweep.engines.batch_last import batch_last_vmap
from sweep.engines.batching import Batched
from sweep.engines.closed_loop import (
    CHUNK,
    ClosedLoop,
    Sensing,
    act,
    figures_of,
    init,
    measure,
    most_ticks,
    sensing,
    start_state,
)
from sweep.engines.fused_loop import Fused, single_rollout_shapes
from sweep.engines.planning import Planning
from sweep.engines.pre_rollout import prepare_belief
from sweep.engines.settings import EngineSettings
from sweep.engines.states import available_columns, select_columns
from sweep.fused import driver, kernel, launch
from sweep.fused.eager import Eager
from sweep.fused.kernel import Code, Kernel
from sweep.metrics.outcome import Thresholds
from sweep.models.binary import model_bytes
from sweep.models.case import Case


class Carry(NamedTuple):
    """One rollout between two control ticks."""

    state: PhysicsState
    loop: ClosedLoop

    @property
    def is_over(self) -> Array:
        """Whether nothing is to come."""
        return self.loop.running.over


class XlaPrograms(NamedTuple):
    """What a batch runs through, compiled."""

    start: Callable[[Case, Case, Array], tuple[Plan, Any]]
    chunk: Callable[[Case, Case, Plan, Any, int, Any], tuple[Any, Any]]
    finish: Callable[[Case, Plan, Any], dict[str, Array]]


class Mjx(Batched):
    """The implicit contact step on structured or on MJX's smooth dynamics."""

    def __init__(self, settings: EngineSettings, world: Case, belief: Case, limits: Thresholds | None = None):
        super().__init__(settings, world, belief, limits)
        self.dynamics = physics.dynamics_name(settings)
        self.width = settings.width or devices.default_width()
        self._mesh = devices.mesh(self.width)
        self.devices = jax.device_count()
        self.fused = _fused(settings)
        with devices.precision(settings):
            self.topology = dynamics.topology(world)
            self.physics = physics.make_physics(settings, self.topology)

    def rollout_bytes(self) -> int:
        """See `Engine`; nothing is compiled for it."""
        with devices.precision(self.settings):
            start = partial(self._start, sensing(self._nominal[0].noise))
            held = jax.eval_shape(start, *devices.as_arrays(self._nominal), jax.random.key(0))
        return sum(x.size * x.dtype.itemsize for x in jax.tree.leaves(held))

    @devices.memory()
    def histories(
        self, world: Case, belief: Case, streams: np.ndarray, slots: np.ndarray, watch: Watch
    ) -> tuple[Figures, np.ndarray]:
        """Figures, and columns over time, see `Engine`."""
        figures, parts = self._simulate(world, belief, streams, slots, watch.every, watch)
        return figures, np.concatenate([np.zeros((0, len(slots), len(watch.columns)), np.float32), *parts])

    def _simulate(
        self,
        world: Case,
        belief: Case,
        streams: np.ndarray,
        slots: np.ndarray | None = None,
        every: int = 1,
        watch: Watch | None = None,
    ) -> tuple[Figures, list[Any]]:
        """Figures of the batch, and of the rollouts in `slots`, if any, what is recorded in each chunk of ticks.

        That is one in `every` ticks: all there is of them, or what is to be watched.
        """
        most = watch.most if watch else 1 if slots is None else len(slots)  # slots that room is made for
        with devices.precision(self.settings):
            (world, belief, keys), programs, kept, places = self._prepare(world, belief, streams, slots, most, watch)
            plans, carry = programs.start(world, belief, keys)
            records = []
            for tick in range(0, most_ticks(plans, self.settings.control_period), self._chunk_ticks):
                carry, record = programs.chunk(world, belief, plans, carry, tick, kept)
                first = (every - 1 - tick) % every
                records.append(jax.tree.map(lambda x, first=first: np.asarray(x)[first::every][:, places], record))
                # on the host: among devices it would take their collective operations, which can hang
                over = np.asarray(carry.is_over)
                if np.all(over if slots is None or watch else over[slots]):
                    break
            figures = programs.finish(world, plans, carry).items()
            return {name: np.asarray(values) for name, values in figures}, records

    @property
    def _by_host(self) -> bool:
        """Whether the closed loop goes on outside of XLA's programs."""
        return self.fused and jax.default_backend() == "cpu"

    @property
    def _few(self) -> bool:
        """Whether NumPy goes through what is run once a batch: on a GPU where that is quicker than XLA compiles it."""
        return self._by_host or (self.fused and self.width <= devices.FEW)

    @property
    def _local(self) -> int:
        """Rollouts that a device has of a batch."""
        return self.width // self._mesh.size

    def _kept(self, slots: np.ndarray | None, room: int) -> tuple[Any, np.ndarray | None]:
        """What each device records, as `room` places among its rollouts, and where `slots` are among all of these."""
        if slots is None or self._by_host:
            return slots, None if slots is None else np.arange(len(slots))
        local, places = np.zeros((self._mesh.size, room), np.int32), np.zeros(len(slots), int)
        for device in range(self._mesh.size):
            mine = np.flatnonzero(slots // self._local == device)
            local[device, : len(mine)] = slots[mine] % self._local
            places[mine] = device * room + np.arange(len(mine))
        return devices.spread(jnp.asarray(local.ravel()), self._mesh), places

    @property
    def _chunk_ticks(self) -> int:
        return max(1, round(CHUNK / self.settings.control_period))

    def _prepare(
        self, world: Case, belief: Case, streams: np.ndarray, slots: np.ndarray | None, most: int, watch: Watch | None
    ) -> tuple[tuple[Case, Case, Array], XlaPrograms | Fused, Any, np.ndarray | None]:
        """Arguments as arrays of the right type, and the programs for their batch axes; what is recorded, and where."""
        batching.check(streams, self.width)
        kept, places = self._kept(slots, min(self._local, most))
        sensors_are = sensing(world.noise)
        recorded = None if kept is None or self._by_host else (kept.shape, watch and watch.columns)
        form = devices.form((world, belief)), sensors_are, recorded
        arrays = devices.spread((*devices.as_arrays((world, belief)), devices.keys(streams)), self._mesh)
        if form not in self._programs:
            compiled = partial(self._compile, arrays, sensors_are, kept, watch)
            made_of, on = (form, *self._made_of), list(self._mesh.devices.flat)
            parts = program_cache.programs(made_of, on, compiled)
            if isinstance(parts[0], str):
                fused_loop.give_up(self.settings, parts[0])
                self.fused = False
                return self._prepare(world, belief, streams, slots, most, watch)
            self._programs[form] = self._ready(*parts)
        programs = self._programs[form]
        programs = programs._replace(watch=watch) if isinstance(programs, Fused) else programs
        return arrays, programs, kept, places

    def _ready(
        self,
        start: Eager | Compiled,
        searches: dict[str, Code],
        chunk: Compiled | Code,
        finish: Eager | Compiled,
        again: Eager | Compiled | None = None,
        machine: driver.GpuKernel | None = None,
    ) -> XlaPrograms | Fused:
        begin, end = Planning.from_programs(start, searches), fused_loop.ready(finish, self.width)
        if not isinstance(chunk, Code):
            if machine:
                driver.add_kernel(machine)
            compiled = isinstance(start, Compiled)
            return XlaPrograms(
                begin if compiled else lambda *of: devices.put_on_devices(begin(*of), self._mesh), chunk, end
            )
        new = again and fused_loop.ready(again, self.width)
        return Fused(begin, Kernel(chunk), end, new, self._chunk_ticks, self.width, None)

    @property
    def _made_of(self) -> tuple:
        """All that the programs depend on beside the form of their arguments; MJX's dynamics hold the nominal model."""
        top = self.topology
        model = model_bytes(top.model) if self.dynamics == "mjx" else None
        return self.settings, self.limits, self.width, self.dynamics, self.fused, top.names, top.owner, model

    @fused_loop.or_what_is_missing
    def _compile(
        self, arrays: tuple[Case, Case, Array], sensors_are: Sensing, kept: Array | None, watch: Watch | None
    ) -> tuple[Any, ...]:
        """The programs over batches like `arrays`, split over the devices.

        They are compiled side by side: the compiler needs no Python, which traces the next one meanwhile.
        """
        world, belief, _ = arrays
        axes, specs = devices.axes((world, belief)), devices.specs((world, belief))
        split, whole = PartitionSpec(devices.BATCH), PartitionSpec()
        on_devices = partial(jax.shard_map, mesh=self._mesh, check_vma=False)
        control = self._nominal[0].control
        one_plan = control.calibrate == control.touch == "none" and not any(map(np.ndim, jax.tree.leaves(belief)))

        def many(start: Callable) -> Callable:
            at_once = jax.vmap(start, in_axes=(*axes, 0))
            batched = at_once if self._by_host or one_plan else devices.in_turns(start, self._local)
            return on_devices(batched, in_specs=(*specs, split), out_specs=split)

        recorded = (split, PartitionSpec(None, devices.BATCH))
        with ThreadPoolExecutor() as pool:
            batch, started = planning.start_compilation(
                pool, partial(self._start, sensors_are), arrays, many, self._searches, self._few
            )
            plans, carry = devices.split(batch, self._mesh)
            if self._by_host:
                with timed_part("closed loop"):
                    lanes = kernel.tile(self.width, devices.cores())
                    chunked = pool.submit(
                        kernel.start_compilation(self._tick, *single_rollout_shapes(arrays, batch), lanes=lanes)
                    )
                    finished = self._compile_finish(arrays, batch, on_devices)
                    again = self._compile_again(arrays, batch, on_devices)
                    return *started(), chunked.result(), finished, again
            make = self._fused_chunk if self.fused else self._chunk
            chunk, key = make(arrays, batch, kept, watch)
            chunk = on_devices(chunk, in_specs=(*specs, split, split, whole, split), out_specs=recorded)
            options = launch.OPTIONS if self.fused else None
            go_on = jax.jit(chunk, donate_argnums=3, compiler_options=options)
            with timed_part("closed loop"):
                chunked = pool.submit(go_on.lower(world, belief, plans, carry, 0, kept).compile)
                finished = self._compile_finish(arrays, batch, on_devices)
                return *started(), chunked.result(), finished, None, key and driver.finished_kernel(key)

    def _compile_again(
        self, arrays: tuple[Case, Case, Array], batch: Any, on_devices: Callable[..., Callable]
    ) -> Eager | Compiled | None:
        """What plans again, if anything does."""
        if not self._replans:
            return None
        (_, belief, plan), carry = single_rollout_shapes(arrays, batch)
        plans, carries = devices.split(batch, self._mesh)

        def by_xla() -> Compiled:
            split = PartitionSpec(devices.BATCH)
            again = jax.vmap(replan_rest, in_axes=(devices.axes(arrays[1]), 0, 0, 0))
            again = on_devices(again, in_specs=(devices.specs(arrays[1]), split, split, split), out_specs=split)
            return jax.jit(again).lower(arrays[1], plans, carries.loop.tracker.stage, carries.loop.learned).compile()

        with timed_part("new plan"):
            return fused_loop.eager_or(by_xla, replan_rest, belief, plan, carry.loop.tracker.stage, carry.loop.learned)

    def _compile_finish(
        self, arrays: tuple[Case, Case, Array], batch: Any, on_devices: Callable[..., Callable]
    ) -> Eager | Compiled:
        """The program that makes figures of a batch, see `_compile`."""
        split = PartitionSpec(devices.BATCH)

        def by_xla() -> Compiled:
            finish = jax.vmap(self._finish, in_axes=(devices.axes(arrays[0]), 0, 0))
            finish = on_devices(finish, in_specs=(devices.specs(arrays[0]), split, split), out_specs=split)
            return jax.jit(finish).lower(arrays[0], *devices.split(batch, self._mesh)).compile()

        with timed_part("figures"):
            if not self._few:
                return by_xla()
            (world, _, plan), carry = single_rollout_shapes(arrays, batch)
            return fused_loop.eager_or(by_xla, self._finish, world, plan, carry)

    def _fused_chunk(
        self, arrays: tuple[Case, Case, Array], batch: Any, kept: Array | None, watch: Watch | None
    ) -> tuple[Callable, str]:
        """A second of the batch that a GPU has, as one kernel, and its key; see `_chunk`."""
        room = 0 if kept is None else len(kept) // self._mesh.size
        form, over, width = single_rollout_shapes(arrays, batch), lambda carry: carry.is_over, self._local
        code = launch.compiled(self._tick, *form, over, self._chunk_ticks, room, width, few=self._few)

        def chunk(world: Case, belief: Case, plans: Plan, carry: Carry, first: Array, kept: Array | None) -> Any:
            if self._replans:
                carry = _with_new_plan(devices.axes(arrays[1]))(belief, plans, carry)
            carry, record = launch.run(code, (world, belief, plans), carry, first, kept)
            if watch is None or record is None:
                return carry, record
            return carry, select_columns(self._nominal[0], record, watch.columns)

        return chunk, driver.key(code.text)

    def _chunk(
        self, arrays: tuple[Case, Case, Array], batch: Any, kept: Array | None, watch: Watch | None
    ) -> tuple[Callable, None]:
        """A second of the batch that a device has, of which some rollouts may be recorded: columns, or all there is."""
        axes, columns = devices.axes(arrays[:2]), available_columns(self._nominal[0])
        last = jax.tree.map(lambda _: -1, (*axes, batch[0]))  # batch axes of what has been put `_batch_last`
        tick = batch_last_vmap(self._tick, (last, -1, None), devices.reuse_from())

        def chunk(world: Case, belief: Case, plans: Plan, carry: Carry, first: Array, kept: Array | None) -> Any:
            if self._replans:
                carry = _with_new_plan(axes[1])(belief, plans, carry)
            given, carry = _batch_last(((world, belief, plans), carry))

            def body(carry: Carry, k: Array) -> tuple[Carry, Any]:
                carry, record = tick(given, carry, k)
                if kept is None:
                    return carry, None
                record = jax.tree.map(lambda x: x[..., kept], record)
                chosen = jnp.stack([columns[name](record) for name in watch.columns]) if watch else record
                return carry, jax.tree.map(lambda x: jnp.moveaxis(x, -1, 0), chosen)

            carry, records = jax.lax.scan(body, carry, first + jnp.arange(self._chunk_ticks))
            return jax.tree.map(lambda x: jnp.moveaxis(x, -1, 0), carry), records

        return chunk, None

    def rollout_outputs(self, world: Case, belief: Case, key: Array) -> dict[str, Array]:
        """See `Batched`: the metrics."""
        plan, carry = self._start(sensing(world.noise), world, belief, key)

        def tick(carry: Carry, number: Array) -> tuple[Carry, None]:
            if self._replans:
                learned = replan_rest(belief, plan, carry.loop.tracker.stage, carry.loop.learned)
                carry = carry._replace(loop=carry.loop._replace(learned=learned))
            return self._tick((world, belief, plan), carry, number)[0], None

        carry, _ = jax.lax.scan(tick, carry, jnp.arange(self._chunk_ticks))
        return self._finish(world, plan, carry)

    def _start(self, sensors_are: Sensing, world: Case, belief: Case, key: Array) -> tuple[Plan, Carry]:
        known, plan, learned = prepare_belief(world, belief, key)
        start = start_state(world, known, plan, start_at_rest(world))
        state = state_at_rest(self.topology, start.qpos)._replace(v=start.qvel)
        energy = self.physics.energy(world, state)
        return plan, Carry(state, init(world, known, plan, start, energy, key, learned, sensors_are))

    def _finish(self, world: Case, plan: Plan, carry: Carry) -> dict[str, Array]:
        return figures_of(world, plan, carry.loop)

    def _tick(self, given: tuple[Case, Case, Plan], carry: Carry, tick: Array) -> tuple[Carry, dict[str, Array]]:
        world, belief, plan = given
        period, old = self.settings.control_period, carry.loop.servo
        loop, command = act(world, belief, plan, carry.loop, tick, period)
        state, summary = self.physics.advance(world, carry.state, old, loop.servo, tick)
        loop, judged = measure(world, plan, self.limits, loop, command, summary, tick, period)
        record = batching.record(command, loop.tracker, summary, state.q, state.v, judged)
        return Carry(state, loop), record


def _fused(settings: EngineSettings) -> bool:
    """Whether this package's own compiler makes the closed loop, as it does where it can."""
    known = (device := jax.default_backend()) in ("cpu", "gpu")
    if settings.compiler == "fused" and not known:
        raise InputError(f"engine.compiler = fused is not allowed on a {device}: auto or xla")
    return settings.fusible and known


def _with_new_plan(axes: Case) -> Callable[[Case, Plan, Carry], Carry]:
    """Every rollout of a batch plans again; `axes` are those of what is believed."""

    def one(belief: Case, plan: Plan, carry: Carry) -> Carry:
        loop = carry.loop
        return carry._replace(loop=loop._replace(learned=replan_rest(belief, plan, loop.tracker.stage, loop.learned)))

    return jax.vmap(one, in_axes=(axes, 0, 0))


def _batch_last(tree: Any) -> Any:
    """Leaves that vary over the batch with that axis last; the others are plain numbers."""
    return jax.tree.map(lambda x: jnp.moveaxis(x, 0, -1) if jnp.ndim(x) else x, tree)

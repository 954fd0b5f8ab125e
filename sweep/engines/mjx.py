"""The primary engine: controller, physics and metrics of a control tick in one program, compiled by the fused compiler
or XLA."""

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

from sweep.backends import devices, program_cache
from sweep.backends.binary import model_bytes
from sweep.contract.engine import Metrics, TimeSeriesRequest
from sweep.contract.engine_settings import EngineSettings
from sweep.controllers.plan import Plan
from sweep.core.errors import InputError
from sweep.core.progress import measure_part_duration
from sweep.dynamics import interface as dynamics
from sweep.dynamics.free_bodies import resting_start_state
from sweep.dynamics.step import PhysicsState, state_at_rest
from sweep.engines import batching, fused_loop, physics, planning
from sweep.engines.batch_last import batch_last_vmap
from sweep.engines.batching import BatchEngine
from sweep.engines.closed_loop import (
    CHUNK_DURATION_S,
    ClosedLoop,
    SensingMode,
    compute_metrics,
    init_loop,
    max_tick_count,
    required_sensing_mode,
    run_controller,
    start_state,
    update_metrics,
)
from sweep.engines.fused_loop import FusedPrograms, single_rollout_shapes
from sweep.engines.planning import CompiledPlanning
from sweep.engines.pre_rollout import prepare_belief
from sweep.engines.states import available_columns, select_columns
from sweep.estimation.belief_update import replan_remaining_stages
from sweep.fused import driver, kernel, launch
from sweep.fused.eager import NumpyProgram
from sweep.fused.kernel import Kernel, KernelCode
from sweep.metrics.outcome import OutcomeThresholds
from sweep.models.case import Case


class RolloutCarry(NamedTuple):
    """State of one rollout (physics, controller, sensors, metrics) between two control ticks."""

    state: PhysicsState
    loop: ClosedLoop

    @property
    def is_over(self) -> Array:
        """Whether the rollout has ended."""
        return self.loop.running.is_over


class XlaPrograms(NamedTuple):
    """Compiled programs of a batch: planning, a chunk of control ticks, and the metrics at the end."""

    make_initial_batch: Callable[[Case, Case, Array], tuple[Plan, Any]]
    simulate_chunk: Callable[[Case, Case, Plan, Any, int, Any], tuple[Any, Any]]
    compute_batch_metrics: Callable[[Case, Plan, Any], dict[str, Array]]


class MjxEngine(BatchEngine):
    """Hexapod engine in JAX: implicit contact steps, dynamics from explicit equations (`arrowhead`) or from MJX."""

    def __init__(self, settings: EngineSettings, world: Case, belief: Case, limits: OutcomeThresholds | None = None):
        super().__init__(settings, world, belief, limits)
        self.dynamics = physics.dynamics_name(settings)
        self.width = settings.width or devices.default_batch_width()
        self._mesh = devices.make_mesh(self.width)
        self.devices = jax.device_count()
        self.fused = _uses_fused_compiler(settings)
        with devices.precision_context(settings):
            self.topology = dynamics.build_model_topology(world)
            self.physics = physics.make_tick_physics(settings, self.topology)

    def rollout_bytes(self) -> int:
        """Return the memory (bytes) of one rollout's plan, state and metrics, without compiling anything."""
        with devices.precision_context(self.settings):
            start = partial(self._start, required_sensing_mode(self._nominal[0].noise))
            held = jax.eval_shape(start, *devices.to_jax_arrays(self._nominal), jax.random.key(0))
        return sum(x.size * x.dtype.itemsize for x in jax.tree.leaves(held))

    @devices.convert_memory_errors()
    def run_with_time_series(
        self, world: Case, belief: Case, streams: np.ndarray, slots: np.ndarray, watch: TimeSeriesRequest
    ) -> tuple[Metrics, np.ndarray]:
        """Simulate a batch; return its metrics, and the requested columns of some rollouts over time."""
        figures, parts = self._simulate(world, belief, streams, slots, watch.every, watch)
        return figures, np.concatenate([np.zeros((0, len(slots), len(watch.columns)), np.float32), *parts])

    def _simulate(
        self,
        world: Case,
        belief: Case,
        streams: np.ndarray,
        slots: np.ndarray | None = None,
        every: int = 1,
        watch: TimeSeriesRequest | None = None,
    ) -> tuple[Metrics, list[Any]]:
        """Simulate a batch, and record the rollouts in `slots`, if any, at one in `every` ticks.

        Returns: metrics, and for each chunk of ticks a record of all quantities, or of the columns in `watch`.
        """
        most = (
            watch.max_rollouts if watch else 1 if slots is None else len(slots)
        )  # number of recorded rollouts to make room for
        with devices.precision_context(self.settings):
            (world, belief, keys), programs, kept, places = self._prepare(world, belief, streams, slots, most, watch)
            plans, carry = programs.make_initial_batch(world, belief, keys)
            records = []
            for tick in range(0, max_tick_count(plans, self.settings.control_period), self._chunk_ticks):
                carry, record = programs.simulate_chunk(world, belief, plans, carry, tick, kept)
                first = (every - 1 - tick) % every
                records.append(jax.tree.map(lambda x, first=first: np.asarray(x)[first::every][:, places], record))
                # on the host, since collective operations among devices can hang
                over = np.asarray(carry.is_over)
                if np.all(over if slots is None or watch else over[slots]):
                    break
            figures = programs.compute_batch_metrics(world, plans, carry).items()
            return {name: np.asarray(values) for name, values in figures}, records

    @property
    def _runs_outside_xla(self) -> bool:
        """Whether the closed loop runs as a kernel of its own, outside XLA's programs."""
        return self.fused and jax.default_backend() == "cpu"

    @property
    def _uses_numpy(self) -> bool:
        """Whether NumPy executes what runs once a batch: on a GPU only where XLA would take longer to compile it."""
        return self._runs_outside_xla or (self.fused and self.width <= devices.NUMPY_WIDTH)

    @property
    def _rollouts_per_device(self) -> int:
        return self.width // self._mesh.size

    def _recording_slots(self, slots: np.ndarray | None, room: int) -> tuple[Any, np.ndarray | None]:
        """Rollouts that each device records, padded to `room`, and where `slots` are among all of these."""
        if slots is None or self._runs_outside_xla:
            return slots, None if slots is None else np.arange(len(slots))
        local, places = np.zeros((self._mesh.size, room), np.int32), np.zeros(len(slots), int)
        for device in range(self._mesh.size):
            mine = np.flatnonzero(slots // self._rollouts_per_device == device)
            local[device, : len(mine)] = slots[mine] % self._rollouts_per_device
            places[mine] = device * room + np.arange(len(mine))
        return devices.shard_leaves(jnp.asarray(local.ravel()), self._mesh), places

    @property
    def _chunk_ticks(self) -> int:
        return max(1, round(CHUNK_DURATION_S / self.settings.control_period))

    def _prepare(
        self,
        world: Case,
        belief: Case,
        streams: np.ndarray,
        slots: np.ndarray | None,
        most: int,
        watch: TimeSeriesRequest | None,
    ) -> tuple[tuple[Case, Case, Array], XlaPrograms | FusedPrograms, Any, np.ndarray | None]:
        """Arguments as arrays, programs for their batch axes, rollouts to record, and their places in the record."""
        batching.check_batch_width(streams, self.width)
        kept, places = self._recording_slots(slots, min(self._rollouts_per_device, most))
        sensing = required_sensing_mode(world.noise)
        recorded = None if kept is None or self._runs_outside_xla else (kept.shape, watch and watch.columns)
        form = devices.program_signature((world, belief)), sensing, recorded
        arrays = devices.shard_leaves(
            (*devices.to_jax_arrays((world, belief)), devices.noise_keys(streams)), self._mesh
        )
        if form not in self._programs:
            compiled = partial(self._compile, arrays, sensing, kept, watch)
            key_parts, on = (form, *self._cache_key), list(self._mesh.devices.flat)
            parts = program_cache.load_or_compile(key_parts, on, compiled)
            if isinstance(parts[0], str):
                fused_loop.report_xla_fallback(self.settings, parts[0])
                self.fused = False
                return self._prepare(world, belief, streams, slots, most, watch)
            self._programs[form] = self._bind_programs(*parts)
        programs = self._programs[form]
        programs = programs._replace(watch=watch) if isinstance(programs, FusedPrograms) else programs
        return arrays, programs, kept, places

    def _bind_programs(
        self,
        start: NumpyProgram | Compiled,
        searches: dict[str, KernelCode],
        chunk: Compiled | KernelCode,
        finish: NumpyProgram | Compiled,
        again: NumpyProgram | Compiled | None = None,
        machine: driver.GpuKernel | None = None,
    ) -> XlaPrograms | FusedPrograms:
        begin, end = CompiledPlanning.from_programs(start, searches), fused_loop.make_batch_function(finish, self.width)
        if not isinstance(chunk, KernelCode):
            if machine:
                driver.register_kernel(machine)
            compiled = isinstance(start, Compiled)
            return XlaPrograms(
                begin if compiled else lambda *args: devices.put_on_devices(begin(*args), self._mesh), chunk, end
            )
        new = again and fused_loop.make_batch_function(again, self.width)
        return FusedPrograms(begin, Kernel(chunk), end, new, self._chunk_ticks, self.width, None)

    @property
    def _cache_key(self) -> tuple:
        """All that the programs depend on besides their arguments' shapes; MJX's dynamics contain the nominal model."""
        top = self.topology
        model = model_bytes(top.model) if self.dynamics == "mjx" else None
        return (
            self.settings,
            self.limits,
            self.width,
            self.dynamics,
            self.fused,
            top.ids_by_name,
            top.contact_owners,
            model,
        )

    @fused_loop.catch_unsupported_primitive
    def _compile(
        self,
        arrays: tuple[Case, Case, Array],
        sensing: SensingMode,
        slots: Array | None,
        watch: TimeSeriesRequest | None,
    ) -> tuple[Any, ...]:
        """Compile the programs for batches like `arrays`, sharded over the devices.

        They compile in parallel: the compiler needs no Python, which traces the next program meanwhile.
        """
        world, belief, _ = arrays
        axes, specs = devices.vmap_in_axes((world, belief)), devices.partition_specs((world, belief))
        split, whole = PartitionSpec(devices.BATCH_MESH_AXIS), PartitionSpec()
        on_devices = partial(jax.shard_map, mesh=self._mesh, check_vma=False)
        control = self._nominal[0].control
        one_plan = control.calibrate == control.touch == "none" and not any(map(np.ndim, jax.tree.leaves(belief)))

        def many(start: Callable) -> Callable:
            at_once = jax.vmap(start, in_axes=(*axes, 0))
            batched = (
                at_once
                if self._runs_outside_xla or one_plan
                else devices.vmap_in_chunks(start, self._rollouts_per_device)
            )
            return on_devices(batched, in_specs=(*specs, split), out_specs=split)

        recorded = (split, PartitionSpec(None, devices.BATCH_MESH_AXIS))
        with ThreadPoolExecutor() as pool:
            batch, wait_for_start = planning.start_compilation(
                pool, partial(self._start, sensing), arrays, many, self._searches, self._uses_numpy
            )
            plans, carry = devices.sharded_shapes(batch, self._mesh)
            if self._runs_outside_xla:
                with measure_part_duration("closed loop"):
                    lanes = kernel.choose_lane_count(self.width, devices.count_cores())
                    chunk_future = pool.submit(
                        kernel.start_compilation(self._tick, *single_rollout_shapes(arrays, batch), lanes=lanes)
                    )
                    finish_program = self._compile_finish(arrays, batch, on_devices)
                    again = self._compile_replan(arrays, batch, on_devices)
                    return *wait_for_start(), chunk_future.result(), finish_program, again
            make = self._fused_chunk if self.fused else self._xla_chunk
            chunk, key = make(arrays, batch, slots, watch)
            chunk = on_devices(chunk, in_specs=(*specs, split, split, whole, split), out_specs=recorded)
            options = launch.XLA_OPTIONS if self.fused else None
            chunk_program = jax.jit(chunk, donate_argnums=3, compiler_options=options)
            with measure_part_duration("closed loop"):
                chunk_future = pool.submit(chunk_program.lower(world, belief, plans, carry, 0, slots).compile)
                finish_program = self._compile_finish(arrays, batch, on_devices)
                return (
                    *wait_for_start(),
                    chunk_future.result(),
                    finish_program,
                    None,
                    key and driver.wait_for_kernel(key),
                )

    def _compile_replan(
        self, arrays: tuple[Case, Case, Array], batch: Any, on_devices: Callable[..., Callable]
    ) -> NumpyProgram | Compiled | None:
        """Program that plans again between chunks, if the scenario does so."""
        if not self._replans:
            return None
        (_, belief, plan), carry = single_rollout_shapes(arrays, batch)
        plans, carries = devices.sharded_shapes(batch, self._mesh)

        def by_xla() -> Compiled:
            split = PartitionSpec(devices.BATCH_MESH_AXIS)
            again = jax.vmap(replan_remaining_stages, in_axes=(devices.vmap_in_axes(arrays[1]), 0, 0, 0))
            again = on_devices(
                again, in_specs=(devices.partition_specs(arrays[1]), split, split, split), out_specs=split
            )
            return jax.jit(again).lower(arrays[1], plans, carries.loop.tracker.stage, carries.loop.learned).compile()

        with measure_part_duration("new plan"):
            return fused_loop.trace_or_compile_program(
                by_xla, replan_remaining_stages, belief, plan, carry.loop.tracker.stage, carry.loop.learned
            )

    def _compile_finish(
        self, arrays: tuple[Case, Case, Array], batch: Any, on_devices: Callable[..., Callable]
    ) -> NumpyProgram | Compiled:
        """Program that computes the metrics of a batch, see `_compile`."""
        split = PartitionSpec(devices.BATCH_MESH_AXIS)

        def by_xla() -> Compiled:
            finish = jax.vmap(self._finish, in_axes=(devices.vmap_in_axes(arrays[0]), 0, 0))
            finish = on_devices(finish, in_specs=(devices.partition_specs(arrays[0]), split, split), out_specs=split)
            return jax.jit(finish).lower(arrays[0], *devices.sharded_shapes(batch, self._mesh)).compile()

        with measure_part_duration("figures"):
            if not self._uses_numpy:
                return by_xla()
            (world, _, plan), carry = single_rollout_shapes(arrays, batch)
            return fused_loop.trace_or_compile_program(by_xla, self._finish, world, plan, carry)

    def _fused_chunk(
        self, arrays: tuple[Case, Case, Array], batch: Any, slots: Array | None, watch: TimeSeriesRequest | None
    ) -> tuple[Callable, str]:
        """Chunk of control ticks as one GPU kernel, and the kernel's key; see `_xla_chunk`."""
        room = 0 if slots is None else len(slots) // self._mesh.size
        form, over, width = single_rollout_shapes(arrays, batch), lambda carry: carry.is_over, self._rollouts_per_device
        code = launch.compile_to_ptx(
            self._tick, *form, over, self._chunk_ticks, room, width, small_batch=self._uses_numpy
        )

        def chunk(
            world: Case, belief: Case, plans: Plan, carry: RolloutCarry, first: Array, slots: Array | None
        ) -> Any:
            if self._replans:
                carry = _replan_batch(devices.vmap_in_axes(arrays[1]))(belief, plans, carry)
            carry, record = launch.run_kernel(code, (world, belief, plans), carry, first, slots)
            if watch is None or record is None:
                return carry, record
            return carry, select_columns(self._nominal[0], record, watch.columns)

        return chunk, driver.kernel_cache_key(code.text)

    def _xla_chunk(
        self, arrays: tuple[Case, Case, Array], batch: Any, slots: Array | None, watch: TimeSeriesRequest | None
    ) -> tuple[Callable, None]:
        """Chunk of control ticks of a device's rollouts; those in `slots` are recorded: all quantities, or columns."""
        axes, columns = devices.vmap_in_axes(arrays[:2]), available_columns(self._nominal[0])
        last = jax.tree.map(lambda _: -1, (*axes, batch[0]))  # batch axes after `_batch_last`
        tick = batch_last_vmap(self._tick, (last, -1, None), devices.recomputation_cost_threshold())

        def chunk(
            world: Case, belief: Case, plans: Plan, carry: RolloutCarry, first: Array, slots: Array | None
        ) -> Any:
            if self._replans:
                carry = _replan_batch(axes[1])(belief, plans, carry)
            given, carry = _batch_last(((world, belief, plans), carry))

            def body(carry: RolloutCarry, k: Array) -> tuple[RolloutCarry, Any]:
                carry, record = tick(given, carry, k)
                if slots is None:
                    return carry, None
                record = jax.tree.map(lambda x: x[..., slots], record)
                chosen = jnp.stack([columns[name](record) for name in watch.columns]) if watch else record
                return carry, jax.tree.map(lambda x: jnp.moveaxis(x, -1, 0), chosen)

            carry, records = jax.lax.scan(body, carry, first + jnp.arange(self._chunk_ticks))
            return jax.tree.map(lambda x: jnp.moveaxis(x, -1, 0), carry), records

        return chunk, None

    def rollout_outputs(self, world: Case, belief: Case, key: Array) -> dict[str, Array]:
        """Compute the metrics of one rollout; JAX only traces this function for analysis."""
        plan, carry = self._start(required_sensing_mode(world.noise), world, belief, key)

        def tick(carry: RolloutCarry, number: Array) -> tuple[RolloutCarry, None]:
            if self._replans:
                learned = replan_remaining_stages(belief, plan, carry.loop.tracker.stage, carry.loop.learned)
                carry = carry._replace(loop=carry.loop._replace(learned=learned))
            return self._tick((world, belief, plan), carry, number)[0], None

        carry, _ = jax.lax.scan(tick, carry, jnp.arange(self._chunk_ticks))
        return self._finish(world, plan, carry)

    def _start(self, sensing: SensingMode, world: Case, belief: Case, key: Array) -> tuple[Plan, RolloutCarry]:
        known, plan, learned = prepare_belief(world, belief, key)
        start = start_state(world, known, plan, resting_start_state(world))
        state = state_at_rest(self.topology, start.qpos)._replace(v=start.qvel)
        energy = self.physics.energy(world, state)
        return plan, RolloutCarry(state, init_loop(world, known, plan, start, energy, key, learned, sensing))

    def _finish(self, world: Case, plan: Plan, carry: RolloutCarry) -> dict[str, Array]:
        return compute_metrics(world, plan, carry.loop)

    def _tick(
        self, inputs: tuple[Case, Case, Plan], carry: RolloutCarry, tick: Array
    ) -> tuple[RolloutCarry, dict[str, Array]]:
        world, belief, plan = inputs
        period, old = self.settings.control_period, carry.loop.servo
        loop, command = run_controller(world, belief, plan, carry.loop, tick, period)
        state, summary = self.physics.advance(world, carry.state, old, loop.servo, tick)
        loop, judged = update_metrics(world, plan, self.limits, loop, command, summary, tick, period)
        record = batching.record_tick(command, loop.tracker, summary, state.q, state.v, judged)
        return RolloutCarry(state, loop), record


def _uses_fused_compiler(settings: EngineSettings) -> bool:
    """Whether the fused compiler compiles the closed loop, as it does where it can."""
    known = (device := jax.default_backend()) in ("cpu", "gpu")
    if settings.compiler == "fused" and not known:
        raise InputError(f"engine.compiler = fused is not allowed on a {device}: auto or xla")
    return settings.is_fusible and known


def _replan_batch(axes: Case) -> Callable[[Case, Plan, RolloutCarry], RolloutCarry]:
    """Batched replanning; `axes` are the batch axes of the belief."""

    def one(belief: Case, plan: Plan, carry: RolloutCarry) -> RolloutCarry:
        loop = carry.loop
        return carry._replace(
            loop=loop._replace(learned=replan_remaining_stages(belief, plan, loop.tracker.stage, loop.learned))
        )

    return jax.vmap(one, in_axes=(axes, 0, 0))


def _batch_last(tree: Any) -> Any:
    """Move the batch axis of each leaf to the end; leaves without one stay plain numbers."""
    return jax.tree.map(lambda x: jnp.moveaxis(x, 0, -1) if jnp.ndim(x) else x, tree)

"""The engine for independent checks: C MuJoCo with its own contact solver on a thread pool, with the same
controller."""

import sys
import warnings
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from jax.stages import Compiled
from jaxtyping import Array, Bool, Float
from mujoco.batch import Batch

from sweep.backends import devices, program_cache
from sweep.backends.binary import model_bytes
from sweep.contract.engine import Metrics, SideMaker, TimeSeriesRequest
from sweep.contract.engine_settings import EngineSettings
from sweep.controllers.flywheel import MiddleLegFlywheel
from sweep.controllers.layers import Command
from sweep.controllers.plan import Plan
from sweep.core.errors import InputError
from sweep.core.progress import measure_part_duration
from sweep.core.rotations import exponential, multiply
from sweep.engines import batching, fused_loop, planning
from sweep.engines.batching import BatchEngine
from sweep.engines.closed_loop import (
    CHUNK_DURATION_S,
    ClosedLoop,
    InitialState,
    SensingMode,
    compute_metrics,
    exact_observation,
    free_body_state,
    init_loop,
    max_tick_count,
    required_sensing_mode,
    run_controller,
    start_state,
    update_metrics,
)
from sweep.engines.physics import push_force
from sweep.engines.planning import CompiledPlanning
from sweep.engines.pre_rollout import prepare_belief
from sweep.engines.states import select_columns
from sweep.estimation.belief_update import LearnedState, replan_remaining_stages
from sweep.fused import kernel
from sweep.fused.eager import NumpyProgram
from sweep.fused.kernel import Kernel, KernelBatch, KernelCode
from sweep.metrics import accumulator
from sweep.metrics.outcome import OutcomeThresholds
from sweep.metrics.tick import EngineTickReport
from sweep.models import scene
from sweep.models.case import Case
from sweep.models.drive import ServoCommand, interpolate_target
from sweep.models.legs import JOINT_V, N_JOINTS, N_LEGS
from sweep.models.obstacles.surface import FreeBodyState, body_poses, surface_at
from sweep.models.robot import link_names

CONTROL_STATE = mujoco.mjtState.mjSTATE_CTRL.value | mujoco.mjtState.mjSTATE_XFRC_APPLIED.value
RECORDED_FIELDS = ("qpos", "qvel", "actuator_force", "sensordata", "energy", "xpos", "site_xpos", "subtree_com")


class StepRecord(NamedTuple):
    """Record of the n physics steps in a control tick of C MuJoCo; positions are those before the last step."""

    qpos: Float[Array, "n q"]
    qvel: Float[Array, "n v"]
    actuator_force: Float[Array, "n 18"]
    foot_force: Float[Array, "n 18"]  # force of the feet on the ground
    energy: Float[Array, ""]
    links: Float[Array, "l 3"]  # origins of the legs' links
    feet: Float[Array, "6 3"]
    centre_of_mass: Float[Array, " 3"]
    diverged: Bool[Array, ""]


class PhysicsInputs(NamedTuple):
    """Inputs of C MuJoCo for the n physics steps of a control tick; world axes, wrenches are force, then torque."""

    torques: Float[Array, "n 18"]  # feed-forward, without those of stiffness and damping (N m)
    push: Float[Array, "n 3"]  # at the base (N)
    loads: Float[Array, "n w"]  # wrenches on the obstacle's free bodies


class LoopState(NamedTuple):
    """State of one rollout that is passed between the compiled controller and C MuJoCo."""

    loop: ClosedLoop
    command: Command
    steps: StepRecord
    inputs: PhysicsInputs
    tick_summary: Float[Array, " w"]  # see `update_metrics`


class NativePrograms(NamedTuple):
    """Compiled programs of a batch: planning, a control tick, the metrics at the end, and replanning."""

    start: Callable[[Case, Case, Array], tuple[Plan, tuple[LoopState, InitialState]]]
    tick: Kernel | Callable[[Any, LoopState, int], LoopState]
    finish: Callable[[Case, Plan, ClosedLoop], dict[str, Array]]
    replan: Callable[..., LearnedState] | None  # see `replan_remaining_stages`

    def load_batch(self, inputs: Any, carried: LoopState, width: int) -> "KernelBatch | XlaBatch":
        """Prepare a batch for its ticks: write it to the memory of the compiled kernel, or wrap it for a tick of XLA.

        Args:
            inputs: world, belief and plans of the batch.
            carried: its state before the first tick.
            width: number of rollouts.
        """
        if isinstance(self.tick, Kernel):
            return self.tick.load_batch(inputs, carried, width)
        return XlaBatch(partial(self.tick, inputs), carried)


class XlaBatch:
    """A batch of rollouts whose control ticks are compiled by XLA; has the methods of the compiled kernel's batches."""

    def __init__(self, tick: Callable[[LoopState, int], LoopState], carried: LoopState):
        self._tick, self._carried = tick, carried

    def replace_state_values(self, select: Callable[[Any], Any], tree: Any) -> None:
        """Replace the values that the function `select` picks from the rollouts' state by those of `tree`."""
        leaves, form = jax.tree.flatten(self._carried)
        places = jax.tree.leaves(select(jax.tree.unflatten(form, range(len(leaves)))))
        for place, x in zip(places, jax.tree.leaves(tree), strict=True):
            leaves[place] = jnp.asarray(x, leaves[place].dtype)
        self._carried = jax.tree.unflatten(form, leaves)

    def advance_ticks(self, first: int, ticks: int) -> None:
        """Advance the batch by `ticks` control ticks, the first of which has the number `first`."""
        for k in range(first, first + ticks):
            self._carried = self._tick(self._carried, k)

    def read_full_state(self) -> LoopState:
        """Return the state that all rollouts carry from tick to tick."""
        return self._carried

    def read_state_values(self, select: Callable[[Any], Any]) -> Any:
        """Return the values that the function `select` picks from the rollouts' state, as NumPy arrays."""
        return jax.tree.map(np.asarray, select(self._carried))


class NativeEngine(BatchEngine):
    """Engine with a separate C MuJoCo simulation for each rollout; the host steps through control ticks."""

    def __init__(self, settings: EngineSettings, world: Case, belief: Case, limits: OutcomeThresholds | None = None):
        super().__init__(settings, world, belief, limits)
        mujoco.set_mju_user_warning(lambda _: None)  # they would fill screen and disk; their rows become invalid
        self.dynamics = "C MuJoCo"
        self.devices = 1  # shared by threads
        self.width = settings.width or devices.NATIVE_WIDTH
        self.fused = settings.compiler != "xla"

    def rollout_bytes(self) -> None:
        """Return None: the memory of a rollout is unknown, since C code allocates it."""
        return None

    @devices.convert_memory_errors()
    def run_with_time_series(
        self, world: Case, belief: Case, streams: np.ndarray, slots: np.ndarray, watch: TimeSeriesRequest
    ) -> tuple[Metrics, np.ndarray]:
        """Simulate a batch; return its metrics, and the requested columns of some rollouts over time."""
        figures, parts = self._simulate(world, belief, streams, slots, watch.every)
        return figures, np.concatenate([select_columns(self._nominal[0], part, watch.columns) for part in parts])

    def _simulate(
        self, world: Case, belief: Case, streams: np.ndarray, slots: np.ndarray | None = None, every: int = 1
    ) -> tuple[Metrics, list[Any]]:
        batching.check_batch_width(streams, self.width)
        with devices.precision_context(self.settings):
            models, unbuilt = self._models(world)
            sensing = required_sensing_mode(world.noise)
            (world, belief), keys = devices.to_jax_arrays((world, belief)), devices.noise_keys(streams)
            programs = self._prepare((world, belief, keys), sensing)
            batch = Batch(models[0], self.width, devices.count_cores())
            batch.set_models(models)
            plans, (between, state) = programs.start(world, belief, keys)
            # models may be built for another servo mode: NaN differs from all gains, so that they are set first
            gains = np.full((self.width, N_JOINTS, 2), np.nan)
            batch.reset()
            batch.qpos[:], batch.qvel[:] = (np.asarray(x) for x in state)
            running_batch = programs.load_batch((world, belief, plans), between, self.width)
            controls = np.zeros((self.width, self.substeps, N_JOINTS + 6 * models[0].nbody))
            steps, records = None, []
            for k in range(max_tick_count(plans, self.settings.control_period)):
                if programs.replan and k % round(CHUNK_DURATION_S / self.settings.control_period) == 0:
                    known = running_batch.read_state_values(
                        lambda state: (state.loop.tracker.stage, state.loop.learned)
                    )
                    running_batch.replace_state_values(
                        lambda state: state.loop.learned, programs.replan(belief, plans, *known)
                    )
                if plans.find_layer(MiddleLegFlywheel) is not None:
                    gains = _update_gains(
                        batch, models, gains, _gains(running_batch.read_state_values(lambda state: state.loop.servo))
                    )
                controls = _write_controls(controls, *running_batch.read_state_values(lambda state: state.inputs))
                steps = batch.rollout(self.substeps, controls, CONTROL_STATE, RECORDED_FIELDS, out=steps)
                if k == 0:  # MuJoCo's derived fields are those before the step, here of the start
                    energy = steps["energy"][:, 0].sum(axis=-1)
                    running_batch.replace_state_values(
                        lambda state: state.loop,
                        _with_energy(self._nominal[0], running_batch.read_full_state().loop, energy),
                    )
                due = slots if (k + 1) % every == 0 else None
                if due is not None:
                    records.append(_tick_record(world, running_batch, steps, due))
                broken = unbuilt | np.any(batch.warning[:, :, 0] > 0, axis=1)
                running_batch.replace_state_values(lambda state: state.steps, self._step_record(steps, broken))
                running_batch.advance_ticks(k + 1, 1)
                if due is not None:
                    records[-1]["judged"] = running_batch.read_state_values(lambda state: state.tick_summary)[due]
                if np.all(running_batch.read_state_values(lambda state: state.loop.running.is_over)):
                    break
            # all ended before the first sample: one is taken for the shapes of the records
            if slots is not None and steps and not records:
                judged = running_batch.read_state_values(lambda state: state.tick_summary)[slots]
                records.append({**_tick_record(world, running_batch, steps, slots), "judged": judged})
            figures = programs.finish(world, plans, running_batch.read_full_state().loop)
            parts = [jax.tree.map(lambda *each: np.stack(each), *records)] if records else []
            return {name: np.asarray(values) for name, values in figures.items()}, parts

    def _models(self, world: Case) -> tuple[list[mujoco.MjModel], np.ndarray]:
        """Model of each row, and which rows have none: MuJoCo cannot compile it, so the nominal model takes its place.

        Such a row is invalid. A line on standard error gives MuJoCo's reason.
        """
        models: list[mujoco.MjModel | None] = []
        reasons: dict[str, int] = {}
        for i in range(self.width):
            try:
                with warnings.catch_warnings(action="ignore", category=UserWarning):  # such as a singular inertia
                    models.append(self._model(batching.rollout_parameters(world, i)))
            except InputError:
                raise
            except ValueError as error:  # from MuJoCo's compiler
                models.append(None)
                reason = " ".join(str(error).removeprefix("Error: ").split())
                reasons[reason] = reasons.get(reason, 0) + 1
        for reason, count in reasons.items():
            rows = f"{count} of {self.width} rollouts of a batch are invalid"
            print(f"sweep: note: {rows}: MuJoCo cannot compile their models: {reason}", file=sys.stderr)
        unbuilt = np.array([model is None for model in models])
        stand_in = self._model(self._nominal[0]) if unbuilt.any() else None
        return [model or stand_in for model in models], unbuilt  # pyright: ignore[reportReturnType]

    def _model(self, world: Case) -> mujoco.MjModel:
        return scene.compile_native_model(world, self.settings.native_time_step, self.settings.solid)

    def _prepare(self, arrays: tuple[Case, Case, Array], sensing: SensingMode) -> NativePrograms:
        """The programs for the batch axes of `arrays`."""
        form = devices.program_signature(arrays[:2]), sensing
        if form not in self._programs:
            key_parts = "native", form, self.settings, self.limits, self.width, self.fused
            parts = program_cache.load_or_compile(key_parts, jax.devices()[:1], lambda: self._compile(arrays, sensing))
            if isinstance(parts[0], str):
                fused_loop.report_xla_fallback(self.settings, parts[0])
                self.fused = False
                return self._prepare(arrays, sensing)
            start, searches, tick, *rest = parts
            finish, again = (one and fused_loop.make_batch_function(one, self.width) for one in rest)
            tick = Kernel(tick) if isinstance(tick, KernelCode) else tick
            self._programs[form] = NativePrograms(CompiledPlanning.from_programs(start, searches), tick, finish, again)
        return self._programs[form]

    def rollout_outputs(self, world: Case, belief: Case, key: Array) -> Any:
        """Compute metrics and C MuJoCo inputs of one rollout for analysis by JAX, with C MuJoCo's results constant."""
        plan, (between, state) = self._start(required_sensing_mode(world.noise), world, belief, key)
        between = between._replace(steps=jax.tree.map(jnp.zeros_like, between.steps))

        def tick(state: LoopState, number: Array) -> tuple[LoopState, Any]:
            if self._replans:
                learned = replan_remaining_stages(belief, plan, state.loop.tracker.stage, state.loop.learned)
                state = state._replace(loop=state.loop._replace(learned=learned))
            after, _ = self._tick((world, belief, plan), state, number)
            return after, (state.inputs, state.loop.servo)

        numbers = 1 + jnp.arange(round(CHUNK_DURATION_S / self.settings.control_period))
        between, inputs = jax.lax.scan(tick, between, numbers)
        return state, inputs, compute_metrics(world, plan, between.loop)

    def find_inactive_parameters(self, sides: SideMaker, ends: Mapping[str, tuple[float, float]]) -> set[str]:
        """Find the parameters that change neither a metric nor the MuJoCo model."""
        unread = super().find_inactive_parameters(sides, ends)
        models = {c: [model_bytes(self._model(sides({c: end})[0])) for end in ends[c]] for c in sorted(unread)}
        return {c for c, (low, high) in models.items() if low == high}

    def _start(
        self, sensing: SensingMode, world: Case, belief: Case, key: Array
    ) -> tuple[Plan, tuple[LoopState, InitialState]]:
        known, plan, learned = prepare_belief(world, belief, key)
        state = start_state(world, known, plan)
        loop = init_loop(world, known, plan, state, jnp.zeros(()), key, learned, sensing)
        nothing = jnp.zeros(len(accumulator.metrics_computed_each_tick(world)), plan.duration.dtype)
        between = self._run_controller(world, belief, plan, loop, self._empty_record(state), nothing, jnp.int32(0))
        return plan, (between, state)

    def _tick(self, inputs: tuple[Case, Case, Plan], state: LoopState, k: Array) -> tuple[LoopState, dict[str, Array]]:
        world, belief, plan = inputs
        period = self.settings.control_period
        summary = self._tick_summary(world, state.steps, k - 1, state.loop.actual.free)
        loop, judged = update_metrics(world, plan, self.limits, state.loop, state.command, summary, k - 1, period)
        return self._run_controller(world, belief, plan, loop, state.steps, judged, k), {}

    @fused_loop.catch_unsupported_primitive
    def _compile(self, arrays: tuple[Case, Case, Array], sensing: SensingMode) -> tuple[Any, ...]:
        world, belief, _ = arrays
        axes, start = devices.vmap_in_axes((world, belief)), partial(self._start, sensing)

        def many(start: Callable) -> Callable:
            return jax.vmap(start, in_axes=(*axes, 0))

        use_numpy = self.fused and jax.default_backend() == "cpu"
        with ThreadPoolExecutor() as pool:
            batch, wait_for_start = planning.start_compilation(pool, start, arrays, many, self._searches, use_numpy)
            plans, (between, _) = batch
            shapes, state = fused_loop.single_rollout_shapes(arrays, (plans, between))
            world_shape, belief_shape, plan_shape = shapes

            def make_program(
                name: str, function: Callable, inputs: tuple, shapes: tuple, axes: tuple
            ) -> NumpyProgram | Compiled:
                def by_xla() -> Compiled:
                    return jax.jit(jax.vmap(function, in_axes=axes)).lower(*inputs).compile()

                with measure_part_duration(name):
                    return fused_loop.trace_or_compile_program(by_xla, function, *shapes) if use_numpy else by_xla()

            with measure_part_duration("closed loop"):
                if self.fused:
                    ticks = pool.submit(kernel.start_compilation(self._tick, shapes, state))
                else:
                    rows = jax.vmap(lambda *args: self._tick(*args)[0], in_axes=((*axes, 0), 0, None))
                    ticks = pool.submit(jax.jit(rows).lower((world, belief, plans), between, 0).compile)
                finish_program = make_program(
                    "figures",
                    compute_metrics,
                    (world, plans, between.loop),
                    (world_shape, plan_shape, state.loop),
                    (axes[0], 0, 0),
                )
                again = None
                if self._replans:
                    args, replan_shapes = ((x.loop.tracker.stage, x.loop.learned) for x in (between, state))
                    again = make_program(
                        "new plan",
                        replan_remaining_stages,
                        (belief, plans, *args),
                        (belief_shape, plan_shape, *replan_shapes),
                        (axes[1], 0, 0, 0),
                    )
                return *wait_for_start(), ticks.result(), finish_program, again

    def _run_controller(
        self,
        world: Case,
        belief: Case,
        plan: Plan,
        loop: ClosedLoop,
        steps: StepRecord,
        judged: Array,
        tick: Array,
    ) -> LoopState:
        """Run the controller for one control tick, and compute the inputs of its physics steps."""
        n, period, servo_before = self.substeps, self.settings.control_period, loop.servo
        loop, command = run_controller(world, belief, plan, loop, tick, period)
        servo = interpolate_target(servo_before, loop.servo, (1 + jnp.arange(n))[:, None, None] / n)
        torques = (servo.stiffness * servo.target + servo.torque).reshape(n, N_JOINTS)
        inputs = PhysicsInputs(torques, *self._external_forces(world, tick, loop.actual.free))
        return LoopState(loop, command, steps, inputs, judged)

    def _empty_record(self, start: InitialState) -> StepRecord:
        """Record before the first physics step."""
        n, count = self.substeps, N_LEGS * len(link_names(self._nominal[0].robot))
        qpos, qvel, forces = jnp.tile(start.qpos, (n, 1)), jnp.tile(start.qvel, (n, 1)), jnp.zeros((n, N_JOINTS))
        axes, feet, centre = jnp.zeros((count, 3)), jnp.zeros((N_LEGS, 3)), jnp.zeros(3)
        return StepRecord(qpos, qvel, forces, forces, jnp.zeros(()), axes, feet, centre, jnp.zeros((), bool))

    def _step_record(self, steps: dict[str, np.ndarray], broken: np.ndarray) -> tuple[np.ndarray, ...]:
        """Fields of `StepRecord` from MuJoCo's record of a batch."""
        count = N_LEGS * len(link_names(self._nominal[0].robot))
        return (
            steps["qpos"],
            steps["qvel"],
            steps["actuator_force"],
            steps["sensordata"],
            steps["energy"][:, -1].sum(axis=-1),
            steps["xpos"][:, -1, 2 : 2 + count],
            steps["site_xpos"][:, -1, :N_LEGS],
            steps["subtree_com"][:, -1, 1],
            broken,
        )

    def _external_forces(
        self, world: Case, tick: Array, free: FreeBodyState
    ) -> tuple[Float[Array, "n 3"], Float[Array, "n w"]]:
        """The push, and the wrenches on the obstacle's free bodies, for the physics steps of a control tick.

        The wrenches are computed for bodies that keep their velocity `free` from the start of the tick.
        """
        h, numbers = self.settings.native_time_step, jnp.arange(self.substeps)
        push = jax.vmap(lambda step: push_force(world.execution, step, h))(tick * self.substeps + numbers)
        ahead = h * numbers
        loads = jnp.zeros((self.substeps, 6 * len(world.obstacle.free_bodies)))
        if (
            loads.size
            and (load := jax.vmap(lambda t: world.obstacle.external_wrench(_extrapolate(free, t)))(ahead)) is not None
        ):
            loads = load.reshape(loads.shape)
        return push, loads

    def _tick_summary(self, world: Case, steps: StepRecord, number: Array, before: FreeBodyState) -> EngineTickReport:
        """Summary of a tick for the metrics; `before` is the state of the free bodies before it."""
        h, drive = self.settings.native_time_step, world.drive
        rate = steps.qvel[:, JOINT_V]
        torque = _joint_torque(steps.actuator_force, rate, drive.back_emf)
        effort = jnp.abs(steps.actuator_force)
        limit = world.execution.torque_scale * drive.torque_limit
        power = torque * rate
        push, loads = self._external_forces(world, number, before)
        count = len(world.obstacle.free_bodies)
        force = -jnp.mean(steps.foot_force.reshape(-1, N_LEGS, 3), axis=0)
        bodies = body_poses(free_body_state(steps.qpos[-1], steps.qvel[-1], count))
        normals = surface_at(world.obstacle, steps.feet, bodies).normal
        normal = jnp.sum(force * normals, axis=-1)
        last = -jnp.sum(steps.foot_force[-1].reshape(N_LEGS, 3) * normals, axis=-1)
        seen = exact_observation(steps.qpos[-1], steps.qvel[-1], count, last)
        outside = jnp.sum(push * steps.qvel[:, :3]) + jnp.sum(loads * _twists(steps, count))
        return EngineTickReport(
            torque_peak=jnp.max(jnp.abs(torque), axis=0).reshape(N_LEGS, 3),
            saturated=jnp.mean(effort >= 0.999 * limit, axis=0).reshape(N_LEGS, 3),
            force=force,
            normal=normal,
            tangential=jnp.linalg.norm(force - normal[:, None] * normals, axis=-1),
            residual=jnp.zeros(()),  # the C solver reports no residual force
            work=h * (jnp.sum(power) + outside),
            positive_work=h * jnp.sum(jnp.maximum(power, 0.0)),
            power=jnp.mean(power, axis=0).reshape(N_LEGS, 3),
            energy=jnp.where(steps.diverged, jnp.nan, steps.energy),
            actual=seen,
            centre_of_mass=steps.centre_of_mass,
            joints=jnp.concatenate([steps.links.reshape(N_LEGS, -1, 3), steps.feet[:, None]], axis=1),
            bodies=bodies,
        )


def _write_controls(controls: np.ndarray, torques: np.ndarray, push: np.ndarray, loads: np.ndarray) -> np.ndarray:
    """Write joint controls, then external wrenches on all bodies: world, robot from its base on, free bodies last."""
    controls[..., :N_JOINTS], controls[..., N_JOINTS + 6 : N_JOINTS + 9] = torques, push
    controls[..., controls.shape[-1] - loads.shape[-1] :] = loads
    return controls


def _extrapolate(free: FreeBodyState, time: Array) -> FreeBodyState:
    """State of free bodies after `time` (s) at constant velocity."""
    return free._replace(
        position=free.position + time * free.velocity, quat=multiply(exponential(time * free.turn), free.quat)
    )


def _twists(steps: StepRecord, count: int) -> Float[Array, "n 6k"]:
    """Linear and angular velocity of the free bodies after each step, world axes."""
    free = jax.vmap(lambda q, v: free_body_state(q, v, count))(steps.qpos, steps.qvel)
    return jnp.concatenate([free.velocity, free.turn], axis=-1).reshape(len(steps.qpos), 6 * count)


def _gains(servo: ServoCommand) -> Float[np.ndarray, "b 18 2"]:
    """Stiffness and damping of every joint."""
    return np.stack([np.asarray(servo.stiffness), np.asarray(servo.damping)], axis=-1).reshape(-1, N_JOINTS, 2)


def _update_gains(
    batch: Batch, models: list[mujoco.MjModel], gains_before: np.ndarray, gains_after: np.ndarray
) -> np.ndarray:
    """Set the servo gains of rollouts in which a joint's mode has changed. Returns the new gains."""
    changed = np.flatnonzero(np.any(gains_before != gains_after, axis=(1, 2)))
    for i in changed:
        models[i].actuator_biasprm[:, 1:3] = -models[i].actuator_gainprm[:, :1] * gains_after[i]
    if len(changed):
        batch.set_models(models)
    return gains_after


def _with_energy(world: Case, loops: ClosedLoop, start: np.ndarray) -> ClosedLoop:
    """Count the energy from its value at the start."""
    energy = jnp.asarray(start, loops.running.time.dtype)
    return loops._replace(running=accumulator.set_start_energy(world, loops.running, energy))


def _joint_torque[A: (Array, np.ndarray)](effort: A, rate: A, back_emf: Any) -> A:
    """Torque at the joints (N m) from the servo's effort; to C MuJoCo back-EMF is damping of the joint."""
    return effort - back_emf * rate


def _tick_record(
    world: Case, running_batch: KernelBatch | XlaBatch, steps: dict[str, np.ndarray], slots: np.ndarray
) -> dict[str, np.ndarray]:
    """Record of a tick of the rollouts in `slots`, without the values that are compared with thresholds."""
    back_emf = np.broadcast_to(world.drive.back_emf, steps["qpos"].shape[:1])[slots, None, None]
    torque = _joint_torque(steps["actuator_force"][slots], steps["qvel"][slots][..., JOINT_V], back_emf)
    commands = running_batch.read_state_values(
        lambda state: (state.command.joints, state.command.target, state.loop.tracker.stage)
    )
    (joints, target, stage), n = jax.tree.map(lambda x: x[slots], commands), len(slots)
    return {
        "qpos": steps["qpos"][slots, -1],
        "qvel": steps["qvel"][slots, -1],
        "joint_target": joints.reshape(n, N_JOINTS),
        "joint_torque": np.abs(torque).max(axis=1),
        "foot_position": steps["site_xpos"][slots, -1, :N_LEGS],
        "foot_target": target.feet,
        "foot_force": -steps["sensordata"][slots].reshape(n, -1, N_LEGS, 3).mean(axis=1),
        "base_target": np.concatenate([target.position, target.quat], axis=-1),
        "stage": stage,
    }

"""A user's model on a kernel of the fused compiler: MuJoCo's step written out over the robot's limbs.

On a CPU and on NVIDIA GPUs. A controller that the compiler has rules for is part of the kernel; a learned policy or a
NumPy controller is called between ticks, in tiles of a fixed size. Bits depend neither on the width of a batch nor on
the device's other rollouts.
"""

import operator
from collections.abc import Callable, Iterable
from dataclasses import replace
from functools import cached_property, partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from jaxtyping import Array

from sweep.backends import devices, program_cache
from sweep.contract.engine import Metrics
from sweep.contract.engine_settings import EngineSettings
from sweep.core.errors import InputError
from sweep.fused import driver, kernel, launch
from sweep.fused.arrays import UnsupportedPrimitive
from sweep.fused.randomness import is_key
from sweep.systems.mujoco_model import batch, disturbances, fields
from sweep.systems.mujoco_model.engine import (
    ON_NATIVE,
    TICKS_PER_CALL,
    BatchResult,
    ModelEngine,
    NativeModelEngine,
    TickSample,
    print_note_once,
)
from sweep.systems.mujoco_model.kernel import agreement, guard, sensors
from sweep.systems.mujoco_model.kernel.layout import (
    HFIELD,
    find_layout,
    find_stack_of_body,
    unsupported_model_error,
)
from sweep.systems.mujoco_model.kernel.numbers import ModelFieldValues
from sweep.systems.mujoco_model.kernel.scalars import Scalar, Vector, flatten_scalars, stack_scalars
from sweep.systems.mujoco_model.kernel.smooth import compute_smooth_terms
from sweep.systems.mujoco_model.kernel.step import (
    BodyPush,
    StepResult,
    compute_forces,
    compute_forward_dynamics,
    read_state,
    step,
    write_state,
)
from sweep.systems.mujoco_model.kernel.variation import find_varied_elements
from sweep.systems.mujoco_model.model_spec import ModelSpec, ParameterOverrides
from sweep.systems.mujoco_model.policy import ControllerBatch

HEIGHTS = "hfield_data"  # MuJoCo's name of the heights of all height fields
LEAST_ITERATIONS = 30  # of Newton's method, at most: models for MJX often have one, which solves no step
FORCED = {
    int(getattr(mujoco.mjtSensor, f"mjSENS_{name}"))
    for name in ("TOUCH", "ACCELEROMETER", "ACTUATORFRC", "JOINTACTFRC")
}


Rows = Any  # an array of one rollout, or of a batch with a leading axis


class KernelInputs(NamedTuple):
    """Inputs of one rollout to the compiled kernel that stay constant over all ticks."""

    policy: Any  # inputs of the controller; () where it is called between ticks
    rows: dict[str, Rows]  # fields in which models differ, in MuJoCo's shapes
    limits: dict[str, Rows]  # (..., 2)
    acting: disturbances.Disturbances  # without the axis of rollouts


class KernelCarry(NamedTuple):
    """State of one rollout (physics, controller, metrics) that the kernel carries from tick to tick."""

    qpos: Rows
    qvel: Rows
    warm: Rows  # (nv,) accelerations of the step before
    metrics: Any  # states of all metrics
    controller: Any  # its state; () where it is called between ticks
    command: Rows  # (nu,) of this tick; of a controller in the kernel, of the tick before
    observable: Rows  # (s,) see `ModelSpec.observable_state`
    force: Rows  # (nu,) of the actuators in the last step
    acting: dict[str, Rows]  # see `MjxModelEngine`
    before: Rows  # (nu,) command of the tick before
    tick: Rows  # number of the next tick
    ticks: Rows  # number of ticks of the rollout
    wrong: Rows  # whether a command was not finite
    needs_native: Rows  # whether something happened that the kernel does not simulate, or a step was not solved
    over: Rows  # whether the rollout has ended: on a GPU a warp stops when all of its rollouts have


def _copy_to_host(values: Any) -> Any:
    """Values as an array of NumPy; random keys, which it does not have, stay as they are."""
    return values if is_key(values) else np.asarray(values)


class KernelModelEngine(ModelEngine):
    """Engine that compiles controller, physics (MuJoCo's equations) and metrics of a tick into one CPU kernel.

    Raises `InputError` where the kernel cannot simulate the model.
    """

    dynamics = "kernel"

    def __init__(self, spec: ModelSpec, settings: EngineSettings):
        if spec.config.data:
            raise unsupported_model_error("arrays of mjData (model.data)")
        if spec.config.terrain:
            raise unsupported_model_error("terrain that replaces the floor (model.terrain)")
        self._layout = find_layout(spec.model)
        if spec.actuator_networks:
            raise unsupported_model_error("learned actuator networks")
        super().__init__(spec, settings)
        model = self._model
        self._is_inside = not (spec.controller.is_batched or spec.controller.fitted_policy)
        self._iterations = max(int(model.opt.iterations), LEAST_ITERATIONS)
        self._read_sensors = self._find_read_sensors()
        self._watched = guard.find_unsimulated_geom_pairs(self._layout, model)
        self._programs_by_form: dict[Any, Any] = {}
        self._first, self._enter, self._finish = self._programs.compile_for_batches()

    def _find_read_sensors(self) -> set[int]:
        """Sensors that the controller may read. Raises `InputError` where the kernel does not compute one of them."""
        spec, model = self._spec, self._model
        read, control = set(range(model.nsensor)), spec.controller
        if spec.config.observe and not (control.measure or control.observe or control.fitted_policy):
            read = {k for k in read if model.sensor(k).name in spec.config.observe}
        feet = {*spec.touch_sensors("feet"), *spec.touch_sensors("collisions")}
        unknown = sensors.find_unsupported_sensors(self._layout, model)
        for k in sorted((read | feet) & set(unknown)):
            raise unsupported_model_error(f"the sensor {model.sensor(k).name or k}: {unknown[k]}")
        return read

    def check_varied_parameters(self, paths: Iterable[str]) -> Iterable[str]:
        """Raise `InputError` if a study varies a number of the model that the kernel does not read."""
        numbers = ModelFieldValues(self._model, {}, {})
        jax.eval_shape(partial(self._read_numbers, numbers))
        for path in paths:
            for place in fields.resolve_parameter_path(self._model, path)[1]:
                ground = place.field.startswith("body_pos") and not self._model.body_weldid[place.flat_index // 3]
                if place.field not in numbers.read or ground:
                    raise unsupported_model_error(f"{path} that differs between rollouts")
        return ()

    def _read_numbers(self, numbers: ModelFieldValues) -> None:
        """Trace a forward pass, which reads all numbers of the model that the kernel uses."""
        model = self._model
        qpos, qvel, warm, ctrl = (jnp.zeros(size) for size in (model.nq, model.nv, model.nv, model.nu))
        state = read_state(self._layout, model, qpos, qvel, warm)
        result, _ = compute_forward_dynamics(self._layout, numbers, state, ctrl, (), 0)  # the solver reads none
        sensors.compute_sensors(self._layout, numbers, state, result)

    @cached_property
    def c_mujoco_agreement(self) -> agreement.AccelerationAgreement:
        """Differences between the kernel's and C MuJoCo's accelerations in random states, computed once and cached."""

        def compare() -> tuple[agreement.AccelerationAgreement]:
            return (agreement.compare_accelerations(self._layout, self._model, self._spec.keyframe_index),)

        key = "agreement", *self._stored_with()
        return program_cache.load_or_compile(key, jax.local_devices()[:1], compare)[0]

    def _stored_with(self) -> tuple[Any, ...]:
        """All of the scenario that stored programs contain."""
        spec = self._spec
        parts = spec.pushes, spec.payloads, spec.motors, spec.schedules
        return repr(spec.config), spec.delay_buffer, spec.action_buffer, *parts, self._settings.precision

    def _tick(
        self, varied: Any, inputs: KernelInputs, carry: KernelCarry, number: Array
    ) -> tuple[KernelCarry, dict[str, Array]]:
        """One control tick of one rollout, whose model has numbers of its own where `varied` says so."""
        if self._is_inside:
            command, controller = self._programs.tick_controller(inputs.policy, carry.controller, carry.observable)
        else:
            command, controller = carry.command, ()
        going = carry.tick < carry.ticks
        wrong = carry.wrong | going & ~jnp.isfinite(command).all()
        command = jnp.nan_to_num(command).astype(carry.qpos.dtype)
        is_first = carry.tick == 0
        before = jnp.where(is_first, command, carry.before)
        shares, extra = jnp.asarray(self._shares, command.dtype), dict(carry.acting)
        acting = jax.tree.map(lambda one: one[None], inputs.acting)
        late = None
        if "past" in extra:
            past = jnp.where(is_first, command[None], extra["past"])
            commands = before + shares[:, None] * (command - before)
            delayed, kept = disturbances.delay_commands(past[None], commands[None], acting.delay)
            late, extra["past"] = delayed[0], kept[0]
        numbers = ModelFieldValues(self._model, inputs.rows, varied)
        needs_native = carry.needs_native
        state, rebuild = flatten_scalars(read_state(self._layout, self._model, carry.qpos, carry.qvel, carry.warm))
        first_step = carry.tick * len(self._shares)
        limits = {name: rows[None] for name, rows in inputs.limits.items()}

        def one_step(moving: Any, given: Any) -> tuple[Any, None]:
            values, metrics, extra, needs_native, _ = moving
            (share, place, delayed), extra = given, dict(extra)
            target = before + share * (command - before) if delayed is None else delayed
            state = rebuild(values)
            controls = self._controls(state, target, acting.motors)
            pushes, force = self._pushes(acting, first_step + place)
            after, result = step(self._layout, numbers, state, controls, pushes, self._iterations)
            qpos, qvel, warm = write_state(self._layout, self._model, after)
            recorded = self._record(numbers, state, result, qpos, qvel)
            if force is not None:
                places = self._push_places(state, result)
                last = jnp.where(is_first & (place == 0), places, extra["places"])
                way = (places - last[0]) / 2  # at the mean of the speeds before and after a step
                recorded["push_work"] = (extra["wrench"] * way).sum()[None]
                extra |= {"wrench": force, "places": jnp.stack([last[1], places])}
            needs_native = needs_native | going & result.is_unsolved
            metrics = self._update(metrics, recorded, limits, going)
            sensed, pull = recorded["sensordata"][0, 0], recorded["actuator_force"][0, 0]
            arrays = [jnp.asarray(x, qpos.dtype) for x in flatten_scalars(after)[0]]
            return (arrays, metrics, extra, needs_native, (qpos, qvel, warm, sensed, pull, controls)), None

        model, dtype = self._model, carry.qpos.dtype
        none = (carry.qpos, carry.qvel, carry.warm, jnp.zeros(model.nsensordata, dtype), carry.force, command)
        steps = jnp.arange(len(self._shares))
        (_, metrics, extra, needs_native, last), _ = jax.lax.scan(
            one_step, (state, carry.metrics, extra, needs_native, none), (shares, steps, late)
        )
        qpos, qvel, warm, sensed, force, controls = last
        if self._spec.config.sensors == "current":
            sensed = self._current_sensors(numbers, qpos, qvel, warm, controls)
        if self._watched:
            state = read_state(self._layout, self._model, qpos, qvel, warm)
            smooth = compute_smooth_terms(self._layout, numbers, state)
            needs_native = needs_native | going & guard.has_near_pair(
                self._layout, numbers, state, smooth, self._watched
            )
        observable = jnp.concatenate([qpos, qvel, sensed])
        new = KernelCarry(qpos, qvel, warm, metrics, controller, command, observable, force, extra, command,
                    carry.tick + 1, carry.ticks, wrong, needs_native, carry.tick + 1 >= carry.ticks)  # fmt: skip
        return new, {"ctrl": command, "qpos": qpos, "qvel": qvel, "force": force}

    def _update(self, metrics: Any, recorded: Any, limits: Any, going: Array) -> Any:
        rows = jax.tree.map(lambda one: one[None], metrics)
        return jax.tree.map(lambda one: one[0], self._meter.update(rows, recorded, limits, going[None]))

    def _controls(self, state: Any, target: Array, limits: Any) -> Array:
        """Controls (nu,) of a physics step, by the laws that run at its rate."""
        law, motors = self._spec.controller.joint_control, self._spec.motor_law
        if law is None and motors is None:
            return target
        qpos, qvel, _ = write_state(self._layout, self._model, state)
        controls = target[None] if law is None else law.controls(target[None], qpos[None], qvel[None])
        if motors is not None:
            controls = motors.controls(controls, qpos[None], qvel[None], limits)
        return controls[0].astype(target.dtype)

    def _pushes(self, acting: Any, number: Array) -> tuple[tuple[BodyPush, ...], Array | None]:
        """Forces of one physics step, and as an array (p, 3) in N; None without pushes."""
        if not len(self._spec.pushed_bodies):
            return (), None
        force = acting.mean_push_forces(number[None], 1, self._model.opt.timestep)[0, 0]
        found = []
        for k, body in enumerate(self._spec.pushed_bodies):
            stack, member = find_stack_of_body(self._layout, int(body))
            found.append(BodyPush(stack, member, Vector(*(Scalar(force[k, i]) for i in range(3)))))
        return tuple(found), force

    def _push_places(self, state: Any, result: StepResult) -> Array:
        """Centres of mass (p, 3) of the pushed bodies as a step begins, m."""
        rows = []
        for body in self._spec.pushed_bodies:
            stack, member = find_stack_of_body(self._layout, int(body))
            centre = state.position + result.smooth.places[stack].centre
            rows.append(stack_scalars([*centre.stack_member(member)], state.position.x.value.dtype))
        return jnp.stack(rows)

    def _record(self, numbers: Any, state: Any, result: StepResult, qpos: Array, qvel: Array) -> dict[str, Array]:
        """What metrics read of one step, (1, 1, ...): positions and velocities at its end, the rest at its start."""
        model, dtype = self._model, qpos.dtype
        force, velocity = ([Scalar(0.0)] * model.nu for _ in range(2))
        for drive in result.drives:
            for k, number in enumerate(drive.actuators):
                for found, one in ((force, drive.force), (velocity, drive.velocity)):
                    found[number] = one.stack_member(k)
        sensed = sensors.compute_sensors(self._layout, numbers, state, result)
        sites = [[Scalar(0.0)] * 3 for _ in range(model.nsite)]
        for number in self._foot_sites:
            place = sensors.Frame(self._layout, numbers, state, result, sensors.SITE, number).position
            sites[number] = [*place]
        flat = [one for row in sites for one in row]

        def join(values: list[Scalar]) -> Array:
            return stack_scalars(values, dtype) if values else jnp.zeros(0, dtype)

        found = {"qpos": qpos, "qvel": qvel, "actuator_force": join(force), "actuator_velocity": join(velocity),
                 "sensordata": join(sensed), "site_xpos": join(flat).reshape(model.nsite, 3)}  # fmt: skip
        return {name: one[None, None] for name, one in found.items()} | {"unsolved": result.is_unsolved[None, None]}

    @cached_property
    def _foot_sites(self) -> list[int]:
        return [int(self._model.sensor_objid[k]) for k in self._spec.touch_sensors("feet")]

    def _current_sensors(self, numbers: Any, qpos: Array, qvel: Array, warm: Array, controls: Array) -> Array:
        """Sensors of a state by MuJoCo's forward pass."""
        state = read_state(self._layout, self._model, qpos, qvel, warm)
        if any(int(self._model.sensor_type[k]) in FORCED for k in self._read_sensors):
            result, _ = compute_forward_dynamics(self._layout, numbers, state, controls, (), self._iterations)
        else:
            smooth = compute_smooth_terms(self._layout, numbers, state)
            drives = compute_forces(self._layout, numbers, state, smooth, controls, ())[2]
            nothing: Any = None
            result = StepResult(smooth, nothing, nothing, drives, nothing)
        found = sensors.compute_sensors(self._layout, numbers, state, result, self._read_sensors)
        return stack_scalars(found, qpos.dtype) if found else jnp.zeros(0, qpos.dtype)

    def _start(self, world: ParameterOverrides, belief: ParameterOverrides, streams: np.ndarray) -> tuple[Any, ...]:
        """Start a batch.

        Returns:
            The batch, its controllers if they are called between ticks, varied elements of the model, inputs, carry,
            control ticks (n,), and energy (n,) in J.
        """
        spec, n, number = self._spec, len(streams), np.dtype(self._settings.precision).type
        begun = batch.make_initial_batch(spec, self._settings, world, belief, streams)
        on_gpu = jax.default_backend() == "gpu" and not spec.controller.is_batched
        outside = None if self._is_inside else ControllerBatch(self._programs, begun.policy_inputs, n, on_gpu)
        if outside is None:
            start, state, duration = self._programs.call_compiled_program(self._first, begun.policy_inputs)
        else:
            start, state, duration = outside.start, (), outside.duration
        at_first = begun.set_initial_state(start)
        observable = np.asarray(spec.observable_state(begun.qpos, begun.qvel, begun.sensors), number)
        ticks = batch.count_ticks(spec, duration).astype(np.int32)
        if outside is not None:
            outside.begin_rollouts(spec.observable_state(begun.qpos, begun.qvel, begun.sensors), ticks)
            controller = ()
        else:
            controller = self._programs.call_compiled_program(
                self._enter, begun.policy_inputs, state, observable, ticks
            )
        model, qpos, qvel = self._model, number(begun.qpos), number(begun.qvel)
        zeros = partial(np.zeros, dtype=number)
        extra = {}
        if spec.action_buffer:
            extra["past"] = zeros((n, spec.action_buffer, model.nu))
        if pushed := len(spec.pushed_bodies):
            extra |= {"wrench": zeros((n, pushed, 3)), "places": zeros((n, 2, pushed, 3))}
        metrics = jax.tree.map(np.asarray, self._meter.start(qpos, qvel))
        carry = KernelCarry(qpos, qvel, zeros((n, model.nv)), metrics, jax.tree.map(_copy_to_host, controller),
                      zeros((n, model.nu)), observable, zeros((n, model.nu)), extra, zeros((n, model.nu)),
                      np.zeros(n, np.int32), ticks, *(np.zeros(n, bool) for _ in range(3)))  # fmt: skip
        varied = self._find_varied(world)
        heights = np.broadcast_to(model.hfield_data, (n, *model.hfield_data.shape))
        rows = {
            name: number(np.reshape(heights if name == HEIGHTS else begun.batch.expand(name), (n, *np.shape(mask))))
            for name, mask in varied.items()
        }
        acting = jax.tree.map(lambda one: one if one.dtype.kind == "i" else number(one), begun.acting)
        limits = {name: number(one) for name, one in begun.limits.items()}
        inputs = KernelInputs(begun.policy_inputs if self._is_inside else (), rows, limits, acting)
        return begun, outside, varied, inputs, carry, ticks, at_first

    def _find_varied(self, world: ParameterOverrides) -> dict[str, np.ndarray]:
        paths = fields.select_batchable_values(self._model, self._spec.select_model_values(world))
        varied = find_varied_elements(self._model, paths, self._spec.payloads)
        if any(one.kind == HFIELD for one in self._layout.static_geoms):
            varied[HEIGHTS] = np.ones(self._model.nhfielddata, bool)  # read at places that only a rollout knows
        return varied

    def _compile(self, varied: Any, inputs: KernelInputs, carry: KernelCarry, n: int, ticks: int, room: int) -> Any:
        """Compile the kernel for batches of a form: `Kernel` on a CPU, `Ptx` on a GPU."""
        shapes = of_inputs, of_carry = tuple(
            jax.tree.map(lambda one: jax.ShapeDtypeStruct(one.shape[1:], one.dtype), tree) for tree in (inputs, carry)
        )
        on_cpu = jax.default_backend() == "cpu"
        lanes = kernel.choose_lane_count(n, devices.count_cores()) if on_cpu else 0
        form = jax.tree.structure(shapes), [(x.shape, str(x.dtype)) for x in jax.tree.leaves(shapes)]
        marks = [(name, np.packbits(mask).tobytes()) for name, mask in sorted(varied.items())]
        key = repr((form, marks, lanes, None if on_cpu else (n, ticks, room)))
        if key not in self._programs_by_form:
            tick = partial(self._tick, varied)

            def compile_code() -> tuple[Any]:
                try:
                    if on_cpu:
                        return (kernel.compile_function(tick, of_inputs, of_carry, self._layout.group, lanes),)
                    is_over = operator.attrgetter("over")
                    group = self._layout.group
                    return (launch.compile_to_ptx(tick, of_inputs, of_carry, is_over, ticks, room, n, group),)
                except UnsupportedPrimitive as missing:
                    return (str(missing),)

            (code,) = program_cache.load_or_compile((*self._stored_with(), key), jax.local_devices()[:1], compile_code)
            if isinstance(code, str):
                raise InputError(
                    f"engine.name = kernel is not allowed: the compiler has no rule for {code}, which the controller "
                    "uses (native and mjx run any controller of JAX)"
                )
            self._programs_by_form[key] = kernel.Kernel(code) if on_cpu else code
        return self._programs_by_form[key]

    @devices.convert_memory_errors()
    def _simulate(
        self,
        world: ParameterOverrides,
        belief: ParameterOverrides,
        streams: np.ndarray,
        slots: Any = (),
        every: int = 1,
    ) -> BatchResult:
        slots = np.asarray(list(slots), int)
        if self._settings.cross_check:
            self.c_mujoco_agreement.require_within_tolerance(self._spec.config.mjcf)
            print_note_once(f"kernel: {self.c_mujoco_agreement}")
        with self._within():
            begun, outside, varied, inputs, carry, ticks, at_first = self._start(world, belief, streams)
            longest = int(ticks.max(initial=0))
            runner = _CpuRunner if jax.default_backend() == "cpu" else _GpuRunner
            running = runner(partial(self._compile, varied), inputs, carry, len(streams), slots)
            frames = []
            chunk = 1 if outside is not None else TICKS_PER_CALL
            for first in range(0, longest, chunk):
                count = min(chunk, longest - first)
                if outside is not None:
                    running.set_commands(outside.next_controls(running.read_observables()))
                record = running.simulate_ticks(first, count)
                for k in range(count) if len(slots) else ():
                    if (first + k + 1) % every == 0:
                        parts = (np.asarray(record[name][k], float) for name in ("ctrl", "qpos", "qvel", "force"))
                        policy = outside.read_observations_and_actions(slots) if outside else np.zeros((len(slots), 0))
                        time = (first + k + 1) * self._spec.config.period
                        frames.append(TickSample(time, *parts, policy=policy))
            end = running.read_final_carry()
            observable = np.asarray(end.observable)
            if outside is None:
                measured = self._programs.call_compiled_program(
                    self._finish, begun.policy_inputs, end.controller, observable
                )
                measured = {name: np.asarray(values, float) for name, values in measured.items()}
            else:
                measured = outside.compute_rollout_metrics(np.asarray(observable, float))
        last = jax.tree.map(np.asarray, end.metrics)
        wrong = np.asarray(end.wrong)
        gained = begun.energy(last.last_qpos, last.last_qvel) - at_first
        found = self._meter.compute(last, begun.mass, gained, wrong, np.zeros(len(streams), bool)) | measured
        models = [begun.batch.get_model(int(slot)) for slot in slots]
        needs_native = np.flatnonzero(np.asarray(end.needs_native))
        found[ON_NATIVE] = np.asarray(end.needs_native, float)
        if len(needs_native):
            print_note_once(
                "kernel: rollouts with a contact that the kernel does not simulate, or with an unsolved step, are "
                f"simulated again by native: their column {ON_NATIVE} is 1"
            )
            self._simulate_again((world, belief), streams, needs_native, found, slots, every, frames)
        return found, frames, models

    def _simulate_again(
        self, sides: Any, streams: np.ndarray, chosen: np.ndarray, found: Metrics, slots: Any, every: int, frames: Any
    ) -> None:
        """Simulate some rollouts on C MuJoCo, and write what it finds over what the kernel found."""
        rows = [
            ParameterOverrides(tuple((path, x[chosen] if np.ndim(x) else x) for path, x in side.values))
            for side in sides
        ]
        both = [k for k, slot in enumerate(slots) if slot in chosen]
        places = [int(np.flatnonzero(chosen == slots[k])[0]) for k in both]
        again, samples, _ = self._native._simulate(rows[0], rows[1], streams[chosen], places, every)
        for name, values in again.items():
            found[name] = np.array(found[name])  # those that JAX has computed cannot be written
            found[name][chosen] = values
        for frame, sample in zip(frames, samples, strict=False):
            for name in ("ctrl", "qpos", "qvel", "force", "policy"):
                getattr(frame, name)[both] = getattr(sample, name)

    @cached_property
    def _native(self) -> NativeModelEngine:
        return NativeModelEngine(self._spec, replace(self._settings, name="native"))


class _CpuRunner:
    """A batch in the memory of a CPU kernel."""

    def __init__(self, make: Callable[..., Any], inputs: KernelInputs, carry: KernelCarry, n: int, slots: np.ndarray):
        self._tiles = make(inputs, carry, n, TICKS_PER_CALL, 0).load_batch(inputs, carry, n)
        self._slots = slots if len(slots) else None

    def set_commands(self, commands: np.ndarray) -> None:
        """Set the commands (n, nu) of the next tick."""
        self._tiles.replace_state_values(lambda carry: carry.command, commands)

    def read_observables(self) -> np.ndarray:
        """What controllers observe (n, s)."""
        return self._tiles.read_state_values(lambda carry: carry.observable)

    def simulate_ticks(self, first: int, count: int) -> Any:
        """Simulate ticks; return what is recorded of the chosen rollouts, (ticks, slots, ...) by name."""
        return self._tiles.advance_ticks(first, count, self._slots)

    def read_final_carry(self) -> KernelCarry:
        """Return the carry at the end, (n, ...)."""
        return self._tiles.read_full_state()


class _GpuRunner:
    """A batch in the memory of a GPU, where it stays as kernels lay it out."""

    def __init__(self, make: Callable[..., Any], inputs: KernelInputs, carry: KernelCarry, n: int, slots: np.ndarray):
        self._make, self._n, self._slots = make, n, jnp.asarray(slots, jnp.int32) if len(slots) else None
        self._begun: Any = inputs, carry  # until the first launch, which lays them out
        self._shapes = jax.eval_shape(lambda *both: both, inputs, carry)
        self._observable, self._commands = jnp.asarray(carry.observable), None
        self._calls: dict[int, tuple[launch.PtxKernel, Any]] = {}

    def set_commands(self, commands: Any) -> None:
        """Set the commands (n, nu) of the next tick."""
        self._commands = jnp.asarray(commands, self._shapes[1].command.dtype)

    def read_observables(self) -> Array:
        """What controllers observe (n, s), on the GPU."""
        return self._observable

    def simulate_ticks(self, first: int, count: int) -> Any:
        """Simulate ticks; return what is recorded of the chosen rollouts, (ticks, slots, ...) by name."""
        if count not in self._calls:
            self._calls[count] = self._compile(count)
        self._code, call = self._calls[count]  # all have the same layout
        if self._begun:
            self._inputs, self._state = jax.jit(partial(launch.pack_batch, self._code))(*self._begun)
            self._begun = None
        self._state, self._observable, record = call(self._inputs, self._state, self._commands, first, self._slots)
        return jax.tree.map(np.asarray, record)

    def _compile(self, count: int) -> tuple[launch.PtxKernel, Any]:
        code = self._make(*self._shapes, self._n, count, 0 if self._slots is None else len(self._slots))
        tree = jax.tree.structure(self._shapes[1])
        leaves = jax.tree.unflatten(tree, code.carry_leaves)

        def call(inputs: Array, state: Array, commands: Any, first: Array, slots: Any) -> Any:
            if commands is not None:
                state = launch.write_carry_leaf(leaves.command, state, commands)
            state, record = launch.advance_packed_batch(code, inputs, state, first, slots)
            return state, launch.read_carry_leaf(leaves.observable, state, self._n), record

        driver.start_ptx_translation(code.text)
        return code, jax.jit(call, donate_argnums=1, compiler_options=launch.XLA_OPTIONS)

    def read_final_carry(self) -> KernelCarry:
        """Return the carry at the end, (n, ...)."""
        carry = jax.jit(lambda state: launch.unpack_carry(self._code, state, self._shapes[1]))(self._state)
        return jax.tree.map(_copy_to_host, carry)

"""A user's controller as one compiled program of a fixed shape, which is called tile by tile.

XLA gives other last bits at other widths, so that a row would depend on what runs beside it. The shape of a tile never
changes. On a CPU other places of a tile give other bits as well, so that its rollouts go through the same instructions
one after the other. On a GPU every rollout of a large tile has a thread, or a row of a matrix product, of its own. A
controller of NumPy's is called with a whole tile, whose width never changes.
"""

import contextlib
import logging
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from sweep.core.errors import USER_CODE_ERRORS, InputError, format_user_exception
from sweep.core.metric import Metric, freeze_ended_states
from sweep.core.user_code import describe_user_error, run_user_code
from sweep.fused.numbers import evaluate_with_numpy
from sweep.systems.mujoco_model import actuation, files
from sweep.systems.mujoco_model.actuator_networks import ActuatorNetwork
from sweep.systems.mujoco_model.batch import InitialBatch, controller_inputs, count_ticks
from sweep.systems.mujoco_model.model_spec import PHYSICAL, ModelSpec, ParameterOverrides
from sweep.systems.mujoco_model.schedules import tabulate_schedule
from sweep.systems.mujoco_model.tracking import VelocityTracking

TILE_ROLLOUTS = 64
GPU_TILE_ROLLOUTS = 16384  # fills a GPU with a policy's smallest layer; activations of its largest fit into the cache
GPU_TILE_OPTIONS = {  # XLA would choose matrix products by their measured times, and so their bits
    "xla_gpu_autotune_level": 0,
    "xla_gpu_enable_triton_gemm": False,
}
logging.getLogger("jax._src.callback").setLevel(logging.CRITICAL)  # it prints tracebacks of errors that are told here


def _draw_normal(key: Array, like: Array) -> Array:
    """Normal numbers, the same in any precision."""
    return jax.random.normal(key, like.shape, jnp.float32).astype(like.dtype)


def select_numeric_values(values: Mapping[str, Any]) -> dict[str, Any]:
    """Select the values that are numbers, not texts such as file names."""
    return {path: value for path, value in values.items() if not isinstance(value, str)}


class FinalControllerState(NamedTuple):
    """Belief and final state of a user's controller, from which the controller's own metrics are computed."""

    belief: Mapping[str, Any]
    state: Any  # of the controller


def make_user_metric(control: files.LoadedController) -> Metric[Any]:
    """Make a metric from the functions `measure` and `figures` of a user's controller; `FIGURES` names its columns.

    It begins with, and is updated by, all that can be observed by name.
    """
    measure, figures = control.measure, control.figures

    def compute(measurement: Any, end: FinalControllerState) -> dict[str, Array]:
        return figures(*end, *([measurement] if measure else [])) if figures else {}

    begin = (lambda told: measure(None, told)) if measure else (lambda told: ())
    return Metric(begin, measure or (lambda measurement, told: ()), compute, control.metric_meanings)


class FirstTickEvaluation(NamedTuple):
    """Observations and commands of a controller at the nominal start, without sensor errors."""

    inputs: dict[str, list[tuple[str, str, np.ndarray]]]  # terms of each input: name, unit and numbers
    # for a network: joint in its order, number of the network, command; else actuator, NaN, command; and the unit
    commands: list[tuple[str, float, float, str]]
    is_learned: bool  # whether a network with a policy file commands


class TilePrograms(NamedTuple):
    """A controller's functions, compiled for a tile of rollouts; see `ControllerPrograms` for what each one takes."""

    rollouts: int  # of a tile
    first: Callable[..., Any]
    enter: Callable[..., Any]
    tick: Callable[..., Any]
    finish: Callable[..., Any]


class ControllerPrograms:
    """Compiled functions of a user's controller for batches of rollouts. Raises `InputError` for invalid controllers.

    `begin(belief, key) -> (start, state, duration)`: positions (nq,) and seconds, or None for the model's own.
    `policy(belief, observation, state, key) -> (ctrl, state)`: once a tick, of an observation (k,), controls (nu,).
    One that is `batched` is `policy(observations) -> ctrl`, of NumPy's (n, k) and (n, nu).
    `measure(previous, told) -> measurement`: as every tick begins, and at the end, of all that can be observed by name;
    `previous` is None at first.
    """

    def __init__(self, spec: ModelSpec, belief: Mapping[str, Any]):
        control, self._spec = spec.controller, spec
        self.period, self.learned = spec.config.period, control.fitted_policy
        self._begin = control.begin or (lambda belief, key: (None, (), None))
        # what is batched is called with what this gives
        self._policy = (lambda belief, told, state, key: (told, state)) if control.is_batched else control.policy
        self._metric = make_user_metric(control)
        ticks = round(spec.config.duration / self.period) + 1
        self._commands = {one.name: tabulate_schedule(one, ticks, self.period) for one in spec.schedules}
        tracked = spec.tracked_commands
        self._tracking = VelocityTracking(spec.model, tracked) if tracked else None
        self.call_user_code(self._check, belief)

        def map_rollouts(one: Callable[..., Any]) -> Callable[..., Any]:  # of a tile, one after the other
            return lambda *rows: jax.lax.map(lambda row: one(*row), rows)

        self.tiles = self._compile_for_tiles(TILE_ROLLOUTS, map_rollouts)
        self.gpu_tiles = self._compile_for_tiles(GPU_TILE_ROLLOUTS, jax.vmap, compiler_options=GPU_TILE_OPTIONS)

    def _compile_for_tiles(self, rollouts: int, over: Callable[..., Any], **options: Any) -> TilePrograms:
        first, enter, finish = (
            jax.jit(over(one), **options)
            for one in (self.begin_controller, self.make_initial_carry, self.compute_rollout_metrics)
        )
        tick = jax.jit(over(self.tick_controller), donate_argnums=1, **options)
        return TilePrograms(rollouts, first, enter, tick, finish)

    def begin_controller(self, policy_inputs: Mapping[str, Any]) -> tuple[Any, Any, Any]:
        """Call the controller's `begin` for one rollout; return start, state and duration (default: infinite)."""
        key = jax.random.fold_in(jax.random.wrap_key_data(policy_inputs["key"]), 0)
        start, state, duration = self._begin(self._belief(policy_inputs, jnp.int32(0)), key)
        return start, state, jnp.asarray(jnp.inf if duration is None else duration)

    def _belief(self, policy_inputs: Mapping[str, Any], tick: Array) -> dict[str, Any]:
        """What the controller believes in a tick: commands that have a schedule are those of its time."""
        found = dict(policy_inputs["belief"])
        for name, table in self._commands.items():
            values = jnp.asarray(table, float)
            found[name] = policy_inputs["factors"][name] * values[jnp.clip(tick, 0, len(table) - 1)]
        return found

    def make_initial_carry(
        self, policy_inputs: Mapping[str, Any], state: Any, observable: Array, ticks: Array
    ) -> dict[str, Any]:
        """Return what one rollout carries from tick to tick: the controller's state and past observations."""
        key, seen = (
            jax.random.fold_in(jax.random.wrap_key_data(policy_inputs["key"]), 1),
            self._spec.observe_state(observable),
        )
        size = policy_inputs["bias"] + self._term_numbers(policy_inputs, "bias")
        bias, late = size * _draw_normal(key, seen), jnp.tile(seen, (self._spec.delay_buffer + 1, 1))
        measurement = self._metric.begin(self._spec.split_state(observable))
        return {
            "state": state,
            "late": late,
            "bias": bias,
            "tick": jnp.int32(0),
            "ticks": ticks,
            "measurement": measurement,
            **({"tracking": self._tracking.begin()} if self._tracking else {}),
            **({"held": seen} if "terms" in policy_inputs else {}),
        }

    def _term_numbers(self, policy_inputs: Mapping[str, Any], key: str) -> Any:
        """A number of the errors of terms for each number of the observation, (k,); 0 without a learned policy."""
        learned = self._spec.controller.fitted_policy
        if learned is None or not learned.measured_terms:
            return 0
        errors = policy_inputs["terms"][key]
        return jnp.concatenate([jnp.full(one.size, errors[label]) for label, one in learned.measured_terms.items()])

    def tick_controller(self, policy_inputs: Mapping[str, Any], carried: Any, observable: Array) -> tuple[Array, Any]:
        """Run the controller for one tick of one rollout; return controls (nu,) and the state to carry on."""
        tick, seen = carried["tick"], self._spec.observe_state(observable)
        policy_key, noise = jax.random.split(
            jax.random.fold_in(jax.random.wrap_key_data(policy_inputs["key"]), 2 + tick)
        )
        length = self._spec.delay_buffer + 1  # of a ring, in which only one row is written in a tick
        late = carried["late"].at[tick % length].set(seen)
        if "terms" in policy_inputs:
            told = self._observe_terms(policy_inputs, carried, late, noise)
            held = {"held": told}
        else:
            seen_late = late[(tick - policy_inputs["delay"]) % length]
            told, held = seen_late + carried["bias"] + policy_inputs["white"] * _draw_normal(noise, seen), {}
        ctrl, state = self._policy(self._belief(policy_inputs, tick), told, carried["state"], policy_key)
        new = {"late": late, "tick": tick + 1, **self._measured(policy_inputs, carried, observable), **held}
        return ctrl, {**carried, **new, "state": freeze_ended_states(tick < carried["ticks"], state, carried["state"])}

    def _observe_terms(self, policy_inputs: Mapping[str, Any], carried: Any, late: Array, key: Array) -> Array:
        """What a learned policy measures in a tick (k,), with the errors of each term."""
        length, tick = late.shape[0], carried["tick"]
        delay = policy_inputs["delay"] + jnp.rint(self._term_numbers(policy_inputs, "delay")).astype(jnp.int32)
        seen = late[(tick - delay) % length, jnp.arange(late.shape[1])]
        white = policy_inputs["white"] + self._term_numbers(policy_inputs, "white")
        told = seen + carried["bias"] + white * _draw_normal(key, seen)
        learned = self._spec.controller.fitted_policy
        terms = learned.measured_terms if learned else {}
        luck = jax.random.uniform(jax.random.fold_in(key, 1), (len(terms),), jnp.float32)  # one for each term
        each = [jnp.full(one.size, luck[k]) for k, one in enumerate(terms.values())]
        luck = jnp.concatenate(each) if each else jnp.zeros(0)
        is_lost = (luck < self._term_numbers(policy_inputs, "dropout")) & (tick > 0)
        return jnp.where(is_lost, carried["held"], told)

    def compute_rollout_metrics(
        self, policy_inputs: Mapping[str, Any], carried: Any, observable: Array
    ) -> dict[str, Array]:
        """Compute the controller's own metrics of one rollout from its last state (s,), by name."""
        measured = self._measured(policy_inputs, carried, observable)
        belief = self._belief(policy_inputs, carried["ticks"] - 1)
        found = self._metric.compute(measured["measurement"], FinalControllerState(belief, carried["state"]))
        return found | (self._tracking.compute(measured["tracking"]) if self._tracking else {})

    def rollout_outputs(self, world: ParameterOverrides, belief: ParameterOverrides, key: Array) -> Any:
        """Compute controller outputs and model inputs of one rollout; JAX only traces this function for analysis."""
        spec = self._spec
        policy_inputs = {**controller_inputs(spec, world, belief), "key": jax.random.key_data(key)}
        policy_inputs["delay"] = jnp.rint(jnp.asarray(policy_inputs["delay"])).astype(jnp.int32)
        observable = jnp.zeros(spec.state_size)
        start, state, duration = self.begin_controller(policy_inputs)

        def tick(carried: Any, _: None) -> tuple[Any, Any]:
            ctrl, carried = self.tick_controller(policy_inputs, carried, observable)
            return carried, ctrl

        carried = self.make_initial_carry(policy_inputs, state, observable, jnp.int32(2))
        carried, ctrl = jax.lax.scan(tick, carried, None, length=2)
        return (
            start,
            duration,
            ctrl,
            self.compute_rollout_metrics(policy_inputs, carried, observable),
            [select_numeric_values(world.select_group(name)) for name in ("model", *PHYSICAL)],
            dict(world.values).get("noise.action_delay"),
        )

    def _measured(self, policy_inputs: Mapping[str, Any], carried: Any, observable: Array) -> dict[str, Any]:
        """What is measured so far; a rollout that is over has its end in it already."""
        state = self._spec.split_state(observable)
        old = {name: carried[name] for name in ("measurement", "tracking") if name in carried}
        new = {"measurement": self._metric.update(carried["measurement"], state)}
        if self._tracking:
            belief = self._belief(policy_inputs, carried["tick"] - 1)  # of the tick that has ended
            new["tracking"] = self._tracking.update(carried["tracking"], belief, state)
        within = (carried["tick"] > 0) & (carried["tick"] <= carried["ticks"])  # the start is in it
        return freeze_ended_states(within, new, old)

    def check_first_controls(self, begun: InitialBatch) -> None:
        """Raise `InputError` if the controller's first controls are not finite, or differ between two calls.

        The calls are for the nominal start; one of a batched controller lies between the two that must agree.
        """

        def found(function: Callable[..., Any], *more: Any) -> Any:  # without compiling it
            return self.call_user_code(
                evaluate_with_numpy, lambda: function(*jax.tree.map(jnp.asarray, (first, *more)))
            )

        first = jax.tree.map(lambda rows: rows[0], begun.policy_inputs)
        start, state, duration = found(self.begin_controller)
        count_ticks(self._spec, duration)
        if start is not None and not np.isfinite(start).all():
            raise self._error("begins at positions that are not finite")
        begun.set_initial_state(start)
        observable = self._spec.observable_state(begun.qpos, begun.qvel, begun.sensors)[0]
        ctrl, _ = found(
            self.tick_controller, found(self.make_initial_carry, state, observable, np.int32(1)), observable
        )
        told = np.tile(ctrl, (TILE_ROLLOUTS, 1))
        controls = np.array(self.compute_controls(told))
        if not np.isfinite(controls).all():
            raise self._error("gives controls that are not finite at the nominal start")
        if not self._spec.controller.is_batched:
            return
        with contextlib.suppress(InputError):  # it may have no answer to what no rollout observes
            self.compute_controls(told + 1)
        again = np.asarray(self.compute_controls(told))
        if not np.array_equal(controls, again):
            row, one = np.argwhere(controls != again)[0]
            raise self._error(
                f"gives {controls[row, one]:.4g}, then {again[row, one]:.4g} for the same observations: a global "
                "variable that keeps a state, or draws random numbers, mixes rollouts. A JAX controller has a state "
                "for each rollout: policy(belief, observation, state, key) -> (controls, state)"
            )

    def evaluate_first_tick(self, begun: InitialBatch) -> FirstTickEvaluation:
        """Return observations and commands of the controller at the nominal start. Raises `InputError` where it fails.

        Args:
            begun: A batch whose first rollout is nominal.
        """
        spec, model = self._spec, self._spec.model
        first = jax.tree.map(lambda rows: jnp.asarray(rows[0]), begun.policy_inputs)
        start, state, _ = self.call_user_code(self.begin_controller, first)
        begun.set_initial_state(start)
        observable = jnp.asarray(spec.observable_state(begun.qpos, begun.qvel, begun.sensors)[0], float)
        carried = self.call_user_code(self.make_initial_carry, first, state, observable, np.int32(1))
        seen = spec.observe_state(observable)
        ctrl, carried = self.call_user_code(self.tick_controller, first, carried, observable)
        controls = np.array(self.compute_controls(np.tile(ctrl, (TILE_ROLLOUTS, 1))))[0]
        learned = spec.controller.fitted_policy
        if learned is None:
            parts = spec.config.observe or ("observation",)
            every = [observable[spec.state_slices[name]] for name in spec.config.observe] or [seen]
            inputs = {"observation": [(name, "", np.asarray(one)) for name, one in zip(parts, every, strict=True)]}
            names = [actuation.find_actuator_name(model, k) for k in range(model.nu)]
            commands = [(name, np.nan, one, "") for name, one in zip(names, controls.tolist(), strict=True)]
        else:
            inputs = learned.split_inputs_into_terms(
                learned.assemble(self._belief(first, jnp.int32(0)), seen, state)[0]
            )
            action = np.asarray(carried["state"]["action"], float)
            commands = list(zip(learned.joints, action.tolist(), controls[learned.actuators].tolist(),
                                learned.command_units, strict=True))  # fmt: skip
        return FirstTickEvaluation(inputs, commands, learned is not None)

    def _error(self, what: str) -> InputError:
        """One line that says what a controller does wrong."""
        return InputError(f"model.controller = {self._spec.config.controller} {what}")

    def call_user_code(self, function: Callable[..., Any], *args: Any, when: str = "", is_own: bool = True) -> Any:
        """Call a function that runs a user's code; name the line of that code if it raises an error.

        Args:
            function: the function.
            *args: its arguments.
            when: ` in tick 3`, for messages.
            is_own: whether all that it raises is the user's; else only what was raised in a file of the project.

        Raises:
            InputError: names the controller, the tick, and the file and line that failed.
        """
        name, control = self._spec.config.controller, self._spec.controller
        try:
            with run_user_code(f"{name}{when}", control.folder):
                return function(*args)
        except InputError:
            raise
        except USER_CODE_ERRORS as error:
            reason = describe_user_error(error, files.project_folder())
            if reason is None and not is_own:
                raise
            raise self._error(f"fails{when}: {reason or format_user_exception(error)}") from None

    def compile_for_batches(self) -> tuple[Callable[..., Any], ...]:
        """Return functions over a batch: begin controllers, start rollouts, and compute the controllers' metrics.

        To be called once: functions made in every run would be traced and compiled anew.
        """
        each = self.begin_controller, self.make_initial_carry, self.compute_rollout_metrics
        return tuple(jax.jit(jax.vmap(one)) for one in each)

    def call_compiled_program(self, program: Callable[..., Any], *inputs: Any, when: str = "") -> Any:
        """Call a compiled program that contains a user's controller, and wait so that its errors are raised here.

        Args:
            program: The program.
            *inputs: Its inputs.
            when: ` in tick 3`, for messages.

        Raises:
            InputError: names the controller, the tick, and the file and line that failed.
        """
        return self.call_user_code(lambda: jax.block_until_ready(program(*inputs)), when=when, is_own=False)

    def compute_controls(self, policy_output: np.ndarray, when: str = "") -> np.ndarray:
        """Return the controls (n, nu): the program's output, or a batched controller's result for it as observation."""
        if not self._spec.controller.is_batched:
            return policy_output
        policy_output, controls = np.array(policy_output), self._spec.model.nu
        ctrl = self.call_user_code(lambda: np.asarray(self._spec.controller.policy(policy_output)), when=when)
        if ctrl.shape != (len(policy_output), controls) or ctrl.dtype.kind not in "fiu":
            count, size = len(policy_output), policy_output.shape[1]
            wanted = f"numbers ({count}, {controls}) are wanted of ({count}, {size})"
            raise self._error(f"gives {ctrl.dtype} {ctrl.shape}: {wanted}")
        return ctrl

    def _check(self, belief: Mapping[str, Any]) -> None:
        """Raise where the controller's functions fit neither each other nor the model."""
        spec, model, key = self._spec, self._spec.model, jax.random.key(0)
        observable = jnp.zeros(spec.state_size)
        start, state, duration = jax.eval_shape(self._begin, belief, key)
        seen = jax.eval_shape(spec.observe_state, observable)
        ctrl, after = jax.eval_shape(self._policy, belief, seen, state, key)
        measurement = jax.eval_shape(lambda: self._metric.begin(spec.split_state(observable)))
        more = jax.eval_shape(self._metric.update, measurement, spec.split_state(observable))
        found = jax.eval_shape(self._metric.compute, measurement, FinalControllerState(belief, after))
        shape = getattr(ctrl, "shape", type(ctrl).__name__)

        def differ(*trees: Any) -> bool:
            before, after = (jax.tree.map(lambda x: (x.shape, x.dtype), tree) for tree in trees)
            return before != after

        for wrong, what in (
            (getattr(seen, "ndim", 0) != 1, f"observes {getattr(seen, 'shape', seen)}: (k,) is wanted"),
            (not spec.controller.is_batched and shape != (model.nu,),
             f"gives controls {shape}: ({model.nu},) are wanted"),
            (differ(state, after), "returns a state of another shape or type than it receives"),
            (differ(measurement, more), "returns measurements of another shape or type than at first"),
            (start is not None and start.shape != (model.nq,),
             f"begins at {getattr(start, 'shape', '')}: ({model.nq},) are wanted"),
            (duration is not None and duration.shape, f"lasts {getattr(duration, 'shape', '')}: one number is wanted"),
        ):  # fmt: skip
            if wrong:
                raise self._error(what)
        told = {"observes": seen, "gives controls": None if spec.controller.is_batched else ctrl, "begins at": start,
                "lasts": duration}  # fmt: skip
        for what, one in told.items():
            if one is not None and not jnp.isdtype(one.dtype, ("real floating", "integral")):
                raise self._error(f"{what} {one.dtype} {one.shape}: numbers are wanted")
        if {*found} != {*spec.controller.metric_meanings} or any(
            one.shape or one.dtype.kind == "c" for one in found.values()
        ):
            has = ", ".join(f"{name} {one.dtype} {one.shape}" for name, one in found.items())
            raise self._error(f"has figures {has}: numbers are wanted, named in FIGURES")
        if spec.controller.is_batched:
            self.compute_controls(np.zeros((TILE_ROLLOUTS, seen.shape[0]), jnp.zeros(0).dtype))


class TiledActuatorNetwork:
    """A neural network for actuator torques, evaluated for `TILE_ROLLOUTS` of n rollouts at a time."""

    def __init__(self, network: ActuatorNetwork):
        one = network.load_torque_function()
        self._program = jax.jit(lambda *rows: jax.lax.map(lambda row: one(*row), rows))

    def __call__(self, inputs: np.ndarray, memory: Mapping[str, np.ndarray]) -> tuple[np.ndarray, dict[str, Any]]:
        """Return torques (n, joints) and the next memory from inputs (n, joints, k) and memory (n, joints, ...)."""
        n = len(inputs)
        rows = np.minimum(np.arange(-(-n // TILE_ROLLOUTS) * TILE_ROLLOUTS), n - 1).reshape(-1, TILE_ROLLOUTS)
        parts = [self._program(inputs[tile], {name: one[tile] for name, one in memory.items()}) for tile in rows]
        return jax.tree.map(lambda *every: np.concatenate(every)[:n].astype(float), *parts)


class ControllerBatch:
    """The controllers of n rollouts, evaluated tile by tile.

    The last tile is filled up with copies of the last rollout.

    Args:
        programs: The controller's functions.
        policy_inputs: What controllers receive, one row for each rollout.
        n: Number of rollouts.
        on_gpu: Whether tiles are evaluated on a GPU, where states and controls then stay.
    """

    def __init__(self, programs: ControllerPrograms, policy_inputs: Mapping[str, Any], n: int, on_gpu: bool = False):
        self._programs, self._n, self._on_gpu = programs, n, on_gpu
        self._tile = programs.gpu_tiles if on_gpu else programs.tiles
        size = self._tile.rollouts
        self._rows = np.minimum(np.arange(-(-n // size) * size), n - 1).reshape(-1, size)
        self._given = [jax.device_put(jax.tree.map(lambda x, r=r: np.asarray(x)[r], policy_inputs)) for r in self._rows]
        self._tick, self._period = 0, programs.period
        starts, self._carried, durations = zip(
            *self._call(lambda: list(map(self._tile.first, self._given))), strict=True
        )
        self.start, self.duration = self._joined(starts), self._joined(durations)

    def begin_rollouts(self, observable: np.ndarray, ticks: np.ndarray) -> None:
        """Begin n rollouts from the model's states (n, s), for numbers of ticks (n,)."""
        self._carried = self._of_tiles(self._tile.enter, observable, ticks.astype(np.int32))

    def next_controls(self, observable: Any) -> Any:
        """Return the controls (n, nu) of the next tick, from the model's states (n, s).

        On a GPU both are arrays of the GPU, and controls are returned before they are computed.
        """
        self._tick += 1
        parts, self._carried = zip(
            *self._of_tiles(self._tile.tick, observable, is_waiting=not self._on_gpu), strict=True
        )
        if self._on_gpu:
            return _join_tiles(parts, self._n)
        return self._joined([self._programs.compute_controls(one, self._when) for one in parts])

    def read_observations_and_actions(self, slots: Any) -> np.ndarray:
        """Return observation and action (slots, k) of a neural policy in the last tick; k = 0 for others."""
        learned, slots = self._programs.learned, np.asarray(slots, int)
        if learned is None:
            return np.zeros((len(slots), 0))
        tiles, places = np.divmod(slots, self._tile.rollouts)
        latest = {
            tile: np.concatenate(learned.latest_observation_and_action(self._carried[tile]["state"]), axis=1)
            for tile in np.unique(tiles)
        }
        return np.stack([latest[tile][place] for tile, place in zip(tiles, places, strict=True)]).astype(float)

    def compute_rollout_metrics(self, observable: np.ndarray) -> dict[str, np.ndarray]:
        """Return the controllers' own metrics (n,), by name, from the model's last states (n, s)."""
        parts = self._of_tiles(self._tile.finish, observable)
        return {name: self._joined([one[name] for one in parts]) for name in parts[0]}

    @property
    def _when(self) -> str:
        return f" in tick {self._tick} ({(self._tick - 1) * self._period:.4g} s)" if self._tick else ""

    def _call(self, function: Callable[[], Any]) -> Any:
        """Wait for the results of compiled programs, so that their errors are raised here."""
        return self._programs.call_compiled_program(function, when=self._when)

    def _of_tiles(self, program: Callable[..., Any], *more: Any, is_waiting: bool = True) -> list[Any]:
        """Call a program for each tile with its inputs, its carried state and its rows of `more`."""
        if self._on_gpu:
            split = [_split_into_tiles(one, self._tile.rollouts) for one in more]
        else:
            split = [[one[rows] for rows in self._rows] for one in map(np.asarray, more)]
        each = zip(self._given, self._carried, *split, strict=True)

        def call() -> list[Any]:
            return [program(*of_tile) for of_tile in each]

        return self._call(call) if is_waiting else self._programs.call_user_code(call, when=self._when, is_own=False)

    def _joined(self, parts: Sequence[Any]) -> Any:
        return None if parts[0] is None else np.concatenate([np.asarray(one) for one in parts])[: self._n].astype(float)


@partial(jax.jit, static_argnums=1)
def _split_into_tiles(values: Array, size: int) -> list[Array]:
    """Tiles (size, ...) of an array (n, ...); copies of its last row fill the last one."""
    missing = -len(values) % size
    rows = jnp.pad(values, ((0, missing), *[(0, 0)] * (values.ndim - 1)), mode="edge")
    return [*rows.reshape(-1, size, *values.shape[1:])]


@partial(jax.jit, static_argnums=1)
def _join_tiles(tiles: Sequence[Array], n: int) -> Array:
    """First n rows of all tiles."""
    return jnp.concatenate(tiles)[:n]

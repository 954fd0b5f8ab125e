"""A user model on MJX: controllers, physics and metrics of a tick in one program of XLA's, on a CPU or a GPU.

Its physics is JAX, or MuJoCo Warp's kernels in the same program: the engine `warp`, which is meant for NVIDIA's GPUs.

What follows from varied numbers is worked out by C MuJoCo: every field in which its models differ is a leaf of MJX's
model with a row for each rollout.
"""

import io
import warnings
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager, redirect_stdout
from copy import copy
from importlib.util import find_spec
from typing import Any

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from jaxtyping import Array

from sweep.backends import devices, mujoco_versions
from sweep.contract.engine import Metrics, TimeSeriesRequest
from sweep.contract.engine_settings import EngineSettings
from sweep.core.constants import GRAVITY
from sweep.core.errors import InputError
from sweep.core.user_code import report_slow_call
from sweep.systems.mujoco_model import batch, disturbances, fields, terrain
from sweep.systems.mujoco_model.actuator_networks import compute_torques
from sweep.systems.mujoco_model.engine import (
    TICKS_PER_CALL,
    BatchResult,
    ModelEngine,
    TickSample,
    TickStepper,
    find_unconverged_steps,
    print_note_once,
)
from sweep.systems.mujoco_model.geom_pairs import find_geom_pairs
from sweep.systems.mujoco_model.metrics.unsolved import BALANCE_FIELDS, find_unbalanced_steps
from sweep.systems.mujoco_model.model_spec import ModelSpec, ParameterOverrides
from sweep.systems.mujoco_model.tick import STEP_FIELDS

with redirect_stdout(io.StringIO()):  # it prints which of its parts are not installed
    from mujoco import mjx

CARRIED_FIELDS = "qpos", "qvel", "act", "qacc_warmstart", "time"  # of its data, from step to step
COMPARED_TICKS = 3  # ticks that are compared with C MuJoCo's
MAX_ACCELERATION_DIFFERENCE = (
    0.1  # difference of an acceleration, over the largest of all joints, from which the engines disagree
)
# likewise on a terrain, where MuJoCo and MJX make contacts with different cells: that of gravity
LITTLE_ON_TERRAIN = GRAVITY
ROUNDING_ACCELERATION = 1e-3  # acceleration (m/s^2, rad/s^2) below which rounding is all there is
TRACE_NOTE_AFTER_S = 3.0  # s, until what MJX traces is told
FRICTION_LOSS_FIELDS = "dof_frictionloss", "tendon_frictionloss"
# by whether they are 0
PROGRAM_SHAPING_FIELDS = (
    *FRICTION_LOSS_FIELDS,
    "opt.density",
    "opt.viscosity",
    "opt.wind",
    "body_gravcomp",
    "geom_margin",
    "pair_margin",
)
MIN_FRICTION_LOSS = 1e-9  # where a program has friction, MJX takes a joint with none for one that is held
# what MJX may leave out in silence, by the words for it: all that varies, and what is no axis
SILENTLY_IGNORED_FIELDS = {
    f"{kind}.{name}": one.field for kind, words in fields.VARIABLE_NUMBERS.items() for name, one in words.items()
} | {
    "option.noslip_iterations": "opt.noslip_iterations",
    "actuator.delay": "actuator_delay",
    "sensor.delay": "sensor_delay",
    **mujoco_versions.YIELDING_SPRING_FIELDS,
}
# of this what it has a field for and makes no use of: of delays the history is not carried on
UNUSED_FIELDS = {
    "jax": ("jnt_stiffnesspoly", "tendon_stiffnesspoly", "dof_dampingpoly", "tendon_dampingpoly", "geom_fluid"),
    "warp": ("actuator_delay", "sensor_delay"),
}
WARP_CONTACTS_PER_ROLLOUT, WARP_CONSTRAINTS_PER_CONTACT = (
    64,
    4,
)  # warp's room for a rollout, and of a contact; a rollout with more is invalid
ALTERNATIVES = {  # by a part of what MJX says
    "collisions not implemented": "other shapes, or geoms that do not collide",
    "mjINT": "model.option.integrator=implicitfast or Euler",
    "mjSOL": "model.option.solver=Newton or CG",
    "mjENBL": "no such flag in its file",
    "fluid drag": "model.option.integrator=Euler",
    "Contact sensor": "other sensors",
}


class MjxModelEngine(ModelEngine):
    """Engine that simulates user models on MJX. Raises `InputError` for models that MJX cannot simulate fully."""

    dynamics = "mjx"

    def __init__(self, spec: ModelSpec, settings: EngineSettings):
        self._impl = "warp" if settings.name == "warp" else "jax"  # as MJX calls it
        if (warp := self._impl == "warp") and find_spec("warp") is None:
            how = "pip install 'insect-sweep[warp]'"
            raise InputError(f"engine.name = warp is not allowed: it needs NVIDIA Warp: {how}")
        if warp and settings.precision != "float32":
            raise InputError(f"engine.precision = {settings.precision} is not allowed: warp computes in float32")
        super().__init__(spec, settings)
        pairs, geoms = len(find_geom_pairs(self._model)), self._model.ngeom
        size = f"{self._model.nv} degrees of freedom, {pairs} pairs of {geoms} geoms that may touch"
        self._about = f"{spec.config.mjcf} ({size})"
        self._limited = [] if warp else find_capped_contact_dims(self._model)
        self._compared = False  # with C MuJoCo
        self._placed: dict[Any, tuple[Any, Any]] = {}  # MJX's model and data of a batch's shape
        if spec.controller.is_batched:
            raise self._refusal("it cannot compile a NumPy controller", "one of JAX's, ")
        with (
            self._within(),
            report_slow_call(f"{settings.name}, which traces {self._about},", after=TRACE_NOTE_AFTER_S),
        ):
            self._check()
        self._first, self._enter, self._finish = self._programs.compile_for_batches()
        self._ticks = jax.jit(self._run_ticks, donate_argnums=2)

    def describe_differences_from_mujoco(self) -> Iterator[str]:
        """Describe the known differences of MJX from C MuJoCo for this model, a line each."""
        model = self._model
        if model.nplugin:
            yield f"{self._settings.name} ignores the model's plugins, C MuJoCo does not"
        damped = model.actuator_biasprm[:, 2] != 0
        bounded = (model.actuator_forcelimited | model.actuator_ctrllimited).astype(bool)
        fast = self._impl == "jax" and model.opt.integrator == int(mujoco.mjtIntegrator.mjINT_IMPLICITFAST)
        if fast and (damped & bounded).any():
            alike = "the two agree with model.option.integrator=Euler"
            yield f"mjx damps actuators at a limit in an implicitfast step, C MuJoCo does not: {alike}"
        if self._impl == "warp":
            yield "on a GPU warp gives different last bits each time, replays included; use native for exact replays"
            return
        if (model.tendon_armature[model.tendon_num > 1] != 0).any():
            yield "mjx simulates armature of tendons between branches of a body, C MuJoCo does not: results may differ"
        if custom_numeric(model, "max_geom_pairs") is not None:
            yield "mjx ignores contacts beyond the model's max_geom_pairs and does not report which rollouts have more"

    def _check(self) -> None:
        """Raise `InputError` where it cannot simulate the model, or would leave a part of it out without a word."""
        template = self._template(self._model)
        parts = template, template._impl, template.opt, getattr(template.opt, "_impl", None)
        has = {name for part in parts if part for name in vars(part)}.difference(UNUSED_FIELDS[self._impl])
        for what, name in SILENTLY_IGNORED_FIELDS.items():
            if name.removeprefix("opt.") not in has and np.any(fields.field_values(self._model, name)):
                raise self._refusal(f"MJX leaves out {what}", "a model without, ")
        needs_forces = (self._model.sensor_needstage == int(mujoco.mjtStage.mjSTAGE_ACC)).any()
        if self._impl == "jax" and needs_forces and not mjx.make_data(self._model)._impl.efc_J.size:
            why = "MJX computes no sensors of forces and accelerations for a model without contacts and limits"
            raise self._refusal(why, "a geom that may touch another, ")

    def _template(self, model: mujoco.MjModel) -> Any:
        """MJX's model. Raises `InputError` where it cannot simulate it."""
        try:
            with self._warnings_as_note():
                template, data = mjx.put_model(model, impl=self._impl), mujoco.MjData(model)
                if self._impl == "jax":
                    jax.eval_shape(mjx.step, template, mjx.put_data(model, data))
        except (NotImplementedError, ValueError) as error:
            said = " ".join(str(error).split())
            instead = next((words for part, words in ALTERNATIVES.items() if part in said), "")
            raise self._refusal(f"MJX has no {said.rstrip('.')}", f"{instead}, " if instead else "") from None
        return template

    @contextmanager
    def _warnings_as_note(self) -> Iterator[None]:
        """Say all that MJX warns of within this context in one line, once."""
        with warnings.catch_warnings(record=True, action="always") as caught:
            yield
        if said := list(dict.fromkeys(" ".join(str(one.message).split()) for one in caught)):
            more = f" (and {len(said) - 1} more)" if len(said) > 1 else ""
            print_note_once(f"{self._settings.name} warns of {self._spec.config.mjcf}: {said[0]}{more}")

    def _refusal(self, why: str, instead: str) -> InputError:
        """One line, of what is to be changed."""
        return InputError(f"engine.name = {self._settings.name} is not allowed: {why} ({instead}or engine=native)")

    def check_varied_parameters(self, paths: Iterable[str]) -> Iterable[str]:
        """Raise `InputError` for parameters that MJX cannot vary within a batch; return warnings, one line each."""
        grounds, paths = ([path for path in paths if terrain.is_terrain_path(path) == one] for one in (True, False))
        if grounds and self._impl == "warp":
            raise self._refusal(f"Warp has one terrain for all rollouts, which {grounds[0]} varies", "engine=mjx, ")
        written = [
            (path, place.field) for path in paths for place in fields.resolve_parameter_path(self._model, path)[1]
        ]
        template = self._template(
            enable_used_features(self._model, {name: 1.0 for _, name in written if name in PROGRAM_SHAPING_FIELDS})
        )
        for path, name in written:
            if name in UNUSED_FIELDS[self._impl] or not hasattr(find_model_array(template, name), "at"):
                raise self._refusal(f"MJX has no {name.removeprefix('opt.')}, which {path} varies", "other axes, ")
        return self.describe_differences_from_mujoco()

    def run(self, world: ParameterOverrides, belief: ParameterOverrides, streams: np.ndarray) -> Metrics:
        """Simulate a batch and return its metrics. The first batch is first compared with C MuJoCo."""
        self._cross_check(world, belief, streams)
        return super().run(world, belief, streams)

    def run_with_time_series(
        self,
        world: ParameterOverrides,
        belief: ParameterOverrides,
        streams: np.ndarray,
        slots: np.ndarray,
        watch: TimeSeriesRequest,
    ) -> tuple[Metrics, np.ndarray]:
        """Simulate a batch; return metrics and columns over time. The first batch is first compared with C MuJoCo."""
        self._cross_check(world, belief, streams)
        return super().run_with_time_series(world, belief, streams, slots, watch)

    @devices.convert_memory_errors()
    def _cross_check(self, world: ParameterOverrides, belief: ParameterOverrides, streams: np.ndarray) -> None:
        """Compare the first control ticks of three rollouts with C MuJoCo; raise `InputError` where they differ.

        The rollouts are the nominal one, in the first row's place, and two of the batch. Both engines go through
        every tick from the same state with the same controls. The batch's compiled program is used, so that nothing
        more is compiled. Ticks in which C MuJoCo leaves a step unsolved do not count. `engine.cross_check=off` leaves
        it out.
        """
        if self._compared or not self._settings.cross_check:
            return
        spec, rows = self._spec, sorted({0, len(streams) // 2, len(streams) - 1})
        world, belief = (ParameterOverrides(tuple((path, self._nominal_first(path, x)) for path, x in one.values))
                         for one in (world, belief))  # fmt: skip
        few = [
            ParameterOverrides(tuple((path, x[rows] if np.ndim(x) else x) for path, x in one.values))
            for one in (world, belief)
        ]
        with self._within():
            reference = batch.make_initial_batch(spec, self._settings, few[0], few[1], streams[rows])
            activation = reference.batch.bind("act")
            _, fixed, carry, _, _ = self._start(world, belief, streams)
            stepper = TickStepper(spec, reference, self._shares)
            for tick in range(COMPARED_TICKS):
                qpos, qvel, act = (
                    np.asarray(carry["sim_state"][name], float)[rows] for name in ("qpos", "qvel", "act")
                )
                reference.qpos[:], reference.qvel[:], activation[:] = qpos, qvel, act
                carry = self._advance(fixed, tick, 1, carry)
                ctrl = np.asarray(carry["ctrl"], float)[rows]
                steps = stepper.advance(ctrl)
                ends = np.asarray(carry["sim_state"]["qvel"], float)[rows], np.asarray(steps["qvel"][:, -1], float)
                solved = ~find_unconverged_steps(self._model, steps).any(
                    axis=1
                )  # else the solver's error is what differs
                self._compare(tick, *(((end - qvel) / spec.config.period)[solved] for end in ends))
        self._compared = True

    def _nominal_first(self, path: str, values: Any) -> Any:
        """Values of a parameter over a batch, with the nominal one for the first rollout."""
        if not np.ndim(values):
            return values
        values = np.array(values)
        values[0] = self._spec.nominal_value(path)
        return values

    def _compare(self, tick: int, here: np.ndarray, there: np.ndarray) -> None:
        """Raise `InputError` where mean accelerations (r, nv) of a tick differ from those of C MuJoCo, `there`."""
        size = np.maximum(np.abs(here), np.abs(there)).max(axis=1, initial=0.0, keepdims=True)
        least = LITTLE_ON_TERRAIN if self._spec.config.terrain else ROUNDING_ACCELERATION
        off = np.where(np.isfinite(there), np.abs(here - there), 0.0) / np.maximum(size, least)
        if not off.size or (np.nanmax(off) <= MAX_ACCELERATION_DIFFERENCE and not np.isnan(off).any()):
            return
        row, dof = np.unravel_index(np.argmax(np.nan_to_num(off, nan=np.inf)), off.shape)
        joint = int(self._model.dof_jntid[dof])
        name = self._model.joint(joint).name or f"number {joint}"
        raise InputError(
            f"engine.name = {self._settings.name} is not allowed: joint {name} accelerates by {here[row, dof]:.4g} in "
            f"tick {tick + 1} and by {there[row, dof]:.4g} on C MuJoCo, from the same state with the same controls "
            "(engine=native, or engine.cross_check=off to skip this check)"
        )

    @devices.convert_memory_errors()
    def _simulate(
        self,
        world: ParameterOverrides,
        belief: ParameterOverrides,
        streams: np.ndarray,
        slots: Any = (),
        every: int = 1,
    ) -> BatchResult:
        spec, frames = self._spec, []
        with self._within():
            begun, fixed, carry, ticks, at_first = self._start(world, belief, streams)
            policy_inputs = fixed[3]
            longest, chunk = int(ticks.max(initial=0)), every if len(slots) else TICKS_PER_CALL
            for k in range(0, longest, chunk):
                carry = self._advance(fixed, k, min(chunk, longest - k), carry)
                if len(slots) and k + every <= longest:
                    last = carry["ctrl"], carry["sim_state"]["qpos"], carry["sim_state"]["qvel"], carry["force"]
                    states, policy = (np.asarray(x)[slots] for x in last), self._read_policy(carry["carried"], slots)
                    frames.append(TickSample((k + every) * spec.config.period, *states, policy=policy))
            measured = self._programs.call_compiled_program(
                self._finish, policy_inputs, carry["carried"], carry["seen"]
            )
        measured = {name: np.asarray(values, float) for name, values in measured.items()}
        last = jax.tree.map(np.asarray, carry["metric_state"])
        wrong, full = (np.asarray(carry[name]) for name in ("wrong", "full"))
        gained = begun.energy(last.last_qpos, last.last_qvel) - at_first
        found = self._meter.compute(last, begun.mass, gained, wrong, full) | measured
        return found, frames, [begun.get_model(int(slot)) for slot in slots]

    def _read_policy(self, carried: Mapping[str, Any], slots: Any) -> np.ndarray:
        """What learned policies saw and did in the latest tick, (slots, k); k is 0 for other controllers."""
        if self._programs.learned is None:
            return np.zeros((len(slots), 0))
        found = self._programs.learned.latest_observation_and_action(carried["state"])
        return np.concatenate([np.asarray(one, float)[np.asarray(slots)] for one in found], axis=1)

    def _start(
        self, world: ParameterOverrides, belief: ParameterOverrides, streams: np.ndarray
    ) -> tuple[batch.InitialBatch, tuple[Any, ...], dict[str, Any], np.ndarray, np.ndarray]:
        """A batch before its first tick: rollouts, what `_ticked` has fixed and carries, ticks (n,), energy (n,) in J.

        To be called in the engine's precision.
        """
        spec, n = self._spec, len(streams)
        print_note_once(f"{self._settings.name} compiles {self._about}")
        begun = batch.make_initial_batch(spec, self._settings, world, belief, streams)
        policy_inputs = jax.device_put(begun.policy_inputs)
        start, state, duration = self._programs.call_compiled_program(self._first, policy_inputs)
        at_first = begun.set_initial_state(start)
        seen = jnp.asarray(spec.observable_state(begun.qpos, begun.qvel, begun.sensors), float)
        ticks = batch.count_ticks(spec, duration)
        template, data, leaves = self._put(begun)
        sim_state = {
            name: jnp.broadcast_to(getattr(data, name), (n, *getattr(data, name).shape)) for name in CARRIED_FIELDS
        }
        sim_state |= {"qpos": jnp.asarray(begun.qpos, float), "qvel": jnp.asarray(begun.qvel, float)}
        carry = {
            "sim_state": sim_state,
            "metric_state": self._meter.start(sim_state["qpos"], sim_state["qvel"]),
            "carried": self._programs.call_compiled_program(
                self._enter, policy_inputs, state, seen, ticks.astype(np.int32)
            ),
            "seen": seen,
            "wrong": jnp.zeros(n, bool),
            "full": jnp.zeros(n, bool),
            "ctrl": jnp.full((n, self._model.nu), jnp.nan, float),  # of the tick before, none at first
            "force": jnp.zeros((n, self._model.nu)),
            "acting": self._start_acting(n),
        }
        carry = jax.tree.map(jnp.copy, carry)  # its buffers are given away, and some are there twice
        carry = jax.device_put(carry, data.qpos.sharding)  # as later carries are: else JAX compiles for both
        limits = {name: jnp.asarray(rows, float) for name, rows in begun.limits.items()}
        acting = jax.tree.map(lambda one: jnp.asarray(one, float if one.dtype.kind == "f" else int), begun.acting)
        return begun, (template, data, leaves, policy_inputs, limits, acting), carry, ticks, at_first

    def _start_acting(self, n: int) -> dict[str, Any]:
        """What pushes and delays of commands carry from step to step at first: nothing where there are none."""
        spec, found = self._spec, {}
        if spec.action_buffer:
            found["past"] = jnp.full((n, spec.action_buffer, self._model.nu), jnp.nan, float)  # of the steps before
        if len(spec.pushed_bodies):
            found["wrench"] = jnp.zeros((n, self._model.nbody, 6))  # in the last step
            # of the bodies, as the last two steps began
            found["places"] = jnp.full((n, 2, len(spec.pushed_bodies), 3), jnp.nan, float)
        if spec.actuator_networks:
            found["networks"] = jax.tree.map(jnp.asarray, [one.begin(n) for one in spec.actuator_networks])
        if spec.action_buffer or spec.controller.joint_control or spec.motor_law:
            found["controls"] = jnp.zeros((n, self._model.nu))  # in the last step
        return found

    def _advance(self, fixed: tuple[Any, ...], first: int, count: int, carry: Mapping[str, Any]) -> dict[str, Any]:
        """What goes on after `count` more ticks from the tick `first` on, see `_run_ticks`."""
        last = first + count
        when = f" in tick {last}" if count == 1 else f" in ticks {first + 1} to {last}"
        return self._programs.call_compiled_program(self._ticks, fixed, count, carry, when=when)

    def _put(self, begun: batch.InitialBatch) -> tuple[Any, Any, dict[str, Array]]:
        """MJX's model, its data at the keyframe, and the fields in which the rollouts' models differ, (n, ...)."""
        n, rows = begun.batch.nsim, batch.varied_model_fields(begun)
        most = {name: np.abs(rows[name]).max(axis=0) for name in PROGRAM_SHAPING_FIELDS if name in rows}
        shape = n, *((name, values.tobytes()) for name, values in most.items())
        ground = begun.ground
        shared = ground.height_data[0] if ground and not ground.varies else None
        if shared is not None:
            shape = *shape, shared.tobytes()
        if shape not in self._placed:  # on the device; the last is kept, which mostly is the next one
            model = enable_used_features(self._model, most)
            if shared is not None:
                model.hfield_data[terrain.height_data_slice(model)] = shared
            data = mujoco.MjData(model)
            if self._spec.keyframe_index >= 0:
                mujoco.mj_resetDataKeyframe(model, data, self._spec.keyframe_index)
            rooms = warp_buffer_sizes(model, n) if self._impl == "warp" else {}
            with self._warnings_as_note():
                placed = mjx.put_model(model, impl=self._impl), mjx.put_data(model, data, impl=self._impl, **rooms)
            self._placed = {shape: placed}
        template, data = self._placed[shape]
        leaves = {}
        for name, values in rows.items():
            values = np.maximum(values, MIN_FRICTION_LOSS) if name in FRICTION_LOSS_FIELDS else values
            if hasattr(
                one := find_model_array(template, name), "at"
            ):  # others it works out itself, or `check` refuses them
                leaves[name] = jnp.asarray(values.reshape(n, *one.shape), float)
        if ground and ground.varies:
            rows = np.tile(self._model.hfield_data, (n, 1))
            rows[:, terrain.height_data_slice(self._model)] = ground.height_data[ground.which]
            leaves["hfield_data"] = jnp.asarray(rows, float)
        return template, data, leaves

    def _run_ticks(self, fixed: tuple[Any, ...], count: Array, carry: Mapping[str, Any]) -> dict[str, Any]:
        """What goes on after `count` more ticks: states, figures, and controls and forces (n, nu) of the last one.

        What is `fixed` are MJX's model and data, leaves by row, what controllers are given, limits (n, ..., 2), and
        pushes and delays of commands.
        """
        template, data, leaves, policy_inputs, limits, acting = fixed
        bodies, time_step, law = self._spec.pushed_bodies, self._model.opt.timestep, self._spec.controller.joint_control
        motor_law, networks = self._spec.motor_law, self._spec.actuator_networks
        evaluations = [jax.vmap(one.load_torque_function()) for one in networks]

        def inputs(ctrl: Array, wrench: Array | None) -> dict[str, Array]:
            return {"ctrl": ctrl} if wrench is None else {"ctrl": ctrl, "xfrc_applied": wrench}

        def one(rows: Mapping[str, Array], sim_state: Mapping[str, Array], ctrl: Array, wrench: Any) -> tuple[Any, Any]:
            model = template.tree_replace(rows)
            after = mjx.step(model, data.replace(**sim_state, **inputs(ctrl, wrench)))
            internal = {"actuator_velocity": after._impl}
            told = {name: getattr(internal.get(name, after), name) for name in STEP_FIELDS}
            if wrench is not None:
                told["places"] = after.xipos[bodies]  # as the step began
            told["full"], told["unsolved"] = self._invalid_flags(model, after)
            told["seen"] = self._read_sensors(after)
            return {name: getattr(after, name).astype(sim_state[name].dtype) for name in CARRIED_FIELDS}, told

        def current(rows: Mapping[str, Array], sim_state: Mapping[str, Array], ctrl: Array, wrench: Any) -> Array:
            model = template.tree_replace(rows)
            return self._read_sensors(mjx.forward(model, data.replace(**sim_state, **inputs(ctrl, wrench))))

        def tick(carry: Mapping[str, Any]) -> dict[str, Any]:
            going = carry["carried"]["tick"] < carry["carried"]["ticks"]
            ctrl, carried = jax.vmap(self._programs.tick_controller)(policy_inputs, carry["carried"], carry["seen"])
            wrong = carry["wrong"] | going & ~jnp.isfinite(ctrl).all(axis=1)
            ctrl = jnp.nan_to_num(ctrl)
            before = jnp.where(jnp.isnan(carry["ctrl"]), ctrl, carry["ctrl"])
            shares, extra, late = jnp.asarray(self._shares, float), dict(carry["acting"]), None
            if "past" in extra:
                past = jnp.where(jnp.isnan(extra["past"]), ctrl[:, None], extra["past"])
                commands = before[:, None] + shares[:, None] * (ctrl - before)[:, None]
                late, extra["past"] = disturbances.delay_commands(past, commands, acting.delay)
                late = jnp.moveaxis(late, 1, 0)
            first_step = carry["carried"]["tick"] * len(self._shares)

            def step(state: Any, given_step: Any) -> tuple[Any, None]:
                sim_state, metric_state, full, extra, _ = state
                (share, number, command), extra = given_step, dict(extra)
                command = before + share * (ctrl - before) if command is None else command
                before_step = sim_state["qpos"], sim_state["qvel"]
                controls = command if law is None else law.controls(command, *before_step)
                torques = None
                if networks:
                    given = networks, evaluations, extra["networks"], command
                    torques, extra["networks"] = compute_torques(*given, *before_step)
                if motor_law is not None:
                    controls = motor_law.controls(controls, *before_step, acting.motors, torques)
                wrench = None
                if len(bodies):
                    forces = acting.mean_push_forces(first_step + number, 1, time_step)[:, 0]
                    wrench = jnp.zeros_like(extra["wrench"]).at[:, bodies, :3].add(forces)
                sim_state, told = jax.vmap(one)(leaves, sim_state, controls, wrench)
                if wrench is not None:
                    places = told.pop("places")
                    last = jnp.where(jnp.isnan(extra["places"]), places[:, None], extra["places"])
                    way = (places - last[:, 0]) / 2  # at the mean of the speeds before and after a step
                    told["push_work"] = (extra["wrench"][:, bodies, :3] * way).sum(axis=(1, 2))
                    extra |= {"wrench": wrench, "places": jnp.stack([last[:, 1], places], axis=1)}
                if "controls" in extra:
                    extra["controls"] = controls
                full = full | going & told.pop("full")
                work, seen = {name: told.pop(name) for name in ("push_work",) if name in told}, told.pop("seen")
                steps = {name: values[:, None] for name, values in told.items()}
                metric_state = self._meter.update(metric_state, {**steps, **work}, limits, going)
                return (sim_state, metric_state, full, extra, (seen, told["actuator_force"])), None

            none = jnp.zeros((len(ctrl), self._model.nsensordata + sum(self._spec.data_sizes.values()))), carry["force"]
            first = carry["sim_state"], carry["metric_state"], carry["full"], extra, none
            each = shares, jnp.arange(len(self._shares)), late
            (sim_state, metric_state, full, extra, (sensors, force)), _ = jax.lax.scan(step, first, each)
            if self._spec.config.sensors == "current":
                sensors = jax.vmap(current)(leaves, sim_state, extra.get("controls", ctrl), extra.get("wrench"))
            seen = self._spec.observable_state(sim_state["qpos"], sim_state["qvel"], sensors)
            new = {
                "sim_state": sim_state,
                "metric_state": metric_state,
                "carried": carried,
                "seen": seen,
                "acting": extra,
            }
            return new | {"wrong": wrong, "full": full, "ctrl": ctrl, "force": force}

        return jax.lax.fori_loop(0, count, lambda _, carry: tick(carry), carry)

    def _read_sensors(self, data: Any) -> Array:
        """Sensor values of a rollout, and the arrays of mjData that controllers read, (k,)."""
        arrays = [self._read_array(data, name).reshape(-1) for name in self._spec.config.data]
        return jnp.concatenate([data.sensordata, *arrays]) if arrays else data.sensordata

    def _read_array(self, data: Any, name: str) -> Array:
        """An array of MJX's data, or of its engine's part. Raises `InputError` where it has none."""
        owner = next((one for one in (data, data._impl) if name in vars(one)), None)
        if owner is None:
            raise self._refusal(f"MJX has no {name}, which model.data lists", "other arrays, ")
        return getattr(owner, name)

    def _invalid_flags(self, model: Any, data: Any) -> tuple[Array, Array]:
        """Whether a step of MJX's model was short of room, and whether it is unsolved."""
        if self._impl == "warp":
            from mujoco.mjx.third_party.mujoco_warp import OverflowType

            lacking = OverflowType.ALL & ~OverflowType.ITERATIONS & ~OverflowType.LS_ITERATIONS
            full = jnp.any(data._impl.overflow & int(lacking) > 0)
            return full, jnp.max(data._impl.solver_niter) >= self._model.opt.iterations
        contact, forces = data._impl.contact, (getattr(data, name) for name in BALANCE_FIELDS)
        near = contact.dist < contact.includemargin
        full = jnp.array([False, *(near[np.asarray(contact.dim) == dim].all() for dim in self._limited)]).any()
        return full, find_unbalanced_steps(mjx.full_m(model, data), *forces)


def custom_numeric(model: mujoco.MjModel, name: str) -> np.ndarray | None:
    """Return a custom numeric of a MuJoCo model by name, as a writable view; None if it has none."""
    number = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_NUMERIC, name)
    return None if number < 0 else model.numeric_data[model.numeric_adr[number] :][:1]


def find_capped_contact_dims(model: mujoco.MjModel) -> list[int]:
    """Return the contact dimensions (condim) for which MJX may drop contacts because of `max_contact_points`."""
    whole = copy(model)
    if (most := custom_numeric(whole, "max_contact_points")) is None:
        return []
    room, most[:] = int(most[0]), -1
    dims, counts = np.unique(mjx.make_data(whole)._impl.contact.dim, return_counts=True)
    return [int(dim) for dim, count in zip(dims, counts, strict=True) if 0 <= room < count]


def find_model_array(model: Any, name: str) -> Any:
    """Return the array of an MJX model for a field named as in `mujoco.batch`; None where MJX lacks the field."""
    owner, name = fields.locate_field(model, name)
    return vars(owner).get(name)


def enable_used_features(model: mujoco.MjModel, most: Mapping[str, Any]) -> mujoco.MjModel:
    """Return a copy of a model with nonzero values for all features that a batch uses, so that MJX compiles them.

    Args:
        model: The model.
        most: Largest absolute values over the batch, by field.
    """
    model = copy(model)
    for name, values in most.items():
        setattr(*fields.locate_field(model, name), np.broadcast_to(values, fields.field_values(model, name).shape))
    model.flg_gravcomp |= "body_gravcomp" in most
    return model


def warp_buffer_sizes(model: mujoco.MjModel, n: int) -> dict[str, int]:
    """Return the sizes of Warp's buffers for n rollouts: contacts of all rollouts, and constraints of each."""
    return {
        "naconmax": WARP_CONTACTS_PER_ROLLOUT * n,
        "njmax": WARP_CONSTRAINTS_PER_CONTACT * WARP_CONTACTS_PER_ROLLOUT + model.njnt + 2 * model.nv,
    }

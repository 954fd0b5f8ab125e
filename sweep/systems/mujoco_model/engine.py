"""Base class of engines for user models, and the engine on C MuJoCo.

That is a batch of models on all cores, each rollout with fields of its own; bits depend neither on threads nor on how
many rollouts share a batch.
"""

import sys
from collections.abc import Iterable, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from functools import cache
from typing import Any, NamedTuple

import mujoco
import numpy as np
from mujoco.batch import SimulationError

from sweep.backends import devices
from sweep.contract.engine import (
    Metrics,
    Push,
    SideMaker,
    TimeSeriesRequest,
    Trace,
    count_substeps,
    hinge_and_slide_joints,
)
from sweep.contract.engine_settings import EngineSettings
from sweep.core.errors import InputError
from sweep.fused.dependence import find_inactive_parameters
from sweep.systems.mujoco_model import batch
from sweep.systems.mujoco_model.accumulator import MetricAccumulator, ModelMetricStates
from sweep.systems.mujoco_model.actuator_networks import compute_torques
from sweep.systems.mujoco_model.disturbances import delay_commands
from sweep.systems.mujoco_model.metrics.unsolved import BALANCE_FIELDS, find_unbalanced_steps
from sweep.systems.mujoco_model.model_spec import ModelSpec, ParameterOverrides
from sweep.systems.mujoco_model.policy import (
    ControllerBatch,
    ControllerPrograms,
    FirstTickEvaluation,
    TiledActuatorNetwork,
)
from sweep.systems.mujoco_model.tick import STEP_FIELDS

BUFFER_WARNINGS = [
    int(mujoco.mjtWarning.mjWARN_CONTACTFULL),
    int(mujoco.mjtWarning.mjWARN_CNSTRFULL),
]  # others are worse
TICKS_PER_CALL = 50  # ticks of a call of a compiled program, so that a command can be ended
ON_NATIVE = "on_native"  # column of `kernel`: 1 where C MuJoCo has simulated a rollout that the kernel could not
RECORDED_FIELDS = (*STEP_FIELDS, "solver_niter", "M", *BALANCE_FIELDS)


class TickSample(NamedTuple):
    """State and forces of some rollouts, recorded at the end of a control tick."""

    time: float
    ctrl: np.ndarray
    qpos: np.ndarray
    qvel: np.ndarray
    force: np.ndarray
    policy: np.ndarray  # what learned policies saw and did, (slots, k)


BatchResult = tuple[Metrics, list[TickSample], list[mujoco.MjModel]]  # of a batch; of some slots of it


@cache
def print_note_once(line: str) -> None:
    """Print a note for the user to standard error before a study starts; each text is printed only once."""
    print(f"sweep: note: {line}", file=sys.stderr)


class ModelEngine:
    """Base class of engines for user models; subclasses simulate the ticks."""

    stages: tuple[str, ...] = ("run",)  # there are no others
    dynamics: str
    devices = 1  # threads share it
    columns: tuple[str, ...] | None = None  # of the study's rows, where its models or controllers have others

    def __init__(self, spec: ModelSpec, settings: EngineSettings):
        devices.configure_jax()
        self._spec, self._settings, self._model = spec, settings, spec.model
        self.duration = spec.config.duration
        self.width = settings.width or (
            devices.CPU_WIDTH if settings.name == "native" else devices.default_batch_width()
        )
        period, step = spec.config.period, self._model.opt.timestep
        allowed = f"a multiple of {step:g} s, the model's time step"
        self._substeps = count_substeps(period, step, f"model.period = {period:g} is not allowed: {allowed}")
        ramp = (1 + np.arange(self._substeps)) / self._substeps  # what a command counts for, beside the one before
        self._shares = ramp if spec.config.command == "ramped" else np.ones(self._substeps)
        self._meter = MetricAccumulator(spec)
        belief = {name: np.dtype(settings.precision).type(value) for name, value in spec.believed_values({}).items()}
        with self._within():
            self._programs = ControllerPrograms(spec, belief)

    @contextmanager
    def _within(self) -> Iterator[None]:
        """The precision that JAX reckons in. Raises `InputError` where MuJoCo has no room for a step of the model."""
        try:
            devices.forget_constants_of_other_precision(self._settings.precision)
            with devices.precision_context(self._settings):
                yield
        except SimulationError as error:
            reason = " ".join(str(error).split())
            raise InputError(f"model.mjcf = {self._spec.config.mjcf} cannot be simulated: {reason}") from None

    def _start_nominal(self) -> batch.InitialBatch:
        world = batch.unperturbed_start_values(self._spec)
        return batch.make_initial_batch(self._spec, self._settings, world, ParameterOverrides(), np.zeros(1, np.int64))

    def check_first_controls(self) -> None:
        """Raise `InputError` where the controller's first controls are not finite at nominal values."""
        begun = self._start_nominal()
        with self._within():
            self._programs.check_first_controls(begun)

    def evaluate_first_tick(self) -> FirstTickEvaluation:
        """Return the controller's observations and commands at the nominal start. Raises `InputError`."""
        begun = self._start_nominal()
        with self._within():
            return self._programs.evaluate_first_tick(begun)

    def check_varied_parameters(self, paths: Iterable[str]) -> Iterable[str]:
        """Raise `InputError` if the engine cannot vary the parameters `paths` in a batch; return warning lines."""
        return ()

    def rollout_bytes(self) -> None:
        """Return None, since the memory that a rollout needs is unknown."""

    def find_inactive_parameters(self, sides: SideMaker, ends: Mapping[str, tuple[float, float]]) -> set[str]:
        """Return the parameter columns that the controller does not read; MuJoCo model columns count as read."""
        with self._within():
            return find_inactive_parameters(self._programs.rollout_outputs, sides, ends)

    def run(self, world: ParameterOverrides, belief: ParameterOverrides, streams: np.ndarray) -> Metrics:
        """Simulate a batch and return its metrics."""
        return self._simulate_columns(world, belief, streams)[0]

    def run_with_time_series(
        self,
        world: ParameterOverrides,
        belief: ParameterOverrides,
        streams: np.ndarray,
        slots: np.ndarray,
        watch: TimeSeriesRequest,
    ) -> tuple[Metrics, np.ndarray]:
        """Simulate a batch; return its metrics, and columns of some rollouts over time."""
        found, frames, _ = self._simulate_columns(world, belief, streams, slots, watch.every)
        columns = [self._spec.time_series_columns(frame.qpos, frame.qvel, frame.policy) for frame in frames]
        none = np.full(len(slots), np.nan)  # of a column that another model or controller of the study has
        samples = [np.stack([one.get(name, none) for name in watch.columns], axis=-1) for one in columns]
        return found, np.stack(samples) if samples else np.zeros((0, len(slots), len(watch.columns)))

    def trace(self, world: ParameterOverrides, belief: ParameterOverrides, streams: np.ndarray, slot: int) -> Trace:
        """Simulate a batch and record the states over time (trace) of the rollout at index `slot`."""
        return self.traces(world, belief, streams, 1, [slot])[0]

    def traces(
        self, world: ParameterOverrides, belief: ParameterOverrides, streams: np.ndarray, every: int, slots: Any = None
    ) -> list[Trace]:
        """Simulate a batch and record states over time (traces) of the rollouts at indices `slots` (default: all)."""
        slots = range(len(streams)) if slots is None else slots
        found, frames, models = self._simulate_columns(world, belief, streams, slots, every)
        if not frames:  # all rollouts end before the first one
            found, frames, models = self._simulate_columns(world, belief, streams, slots, 1)
        time, *recorded = (np.stack(values) for values in zip(*frames, strict=True))
        with self._within():
            acting = batch.make_batch_disturbances(self._spec, world, streams)
        traces = []
        for k, slot in enumerate(slots):
            row = {name: values[slot] for name, values in found.items()}
            within = time <= row["duration_s"] + self._spec.config.period / 2
            ctrl, qpos, qvel, force, policy = (values[within, k] for values in recorded)
            base, model, count = self._spec.base_qpos_address, models[k], int(within.sum())
            pose = np.tile([0.0, 0, 0, 1, 0, 0, 0], (count, 1)) if base is None else qpos[:, base : base + 7]
            moved = time[within], qpos, qvel, ctrl, force @ joint_moment_arms(model)
            none = np.zeros((count, 0, 3))  # of feet
            judged = np.zeros(count, int), np.full(count, np.nan), np.full(count, "")
            told = dict(zip(self._spec.policy_columns, policy.T, strict=True))
            rest = none, none, none, pose, *judged, self.stages, row
            pushed = zip(
                self._spec.pushed_bodies, acting.force[slot], acting.start[slot], acting.end[slot], strict=True
            )
            pushes = tuple(Push(int(body), *push) for body, *push in pushed)
            beside = {"columns": told, "groups": self._spec.policy_groups, "pushes": pushes}
            traces.append(Trace(world, belief, model, *moved, *rest, **beside))
        return traces

    def _simulate_columns(self, *batch_of_rollouts: Any) -> BatchResult:
        """See `_simulate`; with the columns that rows of the study have, NaN where the model has none of them."""
        found, frames, models = self._simulate(*batch_of_rollouts)
        if self.columns is not None:
            none = np.full(len(next(iter(found.values()))), np.nan)
            found = {name: found.get(name, none) for name in self.columns}
        return found, frames, models

    def _simulate(
        self,
        world: ParameterOverrides,
        belief: ParameterOverrides,
        streams: np.ndarray,
        slots: Any = (),
        every: int = 1,
    ) -> BatchResult:
        """Figures of a batch; of the rollouts in `slots` frames at one in `every` ticks, and their models."""
        raise NotImplementedError


def joint_moment_arms(model: mujoco.MjModel) -> np.ndarray:
    """Return the moment arms (nu, J) that turn actuator forces into torques of hinge and slide joints."""
    joints, kind = hinge_and_slide_joints(model), int(mujoco.mjtTrn.mjTRN_JOINT)
    driven = (model.actuator_trnid[:, :1] == joints) & (model.actuator_trntype[:, None] == kind)
    return driven * model.actuator_gear[:, :1]


class NativeModelEngine(ModelEngine):
    """Engine that simulates user models on C MuJoCo; results do not depend on the number of cores."""

    dynamics = "C MuJoCo"

    @contextmanager
    def _within(self) -> Iterator[None]:
        """See `OwnEngine`; and on the CPU, of which rows say that they are, beside a GPU too."""
        with super()._within(), devices.cpu_context():
            yield

    def _simulate(
        self,
        world: ParameterOverrides,
        belief: ParameterOverrides,
        streams: np.ndarray,
        slots: Any = (),
        every: int = 1,
    ) -> BatchResult:
        spec, n = self._spec, len(streams)
        # figures of a tick are worked out, on one core, while the next one is simulated on all of them
        with self._within(), ThreadPoolExecutor(1) as aside:
            begun = batch.make_initial_batch(spec, self._settings, world, belief, streams)
            qpos, qvel = begun.qpos, begun.qvel
            rollouts = ControllerBatch(self._programs, begun.policy_inputs, n)
            before_all = begun.set_initial_state(rollouts.start)
            ticks, seen = batch.count_ticks(spec, rollouts.duration), begun.sensors
            rollouts.begin_rollouts(spec.observable_state(qpos, qvel, seen), ticks)
            metric_state = aside.submit(self._meter.start, qpos.copy(), qvel.copy())

            def update_metrics(metric_state: Any, steps: Any, going: np.ndarray) -> ModelMetricStates:
                steps = {**steps, "unsolved": find_unconverged_steps(self._model, steps)}
                return self._meter.update(metric_state, steps, begun.limits, going)

            broken, frames = np.zeros(n, dtype=bool), []
            recorded: list[Any] = [None, None]  # of this tick and the one before
            stepper = TickStepper(spec, begun, self._shares)
            for k in range(int(ticks.max(initial=0))):
                going = k < ticks
                ctrl = rollouts.next_controls(spec.observable_state(qpos, qvel, seen))
                broken |= going & ~np.isfinite(ctrl).all(axis=1)
                ctrl = np.nan_to_num(ctrl)
                steps = recorded[k % 2] = stepper.advance(ctrl, recorded[k % 2])
                if spec.config.sensors == "current":
                    begun.refresh_sensors()
                seen = begun.sensors
                metric_state = aside.submit(update_metrics, metric_state.result(), steps, going)
                if len(slots) and (k + 1) % every == 0:
                    last = (steps[name][slots, -1] for name in ("qpos", "qvel", "actuator_force"))
                    time, policy = (k + 1) * spec.config.period, rollouts.read_observations_and_actions(slots)
                    frames.append(TickSample(time, ctrl[slots], *last, policy=policy))
            own_figures = rollouts.compute_rollout_metrics(spec.observable_state(qpos, qvel, seen))
        warned = begun.batch.warning[:, :, 0] > 0
        full, broken = (
            warned[:, BUFFER_WARNINGS].any(axis=1),
            broken | np.delete(warned, BUFFER_WARNINGS, axis=1).any(axis=1),
        )
        last = metric_state.result()
        gained = begun.energy(last.last_qpos, last.last_qvel) - before_all
        found = self._meter.compute(last, begun.mass, gained, broken, full)
        return found | own_figures, frames, [begun.get_model(int(slot)) for slot in slots]


class TickStepper:
    """Simulates a batch on C MuJoCo, one control tick after the other.

    Args:
        spec: The model with its controller.
        begun: The batch of n rollouts.
        shares: How much of a new command counts in each physics step of a tick, beside the one before, (s,).
    """

    def __init__(self, spec: ModelSpec, begun: batch.InitialBatch, shares: np.ndarray):
        self._spec, self._begun, self._shares = spec, begun, shares
        n, model = begun.batch.nsim, spec.model
        self._control, self._motors, self._bodies = spec.controller.joint_control, spec.motor_law, spec.pushed_bodies
        self._commands = np.zeros((n, len(shares), model.nu))
        self._before: np.ndarray | None = None
        self._networks = [TiledActuatorNetwork(one) for one in spec.actuator_networks]
        self._network_states = [one.begin(n) for one in spec.actuator_networks]
        self._past = np.zeros((n, spec.action_buffer, model.nu))  # commands of the steps before
        self._first = 0  # number of the next step
        self._pushed: tuple[np.ndarray, np.ndarray] | None = None  # places as two steps began, last force

    def advance(self, ctrl: np.ndarray, out: dict[str, np.ndarray] | None = None) -> dict[str, np.ndarray]:
        """Simulate one control tick of the batch.

        Args:
            ctrl: Commands (n, nu) of the controllers.
            out: Arrays to record into, as an earlier call returned them.

        Returns:
            What is recorded after each step, (n, s, ...) by name; with pushes their work `push_work` (n,) in J, up to
            the last step but one.
        """
        before, self._before = ctrl if self._before is None else self._before, ctrl
        commands = self._commands
        commands[:] = before[:, None] + self._shares[:, None] * (ctrl - before)[:, None]
        if room := self._past.shape[1]:
            self._past = np.repeat(ctrl[:, None], room, axis=1) if not self._first else self._past
            commands, self._past = delay_commands(self._past, commands, self._begun.acting.delay)
        step, count = self._spec.model.opt.timestep, len(self._shares)
        forces = (
            self._begun.acting.mean_push_forces(np.asarray(self._first), count, step) if len(self._bodies) else None
        )
        self._first += count
        return self._simulate(commands, forces, out)

    def _begin_step(self, commands: np.ndarray) -> np.ndarray:
        """Controls (n, nu) of the next physics step from its commands, by the laws that run at the physics rate."""
        state = self._begun.qpos, self._begun.qvel
        controls = commands if self._control is None else self._control.controls(commands, *state)
        limits = self._begun.acting.motors
        if self._motors is None or limits is None:
            return controls
        torques, networks = None, self._spec.actuator_networks
        if networks:
            torques, self._network_states = compute_torques(
                networks, self._networks, self._network_states, commands, *state
            )
        return self._motors.controls(controls, *state, limits, torques)

    def _simulate(self, commands: np.ndarray, forces: Any, out: Any) -> dict[str, np.ndarray]:
        simulate, record, spec = self._begun.batch.rollout, RECORDED_FIELDS, int(mujoco.mjtState.mjSTATE_CTRL)
        beside = np.zeros((*commands.shape[:2], 0))
        if forces is not None:
            wrench = np.zeros((*commands.shape[:2], self._spec.model.nbody, 6))
            for k, body in enumerate(self._bodies):
                wrench[:, :, body, :3] += forces[:, :, k]
            beside, spec = wrench.reshape(*commands.shape[:2], -1), spec | int(mujoco.mjtState.mjSTATE_XFRC_APPLIED)
            record = (*RECORDED_FIELDS, "xipos")
        if self._control is None and self._motors is None:
            inputs = commands if forces is None else np.concatenate([commands, beside], axis=2)
            steps = simulate(commands.shape[1], inputs, spec, record=record, out=out)
        else:
            parts = []
            for k in range(commands.shape[1]):
                controls = self._begin_step(commands[:, k])
                inputs = np.concatenate([controls, beside[:, k]], axis=1)[:, None]
                parts.append(simulate(1, inputs, spec, record=record))
            steps = {name: np.concatenate([one[name] for one in parts], axis=1) for name in record}
        if forces is None:
            return steps
        places = steps["xipos"][:, :, self._bodies]  # as each step began
        last = self._pushed or (places[:, [0, 0]], np.zeros_like(places[:, :1]))
        places, forces = (np.concatenate(both, axis=1) for both in zip(last, (places, forces), strict=True))
        self._pushed = places[:, -2:], forces[:, -1:]
        way = (places[:, 2:] - places[:, :-2]) / 2  # at the mean of the speeds before and after a step
        return {**steps, "push_work": (forces[:, :-1] * way).sum(axis=(1, 2, 3))}


def find_unconverged_steps(model: mujoco.MjModel, steps: Mapping[str, np.ndarray]) -> np.ndarray:
    """Return in which physics steps (n, s) the contact solver did not converge within its iteration limit.

    What PGS and noslip find balances whatever it is, so that of theirs the iterations alone are known.
    """
    found = steps["solver_niter"].reshape(*steps["M"].shape[:2], -1).max(axis=2) >= model.opt.iterations
    if found.any() and model.opt.solver != int(mujoco.mjtSolver.mjSOL_PGS) and not model.opt.noslip_iterations:
        inertia, *forces = (steps[name][found] for name in ("M", *BALANCE_FIELDS))
        row, column = np.repeat(np.arange(model.nv), model.M_rownnz), model.M_colind
        mass = np.zeros((len(inertia), model.nv, model.nv))  # of which the lower triangle is recorded
        mass[:, row, column] = mass[:, column, row] = inertia
        found[found] = find_unbalanced_steps(mass, *forces)
    return found

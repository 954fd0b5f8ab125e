"""Handling of batches that both engines share: nominal plan, batch width, and traces from recorded ticks."""

from collections.abc import Mapping
from functools import lru_cache
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from sweep.backends import devices, program_cache
from sweep.contract.engine import Metrics, MissingTrace, Push, SideMaker, Trace, count_substeps
from sweep.contract.engine_settings import EngineSettings
from sweep.contract.trace_frames import base_body_id
from sweep.controllers.layers import Command, ForceFeedforward
from sweep.controllers.plan import Plan
from sweep.controllers.tracker import TrackerState
from sweep.core.parameters import InputError
from sweep.core.progress import measure_part_duration
from sweep.engines import planning, pre_rollout
from sweep.engines.contact_forces import SurfaceContacts
from sweep.fused.dependence import find_inactive_parameters
from sweep.metrics import accumulator, outcome
from sweep.metrics.outcome import OutcomeThresholds
from sweep.metrics.tick import MAX_DURATION_FACTOR, EngineTickReport
from sweep.models import scene
from sweep.models.case import Case
from sweep.models.legs import N_JOINTS


def nominal_plan(belief: Case) -> Plan:
    """Compute the motion plan for the nominal parameters that the controller believes.

    The last plan is cached in this process, since layout and engine ask for the same one; later processes load it
    together with the compiled programs.

    Raises:
        InputError: The parameters admit no plan. In a study a row without a plan is invalid instead.
    """
    return _nominal_plan(belief, jnp.zeros(()).dtype)


@lru_cache(maxsize=1)
def _nominal_plan(belief: Case, dtype: np.dtype) -> Plan:
    """Cached by belief and JAX's present float type."""
    made_of = "nominal plan", belief, str(dtype)
    (plan,) = program_cache.load_or_compile(made_of, jax.devices()[:1], lambda: [_compute_nominal_plan(belief)])
    return plan


def _compute_nominal_plan(belief: Case) -> Plan:
    with measure_part_duration("nominal plan"):
        plan = planning.evaluate_planning_function(lambda: belief.manoeuvre.plan(belief))
    if not all(np.all(np.isfinite(leaf)) for leaf in jax.tree.leaves(plan)):
        kinds = f"manoeuvre = {belief.manoeuvre.kind} on obstacle = {belief.obstacle.kind}"
        raise InputError(f"{kinds} has no plan for these sizes: a foothold or a path is out of reach")
    return plan


def physics_steps_per_tick(settings: EngineSettings) -> int:
    """Number of physics steps in a control tick. Raises `InputError` if the period is no whole multiple of the step."""
    key = "native_time_step" if settings.name == "native" else "time_step"
    step, period = settings.time_step_s, settings.control_period
    allowed = f"a whole fraction of engine.control_period = {period:g} s"
    return count_substeps(period, step, f"engine.{key} = {step:g} is not allowed: {allowed}")


def rollout_parameters(case: Case, slot: int) -> Case:
    """Return the parameters of the rollout at index `slot` of a batch, as plain numbers."""
    return jax.tree.map(lambda x: float(x[slot]) if np.ndim(x) else x, case)


def check_batch_width(streams: np.ndarray, width: int) -> None:
    """Raise `ValueError` if a batch has another number of rollouts than the engine was made for."""
    if len(streams) != width:
        raise ValueError(f"a batch of {len(streams)} rollouts for an engine of width {width}")


def record_tick(
    command: Command, state: TrackerState, tick: EngineTickReport, q: Array, v: Array, tick_summary: Array
) -> dict[str, Array]:
    """Return the quantities of one control tick (state, targets, foot forces) that a trace records.

    Args:
        command: command of the controller.
        state: state of the tracker.
        tick: summary of the physics steps.
        q: positions in MuJoCo's layout (nq,).
        v: velocities in MuJoCo's layout (nv,).
        tick_summary: present values of the metrics that have thresholds (w,).

    Returns:
        Arrays by name; foot quantities (6, 3) in world axes, SI units.
    """
    return {
        "qpos": q,
        "qvel": v,
        "joint_target": command.joints.reshape(N_JOINTS),
        "joint_torque": tick.torque_peak.reshape(N_JOINTS),
        "foot_position": tick.joints[:, -1],
        "foot_target": command.target.feet,
        "foot_force": tick.force,
        "base_target": jnp.concatenate([command.target.position, command.target.quat]),
        "stage": state.stage,
        "judged": tick_summary,
    }


class BatchEngine:
    """Base class of engines that simulate batches of the built-in hexapod; recording does not change results."""

    width: int

    def __init__(self, settings: EngineSettings, world: Case, belief: Case, limits: OutcomeThresholds | None = None):
        devices.configure_jax()
        self.settings, self.limits, self._nominal = settings, limits or OutcomeThresholds(), (world, belief)
        self.substeps = physics_steps_per_tick(settings)
        with devices.precision_context(settings):
            plan = nominal_plan(belief)
            pre_rollout.check_control_settings(world, belief, plan)
        self.stages, self.duration = plan.names, float(MAX_DURATION_FACTOR * np.sum(np.asarray(plan.duration)))
        self._searches = plan.find_layer(ForceFeedforward) is not None  # for planned forces
        self._replans = world.control.replan != "never"
        self._programs: dict[Any, Any] = {}  # by the signature of their arguments

    def _simulate(
        self, world: Case, belief: Case, streams: np.ndarray, slots: np.ndarray | None = None, every: int = 1
    ) -> tuple[Metrics, list[Any]]:
        """Simulate a batch, and record the rollouts in `slots`, if any, at one in `every` ticks.

        Returns: metrics, and the recorded parts in order of time.
        """
        raise NotImplementedError

    def rollout_outputs(self, world: Case, belief: Case, key: Array) -> Any:
        """Compute what the metrics of one rollout depend on; JAX only traces this function for analysis."""
        raise NotImplementedError

    def find_inactive_parameters(self, sides: SideMaker, ends: Mapping[str, tuple[float, float]]) -> set[str]:
        """Find the parameters that cannot change any metric, by analysing the traced program of a rollout."""
        with devices.precision_context(self.settings):
            return find_inactive_parameters(self.rollout_outputs, sides, ends)

    @devices.convert_memory_errors()
    def run(self, world: Case, belief: Case, streams: np.ndarray) -> Metrics:
        """Simulate a batch of rollouts and return their metrics; the simulation stops once every rollout is over."""
        return self._simulate(world, belief, streams)[0]

    def trace(self, world: Case, belief: Case, streams: np.ndarray, slot: int) -> Trace:
        """Simulate a batch and record the states over time (trace) of the rollout at index `slot`."""
        return require_trace(self.traces(world, belief, streams, 1, np.array([slot]))[0])

    def traces(
        self, world: Case, belief: Case, streams: np.ndarray, every: int, slots: np.ndarray | None = None
    ) -> list[Trace | MissingTrace]:
        """Simulate a batch and record states over time (traces) of the rollouts at indices `slots` (default: all)."""
        slots = np.arange(self.width) if slots is None else slots
        figures, parts = self._simulate(world, belief, streams, slots, every)
        records = jax.tree.map(lambda *each: np.concatenate(each), *parts)
        tick = self.settings.control_period
        return traces_from_records((world, belief), slots, figures, records, self.stages, self.limits, tick, every)


def require_trace(trace: Trace | MissingTrace) -> Trace:
    """Return the trace of a rollout; raise `InputError` if MuJoCo could not compile its model."""
    if isinstance(trace, MissingTrace):
        raise InputError(trace.reason)
    return trace


def list_pushes(execution: Any, model: Any) -> tuple[Push, ...]:
    """List the push on the base of a rollout, if there is one.

    Args:
        execution: faults of the rollout, see `ExecutionFaults`.
        model: its MuJoCo model.
    """
    angle, length = float(execution.push_direction), float(execution.push_duration)
    force = float(execution.push_impulse) / length * np.array([np.cos(angle), np.sin(angle), 0.0])
    start = float(execution.push_time)
    return (Push(base_body_id(model), force, start, start + length),) if force.any() else ()


def traces_from_records(
    cases: tuple[Case, Case],
    slots: np.ndarray,
    figures: Metrics,
    records: dict[str, np.ndarray],
    stages: tuple[str, ...],
    limits: OutcomeThresholds,
    tick: float,
    every: int,
) -> list[Trace | MissingTrace]:
    """Make traces (states over time for replay) of rollouts from the recorded ticks of a batch.

    Args:
        cases: world and belief of the batch.
        slots: indices of the recorded rollouts in the batch.
        figures: metrics of the batch, by column name.
        records: recorded arrays (samples, slots, ...), see `record_tick`.
        stages: names of the plan's stages.
        limits: thresholds, for the margin of each sample.
        tick: length of a control tick (s).
        every: number of control ticks between samples.

    Returns:
        A trace for each slot, or the reason that its model cannot be drawn.
    """
    traces: list[Trace | MissingTrace] = []
    for place, slot in enumerate(slots):
        world, belief = (rollout_parameters(case, slot) for case in cases)
        row = {name: values[slot] for name, values in figures.items()}
        samples = round(float(row["duration_s"]) / tick) // every  # rounds off the error of summing many ticks
        kept = {name: values[:samples, place] for name, values in records.items()}
        causes, judged = accumulator.causes_judged_each_tick(world), kept.pop("judged").T
        watched = dict(zip(accumulator.metrics_computed_each_tick(world), judged, strict=True))
        margin, margin_of = outcome.least_margins(causes, watched, limits)
        time = every * tick * (1 + np.arange(len(kept["stage"])))
        try:
            model = scene.compile_model(world)
        except InputError as error:
            traces.append(MissingTrace(str(error)))
            continue
        traces.append(
            Trace(
                world=world,
                belief=belief,
                model=model,
                time=time,
                stages=stages,
                margin=margin,
                margin_of=margin_of,
                metrics=row,
                torque_limit=float(np.max(world.drive.torque_limit)),
                contacts=SurfaceContacts(),
                pushes=list_pushes(world.execution, model),
                **kept,  # pyright: ignore[reportArgumentType]
            )
        )
    return traces

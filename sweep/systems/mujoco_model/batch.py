"""Start of a batch of a MuJoCo model: models with their own values, controller inputs, and poses."""

from typing import Any, NamedTuple

import jax
import mujoco
import numpy as np
from mujoco.batch import Batch

from sweep.backends import devices, mujoco_versions
from sweep.contract.engine_settings import EngineSettings
from sweep.core.errors import InputError
from sweep.systems.mujoco_model import disturbances, fields, initial_state, motors, payloads, terrain
from sweep.systems.mujoco_model.disturbances import Disturbances
from sweep.systems.mujoco_model.initial_state import StartOffsets
from sweep.systems.mujoco_model.model_spec import (
    PHYSICAL,
    TERM_NOISE_PARAMETERS,
    ModelSpec,
    ParameterOverrides,
    append_arrays,
)

PUSH_KEY, START_KEY = 2**31 - 1, 2**31 - 2  # of random pushes and initial states; controllers have those from 0 on


class InitialBatch(NamedTuple):
    """A batch of n rollouts before their first control tick, made by `make_initial_batch`."""

    batch: Batch  # at the keyframe
    qpos: np.ndarray  # (n, nq), of the batch: what is written here is where it goes on from
    qvel: np.ndarray  # (n, nv), likewise
    sensordata: np.ndarray  # (n, nsensordata), likewise
    arrays: dict[str, np.ndarray]  # of mjData that the controllers read, (n, ...) by name
    policy_inputs: dict[str, Any]  # to the controllers, by row
    mass: np.ndarray  # (n,) kg
    limits: dict[str, np.ndarray]  # by field, (n, ..., 2), and the ground
    acting: Disturbances  # pushes and delays of commands
    written: frozenset[str]  # fields of the models that were written
    offsets: StartOffsets  # of the initial state
    ground: terrain.TerrainBatch | None  # the terrains, where the model has one
    alone: mujoco.MjModel  # the model with one height field only

    def set_initial_state(self, start: np.ndarray | None) -> np.ndarray:
        """Set the initial state, above the terrain, and return its energy (n,) in J.

        Args:
            start: Positions (n, nq) that the controllers start from, to which the scenario's offsets are added; None
                for those of the keyframe.
        """
        if start is not None:
            self.qpos[:] = start
        model, free = self.batch.model, np.flatnonzero(self.batch.model.jnt_type == int(mujoco.mjtJoint.mjJNT_FREE))
        base = int(model.jnt_qposadr[free[0]]) if len(free) else None
        self.offsets.add_to_states(model, base, self.limits["jnt_range"], self.qpos, self.qvel)
        energy = self.energy()
        if self.ground is None:
            return energy
        terrain.lift_above_terrain(self.ground, self.batch, self.qpos)
        return self.energy()

    def get_model(self, slot: int) -> mujoco.MjModel:
        """Return the MuJoCo model of the rollout at index `slot` of the batch, for drawing."""
        if self.ground is None:
            return self.batch.get_model(slot)
        return self.ground.make_render_model(self.batch, slot, self.alone)

    def energy(self, qpos: Any = None, qvel: Any = None) -> np.ndarray:
        """Return the mechanical energy (n,) in J of each rollout, in its present state or in a given one.

        All that follows from the state is worked out; where that is not finite, energy is NaN.
        """
        for state, new in ((self.qpos, qpos), (self.qvel, qvel)):
            if new is not None:
                state[:] = new
        finite = self._finite()
        flags, found = self.batch.expand("opt.enableflags"), self.batch.bind("energy")
        usual = flags.copy()
        flags |= int(mujoco.mjtEnableBit.mjENBL_ENERGY)
        self.batch.forward(np.flatnonzero(finite))
        flags[:] = usual
        return np.where(finite, found.sum(axis=1), np.nan)

    @property
    def sensors(self) -> np.ndarray:
        """Sensor values and arrays of mjData (n, k) that MuJoCo computed last."""
        return append_arrays(self.sensordata, self.arrays.values())

    def refresh_sensors(self) -> None:
        """Compute the sensor values and arrays of the present state, by MuJoCo's forward pass."""
        self.batch.forward(np.flatnonzero(self._finite()))

    def _finite(self) -> np.ndarray:
        return np.isfinite(self.qpos).all(axis=1) & np.isfinite(self.qvel).all(axis=1)


def make_initial_batch(
    spec: ModelSpec,
    settings: EngineSettings,
    world: ParameterOverrides,
    belief: ParameterOverrides,
    streams: np.ndarray,
) -> InitialBatch:
    """Make models and initial states of n rollouts. Raises `InputError` where MuJoCo cannot batch the model."""
    n, number = len(streams), np.dtype(settings.precision).type
    ground = spec.make_terrain(world, n)
    model = ground.fill_height_fields(spec.compile_with_height_fields(len(ground.heights))) if ground else spec.model
    try:
        batch = Batch(model, n, devices.count_cores())
    except ValueError as error:  # as of bodies that sleep
        reason = " ".join(str(error).split())
        raise InputError(f"model.mjcf = {spec.config.mjcf} cannot be simulated in batches: {reason}") from None
    qpos, qvel, sensordata = (batch.bind(name) for name in ("qpos", "qvel", "sensordata"))
    arrays = {name: batch.bind(name) for name in spec.data_sizes}
    # bound before the reset: what is bound after it is zero until the next call
    if ground:
        for name in ("geom_xpos", "geom_xmat"):
            batch.bind(name)
        ground.assign_height_fields(batch)
    varied = fields.select_batchable_values(spec.model, spec.select_model_values(world))
    rows = {path: np.broadcast_to(value, (n,)) for path, value in varied.items()}
    numbers = world_parameter_values(spec, world)
    written = payloads.write_payloads(batch, spec.payloads, numbers)
    written |= fields.write_batch_parameters(batch, rows, spec.load_source)
    batch.reset(keyframe=spec.keyframe_index, stage=int(mujoco.mjtStage.mjSTAGE_NONE))
    values = controller_inputs(spec, world, belief)
    policy_inputs = {
        **jax.tree.map(lambda value: np.broadcast_to(number(value), (n,)), values),
        "delay": np.broadcast_to(np.rint(values["delay"]).astype(np.int32), (n,)),
        "key": np.asarray(jax.random.key_data(devices.noise_keys(streams))),
    }
    limits = {name: batch.expand(name) for name in ("actuator_forcerange", "jnt_range")}
    if ground:
        limits |= ground.metric_inputs(batch.expand("geom_pos")[:, terrain.find_terrain_geom(model)])
    acting = make_batch_disturbances(spec, world, streams)
    acting = acting._replace(motors=motors.make_motor_limits(spec.motors, numbers, batch))
    is_random = any(np.any(numbers[path]) for path in numbers if path.startswith(f"{initial_state.RANDOM}."))
    count = initial_state.count_random_numbers(spec.model)
    luck = draw_uniform(streams, START_KEY, count) if is_random else np.full((n, count), 0.5)
    offsets = initial_state.make_offsets(spec.model, numbers, 2 * luck - 1)
    mass = batch.expand("body_mass").sum(axis=1)
    start = batch, qpos, qvel, sensordata, arrays, policy_inputs, mass, limits, acting, written, offsets
    return InitialBatch(*start, ground, spec.model)


def make_batch_disturbances(
    spec: ModelSpec, world: ParameterOverrides, streams: np.ndarray
) -> disturbances.Disturbances:
    """Make the disturbances that act on a batch: pushes and command delays, but no motor limits.

    Args:
        spec: The model with its scenario.
        world: Parameters of the simulated side.
        streams: Noise stream of each rollout (n,), which the times of random pushes are drawn from.
    """
    uniform = draw_uniform(streams, PUSH_KEY, len(spec.pushes))
    return disturbances.make_disturbances(spec.pushes, world_parameter_values(spec, world), uniform)


def draw_uniform(streams: np.ndarray, purpose: int, count: int) -> np.ndarray:
    """Draw uniform random numbers from 0 to 1 from the random-number stream of each rollout.

    Args:
        streams: Noise streams (n,).
        purpose: Number that tells these draws from others of a stream.
        count: Numbers k for each rollout.

    Returns:
        Numbers (n, k), the same in any precision.
    """
    if not count:
        return np.zeros((len(streams), 0))
    keys = jax.vmap(lambda key: jax.random.fold_in(key, purpose))(devices.noise_keys(streams))
    return np.asarray(jax.vmap(lambda key: jax.random.uniform(key, (count,), jax.numpy.float32))(keys), float)


def controller_inputs(spec: ModelSpec, world: ParameterOverrides, belief: ParameterOverrides) -> dict[str, Any]:
    """Return what the controllers of a batch receive: believed parameters, observation errors, and schedule factors."""
    noise = world_parameter_values(spec, world)
    told = spec.believed_values({**belief.select_group("model"), **belief.select_group("controller")})
    found = {"belief": told, **{name: noise[f"noise.{name}"] for name in ("delay", "white", "bias")}}
    factors = {**dict(spec.controller_values), **belief.select_group("schedule")}
    found["factors"] = {one.name: factors[f"schedule.{one.name}.factor"] for one in spec.schedules}
    if spec.controller.fitted_policy:
        labels = spec.controller.fitted_policy.measured_terms
        found["terms"] = {key: {one: noise[f"noise.{one}.{key}"] for one in labels} for key in TERM_NOISE_PARAMETERS}
    return found


def world_parameter_values(spec: ModelSpec, world: ParameterOverrides) -> dict[str, Any]:
    """Return the values of noise and push parameters in the simulated world, by path."""
    groups = (world.select_group(name) for name in ("noise", *PHYSICAL))
    return {**dict(spec.controller_values), **{path: value for group in groups for path, value in group.items()}}


def unperturbed_start_values(spec: ModelSpec) -> ParameterOverrides:
    """Return the nominal parameter values with all random deviations of the initial state set to zero."""
    return ParameterOverrides(
        tuple((path, 0.0) for path in spec.parameters if path.startswith(f"{initial_state.RANDOM}."))
    )


def count_ticks(spec: ModelSpec, duration: Any) -> np.ndarray:
    """Return the number of control ticks (n,) in rollouts that last `duration` (n,) seconds.

    Raises `InputError` where one is shorter than a tick.
    """
    found = np.rint(np.minimum(np.asarray(duration, float), spec.config.duration) / spec.config.period)
    for short in np.ravel(duration)[~(np.ravel(found) >= 1)]:
        wanted = f"at least a tick of {spec.config.period:g} s is wanted"
        raise InputError(f"model.controller = {spec.config.controller} lasts {short:g} s: {wanted}")
    return found.astype(int)


def varied_model_fields(begun: InitialBatch) -> dict[str, np.ndarray]:
    """Return the fields of MuJoCo models (n, ...) that differ from the nominal model in a batch, by name."""
    model, found = begun.batch.model, mujoco_versions.differing_model_fields(begun.batch, begun.written)
    return {name: rows for name, rows in sorted(found.items()) if (rows != fields.field_values(model, name)).any()}

"""The second opinion: C MuJoCo with its own contact solver on a thread pool, under the same controller and metrics."""

import warnings
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from jaxtyping import Array, Float
from mujoco.batch import Batch

from sweep.controllers.learned import newest
from sweep.controllers.plan import Plan
from sweep.controllers.tracker import Command
from sweep.core.errors import InputError
from sweep.core.rotations import exponential, multiply
from sweep.engines import batching, devices
from sweep.engines.base import Figures, Trace
from sweep.engines.closed_loop import (
    CHUNK,
    GRACE,
    ClosedLoop,
    Start,
    act,
    free_state,
    init,
    is_quiet,
    measure,
    most_ticks,
    start_state,
    with_new_plan,
)
from sweep.engines.prelude import check, prepared
from sweep.engines.settings import EngineSettings
from sweep.engines.states import Watch, offered
from sweep.metrics import stream
from sweep.metrics.metric import Tick
from sweep.metrics.outcome import Thresholds
from sweep.models import scene
from sweep.models.case import Case
from sweep.models.collisions import collide
from sweep.models.drive import Servo, towards
from sweep.models.legs import JOINT_Q, JOINT_V, JOINTS, N_JOINTS, N_LEGS
from sweep.models.obstacles.surface import FreeState, poses

CONTROL = mujoco.mjtState.mjSTATE_CTRL.value | mujoco.mjtState.mjSTATE_XFRC_APPLIED.value
Compiled = tuple[Callable, Callable, Callable, Callable | None]
RECORD = ("qpos", "qvel", "actuator_force", "sensordata", "energy", "xpos", "xmat", "site_xpos", "subtree_com")


def native_model(case: Case, time_step: float, solid: bool = False) -> mujoco.MjModel:
    """The compiled `native_spec`."""
    return native_spec(case, time_step, solid).compile()


def native_spec(case: Case, time_step: float, solid: bool = False) -> mujoco.MjSpec:
    """The model of one case with contact, the clamped servos of (1.2.1) and foot force sensors.

    The settings are those that hold a stiff robot still: elliptic cones, impratio 100, stiff contact. Where it is
    `solid`, not only feet touch.
    """
    spec = scene.describe(case)
    spec.option.timestep = time_step
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    spec.option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
    spec.option.impratio = 100
    spec.option.iterations = 50
    spec.option.enableflags |= int(mujoco.mjtEnableBit.mjENBL_ENERGY)
    drive, execution = case.drive, case.execution
    dead, limit = round(float(execution.dead_joint)), execution.torque_scale * drive.torque_limit
    for number, (name, motor) in enumerate(zip(JOINTS, spec.actuators, strict=True)):
        alive = float(number != dead)
        motor.gainprm[0] = alive  # controls are torques: stiffness times target, and what comes on top
        motor.biastype = mujoco.mjtBias.mjBIAS_AFFINE
        motor.biasprm[1:3] = -alive * drive.stiffness, -alive * drive.damping
        motor.forcelimited, motor.forcerange = True, [-limit, limit]
        spec.joint(name).damping[0] = drive.back_emf
    if solid:
        collide(spec, case, scene.links(case.robot))
    return spec


class Native:
    """One C simulation per rollout; the host goes through the control ticks."""

    def __init__(self, settings: EngineSettings, world: Case, belief: Case, limits: Thresholds | None = None):
        devices.configure()
        mujoco.set_mju_user_warning(lambda _: None)  # or it fills screen and disk; a row that it is about is invalid
        self.settings = settings
        self._nominal = world
        self.limits = limits or Thresholds()
        self.substeps = batching.substeps(settings)
        self.dynamics = "C MuJoCo"
        self.devices = 1  # threads share it
        self.width = settings.width or devices.NATIVE_WIDTH
        plan = batching.nominal_plan(belief)
        check(world, belief, plan)
        self.stages = plan.names
        self.duration = float(GRACE * np.sum(plan.duration))
        self._compiled: dict[Any, Compiled] = {}

    def rollout_bytes(self) -> None:
        """See `Engine`."""
        return None

    @devices.memory()
    def run(self, world: Case, belief: Case, streams: np.ndarray) -> Figures:
        """Figures of `width` rollouts."""
        return self._simulate(world, belief, streams, None)[0]

    @devices.memory()
    def histories(
        self, world: Case, belief: Case, streams: np.ndarray, slots: np.ndarray, watch: Watch
    ) -> tuple[Figures, np.ndarray]:
        """See `Engine`."""
        columns = offered(self._nominal)

        def chosen(record: dict[str, np.ndarray]) -> np.ndarray:
            parts = {name: np.moveaxis(values, 0, -1) for name, values in record.items()}
            return np.stack([np.asarray(columns[name](parts)) for name in watch.columns], axis=-1)

        figures, records = self._simulate(world, belief, streams, slots, watch.every)
        return figures, np.stack([chosen(record) for record in records])

    def trace(self, world: Case, belief: Case, streams: np.ndarray, slot: int) -> Trace:
        """The rollout in `slot`."""
        return self._traces(world, belief, streams, np.array([slot]), 1)[0]

    def traces(self, world: Case, belief: Case, streams: np.ndarray, every: int) -> list[Trace]:
        """See `Engine`."""
        return self._traces(world, belief, streams, np.arange(self.width), every)

    def _traces(self, world: Case, belief: Case, streams: np.ndarray, slots: np.ndarray, every: int) -> list[Trace]:
        figures, parts = self._simulate(world, belief, streams, slots, every)
        records = {name: np.stack([part[name] for part in parts]) for name in parts[0]}
        tick = self.settings.control_period
        return batching.to_traces((world, belief), slots, figures, records, self.stages, tick, every)

    def _simulate(
        self, world: Case, belief: Case, streams: np.ndarray, slots: np.ndarray | None, every: int = 1
    ) -> tuple[Figures, list[dict[str, np.ndarray]]]:
        batching.check(streams, self.width)
        with devices.precision(self.settings):
            start, tick, finish, replan = self._functions(world, belief)
            models, unbuilt = self._models(world)
            batch = Batch(models[0], self.width)
            batch.set_models(models)
            arrays = (*devices.as_arrays((world, belief)), devices.keys(streams))
            plans, loops, state = start(*arrays)
            told = _gains(loops.servo)
            batch.reset()
            batch.qpos[:], batch.qvel[:] = (np.asarray(x) for x in state)
            loops, commands, controls = tick(*arrays[:2], plans, loops, None, None, 0)
            records = []
            for k in range(most_ticks(plans, self.settings.control_period)):
                if replan and k % round(CHUNK / self.settings.control_period) == 0:
                    loops = replan(arrays[1], plans, loops)
                if plans.flywheel is not None:
                    told = _retune(batch, models, told, _gains(loops.servo))
                steps = batch.rollout(self.substeps, np.asarray(controls, float), CONTROL, RECORD)
                steps["broken"] = unbuilt | np.any(batch.warning[:, :, 0] > 0, axis=1)
                if k == 0:  # derived fields are those before a step, hence the start's
                    loops = _with_energy(self._nominal, loops, steps["energy"][:, 0].sum(axis=-1))
                if slots is not None and (k + 1) % every == 0:
                    records.append(_record(commands, loops, steps, slots))
                loops, commands, controls = tick(*arrays[:2], plans, loops, commands, steps, k + 1)
                if bool(np.all(loops.running.over)):
                    break
            if slots is not None and not records:  # all ended before the first sample, which has the form of none
                records.append(_record(commands, loops, steps, slots))
            return {name: np.asarray(values) for name, values in finish(arrays[0], plans, loops).items()}, records

    def _models(self, world: Case) -> tuple[list[mujoco.MjModel], np.ndarray]:
        """Each row's model, and which rows cannot be built: absurd sizes, in whose place the nominal model runs."""
        models: list[mujoco.MjModel | None] = []
        for i in range(self.width):
            try:
                with warnings.catch_warnings(action="ignore", category=UserWarning):  # as of a singular inertia
                    models.append(self._model(batching.pick(world, i)))
            except InputError:
                raise
            except ValueError:  # of MuJoCo's compiler
                models.append(None)
        unbuilt = np.array([model is None for model in models])
        stand_in = self._model(self._nominal) if unbuilt.any() else None
        return [model or stand_in for model in models], unbuilt  # pyright: ignore[reportReturnType]

    def _model(self, world: Case) -> mujoco.MjModel:
        return native_model(world, self.settings.native_time_step, self.settings.solid)

    def _functions(self, world: Case, belief: Case) -> Compiled:
        """Compiled `start`, `tick` (measure the last tick, act in the next), `finish` and, if any, `replan`."""
        axes, quiet = devices.axes((world, belief)), is_quiet(world.noise)
        form = devices.form((world, belief)), quiet
        if form not in self._compiled:
            self._compiled[form] = self._compile(axes, quiet)
        return self._compiled[form]

    def _compile(self, axes: tuple[Case, Case], quiet: bool) -> Compiled:
        period, n = self.settings.control_period, self.substeps

        def start(world: Case, belief: Case, key: Array) -> tuple[Plan, ClosedLoop, Start]:
            belief, plan, learned = prepared(world, belief, key)
            state = start_state(world, belief, plan)
            return plan, init(world, belief, plan, state, jnp.zeros(()), key, learned), state

        def tick(
            world: Case, belief: Case, plan: Plan, loop: ClosedLoop, command: Command | None, steps: Any, k: Array
        ):
            if steps is not None and command is not None:
                summary = self._summary(world, steps, (k - 1) * period, loop.seen.free)
                loop = measure(world, plan, self.limits, loop, command, summary, k - 1, period)
            old = loop.servo
            loop, command = act(world, belief, plan, loop, k, period, quiet)
            told = towards(old, loop.servo, (1 + jnp.arange(n))[:, None, None] / n)
            torques = (told.stiffness * told.target + told.torque).reshape(n, N_JOINTS)
            forces = self._outside(world, k * period, loop.seen.free)
            return loop, command, jnp.concatenate([torques, forces], axis=1)

        def finish(world: Case, plan: Plan, loop: ClosedLoop) -> dict[str, Array]:
            return stream.figures(world, newest(plan, loop.learned), loop.running, loop.tracker.stage)

        again = self._nominal.control.replan != "never"
        over = (*axes, 0, 0, 0, 0, None)
        return (
            jax.jit(jax.vmap(start, in_axes=(*axes, 0))),
            jax.jit(jax.vmap(tick, in_axes=over)),
            jax.jit(jax.vmap(finish, in_axes=(axes[0], 0, 0))),
            jax.jit(jax.vmap(with_new_plan, in_axes=(axes[1], 0, 0))) if again else None,
        )

    def _outside(self, world: Case, start: Array, free: FreeState) -> Float[Array, "n f"]:
        """Outside wrenches on all bodies in the tick's steps: force, then torque, world axes.

        The obstacle's loads are those of its bodies moved on from the tick's start, `free`, as fast as they are there.
        """
        ahead = self.settings.native_time_step * jnp.arange(self.substeps)
        push = jax.vmap(lambda t: batching.execution_limits(world, t).push)(start + ahead)
        robot, count = 2 + N_LEGS * len(scene.links(world.robot)), len(world.obstacle.free_bodies)
        forces = jnp.zeros((self.substeps, 6 * (robot + count))).at[:, 6:9].set(push)
        if not count:
            return forces
        load = jax.vmap(lambda t: world.obstacle.load(_ahead(free, t)))(ahead)
        return forces if load is None else forces.at[:, 6 * robot :].set(load.reshape(self.substeps, -1))

    def _summary(self, world: Case, steps: dict[str, Array], start: Array, before: FreeState) -> Tick:
        """What the metrics want of a tick; `steps` hold the records of its physics steps, `before` free bodies then."""
        h, drive = self.settings.native_time_step, world.drive
        rate = steps["qvel"][:, JOINT_V]
        torque = steps["actuator_force"] - drive.back_emf * rate
        effort = jnp.abs(steps["actuator_force"])
        limit = world.execution.torque_scale * drive.torque_limit
        power = torque * rate
        outside, count = self._outside(world, start, before), len(world.obstacle.free_bodies)
        force = -jnp.mean(steps["sensordata"].reshape(-1, 6, 3), axis=0)
        qpos, qvel = steps["qpos"][-1], steps["qvel"][-1]
        free = free_state(qpos, qvel, count)
        feet = steps["site_xpos"][-1, :6]
        normals = world.obstacle.surface(feet, (-1,) * 6, poses(free)).normal
        normal = jnp.sum(force * normals, axis=-1)
        last = -jnp.sum(steps["sensordata"][-1].reshape(N_LEGS, 3) * normals, axis=-1)
        links = steps["xpos"][-1, 2 : 2 + N_LEGS * len(scene.links(world.robot))].reshape(N_LEGS, -1, 3)
        energy = jnp.sum(steps["energy"][-1])
        return Tick(
            torque_peak=jnp.max(jnp.abs(torque), axis=0).reshape(N_LEGS, 3),
            saturated=jnp.mean(effort >= 0.999 * limit, axis=0).reshape(N_LEGS, 3),
            force=force,
            normal=normal,
            tangential=jnp.linalg.norm(force - normal[:, None] * normals, axis=-1),
            load=last,
            residual=jnp.zeros(()),  # the C solver reports no residual force
            work=h
            * (
                jnp.sum(power)
                + jnp.sum(outside[:, 6:9] * steps["qvel"][:, :3])
                + jnp.sum(outside[:, outside.shape[1] - 6 * count :] * _twists(steps, count))
            ),
            effort=h * jnp.sum(jnp.maximum(power, 0.0)),
            energy=jnp.where(steps["broken"], jnp.nan, energy),
            position=qpos[:3],
            quat=qpos[3:7],
            velocity=qvel[:3],
            spin=qvel[3:6],
            angles=qpos[JOINT_Q].reshape(N_LEGS, 3),
            rates=rate[-1].reshape(N_LEGS, 3),
            centre_of_mass=steps["subtree_com"][-1, 1],
            joints=jnp.concatenate([links, feet[:, None]], axis=1),
            bodies=poses(free),
            free=free,
        )


def _ahead(free: FreeState, time: Array) -> FreeState:
    """Free bodies that went on as they do for `time` (s)."""
    return free._replace(
        position=free.position + time * free.velocity, quat=multiply(exponential(time * free.turn), free.quat)
    )


def _twists(steps: dict[str, Array], count: int) -> Float[Array, "n 6k"]:
    """Velocities and rates of turning of the free bodies after each step, world axes."""
    free = jax.vmap(lambda q, v: free_state(q, v, count))(steps["qpos"], steps["qvel"])
    return jnp.concatenate([free.velocity, free.turn], axis=-1).reshape(len(steps["qpos"]), 6 * count)


def _gains(servo: Servo) -> Float[np.ndarray, "b 18 2"]:
    """Stiffness and damping of every joint."""
    return np.stack([np.asarray(servo.stiffness), np.asarray(servo.damping)], axis=-1).reshape(-1, N_JOINTS, 2)


def _retune(batch: Batch, models: list[mujoco.MjModel], old: np.ndarray, new: np.ndarray) -> np.ndarray:
    """Give the servos of rollouts where a joint's mode has changed their new gains; which are returned."""
    changed = np.flatnonzero(np.any(old != new, axis=(1, 2)))
    for i in changed:
        models[i].actuator_biasprm[:, 1:3] = -models[i].actuator_gainprm[:, :1] * new[i]
    if len(changed):
        batch.set_models(models)
    return new


def _with_energy(world: Case, loops: ClosedLoop, start: np.ndarray) -> ClosedLoop:
    """Energy is counted from that of the start."""
    energy = jnp.asarray(start, loops.running.time.dtype)
    return loops._replace(running=stream.with_energy(world, loops.running, energy))


def _record(
    commands: Command, loops: ClosedLoop, steps: dict[str, np.ndarray], slots: np.ndarray
) -> dict[str, np.ndarray]:
    """What is kept of a tick of the rollouts in `slots`."""
    command, n = jax.tree.map(lambda x: np.asarray(x)[slots], commands), len(slots)
    return {
        "qpos": steps["qpos"][slots, -1],
        "qvel": steps["qvel"][slots, -1],
        "joint_target": command.joints.reshape(n, N_JOINTS),
        "joint_torque": np.abs(steps["actuator_force"][slots]).max(axis=1),
        "foot_position": steps["site_xpos"][slots, -1, :6],
        "foot_target": command.target.feet,
        "foot_force": -steps["sensordata"][slots].reshape(n, -1, 6, 3).mean(axis=1),
        "base_target": np.concatenate([command.target.position, command.target.quat], axis=-1),
        "stage": np.asarray(loops.tracker.stage)[slots],
    }

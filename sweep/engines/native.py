"""The second opinion: C MuJoCo with its own contact solver on a thread pool, under the same controller and metrics."""

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

from sweep.controllers.belief_update import LearnedState, replan_rest
from sweep.controllers.flywheel import Flywheel
from sweep.controllers.layers import Command
from sweep.controllers.plan import Plan
from sweep.core.errors import InputError
from sweep.core.progress import timed_part
from sweep.core.rotations import exponential, multiply
from sweep.engines import batching, devices, fused_loop, planning, program_cache
from sweep.engines.base import Figures, Sides, Watch
from sweep.engines.batching import Batched
from sweep.engines.closed_loop import (
    CHUNK,
    ClosedLoop,
    Sensing,
    Start,
    act,
    figures_of,
    free_state,
    init,
    measure,
    most_ticks,
    sensing,
    start_state,
    truth,
)
from sweep.engines.physics import push_force
from sweep.engines.planning import Planning
from sweep.engines.pre_rollout import prepare_belief
from sweep.engines.settings import EngineSettings
from sweep.engines.states import select_columns
from sweep.fused import kernel
from sweep.fused.eager import Eager
from sweep.fused.kernel import Code, Kernel, Tiles
from sweep.metrics import accumulator
from sweep.metrics.metric import Tick
from sweep.metrics.outcome import Thresholds
from sweep.models import scene
from sweep.models.binary import model_bytes
from sweep.models.case import Case
from sweep.models.drive import Servo, interpolate_target
from sweep.models.legs import JOINT_V, N_JOINTS, N_LEGS
from sweep.models.obstacles.surface import FreeState, body_poses, surface_at
from sweep.models.robot import link_names

CONTROL = mujoco.mjtState.mjSTATE_CTRL.value | mujoco.mjtState.mjSTATE_XFRC_APPLIED.value
RECORD = ("qpos", "qvel", "actuator_force", "sensordata", "energy", "xpos", "site_xpos", "subtree_com")


class Recorded(NamedTuple):
    """What C MuJoCo records of a tick's n physics steps; places are those before the last one."""

    qpos: Float[Array, "n q"]
    qvel: Float[Array, "n v"]
    actuator_force: Float[Array, "n 18"]
    foot_force: Float[Array, "n 18"]  # of the feet on the ground
    energy: Float[Array, ""]
    links: Float[Array, "l 3"]  # where the legs' links begin
    feet: Float[Array, "6 3"]
    centre_of_mass: Float[Array, " 3"]
    broken: Bool[Array, ""]


class Orders(NamedTuple):
    """What C MuJoCo is told for a tick's n physics steps; wrenches are force, then torque, world axes."""

    torques: Float[Array, "n 18"]  # beside those of stiffness and damping (N m)
    push: Float[Array, "n 3"]  # at the base (N)
    loads: Float[Array, "n w"]  # wrenches on the obstacle's free bodies


class Between(NamedTuple):
    """One rollout between controller and physics."""

    loop: ClosedLoop
    command: Command
    steps: Recorded
    orders: Orders
    judged: Float[Array, " w"]  # see `measure`


class NativePrograms(NamedTuple):
    """What a batch runs through, compiled."""

    start: Callable[[Case, Case, Array], tuple[Plan, tuple[Between, Start]]]
    tick: Kernel | Callable[[Any, Between, int], Between]
    finish: Callable[[Case, Plan, ClosedLoop], dict[str, Array]]
    replan: Callable[..., LearnedState] | None  # see `replan_rest`

    def enter(self, given: Any, carried: Between, width: int) -> "Tiles | ByXla":
        """A batch that goes through ticks."""
        if isinstance(self.tick, Kernel):
            return self.tick.enter(given, carried, width)
        return ByXla(partial(self.tick, given), carried)


class ByXla:
    """A batch that goes through ticks of XLA's, see `Tiles`."""

    def __init__(self, tick: Callable[[Between, int], Between], carried: Between):
        self._tick, self._carried = tick, carried

    def change(self, which: Callable[[Any], Any], tree: Any) -> None:
        """Go on with other values of what `which` picks."""
        leaves, form = jax.tree.flatten(self._carried)
        places = jax.tree.leaves(which(jax.tree.unflatten(form, range(len(leaves)))))
        for place, x in zip(places, jax.tree.leaves(tree), strict=True):
            leaves[place] = jnp.asarray(x, leaves[place].dtype)
        self._carried = jax.tree.unflatten(form, leaves)

    def advance(self, first: int, ticks: int) -> None:
        """Go on by `ticks` from control tick `first`."""
        for k in range(first, first + ticks):
            self._carried = self._tick(self._carried, k)

    def leave(self) -> Between:
        """What all rollouts carry on."""
        return self._carried

    def look(self, which: Callable[[Any], Any]) -> Any:
        """What `which` picks of what is carried, as NumPy's."""
        return jax.tree.map(np.asarray, which(self._carried))


class Native(Batched):
    """One C simulation per rollout; the host goes through the control ticks."""

    def __init__(self, settings: EngineSettings, world: Case, belief: Case, limits: Thresholds | None = None):
        super().__init__(settings, world, belief, limits)
        mujoco.set_mju_user_warning(lambda _: None)  # or it fills screen and disk; a row that it is about is invalid
        self.dynamics = "C MuJoCo"
        self.devices = 1  # threads share it
        self.width = settings.width or devices.NATIVE_WIDTH
        self.fused = settings.compiler != "xla"

    def rollout_bytes(self) -> None:
        """Nothing: C keeps plan, state and figures."""
        return None

    @devices.memory()
    def histories(
        self, world: Case, belief: Case, streams: np.ndarray, slots: np.ndarray, watch: Watch
    ) -> tuple[Figures, np.ndarray]:
        """Figures, and columns over time, see `Engine`."""
        figures, parts = self._simulate(world, belief, streams, slots, watch.every)
        return figures, np.concatenate([select_columns(self._nominal[0], part, watch.columns) for part in parts])

    def _simulate(
        self, world: Case, belief: Case, streams: np.ndarray, slots: np.ndarray | None = None, every: int = 1
    ) -> tuple[Figures, list[Any]]:
        batching.check(streams, self.width)
        with devices.precision(self.settings):
            models, unbuilt = self._models(world)
            sensors_are = sensing(world.noise)
            (world, belief), keys = devices.as_arrays((world, belief)), devices.keys(streams)
            programs = self._prepare((world, belief, keys), sensors_are)
            batch = Batch(models[0], self.width, devices.cores())
            batch.set_models(models)
            plans, (between, state) = programs.start(world, belief, keys)
            told = np.full((self.width, N_JOINTS, 2), np.nan)  # models are built for a mode that may be another one
            batch.reset()
            batch.qpos[:], batch.qvel[:] = (np.asarray(x) for x in state)
            going = programs.enter((world, belief, plans), between, self.width)
            controls = np.zeros((self.width, self.substeps, N_JOINTS + 6 * models[0].nbody))
            steps, records = None, []
            for k in range(most_ticks(plans, self.settings.control_period)):
                if programs.replan and k % round(CHUNK / self.settings.control_period) == 0:
                    known = going.look(lambda now: (now.loop.tracker.stage, now.loop.learned))
                    going.change(lambda now: now.loop.learned, programs.replan(belief, plans, *known))
                if plans.layer(Flywheel) is not None:
                    told = _retune(batch, models, told, _gains(going.look(lambda now: now.loop.servo)))
                controls = _ordered(controls, *going.look(lambda now: now.orders))
                steps = batch.rollout(self.substeps, controls, CONTROL, RECORD, out=steps)
                if k == 0:  # derived fields are those before a step, hence the start's
                    energy = steps["energy"][:, 0].sum(axis=-1)
                    going.change(lambda now: now.loop, _with_energy(self._nominal[0], going.leave().loop, energy))
                due = slots if (k + 1) % every == 0 else None
                if due is not None:
                    records.append(_record(world, going, steps, due))
                broken = unbuilt | np.any(batch.warning[:, :, 0] > 0, axis=1)
                going.change(lambda now: now.steps, self._steps(steps, broken))
                going.advance(k + 1, 1)
                if due is not None:
                    records[-1]["judged"] = going.look(lambda now: now.judged)[due]
                if np.all(going.look(lambda now: now.loop.running.over)):
                    break
            if (
                slots is not None and steps and not records
            ):  # all ended before the first one, which is kept for its form
                judged = going.look(lambda now: now.judged)[slots]
                records.append({**_record(world, going, steps, slots), "judged": judged})
            figures = programs.finish(world, plans, going.leave().loop)
            parts = [jax.tree.map(lambda *each: np.stack(each), *records)] if records else []
            return {name: np.asarray(values) for name, values in figures.items()}, parts

    def _models(self, world: Case) -> tuple[list[mujoco.MjModel], np.ndarray]:
        """Each row's model, and which rows MuJoCo makes no model of: the nominal one runs in their place.

        These rows are invalid; a line on the standard error says why.
        """
        models: list[mujoco.MjModel | None] = []
        reasons: dict[str, int] = {}
        for i in range(self.width):
            try:
                with warnings.catch_warnings(action="ignore", category=UserWarning):  # as of a singular inertia
                    models.append(self._model(batching.pick(world, i)))
            except InputError:
                raise
            except ValueError as error:  # of MuJoCo's compiler
                models.append(None)
                reason = " ".join(str(error).removeprefix("Error: ").split())
                reasons[reason] = reasons.get(reason, 0) + 1
        for reason, count in reasons.items():
            rows = f"{count} of {self.width} rollouts of a batch are invalid"
            print(f"sweep: note: {rows}: MuJoCo makes no model of them: {reason}", file=sys.stderr)
        unbuilt = np.array([model is None for model in models])
        stand_in = self._model(self._nominal[0]) if unbuilt.any() else None
        return [model or stand_in for model in models], unbuilt  # pyright: ignore[reportReturnType]

    def _model(self, world: Case) -> mujoco.MjModel:
        return scene.native_model(world, self.settings.native_time_step, self.settings.solid)

    def _prepare(self, arrays: tuple[Case, Case, Array], sensors_are: Sensing) -> NativePrograms:
        """The programs for the batch axes of `arrays`."""
        form = devices.form(arrays[:2]), sensors_are
        if form not in self._programs:
            made_of = "native", form, self.settings, self.limits, self.width, self.fused
            parts = program_cache.programs(made_of, jax.devices()[:1], lambda: self._compile(arrays, sensors_are))
            if isinstance(parts[0], str):
                fused_loop.give_up(self.settings, parts[0])
                self.fused = False
                return self._prepare(arrays, sensors_are)
            start, searches, tick, *rest = parts
            finish, again = (one and fused_loop.ready(one, self.width) for one in rest)
            tick = Kernel(tick) if isinstance(tick, Code) else tick
            self._programs[form] = NativePrograms(Planning.from_programs(start, searches), tick, finish, again)
        return self._programs[form]

    def rollout_outputs(self, world: Case, belief: Case, key: Array) -> Any:
        """See `Batched`: the metrics, and what C MuJoCo is told, whose answer is taken as given."""
        plan, (between, state) = self._start(sensing(world.noise), world, belief, key)
        between = between._replace(steps=jax.tree.map(jnp.zeros_like, between.steps))

        def tick(now: Between, number: Array) -> tuple[Between, Any]:
            if self._replans:
                learned = replan_rest(belief, plan, now.loop.tracker.stage, now.loop.learned)
                now = now._replace(loop=now.loop._replace(learned=learned))
            after, _ = self._tick((world, belief, plan), now, number)
            return after, (now.orders, now.loop.servo)

        numbers = 1 + jnp.arange(round(CHUNK / self.settings.control_period))
        between, told = jax.lax.scan(tick, between, numbers)
        return state, told, figures_of(world, plan, between.loop)

    def find_unread_columns(self, sides: Sides, ends: Mapping[str, tuple[float, float]]) -> set[str]:
        """See `Engine`: those, too, that change no number of MuJoCo's model from end to end."""
        unread = super().find_unread_columns(sides, ends)
        models = {c: [model_bytes(self._model(sides({c: end})[0])) for end in ends[c]] for c in sorted(unread)}
        return {c for c, (low, high) in models.items() if low == high}

    def _start(self, sensors_are: Sensing, world: Case, belief: Case, key: Array) -> tuple[Plan, tuple[Between, Start]]:
        known, plan, learned = prepare_belief(world, belief, key)
        state = start_state(world, known, plan)
        loop = init(world, known, plan, state, jnp.zeros(()), key, learned, sensors_are)
        nothing = jnp.zeros(len(accumulator.tick_metrics(world)), plan.duration.dtype)
        return plan, (self._acted(world, belief, plan, loop, self._nothing(state), nothing, jnp.int32(0)), state)

    def _tick(self, given: tuple[Case, Case, Plan], now: Between, k: Array) -> tuple[Between, dict[str, Array]]:
        world, belief, plan = given
        period = self.settings.control_period
        summary = self._summary(world, now.steps, k - 1, now.loop.seen.free)
        loop, judged = measure(world, plan, self.limits, now.loop, now.command, summary, k - 1, period)
        return self._acted(world, belief, plan, loop, now.steps, judged, k), {}

    @fused_loop.or_what_is_missing
    def _compile(self, arrays: tuple[Case, Case, Array], sensors_are: Sensing) -> tuple[Any, ...]:
        world, belief, _ = arrays
        axes, start = devices.axes((world, belief)), partial(self._start, sensors_are)

        def many(start: Callable) -> Callable:
            return jax.vmap(start, in_axes=(*axes, 0))

        by_host = self.fused and jax.default_backend() == "cpu"
        with ThreadPoolExecutor() as pool:
            batch, started = planning.start_compilation(pool, start, arrays, many, self._searches, by_host)
            plans, (between, _) = batch
            (one, known, plan), now = fused_loop.single_rollout_shapes(arrays, (plans, between))

            def made(name: str, function: Callable, given: tuple, of_one: tuple, axes: tuple) -> Eager | Compiled:
                def by_xla() -> Compiled:
                    return jax.jit(jax.vmap(function, in_axes=axes)).lower(*given).compile()

                with timed_part(name):
                    return fused_loop.eager_or(by_xla, function, *of_one) if by_host else by_xla()

            with timed_part("closed loop"):
                if self.fused:
                    ticks = pool.submit(kernel.start_compilation(self._tick, (one, known, plan), now))
                else:
                    rows = jax.vmap(lambda *of: self._tick(*of)[0], in_axes=((*axes, 0), 0, None))
                    ticks = pool.submit(jax.jit(rows).lower((world, belief, plans), between, 0).compile)
                finished = made(
                    "figures", figures_of, (world, plans, between.loop), (one, plan, now.loop), (axes[0], 0, 0)
                )
                again = None
                if self._replans:
                    given, of_it = ((x.loop.tracker.stage, x.loop.learned) for x in (between, now))
                    again = made(
                        "new plan", replan_rest, (belief, plans, *given), (known, plan, *of_it), (axes[1], 0, 0, 0)
                    )
                return *started(), ticks.result(), finished, again

    def _acted(
        self,
        world: Case,
        belief: Case,
        plan: Plan,
        loop: ClosedLoop,
        steps: Recorded,
        judged: Array,
        tick: Array,
    ) -> Between:
        """The controller's part of a tick, and what follows for the physics."""
        n, period, old = self.substeps, self.settings.control_period, loop.servo
        loop, command = act(world, belief, plan, loop, tick, period)
        told = interpolate_target(old, loop.servo, (1 + jnp.arange(n))[:, None, None] / n)
        torques = (told.stiffness * told.target + told.torque).reshape(n, N_JOINTS)
        orders = Orders(torques, *self._outside(world, tick, loop.seen.free))
        return Between(loop, command, steps, orders, judged)

    def _nothing(self, start: Start) -> Recorded:
        """Before the first physics step."""
        n, count = self.substeps, N_LEGS * len(link_names(self._nominal[0].robot))
        qpos, qvel, forces = jnp.tile(start.qpos, (n, 1)), jnp.tile(start.qvel, (n, 1)), jnp.zeros((n, N_JOINTS))
        axes, feet, centre = jnp.zeros((count, 3)), jnp.zeros((N_LEGS, 3)), jnp.zeros(3)
        return Recorded(qpos, qvel, forces, forces, jnp.zeros(()), axes, feet, centre, jnp.zeros((), bool))

    def _steps(self, steps: dict[str, np.ndarray], broken: np.ndarray) -> tuple[np.ndarray, ...]:
        """`Recorded` of a batch, from its record."""
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

    def _outside(self, world: Case, tick: Array, free: FreeState) -> tuple[Float[Array, "n 3"], Float[Array, "n w"]]:
        """The push, and the wrenches on the obstacle's free bodies, in the steps of tick number `tick`.

        The latter are those of the bodies moved on from the tick's start, `free`, as fast as they are there.
        """
        h, numbers = self.settings.native_time_step, jnp.arange(self.substeps)
        push = jax.vmap(lambda step: push_force(world.execution, step, h))(tick * self.substeps + numbers)
        ahead = h * numbers
        loads = jnp.zeros((self.substeps, 6 * len(world.obstacle.free_bodies)))
        if (
            loads.size
            and (load := jax.vmap(lambda t: world.obstacle.external_wrench(_ahead(free, t)))(ahead)) is not None
        ):
            loads = load.reshape(loads.shape)
        return push, loads

    def _summary(self, world: Case, steps: Recorded, number: Array, before: FreeState) -> Tick:
        """What the metrics want of a tick; free bodies were `before` it."""
        h, drive = self.settings.native_time_step, world.drive
        rate = steps.qvel[:, JOINT_V]
        torque = _torque(steps.actuator_force, rate, drive.back_emf)
        effort = jnp.abs(steps.actuator_force)
        limit = world.execution.torque_scale * drive.torque_limit
        power = torque * rate
        push, loads = self._outside(world, number, before)
        count = len(world.obstacle.free_bodies)
        force = -jnp.mean(steps.foot_force.reshape(-1, N_LEGS, 3), axis=0)
        bodies = body_poses(free_state(steps.qpos[-1], steps.qvel[-1], count))
        normals = surface_at(world.obstacle, steps.feet, bodies).normal
        normal = jnp.sum(force * normals, axis=-1)
        last = -jnp.sum(steps.foot_force[-1].reshape(N_LEGS, 3) * normals, axis=-1)
        seen = truth(steps.qpos[-1], steps.qvel[-1], count, last)
        outside = jnp.sum(push * steps.qvel[:, :3]) + jnp.sum(loads * _twists(steps, count))
        return Tick(
            torque_peak=jnp.max(jnp.abs(torque), axis=0).reshape(N_LEGS, 3),
            saturated=jnp.mean(effort >= 0.999 * limit, axis=0).reshape(N_LEGS, 3),
            force=force,
            normal=normal,
            tangential=jnp.linalg.norm(force - normal[:, None] * normals, axis=-1),
            residual=jnp.zeros(()),  # the C solver reports no residual force
            work=h * (jnp.sum(power) + outside),
            effort=h * jnp.sum(jnp.maximum(power, 0.0)),
            power=jnp.mean(power, axis=0).reshape(N_LEGS, 3),
            energy=jnp.where(steps.broken, jnp.nan, steps.energy),
            truth=seen,
            centre_of_mass=steps.centre_of_mass,
            joints=jnp.concatenate([steps.links.reshape(N_LEGS, -1, 3), steps.feet[:, None]], axis=1),
            bodies=bodies,
        )


def _ordered(controls: np.ndarray, torques: np.ndarray, push: np.ndarray, loads: np.ndarray) -> np.ndarray:
    """Controls, then outside wrenches on all bodies: the world, the robot from its base on, free bodies last."""
    controls[..., :N_JOINTS], controls[..., N_JOINTS + 6 : N_JOINTS + 9] = torques, push
    controls[..., controls.shape[-1] - loads.shape[-1] :] = loads
    return controls


def _ahead(free: FreeState, time: Array) -> FreeState:
    """Free bodies that went on as they do for `time` (s)."""
    return free._replace(
        position=free.position + time * free.velocity, quat=multiply(exponential(time * free.turn), free.quat)
    )


def _twists(steps: Recorded, count: int) -> Float[Array, "n 6k"]:
    """Velocities and rates of turning of the free bodies after each step, world axes."""
    free = jax.vmap(lambda q, v: free_state(q, v, count))(steps.qpos, steps.qvel)
    return jnp.concatenate([free.velocity, free.turn], axis=-1).reshape(len(steps.qpos), 6 * count)


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
    return loops._replace(running=accumulator.with_start_energy(world, loops.running, energy))


def _torque[A: (Array, np.ndarray)](effort: A, rate: A, back_emf: Any) -> A:
    """At the joints (N m), of what servos exert: to C MuJoCo back-EMF is damping of the joint, no part of that."""
    return effort - back_emf * rate


def _record(
    world: Case, going: Tiles | ByXla, steps: dict[str, np.ndarray], slots: np.ndarray
) -> dict[str, np.ndarray]:
    """What is kept of a tick of the rollouts in `slots`, before it is judged."""
    back_emf = np.broadcast_to(world.drive.back_emf, steps["qpos"].shape[:1])[slots, None, None]
    torque = _torque(steps["actuator_force"][slots], steps["qvel"][slots][..., JOINT_V], back_emf)
    told = going.look(lambda now: (now.command.joints, now.command.target, now.loop.tracker.stage))
    (joints, target, stage), n = jax.tree.map(lambda x: x[slots], told), len(slots)
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

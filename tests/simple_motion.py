"""A motion whose metrics are known, as both systems report it: for tests of shared metrics."""

from dataclasses import dataclass, replace
from types import SimpleNamespace
from typing import Any

import jax
import jax.numpy as jnp
import mujoco
import numpy as np

from sweep.config.experiment import compose
from sweep.core.metric import Metric, compute_columns
from sweep.metrics.tick import MetricContext, RolloutEnd, RolloutStart
from sweep.models.obstacles.surface import body_poses, empty_free_body_state
from sweep.models.robot import total_mass
from sweep.systems.mujoco_model.tick import ModelPartIndices, ModelRollout, ModelStart, ModelTick

CASE = compose(["scenario=walk_tripod"]).case
MASS = float(total_mass(CASE.robot))  # kg, of both
MODEL = mujoco.MjModel.from_xml_string("""<mujoco><worldbody><body><freejoint/><geom size=".1"/>
<site name="foot" size=".1"/><body><joint name="knee"/><geom size=".1"/></body></body></worldbody>
<actuator><motor name="knee" joint="knee"/></actuator><sensor><touch name="foot" site="foot"/></sensor></mujoco>""")


@dataclass(frozen=True)
class Motion:
    """Samples (t, ...) of a motion along x; the base is upright at first."""

    period: float = 0.02  # s
    position: Any = ((0.0, 0.0, 0.5),)  # m
    velocity: Any = ((0.0, 0.0, 0.0),)  # m/s
    pitch: Any = (0.0,)  # rad
    joint_rate: Any = (0.0,)  # rad/s, of one joint
    torque: Any = (0.0,)  # N m, of its drive
    foot: Any = ((0.0, 0.0, 0.0),)  # m, of one foot
    load: Any = (0.0,)  # N, on it

    def samples(self) -> "Motion":
        """The motion with all fields as arrays of equal length."""
        fields = ("position", "velocity", "pitch", "joint_rate", "torque", "foot", "load")
        arrays = {name: np.asarray(getattr(self, name), float) for name in fields}
        count = max(map(len, arrays.values()))
        return replace(self, **{name: np.broadcast_to(x, (count, *x.shape[1:])) for name, x in arrays.items()})

    @property
    def quat(self) -> np.ndarray:
        """Orientations (t, 4) of the base."""
        half, none = np.asarray(self.pitch) / 2, np.zeros(len(self.pitch))
        return np.stack([np.cos(half), none, np.sin(half), none], axis=-1)


START = Motion().samples()


def hexapod_columns(metrics: tuple[Metric, ...], motion: Motion) -> dict[str, float]:
    """Columns of the built-in robot whose first leg moves as the motion says, and whose plan leads along x."""
    motion, free, zero = motion.samples(), empty_free_body_state(), jnp.zeros(())
    plan: Any = SimpleNamespace(
        position=jnp.array([[1.0, 0.0, 0.5]]), duration=jnp.array([99.0]), swing=jnp.zeros((1, 6), bool)
    )
    base, upright = jnp.asarray(START.position[0]), jnp.asarray(START.quat[0])
    start = RolloutStart(CASE, plan, base, upright, jnp.zeros((6, 3)), free, zero)
    still: Any = SimpleNamespace(position=base, quat=upright)

    def on_first(value: Any, *shape: int) -> Any:
        return jnp.zeros(shape).at[(0,) * (len(shape) - np.ndim(value))].set(jnp.asarray(value))

    def tick(sample: dict[str, Any]) -> MetricContext:
        rate, torque = sample["joint_rate"], sample["torque"]
        truth = SimpleNamespace(
            position=sample["position"], velocity=sample["velocity"], quat=sample["quat"], rates=on_first(rate, 6, 3),
            loaded=on_first(sample["load"], 6) > 1,
        )  # fmt: skip
        report: Any = SimpleNamespace(
            actual=truth, torque_peak=on_first(abs(torque), 6, 3), joints=on_first(sample["foot"], 6, 1, 3),
            positive_work=motion.period * jnp.maximum(torque * rate, 0.0), bodies=body_poses(free),
        )  # fmt: skip
        ends = jnp.asarray(False), base, still, still, zero
        return MetricContext(CASE, plan, jnp.int32(0), zero, *ends, report, motion.period, zero)

    def step(states: Any, sample: dict[str, Any]) -> tuple[Any, None]:
        ctx = tick(sample)
        return tuple(metric.update(state, ctx) for metric, state in zip(metrics, states, strict=True)), None

    samples = {name: jnp.asarray(value) for name, value in vars(motion).items() if name != "period"}
    first = tuple(metric.begin(start) for metric in metrics)
    states, _ = jax.jit(lambda: jax.lax.scan(step, first, samples | {"quat": jnp.asarray(motion.quat)}))()
    end = RolloutEnd(CASE, plan, jnp.asarray(len(motion.position) * motion.period), jnp.int32(0))
    return {name: float(value) for name, value in compute_columns(metrics, states, end).items()}


def model_columns(
    metrics: tuple[Metric, ...], motion: Motion, number: int = 1, on_jax: bool = False
) -> dict[str, float]:
    """Columns of a MuJoCo model that moves so, reported in groups of `number` physics steps."""
    motion, xp = motion.samples(), jnp if on_jax else np
    MODEL.opt.timestep = motion.period
    spec: Any = SimpleNamespace(
        model=MODEL, base_qpos_address=0, config=SimpleNamespace(direction=(1.0, 0.0, 0.0), terrain=None),
        touch_sensors=lambda key: [0] if key == "feet" else [],
    )  # fmt: skip
    parts, count = ModelPartIndices(spec), len(motion.position)
    knee, none = motion.joint_rate[:, None], np.zeros((count, 1))
    recorded = {
        "qpos": np.concatenate([motion.position, motion.quat, none], axis=1),
        "qvel": np.concatenate([motion.velocity, np.zeros((count, 3)), knee], axis=1),
        "actuator_force": motion.torque[:, None], "actuator_velocity": knee, "sensordata": motion.load[:, None],
        "site_xpos": motion.foot[:, None], "unsolved": np.zeros(count, bool),
    }  # fmt: skip
    recorded = {name: xp.asarray(values)[None] for name, values in recorded.items()}  # of one rollout
    first = np.concatenate([START.position, START.quat, [[0.0]]], axis=1)
    start = xp.asarray(first)
    states = tuple(metric.begin(ModelStart(parts, start)) for metric in metrics)

    def update(states: Any, steps: dict[str, Any]) -> Any:
        ctx = ModelTick(parts, steps, {}, start)
        return tuple(metric.update(state, ctx) for metric, state in zip(metrics, states, strict=True))

    update = jax.jit(update) if on_jax else update
    for k in range(0, count, number):
        states = update(states, {name: values[:, k : k + number] for name, values in recorded.items()})
    last, nothing = np.asarray(recorded["qpos"][:, -1]), np.zeros(1)
    end = ModelRollout(parts, nothing + count, first, last, nothing + MASS, nothing, nothing > 0, nothing > 0)
    found = compute_columns(metrics, jax.tree.map(np.asarray, states), end)
    return {name: float(values[0]) for name, values in found.items()}


def columns_by_system(*metrics: Metric, motion: Motion) -> dict[str, dict[str, float]]:
    """Columns of a motion by system, engine and grouping, which all should be alike."""
    return {
        "hexapod": hexapod_columns(metrics, motion),
        "model, a step a report": model_columns(metrics, motion, on_jax=True),
        "model, five steps a report": model_columns(metrics, motion, number=5),
    }

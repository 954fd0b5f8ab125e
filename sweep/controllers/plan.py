"""The plan: a list of stages, and the table of arrays made from it that the tracker follows.

In a stage, some legs swing to footholds along a step cycle while the base moves along its path; the other feet stand.
All numbers may depend on the belief's parameters, so that plans can be made under vmap. The number of stages and their
names are fixed at compile time.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from sweep.controllers.frames import stance_to_frame, stance_to_world
from sweep.core.rotations import exponential, multiply, rotate
from sweep.formulas import stepping
from sweep.models.frames import WORLD_FRAME
from sweep.models.obstacles.surface import FreeBodyState
from sweep.models.posture import Stance

# swing profiles; CYCLE_B_SMOOTH is cycle B with the timing of `stepping.trapezoidal_transfer_timing`
CYCLE_A, CYCLE_B, CYCLE_B_SMOOTH, HALF_ELLIPSE = range(4)
# middle legs: as planned; as a flywheel that comes to rest; as a flywheel that balances
LOCKED, LEVELLING, BALANCE = range(3)
# progress of the base: a cubic with given rates at its ends; trapezoidal timing; as the half-ellipse swing
STEADY, SMOOTH, ELLIPTIC = range(3)
# How a stage starts. REZERO: footholds and base shifted by the measured base error. REGRIP: measured feet at their
# commanded depth. GRIP: as REGRIP, but feet on free bodies pressed in by `Stage.press`. KEEP: the commanded feet.
REZERO, REGRIP, GRIP, KEEP = "rezero", "regrip", "grip", "keep"
# Reference motion of a free body during a stage: as measured; to a velocity; to a pose; with the mean motion of all
# bodies; held at its reference at the end of the stage before; of a floating body, to a pose, but measured along y and
# in height.
MEASURED, TO_VELOCITY, TO_POSE, TOGETHER, KEPT, ALONGSIDE = range(6)
STILL, LEVEL = np.zeros(3, np.float32), np.array([1, 0, 0, 0], np.float32)
STAND = 0.5  # s, standing before the first and after the last swing


class SupportMotion(NamedTuple):
    """Reference motion of the free body (such as a ball) that carries the robot in a stage, from its measured state.

    - `TO_VELOCITY`: to a velocity and angular velocity at the end of the stage, at constant acceleration: monograph
      (3.3.5). A starting velocity into the floor counts as 0: a ball that rattles on the floor falls for some ticks,
      and would be planned to sink by millimetres.
    - `TO_POSE`: to a pose, with trapezoidal timing (lambda_1).
    - `TOGETHER`: with the mean motion of all bodies.
    - `KEPT`: stays at its last reference, so that feet pull a body back that drifts.
    """

    mode: Int[Array, "*b"] | int = MEASURED
    velocity: Float[Array, "*b 3"] | np.ndarray = STILL  # m/s
    turn: Float[Array, "*b 3"] | np.ndarray = STILL  # rad/s
    position: Float[Array, "*b 3"] | np.ndarray = STILL  # m
    quat: Float[Array, "*b 4"] | np.ndarray = LEVEL


RESTS, STAYS = SupportMotion(TO_VELOCITY), SupportMotion(KEPT)


@dataclass(frozen=True)
class Stage:
    """One stage of a plan as manoeuvres write it; fields that are None repeat the previous stage."""

    name: str
    duration: Array | float  # s
    swing: Mapping[int, Array] = field(default_factory=dict)  # leg number -> foothold (m, world)
    cycle: int = CYCLE_A  # swing profile
    # m, k^ d_y of (1.3.3), or h of the half-ellipse
    height: Array | float = 0.0
    # e of (1.3.3), the direction in which swings are lifted: one for all legs, or by leg (6, 3)
    plane: Array | np.ndarray | Sequence[float] | Sequence[Sequence[float]] = (0.0, 0.0, 1.0)
    # share of the swing that progresses evenly with the base, as in a regular gait
    carry: Array | float = 0.0
    position: Array | None = None  # m, base at the end
    turn: Array | None = None  # rad, rotation vector of the base over the stage, world axes
    pace: int = STEADY  # progress of the base
    rates: tuple[float, float] = (1.0, 1.0)  # speed of a steady base at the start and end, over its mean speed
    pivot: Array | None = None  # m, centre of the ellipse along which the base goes
    arc: Array | float = 0.0  # rad, angle covered on that ellipse, below pi; 0 is a straight line
    # Control points (2, 3) (m, world) of a swing along a cubic Bezier curve, which leaves towards the first and lands
    # from the second. For swings over edges, in place of `height` and `plane`.
    guides: Mapping[int, Array] = field(default_factory=dict)
    # leg number -> joint angles (rad), approached straight in joint space and held until the leg's next swing. A leg
    # that swings as well stands at its foothold afterwards, so these angles must reach it.
    posture: Mapping[int, Array | Sequence[float]] = field(default_factory=dict)
    flywheel: int = LOCKED  # mode of the middle legs
    # frame in which each foot stands or swings, see frames.py
    foot_frames: tuple[int, ...] = (WORLD_FRAME,) * 6
    base_frame: int = WORLD_FRAME  # frame of the base position; a body-fixed frame also turns the base
    support: tuple[SupportMotion, ...] = ()  # reference motion of every free body; empty: as measured
    law: str = ""  # name of the feedback law that guides the stage, or by which metrics find it; empty: follow the plan
    onset: str = REZERO
    # m, by which feet on a free body are commanded beyond their measured places: into the body, and towards the middle
    # plane
    press: tuple[Array | float, Array | float] = (0.0, 0.0)


class SwingCurves(NamedTuple):
    """Paths of all six feet during their swings, as arrays over S stages."""

    cycle: Int[Array, " s"]
    height: Float[Array, " s"]  # m
    plane: Float[Array, "s 6 3"]
    guides: Float[Array, "s 6 2 3"]  # m
    guided: Bool[Array, "s 6"]  # swings along Bezier curves
    carry: Float[Array, " s"]


class BasePaths(NamedTuple):
    """Path of the base and its timing in each stage, as arrays over S stages."""

    pace: Int[Array, " s"]
    rates: Float[Array, "s 2"]
    pivot: Float[Array, "s 3"]  # m
    arc: Float[Array, " s"]  # rad


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Plan:
    """A motion plan that the tracker follows: footholds, base poses and times of S stages as arrays."""

    names: tuple[str, ...] = field(metadata={"static": True})
    start: Stance
    duration: Float[Array, " s"]
    swing: Bool[Array, "s 6"]
    foothold: Float[Array, "s 6 3"]  # m, commanded, at the end of the stage
    curve: SwingCurves
    position: Float[Array, "s 3"]  # m, base at the end of the stage
    quat: Float[Array, "s 4"]  # base to world, at the start of the stage
    turn: Float[Array, "s 3"]  # rad, rotation vector of the base over the stage
    path: BasePaths
    foot_frame: Int[Array, "s 6"]
    base_frame: Int[Array, " s"]
    press: Float[Array, "s 2"]  # m
    patience: Float[Array, ""]  # s, longest wait for the touchdown of swinging feet
    layers: tuple[Any, ...] = ()  # see `sweep.controllers.layers`
    # whether base errors are corrected in the plane and in heading only
    steered: bool = field(default=False, metadata={"static": True})
    onset: tuple[str, ...] = field(default=(), metadata={"static": True})  # by stage
    laws: tuple[str, ...] = field(default=(), metadata={"static": True})  # by stage

    def find_layer[T](self, kind: type[T]) -> T | None:
        """Return the plan's tracker layer of class `kind`; None if the plan has none."""
        return next((layer for layer in self.layers if isinstance(layer, kind)), None)

    def replace_layer(self, layer: Any) -> "Plan":
        """Return the plan with this tracker layer added, or in place of its layer of the same class."""
        return replace(self, layers=(*(other for other in self.layers if not isinstance(other, type(layer))), layer))


def transform_plan(plan: Plan, quat: Float[Array, " 4"], by: Float[Array, " 3"]) -> Plan:
    """Transform a plan to other axes, for example from an obstacle's frame to the world.

    Args:
        plan: plan to transform.
        quat: rotation from the old to the new axes.
        by: shift (m) after the rotation, new axes.
    """

    def point(p: Array) -> Array:
        return rotate(jnp.broadcast_to(quat, (*p.shape[:-1], 4)), p) + by

    def vector(v: Array) -> Array:
        return rotate(jnp.broadcast_to(quat, (*v.shape[:-1], 4)), v)

    start = Stance(point(plan.start.feet), point(plan.start.position), multiply(quat, plan.start.quat))
    quats = multiply(jnp.broadcast_to(quat, plan.quat.shape), plan.quat)
    curve = plan.curve._replace(plane=vector(plan.curve.plane), guides=point(plan.curve.guides))
    path = plan.path._replace(pivot=point(plan.path.pivot))
    return replace(plan, start=start, foothold=point(plan.foothold), curve=curve, quat=quats,
                   position=point(plan.position), path=path, turn=vector(plan.turn))  # fmt: skip


def path_length(plan: Plan) -> Float[Array, ""]:
    """Return the length (m) of the base's path, with straight lines between the ends of stages."""
    points = jnp.concatenate([plan.start.position[None], plan.position])
    return jnp.sum(jnp.linalg.norm(jnp.diff(points, axis=0), axis=-1))


def swing_progress_and_lift(cycle: Int[Array, ""], carry: Array, phase: Float[Array, ""]) -> tuple[Array, Array]:
    """Return how far a swinging foot is on its way (0 to 1), and its lift over the stage's swing height, at a phase.

    Args:
        cycle: swing profile, such as `CYCLE_A`.
        carry: share of the swing that progresses evenly.
        phase: of the stage, 0 to 1.

    Returns:
        The share of the way to the foothold, and the lift in units of the stage's `height`.
    """
    x_a, y_a = stepping.swing_cycle_a(phase)
    x_b, y_b = stepping.swing_cycle_b(phase)
    smooth, _ = stepping.trapezoidal_transfer_timing(phase, 0.0, 1.0)
    share_e, y_e = stepping.half_ellipse_swing(phase)
    shares = jnp.stack(
        [0.5 + 0.5 * x_a / stepping.LANDING_RATIO, 0.5 + 0.5 * x_b / stepping.LANDING_RATIO, smooth, share_e]
    )
    share, height = shares[cycle], jnp.stack([y_a, y_b, y_b, y_e])[cycle]
    return (1 - carry) * share + carry * phase, height


def is_guided_by_law(plan: Plan, stage: Int[Array, ""], *laws: str) -> Bool[Array, ""]:
    """Return whether one of the given feedback laws guides a stage of the plan.

    Args:
        plan: the plan.
        stage: stage number.
        *laws: names of laws.
    """
    return jnp.asarray(np.isin(plan.laws, laws))[stage]


def stage_start_pose(
    plan: Plan, stage: Int[Array, ""], free: FreeBodyState
) -> tuple[Float[Array, "6 3"], Float[Array, " 3"]]:
    """Return the planned feet and base position (m) at the start of a stage, each in its own coordinate frame.

    Args:
        plan: the plan.
        stage: stage number.
        free: state of the free bodies, world axes.

    Returns:
        Feet (6, 3) and base position (3,), both m.
    """
    before = jnp.maximum(stage - 1, 0)
    feet = jnp.where(stage > 0, plan.foothold[before], plan.start.feet)
    position = jnp.where(stage > 0, plan.position[before], plan.start.position)
    frames = plan.foot_frame[before], plan.base_frame[before]
    stance = Stance(feet, position, plan.quat[before])
    stance = jax.tree.map(lambda a, b: jnp.where(stage > 0, a, b), stance_to_world(stance, *frames, free), stance)
    stance = stance_to_frame(stance, plan.foot_frame[stage], plan.base_frame[stage], free)
    return stance.feet, stance.position


def stage_end_stances(plan: Plan, free: FreeBodyState) -> Stance:
    """Return the planned stances (feet and base pose, world axes) at the ends of all S stages.

    Args:
        plan: the plan.
        free: state of the free bodies at all these moments, world axes.
    """
    last = Stance(plan.foothold, plan.position, multiply(exponential(plan.turn), plan.quat))
    return jax.vmap(stance_to_world, (0, 0, 0, None))(last, plan.foot_frame, plan.base_frame, free)


def reference_stance(
    plan: Plan,
    stage: Int[Array, ""],
    phase: Float[Array, ""],
    feet: Float[Array, "6 3"],
    position: Float[Array, " 3"],
    goal: Float[Array, "6 3"] | None = None,
) -> Stance:
    """Return the planned stance at a phase of a stage, with feet and base each in its own coordinate frame.

    The base goes along an elliptic arc about `pivot`, on a circle through equal angles for equal shares of the path; an
    arc of 0 is a straight line. Swinging feet go along a step cycle, or along a cubic Bezier curve through two control
    points, in whose hull they stay.

    Args:
        plan: the plan.
        stage: stage number.
        phase: of the stage, 0 to 1.
        feet: footholds (m) with which the stage started, (6, 3).
        position: base position (m) with which the stage started, (3,).
        goal: where swinging feet go (m), (6, 3); None: to their planned footholds.
    """
    path, curve, goal = plan.path, plan.curve, plan.foothold[stage] if goal is None else goal
    first_rate, last_rate = path.rates[stage] - 1  # over the mean rate
    steady = phase + (first_rate * (1 - phase) - last_rate * phase) * phase * (1 - phase)
    smooth, elliptic = stepping.trapezoidal_transfer_timing(phase, 0.0, 1.0)[0], stepping.half_ellipse_swing(phase)[0]
    progress = jnp.stack([steady, smooth, elliptic])[path.pace[stage]]
    quat = multiply(exponential(progress * plan.turn[stage]), plan.quat[stage])
    arc, rest = path.arc[stage], 1 - progress
    whole = jnp.sinc(arc / jnp.pi)
    near = rest * jnp.sinc(rest * arc / jnp.pi) / whole
    far = progress * jnp.sinc(progress * arc / jnp.pi) / whole
    centre = near * position + far * plan.position[stage] + (1 - near - far) * path.pivot[stage]

    share, height = swing_progress_and_lift(curve.cycle[stage], curve.carry[stage], phase)
    lift = stepping.lift_direction(goal - feet, curve.plane[stage])
    lifted = feet + share * (goal - feet) + curve.height[stage] * height * lift
    rest, near_guide, far_guide = 1 - share, curve.guides[stage][:, 0], curve.guides[stage][:, 1]
    guided = rest**3 * feet + 3 * rest**2 * share * near_guide + 3 * rest * share**2 * far_guide + share**3 * goal
    along = jnp.where(curve.guided[stage][:, None], guided, lifted)
    return Stance(jnp.where(plan.swing[stage][:, None], along, feet), centre, quat)

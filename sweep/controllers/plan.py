"""The vocabulary of manoeuvres: a plan is a list of stages, laid out as one table that a controller can follow.

In a stage some legs swing to given footholds along a step cycle while the body moves along its path; the other feet
stand. Numbers come from the belief's parameters, so that plans are built under vmap; the number of stages and their
names are fixed at compile time.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from sweep.controllers.frames import Stance, stance_to_frame, stance_to_world
from sweep.core.rotations import exponential, multiply, rotate
from sweep.formulas import stepping
from sweep.models.frames import WORLD
from sweep.models.obstacles.surface import FreeState

CYCLE_A, CYCLE_B, CYCLE_B_SMOOTH, HALF_ELLIPSE = range(4)  # swings; the third spends its way by lambda_1
LOCKED, LEVELLING, BALANCE = range(3)  # middle legs: as planned; as a flywheel that comes to rest, or that balances
STEADY, SMOOTH, ELLIPTIC = range(3)  # timing of a body path: its own rates, trapezoidal_transfer, half-ellipse swing
# How a stage begins: with footholds and base shifted by the base's error; from the feet's measured places, at their
# commanded depth or, on a free body, pressed as far beyond them as the stage says; or just from what was commanded.
REZERO, REGRIP, GRIP, KEEP = "rezero", "regrip", "grip", "keep"
# a body is: where it is seen; going over to a velocity; going to a pose; rolling along with the others; held where it
# was meant to be when the stage before ended; one that floats: going to a pose, but along the world's y axis and in
# height where it is
MEASURED, TO_VELOCITY, TO_POSE, TOGETHER, KEPT, ALONGSIDE = range(6)
STILL, LEVEL = np.zeros(3, np.float32), np.array([1, 0, 0, 0], np.float32)
STAND = 0.5  # s, before the first and after the last swing


class Support(NamedTuple):
    """How a free body is meant to move from where it is seen when a stage begins; of a plan, over S stages, k bodies.

    To the velocity (with its rate of turning) that it has at the stage's end, at constant acceleration: monograph
    (3.3.5), also to rest. Not from one into the floor: a body that chatters on it falls for a step now and then, and
    would be meant to go on and sink by millimetres. To a pose, spent by lambda_1. Together: as the mean of all bodies
    has moved and turned. Kept: not from where it is seen, so that it is pulled back there.
    """

    mode: Int[Array, "*b"] | int = MEASURED
    velocity: Float[Array, "*b 3"] | np.ndarray = STILL  # m/s
    turn: Float[Array, "*b 3"] | np.ndarray = STILL  # rad/s
    position: Float[Array, "*b 3"] | np.ndarray = STILL  # m
    quat: Float[Array, "*b 4"] | np.ndarray = LEVEL


RESTS, STAYS = Support(TO_VELOCITY), Support(KEPT)


@dataclass(frozen=True)
class Stage:
    """One stage in a manoeuvre's own words; what is left out stays as it was."""

    name: str
    duration: Array | float  # s
    swing: Mapping[int, Array] = field(default_factory=dict)  # leg number -> foothold (m, world)
    cycle: int = CYCLE_A
    height: Array | float = 0.0  # m: k^ d_y of (1.3.3), or h of the half-ellipse
    # e of (1.3.3), which lifts the swing: one for all legs, or by leg (6, 3)
    plane: Array | np.ndarray | Sequence[float] | Sequence[Sequence[float]] = (0.0, 0.0, 1.0)
    carry: Array | float = 0.0  # share of the swing's way that is made evenly, with the body, in a regular gait
    position: Array | None = None  # m, base at the end
    turn: Array | None = None  # rad, rotation vector of the base over the stage, world axes
    pace: int = STEADY
    rates: tuple[float, float] = (1.0, 1.0)  # of a steady pace at the stage's start and end, in units of its mean
    pivot: Array | None = None  # m, centre of the ellipse that the base goes along
    arc: Array | float = 0.0  # rad, how far it goes along the ellipse, below pi; 0 is straight on
    # control points (2, 3) (m, world) of a leg's swing along a cubic Bezier curve, which leaves towards the first and
    # lands from the second: for swings over edges, in place of `height` and `plane`
    guides: Mapping[int, Array] = field(default_factory=dict)
    # leg number -> joint angles (rad) that it goes to, straight in joint space, and keeps until its next swing. A leg
    # that swings as well stands at its foothold then, which these angles must reach.
    posture: Mapping[int, Array | Sequence[float]] = field(default_factory=dict)
    flywheel: int = LOCKED
    foot_frames: tuple[int, ...] = (WORLD,) * 6  # in which each foot stands or swings, see frames.py
    base_frame: int = WORLD  # of its place; a body's own axes turn its attitude, too
    support: tuple[Support, ...] = ()  # of every free body; none is said of those that are where they are seen
    law: str = ""  # that leads it, or by which metrics know it; the plan alone leads one without
    onset: str = REZERO
    # m, by how much feet on a free body are commanded beyond where they are measured: into it, and to the middle plane
    press: tuple[Array | float, Array | float] = (0.0, 0.0)


class Curves(NamedTuple):
    """How feet swing, over S stages."""

    cycle: Int[Array, " s"]
    height: Float[Array, " s"]  # m
    plane: Float[Array, "s 6 3"]
    guides: Float[Array, "s 6 2 3"]  # m
    guided: Bool[Array, "s 6"]  # which swings have guides
    carry: Float[Array, " s"]


class Ways(NamedTuple):
    """How the base's way is spent, and along what, over S stages."""

    pace: Int[Array, " s"]
    rates: Float[Array, "s 2"]
    pivot: Float[Array, "s 3"]  # m
    arc: Float[Array, " s"]  # rad


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Plan:
    """Stages as arrays over S; `names` are static."""

    names: tuple[str, ...] = field(metadata={"static": True})
    start: Stance
    duration: Float[Array, " s"]
    swing: Bool[Array, "s 6"]
    foothold: Float[Array, "s 6 3"]  # at the end of the stage, commanded
    curve: Curves
    position: Float[Array, "s 3"]  # of the base, at the end
    quat: Float[Array, "s 4"]  # of the base, at the start
    turn: Float[Array, "s 3"]
    way: Ways
    foot_frame: Int[Array, "s 6"]
    base_frame: Int[Array, " s"]
    press: Float[Array, "s 2"]  # m
    patience: Float[Array, ""]  # s, that a stage waits for its swing feet to touch down
    layers: tuple[Any, ...] = ()  # what is done besides, see `sweep.controllers.layers`
    # whether errors are taken back in the plane, with the heading's
    steered: bool = field(default=False, metadata={"static": True})
    onset: tuple[str, ...] = field(default=(), metadata={"static": True})  # of each stage
    laws: tuple[str, ...] = field(default=(), metadata={"static": True})  # of each stage

    def layer[T](self, kind: type[T]) -> T | None:
        """The one of a class, if there is one."""
        return next((layer for layer in self.layers if isinstance(layer, kind)), None)

    def with_layer(self, layer: Any) -> "Plan":
        """With this one besides, or in place of that of its class."""
        return replace(self, layers=(*(one for one in self.layers if not isinstance(one, type(layer))), layer))


def moved(plan: Plan, quat: Float[Array, " 4"], by: Float[Array, " 3"]) -> Plan:
    """The same plan in axes turned by `quat` and shifted by `by` (m): from an obstacle's frame to the world."""

    def point(p: Array) -> Array:
        return rotate(jnp.broadcast_to(quat, (*p.shape[:-1], 4)), p) + by

    def vector(v: Array) -> Array:
        return rotate(jnp.broadcast_to(quat, (*v.shape[:-1], 4)), v)

    start = Stance(point(plan.start.feet), point(plan.start.position), multiply(quat, plan.start.quat))
    turned = multiply(jnp.broadcast_to(quat, plan.quat.shape), plan.quat)
    curve = plan.curve._replace(plane=vector(plan.curve.plane), guides=point(plan.curve.guides))
    way = plan.way._replace(pivot=point(plan.way.pivot))
    return replace(plan, start=start, foothold=point(plan.foothold), curve=curve, quat=turned,
                   position=point(plan.position), way=way, turn=vector(plan.turn))  # fmt: skip


def path_length(plan: Plan) -> Float[Array, ""]:
    """Length of the base's planned way (m), from the end of one stage straight to the end of the next."""
    points = jnp.concatenate([plan.start.position[None], plan.position])
    return jnp.sum(jnp.linalg.norm(jnp.diff(points, axis=0), axis=-1))


def swing_progress(cycle: Int[Array, ""], carry: Array, u: Float[Array, ""]) -> tuple[Array, Array]:
    """Share of the way and height in units of the stage's `height`, at phase u of a swing: lambda and y' + y_s."""
    x_a, y_a = stepping.cycle_a(u)
    x_b, y_b = stepping.cycle_b(u)
    smooth, _ = stepping.trapezoidal_transfer(u, 0.0, 1.0)
    share_e, y_e = stepping.half_ellipse(u)
    shares = jnp.stack([0.5 + 0.5 * x_a / stepping.LANDING, 0.5 + 0.5 * x_b / stepping.LANDING, smooth, share_e])
    share, height = shares[cycle], jnp.stack([y_a, y_b, y_b, y_e])[cycle]
    return (1 - carry) * share + carry * u, height


def pace_progress(pace: Int[Array, ""], rates: Float[Array, " 2"], u: Float[Array, ""]) -> Array:
    """Share of a body path that is done at phase u of its stage; a steady one is the cubic with `rates` at its ends."""
    first, last = rates - 1
    steady = u + (first * (1 - u) - last * u) * u * (1 - u)
    return jnp.stack([steady, stepping.trapezoidal_transfer(u, 0.0, 1.0)[0], stepping.half_ellipse(u)[0]])[pace]


def along_arc(start: Array, end: Array, pivot: Array, arc: Array, share: Array) -> Float[Array, " 3"]:
    """Point (m) that has done `share` of the arc of `arc` rad between two radii of an ellipse about `pivot`.

    Equal shares are equal angles where the ellipse is a circle. With arc 0 the way is straight.
    """
    whole, rest = jnp.sinc(arc / jnp.pi), 1 - share
    near, far = rest * jnp.sinc(rest * arc / jnp.pi) / whole, share * jnp.sinc(share * arc / jnp.pi) / whole
    return near * start + far * end + (1 - near - far) * pivot


def along_guides(start: Array, guides: Float[Array, "*b 2 3"], end: Array, share: Array) -> Float[Array, "*b 3"]:
    """Point (m) at `share` of the cubic Bezier curve from `start` to `end` (*b, 3) with two control points between.

    The curve stays in the hull of its four points.
    """
    rest = 1 - share
    near, far = guides[..., 0, :], guides[..., 1, :]
    return rest**3 * start + 3 * rest**2 * share * near + 3 * rest * share**2 * far + share**3 * end


def led_by(plan: Plan, stage: Int[Array, ""], *laws: str) -> Bool[Array, ""]:
    """Whether the stage is under one of these laws."""
    return jnp.asarray(np.isin(plan.laws, laws))[stage]


def begins(plan: Plan, stage: Int[Array, ""], free: FreeState) -> tuple[Float[Array, "6 3"], Float[Array, " 3"]]:
    """Where feet and base (m) are in a stage's frames when it begins, had all gone as planned with bodies as `free`."""
    before = jnp.maximum(stage - 1, 0)
    feet = jnp.where(stage > 0, plan.foothold[before], plan.start.feet)
    position = jnp.where(stage > 0, plan.position[before], plan.start.position)
    frames = plan.foot_frame[before], plan.base_frame[before]
    stance = Stance(feet, position, plan.quat[before])
    stance = jax.tree.map(lambda a, b: jnp.where(stage > 0, a, b), stance_to_world(stance, *frames, free), stance)
    stance = stance_to_frame(stance, plan.foot_frame[stage], plan.base_frame[stage], free)
    return stance.feet, stance.position


def ends(plan: Plan, free: FreeState) -> Stance:
    """Where feet and base (world axes) are at the ends of all stages, over S, bodies as `free`."""
    last = Stance(plan.foothold, plan.position, multiply(exponential(plan.turn), plan.quat))
    return jax.vmap(stance_to_world, (0, 0, 0, None))(last, plan.foot_frame, plan.base_frame, free)


def reference(
    plan: Plan, stage: Int[Array, ""], u: Float[Array, ""], feet: Array, position: Array, goal: Array | None = None
) -> Stance:
    """What stage number `stage` wants at phase u (0 to 1), having begun with `feet` (6, 3) and base `position`.

    Those that swing go to `goal` (6, 3) if it is given, to their footholds else.
    """
    way, curve, goal = plan.way, plan.curve, plan.foothold[stage] if goal is None else goal
    done = pace_progress(way.pace[stage], way.rates[stage], u)
    quat = multiply(exponential(done * plan.turn[stage]), plan.quat[stage])
    centre = along_arc(position, plan.position[stage], way.pivot[stage], way.arc[stage], done)
    share, height = swing_progress(curve.cycle[stage], curve.carry[stage], u)
    lift = stepping.lift_direction(goal - feet, curve.plane[stage])
    lifted = feet + share * (goal - feet) + curve.height[stage] * height * lift
    guided = along_guides(feet, curve.guides[stage], goal, share)
    along = jnp.where(curve.guided[stage][:, None], guided, lifted)
    return Stance(jnp.where(plan.swing[stage][:, None], along, feet), centre, quat)

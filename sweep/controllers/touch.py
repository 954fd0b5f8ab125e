"""Touch: what the places where feet come to stand tell of the obstacle, and where its surface is under them.

A foot that has just come to stand is at the surface. How far inside or outside the believed surface it is, is one
equation for the obstacle's sizes; recursive least squares take in one after the other.
"""

import dataclasses
from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from sweep.controllers import frames
from sweep.controllers.frames import Stance, to_frame, to_world
from sweep.controllers.layers import HeldLegs
from sweep.controllers.observation import Observation, untold
from sweep.controllers.plan import Plan
from sweep.controllers.posture import feet_in_world
from sweep.controllers.tracker import TrackerState
from sweep.models.control import Control
from sweep.models.legs import N_LEGS
from sweep.models.noise import Noise
from sweep.models.obstacles.surface import Bodies, Obstacle, Surface, free_start, marked, placed, poses, under
from sweep.models.robot import Robot

REACH = 0.04  # m, how far a foot that finds no surface goes on beyond where it is planned
COMING = 0.5  # of a swing, from where on a foot that bears load has landed
TOO_FAR = 0.002  # m, that a foot in search of the surface may go on before it is told of the load on it
YIELD = 0.5  # of what presses a foot too much as it lands, by which it yields in a tick
CLEAR = 0.005  # m, that a foot may land outside of the planned surface; farther out it is lifted, by as much


class Touched(NamedTuple):
    """What touching has told so far."""

    obstacle: Obstacle  # as it is believed now
    first: Obstacle  # as the first plan was made for
    covariance: Float[Array, "n n"]  # of the sizes of `names`, in their units
    felt: Bool[Array, " 6"]  # which feet have come to stand since they swung
    left: Float[Array, " 6"]  # m, outwards, by which each foot's command is still to be moved; or has gone on inwards
    caution: Float[Array, ""]  # deviations, see `planned_for`


def names(obstacle: Obstacle | type[Obstacle]) -> tuple[str, ...]:
    """The obstacle's sizes that can be learned: of one that moves those that lying on the floor, or feet, tell."""
    if obstacle.free_bodies:  # pyright: ignore[reportAttributeAccessIssue]
        return obstacle.lying or obstacle.stood_on  # pyright: ignore[reportAttributeAccessIssue]
    fields = dataclasses.fields(obstacle)  # pyright: ignore[reportArgumentType]
    return tuple(f.name for f in fields if f.metadata.get("role") == "quantity")


def by_feet(obstacle: Obstacle) -> bool:
    """Whether it is feet that tell these sizes."""
    return not obstacle.free_bodies or bool(obstacle.stood_on)


def untouched(control: Control, obstacle: Obstacle) -> Touched:
    """Before anything is touched: sizes as believed, all feet where they stand."""
    sizes = _sizes(obstacle)
    covariance = jnp.diag((control.obstacle_error * sizes) ** 2)
    caution = jnp.asarray(control.caution, float)
    known = _with(obstacle, sizes)
    return Touched(known, known, covariance, jnp.ones(N_LEGS, bool), jnp.zeros(N_LEGS), caution)


def standing(
    control: Control,
    noise: Noise,
    robot: Robot,
    start: Stance,
    so_far: Touched,
    position: Float[Array, "3"],
    quat: Float[Array, "4"],
    angles: Float[Array, "6 3"],
) -> Touched:
    """What is known when feet at the places of `start` stand, seen with these joint angles (rad) and base (m)."""
    places = feet_in_world(robot, position, quat, angles)
    ground = under(so_far.obstacle, start.feet, _at_rest(so_far.first))
    out = jnp.sum((places - start.feet) * ground.normal, axis=1)
    variance = _variance(control, noise, so_far.obstacle)
    known, _ = _known(so_far, places, out, ground.normal, variance, jnp.ones(N_LEGS, bool))
    return known._replace(first=planned_for(known))


def lying(control: Control, noise: Noise, so_far: Touched, places: Float[Array, "k 3"]) -> Touched:
    """What is known when the obstacle's free bodies lie on the floor with their centres at `places` (m)."""
    bodies = _at_rest(so_far.obstacle)._replace(position=places)
    owner = tuple(range(len(so_far.obstacle.free_bodies)))

    def inside(x: Array) -> Array:
        return _with(so_far.obstacle, x).surface(places, owner, bodies).depth

    variance = control.touch_error**2 + noise.body_position_noise**2 + noise.body_position_bias**2
    return _taken_in(so_far, inside, variance, jnp.ones(len(owner), bool))[0]


def planned_for(touched: Touched) -> Obstacle:
    """The obstacle to plan for: heights that are uncertain somewhat larger than they probably are.

    A foot that comes down on what is lower than planned goes on in search of it; where it is higher, links touch its
    edge before a foot can tell.
    """
    known = names(touched.obstacle)
    deviation = jnp.sqrt(jnp.maximum(jnp.diagonal(touched.covariance), 0.0))
    more = jnp.array([name in touched.obstacle.heights for name in known]) * touched.caution * deviation
    return _with(touched.obstacle, _sizes(touched.obstacle) + more)


def planned_on(so_far: Touched, plan: Plan, stage: Int[Array, ""]) -> Surface:
    """What `plan`, the first one, was made for at a stage's footholds, free bodies as they start."""
    return frames.ground(so_far.first, plan.foothold[stage], plan.foot_frame[stage])


def felt(
    control: Control,
    noise: Noise,
    robot: Robot,
    plan: Plan,
    ground: Surface,
    state: TrackerState,
    so_far: Touched,
    seen: Observation,
    period: float,
) -> tuple[Touched, Float[Array, "6 3"], Bool[Array, " 6"]]:
    """A tick of `period` seconds on: what is known, how far footholds are to be moved (m, their frames), who searches.

    `ground` is `planned_on` in this stage: of its face a foot is taken to be, as deep in it as planned. On a free
    body all is worked out as if that were where it starts. Where sizes are uncertain, a foot is told to stand so deep
    inside the surface that it has felt, along whose normal its command goes over; one that lands before its swing is
    over yields by what it is pressed more, or, far outside of where it was to land, goes on to its place above the
    surface that it has met; one that has come to the end of its swing in the air, or stands there, goes on inwards,
    once a load would be known of, and no faster than that allows. Along the surface it stays where it is. Legs that
    are held by their joints do nothing of this, since footholds tell them nothing. Footholds of swinging feet are
    moved from where they are planned, those of the others from where they were told to be in the last tick.
    """
    stage, normal = state.stage, ground.normal
    frame, rest = plan.foot_frame[stage], free_start(so_far.first)
    free = seen.free if state.observer is None else state.observer.second

    def feet(angles: Array) -> Array:
        places = feet_in_world(robot, seen.position, seen.quat, angles)
        return to_world(to_frame(places, frame, free), frame, rest)

    places, told, began = feet(seen.angles), feet(state.joints), to_world(state.feet, frame, rest)
    out = jnp.sum((places - to_world(plan.foothold[stage], frame, rest)) * normal, axis=1)
    legs = plan.layer(HeldLegs)
    goes = jnp.ones(N_LEGS, bool) if legs is None else ~legs.held[stage]
    stands = goes & ~plan.swing[stage]
    new = stands & seen.loaded & ~so_far.felt
    known, uncertain = _known(so_far, places, out, normal, _variance(control, noise, so_far.obstacle), new)
    outwards = jnp.sum((places - began) * normal, axis=1) - ground.depth
    comes = goes & plan.swing[stage] & (state.clock >= COMING * plan.duration[stage])
    left = jnp.where(stands | comes, jnp.where(new & uncertain, outwards, so_far.left), 0.0)
    has = stands & (so_far.felt | new)
    step = control.touch_speed * period
    follows = jnp.where(has & seen.loaded, jnp.clip(left, -step, step), 0.0)
    late = comes & (state.clock >= plan.duration[stage])
    searches = ((stands & ~has) | (late & ~seen.loaded)) & uncertain & (left > -REACH)
    unknown = untold(noise, period)
    goes_on = searches & (stands | (state.clock >= plan.duration[stage] + unknown))
    onwards = jnp.where(goes_on, jnp.minimum(step, TOO_FAR * period / jnp.maximum(unknown, period)), 0.0)
    strain = jnp.sum((places - told) * normal, axis=1)  # m, by which it is held outside of where it is told to be
    pressed = YIELD / (1 + noise.delay) * (strain - ground.depth)
    back = jnp.maximum(pressed, -jnp.maximum(left, 0.0))  # to where it was planned, at most
    lifted = jnp.where(strain > 0, jnp.maximum(out + CLEAR - left, 0.0), 0.0)
    early = comes & ~late & seen.loaded & uncertain
    yields = jnp.where(early, jnp.where(out > ground.depth + CLEAR, lifted, back), 0.0)
    moved = follows - onwards
    left = jnp.where(searches, left - onwards, left - follows + yields)
    axes = rest._replace(position=jnp.zeros_like(rest.position))
    moves = to_frame(jnp.where(stands, moved, left)[:, None] * normal, frame, axes)
    return known._replace(felt=has, left=left), moves, searches


def _variance(control: Control, noise: Noise, obstacle: Obstacle) -> Array | float:
    """Variance of how far a touched place is measured off the surface (m^2)."""
    own = control.touch_error**2 + noise.position_noise**2 + noise.position_bias**2
    return own + noise.body_position_noise**2 + noise.body_position_bias**2 if obstacle.free_bodies else own


def _at_rest(obstacle: Obstacle) -> Bodies:
    """Poses of its free bodies as they start."""
    return poses(free_start(obstacle))


def _known(
    so_far: Touched,
    places: Float[Array, "6 3"],
    out: Float[Array, " 6"],
    normal: Float[Array, "6 3"],
    variance: Array | float,
    counts: Bool[Array, " 6"],
) -> tuple[Touched, Bool[Array, " 6"]]:
    """Sizes after those feet that count were found at the surface, and at which feet it was uncertain.

    `places` are outside of where they are planned by `out` (m) along the normal. What is seen of free bodies stays
    where it is, whatever the sizes.
    """
    marks = marked(so_far.first, free_start(so_far.first))

    def inside(x: Array) -> Array:
        """Taken at the planned depth: deep inside what is believed another face may be nearer."""
        planned, obstacle = places - out[:, None] * normal, _with(so_far.obstacle, x)
        return under(obstacle, planned, poses(placed(obstacle, marks))).depth - out

    return _taken_in(so_far, inside, variance, counts)


def _taken_in(
    so_far: Touched, inside: Callable[[Array], Array], variance: Array | float, counts: Bool[Array, " m"]
) -> tuple[Touched, Bool[Array, " m"]]:
    """Sizes after those points that count were found at the surface, and at which it was uncertain.

    `inside` says how deep (m) in the surface they are by given sizes.
    """
    sizes = _sizes(so_far.obstacle)
    slopes = jax.jacfwd(inside)(sizes)
    uncertain = jnp.sum((slopes @ so_far.covariance) * slopes, axis=1) > 0
    sizes, covariance = _least_squares(sizes, so_far.covariance, inside(sizes), slopes, variance, counts)
    return so_far._replace(obstacle=_with(so_far.obstacle, sizes), covariance=covariance), uncertain


def _least_squares(
    sizes: Float[Array, " n"],
    covariance: Float[Array, "n n"],
    inside: Float[Array, " m"],
    slopes: Float[Array, "m n"],
    variance: Array | float,
    counts: Bool[Array, " m"],
) -> tuple[Float[Array, " n"], Float[Array, "n n"]]:
    """Sizes and their covariance after those of m points that count were found at the surface, one after the other."""
    first = sizes
    for k in range(slopes.shape[0]):
        slope = slopes[k]
        spread = covariance @ slope
        gain = jnp.where(counts[k], spread / (slope @ spread + variance), 0.0)
        sizes = sizes - gain * (inside[k] + slope @ (sizes - first))
        covariance = covariance - gain[:, None] * spread
    return sizes, covariance


def _sizes(obstacle: Obstacle) -> Float[Array, " n"]:
    return jnp.stack([jnp.asarray(getattr(obstacle, name), float) for name in names(obstacle)])


def _with(obstacle: Obstacle, sizes: Float[Array, " n"]) -> Obstacle:
    return replace(obstacle, **{name: sizes[k] for k, name in enumerate(names(obstacle))})  # pyright: ignore

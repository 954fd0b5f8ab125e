"""Running figures of a rollout: updated once a control tick, from the same summary for both engines."""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from sweep.controllers.frames import WORLD
from sweep.controllers.plan import Plan, path_length
from sweep.controllers.tracker import Command, TrackerState
from sweep.core.rotations import conjugate, multiply, rotate
from sweep.metrics.geometry import box_corners, leg_gap, link_points, support_margin
from sweep.metrics.outcome import FREE_BODY_CAUSES, TIMED_CAUSES, Thresholds
from sweep.models.case import Case
from sweep.models.contact import to_body, to_world
from sweep.models.obstacles.surface import Bodies, FreeState, fixed_surface, poses
from sweep.models.robot import total_mass
from sweep.models.scene import GRAVITY

OVERTURNED = 60.0  # deg of tilt: nothing after it tells anything of the manoeuvre
LOADED = 5.0  # N, from which a foot carries load and its friction demand means something
LOST = ("fell", "fell_off", "unreachable")  # what the solver does after these is of no matter
TAIL = 12.0  # s, before the planned end, over which the obstacle's final speed is taken
AT_FACE = 5e-3  # m, within which a foot that may hover, since others carry, is at a face
LOAD_TIME = 0.05  # s, over which a load is averaged for the support polygon: a bounce of the feet is not a fall


class Tick(NamedTuple):
    """What an engine reports of one control tick. World axes; L links a leg, k free bodies."""

    torque_peak: Float[Array, "6 3"]  # N m, absolute
    saturated: Float[Array, "6 3"]  # share of the tick
    force: Float[Array, "6 3"]  # N, mean, on the feet
    normal: Float[Array, " 6"]  # N, mean
    tangential: Float[Array, " 6"]  # N, size of the mean
    loaded: Bool[Array, " 6"]  # at the end
    residual: Float[Array, ""]  # N, largest of the solver
    work: Float[Array, ""]  # J, of drives and pushes
    effort: Float[Array, ""]  # J, positive drive work only
    energy: Float[Array, ""]  # J, kinetic and potential, at the end
    position: Float[Array, " 3"]  # m, of the base
    quat: Float[Array, " 4"]
    velocity: Float[Array, " 3"]  # m/s, of the base
    spin: Float[Array, " 3"]  # rad/s, of the base, base axes
    angles: Float[Array, "6 3"]  # rad, of the joints
    rates: Float[Array, "6 3"]  # rad/s
    centre_of_mass: Float[Array, " 3"]  # m, of the robot
    angles: Float[Array, "6 3"]  # rad, of the joints
    joints: Float[Array, "6 k 3"]  # m, along each leg: hip, ..., knee, foot
    bodies: Bodies
    free: FreeState


class Running(NamedTuple):
    """The figures so far, and what updating them needs."""

    time: Float[Array, ""]
    over: Bool[Array, ""]  # overturned or not finite: figures are frozen
    energy_start: Float[Array, ""]
    work: Float[Array, ""]
    effort: Float[Array, ""]
    energy_gain: Float[Array, ""]
    touchdown: Float[Array, "6 3"]  # m, where each foot took hold, in its surface's body
    slip: Float[Array, ""]
    load: Float[Array, " 6"]  # N, normal, averaged
    margin: Float[Array, ""]
    torque: Float[Array, " 3"]
    saturated: Float[Array, " 3"]  # s
    friction: Float[Array, ""]
    friction_use: Float[Array, ""]  # s, integral of all feet's tangential over their normal force
    normal: Float[Array, ""]
    clearance: Float[Array, ""]
    gap: Float[Array, ""]
    tilt: Float[Array, ""]
    quat: Float[Array, " 4"]  # of the base
    feet: Float[Array, "6 3"]  # m
    heading: Float[Array, ""]
    shortfall: Float[Array, ""]
    position_error: Float[Array, ""]
    residual: Float[Array, ""]
    start: Float[Array, " 3"]
    position: Float[Array, " 3"]
    travel: Float[Array, ""]  # m, along the planned direction while the plan moves the base
    travel_time: Float[Array, ""]
    body_start: Float[Array, "k 3"]  # m, of the obstacle's free bodies
    body: Float[Array, "k 3"]  # m
    body_tail: Float[Array, "k 3"]  # m, when the tail began
    tail_time: Float[Array, ""]
    body_moved: Float[Array, ""]
    body_aside: Float[Array, ""]
    ride_height: Float[Array, ""]
    finished: Bool[Array, ""]
    finite: Bool[Array, ""]
    cause_time: Float[Array, " c"]  # s, first crossing of each timed cause's threshold, NaN before
    cause_stage: Int[Array, " c"]


def begin(
    world: Case, plan: Plan, position: Float[Array, " 3"], feet: Float[Array, "6 3"], free: FreeState,
    energy: Float[Array, ""],
) -> Running:  # fmt: skip
    """Nothing has happened yet."""
    bodies = poses(free)
    dtype = plan.duration.dtype
    zero, far = jnp.zeros((), dtype), jnp.full((), jnp.inf, dtype)
    three = jnp.zeros(3, dtype)
    no, yes = jnp.asarray(False), jnp.asarray(True)
    n = len(TIMED_CAUSES)
    return Running(
        time=zero, over=no, energy_start=energy, work=zero, effort=zero, energy_gain=zero,
        touchdown=to_body(feet, world.obstacle.surface(feet, (-1,) * 6, bodies).body, bodies), slip=zero,
        load=jnp.full(6, 2 * LOADED, dtype), margin=far, torque=three, saturated=three, friction=zero,
        friction_use=zero, normal=zero,
        clearance=far, gap=far, tilt=zero, quat=plan.start.quat, feet=feet, heading=zero, shortfall=zero,
        position_error=zero, residual=zero,
        start=position, position=position, travel=zero, travel_time=zero,
        body_start=free.position, body=free.position, body_tail=free.position, tail_time=zero, body_moved=zero,
        body_aside=zero, ride_height=far if free.position.shape[0] else zero, finished=no, finite=yes,
        cause_time=jnp.full(n, jnp.nan, dtype), cause_stage=jnp.full(n, -1, jnp.int32),
    )  # fmt: skip


def update(
    world: Case, plan: Plan, limits: Thresholds, state: TrackerState, command: Command, running: Running, tick: Tick,
    period: float,
) -> Running:  # fmt: skip
    """One control tick on."""
    robot = world.robot
    stage = state.stage
    swinging = plan.swing[stage] & ~state.finished
    touchdown, slip = _slip(world, running.touchdown, swinging, command.phase, tick)
    tilt, heading = _attitude(tick.quat, command.target.quat)
    corners = rotate(tick.quat[None], box_corners(
        0.5 * jnp.stack([jnp.asarray(s, tilt.dtype) for s in (robot.body_length, robot.body_width, robot.body_height)])
    )) + tick.position  # fmt: skip
    points = jnp.concatenate([link_points(tick.joints), corners])
    depth = world.obstacle.surface(points, (-1,) * points.shape[0], tick.bodies).depth
    radius = jnp.full(points.shape[0], robot.link_radius).at[-8:].set(0.0)
    weight = GRAVITY * total_mass(robot)
    demand = jnp.where(tick.normal > LOADED, tick.tangential / jnp.maximum(tick.normal, LOADED), 0.0)
    way = plan.position[stage] - state.position
    length = jnp.linalg.norm(way)
    moving = (length > 1e-6) & ~state.finished
    direction = way / jnp.maximum(length, 1e-6)
    work = running.work + tick.work
    gain = tick.energy - running.energy_start - work
    lost = np.array([TIMED_CAUSES.index(cause) for cause in LOST])
    fallen = jnp.any(~jnp.isnan(running.cause_time[lost]))
    load = running.load + min(1.0, period / LOAD_TIME) * (tick.normal - running.load)
    margin = support_margin(tick.joints[:, -1, :2], load > LOADED, tick.centre_of_mass[:2])
    new = running._replace(
        time=running.time + period,
        work=work,
        effort=running.effort + tick.effort,
        energy_gain=jnp.maximum(running.energy_gain, jnp.where(fallen, 0.0, gain)),
        touchdown=touchdown,
        slip=jnp.maximum(running.slip, slip),
        load=load,
        margin=jnp.minimum(running.margin, margin),
        torque=jnp.maximum(running.torque, jnp.max(tick.torque_peak, axis=0)),
        saturated=running.saturated + period * jnp.mean(tick.saturated, axis=0),
        friction=jnp.maximum(running.friction, jnp.max(demand)),
        friction_use=running.friction_use
        + period * jnp.sum(tick.tangential) / jnp.maximum(jnp.sum(tick.normal), LOADED),
        normal=jnp.maximum(running.normal, jnp.max(tick.normal) / weight),
        clearance=jnp.minimum(running.clearance, jnp.min(-depth - radius)),
        gap=jnp.minimum(running.gap, leg_gap(tick.joints[:, -3:]) - 2 * robot.link_radius),
        tilt=jnp.maximum(running.tilt, tilt),
        quat=tick.quat,
        feet=tick.joints[:, -1],
        heading=jnp.maximum(running.heading, heading),
        shortfall=jnp.maximum(running.shortfall, command.shortfall),
        position_error=jnp.maximum(running.position_error, jnp.linalg.norm(tick.position - command.target.position)),
        residual=jnp.maximum(running.residual, jnp.where(fallen, 0.0, tick.residual)),
        position=tick.position,
        travel=running.travel + jnp.where(moving, (tick.position - running.position) @ direction, 0.0),
        travel_time=running.travel_time + jnp.where(moving, period, 0.0),
        **_free_bodies(plan, running, tick),
        finished=state.finished,
        finite=jnp.isfinite(tick.energy) & jnp.all(jnp.isfinite(tick.joints)),
    )
    unheld = imbalance(plan) > limits.imbalance_max
    new = _note_causes(limits, new, stage, unheld)
    new = new._replace(over=(new.tilt > OVERTURNED) | ~new.finite | jnp.any(unheld))
    frozen = [jnp.where(running.over, old, fresh) for old, fresh in zip(running, new, strict=True)]
    return Running(*frozen)


def _free_bodies(plan: Plan, running: Running, tick: Tick) -> dict[str, Array]:
    """What the obstacle's free bodies have done; the first one is that on which the robot rides."""
    body = tick.free.position
    if not body.shape[0]:
        return {}
    way = body - running.body_start
    before_tail = running.time < jnp.sum(plan.duration) - TAIL
    return {
        "body": body,
        "body_tail": jnp.where(before_tail, body, running.body_tail),
        "tail_time": jnp.where(before_tail, running.time, running.tail_time),
        "body_moved": jnp.maximum(running.body_moved, jnp.max(jnp.linalg.norm(way, axis=-1))),
        "body_aside": jnp.maximum(running.body_aside, jnp.abs(way[0, 1])),
        "ride_height": jnp.minimum(running.ride_height, tick.position[2] - body[0, 2]),
    }


def _slip(world: Case, touchdown: Array, swinging: Array, phase: Array, tick: Tick) -> tuple[Array, Array]:
    """Touchdown points, and the largest distance of a standing foot from its own.

    A foot takes hold when it is first loaded in the second half of its swing; a standing foot that is unloaded for a
    moment keeps its touchdown point, so that chattering along does not hide a slip.
    """
    feet = tick.joints[:, -1]
    body = world.obstacle.surface(feet, (-1,) * 6, tick.bodies).body
    free = swinging & ~(tick.loaded & (phase > 0.5))
    here = to_body(feet, body, tick.bodies)
    touchdown = jnp.where(free[:, None], here, touchdown)
    held = to_world(touchdown, body, tick.bodies)
    slip = jnp.where(~free & tick.loaded, jnp.linalg.norm(feet - held, axis=-1), 0.0)
    return touchdown, jnp.max(slip)


def _attitude(quat: Array, wanted: Array) -> tuple[Array, Array]:
    """Tilt of the base from its commanded vertical, and the turn about it (deg)."""
    off = multiply(conjugate(wanted), quat)
    w, _, _, z = off
    return _from_level(off), jnp.degrees(jnp.abs(2 * jnp.arctan2(z * jnp.sign(w), jnp.abs(w))))


def _from_level(quat: Array) -> Float[Array, ""]:
    """Angle between the vertical and what `quat` makes of it (deg)."""
    w, x, y, z = quat
    return jnp.degrees(jnp.arctan2(jnp.sqrt(x**2 + y**2 + 1e-14), jnp.sqrt(w**2 + z**2 + 1e-14)) * 2)


def _on_target(world: Case, plan: Plan, feet: Float[Array, "6 3"]) -> Int[Array, ""]:
    """How many feet are at the face of the obstacle, which has no free bodies, on which the last footholds are."""
    here, there = (fixed_surface(world.obstacle, p) for p in (feet, plan.foothold[-1]))
    return jnp.sum((here.face == there.face) & (here.depth > -AT_FACE)).astype(jnp.int32)


def imbalance(plan: Plan) -> Float[Array, " s"]:
    """What planned forces leave of the weight in each stage; nothing where none are planned."""
    return jnp.zeros_like(plan.duration) if plan.grip is None else plan.grip.imbalance


def _note_causes(limits: Thresholds, running: Running, stage: Array, unheld: Bool[Array, " s"]) -> Running:
    """Remember when, and in which stage, each timed cause first crossed its threshold.

    A stance that the planner cannot hold is known from the start, with the stage that it belongs to.
    """
    crossed = jnp.stack([
        running.tilt > limits.tilt_max_deg,
        running.slip > limits.slip_max_m,
        running.shortfall > limits.reach_shortfall_max_m,
        running.clearance < limits.clearance_min_m,
        running.gap < limits.leg_gap_min_m,
        running.heading > limits.heading_error_max_deg,
        running.ride_height < limits.ride_height_min_m,
        running.body_moved > limits.obstacle_moved_max_m,
        jnp.any(unheld),
    ])  # fmt: skip
    first = crossed & jnp.isnan(running.cause_time)
    stage = jnp.full_like(running.cause_stage, stage).at[-1].set(jnp.argmax(unheld).astype(jnp.int32))
    return running._replace(
        cause_time=jnp.where(first, running.time, running.cause_time),
        cause_stage=jnp.where(first, stage, running.cause_stage),
    )


def figures(world: Case, plan: Plan, running: Running, stage: Int[Array, ""]) -> dict[str, Array]:
    """The row's figures by column name, units in the name."""
    length = path_length(plan)
    left = jnp.linalg.norm(running.position - plan.position[-1])
    goes = (length > 1e-6) & (plan.base_frame[-1] == WORLD)  # on a free body the goal is a motion, not a place
    progress = jnp.where(goes, 1 - left / jnp.maximum(length, 1e-6), 1.0)
    time = jnp.maximum(running.time, 1e-9)
    out = {
        "finite": running.finite,
        "finished": running.finished,
        "end_stage": stage,
        "duration_s": running.time,
        "progress": progress,
        "distance_m": jnp.linalg.norm((running.position - running.start)[:2]),
        "speed_mps": running.travel / jnp.maximum(running.travel_time, 1e-9),
        "tilt_max_deg": running.tilt,
        "end_tilt_deg": _from_level(running.quat),
        "heading_error_max_deg": running.heading,
        "position_error_max_m": running.position_error,
        "reach_shortfall_max_m": running.shortfall,
        "slip_max_m": running.slip,
        "stability_margin_min_m": running.margin,
        "friction_demand_max": running.friction,
        "friction_demand_mean": running.friction_use / time,
        "normal_max_over_weight": running.normal,
        "clearance_min_m": running.clearance,
        "leg_gap_min_m": running.gap,
        "energy_j": running.effort,
        "energy_gain_max_j": running.energy_gain,
        "solver_residual_max_n": running.residual,
        "imbalance_max": jnp.max(imbalance(plan)),
    }
    if running.body.shape[0]:
        along = (running.body - running.body_tail)[0, :2] / jnp.maximum(running.time - running.tail_time, 1e-9)
        out["obstacle_moved_m"], out["ride_height_min_m"] = running.body_moved, running.ride_height
        out["obstacle_x_m"], out["obstacle_y_m"] = running.body[0, :2]
        out["obstacle_aside_max_m"] = running.body_aside  # sideways of the world's x axis
        out["obstacle_speed_mps"] = jnp.linalg.norm(along)  # mean over the last TAIL seconds
    else:
        out["feet_on_target"] = _on_target(world, plan, running.feet)
    for k, joint in enumerate(("alpha", "beta", "gamma")):
        out[f"torque_peak_{joint}_nm"] = running.torque[k]
        out[f"saturation_share_{joint}"] = running.saturated[k] / time
    for k, cause in enumerate(TIMED_CAUSES):
        if cause in FREE_BODY_CAUSES and not running.body.shape[0]:
            continue
        out[f"{cause}_time_s"] = running.cause_time[k]
        out[f"{cause}_stage"] = running.cause_stage[k]
    return out

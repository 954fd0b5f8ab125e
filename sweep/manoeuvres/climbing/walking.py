"""Walking up to an obstacle and away from it by tripod, along -y unless said otherwise."""

from collections.abc import Mapping
from dataclasses import replace
from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float

from sweep.controllers.plan import CYCLE_B, Stage
from sweep.core.rotations import IDENTITY, rotate
from sweep.models.case import Case
from sweep.models.posture import Stance, foot_centres
from sweep.planning.gaits import TRIPOD, GaitStep, initial_foot_offsets, regular_gait_stages


class WalkingDirection(NamedTuple):
    """Direction of the base's x axis and of the walk, in world axes."""

    quat: tuple[float, float, float, float]  # base to world
    forward: tuple[float, float, float]


FACING_MINUS_Y = (0.5**0.5, 0.0, 0.0, -(0.5**0.5))  # base to world: x axis of the base along -y, z axis up
ALONG_Y = WalkingDirection(FACING_MINUS_Y, (0.0, -1.0, 0.0))
AHEAD = WalkingDirection(IDENTITY, (1.0, 0.0, 0.0))
REST_TO_REST = (0.0, 0.0)  # rates of a base path that starts and ends at rest, as swings do


def foot_offsets_from_base(
    belief: Case, spread: Array | float, height: Array | float, facing: WalkingDirection = ALONG_Y
) -> Float[Array, "6 3"]:
    """Return the feet relative to the base (m, world axes), each at the same offset from its hip.

    Args:
        belief: has the robot.
        spread: distance of feet outward from their hips (m).
        height: distance of feet below their hips (m).
        facing: direction in which the robot looks.
    """
    return rotate(jnp.array(facing.quat)[None], foot_centres(belief.robot, spread, height))


def approach_stages(
    belief: Case,
    step: GaitStep,
    arrival: Float[Array, " 3"],
    spread: Array | float,
    places: Mapping[int, Array],
    steps: int,
    gap: Array | float = 0.0,
) -> tuple[Stance, list[Stage]]:
    """Return the start stance and the plan stages of a tripod walk whose last swings end at given footholds.

    The base walks to a point `gap` (m) before its arrival, and covers the rest while the feet go to their places.

    Args:
        belief: has the robot.
        step: the regular step.
        arrival: base position (m) on arrival.
        spread: distance of feet outward from their hips (m).
        places: leg number -> foothold on arrival (m).
        steps: number of swings.
        gap: m.
    """
    forward, home = jnp.array(ALONG_Y.forward), foot_offsets_from_base(belief, spread, arrival[2])
    position = arrival - (gap + 2 * step.half_swing_length * steps) * forward
    feet = position + home + initial_foot_offsets(TRIPOD, step, forward)
    start = Stance(feet, position, jnp.array(FACING_MINUS_Y))
    stages = regular_gait_stages(TRIPOD, step, start, home, forward, steps, 0.0)
    for k, legs in enumerate(TRIPOD):
        centre = arrival - (1 - k) * gap / 2 * forward
        name = f"place.{'-'.join(map(str, legs))}"
        stages.append(Stage(name, step.time, {leg: places[leg] for leg in legs}, CYCLE_B, step.height,
                            position=centre))  # fmt: skip
    return start, stages


def departure_stages(
    belief: Case,
    step: GaitStep,
    position: Float[Array, " 3"],
    spread: Array | float,
    clearance: Array | float,
    steps: int,
    facing: WalkingDirection = ALONG_Y,
) -> tuple[list[Stage], list[Stage]]:
    """Return the plan stages that bring the feet into a tripod gait and walk away.

    Args:
        belief: has the robot.
        step: the regular step.
        position: base position (m) from which the robot walks.
        spread: distance of feet outward from their hips (m).
        clearance: of the hips above the ground (m).
        steps: number of swings.
        facing: direction in which the robot looks and walks.
    """
    forward, home = jnp.array(facing.forward), foot_offsets_from_base(belief, spread, clearance, facing)
    feet = position + home + initial_foot_offsets(TRIPOD, step, forward)
    stages = []
    for legs in TRIPOD:
        name = f"away.{'-'.join(map(str, legs))}"
        stages.append(Stage(name, 1.5 * step.time, {leg: feet[leg - 1] for leg in legs}, CYCLE_B, 2 * step.height,
                            position=position, rates=REST_TO_REST))  # fmt: skip
    walk = regular_gait_stages(TRIPOD, step, Stance(feet, position, jnp.array(facing.quat)), home, forward, steps, 0.0)
    return stages, [replace(stage, name=f"away.{stage.name}") for stage in walk]

"""Across a narrow beam by diagonal gait, with the straight middle legs balancing as a flywheel (monograph 2.6).

World axes: the beam lies along y and the robot comes along -y. The book's xi, eta, zeta are x, y, z.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import ClassVar, NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from sweep.controllers.flywheel import FlywheelGains
from sweep.controllers.plan import BALANCE, CYCLE_B, LEVELLING, LOCKED, SMOOTH, STAND, Plan, Stage
from sweep.core.parameters import choice, count, parameters, quantity
from sweep.formulas.leg import SIDE_BY_LEG
from sweep.manoeuvres.climbing.walking import FACING_MINUS_Y
from sweep.manoeuvres.goals import ARRIVED, UPRIGHT
from sweep.models.case import Case, Manoeuvre
from sweep.models.legs import LEGS
from sweep.models.obstacles.beam import Beam
from sweep.models.obstacles.charts import stack_components
from sweep.models.posture import Stance, joint_targets, leg_mounts
from sweep.models.robot import Robot
from sweep.planning.compile_plan import compile_plan
from sweep.planning.gaits import TRIPOD, GaitStep, initial_foot_offsets, regular_gait_stages

DIAGONALS = ((1, 6), (2, 5))
MIDDLE = (3, 4)
IS_MIDDLE = np.isin(np.array(LEGS), MIDDLE)
# joint angles of middle legs that are stretched out to the sides
LEVEL_LEGS = {3: (0.0, np.pi / 2, 0.0), 4: (0.0, np.pi / 2, np.pi)}
FORWARD = (0.0, -1.0, 0.0)


class BeamGeometry(NamedTuple):
    """Positions of feet and base on a beam, from which plan stages are made."""

    robot: Robot
    ground: Array | float  # m, h_1, height of the ledges and the beam's top
    clearance: Array | float  # m, height of the hips above them
    track: Array | float  # m, xi_b, the narrow track
    deepening: Array | float  # m, epsilon
    step: GaitStep

    def base_position_at(self, y: Array | float) -> Float[Array, " 3"]:
        """Return the planned position of the base (m) at coordinate `y` along the beam."""
        return stack_components(0.0, y, self.ground + self.clearance)

    def foot_positions_at(self, y: Array | float, track: Array | float) -> Float[Array, "6 3"]:
        """Return foot positions (m) beside the hips, each `track` (m) from the middle line, for a base at y."""
        depth = jnp.full(6, self.ground - self.deepening)
        return jnp.stack(
            [SIDE_BY_LEG * jnp.asarray(track, float), y - leg_mounts(self.robot).hips[:, 0], depth], axis=-1
        )

    def swing_stage(self, name: str, legs: Sequence[int], feet: Float[Array, "6 3"], **more) -> Stage:
        """Return a plan stage in which the given legs step to their positions in `feet`."""
        return Stage(name, self.step.time, rows_by_leg(feet, legs), CYCLE_B, self.step.height, **more)

    def joint_angles(self, y: Array | float, feet: Float[Array, "6 3"]) -> Float[Array, "6 3"]:
        """Return the joint angles (rad) that put the feet at given positions, for a base at y."""
        return joint_targets(self.robot, Stance(feet, self.base_position_at(y), jnp.array(FACING_MINUS_Y)))[0]

    def stretched_foot_positions(self, y: Array | float) -> Float[Array, "6 3"]:
        """Return the feet of straight legs (m), level and out to the sides, for a base at y."""
        robot = self.robot
        feet = self.foot_positions_at(y, robot.body_width / 2 + robot.coxa + robot.thigh + robot.shin)
        return feet.at[:, 2].set(self.ground + self.clearance)

    def joint_angles_beside_hips(self, out: Array | float, down: Array | float) -> Float[Array, "6 3"]:
        """Return the joint angles (rad) with every foot `out` (m) outward from its hip and `down` (m) below it."""
        feet = self.foot_positions_at(0.0, self.robot.body_width / 2 + out)
        return self.joint_angles(0.0, feet.at[:, 2].set(self.ground + self.clearance - down))


@parameters
class BeamWalk(Manoeuvre):
    """Walk along a beam on the front and rear legs, and balance with the spread middle legs.
    Ratios are to the body length a_r."""

    goal: ClassVar = ARRIVED
    kind: str = choice("beam_walk", "beam_walk")
    flywheel: str = choice("on", "on", "off")  # whether the middle legs balance the body; off: they stay as they are
    steps: int = count(16, at_least=0, at_most=100)  # number of swings of a diagonal pair
    # distance of the feet from the beam's edges: xi_b is its width less twice that
    inset: float = quantity(0.0125, "m", at_least=0)
    half_step_ratio: float = quantity(0.1, "a_r", above=0, at_most=0.5)  # d_x, half the length of a swing
    lift_ratio: float = quantity(0.03, "a_r", above=0, at_most=0.5)  # d_y, height of a swing
    height_ratio: float = quantity(0.58, "a_r", above=0, at_most=2)  # height of the hips above the beam
    rate: float = quantity(6.0, "rad/s", above=0, at_most=20)  # varpi, rate of the swings, which gives their time t*
    deepening: float = quantity(5e-3, "m", at_least=0, at_most=0.05)  # epsilon, depth of footholds below the beam's top
    patience: float = quantity(0.1, "s", at_least=0)  # longest wait for a touchdown
    c1: float = quantity(5000.0, "N/m")  # force for each metre of the mass centre's distance from its planned line
    c2: float = quantity(400.0, "N*s/m")  # force against the mass centre's lateral speed
    c3: float = quantity(-5e4, "N*m/rad", at_most=0)  # torque by which leg 4 follows leg 3, for each radian
    c4: float = quantity(547.215, "N*m*s/rad", at_least=0)  # printed with a minus, which gives no damping
    c5: float = quantity(-6.25, "N*m/rad")  # torque on leg 3 towards its rest while four feet stand, for each radian
    c6: float = quantity(10.067, "N*m*s/rad")  # printed with a minus, which gives no damping

    needs = (Beam,)

    def plan(self, belief: Case) -> Plan:
        """Return the plan: stand, `steps` swings with base motions between them, step into the final stance, stand.

        At the end the middle legs are held where they are, since the law that levels them takes c_6/-c_5, 1.6 s in
        print.
        """
        site = self.beam_geometry(belief)
        start = -belief.robot.body_length / 2 - 2 * site.step.half_swing_length
        stages = [Stage("stand", STAND, posture=LEVEL_LEGS, flywheel=self.select_flywheel_mode(LEVELLING))]
        stages += self.diagonal_stages(site, start, 2 * site.step.half_swing_length)
        stages += [Stage("rest", STAND, flywheel=self.select_flywheel_mode(LEVELLING)), Stage("halt", STAND)]
        feet = jnp.where(
            IS_MIDDLE[:, None], site.stretched_foot_positions(start), site.foot_positions_at(start, site.track / 2)
        )
        stance = Stance(feet, site.base_position_at(start), jnp.array(FACING_MINUS_Y))
        return compile_plan(stance, stages, self.patience, self.flywheel_gains(belief), steered=True)

    def beam_geometry(self, belief: Case) -> BeamGeometry:
        """Return the believed geometry of robot and beam, from which plan stages are made."""
        length = belief.robot.body_length
        step = GaitStep.from_ratios(length, self.half_step_ratio, self.lift_ratio, self.rate)
        track = belief.obstacle_of_type(Beam).width - 2 * self.inset
        return BeamGeometry(
            belief.robot, belief.obstacle_of_type(Beam).height, self.height_ratio * length, track, self.deepening, step
        )

    def flywheel_gains(self, belief: Case) -> FlywheelGains:
        """Return the feedback gains of the middle legs, which balance the robot like a flywheel."""
        return FlywheelGains(self.c1, self.c2, self.c3, self.c4, self.c5, self.c6, belief.drive.back_emf)

    def select_flywheel_mode(self, wanted: int) -> int:
        """Return the mode of the balancing middle legs: `wanted`, or `LOCKED` if balancing is switched off."""
        return wanted if self.flywheel == "on" else LOCKED

    def diagonal_stages(self, site: BeamGeometry, start: Array | float, way: Array | float) -> list[Stage]:
        """Return the plan stages on the beam: diagonal leg pairs swing in turn, and the base moves between (2.6.2).

        While a pair swings, the mass centre is over the line of the other two feet, which are beside their hips. While
        the base moves, the middle legs come to rest.

        Args:
            site: geometry of robot and beam.
            start: y of the base at the start (m).
            way: motion of the base after each swing (m).
        """
        stages, y, rest = [], start, self.select_flywheel_mode(LEVELLING)
        for k in range(self.steps):
            pair = DIAGONALS[k % 2]
            goal = site.foot_positions_at(y - way, site.track / 2)
            name = f"{k + 1}.{'-'.join(map(str, pair))}"
            y = y - way
            stages += [
                site.swing_stage(name, pair, goal, flywheel=self.select_flywheel_mode(BALANCE)),
                Stage(
                    f"{k + 1}.body", 2 * site.step.time, position=site.base_position_at(y), pace=SMOOTH, flywheel=rest
                ),
            ]
        last, goal = DIAGONALS[self.steps % 2], site.foot_positions_at(y, site.track / 2)
        stages.append(site.swing_stage("close", last, goal, flywheel=self.select_flywheel_mode(BALANCE)))
        return stages


@parameters
class BeamCross(BeamWalk):
    """Cross a beam between two ledges: by tripod to the edge, along the beam with spread middle legs, on by tripod.

    `steps` swings divide the path on the narrow track evenly, from `margin` before the first edge to `margin` behind
    the second.
    """

    goal: ClassVar = UPRIGHT
    kind: str = choice("beam_cross", "beam_cross")
    steps: int = count(17, at_least=1, at_most=100)  # number of swings of a diagonal pair on the beam
    approach: int = count(2, at_least=0, at_most=50)  # number of swings by tripod to the edge
    walk_step_ratio: float = quantity(0.08, "a_r", above=0, at_most=0.5)  # d_x, half the length of these swings
    departure: int = count(4, at_least=0, at_most=50)  # number of swings by tripod away from it
    wide_track: float = quantity(0.7852, "m", above=0)  # 2 x_f, distance between left and right feet on the ledges
    margin: float = quantity(0.12, "m", at_least=0)  # distance between feet and edge
    transfer_lift: float = quantity(0.1, "m", above=0)  # lift of feet that change the track

    def plan(self, belief: Case) -> Plan:
        """Return the plan: stand, approach, narrow track, spread middle legs, cross, fold them, wide track, depart,
        halt."""
        site = self.beam_geometry(belief)
        reach = belief.robot.body_length / 2 + self.margin
        far = -belief.obstacle_of_type(Beam).length - reach
        start, stages = self.tripod_approach_stages(site, reach)
        stages += [
            *track_width_change_stages(site, reach, site.track, self.transfer_lift, "narrow"),
            *self.leg_spreading_stages(site, reach),
            *self.diagonal_stages(site, reach, (reach - far) / self.steps),
            Stage("rest", STAND, flywheel=self.select_flywheel_mode(LEVELLING)),
            *self.leg_folding_stages(site, far),
            *track_width_change_stages(site, far, self.wide_track, self.transfer_lift, "wide"),
        ]
        stance = Stance(
            site.foot_positions_at(far, self.wide_track / 2), site.base_position_at(far), jnp.array(FACING_MINUS_Y)
        )
        departure = self.tripod_stages(self.tripod_geometry(site), stance, self.departure)
        stages += [replace(stage, name=f"depart.{stage.name}") for stage in departure]
        return compile_plan(
            start, [*stages, Stage("halt", STAND)], self.patience, self.flywheel_gains(belief), steered=True
        )

    def tripod_approach_stages(self, site: BeamGeometry, y: Array | float) -> tuple[Stance, list[Stage]]:
        """Return the start stance, and tripod stages that bring the base to `y` and the feet beside the hips."""
        site, forward = self.tripod_geometry(site), jnp.array(FORWARD)
        step = site.step
        first = y + 2 * step.half_swing_length * self.approach
        feet = site.foot_positions_at(first, self.wide_track / 2) + initial_foot_offsets(TRIPOD, step, forward)
        start = Stance(feet, site.base_position_at(first), jnp.array(FACING_MINUS_Y))
        stages = [Stage("stand", STAND), *self.tripod_stages(site, start, self.approach)]
        goal = site.foot_positions_at(y, self.wide_track / 2)
        return start, stages + [site.swing_stage(f"place.{'-'.join(map(str, legs))}", legs, goal) for legs in TRIPOD]

    def tripod_geometry(self, site: BeamGeometry) -> BeamGeometry:
        """Return the beam geometry with the step length of the tripod gait on the ledges."""
        return site._replace(step=site.step._replace(half_length=self.walk_step_ratio * site.robot.body_length))

    def tripod_stages(self, site: BeamGeometry, start: Stance, number: int) -> list[Stage]:
        """Return plan stages in which the tripods step in turn, with the feet as far apart as on the ledges."""
        centres = site.foot_positions_at(0.0, self.wide_track / 2) - site.base_position_at(0.0)
        return regular_gait_stages(TRIPOD, site.step, start, centres, jnp.array(FORWARD), number, 0.0)

    def leg_spreading_stages(self, site: BeamGeometry, y: Array | float) -> list[Stage]:
        """Return the plan stages in which the middle legs are lifted, moved outward and stretched: monograph 2.6.1."""
        raised, out = self.intermediate_leg_postures(site, y)
        return [*middle_leg_stages(site, "out", (raised, out)), Stage("out.3", site.step.time, posture=LEVEL_LEGS)]

    def leg_folding_stages(self, site: BeamGeometry, y: Array | float) -> list[Stage]:
        """Return the plan stages in which the stretched middle legs are put back on the beam: monograph 2.6.3."""
        raised, out = self.intermediate_leg_postures(site, y)
        feet = site.foot_positions_at(y, site.track / 2)
        angles = rows_by_leg(site.joint_angles(y, feet), MIDDLE)
        down = Stage("down.3", site.step.time, rows_by_leg(feet, MIDDLE), posture=angles)
        return [*middle_leg_stages(site, "down", (out, raised)), down]

    def intermediate_leg_postures(self, site: BeamGeometry, y: Array | float) -> tuple[Array, Array]:
        """Return two postures (6, 3) as joint angles (rad): feet lifted off the beam, and legs half spread."""
        lifted = site.foot_positions_at(y, site.track / 2) + jnp.array([0.0, 0.0, 1.0]) * self.transfer_lift
        reach = site.robot.thigh + site.robot.shin
        return site.joint_angles(y, lifted), site.joint_angles_beside_hips(0.5 * reach, 0.25 * reach)


def track_width_change_stages(
    site: BeamGeometry, y: Array | float, track: Array | float, lift: Array | float, name: str
) -> list[Stage]:
    """Return the plan stages in which the tripods step to another lateral distance between left and right feet.

    The foot passes below its hip, where its place does not determine alpha; it goes there in joint space.

    Args:
        site: geometry of robot and beam.
        y: of the base (m).
        track: distance between left and right feet (m).
        lift: of the feet (m).
        name: prefix of the stages' names.
    """
    over, goal = site.joint_angles_beside_hips(0.02, site.clearance - lift), site.foot_positions_at(y, track / 2)
    angles, stages = site.joint_angles(y, goal), []
    for legs in TRIPOD:
        label = f"{name}.{'-'.join(map(str, legs))}"
        stages.append(Stage(f"{label}.over", site.step.time, posture=rows_by_leg(over, legs)))
        stages.append(
            Stage(f"{label}.down", site.step.time, rows_by_leg(goal, legs), posture=rows_by_leg(angles, legs))
        )
    return stages


def middle_leg_stages(site: BeamGeometry, name: str, angles: Sequence[Array]) -> list[Stage]:
    """Return plan stages in which the middle legs go through a sequence of postures."""
    return [Stage(f"{name}.{k}", site.step.time, posture=rows_by_leg(a, MIDDLE)) for k, a in enumerate(angles, start=1)]


def rows_by_leg(values: Float[Array, "6 3"], legs: Sequence[int]) -> dict[int, Array]:
    """Select rows of foot positions or joint angles (6, 3) for the given legs, by leg number."""
    return {leg: values[leg - 1] for leg in legs}

"""From the floor on to a free ball and to rest on its top (monograph 3.3.1, 3.3.2)."""

import math
from collections.abc import Mapping
from typing import ClassVar, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from sweep.controllers.frames import WORLD
from sweep.controllers.manoeuvres.balancing.ball import BallDrive, perch
from sweep.controllers.manoeuvres.balancing.beside_ball import (
    FRONT,
    MIDDLE,
    ON_FLOOR,
    REAR,
    Held,
    Move,
    Pose,
    centre,
    foothold,
    pitch,
    refuse,
    stages,
)
from sweep.controllers.manoeuvres.balancing.parts import InParts, Steps
from sweep.controllers.manoeuvres.goals import ON_ITS_FEET
from sweep.controllers.observation import Observation
from sweep.controllers.plan import Plan, Stance, assemble, swings
from sweep.controllers.riding import centre_of_mass, measured_stance
from sweep.controllers.support import RESTS, TO_VELOCITY, Support
from sweep.controllers.tracker import Guidance, Guided, TrackerState
from sweep.core.errors import InputError
from sweep.core.parameters import choice, count, parameters, quantity
from sweep.core.rotations import exponential, logarithm, rotate
from sweep.formulas.ball import GRAVITY, ROLLING, climbing_rate
from sweep.formulas.ball_reach import max_ball
from sweep.models.case import Case
from sweep.models.legs import LEGS
from sweep.models.obstacles.ball import Ball
from sweep.models.robot import total_mass

STILL = (0.0, 0.0)
RIDE, UP = "ride.", "up"
LEVEL, LEANS = Pose(90.0, -0.286, -1.678), Pose(30.1, 1.078, -0.795)
LIFTED, PUSHED, TOP = Pose(30.1, 1.078, -0.436), Pose(30.1, 1.078, -0.202), Pose(90.0, 1.078)
RISEN = Pose(90.0, 1.19)


class Table(NamedTuple):
    """The numbers of the plan: where the feet start, moves up to the push, swings of the ride, moves on top."""

    floor: tuple[tuple[float, float], ...] = ((0.536, -2.083), (0.536, -1.452), (0.536, -1.131))  # R, see `Move.place`
    level: Pose = LEVEL
    prepare: tuple[Move, ...] = (
        Move("front", 0.8, LEVEL, FRONT, place=(0.655, 27.2), lift=0.075, plane=(-1.0, 1.0, 0.3), support=RESTS),
        Move("turn1", 0.55, Pose(68.9, 0.339, -1.662), rates=(0.0, 1.1), support=RESTS),
        Move("turn2", 0.5, Pose(49.4, 0.832, -1.331), support=RESTS),
        Move("turn3", 0.55, LEANS, rates=(1.1, 0.0), support=RESTS),
        Move("rear", 0.8, LEANS, REAR, ON_FLOOR, (0.536, -1.43), 0.04, (0.0, 0.0, 1.0), support=RESTS),
        Move("middle", 0.8, LEANS, MIDDLE, ON_FLOOR, (0.536, -1.095), 0.04, (0.0, 0.0, 1.0), support=RESTS),
        Move("front2", 0.8, LEANS, FRONT, place=(0.654, 62.9), lift=0.075, plane=(-0.5, 1.0, 0.8), support=RESTS),
        Move("middle2", 0.8, LEANS, MIDDLE, place=(0.844, -1.3), lift=0.075, plane=(-0.5, 1.0, 0.0), support=RESTS),
        Move("grip", 0.32, LEANS, support=RESTS),
        Move("lift", 1.5, LIFTED, rates=STILL, support=RESTS),
        Move("front3", 0.8, LIFTED, FRONT, place=(0.804, 77.2), lift=0.075, plane=(-0.5, 1.0, 0.8), support=RESTS),
        Move("grip2", 0.32, LIFTED, support=RESTS),
    )
    push: Move = Move("push", 0.9, PUSHED, rates=(0.0, 2.0))
    # with places as if the base were on top
    ride: tuple[Move, ...] = (
        Move("rear3", 1.05, TOP, REAR, place=(0.638, 50.2), lift=0.075, plane=(0.5, 0.6, 0.5)),
        Move("middle3", 0.5, TOP, MIDDLE, place=(0.714, 90.0), lift=0.06, plane=(0.0, 0.5, 1.0)),
        Move(UP, 3.0, TOP),
    )
    top: tuple[Move, ...] = (
        Move("middle4", 0.6, TOP, MIDDLE, place=(0.613, 90.0), lift=0.06, plane=(0.0, 0.5, 1.0)),
        Move("rise", 0.5, RISEN, rates=STILL),
        Move("rear4", 0.6, RISEN, REAR, place=(0.438, 61.5), lift=0.06, plane=(0.0, 0.5, 1.0)),
        Move("front4", 0.6, RISEN, FRONT, place=(0.438, 118.5), lift=0.06, plane=(0.0, 0.5, 1.0)),
    )


class RideMemory(NamedTuple):
    """How far the base has come."""

    elevation: Float[Array, ""]  # rad, of its tangent
    distance: Float[Array, ""]  # m, of its axis
    ahead: Float[Array, ""]  # m, of its centre along the tangent
    time: Float[Array, ""]  # s


class Ride(NamedTuple):
    """Up on a ball that rolls, at the rate that has it stop as the top is reached: (3.1.13)-(3.1.16) at every tick.

    The plan's places are those of a base on top: feet go where these are by then, as far round the ball as the base is.
    """

    gain: Array | float  # of the rate
    most: Array | float  # rad/s, of the rate
    centring: Array | float  # s, over which the base goes to the tangent's point first

    def memory(self, belief: Case, plan: Plan) -> RideMemory:
        """Where the base is when the ride begins."""
        first = [name.startswith(RIDE) for name in plan.names].index(True)
        x, _, z = plan.position[first - 1]
        elevation = 0.5 * np.pi + logarithm(plan.quat[first])[1]
        sin, cos = jnp.sin(elevation), jnp.cos(elevation)
        return RideMemory(elevation, z * sin - x * cos, x * sin + z * cos, jnp.zeros(()))

    def guide(
        self, belief: Case, plan: Plan, state: TrackerState, seen: Observation, begins: Bool[Array, ""], period: float
    ) -> Guidance:
        """The base goes up, and feet swing to places relative to it."""
        ball, memory = belief.on(Ball), state.memory
        distance, rate = memory.distance, self.rate(belief, seen)
        share = jnp.minimum(1.0, memory.time / self.centring)
        share = share**2 * (3 - 2 * share)
        forward = jnp.clip(distance * rate * (1 - share), 0.0, -4 * jnp.minimum(memory.ahead, 0.0))
        turning = jnp.maximum(0.0, rate - forward / distance)
        elevation = jnp.minimum(0.5 * np.pi, memory.elevation + turning * period)
        memory = RideMemory(elevation, distance, memory.ahead + forward * period, memory.time + period)
        pose = Pose(jnp.degrees(elevation), distance / ball.radius, memory.ahead / ball.radius)
        round_ = about_aside(pitch(pose) + memory.ahead / distance)
        goal = jnp.where(plan.swing[state.stage][:, None], rotate(round_[None], plan.foothold[state.stage]), state.feet)
        phase = jnp.clip(state.clock / plan.duration[state.stage], 0.0, 1.0)
        feet = swings(plan, state.stage, phase, state.feet, goal)
        return Guidance(Stance(feet, centre(ball, pose), about_aside(pitch(pose))), goal, memory)

    def rate(self, belief: Case, seen: Observation) -> Float[Array, ""]:
        """(3.1.16), rad/s, of the mass centre where it is measured; none beyond the top."""
        ball, robot = belief.on(Ball), belief.robot
        off = centre_of_mass(robot, measured_stance(robot, seen)) - seen.free.position[0]
        elevation = jnp.arctan2(off[2], -off[0])
        omega = jnp.maximum(seen.free.turn[0, 1], 0.0)
        p = total_mass(robot) * jnp.hypot(off[0], off[2]) / (ball.radius * (ROLLING * ball.mass + total_mass(robot)))
        effort = jnp.log((1 + p) / (1 + p * jnp.sin(jnp.minimum(elevation, 0.5 * np.pi))))
        enough = (omega * ball.radius) ** 2 > 4 * effort**2 * ball.radius * GRAVITY
        root = climbing_rate(jnp.where(enough, omega, 10.0), effort, ball.radius)
        fastest = omega / (2 * jnp.maximum(effort, 1e-6))
        wanted = jnp.minimum(self.gain * jnp.where(enough, root, fastest), self.most)
        return jnp.where(elevation > 0.5 * np.pi, 0.0, wanted)

    def ends(self, belief: Case, plan: Plan, state: TrackerState, seen: Observation) -> Bool[Array, ""]:
        """On top, in the last stage."""
        last = jnp.asarray(plan.names.index(RIDE + UP))
        return (state.stage == last) & (state.memory.elevation >= 0.5 * np.pi - 1e-4)


def about_aside(angle: Array) -> Float[Array, " 4"]:
    """Rotation by `angle` (rad) about y: nose down."""
    return exponential(jnp.zeros(3).at[1].set(angle))


@parameters
class BallClimb(InParts):
    """From the floor on to a free ball and to rest on its top. Stages and their numbers are in `Table`."""

    goal: ClassVar = {**ON_ITS_FEET, "end_tilt_max_deg": 3.0, "obstacle_speed_error_max_mps": 0.01,
                      "obstacle_aside_max_m": 0.05}  # fmt: skip
    kind: str = choice("ball_climb", "ball_climb")
    calm: int = count(15, at_least=1, at_most=100)  # steps on top
    push_speed: float = quantity(0.324, "m/s", above=0)  # v_*, of the ball after the push
    gain: float = quantity(0.918, "-", above=0, at_most=2)  # of the rate (3.1.16)
    most_rate: float = quantity(1.5, "rad/s", above=0)
    centring: float = quantity(1.52, "s", above=0)
    calm_speed: float = quantity(0.0, "m/s", at_least=0)  # of a ball that needs no further step
    step_time: float = quantity(0.9, "s", above=0, at_most=20)  # of the steps on top
    speed_gain: float = quantity(0.6, "s", at_least=0)  # k_v
    aside_gain: float = quantity(0.4, "-", at_least=0)  # k_1
    aside_gain_before: float = quantity(0.3, "-", at_least=0)  # k_2
    circle_ratio: float = quantity(0.613, "R", above=0, at_most=1)  # d_1 of the feet on top
    chord_ratio: float = quantity(0.7, "d_1", above=0, at_most=1)  # d_2
    height_ratio: float = quantity(0.257, "a_r", above=0, at_most=2)  # of the base over the ball's top
    deepening: float = quantity(5e-4, "m", at_least=0, at_most=0.05)  # epsilon, feet inside ball and floor
    press: float = quantity(1.6e-3, "m", at_least=0, at_most=0.05)  # feet on the ball deeper than they are measured
    squeeze: float = quantity(3.2e-3, "m", at_least=0, at_most=0.05)  # the same to the middle
    observer: float = quantity(0.1, "s", at_least=0)  # in which the ball's measured pose is taken over; 0: at once
    ease: float = quantity(0.15, "s", above=0)  # in which feet go over to where they are measured
    patience: float = quantity(0.1, "s", at_least=0)  # longest wait for a touchdown

    needs = (Ball,)

    @property
    def table(self) -> Table:
        """The numbers of its plan."""
        return Table()

    def obstacle_speed(self, duration: Array) -> Array:
        """The ball is to stand (m/s)."""
        return jnp.zeros_like(duration)

    def plan(self, belief: Case, table: Table | None = None) -> Plan:
        """Feet to the ball, base to its tangent, push, ride, stand on top, calm the ball.

        Raises `InputError` where the ball is too large, or the feet do not reach the floor, by plain numbers.
        """
        ball, table = belief.on(Ball), table or self.table
        self.refuse(belief)
        refuse(belief, lambda: self.stance(ball, table))
        held, stand = Held(self.deepening, (self.press, self.squeeze)), dict.fromkeys(LEGS, WORLD)
        rolls = Support(TO_VELOCITY, jnp.zeros(3).at[0].set(self.push_speed),
                        jnp.zeros(3).at[1].set(self.push_speed / ball.radius))  # fmt: skip
        prepare = (*table.prepare, table.push._replace(support=rolls))
        moves = stages(ball, prepare, table.level, stand, held)
        moves += stages(ball, table.ride, table.push.pose, stand, held, RIDE)
        moves += stages(ball, table.top, table.ride[-1].pose, stand, held)
        calm = self.calming.steps_of(perch(belief, self), "calm")
        return assemble(self.stance(ball, table), [*moves, *calm], self.patience, ease=self.ease)

    def stance(self, ball: Ball, table: Table) -> Stance:
        """Where the robot stands at the start."""
        start, up = Move("", 0.0, table.level, where=ON_FLOOR), jnp.zeros(3).at[2].set(ball.radius)
        feet = [foothold(ball, leg, start._replace(place=table.floor[(leg - 1) // 2]), self.deepening) for leg in LEGS]
        return Stance(jnp.stack(feet) + up, centre(ball, table.level) + up, jnp.array([1.0, 0.0, 0.0, 0.0]))

    def refuse(self, belief: Case) -> None:
        """Raise `InputError` where the front feet do not reach so high that friction holds them: (3.1.18)-(3.1.22)."""
        robot, radius = belief.robot, belief.on(Ball).radius
        highest = 2 * (robot.thigh + robot.shin)  # of the front hips for which the ball may be largest
        numbers = (robot.thigh, robot.shin, highest, robot.body_width, belief.contact.friction)
        if not all(isinstance(x, float) for x in (*numbers, radius)):
            return
        with jax.ensure_compile_time_eval():
            most = float(max_ball(*numbers).R)
        if not radius <= most:
            raise InputError(
                f"obstacle.radius = {radius:g} is not allowed: at most {most:.2f} m can be climbed by legs of "
                f"{robot.thigh:g} and {robot.shin:g} m at friction {numbers[-1]:g} (formula max_ball)"
            )

    @property
    def calming(self) -> BallDrive:
        """The steps that stop the ball."""
        return BallDrive(steps=self.calm, speed=0.0, step_time=self.step_time, speed_gain=self.speed_gain,
                         aside_gain=self.aside_gain, aside_gain_before=self.aside_gain_before,
                         circle_ratio=self.circle_ratio, chord_ratio=self.chord_ratio,
                         height_ratio=self.height_ratio, deepening=self.deepening)  # fmt: skip

    @property
    def parts(self) -> Mapping[str, Guided]:
        """The ride up, and the calming steps."""
        ride = Ride(self.gain, self.most_rate, self.centring)
        return {RIDE: ride, "calm": Steps(self.calming, self.calm_speed, math.inf)}

"""Standing on a free ball and driving it (monograph 3.1.1, 3.1.2).

World axes: the robot faces x and the ball starts at the origin; the book's e is x. Standing feet are planned in the
ball's own axes, base and swinging feet in its Koenig frame, from the ball's measured pose at every tick. The drives are
stiff: feet that followed the raw measured attitude, 1 mrad off at every tick, would shake the robot off the ball.
Therefore the measured pose is filtered, without lag in steady rolling.
"""

from collections.abc import Callable, Mapping
from functools import partial
from typing import Any, ClassVar, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from sweep.controllers.ball_state import (
    UP,
    angular_momentum,
    ball_footholds,
    base_shift_for_mass_centre,
    centre_of_mass,
    measured_stance,
    momentum_cancelling_lean,
    rotate_footholds_backward,
    swing_foot_arc,
)
from sweep.controllers.layers import TickContext
from sweep.controllers.observation import Observation
from sweep.controllers.plan import CYCLE_A, GRIP, KEEP, REGRIP, Plan, Stage, SupportMotion, swing_progress_and_lift
from sweep.controllers.tracker import Guidance, TrackerState
from sweep.core.constants import GRAVITY
from sweep.core.parameters import choice, count, parameters, quantity
from sweep.core.rotations import IDENTITY, conjugate, rotate
from sweep.formulas.ball import ROLLING_INERTIA, stabilise_delta
from sweep.manoeuvres.goals import ON_ITS_FEET
from sweep.models.case import Case, Manoeuvre
from sweep.models.frames import body_frame_number, koenig_frame_number
from sweep.models.legs import LEGS
from sweep.models.obstacles.ball import Ball
from sweep.models.posture import Stance
from sweep.models.robot import Robot, total_mass
from sweep.planning.compile_plan import compile_plan
from sweep.planning.gaits import TRIPOD
from sweep.planning.moves import MoveContext
from sweep.planning.validation import require_within_reach

CENTRING_ITERATIONS = 4  # Newton iterations that put the mass centre over the ball's centre
CHI_ITERATIONS = 3  # iterations of (3.1.10)
MAX_BASE_SPEED = 0.4  # m/s, of the base under the law `tick`


class StandPose(NamedTuple):
    """Feet and base position (m, from the ball's centre) of a robot that stands on a ball."""

    feet: Float[Array, "6 3"]  # m
    position: Float[Array, " 3"]  # m, base, with the mass centre over the ball's centre


@parameters
class OnBallManoeuvre(Manoeuvre):
    """Base class of manoeuvres on top of a ball. Ratios are to the body length a_r unless stated otherwise."""

    circle_ratio: float = quantity(0.613, "R", above=0, at_most=1)  # d_1, radius of the circle of footholds on the ball
    # d_2, distance of the front and rear feet from the middle of that circle
    chord_ratio: float = quantity(0.7, "d_1", above=0, at_most=1)
    height_ratio: float = quantity(0.257, "a_r", above=0, at_most=2)  # height of the base over the ball's top
    deepening: float = quantity(5e-4, "m", at_least=0, at_most=0.05)  # epsilon, depth of feet inside the ball
    # time constant of the filter of the ball's measured pose; 0: no filter
    observer: float = quantity(0.1, "s", at_least=0)

    needs = (Ball,)

    def make_ball_drive(self, **options: Any) -> "BallDrive":
        """Return the manoeuvre that rolls the ball by walking on it, with the footholds of this manoeuvre."""
        return BallDrive(circle_ratio=self.circle_ratio, chord_ratio=self.chord_ratio,
                         height_ratio=self.height_ratio, deepening=self.deepening, **options)  # fmt: skip


def ball_move_context(
    belief: Case,
    unit: Array | float,
    deepening: Array | float,
    press: tuple[Array | float, Array | float],
    supports: Mapping[str, tuple[SupportMotion, ...]],
    laws: tuple[str, ...] = (),
) -> MoveContext:
    """Return the coordinate systems, units and feedback laws for plan-file moves on or beside balls.

    Args:
        belief: has the obstacle.
        unit: unit of lengths (m).
        deepening: depth of feet in what they stand on (m).
        press: pressure of feet on balls (m), see `Stage.press`.
        supports: reference motions of balls by name.
        laws: names of laws that moves may use.
    """
    depths = dict.fromkeys(belief.obstacle.charts, deepening)
    return MoveContext(belief, unit, 1.0, unit, depths, supports=supports,
                 laws=laws, stage={"onset": GRIP, "press": press})  # fmt: skip


def require_start_within_reach(belief: Case, start: Callable[[], Stance]) -> None:
    """Raise an error unless the legs reach all feet in the start stance; skip the check under JAX tracing.

    Args:
        belief: believed parameters.
        start: makes the start stance, world axes.

    Raises:
        InputError: a foot is out of reach.
    """
    require_within_reach(belief, lambda: {f"at the start of manoeuvre = {belief.manoeuvre.kind}": start()},
                 f"obstacle.radius = {belief.obstacle_of_type(Ball).radius} is not allowed: ")  # fmt: skip


def stand_pose(belief: Case, manoeuvre: OnBallManoeuvre) -> StandPose:
    """Return the pose of a robot with its feet on their circle on the ball, and a level base over the ball's centre.

    Args:
        belief: has robot and ball.
        manoeuvre: has the circle of footholds.
    """
    radius, length = belief.obstacle_of_type(Ball).radius, belief.robot.body_length
    circle = manoeuvre.circle_ratio * radius
    feet = ball_footholds(radius, circle, manoeuvre.chord_ratio * circle) * (1 - manoeuvre.deepening / radius)
    above = jnp.asarray(UP) * (radius + manoeuvre.height_ratio * length)
    return StandPose(feet, _balanced_base(belief.robot, Stance(feet, above, jnp.array(IDENTITY))))


@jax.jit
def _balanced_base(robot: Robot, stance: Stance) -> Float[Array, " 3"]:
    """Position of the base (m) that puts the mass centre over the origin."""
    for _ in range(CENTRING_ITERATIONS):
        move = base_shift_for_mass_centre(robot, stance, -centre_of_mass(robot, stance)[:2])
        stance = stance._replace(position=stance.position.at[:2].add(move))
    return stance.position


def stance_on_ball(belief: Case, pose: StandPose) -> Stance:
    """Return the stance (feet and base pose, world axes) for a pose on the ball at its start position.

    Args:
        belief: has the ball.
        pose: pose relative to the ball's centre.
    """
    centre = jnp.asarray(UP) * belief.obstacle_of_type(Ball).radius
    return Stance(pose.feet + centre, pose.position + centre, jnp.array(IDENTITY))


def standing_stages(pose: StandPose, times: Mapping[str, Array | float]) -> list[Stage]:
    """Return plan stages in which all feet stand on the ball.

    Args:
        pose: pose relative to the ball's centre.
        times: durations (s) by the stages' names.
    """
    frames = {"foot_frames": (body_frame_number(0),) * 6, "base_frame": koenig_frame_number(0)}
    return [Stage(name, time, position=pose.position, onset=KEEP, **frames) for name, time in times.items()]


class BalanceMemory(NamedTuple):
    """State of the law that balances on a ball: base motion and momentum, planned when a stage starts or measured."""

    place: Float[Array, " 3"]  # m, of the base over the ball's centre, at the start of the stage or now
    move: Float[Array, " 2"]  # m, of the base, shaped by delta
    pulse: Float[Array, " 2"]  # m, of the base, shaped by delta'
    momentum: Float[Array, " 3"]  # N m s, K_S, smoothed


@parameters
class BallBalance(OnBallManoeuvre):
    """Stand on a ball, and stop it by moving the body so that the mass centre is over it.
    Ratios are to the body length a_r.

    There are two laws. `manoeuvre` plans every `period` T from the measured state: base = start + D^-1 (-x) delta(tau)
    + D^-1 (K_S x g)/(m g^2 T) delta'(tau) with x = r_m - r_b, monograph (3.1.1)-(3.1.7). `tick` acts at every control
    tick: the mass centre follows `momentum_gain` (K_S x g)/(m g^2) - `place_gain` r_b, which also returns the ball to
    its start. `none` holds the body over the ball.

    The book does not say how D and K_S are measured. Here they follow from the believed robot's links and the measured
    motion.
    """

    goal: ClassVar = {**ON_ITS_FEET, "obstacle_speed_error_max_mps": 0.01}
    kind: str = choice("ball_balance", "ball_balance")
    law: str = choice("manoeuvre", "manoeuvre", "tick", "none")  # law by which the body balances the ball, see above
    stages: int = count(30, at_least=1, at_most=500)  # number of stages, of T each
    period: float = quantity(2.0, "s", above=0, at_most=20)  # T, time of a stage
    rest: float = quantity(0.0, "s", at_least=0)  # Delta, rest at the end of T
    offset: float = quantity(0.03, "m")  # of the body ahead of its balanced place, at the start
    offset_aside: float = quantity(0.0, "m")  # of the body to the left of it, at the start
    momentum_gain: float = quantity(1.5, "1/s", at_least=0)  # gain on the ball's angular momentum, in the law `tick`
    place_gain: float = quantity(0.2, "-", at_least=0)  # gain on the ball's distance from its start, in the law `tick`
    smoothing: float = quantity(0.05, "s", at_least=0)  # time constant of K_S in the law `tick`
    lag: float = quantity(0.1, "s", above=0)  # time constant with which the mass centre follows that law
    reach: float = quantity(0.12, "m", above=0)  # largest lean of that law

    def plan(self, belief: Case) -> Plan:
        """Return a plan of equal stages in which all feet stand on the ball."""
        pose = stand_pose(belief, self)
        off = jnp.stack([jnp.asarray(self.offset, float), jnp.asarray(self.offset_aside, float)])
        pose = pose._replace(position=pose.position.at[:2].add(off))
        stages = standing_stages(pose, {f"balance{k + 1}": self.period for k in range(self.stages)})
        return compile_plan(stance_on_ball(belief, pose), stages, 0.0)

    def init_memory(self, belief: Case, plan: Plan) -> BalanceMemory:
        """Return the law's state before the first tick, with the base where the plan starts."""
        return BalanceMemory(plan.position[0], jnp.zeros(2), jnp.zeros(2), jnp.zeros(3))

    def guide(self, belief: Case, ctx: TickContext, state: TrackerState) -> Guidance:
        """Return the stance in which the base is moved to stop the ball, by the balancing law that the plan names."""
        memory: BalanceMemory = state.memory
        if self.law == "manoeuvre":
            memory = jax.tree.map(
                partial(jnp.where, ctx.is_first_tick), self._plan_move(belief, memory, ctx.obs), memory
            )
            shape = stabilise_delta(self.period, self.rest, state.clock)
            shift = memory.move * shape.delta + memory.pulse * shape.pulse_integral_T
            position = memory.place.at[:2].add(shift)
        else:
            memory = self._lean_tick(belief, memory, state, ctx.obs, ctx.period) if self.law == "tick" else memory
            position = memory.place
        return Guidance(Stance(state.feet, position, ctx.plan.quat[ctx.stage]), state.feet, memory)

    def _plan_move(self, belief: Case, memory: BalanceMemory, obs: Observation) -> BalanceMemory:
        """Plan the move of (3.1.1) and the pulse after fig. 3.1.2 from the measured state."""
        robot, stance = belief.robot, measured_stance(belief.robot, obs)
        momentum = angular_momentum(robot, belief.obstacle_of_type(Ball), obs)
        off = (centre_of_mass(robot, stance) - obs.free.position[0])[:2]
        pulse = momentum_cancelling_lean(momentum, total_mass(robot)) / self.period
        place = memory.place.at[:2].add(memory.move)
        return BalanceMemory(
            place,
            base_shift_for_mass_centre(robot, stance, -off),
            base_shift_for_mass_centre(robot, stance, pulse),
            momentum,
        )

    def _lean_tick(
        self, belief: Case, memory: BalanceMemory, state: TrackerState, obs: Observation, period: float
    ) -> BalanceMemory:
        """Advance the law `tick` by one tick: the commanded mass centre moves towards its target."""
        robot, free = belief.robot, obs.free
        share = jnp.minimum(1.0, period / jnp.maximum(self.smoothing, period))
        momentum = memory.momentum + share * (
            angular_momentum(robot, belief.obstacle_of_type(Ball), obs) - memory.momentum
        )
        wanted = (
            self.momentum_gain * momentum_cancelling_lean(momentum, total_mass(robot))
            - self.place_gain * free.position[0, :2]
        )
        wanted = jnp.clip(wanted, -self.reach, self.reach)
        stance = Stance(rotate(free.quat, state.feet), memory.place, jnp.array(IDENTITY))
        off = wanted - centre_of_mass(robot, stance)[:2]
        move = base_shift_for_mass_centre(
            robot, measured_stance(robot, obs), off
        )  # measured: commanded legs may be out of reach
        step = jnp.minimum(1.0, period / self.lag) * move
        place = memory.place.at[:2].add(jnp.clip(step, -MAX_BASE_SPEED * period, MAX_BASE_SPEED * period))
        return memory._replace(place=place, momentum=momentum)


class BallPathPoint(NamedTuple):
    """Position of the ball relative to its planned path: travel along the path, offset, direction, curvature."""

    along: Float[Array, " 2"]  # unit vector along the path
    progress: Float[Array, ""]  # m, along the path
    left_offset: Float[Array, ""]  # m, to the left of the path
    curvature: Float[Array, ""]  # 1/m, of the path, to the left


class DriveMemory(NamedTuple):
    """State of the law that rolls a ball: motion planned for the current step, and sums over earlier steps."""

    push: Float[Array, ""]  # m, k_v (v_d - v_e) and the integral
    integral: Float[Array, ""]  # m, sum over the steps so far of the integral term
    along: Float[Array, " 2"]  # unit vector along the path, at the start of the step
    progress: Float[Array, ""]  # m, of the ball along the path, at the start of the step
    aside: Float[Array, ""]  # m, delta r^(3) to the left
    aside_before: Float[Array, ""]  # m, the same in the last step
    left_offset: Float[Array, ""]  # m, of the ball to the left of the path, at the start of the step


@parameters
class BallDrive(OnBallManoeuvre):
    """Walk on a ball by tripod so that it rolls along x at `speed`, and stop it at `place`.
    Ratios are to the body length a_r.

    In each step, the mass centre is pushed ahead by k_v (v_d - v_e) delta'(tau) (3.1.8), every `push_every` steps; kept
    over the ball's middle line by the fixed-point iteration (3.1.10); and moved sideways by -(k_1 y_n - k_2 y_(n-1)).
    Feet land on the circle that is turned back by alpha = T v_b/(2 R). Monograph 3.1.2.

    Additions to the book, and differences:

    - At the start of every step, all feet are taken where they are measured, at their commanded depth, even those about
      to land. Otherwise a foot lands as far off its place as the base is and hands that error on to the base, and the
      ball goes ever faster: 0.7 m/s after 30 s.
    - Commanded feet move to their new places within `ease`, since a jump would make the drives jerk.
    - (3.1.10) also acts lengthwise (`compensate`): swinging legs shift the mass centre by centimetres, as much as the
      push.
    - T of alpha is the time of a stance, which is that of one step.
    - Changes of the lateral move are spread over half a step, and the push is limited.
    - Rolling friction keeps the ball slower than v_d, a heavy one most; `speed_integral` integrates the missing speed.
    - To stop, v_d is at most `brake` times the distance to `place`.
    """

    goal: ClassVar = {"obstacle_speed_error_max_mps": 0.0065, "obstacle_aside_max_m": 0.02}
    kind: str = choice("ball_drive", "ball_drive")
    steps: int = count(50, at_least=1, at_most=500)  # number of steps, by either tripod in turn
    step_time: float = quantity(1.2, "s", above=0, at_most=20)  # T, time of a step
    speed: float = quantity(0.13, "m/s")  # v_d, speed at which the ball is to roll
    # k_v, push of the mass centre ahead for each m/s that the ball is too slow
    speed_gain: float = quantity(0.4, "s", at_least=0)
    # additional push at all later steps for each m/s that the ball is too slow at one step; 0 in the book
    speed_integral: float = quantity(0.0, "s", at_least=0)
    push_every: int = count(1, at_least=1)  # steps from one push ahead to the next
    push_max: float = quantity(0.06, "m", at_least=0)  # largest push of the mass centre ahead or back
    aside_gain: float = quantity(0.2, "-", at_least=0)  # k_1, gain on the ball's distance from its path now
    aside_gain_before: float = quantity(0.15, "-", at_least=0)  # k_2, gain on that distance a step before
    # directions in which the mass centre is kept in place while legs swing
    compensate: str = choice("both", "both", "aside")
    place: float = quantity(1e6, "m")  # x of the ball's centre at which it stops
    brake: float = quantity(0.2, "1/s", above=0)  # largest speed for each metre of distance to `place`
    lift_ratio: float = quantity(0.03, "a_r", above=0, at_most=0.5)  # d_y, height of a swing
    ease: float = quantity(0.1, "s", above=0)  # time in which feet move over to new footholds
    patience: float = quantity(0.0, "s", at_least=0)  # longest wait for a touchdown, while the ball rolls on below

    def obstacle_speed(self, duration: Array) -> Array:
        """Return the planned speed (m/s) of the ball after `duration` (s); 0 if it has reached its goal."""
        return jnp.where(self.speed * duration > self.place, 0.0, self.speed)

    def lateral_offset(self, way: Float[Array, " 3"]) -> Array:
        """Return the lateral distance (m) of the ball from its planned path after a displacement."""
        return jnp.abs(self.path_point_at(way).left_offset)

    def plan(self, belief: Case) -> Plan:
        """Return the plan in which the two tripods step in turn on the ball."""
        pose = stand_pose(belief, self)
        return compile_plan(
            stance_on_ball(belief, pose), self.tripod_step_stages(pose, "step"), self.patience, ease=self.ease
        )

    def tripod_step_stages(self, pose: StandPose, law: str, first_share: float = 1.0) -> list[Stage]:
        """Return plan stages in which tripods step in turn on the ball.
        Standing feet move with the ball; swinging feet move in axes that follow its centre and its Koenig frame.

        Args:
            pose: pose relative to the ball's centre.
            law: law of the stages, and prefix of their names.
            first_share: duration of the first step over that of the others. Half of it if the ball rolls already and
                its feet start in the middle of their stance.
        """
        stages = []
        for k in range(self.steps):
            legs = TRIPOD[k % 2]
            swing = {leg: pose.feet[leg - 1] for leg in legs}
            frames = tuple(koenig_frame_number(0) if leg in legs else body_frame_number(0) for leg in LEGS)
            time = self.step_time * (1.0 if k else first_share)
            stages.append(Stage(f"{law}{k + 1}", time, swing, CYCLE_A, position=pose.position,
                                foot_frames=frames, base_frame=koenig_frame_number(0), law=law,
                                onset=REGRIP))  # fmt: skip
        return stages

    def path_point_at(self, place: Float[Array, " 3"]) -> BallPathPoint:
        """Return point and direction of the planned path at a ball position `place` (m); the path is along x."""
        return BallPathPoint(jnp.array([1.0, 0.0]), place[0], place[1], jnp.zeros_like(place[0]))

    def init_memory(self, belief: Case, plan: Plan) -> DriveMemory:
        """Return the law's state before its first push on the ball."""
        zero = jnp.zeros(())
        return DriveMemory(zero, zero, jnp.array([1.0, 0.0]), zero, zero, zero, zero)

    def guide(self, belief: Case, ctx: TickContext, state: TrackerState) -> Guidance:
        """Return the stance that drives the ball by the motion planned at the start of the step."""
        plan, stage, phase, free = ctx.plan, ctx.stage, ctx.phase, ctx.obs.free
        planned, landing = self._plan_step(belief, ctx, state)
        memory = jax.tree.map(partial(jnp.where, ctx.is_first_tick), planned, state.memory)
        swings = plan.swing[stage][:, None]
        goal = jnp.where(ctx.is_first_tick, jnp.where(swings, landing, state.feet), state.goal)
        time = plan.duration[stage]
        share, height = swing_progress_and_lift(plan.curve.cycle[stage], jnp.zeros(()), phase)
        lift = height * self.lift_ratio * belief.robot.body_length
        on_way = swing_foot_arc(state.feet, goal, share, phase, lift)
        feet = jnp.where(swings, on_way, rotate(free.quat, state.feet))
        blend = jnp.minimum(1.0, 2 * phase)
        aside = memory.aside_before + blend**2 * (3 - 2 * blend) * (memory.aside - memory.aside_before)
        pulse = memory.push * time / self.step_time * stabilise_delta(time, 0.0, state.clock).pulse
        wanted = pulse * memory.along + aside * direction_left_of_path(memory)
        lengthwise = self.compensate == "both"
        position = base_position_for_mass_centre(belief.robot, plan.position[stage], feet, wanted, lengthwise)
        feet = jnp.where(swings, feet, rotate(conjugate(free.quat), feet))
        return Guidance(Stance(feet, position, plan.quat[stage]), goal, memory)

    def _plan_step(
        self, belief: Case, ctx: TickContext, state: TrackerState
    ) -> tuple[DriveMemory, Float[Array, "6 3"]]:
        """Plan a step from the ball's measured position and speed: push by (3.1.8), delta r^(3), turned footholds."""
        ball, memory, obs = belief.obstacle_of_type(Ball), state.memory, ctx.obs
        track = self.path_point_at(obs.free.position[0])
        speed = obs.free.velocity[0, :2] @ track.along
        wanted = jnp.minimum(self.speed, self.brake * (self.place - track.progress))
        pushes = state.stage % self.push_every == 0
        mean = (track.progress - memory.progress) / self.step_time
        went = jnp.where(state.stage == 0, speed, mean)
        missing = memory.integral + jnp.where(pushes, self.speed_integral * (wanted - went), 0.0)
        missing = jnp.clip(missing, -self.push_max, self.push_max)
        push = jnp.clip(self.speed_gain * (wanted - speed) + missing, -self.push_max, self.push_max)
        push = jnp.where(pushes, push, 0.0)
        before = jnp.where(state.stage == 0, track.left_offset, memory.left_offset)
        lean = (
            speed**2
            * track.curvature
            * lateral_lean_per_curvature(belief, ball.radius + self.height_ratio * belief.robot.body_length)
        )
        aside = lean + self.aside_gain_before * before - self.aside_gain * track.left_offset
        planned = memory._replace(
            push=push, integral=missing, along=track.along, progress=track.progress, aside=aside,
            aside_before=memory.aside, left_offset=track.left_offset,
        )  # fmt: skip
        level = ctx.plan.foothold[ctx.stage]
        return planned, rotate_footholds_backward(level, self.step_time * speed / (2 * ball.radius), track.along)


def direction_left_of_path(memory: DriveMemory) -> Float[Array, " 2"]:
    """Return the horizontal unit vector to the left of the ball's path."""
    return jnp.stack([-memory.along[1], memory.along[0]])


def lateral_lean_per_curvature(belief: Case, height: Array | float) -> Array | float:
    """Return the lateral lean (m) of the mass centre per curvature (1/m) of the ball's path at 1 m/s: (3.1.33).

    Args:
        belief: has robot and ball.
        height: of the mass centre above the ball's centre (m).
    """
    ball, mass = belief.obstacle_of_type(Ball), total_mass(belief.robot)
    return (ROLLING_INERTIA * ball.mass * ball.radius + mass * (ball.radius + height)) / (mass * GRAVITY)


def base_position_for_mass_centre(
    robot: Robot, balanced: Float[Array, " 3"], feet: Float[Array, "6 3"], wanted: Float[Array, " 2"], lengthwise: bool
) -> Float[Array, " 3"]:
    """Return the level base's position (m) that puts the robot's mass centre at a given horizontal place: (3.1.10).

    Args:
        robot: the robot, as believed.
        balanced: base with the mass centre over the ball (m).
        feet: m, relative to the ball's centre, world axes.
        wanted: place of the mass centre in the plane (m).
        lengthwise: whether to correct its x component, too.
    """
    heavier = total_mass(robot) / robot.body_mass
    position = balanced.at[:2].add(wanted)
    free = jnp.array([1.0 if lengthwise else 0.0, 1.0])
    for _ in range(CHI_ITERATIONS):
        off = wanted - centre_of_mass(robot, Stance(feet, position, jnp.array(IDENTITY)))[:2]
        position = position.at[:2].add(heavier * free * off)
    return position

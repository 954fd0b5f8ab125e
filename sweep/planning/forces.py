"""Force planning: foot forces with which a standing robot holds its weight, for any stance (monograph 2.1).

With more than two standing feet, balance leaves the forces undetermined. Here they minimise the largest value of one
quantity (friction used, joint torque or normal force) within friction cones and limits. The solution is a centre of the
near-optimal forces rather than an extreme one, so that it changes smoothly with the pose.
"""

from collections.abc import Callable, Sequence
from typing import ClassVar, Literal, NamedTuple, cast

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from sweep.controllers.frames import stance_to_world, surface_under_feet
from sweep.controllers.layers import ForceFeedforward
from sweep.controllers.plan import Plan, Stage, reference_stance, stage_start_pose
from sweep.core.constants import GRAVITY
from sweep.core.parameters import choice, parameters, quantity
from sweep.core.rotations import rotate
from sweep.models.case import Case, Manoeuvre
from sweep.models.obstacles.surface import free_start_state
from sweep.models.posture import Stance, foot_positions, joint_targets, mass_centre
from sweep.models.robot import Robot, total_mass

Effort = Literal["friction", "torque", "normal"]
_BOUND: dict[Effort, str] = {"friction": "friction", "torque": "torque", "normal": "most_normal"}

# Each Newton step bounds the effort by a level above its largest value, by a relative slack that shrinks every second
# step. It starts without a bound, from forces that are not in balance, and ends at `MIN_SLACK` unless `ForceBounds`
# sets another one.
MIN_SLACK = 0.01
SLACK = np.repeat(np.array([1e12] * 12 + list(np.geomspace(5 * MIN_SLACK, MIN_SLACK, 40)), np.float32), 2)
# of a Newton step, of which the longest that stays within bounds is taken
STEP_LENGTHS = (1.0, 0.7, 0.5, 0.3, 0.15, 0.07, 0.03, 0.01)
EFFORT_WEIGHT = 8.0  # weight of the bounds on the effort against all others
MARGIN_KEPT = 0.2  # share of the margin to a bound that a step has to keep
MOTION_THRESHOLD = 1e-5  # m and rad, of a base that moves; above rounding of frame changes in single precision
LOAD = "load"  # law of stages in which load transfers between feet
KNOTS = 5  # moments of a stage for which forces are planned


class ForcePlanningPose(NamedTuple):
    """Feet, surface normals and leg Jacobians of a pose for which foot forces are planned, world axes."""

    arm: Float[Array, "6 3"]  # m, feet from the robot's mass centre
    normal: Float[Array, "6 3"]  # of the surfaces under the feet, outward
    stands: Bool[Array, " 6"]  # which feet stand
    jacobian: Float[Array, "6 3 3"]  # m/rad, of each foot by its leg's joints
    own_torque: Float[Array, "6 3"]  # N m, that holds the links of the leg
    weight: Float[Array, ""]  # N


class ForceBounds(NamedTuple):
    """Bounds on the forces of the feet, each a single number or one number for each foot."""

    friction: Array | float  # coefficient
    torque: Array | float  # N m, of each joint
    least_normal: Array | float = 0.0  # N
    most_normal: Array | float = 1e4  # N
    # relative distance of the final level from the effort; a larger one keeps forces farther from all bounds
    slack: Array | float = MIN_SLACK


class ForceProblem(NamedTuple):
    """Pose of the robot and bounds on its foot forces, for which forces are searched."""

    pose: ForcePlanningPose
    bounds: ForceBounds


class ForceSearchState(NamedTuple):
    """State of the search for foot forces after a Newton step."""

    force: Float[Array, "6 3"]  # in weights
    level: Float[Array, " 6"]  # bound of the effort, in weights


class FootForces(NamedTuple):
    """Foot forces in a pose, and the largest friction, torque and normal force that they need."""

    force: Float[Array, "6 3"]  # N, of the surface on the foot, world axes
    friction: Float[Array, ""]  # largest ratio of tangential to normal force
    torque: Float[Array, ""]  # N m, largest of the joints
    normal: Float[Array, ""]  # N, largest
    imbalance: Float[Array, ""]  # in weights (and weights times m), force and moment that are left unsupported


def force_planning_pose(
    robot: Robot, stance: Stance, normal: Float[Array, "6 3"], stands: Bool[Array, " 6"]
) -> ForcePlanningPose:
    """Return the data for force planning (feet, normals, Jacobians) of a robot in a given stance.

    Args:
        robot: the robot, as believed.
        stance: feet and base, world axes; joint angles follow by inverse kinematics.
        normal: outward normals of the surfaces under the feet, world axes.
        stands: which feet stand.
    """
    angles, _ = joint_targets(robot, stance)
    weight = GRAVITY * total_mass(robot)
    quat = jnp.broadcast_to(stance.quat, (6, 4))
    slope = jax.jacfwd(lambda a: rotate(quat, foot_positions(robot, a)))(angles)  # (6, 3, 6, 3)
    lift = jax.grad(lambda a: rotate(stance.quat, mass_centre(robot, a))[2])(angles)
    centre = stance.position + rotate(stance.quat, mass_centre(robot, angles))
    return ForcePlanningPose(
        stance.feet - centre, normal, stands, jnp.einsum("lilj->lij", slope), weight * lift, jnp.asarray(weight)
    )


def joint_torque(pose: ForcePlanningPose, force: Float[Array, "6 3"]) -> Float[Array, "6 3"]:
    """Return the joint torques (N m) that balance foot forces and the weight of the links at rest.

    Args:
        pose: the pose.
        force: forces on the feet (N), world axes.
    """
    return pose.own_torque - jnp.einsum("lij,li->lj", pose.jacobian, force)


def distribute_forces(pose: ForcePlanningPose, bounds: ForceBounds, least: Effort) -> FootForces:
    """Return balanced foot forces within bounds that nearly minimise an effort, such as torque.

    The method of centres: a level slightly above the largest effort is set, a Newton step moves the forces towards the
    point that is farthest, in the logarithmic sense, from the level and all bounds, and so on with a shrinking margin.
    With the least `slack`, the effort ends within about 3 % of the optimum. The `imbalance` stays below 1 % if
    admissible forces exist, and above it if there are none.

    Args:
        pose: the pose.
        bounds: bounds on the forces.
        least: effort to minimise.
    """
    problem = ForceProblem(pose, ForceBounds(*(jnp.asarray(b, float) for b in bounds)))
    return evaluate_forces(pose, make_force_search(least)(jax.tree.map(lambda x: x[None], problem))[0])


def make_force_search(least: Effort) -> Callable[[ForceProblem], Float[Array, "n 6 3"]]:
    """Return a function that finds balanced foot forces, in units of the robot's weight, for n poses at once.

    In a traced program it is a single operation with a name from `SEARCHES`, so that the package's own compiler can
    replace it by a faster one that treats all problems in parallel.
    """
    return _SEARCH_BY_EFFORT[least]


def _make_search(least: Effort) -> Callable[[ForceProblem], Float[Array, "n 6 3"]]:
    def one(problem: ForceProblem) -> Array:
        task = _SearchTask.from_problem(problem)
        return jax.lax.fori_loop(0, len(SLACK), lambda k, s: task.step(s, k, least), task.initial_state).force

    def search(problems: ForceProblem) -> Array:
        return jax.vmap(one)(problems)

    search.__name__ = f"forces_of_least_{least}"
    return jax.jit(search)


def force_search_step(
    least: Effort, problem: ForceProblem, search: ForceSearchState, number: Int[Array, ""]
) -> ForceSearchState:
    """Run one Newton step of the search for foot forces in a single pose.

    Args:
        least: effort to minimise.
        problem: pose and bounds.
        search: state after the step before; ignored by step 0.
        number: number of the step.
    """
    return _SearchTask.from_problem(problem).step(search, number, least)


def evaluate_forces(pose: ForcePlanningPose, force: Float[Array, "6 3"]) -> FootForces:
    """Convert foot forces from units of weight to N, and compute the friction and torques that they need.

    Args:
        pose: the pose.
        force: forces on the feet, in weights, world axes.
    """
    scaled = _ScaledPose.from_pose(pose)
    sound = jnp.all(jnp.isfinite(force))  # Newton's method may diverge far from a solution
    force = jnp.where(sound, force, 0.0)
    efforts = {name: jnp.max(scaled.effort(force, name)) for name in _BOUND}
    return FootForces(
        force * pose.weight,
        efforts["friction"],
        efforts["torque"] * pose.weight,
        efforts["normal"] * pose.weight,
        jnp.max(jnp.abs(scaled.imbalance(force))),
    )


class _ScaledPose(NamedTuple):
    """A pose with forces in units of the weight; swinging feet carry nothing and have no bounds."""

    normal: Float[Array, "6 3"]
    stands: Float[Array, " 6"]
    grasp: Float[Array, "6 6 3"]  # force and moment about the mass centre by a foot's force
    drive: Float[Array, "6 3 3"]  # joint torques by a foot's force
    own: Float[Array, "6 3"]

    @classmethod
    def from_pose(cls, pose: ForcePlanningPose) -> "_ScaledPose":
        stands = pose.stands.astype(pose.arm.dtype)
        eye = jnp.broadcast_to(jnp.eye(3, dtype=stands.dtype), (6, 3, 3))
        moment = jnp.cross(pose.arm[:, None, :], eye).swapaxes(1, 2)
        grasp = jnp.concatenate([eye, moment], axis=1) * stands[:, None, None]
        return cls(pose.normal, stands, grasp, -pose.jacobian.swapaxes(1, 2), pose.own_torque / pose.weight)

    def initial_forces(self, bounds: ForceBounds) -> Array:
        """Return unbalanced forces along the normals, within the bounds if the least normal force permits it."""
        pull = jnp.abs(jnp.einsum("lij,lj->li", self.drive, self.normal)) + 1e-6
        most = jnp.min((jnp.asarray(bounds.torque)[:, None] - jnp.abs(self.own)) / pull, axis=-1)
        size = 0.5 * (bounds.least_normal + jnp.minimum(most, bounds.most_normal))
        return self.normal * jnp.minimum(size, bounds.least_normal + 0.5)[:, None] * self.stands[:, None]

    def torque(self, force: Array) -> Array:
        return self.own + jnp.einsum("lij,lj->li", self.drive, force)

    def effort(self, force: Array, kind: Effort) -> Float[Array, " 6"]:
        """Return the effort of each foot."""
        normal = jnp.sum(force * self.normal, axis=-1)
        if kind == "torque":
            return jnp.max(jnp.abs(self.torque(force)), axis=-1) * self.stands
        if kind == "normal":
            return normal * self.stands
        tangential = jnp.sqrt(jnp.sum((force - normal[:, None] * self.normal) ** 2, axis=-1) + 1e-12)
        return jnp.where(self.stands > 0, tangential / jnp.maximum(normal, 1e-6), 0.0)

    def imbalance(self, force: Array) -> Float[Array, " 6"]:
        """Return the unsupported weight and its moment (m)."""
        weight = jnp.zeros(6, force.dtype).at[2].set(1.0)
        return weight - jnp.einsum("lij,lj->i", self.grasp, force)

    def margins(self, force: Array, bounds: ForceBounds) -> dict[Effort, Float[Array, "6 k"]]:
        """Return the distances of forces to their bounds, positive inside."""
        normal = jnp.sum(force * self.normal, axis=-1)
        tangential = jnp.sum((force - normal[:, None] * self.normal) ** 2, axis=-1)
        torque = self.torque(force)
        cap = jnp.asarray(bounds.torque)[:, None]
        margins: dict[Effort, Array] = {
            "friction": jnp.stack([(bounds.friction * normal) ** 2 - tangential, normal - bounds.least_normal], -1),
            "torque": jnp.concatenate([cap - torque, cap + torque], axis=-1),
            "normal": (bounds.most_normal - normal)[:, None],
        }
        return {kind: jnp.where(self.stands[:, None] > 0, r, 1.0) for kind, r in margins.items()}

    def barrier(self, force: Array, bounds: ForceBounds, least: Effort) -> Array:
        weight = {kind: EFFORT_WEIGHT if kind == least else 1.0 for kind in _BOUND}
        logs = {kind: jnp.sum(jnp.log(margins)) for kind, margins in self.margins(force, bounds).items()}
        return -sum((weight[kind] * logs[kind] for kind in logs), jnp.zeros(()))

    def newton_step(self, force: Array, bounds: ForceBounds, least: Effort) -> Array:
        """Return forces after a Newton step towards balance and the centre of the bounds, shortened to stay inside."""
        gradient = jax.grad(self.barrier)(force, bounds, least)
        swings = (1 - self.stands)[:, None, None] * jnp.eye(3, dtype=force.dtype)
        curvature = jnp.stack(
            [  # a foot's force affects its own bounds only
                jax.jvp(lambda f: jax.grad(self.barrier)(f, bounds, least), (force,), (jnp.zeros_like(force) + axis,))[
                    1
                ]
                for axis in jnp.eye(3, dtype=force.dtype)
            ],
            axis=-1,
        )
        inverse = _inverse_3x3(curvature + swings)
        down = -jnp.einsum("lij,lj->li", inverse, gradient)
        across = jnp.einsum("lij,lkj->lik", inverse, self.grasp)  # (6, 3, 6)
        schur = jnp.einsum("lij,ljk->ik", self.grasp, across)
        scale = jnp.sqrt(jnp.diagonal(schur) + 1e-12)
        schur = schur / scale / scale[:, None] + 1e-6 * jnp.eye(6, dtype=force.dtype)
        short = self.imbalance(force) - jnp.einsum("lij,lj->i", self.grasp, down)
        direction = down + across @ (_solve_6x6(schur, short / scale) / scale)
        margins = self.margins(force, bounds)

        def fits(length: Array) -> Array:
            after = self.margins(force + length * direction, bounds)
            is_inside = [jnp.all(after[k] > MARGIN_KEPT * margins[k]) for k in margins]
            return jnp.stack(is_inside).all()

        lengths = jnp.asarray(STEP_LENGTHS, force.dtype)
        length = jnp.max(jnp.where(jax.vmap(fits)(lengths), lengths, 0.0))
        return force + length * direction


class _SearchTask(NamedTuple):
    """A force problem in scaled form."""

    scaled: _ScaledPose
    bounds: ForceBounds  # of each foot, in weights
    slack: Float[Array, ""]  # over `MIN_SLACK`

    @classmethod
    def from_problem(cls, problem: ForceProblem) -> "_SearchTask":
        (pose, bounds), scaled = problem, _ScaledPose.from_pose(problem.pose)
        start = ForceBounds(
            bounds.friction,
            bounds.torque / pose.weight,
            bounds.least_normal / pose.weight,
            bounds.most_normal / pose.weight,
        )
        each = ForceBounds(*[jnp.broadcast_to(jnp.asarray(b, scaled.normal.dtype), (6,)) for b in start])
        return cls(scaled, each, jnp.asarray(bounds.slack / MIN_SLACK, scaled.normal.dtype))

    @property
    def initial_state(self) -> ForceSearchState:
        """Return the state of the search before its first step."""
        return ForceSearchState(jnp.zeros_like(self.scaled.normal), jnp.zeros_like(self.scaled.stands))

    def step(self, search: ForceSearchState, number: Array, least: Effort) -> ForceSearchState:
        """Return the state of the search after a Newton step."""
        force = jnp.where(number == 0, self.scaled.initial_forces(self.bounds), search.force)
        slack = jnp.asarray(SLACK, force.dtype)[number] * self.slack
        above = (1 + slack) * jnp.max(self.scaled.effort(force, least))
        level = jnp.where(number % 2 == 0, jnp.minimum(above, getattr(self.bounds, _BOUND[least])), search.level)
        lower = self.bounds._replace(**{_BOUND[least]: level})
        return ForceSearchState(self.scaled.newton_step(force, lower, least), level)


_SEARCH_BY_EFFORT: dict[Effort, Callable[[ForceProblem], Array]] = {least: _make_search(least) for least in _BOUND}
SEARCHES: dict[str, Effort] = {search.__name__: least for least, search in _SEARCH_BY_EFFORT.items()}


class ForcePlan(NamedTuple):
    """Planned foot forces at `KNOTS` evenly spaced times of each of S stages; made by `plan_forces`."""

    force: Float[Array, "s k 6 3"]  # N, on the feet, world axes
    torque: Float[Array, "s k 6 3"]  # N m, of the joints
    optimum: FootForces  # optimum of each moment by itself, leading axes (s, k)


def planned_pose(belief: Case, plan: Plan, stage: Int[Array, ""], u: Float[Array, ""]) -> ForcePlanningPose:
    """Return the pose for force planning at a phase `u` of a stage, with free bodies at their start poses.

    Args:
        belief: believed parameters.
        plan: the plan.
        stage: stage number.
        u: phase of the stage, 0 to 1.
    """
    free, frames = free_start_state(belief.obstacle), (plan.foot_frame[stage], plan.base_frame[stage])
    feet, position = stage_start_pose(plan, stage, free)
    stance = stance_to_world(reference_stance(plan, stage, u, feet, position), *frames, free)
    normal = surface_under_feet(belief.obstacle, feet, plan.foot_frame[stage]).normal
    return force_planning_pose(belief.robot, stance, normal, ~plan.swing[stage])


def plan_forces(belief: Case, plan: Plan, bounds: ForceBounds, least: Effort) -> ForcePlan:
    """Plan foot forces for all stages of a plan, with the feet on the obstacle as believed.

    In stages without any motion, forces change linearly from those before to those after. So feet are unloaded when
    their swing starts.

    Args:
        belief: believed parameters.
        plan: the plan.
        bounds: bounds on the forces.
        least: effort to minimise.
    """
    stages = plan.duration.shape[0]
    number, phases = jnp.arange(stages), jnp.linspace(0.0, 1.0, KNOTS)
    _, base = jax.vmap(lambda s: stage_start_pose(plan, s, free_start_state(belief.obstacle)))(number)
    poses = jax.vmap(lambda k: planned_pose(belief, plan, number[k // KNOTS], phases[k % KNOTS]))(
        jnp.arange(stages * KNOTS)
    )
    every_bounds = jax.tree.map(
        lambda b: jnp.broadcast_to(jnp.asarray(b, float), (stages * KNOTS, *jnp.shape(b))), bounds
    )
    optima = jax.vmap(evaluate_forces)(poses, make_force_search(least)(ForceProblem(poses, every_bounds)))
    poses, planned = jax.tree.map(lambda x: x.reshape(stages, KNOTS, *x.shape[1:]), (poses, optima))
    force = planned.force
    before = jnp.concatenate([force[:1, 0], force[:-1, -1]])[:, None]
    after = jnp.concatenate([force[1:, 0], force[-1:, -1]])[:, None]
    is_moving = jnp.linalg.norm(plan.position - base, axis=-1) + jnp.linalg.norm(plan.turn, axis=-1) > MOTION_THRESHOLD
    is_rest = ~jnp.any(plan.swing, axis=-1) & ~is_moving
    share = phases[:, None, None]
    force = jnp.where(is_rest[:, None, None, None], (1 - share) * before + share * after, force)
    return ForcePlan(force, jax.vmap(jax.vmap(joint_torque))(poses, force), planned)


@parameters
class PlannedForces(Manoeuvre):
    """Base class of manoeuvres that hold on to an obstacle by planned foot forces."""

    plans_forces: ClassVar = True

    effort: str = choice("friction", "friction", "torque", "normal")  # which effort the planned forces minimise
    load_time: float = quantity(0.4, "s", above=0, at_most=10)  # time of the load transfer between feet before a swing
    # share of the believed friction that the forces may use
    friction_share: float = quantity(1.0, "-", above=0, at_most=1)
    # share of the drives' believed torque limit that the forces may use
    torque_share: float = quantity(0.85, "-", above=0, at_most=1)
    least_normal: float = quantity(8.0, "N", at_least=0)  # least normal force of a standing foot
    # relative increase of the effort over its minimum that is accepted to stay away from all other bounds
    slack: float = quantity(MIN_SLACK, "-", at_least=MIN_SLACK, at_most=2)
    creep: float = quantity(0.0125, "m/s", at_least=0)  # speed at which a foot that missed the surface moves on into it
    anchoring: float = quantity(0.01, "s", above=0)  # time constant with which footholds follow the measured feet

    def insert_load_transfers(self, stages: Sequence[Stage]) -> list[Stage]:
        """Return the stages with a rest before each, in which the feet that swing next are unloaded.

        A rest is in the frames of the stage before it.
        """
        previous_stages = [Stage("", 0.0), *stages]
        return [s for previous, stage in zip(previous_stages, stages, strict=False) for s in (
            Stage(f"{stage.name}.{LOAD}", self.load_time, law=LOAD,
                  foot_frames=previous.foot_frames, base_frame=previous.base_frame), stage
        )]  # fmt: skip

    def force_bounds(self, belief: Case) -> ForceBounds:
        """Return the bounds on normal force, friction and torque of the feet for force planning."""
        friction, torque = self.friction_share * belief.contact.friction, self.torque_share * belief.drive.torque_limit
        return ForceBounds(friction, torque, self.least_normal, slack=self.slack)

    def force_plan(self, belief: Case, plan: Plan) -> ForcePlan:
        """Plan the foot forces along a plan that take the least effort, as `effort` measures it.

        Args:
            belief: believed parameters.
            plan: the plan.
        """
        return plan_forces(belief, plan, self.force_bounds(belief), cast(Effort, self.effort))

    def add_force_feedforward(self, belief: Case, plan: Plan) -> Plan:
        """Return the plan with a tracker layer whose joint offsets produce the planned foot forces.

        Args:
            belief: believed parameters.
            plan: the plan.
        """
        course = self.force_plan(belief, plan)
        inward = -jax.vmap(lambda *feet: surface_under_feet(belief.obstacle, *feet).normal)(
            plan.foothold, plan.foot_frame
        )
        offset = course.torque / belief.drive.stiffness
        rates = (jnp.asarray(x, float) for x in (self.creep, self.anchoring))
        return plan.replace_layer(ForceFeedforward(offset, jnp.max(course.optimum.imbalance, axis=-1), inward, *rates))


def _solve_6x6(m: Float[Array, "6 6"], right: Float[Array, " 6"]) -> Float[Array, " 6"]:
    """Solution of m x = right for a positive definite m, by 3x3 blocks."""
    first, cross, last = m[:3, :3], m[:3, 3:], m[3:, 3:]
    inverse = _inverse_3x3(first)
    force = inverse @ right[:3]
    moment = _inverse_3x3(last - cross.T @ inverse @ cross) @ (right[3:] - cross.T @ force)
    return jnp.concatenate([force - inverse @ cross @ moment, moment])


def _inverse_3x3(m: Float[Array, "*b 3 3"]) -> Float[Array, "*b 3 3"]:
    """Inverses of 3x3 matrices by cofactors."""
    x, y, z = m[..., 0, :], m[..., 1, :], m[..., 2, :]
    columns = jnp.stack([jnp.cross(y, z), jnp.cross(z, x), jnp.cross(x, y)], axis=-1)
    determinant = jnp.sum(x * columns[..., :, 0], axis=-1)
    return columns / determinant[..., None, None]

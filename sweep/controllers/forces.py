"""Force planning: with which foot forces a standing robot holds its weight (monograph 2.1, for any stance).

The equations of balance leave the forces of more than two standing feet open. Here they are chosen so that the largest
of one quantity (friction used, joint torque, or normal force) is least, within friction cones and limits. The answer
is a centre of the forces that do nearly as well, not their extreme: it changes smoothly with the pose.
"""

from collections.abc import Callable, Sequence
from typing import Literal, NamedTuple, cast

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from sweep.controllers.frames import Stance, ground, stance_to_world
from sweep.controllers.layers import Feedforward
from sweep.controllers.plan import Plan, Stage, begins, reference
from sweep.controllers.posture import foot_positions, joint_targets, mass_centre
from sweep.core.constants import GRAVITY
from sweep.core.parameters import choice, parameters, quantity
from sweep.core.rotations import rotate
from sweep.models.case import Case
from sweep.models.obstacles.surface import free_start
from sweep.models.robot import Robot, total_mass

Effort = Literal["friction", "torque", "normal"]
_BOUND: dict[Effort, str] = {"friction": "friction", "torque": "torque", "normal": "most_normal"}

# By how much the level of each Newton step lies above the largest effort, that before every second step: first no
# level, from no balance to the first centre. In the end by `LAST`, if `Bounds` says nothing else.
LAST = 0.01
SLACK = np.repeat(np.array([1e12] * 12 + list(np.geomspace(5 * LAST, LAST, 40)), np.float32), 2)
LENGTHS = (1.0, 0.7, 0.5, 0.3, 0.15, 0.07, 0.03, 0.01)  # of a Newton step, of which the longest that fits is taken
FOCUS = 8.0  # weight of the pressed bounds against all others
KEEP = 0.2  # of the room to a bound that a step has to leave
MOVES = 1e-5  # m and rad, of a base that does: more than single precision makes of changing frames
LOAD = "load"  # law of rests in which load goes over
KNOTS = 5  # moments of a stage for which forces are planned


class StaticPose(NamedTuple):
    """A pose of the robot as far as forces are concerned. World axes."""

    arm: Float[Array, "6 3"]  # m, feet from the robot's mass centre
    normal: Float[Array, "6 3"]  # of the surfaces under the feet, outward
    stands: Bool[Array, " 6"]
    jacobian: Float[Array, "6 3 3"]  # m, of a foot by its leg's joints
    own_torque: Float[Array, "6 3"]  # N m, that holds the leg's links up
    weight: Float[Array, ""]  # N


class Bounds(NamedTuple):
    """What forces have to keep to; each a number or one for each foot."""

    friction: Array | float  # coefficient
    torque: Array | float  # N m, of a joint
    least_normal: Array | float = 0.0  # N
    most_normal: Array | float = 1e4  # N
    # share of the effort that the level above it is away: the more, the farther are forces from all other bounds
    slack: Array | float = LAST


class Sought(NamedTuple):
    """What forces are planned for."""

    pose: StaticPose
    bounds: Bounds


class Search(NamedTuple):
    """How far the method of centres has come."""

    force: Float[Array, "6 3"]  # weights
    level: Float[Array, " 6"]  # bound of the effort, in weights


class FootForces(NamedTuple):
    """Planned foot forces, and the most that they ask for."""

    force: Float[Array, "6 3"]  # N, of the surface on the foot
    friction: Float[Array, ""]  # largest tangential over normal force
    torque: Float[Array, ""]  # N m, largest of the joints
    normal: Float[Array, ""]  # N, largest
    imbalance: Float[Array, ""]  # in weights (and weights times m): what is not held


def pose(robot: Robot, stance: Stance, normal: Float[Array, "6 3"], stands: Bool[Array, " 6"]) -> StaticPose:
    """The robot in a stance, its joints where inverse kinematics has them."""
    angles, _ = joint_targets(robot, stance)
    weight = GRAVITY * total_mass(robot)
    quat = jnp.broadcast_to(stance.quat, (6, 4))
    slope = jax.jacfwd(lambda a: rotate(quat, foot_positions(robot, a)))(angles)  # (6, 3, 6, 3)
    lift = jax.grad(lambda a: rotate(stance.quat, mass_centre(robot, a))[2])(angles)
    centre = stance.position + rotate(stance.quat, mass_centre(robot, angles))
    return StaticPose(
        stance.feet - centre, normal, stands, jnp.einsum("lilj->lij", slope), weight * lift, jnp.asarray(weight)
    )


def joint_torque(pose: StaticPose, force: Float[Array, "6 3"]) -> Float[Array, "6 3"]:
    """Drive torques (N m) under foot forces (N) at rest."""
    return pose.own_torque - jnp.einsum("lij,li->lj", pose.jacobian, force)


def distribute(pose: StaticPose, bounds: Bounds, least: Effort) -> FootForces:
    """Foot forces in balance within `bounds` that ask for nearly the least of one effort.

    The method of centres: a level is set a little above the largest effort, Newton's method takes the forces towards
    the point that is farthest, in the logarithmic sense, from the level and all bounds, and so on with ever less room.
    With the least `slack` the effort ends within some 3 % of the least possible one. What is left of the weight
    (`imbalance`) stays below 1 % where forces within the bounds exist, and above it where there are none.
    """
    sought = Sought(pose, Bounds(*(jnp.asarray(b, float) for b in bounds)))
    return asked(pose, searched(least)(jax.tree.map(lambda x: x[None], sought))[0])


def searched(least: Effort) -> Callable[[Sought], Float[Array, "n 6 3"]]:
    """What finds forces in weights for n poses within bounds.

    In a traced program it is one operation, which goes by the name of `SEARCHES`: this package's own compiler can take
    its place, since poses have nothing to do with each other.
    """
    return _SEARCHED[least]


def _by_xla(least: Effort) -> Callable[[Sought], Float[Array, "n 6 3"]]:
    def one(sought: Sought) -> Array:
        problem = _Task.of(sought)
        return jax.lax.fori_loop(0, len(SLACK), lambda k, s: problem.step(s, k, least), problem.nothing).force

    def search(sought: Sought) -> Array:
        return jax.vmap(one)(sought)

    search.__name__ = f"forces_of_least_{least}"
    return jax.jit(search)


def step(least: Effort, sought: Sought, so_far: Search, number: Int[Array, ""]) -> Search:
    """Newton step `number` of the search for one pose, the first of which takes nothing from `so_far`."""
    return _Task.of(sought).step(so_far, number, least)


def asked(pose: StaticPose, force: Float[Array, "6 3"]) -> FootForces:
    """Forces in weights, and what they ask for."""
    scaled = _Scaled.of(pose)
    sound = jnp.all(jnp.isfinite(force))  # far from any solution Newton's method may break down
    force = jnp.where(sound, force, 0.0)
    efforts = {name: jnp.max(scaled.effort(force, name)) for name in _BOUND}
    return FootForces(
        force * pose.weight,
        efforts["friction"],
        efforts["torque"] * pose.weight,
        efforts["normal"] * pose.weight,
        jnp.max(jnp.abs(scaled.left(force))),
    )


class _Scaled(NamedTuple):
    """A pose with forces in weights; swinging feet carry nothing and count nowhere."""

    normal: Float[Array, "6 3"]
    stands: Float[Array, " 6"]
    grasp: Float[Array, "6 6 3"]  # force and moment about the mass centre, by a foot's force
    drive: Float[Array, "6 3 3"]  # joint torques by a foot's force
    own: Float[Array, "6 3"]

    @classmethod
    def of(cls, pose: StaticPose) -> "_Scaled":
        stands = pose.stands.astype(pose.arm.dtype)
        eye = jnp.broadcast_to(jnp.eye(3, dtype=stands.dtype), (6, 3, 3))
        moment = jnp.cross(pose.arm[:, None, :], eye).swapaxes(1, 2)
        grasp = jnp.concatenate([eye, moment], axis=1) * stands[:, None, None]
        return cls(pose.normal, stands, grasp, -pose.jacobian.swapaxes(1, 2), pose.own_torque / pose.weight)

    def first(self, bounds: Bounds) -> Array:
        """Forces along the normals, not in balance, within the bounds where the smallest normal force allows it."""
        pull = jnp.abs(jnp.einsum("lij,lj->li", self.drive, self.normal)) + 1e-6
        most = jnp.min((jnp.asarray(bounds.torque)[:, None] - jnp.abs(self.own)) / pull, axis=-1)
        size = 0.5 * (bounds.least_normal + jnp.minimum(most, bounds.most_normal))
        return self.normal * jnp.minimum(size, bounds.least_normal + 0.5)[:, None] * self.stands[:, None]

    def torque(self, force: Array) -> Array:
        return self.own + jnp.einsum("lij,lj->li", self.drive, force)

    def effort(self, force: Array, kind: Effort) -> Float[Array, " 6"]:
        """What each foot asks for."""
        normal = jnp.sum(force * self.normal, axis=-1)
        if kind == "torque":
            return jnp.max(jnp.abs(self.torque(force)), axis=-1) * self.stands
        if kind == "normal":
            return normal * self.stands
        tangential = jnp.sqrt(jnp.sum((force - normal[:, None] * self.normal) ** 2, axis=-1) + 1e-12)
        return jnp.where(self.stands > 0, tangential / jnp.maximum(normal, 1e-6), 0.0)

    def left(self, force: Array) -> Float[Array, " 6"]:
        """Weight that is not held, and its moment (m)."""
        weight = jnp.zeros(6, force.dtype).at[2].set(1.0)
        return weight - jnp.einsum("lij,lj->i", self.grasp, force)

    def room(self, force: Array, bounds: Bounds) -> dict[Effort, Float[Array, "6 k"]]:
        """What is left to each bound; positive within."""
        normal = jnp.sum(force * self.normal, axis=-1)
        tangential = jnp.sum((force - normal[:, None] * self.normal) ** 2, axis=-1)
        torque = self.torque(force)
        cap = jnp.asarray(bounds.torque)[:, None]
        room: dict[Effort, Array] = {
            "friction": jnp.stack([(bounds.friction * normal) ** 2 - tangential, normal - bounds.least_normal], -1),
            "torque": jnp.concatenate([cap - torque, cap + torque], axis=-1),
            "normal": (bounds.most_normal - normal)[:, None],
        }
        return {kind: jnp.where(self.stands[:, None] > 0, r, 1.0) for kind, r in room.items()}

    def barrier(self, force: Array, bounds: Bounds, least: Effort) -> Array:
        weight = {kind: FOCUS if kind == least else 1.0 for kind in _BOUND}
        logs = {kind: jnp.sum(jnp.log(room)) for kind, room in self.room(force, bounds).items()}
        return -sum((weight[kind] * logs[kind] for kind in logs), jnp.zeros(()))

    def towards_centre(self, force: Array, bounds: Bounds, least: Effort) -> Array:
        """A Newton step towards balance and the centre of what the bounds leave, short enough to stay within."""
        gradient = jax.grad(self.barrier)(force, bounds, least)
        swings = (1 - self.stands)[:, None, None] * jnp.eye(3, dtype=force.dtype)
        curvature = jnp.stack(
            [  # a foot's force bears on its own bounds only
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
        short = self.left(force) - jnp.einsum("lij,lj->i", self.grasp, down)
        direction = down + across @ (_solved(schur, short / scale) / scale)
        now = self.room(force, bounds)

        def fits(length: Array) -> Array:
            then = self.room(force + length * direction, bounds)
            kept = [jnp.all(then[k] > KEEP * now[k]) for k in now]
            return jnp.stack(kept).all()

        lengths = jnp.asarray(LENGTHS, force.dtype)
        length = jnp.max(jnp.where(jax.vmap(fits)(lengths), lengths, 0.0))
        return force + length * direction


class _Task(NamedTuple):
    """A pose, what forces have to keep to there, and how far the levels are away."""

    scaled: _Scaled
    bounds: Bounds  # of each foot, in weights
    slack: Float[Array, ""]  # over `LAST`

    @classmethod
    def of(cls, sought: Sought) -> "_Task":
        (pose, bounds), scaled = sought, _Scaled.of(sought.pose)
        start = Bounds(
            bounds.friction,
            bounds.torque / pose.weight,
            bounds.least_normal / pose.weight,
            bounds.most_normal / pose.weight,
        )
        each = Bounds(*[jnp.broadcast_to(jnp.asarray(b, scaled.normal.dtype), (6,)) for b in start])
        return cls(scaled, each, jnp.asarray(bounds.slack / LAST, scaled.normal.dtype))

    @property
    def nothing(self) -> Search:
        """The search before its first step."""
        return Search(jnp.zeros_like(self.scaled.normal), jnp.zeros_like(self.scaled.stands))

    def step(self, so_far: Search, number: Array, least: Effort) -> Search:
        """The search a Newton step later."""
        force = jnp.where(number == 0, self.scaled.first(self.bounds), so_far.force)
        slack = jnp.asarray(SLACK, force.dtype)[number] * self.slack
        above = (1 + slack) * jnp.max(self.scaled.effort(force, least))
        level = jnp.where(number % 2 == 0, jnp.minimum(above, getattr(self.bounds, _BOUND[least])), so_far.level)
        lower = self.bounds._replace(**{_BOUND[least]: level})
        return Search(self.scaled.towards_centre(force, lower, least), level)


_SEARCHED: dict[Effort, Callable[[Sought], Array]] = {least: _by_xla(least) for least in _BOUND}
SEARCHES: dict[str, Effort] = {search.__name__: least for least, search in _SEARCHED.items()}


class Course(NamedTuple):
    """Planned forces along a plan: S stages, `KNOTS` even moments of each."""

    force: Float[Array, "s k 6 3"]  # N
    torque: Float[Array, "s k 6 3"]  # N m, of the joints
    planned: FootForces  # the optimum of each moment by itself, leading axes (s, k)


def moment(belief: Case, plan: Plan, stage: Int[Array, ""], u: Float[Array, ""]) -> StaticPose:
    """The pose at phase `u` of a stage as planned, bodies as they start."""
    free, frames = free_start(belief.obstacle), (plan.foot_frame[stage], plan.base_frame[stage])
    feet, position = begins(plan, stage, free)
    stance = stance_to_world(reference(plan, stage, u, feet, position), *frames, free)
    normal = ground(belief.obstacle, feet, plan.foot_frame[stage]).normal
    return pose(belief.robot, stance, normal, ~plan.swing[stage])


def along(belief: Case, plan: Plan, bounds: Bounds, least: Effort) -> Course:
    """Foot forces for all of a plan, the feet on the believed obstacle.

    In a stage in which nothing moves, load goes evenly from the forces before it to those after it: so that feet that
    are to swing carry nothing when they do.
    """
    stages = plan.duration.shape[0]
    number, phases = jnp.arange(stages), jnp.linspace(0.0, 1.0, KNOTS)
    _, base = jax.vmap(lambda s: begins(plan, s, free_start(belief.obstacle)))(number)
    poses = jax.vmap(lambda k: moment(belief, plan, number[k // KNOTS], phases[k % KNOTS]))(jnp.arange(stages * KNOTS))
    each = jax.tree.map(lambda b: jnp.broadcast_to(jnp.asarray(b, float), (stages * KNOTS, *jnp.shape(b))), bounds)
    found = jax.vmap(asked)(poses, searched(least)(Sought(poses, each)))
    poses, planned = jax.tree.map(lambda x: x.reshape(stages, KNOTS, *x.shape[1:]), (poses, found))
    force = planned.force
    before = jnp.concatenate([force[:1, 0], force[:-1, -1]])[:, None]
    after = jnp.concatenate([force[1:, 0], force[-1:, -1]])[:, None]
    moves = jnp.linalg.norm(plan.position - base, axis=-1) + jnp.linalg.norm(plan.turn, axis=-1) > MOVES
    rests = ~jnp.any(plan.swing, axis=-1) & ~moves
    share = phases[:, None, None]
    force = jnp.where(rests[:, None, None, None], (1 - share) * before + share * after, force)
    return Course(force, jax.vmap(jax.vmap(joint_torque))(poses, force), planned)


@parameters
class PlannedForces:
    """What a manoeuvre that holds on with planned forces needs to be told of them; a base of its own parameters."""

    effort: str = choice("friction", "friction", "torque", "normal")  # of which the forces ask for the least
    load_time: float = quantity(0.4, "s", above=0, at_most=10)  # for load to go from foot to foot before a swing
    friction_share: float = quantity(1.0, "-", above=0, at_most=1)  # of the believed friction, planned with at most
    torque_share: float = quantity(0.85, "-", above=0, at_most=1)  # of the believed drives' limit
    least_normal: float = quantity(8.0, "N", at_least=0)  # force of a standing foot
    # share of the effort by which forces may ask for more than it, to keep away from all other bounds
    slack: float = quantity(LAST, "-", at_least=LAST, at_most=2)
    creep: float = quantity(0.0125, "m/s", at_least=0)  # inwards, of a foot that has missed the surface
    anchoring: float = quantity(0.01, "s", above=0)  # in which footholds follow the feet

    def loading(self, stages: Sequence[Stage]) -> list[Stage]:
        """`stages` with a rest before each of them, in which load goes off the feet that are to swing.

        A rest is in the frames of the stage before it.
        """
        before = [Stage("", 0.0), *stages]
        return [s for last, stage in zip(before, stages, strict=False) for s in (
            Stage(f"{stage.name}.{LOAD}", self.load_time, law=LOAD,
                  foot_frames=last.foot_frames, base_frame=last.base_frame), stage
        )]  # fmt: skip

    def bounds(self, belief: Case) -> Bounds:
        """What forces have to keep to."""
        friction, torque = self.friction_share * belief.contact.friction, self.torque_share * belief.drive.torque_limit
        return Bounds(friction, torque, self.least_normal, slack=self.slack)

    def course(self, belief: Case, plan: Plan) -> Course:
        """The forces of least `effort` along `plan`."""
        return along(belief, plan, self.bounds(belief), cast(Effort, self.effort))

    def with_feedforward(self, belief: Case, plan: Plan) -> Plan:
        """`plan` with its `course` as offsets of what the believed drives are told (`Feedforward`)."""
        course = self.course(belief, plan)
        inward = -jax.vmap(lambda *feet: ground(belief.obstacle, *feet).normal)(plan.foothold, plan.foot_frame)
        offset = course.torque / belief.drive.stiffness
        told = (jnp.asarray(x, float) for x in (self.creep, self.anchoring))
        return plan.with_layer(Feedforward(offset, jnp.max(course.planned.imbalance, axis=-1), inward, *told))


def _solved(m: Float[Array, "6 6"], right: Float[Array, " 6"]) -> Float[Array, " 6"]:
    """m^-1 right of a positive definite m by its quarters, in arithmetic alone."""
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

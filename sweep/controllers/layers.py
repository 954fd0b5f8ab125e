"""What a plan adds to the core of its tracker: layers, each with a table of its own, and a state where it needs one."""

from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from sweep.controllers.frames import Stance, to_frame, to_world
from sweep.controllers.observation import Observation
from sweep.controllers.plan import Plan
from sweep.controllers.posture import feet_in_world
from sweep.core.rotations import nearest
from sweep.formulas import stepping
from sweep.models.drive import Servo
from sweep.models.obstacles.surface import FreeState
from sweep.models.robot import Robot

SOON = 0.1  # s after the end of a swing, in which all its feet go on inwards; then those do that hang
FASTER = 3.0  # than all of them, those go on that hang


class Now(NamedTuple):
    """A control tick as layers and guidance see it."""

    robot: Robot  # as it is believed
    plan: Plan
    before: Int[Array, ""]  # stage of the last tick
    stage: Int[Array, ""]
    clock: Float[Array, ""]  # s since the stage began
    phase: Float[Array, ""]  # of the stage, 0 to 1
    begins: Bool[Array, ""]  # whether this is its first tick
    seen: Observation
    free: FreeState  # as the stage has them
    period: float  # s
    joints: Float[Array, "6 3"]  # rad, last targets
    untold: Array | float = 0.0  # s, for which a foot stands before its load is seen
    behind: Array | float = 0.0  # s, by which loads are seen later than places


class Command(NamedTuple):
    """What the controller asks for at the end of a tick."""

    joints: Float[Array, "6 3"]  # rad
    target: Stance
    phase: Float[Array, ""]  # of the stage, 0 to 1
    shortfall: Float[Array, " 6"]  # m, by how much foot targets are out of reach
    own: tuple[Bool[Array, "6 3"], Servo] | None = None  # which joints do otherwise than go to `joints`, and what
    # `target` with the base where exact sensors would have it, which metrics compare the true pose with; None: the same
    reference: Stance | None = None


class Layer:
    """A layer does nothing in moments of which it does not say otherwise."""

    anchors: ClassVar = False  # whether footholds follow the feet, which need not be moved with the base's error then

    def begun(self, start: Stance, joints: Float[Array, "6 3"], free: FreeState) -> Any:
        """Its state before the first tick, with feet in their frames and free bodies as in `free`."""
        return None

    def borne(self, plan: Plan, own: Any, stage: Int[Array, ""], clock: Float[Array, ""], free: FreeState) -> FreeState:
        """Free bodies as a stage has them `clock` s after it began, where they are seen as in `free`."""
        return free

    def entered(self, stage: Int[Array, ""], own: Any, was: FreeState, free: FreeState) -> tuple[Any, FreeState]:
        """Its state and free bodies as a stage begins: seen as in `free`, and as in `was` to the stage before."""
        return own, free

    def blind(self, stage: Int[Array, ""]) -> Bool[Array, ""] | bool:
        """Whether the base's place says nothing of the feet's in a stage."""
        return False

    def anchored(self, now: Now, feet: Float[Array, "6 3"]) -> Float[Array, "6 3"]:
        """Footholds of a stage (m, in its frames), a tick on."""
        return feet

    def crept(
        self, plan: Plan, own: Any, stage: Int[Array, ""], clock: Float[Array, ""], feet: Float[Array, "6 3"],
        behind: Array | float,
    ) -> Float[Array, "6 3"]:  # fmt: skip
        """Feet (m, world axes) as a stage ends `clock` s after it began, where the plan has them at `feet`.

        Loads are seen `behind` s later than places.
        """
        return feet

    def led(self, now: Now, own: Any, target: Stance) -> tuple[Any, Stance]:
        """Its state and the stance (world axes) that the robot goes to, where the stage wants `target`."""
        return own, target

    def commanded(self, now: Now, own: Any, command: Command) -> tuple[Any, Command]:
        """Its state and the command, where the tracker asks for `command`."""
        return own, command

    def driven(self, now: Now, joints: Float[Array, "6 3"]) -> Float[Array, "6 3"]:
        """What the drives are told (rad) to have the joints at `joints`."""
        return joints


class Slack(NamedTuple):
    """Where feet are on their way, see `Ease`. World axes."""

    command: Float[Array, "6 3"]  # m, in the last tick, from the origins of their frames
    left: Float[Array, "6 3"]  # m, from where they stand to where they were commanded before the stage


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Ease(Layer):
    """Feet that go over to where a stage takes them to stand: a jump would have the drives kick."""

    time: Float[Array, ""]  # s, that it takes

    def begun(self, start: Stance, joints: Float[Array, "6 3"], free: FreeState) -> Slack:
        """Feet that stand where they were commanded."""
        return Slack(start.feet, jnp.zeros_like(start.feet))

    def led(self, now: Now, own: Slack, target: Stance) -> tuple[Slack, Stance]:
        """The feet on their way, evenly within `time`."""
        frame, nowhere = now.plan.foot_frame, jnp.zeros((6, 3))
        was, here = (to_world(nowhere, frame[stage], now.free) for stage in (now.before, now.stage))
        left = jnp.where(now.begins, own.command + was - target.feet, own.left)
        feet = target.feet + jnp.clip(1 - now.clock / self.time, 0.0, 1.0) * left
        return Slack(feet - here, left), target._replace(feet=feet)


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class HeldLegs(Layer):
    """Legs that follow joint angles instead of footholds: which do, and where they go, over S stages.

    The state is where the joints (rad) were as the stage began.
    """

    held: Bool[Array, "s 6"]
    joints: Float[Array, "s 6 3"]  # rad, at the end of the stage

    def begun(self, start: Stance, joints: Float[Array, "6 3"], free: FreeState) -> Float[Array, "6 3"]:
        """The joint angles (rad) at the start."""
        return joints

    def commanded(self, now: Now, own: Float[Array, "6 3"], command: Command) -> tuple[Float[Array, "6 3"], Command]:
        """These legs on their straight way in joint space, spent by lambda_1; their reach counts for nothing."""
        origin, held = jnp.where(now.begins, now.joints, own), self.held[now.stage]
        goal = nearest(self.joints[now.stage], origin)
        posed = origin + stepping.trapezoidal_transfer(now.phase, 0.0, 1.0)[0] * (goal - origin)
        joints, target = jnp.where(held[:, None], posed, command.joints), command.target
        feet = feet_in_world(now.robot, target.position, target.quat, joints)
        target = target._replace(feet=jnp.where(held[:, None], feet, target.feet))
        shortfall = jnp.where(held, 0.0, command.shortfall)
        return origin, command._replace(joints=joints, target=target, shortfall=shortfall)


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Feedforward(Layer):
    """Holding on with planned foot forces, over S stages and K even moments of each.

    The drives are told of a force as an offset of their targets. It acts as planned only where the foothold is the
    place at which the foot really stands: 1 mm off is a force as large as the robot's weight. So a foot that
    hangs longer than the others of its swing goes on alone: they would push the base away. The state is how far (m)
    each has gone on alone.
    """

    anchors: ClassVar = True
    offset: Float[Array, "s k 6 3"]  # rad, that the drives turn into the joint torques wanted
    imbalance: Float[Array, " s"]  # what the forces leave of the weight; more than a little where none hold it
    inward: Float[Array, "s 6 3"]  # unit vectors into the surface at the footholds
    creep: Float[Array, ""]  # m/s, of a foot that has not touched down at the end of its swing
    anchoring: Float[Array, ""]  # s, in which the foothold of a loaded foot follows the place where it really is

    def begun(self, start: Stance, joints: Float[Array, "6 3"], free: FreeState) -> Float[Array, " 6"]:
        """No foot has gone on yet."""
        return jnp.zeros(len(joints))

    def entered(
        self, stage: Int[Array, ""], own: Float[Array, " 6"], was: FreeState, free: FreeState
    ) -> tuple[Float[Array, " 6"], FreeState]:
        """No foot has gone on in a stage that begins."""
        return jnp.zeros_like(own), free

    def led(self, now: Now, own: Float[Array, " 6"], target: Stance) -> tuple[Float[Array, " 6"], Stance]:
        """Feet `crept`; farther, those that bear no load long after the end of their swing.

        None that may bear some, since it would push the base away; not before it is known which did in time.
        """
        late = jnp.clip(now.clock - now.plan.duration[now.stage] - (SOON + now.untold), 0.0, now.period)
        bears = now.seen.loaded if now.seen.perhaps is None else now.seen.perhaps
        own = own + jnp.where(bears, 0.0, FASTER * self.creep * late)
        return own, target._replace(feet=self.crept(now.plan, own, now.stage, now.clock, target.feet, now.behind))

    def anchored(self, now: Now, feet: Float[Array, "6 3"]) -> Float[Array, "6 3"]:
        """Those of loaded standing feet follow the feet, no faster than loads are seen behind places."""
        stage, seen = now.stage, now.seen
        places = feet_in_world(now.robot, seen.position, seen.quat, seen.angles)
        real = to_frame(places, now.plan.foot_frame[stage], now.free)
        # a foot that has just left, or come, is followed wrongly for as long as loads come later than places
        time = jnp.maximum(self.anchoring, now.behind)
        share = jnp.where(seen.loaded & ~now.plan.swing[stage], jnp.minimum(1.0, now.period / time), 0.0)
        return feet + share[:, None] * (real - feet)

    def crept(
        self, plan: Plan, own: Float[Array, " 6"], stage: Int[Array, ""], clock: Float[Array, ""],
        feet: Float[Array, "6 3"], behind: Array | float,
    ) -> Float[Array, "6 3"]:  # fmt: skip
        """Swinging feet go on inwards while the stage waits for their touchdown.

        As soon as it may be known which landed in time, since those that go on lift the base off the others; not later
        than `SOON`: feet that really hang have the base sink meanwhile.
        """
        late = jnp.clip(clock - plan.duration[stage] - jnp.minimum(behind, SOON), 0.0, SOON)
        way = (self.creep * late + own)[:, None] * self.inward[stage]
        return feet + jnp.where(plan.swing[stage][:, None], way, 0.0)

    def driven(self, now: Now, joints: Float[Array, "6 3"]) -> Float[Array, "6 3"]:
        """Targets with the offset that the planned forces take."""
        return joints + between(self.offset, now.stage, now.phase)


def between(moments: Float[Array, "s k 6 3"], stage: Int[Array, ""], phase: Float[Array, ""]) -> Float[Array, "6 3"]:
    """What is planned for k even moments of every stage, at `phase` (0 to 1) of one: linear between them."""
    last = moments.shape[1] - 1
    before = jnp.minimum((phase * last).astype(jnp.int32), last - 1)
    share = phase * last - before
    return (1 - share) * moments[stage, before] + share * moments[stage, before + 1]

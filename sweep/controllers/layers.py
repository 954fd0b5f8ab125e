"""What a plan adds to the core of its tracker: layers, each with a table of its own, and a state where it needs one."""

from typing import Any, NamedTuple

from jaxtyping import Array, Bool, Float, Int

from sweep.controllers.observation import Observation
from sweep.controllers.plan import Plan, Stance
from sweep.models.drive import Servo
from sweep.models.obstacles.surface import FreeState
from sweep.models.robot import Robot


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


class Command(NamedTuple):
    """What the controller asks for at the end of a tick."""

    joints: Float[Array, "6 3"]  # rad
    target: Stance
    phase: Float[Array, ""]  # of the stage, 0 to 1
    shortfall: Float[Array, " 6"]  # m, by how much foot targets are out of reach
    own: tuple[Bool[Array, "6 3"], Servo] | None = None  # which joints do otherwise than go to `joints`, and what


class Layer:
    """A layer does nothing in moments of which it does not say otherwise."""

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
        self, plan: Plan, stage: Int[Array, ""], clock: Float[Array, ""], feet: Float[Array, "6 3"]
    ) -> Float[Array, "6 3"]:
        """Feet (m, world axes) `clock` s into a stage, where it has them at `feet`."""
        return feet

    def led(self, now: Now, own: Any, target: Stance) -> tuple[Any, Stance]:
        """Its state and the stance (world axes) that the robot goes to, where the stage wants `target`."""
        return own, target

    def commanded(self, now: Now, own: Any, command: Command) -> tuple[Any, Command]:
        """Its state and what is asked for."""
        return own, command

    def driven(self, now: Now, joints: Float[Array, "6 3"]) -> Float[Array, "6 3"]:
        """What the drives are told (rad) to have the joints at `joints`."""
        return joints

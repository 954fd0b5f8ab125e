"""One experiment's parameters. A rollout has two: the world that is simulated, the belief that is planned with."""

from collections.abc import Mapping
from typing import Any, Protocol, runtime_checkable

from jaxtyping import Array

from sweep.core.parameters import parameters
from sweep.models.contact import Contact
from sweep.models.control import Control
from sweep.models.disturbance import Execution
from sweep.models.drive import Drive
from sweep.models.noise import Noise
from sweep.models.obstacles.surface import Obstacle
from sweep.models.plan_table import PlanTable
from sweep.models.robot import Robot


class Manoeuvre(Protocol):
    """What the robot does: a parameter dataclass with these members.

    One whose feedback goes beyond following its plan is `sweep.controllers.tracker.Guided` besides.
    """

    @property
    def kind(self) -> str:
        """Its name in the configuration."""
        ...

    @property
    def needs(self) -> tuple[type, ...]:
        """The obstacles that it is for, any one of them; `Obstacle`: all that offer charts."""
        ...

    @property
    def goal(self) -> Mapping[str, float]:
        """What it aims at: thresholds of figures, by their names in `outcome`."""
        ...

    def plan(self, belief: "Case") -> Any:
        """The `sweep.controllers.plan.Plan` for what is believed; traced by JAX, not a number where there is none.

        May raise `InputError` where plain numbers admit none.
        """
        ...


@runtime_checkable
class Riding(Protocol):
    """A manoeuvre on free bodies has this member besides."""

    @property
    def observer(self) -> Array | float:
        """Time constant (s) in which their measured poses are taken over."""
        ...


@runtime_checkable
class Driving(Protocol):
    """A manoeuvre that does not leave the free body at rest."""

    def obstacle_speed(self, duration: Array) -> Array:
        """The speed (m/s) that the body is meant to have at the end of a plan of `duration` (s)."""
        ...

    def lateral_offset(self, way: Array) -> Array:
        """How far (m) the body is beside the way that it is meant to go, having gone by `way` (3,) (m)."""
        ...


@parameters
class Case:
    """All parameter groups, a pytree whose leaves are numbers, or arrays over the batch where they are swept."""

    robot: Robot
    drive: Drive
    contact: Contact
    obstacle: Obstacle
    manoeuvre: Manoeuvre
    noise: Noise
    execution: Execution
    control: Control = Control()
    plan: PlanTable = PlanTable()

    def obstacle_as[T: Obstacle](self, kind: type[T]) -> T:
        """The obstacle, which is of the `kind` that the manoeuvre needs."""
        assert isinstance(self.obstacle, kind)
        return self.obstacle

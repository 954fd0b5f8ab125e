"""All parameters of one rollout. A rollout has two cases: the world is simulated, the belief goes to the planner."""

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
from sweep.models.plan_numbers import PlanTable
from sweep.models.robot import Robot


class Manoeuvre(Protocol):
    """A parameter dataclass that describes what the robot does, such as climbing a pole.

    A manoeuvre with feedback of its own, beyond the tracking of its plan, also implements
    `sweep.controllers.tracker.Guided`.
    """

    @property
    def kind(self) -> str:
        """Its name in the configuration."""
        ...

    @property
    def needs(self) -> tuple[type, ...]:
        """Classes of obstacles that the manoeuvre supports; `Obstacle` stands for all with charts."""
        ...

    @property
    def goal(self) -> Mapping[str, float]:
        """Thresholds that the manoeuvre sets for its metrics, by their names in `outcome`."""
        ...

    def plan(self, belief: "Case") -> Any:
        """Make the `sweep.controllers.plan.Plan` for the believed case, traced by JAX.

        Numbers are nan where no plan exists. Raises `InputError` where plain numbers admit no plan.
        """
        ...


@runtime_checkable
class TabulatedManoeuvre(Protocol):
    """A manoeuvre whose plan's numbers are in a file."""

    @property
    def default_plan_name(self) -> str:
        """Name of the file of a case without another one; empty if each case must name a file."""
        ...


@runtime_checkable
class ReversibleManoeuvre(TabulatedManoeuvre, Protocol):
    """A manoeuvre whose whole plan can be executed backwards in time."""

    @property
    def two_way(self) -> bool:
        """Always True."""
        ...


@runtime_checkable
class Riding(Protocol):
    """A manoeuvre on free bodies, which the robot observes."""

    @property
    def observer(self) -> Array | float:
        """Time constant (s) of the filter of the bodies' measured poses."""
        ...


@runtime_checkable
class Driving(Protocol):
    """A manoeuvre that moves a free body along a path and may leave it in motion."""

    def obstacle_speed(self, duration: Array) -> Array:
        """Reference speed (m/s) of the body at the end of a plan of `duration` (s)."""
        ...

    def lateral_offset(self, way: Array) -> Array:
        """Distance (m) of the body from its reference path after a displacement `way` (3,) (m, world axes)."""
        ...


@parameters
class Case:
    """All parameter groups of one rollout, made by the configuration.

    A pytree: leaves are numbers, or arrays over the batch where a study varies them.
    """

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
        """Return the obstacle with the type that the manoeuvre supports."""
        assert isinstance(self.obstacle, kind)
        return self.obstacle

"""All parameters of one rollout: a `Case` for the simulated world and another for the belief of planner and
controller."""

from collections.abc import Mapping
from types import MappingProxyType
from typing import Any, ClassVar

import jax.numpy as jnp
from jaxtyping import Array, Float

from sweep.core.parameters import parameters
from sweep.models.contact import Contact
from sweep.models.control import Control
from sweep.models.disturbance import ExecutionFaults
from sweep.models.drive import Drive
from sweep.models.noise import Noise
from sweep.models.obstacles.surface import Obstacle
from sweep.models.plan_numbers import PlanTable
from sweep.models.robot import Robot


class Manoeuvre:
    """Base class of manoeuvres: parameter dataclasses that describe what the robot does, such as climbing a pole.

    Engines, metrics and commands read these fields; a class states those that differ from the defaults. Fields that
    follow from the methods of a class are set when the class is made.
    """

    kind: str  # its name in the configuration
    # classes of obstacles that it supports; `Obstacle` stands for all with charts
    needs: tuple[type, ...] = ()
    goal: Mapping[str, float] = MappingProxyType({})  # thresholds that it sets for its metrics, by name in `outcome`
    # name of the plan file of a case that names none; empty: each case must name one; None: it has no plan file
    default_plan_name: str | None = None
    two_way: bool = False  # whether its plan can be executed backwards in time
    # time constant (s) of the filter of the free bodies' measured poses; None: it uses no free body
    observer: Array | float | None = None
    plans_forces: ClassVar[bool] = False  # whether it is a `sweep.planning.forces.PlannedForces`
    is_guided: ClassVar[bool] = False  # whether it has feedback of its own: `guide`
    ends_stages: ClassVar[bool] = False  # whether it may end a stage early: `is_stage_over`
    # whether it moves a free body along a path and may leave it in motion: `obstacle_speed`
    drives_body: ClassVar[bool] = False

    def __init_subclass__(cls, **kwargs: Any) -> None:
        """Set the fields that follow from the methods of the class."""
        super().__init_subclass__(**kwargs)
        complete_manoeuvre_class(cls)

    def plan(self, belief: "Case") -> Any:
        """Make the plan of motion from what the robot believes of robot and obstacle; JAX traces this function.

        Numbers are nan where no plan exists. Raises `InputError` where plain numbers admit no plan.
        """
        raise NotImplementedError

    def init_memory(self, belief: "Case", plan: Any) -> Any:
        """Return the state of the manoeuvre's feedback before the first tick."""
        return None

    def guide(self, belief: "Case", ctx: Any, state: Any) -> Any:
        """Return the poses of base and feet to command in one tick, for manoeuvres with feedback."""
        raise NotImplementedError

    def is_stage_over(self, belief: "Case", plan: Any, state: Any, obs: Any) -> Any:
        """Return whether the event that the current stage waits for has occurred; the stage's `duration` is its longest
        time."""
        raise NotImplementedError

    def obstacle_speed(self, duration: Array) -> Array:
        """Return the speed (m/s) that the body driven by the robot should have after a plan of `duration` (s)."""
        raise NotImplementedError

    def lateral_offset(self, way: Float[Array, " 3"]) -> Array:
        """Return how far (m) the driven body is beside its planned path after a displacement `way` (m, world axes)."""
        return jnp.abs(way[1])


DERIVED_FIELDS = {"is_guided": "guide", "ends_stages": "is_stage_over", "drives_body": "obstacle_speed"}  # from methods


def complete_manoeuvre_class(cls: type) -> None:
    """Set the class attributes of a manoeuvre class that follow from its methods.

    A class of a user module that does not inherit from `Manoeuvre` gets its other members as well.
    """
    for name, member in vars(Manoeuvre).items():
        if not name.startswith("_") and not hasattr(cls, name):
            setattr(cls, name, member)
    for name, method in DERIVED_FIELDS.items():
        setattr(cls, name, getattr(cls, method) is not getattr(Manoeuvre, method))


@parameters
class Case:
    """All parameter groups of a rollout (robot, obstacle, manoeuvre, ...), as simulated or as the robot believes.

    A pytree: leaves are numbers, or arrays over the batch where a study varies them.
    """

    robot: Robot
    drive: Drive
    contact: Contact
    obstacle: Obstacle
    manoeuvre: Manoeuvre
    noise: Noise
    execution: ExecutionFaults
    control: Control = Control()
    plan: PlanTable = PlanTable()

    def obstacle_of_type[T: Obstacle](self, kind: type[T]) -> T:
        """Return the rollout's obstacle, checked to be of the type `kind` that the manoeuvre supports."""
        assert isinstance(self.obstacle, kind)
        return self.obstacle

"""One experiment's parameters. A rollout has two: the world that is simulated, the belief that is planned with."""

from typing import Any

from sweep.core.parameters import parameters
from sweep.models.contact import Contact
from sweep.models.disturbance import Execution
from sweep.models.drive import Drive
from sweep.models.noise import Noise
from sweep.models.robot import Robot


@parameters
class Case:
    """All parameter groups, a pytree whose leaves are numbers, or arrays over the batch where they are swept."""

    robot: Robot
    drive: Drive
    contact: Contact
    obstacle: Any
    manoeuvre: Any
    noise: Noise
    execution: Execution

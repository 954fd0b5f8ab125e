"""Parameters of execution faults: weak drives, a dead joint, a push, a wrong start pose."""

from sweep.core.parameters import parameters, quantity
from sweep.models.legs import N_JOINTS


@parameters
class ExecutionFaults:
    """Parameters of faults in the execution of a plan, all off by default."""

    torque_scale: float = quantity(1.0, "-", at_least=0, at_most=1)  # multiplies the drives' torque limit
    dead_joint: float = quantity(-1, "index", at_least=-1, at_most=N_JOINTS - 1)  # of `JOINTS`; -1: none
    push_impulse: float = quantity(0.0, "N*s", at_least=0)  # of a horizontal push on the base
    push_direction: float = quantity(0.0, "rad")  # in the horizontal plane, from the world's x axis
    push_time: float = quantity(1.0, "s", at_least=0)  # when the push begins, from the start of the rollout
    push_duration: float = quantity(0.05, "s", above=0)  # how long it lasts, at an even force
    start_x: float = quantity(0.0, "m")  # how far the robot starts from where the plan begins, along the world's x axis
    start_y: float = quantity(0.0, "m")  # the same along the world's y axis
    start_yaw: float = quantity(0.0, "rad")  # and how far it is turned about the vertical

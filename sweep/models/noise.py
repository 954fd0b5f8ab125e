"""Parameters of sensor errors: noise, bias, offsets and delays."""

from sweep.core.parameters import count, parameters, quantity


@parameters
class Noise:
    """Parameters of sensor errors: noise, bias, offsets and delays, all off by default.

    A bias is drawn once a rollout, noise anew at every control tick; both are normal with the given deviation. An
    offset is a constant error that is given, and added to what is drawn: an axis of a study may search it.
    """

    # deviation of the base's measured position, along each axis, at every tick
    position_noise: float = quantity(0.0, "m", at_least=0)
    position_bias: float = quantity(0.0, "m", at_least=0)  # deviation of its constant error, along each axis
    # deviation of the base's measured orientation, about each axis, at every tick
    orientation_noise: float = quantity(0.0, "rad", at_least=0)
    orientation_bias: float = quantity(0.0, "rad", at_least=0)  # deviation of its constant error, about each axis
    position_offset_x: float = quantity(0.0, "m")  # constant error of the base's measured position along world axis x
    position_offset_y: float = quantity(0.0, "m")  # constant error of the base's measured position along world axis y
    position_offset_z: float = quantity(0.0, "m")  # constant error of the base's measured position along world axis z
    orientation_offset_x: float = quantity(0.0, "rad")  # constant error of its measured orientation about world axis x
    orientation_offset_y: float = quantity(0.0, "rad")  # constant error of its measured orientation about world axis y
    orientation_offset_z: float = quantity(0.0, "rad")  # constant error of its measured orientation about world axis z
    # deviation of the base's measured velocity, along each axis, at every tick
    velocity_noise: float = quantity(0.0, "m/s", at_least=0)
    velocity_bias: float = quantity(0.0, "m/s", at_least=0)  # deviation of its constant error, along each axis
    # deviation of the base's measured angular velocity, about each axis, at every tick
    spin_noise: float = quantity(0.0, "rad/s", at_least=0)
    joint_noise: float = quantity(0.0, "rad", at_least=0)  # deviation of each measured joint angle, at every tick
    joint_rate_noise: float = quantity(0.0, "rad/s", at_least=0)  # deviation of each measured joint rate, at every tick
    joint_bias: float = quantity(0.0, "rad", at_least=0)  # deviation of the constant error of each joint's zero
    # control ticks by which what is measured of the robot comes late
    delay: float = quantity(0.0, "ticks", at_least=0, at_most=50)
    # deviation of the measured load on each foot, at every tick: of a switch's threshold, or told from joint torques
    load_noise: float = quantity(0.0, "N", at_least=0)
    load_bias: float = quantity(0.0, "N", at_least=0)  # deviation of its constant error
    load_delay: float = quantity(0.0, "ticks", at_least=0, at_most=50)  # by which it comes later than the rest
    # of the measured positions of the obstacle's free bodies, at every tick
    body_position_noise: float = quantity(0.0, "m", at_least=0)
    body_position_bias: float = quantity(0.0, "m", at_least=0)  # deviation of their constant error
    # of the measured orientations of free bodies, at every tick
    body_orientation_noise: float = quantity(0.0, "rad", at_least=0)
    body_orientation_bias: float = quantity(0.0, "rad", at_least=0)  # deviation of their constant error
    # of the measured velocities of free bodies, at every tick
    body_velocity_noise: float = quantity(0.0, "m/s", at_least=0)
    body_velocity_bias: float = quantity(0.0, "m/s", at_least=0)  # deviation of their constant error
    # of the measured angular velocities of free bodies, at every tick
    body_turn_noise: float = quantity(0.0, "rad/s", at_least=0)
    body_turn_bias: float = quantity(0.0, "rad/s", at_least=0)  # deviation of their constant error
    # control ticks by which what is measured of free bodies comes late
    body_delay: float = quantity(0.0, "ticks", at_least=0, at_most=50)
    delay_buffer: int = count(0, at_most=100)  # room for the longest delay of a study, set by the runner

"""Errors of measurement."""

from sweep.core.parameters import count, parameters, quantity


@parameters
class Noise:
    """Errors of measurement, all off by default.

    A bias is drawn once a rollout, noise anew at every control tick; both are normal with the given deviation.
    """

    position_noise: float = quantity(0.0, "m", at_least=0)
    position_bias: float = quantity(0.0, "m", at_least=0)
    orientation_noise: float = quantity(0.0, "rad", at_least=0)
    orientation_bias: float = quantity(0.0, "rad", at_least=0)
    velocity_noise: float = quantity(0.0, "m/s", at_least=0)
    velocity_bias: float = quantity(0.0, "m/s", at_least=0)
    joint_noise: float = quantity(0.0, "rad", at_least=0)
    joint_bias: float = quantity(0.0, "rad", at_least=0)
    delay: float = quantity(0.0, "ticks", at_least=0, at_most=50)
    body_position_noise: float = quantity(0.0, "m", at_least=0)  # these of the obstacle's free bodies
    body_position_bias: float = quantity(0.0, "m", at_least=0)
    body_orientation_noise: float = quantity(0.0, "rad", at_least=0)
    body_orientation_bias: float = quantity(0.0, "rad", at_least=0)
    body_velocity_noise: float = quantity(0.0, "m/s", at_least=0)
    body_velocity_bias: float = quantity(0.0, "m/s", at_least=0)
    body_turn_noise: float = quantity(0.0, "rad/s", at_least=0)
    body_turn_bias: float = quantity(0.0, "rad/s", at_least=0)
    body_delay: float = quantity(0.0, "ticks", at_least=0, at_most=50)
    delay_buffer: int = count(0, at_most=50)  # room for the longest delay of a study, set by the runner

"""Estimation by the robot besides following its plan: calibration, touch, replanning."""

from sweep.core.parameters import choice, parameters, quantity


@parameters
class Control:
    """Settings of the controller's calibration, learning by touch and replanning; all off by default.

    It belongs to what is simulated, as sensors do: it is read from the world's side.
    """

    # what the robot measures of itself before it plans, moving its base through a few poses where it stands: its sizes,
    # computed from where its feet are, or simulated
    calibrate: str = choice("none", "none", "sizes", "simulated")
    shift: float = quantity(0.1, "m", above=0, at_most=1)  # by how much calibration moves the base along each axis
    turn: float = quantity(0.175, "rad", above=0, at_most=1)  # by how much it turns the base about each axis
    samples: float = quantity(50.0, "ticks", at_least=1)  # over how many measurements of a pose it takes the mean
    stiffness: float = quantity(1500.0, "N*m/rad", above=0)  # of the drives in simulated poses
    damping: float = quantity(200.0, "N*m*s/rad", at_least=0)  # of these, against the joint's rate
    # deviation of each believed size, relative: what calibration takes for possible before it measures
    size_error: float = quantity(0.012, "-", above=0, at_most=0.2)
    # deviation of each standing foot's place along the ground from pose to pose of the calibration
    slip: float = quantity(0.001, "m", above=0, at_most=0.1)
    # measured load from which on a foot counts as standing, whatever is learned; as noise needs, it is higher
    load_threshold: float = quantity(1.0, "N", above=0, at_most=1000)
    # what the robot learns from where its feet come to stand, of balls from how high they lie: the obstacle's sizes
    touch: str = choice("none", "none", "obstacle")
    # deviation of each believed size of the obstacle, relative: what touching takes for possible before it begins
    obstacle_error: float = quantity(0.03, "-", above=0, at_most=0.2)
    # deviations by which heights of the obstacle are planned for as larger, as long as they are uncertain
    caution: float = quantity(0.1, "-", at_least=0, at_most=3)
    touch_error: float = quantity(0.002, "m", above=0, at_most=0.1)  # deviation of a touched place from the surface
    # how fast a foot's command goes over to the surface that it has felt, or on in search of it
    touch_speed: float = quantity(0.1, "m/s", at_least=0, at_most=1)
    # when the robot plans what is left of its way anew, by what it has learned: never, or every simulated second
    replan: str = choice("never", "never", "touched")

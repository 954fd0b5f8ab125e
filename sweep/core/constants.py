"""Constants that several rooms share."""

GRAVITY = 9.81  # m/s^2
FOOT_LOAD_THRESHOLD_N = 1.0  # N, from which a foot carries load
CONFIDENCE_LEVEL = 0.95  # of every interval, unless a command is given another level

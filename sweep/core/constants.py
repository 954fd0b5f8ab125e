"""Constants that several rooms share."""

GRAVITY = 9.81  # m/s^2
LOADED = 1.0  # N, from which a foot carries load
CONFIDENCE = 0.95  # of every interval, unless a command is given another level

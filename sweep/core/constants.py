"""Constants shared by formulas, models and metrics."""

GRAVITY = 9.81  # m/s^2
LOADED = 1.0  # N, from which a foot carries load

"""What nature sets, for formulas and models alike."""

GRAVITY = 9.81  # m/s^2

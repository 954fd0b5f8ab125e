"""The way up a leaning ladder in numbers: monograph 2.5, tables 2.2 to 2.5."""

from typing import NamedTuple

from sweep.controllers.gaits import GALLOP

FRONT, MIDDLE, REAR = GALLOP
FLOOR, RUNG, LEDGE, ALONG = "floor", "rung", "ledge", "along"


class Move(NamedTuple):
    """A stage: the base goes to a place and pitch, and some feet, or none, to another place. Lengths in `leg_unit`."""

    name: str
    # of the base: along the ladder from its lower end (rungs) and out of its plane, or beyond the ledge's edge and
    # above the ledge; before the first move above the floor and from the ladder's lower end
    base: tuple[float, float]
    pitch: float  # deg, nose up
    over: str = ALONG  # which of the two
    legs: tuple[int, ...] = ()
    where: str = RUNG
    rung: int = 0
    # aside; and out of the ladder's plane (rung depths), from the ladder's lower end, or beyond the ledge's edge
    place: tuple[float, float] = (0.0, 0.0)
    # control points of the swing from where it starts and from where it lands: out to the side; along the ladder and
    # out of its plane to a rung; y and z elsewhere
    first: tuple[float, float, float] = (0.0, 0.0, 0.0)
    last: tuple[float, float, float] = (0.0, 0.0, 0.0)
    time: float = 1.0  # t*


# where the feet stand on the floor at first: aside, and from the ladder's lower end
PLACES = {FRONT: (0.5, 0.137), MIDDLE: (0.6, 0.444), REAR: (0.5, 0.837)}
MOVES = (
    Move("arrive", (0.5, 0.541), 0.0),
    Move("front1", (0.887, 0.663), 8.0, legs=FRONT, rung=1, place=(0.53, 0.197),
         first=(0.034, 0.167, 0.187), last=(0.042, 0.21, 0.191), time=1.5),
    Move("tilt1", (1.126, 0.61), 12.3),
    Move("middle1", (1.237, 0.581), 20.6, legs=MIDDLE, where=FLOOR, place=(0.567, 0.35),
         first=(0.0, 0.0, 0.15), last=(0.0, 0.0, 0.15), time=1.5),
    Move("front3", (1.299, 0.589), 27.2, legs=FRONT, rung=3, place=(0.48, 0.2),
         first=(0.006, 0.128, 0.278), last=(-0.003, 0.267, 0.154), time=1.5),
    Move("middle2", (1.347, 0.518), 25.1, legs=MIDDLE, where=FLOOR, place=(0.587, 0.35),
         first=(-0.026, 0.024, 0.176), last=(-0.025, -0.015, 0.176), time=1.5),
    Move("rear1", (1.374, 0.473), 28.1, legs=REAR, where=FLOOR, place=(0.526, 0.437),
         first=(0.0, 0.001, 0.151), last=(0.002, 0.033, 0.145), time=1.5),
    Move("middle3", (1.493, 0.53), 25.3, legs=MIDDLE, rung=2, place=(0.586, 0.2),
         first=(0.015, 0.23, 0.088), last=(-0.001, 0.25, 0.144), time=1.5),
    Move("front4", (1.97, 0.492), 49.1, legs=FRONT, rung=4, place=(0.534, 0.2),
         first=(0.02, 0.143, 0.234), last=(0.029, 0.249, 0.118), time=1.5),
    Move("middle4", (2.557, 0.122), 75.4, legs=MIDDLE, rung=1, place=(0.66, 0.2),
         first=(0.032, 0.161, 0.299), last=(0.031, 0.247, 0.122), time=1.5),
    Move("rear2", (2.594, 0.124), 74.0, legs=REAR, where=FLOOR, place=(0.35, 0.35),
         first=(0.061, -0.059, 0.106), last=(0.063, -0.07, 0.119), time=1.5),
    Move("middle5", (2.456, 0.195), 77.8, legs=MIDDLE, rung=3, place=(0.626, 0.2),
         first=(0.03, 0.1, 0.25), last=(0.03, 0.25, 0.12), time=1.5),
    Move("up1", (2.468, 0.137), 72.5),
    Move("front5", (2.865, 0.248), 77.3, legs=FRONT, rung=5, place=(0.403, 0.116),
         first=(0.03, 0.1, 0.25), last=(0.03, 0.25, 0.12), time=1.5),
    Move("up2", (2.698, 0.379), 72.5),
    Move("middle6", (2.864, 0.164), 73.4, legs=MIDDLE, rung=2, place=(0.66, 0.2),
         first=(0.011, 0.157, 0.308), last=(0.028, 0.253, 0.116), time=1.5),
    Move("rear3", (2.989, 0.117), 74.1, legs=REAR, rung=1, place=(0.35, 0.2),
         first=(0.186, 0.177, -0.027), last=(-0.016, 0.444, -0.002), time=1.5),
    Move("up3", (3.186, 0.302), 66.9),
    Move("middle7", (3.328, 0.154), 72.7, legs=MIDDLE, rung=4, place=(0.627, 0.2),
         first=(0.01, 0.123, 0.262), last=(0.032, 0.247, 0.12), time=1.5),
    Move("front6", (4.167, 0.167), 77.5, legs=FRONT, where=LEDGE, place=(0.493, 0.037),
         first=(0.05, 0.25, 0.2), last=(0.03, 0.1, 0.35), time=1.5),
    Move("middle8", (4.179, 0.14), 77.4, legs=MIDDLE, rung=3, place=(0.652, 0.2),
         first=(0.009, 0.157, 0.308), last=(0.028, 0.256, 0.117), time=1.5),
    Move("rear4", (4.611, 0.169), 59.9, legs=REAR, rung=2, place=(0.618, 0.046),
         first=(0.03, 0.1, 0.3), last=(0.03, 0.3, 0.14), time=1.5),
    Move("up4", (4.56, 0.202), 67.7),
    Move("middle9", (4.69, 0.134), 74.7, legs=MIDDLE, rung=5, place=(0.621, 0.2),
         first=(0.03, 0.1, 0.25), last=(0.03, 0.25, 0.12), time=1.5),
    Move("middle10", (4.805, 0.18), 74.2, legs=MIDDLE, rung=4, place=(0.564, 0.2),
         first=(0.028, 0.156, 0.3), last=(0.03, 0.245, 0.122), time=1.5),
    Move("rear5", (4.873, 0.143), 73.0, legs=(1,), rung=3, place=(0.418, 0.2),
         first=(0.025, 0.156, 0.206), last=(0.03, 0.253, 0.126), time=1.5),
    Move("rear6", (5.045, 0.259), 70.8, legs=(2,), rung=3, place=(0.405, 0.121),
         first=(0.025, 0.156, 0.206), last=(0.03, 0.254, 0.124), time=1.5),
    Move("up5", (5.654, 0.241), 48.2),
    Move("front7", (5.701, 0.221), 57.7, legs=FRONT, where=LEDGE, place=(0.557, 0.447),
         first=(0.0, 0.0, 0.15), last=(0.0, 0.0, 0.15), time=1.5),
    Move("middle11", (5.697, 0.272), 54.1, legs=MIDDLE, where=LEDGE, place=(0.476, 0.045),
         first=(0.003, 0.329, 0.205), last=(-0.001, 0.189, 0.299), time=1.5),
    Move("up6", (5.706, 0.232), 56.5),
    Move("middle12", (5.687, 0.221), 53.7, legs=MIDDLE, rung=5, place=(0.66, 0.154),
         first=(0.056, 0.143, 0.315), last=(0.03, 0.245, 0.204), time=1.5),
    Move("rear7", (5.825, 0.18), 55.2, legs=(1,), rung=4, place=(0.478, 0.2),
         first=(0.032, 0.115, 0.246), last=(0.03, 0.252, 0.119), time=1.5),
    Move("rear8", (6.061, 0.211), 44.5, legs=(2,), rung=4, place=(0.465, 0.2),
         first=(0.123, 0.24, 0.101), last=(-0.085, 0.4, -0.031), time=1.5),
    Move("up7", (6.576, 0.15), 43.7),
    Move("middle13", (-0.049, 0.165), 53.4, LEDGE, legs=MIDDLE, where=LEDGE, place=(0.66, 0.045),
         first=(0.018, 0.217, 0.236), last=(0.03, 0.127, 0.336), time=1.5),
    Move("over1", (0.015, 0.155), 50.9, LEDGE),
    Move("rear9", (0.018, 0.175), 54.2, LEDGE, legs=(1,), rung=5, place=(0.534, 0.199),
         first=(0.03, 0.1, 0.25), last=(0.03, 0.25, 0.12), time=1.5),
    Move("rear10", (0.032, 0.225), 54.2, LEDGE, legs=(2,), rung=5, place=(0.534, 0.19),
         first=(0.025, 0.136, 0.255), last=(0.03, 0.246, 0.12), time=1.5),
    Move("middle14", (0.039, 0.267), 55.7, LEDGE, legs=MIDDLE, where=LEDGE, place=(0.708, 0.237),
         first=(-0.034, 0.039, 0.12), last=(0.018, 0.05, 0.102), time=1.5),
    Move("front8", (-0.017, 0.252), 49.6, LEDGE, legs=FRONT, where=LEDGE, place=(0.536, 0.663),
         first=(0.033, -0.035, 0.16), last=(-0.003, 0.003, 0.15), time=1.5),
    Move("over2", (0.4, 0.32), 25.5, LEDGE),
    Move("rear11", (0.42, 0.335), 25.5, LEDGE, legs=REAR, where=LEDGE, place=(0.542, 0.045),
         first=(0.108, 0.183, 0.223), last=(0.072, 0.089, 0.344), time=1.5),
    Move("middle15", (0.366, 0.33), 26.4, LEDGE, legs=MIDDLE, where=LEDGE, place=(0.594, 0.55),
         first=(0.025, -0.029, 0.165), last=(0.044, -0.045, 0.183), time=1.5),
    Move("front9", (0.356, 0.335), 28.0, LEDGE, legs=FRONT, where=LEDGE, place=(0.466, 1.0),
         first=(0.002, 0.025, 0.147), last=(-0.026, 0.059, 0.162), time=1.5),
    Move("over3", (0.6, 0.5), 0.0, LEDGE),
)  # fmt: skip

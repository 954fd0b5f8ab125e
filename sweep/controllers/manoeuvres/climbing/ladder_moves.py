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
    Move("front1", (0.887, 0.663), 8.0, legs=FRONT, rung=1, place=(0.53, 0.12),
         first=(0.034, 0.167, 0.187), last=(0.042, 0.21, 0.191), time=1.5),
    Move("tilt1", (1.126, 0.61), 12.3),
    Move("middle1", (1.237, 0.581), 20.6, legs=MIDDLE, where=FLOOR, place=(0.567, 0.35),
         first=(0.0, 0.0, 0.15), last=(0.0, 0.0, 0.15), time=1.5),
    Move("front3", (1.299, 0.589), 27.2, legs=FRONT, rung=3, place=(0.48, 0.122),
         first=(0.008, 0.098, 0.282), last=(-0.003, 0.269, 0.155), time=1.5),
    Move("middle2", (1.385, 0.524), 25.1, legs=MIDDLE, where=FLOOR, place=(0.578, 0.421),
         first=(-0.026, 0.024, 0.176), last=(-0.025, -0.015, 0.176), time=1.5),
    Move("rear1", (1.387, 0.525), 25.2, legs=REAR, where=FLOOR, place=(0.5, 0.523),
         first=(0.0, 0.0, 0.15), last=(0.0, 0.0, 0.15), time=1.5),
    Move("middle3", (1.481, 0.532), 25.0, legs=MIDDLE, rung=2, place=(0.585, 0.152),
         first=(-0.006, 0.213, 0.147), last=(-0.001, 0.25, 0.15), time=1.5),
    Move("front4", (1.935, 0.445), 45.8, legs=FRONT, rung=4, place=(0.532, 0.12),
         first=(0.03, 0.1, 0.25), last=(0.03, 0.25, 0.12), time=1.5),
    Move("middle4", (2.332, 0.137), 73.0, legs=MIDDLE, rung=1, place=(0.6, 0.0),
         first=(0.03, 0.129, 0.283), last=(0.03, 0.251, 0.12), time=1.5),
    Move("rear2", (2.332, 0.137), 73.0, legs=REAR, where=FLOOR, place=(0.434, 0.35),
         first=(0.0, 0.0, 0.15), last=(0.0, 0.0, 0.15), time=1.5),
    Move("middle5", (2.33, 0.135), 72.9, legs=MIDDLE, rung=3, place=(0.625, 0.141),
         first=(0.03, 0.1, 0.25), last=(0.03, 0.25, 0.12), time=1.5),
    Move("up1", (2.517, 0.132), 72.7),
    Move("front5", (2.718, 0.18), 72.9, legs=FRONT, rung=5, place=(0.558, 0.196),
         first=(0.03, 0.1, 0.25), last=(0.03, 0.25, 0.12), time=1.5),
    Move("up2", (2.767, 0.216), 70.5),
    Move("middle6", (2.773, 0.237), 69.8, legs=MIDDLE, rung=2, place=(0.579, 0.083),
         first=(0.03, 0.111, 0.269), last=(0.03, 0.25, 0.12), time=1.5),
    Move("rear3", (2.934, 0.138), 72.9, legs=REAR, rung=1, place=(0.355, 0.2),
         first=(-0.036, 0.236, 0.114), last=(-0.029, 0.284, 0.125), time=1.5),
    Move("up3", (3.586, 0.16), 74.1),
    Move("middle7", (3.558, 0.155), 74.2, legs=MIDDLE, rung=4, place=(0.626, 0.139),
         first=(0.01, 0.123, 0.262), last=(0.032, 0.247, 0.12), time=1.5),
    Move("front6", (4.161, 0.172), 77.1, legs=FRONT, where=LEDGE, place=(0.479, 0.045),
         first=(0.05, 0.25, 0.2), last=(0.03, 0.1, 0.35), time=1.5),
    Move("middle8", (4.162, 0.17), 77.2, legs=MIDDLE, rung=3, place=(0.573, 0.059),
         first=(0.03, 0.109, 0.267), last=(0.03, 0.25, 0.12), time=1.5),
    Move("rear4", (4.445, 0.324), 65.5, legs=REAR, rung=2, place=(0.5, 0.023),
         first=(0.03, 0.1, 0.25), last=(0.03, 0.25, 0.12), time=1.5),
    Move("up4", (4.625, 0.181), 72.5),
    Move("middle9", (4.539, 0.144), 73.5, legs=MIDDLE, rung=5, place=(0.621, 0.153),
         first=(0.03, 0.1, 0.25), last=(0.03, 0.25, 0.12), time=1.5),
    Move("middle10", (4.865, 0.165), 72.8, legs=MIDDLE, rung=4, place=(0.529, 0.196),
         first=(0.03, 0.121, 0.277), last=(0.03, 0.25, 0.12), time=1.5),
    Move("rear5", (4.917, 0.141), 74.7, legs=(1,), rung=3, place=(0.495, 0.197),
         first=(0.03, 0.1, 0.25), last=(0.03, 0.25, 0.12), time=1.5),
    Move("rear6", (4.851, 0.208), 72.2, legs=(2,), rung=3, place=(0.497, 0.199),
         first=(0.03, 0.1, 0.25), last=(0.03, 0.25, 0.12), time=1.5),
    Move("up5", (5.63, 0.173), 46.9),
    Move("front7", (5.638, 0.174), 54.2, legs=FRONT, where=LEDGE, place=(0.569, 0.298),
         first=(0.0, 0.0, 0.15), last=(0.0, 0.0, 0.15), time=1.5),
    Move("middle11", (5.622, 0.262), 55.7, legs=MIDDLE, where=LEDGE, place=(0.509, 0.045),
         first=(0.002, 0.3, 0.152), last=(-0.001, 0.187, 0.285), time=1.5),
    Move("up6", (5.707, 0.262), 55.8),
    Move("middle12", (5.677, 0.252), 54.2, legs=MIDDLE, rung=5, place=(0.575, 0.089),
         first=(0.054, 0.112, 0.327), last=(0.029, 0.249, 0.204), time=1.5),
    Move("rear7", (5.7, 0.255), 55.5, legs=(1,), rung=4, place=(0.551, 0.199),
         first=(0.03, 0.1, 0.25), last=(0.03, 0.25, 0.12), time=1.5),
    Move("rear8", (5.796, 0.3), 53.3, legs=(2,), rung=4, place=(0.552, 0.198),
         first=(0.03, 0.1, 0.25), last=(0.03, 0.25, 0.12), time=1.5),
    Move("up7", (6.582, 0.215), 50.2),
    Move("middle13", (-0.092, 0.115), 57.3, LEDGE, legs=MIDDLE, where=LEDGE, place=(0.608, 0.051),
         first=(0.05, 0.266, 0.184), last=(0.03, 0.125, 0.325), time=1.5),
    Move("over1", (0.051, 0.169), 52.3, LEDGE),
    Move("rear9", (0.062, 0.185), 56.6, LEDGE, legs=(1,), rung=5, place=(0.535, 0.101),
         first=(0.03, 0.1, 0.25), last=(0.03, 0.25, 0.12), time=1.5),
    Move("rear10", (0.064, 0.233), 56.6, LEDGE, legs=(2,), rung=5, place=(0.535, 0.108),
         first=(0.03, 0.1, 0.25), last=(0.03, 0.25, 0.12), time=1.5),
    Move("middle14", (0.066, 0.24), 57.8, LEDGE, legs=MIDDLE, where=LEDGE, place=(0.671, 0.252),
         first=(-0.031, 0.065, 0.089), last=(-0.006, 0.088, 0.063), time=1.5),
    Move("front8", (0.01, 0.225), 51.6, LEDGE, legs=FRONT, where=LEDGE, place=(0.536, 0.663),
         first=(0.033, -0.035, 0.16), last=(-0.003, 0.003, 0.15), time=1.5),
    Move("over2", (0.447, 0.326), 24.9, LEDGE),
    Move("rear11", (0.449, 0.365), 22.6, LEDGE, legs=REAR, where=LEDGE, place=(0.54, 0.045),
         first=(0.149, 0.225, 0.175), last=(0.067, 0.083, 0.339), time=1.5),
    Move("middle15", (0.366, 0.33), 26.4, LEDGE, legs=MIDDLE, where=LEDGE, place=(0.594, 0.463),
         first=(0.025, -0.029, 0.165), last=(0.044, -0.045, 0.183), time=1.5),
    Move("front9", (0.356, 0.335), 28.0, LEDGE, legs=FRONT, where=LEDGE, place=(0.466, 0.809),
         first=(0.002, 0.025, 0.147), last=(-0.026, 0.059, 0.162), time=1.5),
    Move("over3", (0.464, 0.584), 0.0, LEDGE),
)  # fmt: skip

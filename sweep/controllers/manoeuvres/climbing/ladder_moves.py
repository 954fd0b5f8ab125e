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
    pitch: float  # nose up, of the ladder's lean
    over: str = ALONG  # which of the two
    follow: float = 0.0  # share of the way that the base goes with a ledge that is higher over the rungs
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
    Move("front1", (0.8371, 0.7126), 0.1067, legs=FRONT, rung=1, place=(0.53, 0.197),
         first=(0.034, 0.167, 0.187), last=(0.042, 0.21, 0.191), time=1.5),
    Move("tilt1", (1.126, 0.61), 0.164),
    Move("middle1", (1.1995, 0.6187), 0.2747, legs=MIDDLE, where=FLOOR, place=(0.567, 0.35),
         first=(0.0, 0.0, 0.15), last=(0.0, 0.0, 0.15), time=1.5),
    Move("front3", (1.2508, 0.6372), 0.3627, legs=FRONT, rung=3, place=(0.48, 0.2),
         first=(0.006, 0.128, 0.278), last=(-0.003, 0.267, 0.154), time=1.5),
    Move("middle2", (1.347, 0.518), 0.3347, legs=MIDDLE, where=FLOOR, place=(0.587, 0.35),
         first=(-0.026, 0.024, 0.176), last=(-0.025, -0.015, 0.176), time=1.5),
    Move("rear1", (1.374, 0.473), 0.3747, legs=REAR, where=FLOOR, place=(0.526, 0.437),
         first=(0.0, 0.001, 0.151), last=(0.002, 0.033, 0.145), time=1.5),
    Move("middle3", (1.493, 0.53), 0.3373, legs=MIDDLE, rung=2, place=(0.586, 0.2),
         first=(0.015, 0.23, 0.088), last=(-0.001, 0.25, 0.144), time=1.5),
    Move("front4", (1.97, 0.492), 0.6547, legs=FRONT, rung=4, place=(0.534, 0.2),
         first=(0.02, 0.143, 0.234), last=(0.029, 0.249, 0.118), time=1.5),
    Move("middle4", (2.557, 0.122), 1.0053, legs=MIDDLE, rung=1, place=(0.66, 0.2),
         first=(0.032, 0.161, 0.299), last=(0.031, 0.247, 0.122), time=1.5),
    Move("rear2", (2.594, 0.124), 0.9867, legs=(1,), where=FLOOR, place=(0.35, 0.35),
         first=(0.061, -0.059, 0.106), last=(0.063, -0.07, 0.119), time=1.5),
    Move("rear3", (2.594, 0.124), 0.9867, legs=(2,), where=FLOOR, place=(0.35, 0.35),
         first=(0.061, -0.059, 0.106), last=(0.063, -0.07, 0.119), time=1.5),
    Move("middle5", (2.456, 0.195), 1.0373, legs=MIDDLE, rung=3, place=(0.626, 0.2),
         first=(0.03, 0.1, 0.25), last=(0.03, 0.25, 0.12), time=1.5),
    Move("up1", (2.4175, 0.1878), 0.9667),
    Move("front5", (2.865, 0.248), 1.0307, legs=FRONT, rung=5, place=(0.403, 0.116),
         first=(0.03, 0.1, 0.25), last=(0.03, 0.25, 0.12), time=1.5),
    Move("up2", (2.698, 0.379), 0.9667),
    Move("middle6", (2.7182, 0.1701), 0.9787, legs=MIDDLE, rung=2, place=(0.66, 0.2),
         first=(0.011, 0.157, 0.308), last=(0.028, 0.253, 0.116), time=1.5),
    Move("rear4", (2.8579, 0.1076), 0.9787, legs=(1,), rung=1, place=(0.35, 0.2),
         first=(0.2759, 0.0915, 0.0255), last=(0.0783, 0.3418, 0.0749), time=1.5),
    Move("rear5", (3.2974, 0.1028), 0.9833, follow=0.06, legs=(2,), rung=1, place=(0.35, 0.2),
         first=(0.211, 0.4567, -0.2844), last=(0.0154, 0.6957, -0.2128), time=1.5),
    Move("up3", (3.516, 0.1416), 0.892, follow=0.15),
    Move("middle7", (3.4943, 0.1275), 0.9693, follow=0.14, legs=MIDDLE, rung=4, place=(0.627, 0.2),
         first=(0.01, 0.123, 0.262), last=(0.032, 0.247, 0.12), time=1.5),
    Move("front6", (4.1711, 0.1692), 1.0333, follow=0.34, legs=FRONT, where=LEDGE, place=(0.493, 0.037),
         first=(0.05, 0.25, 0.2), last=(0.03, 0.1, 0.35), time=1.5),
    Move("middle8", (4.1924, 0.1162), 1.032, follow=0.34, legs=MIDDLE, rung=3, place=(0.652, 0.2),
         first=(0.009, 0.157, 0.308), last=(0.028, 0.256, 0.117), time=1.5),
    Move("rear6", (4.1938, 0.1171), 1.032, follow=0.34, legs=(1,), rung=2, place=(0.618, 0.046),
         first=(0.03, 0.1, 0.3), last=(0.03, 0.3, 0.14), time=1.5),
    Move("rear7", (4.497, 0.1048), 1.032, follow=0.43, legs=(2,), rung=2, place=(0.618, 0.046),
         first=(0.03, 0.1, 0.3), last=(0.03, 0.3, 0.14), time=1.5),
    Move("up4", (4.6264, 0.1403), 0.9267, follow=0.47),
    Move("middle9", (4.9012, 0.1085), 0.9988, follow=0.55, legs=MIDDLE, rung=5, place=(0.6871, 0.1743),
         first=(0.03, 0.1, 0.25), last=(0.03, 0.25, 0.12), time=1.5),
    Move("middle10", (4.9212, 0.1029), 0.9867, follow=0.55, legs=MIDDLE, rung=4, place=(0.564, 0.2),
         first=(0.028, 0.156, 0.3), last=(0.03, 0.245, 0.122), time=1.5),
    Move("rear8", (4.933, 0.0959), 0.9993, follow=0.56, legs=(1,), rung=3, place=(0.418, 0.2),
         first=(0.025, 0.156, 0.206), last=(0.03, 0.253, 0.126), time=1.5),
    Move("rear9", (5.1882, 0.1603), 0.8674, follow=0.63, legs=(2,), rung=3, place=(0.4288, 0.2168),
         first=(0.025, 0.156, 0.206), last=(0.03, 0.254, 0.124), time=1.5),
    Move("up5", (5.5682, 0.2511), 0.622, follow=0.74),
    Move("front7", (5.411, 0.2313), 0.8377, follow=0.69, legs=FRONT, where=LEDGE, place=(0.557, 0.447),
         first=(0.0, 0.0, 0.15), last=(0.0, 0.0, 0.15), time=1.5),
    Move("middle11", (5.7795, 0.1747), 0.6826, follow=0.8, legs=MIDDLE, where=LEDGE, place=(0.476, 0.045),
         first=(0.003, 0.329, 0.205), last=(-0.001, 0.189, 0.299), time=1.5),
    Move("up6", (5.824, 0.1588), 0.7082, follow=0.81),
    Move("middle12", (5.8703, 0.1435), 0.7217, follow=0.83, legs=MIDDLE, rung=5, place=(0.66, 0.154),
         first=(0.056, 0.143, 0.315), last=(0.03, 0.245, 0.204), time=1.5),
    Move("rear10", (5.95, 0.1107), 0.7526, follow=0.5, legs=(1,), rung=4, place=(0.478, 0.2),
         first=(0.032, 0.115, 0.246), last=(0.03, 0.252, 0.119), time=1.5),
    Move("rear11", (6.2474, 0.1196), 0.5257, follow=0.75, legs=(2,), rung=4, place=(0.465, 0.2),
         first=(0.123, 0.24, 0.101), last=(-0.085, 0.4, -0.031), time=1.5),
    Move("up7", (6.5558, 0.044), 0.497, follow=0.7),
    Move("middle13", (-0.0364, 0.1673), 0.7247, LEDGE, follow=0.5, legs=MIDDLE, where=LEDGE, place=(0.66, 0.045),
         first=(0.018, 0.217, 0.236), last=(0.03, 0.127, 0.336), time=1.5),
    Move("over1", (0.0654, 0.1629), 0.66, LEDGE, follow=0.4),
    Move("rear12", (0.0921, 0.1974), 0.6594, LEDGE, follow=0.4, legs=(1,), rung=5, place=(0.534, 0.199),
         first=(0.03, 0.1, 0.25), last=(0.03, 0.25, 0.12), time=1.5),
    Move("rear13", (0.1214, 0.3198), 0.6328, LEDGE, follow=0.5, legs=(2,), rung=5, place=(0.534, 0.19),
         first=(0.025, 0.136, 0.255), last=(0.03, 0.246, 0.12), time=1.5),
    Move("middle14", (0.0874, 0.3144), 0.6992, LEDGE, follow=0.7, legs=MIDDLE, where=LEDGE, place=(0.708, 0.237),
         first=(-0.034, 0.039, 0.12), last=(0.018, 0.05, 0.102), time=1.5),
    Move("front8", (0.1493, 0.3838), 0.5015, LEDGE, follow=0.6, legs=FRONT, where=LEDGE, place=(0.536, 0.663),
         first=(0.033, -0.035, 0.16), last=(-0.003, 0.003, 0.15), time=1.5),
    Move("over2", (0.4, 0.32), 0.34, LEDGE, follow=0.7),
    Move("rear14", (0.42, 0.335), 0.34, LEDGE, follow=0.7, legs=REAR, where=LEDGE, place=(0.542, 0.045),
         first=(0.108, 0.183, 0.223), last=(0.072, 0.089, 0.344), time=1.5),
    Move("middle15", (0.366, 0.33), 0.352, LEDGE, follow=1.0, legs=MIDDLE, where=LEDGE, place=(0.594, 0.55),
         first=(0.025, -0.029, 0.165), last=(0.044, -0.045, 0.183), time=1.5),
    Move("front9", (0.3968, 0.2943), 0.3324, LEDGE, follow=1.0, legs=FRONT, where=LEDGE, place=(0.466, 1.0),
         first=(0.002, 0.025, 0.147), last=(-0.026, 0.059, 0.162), time=1.5),
    Move("over3", (0.6, 0.5), 0.0, LEDGE, follow=1.0),
)  # fmt: skip

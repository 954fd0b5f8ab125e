"""The way up a leaning ladder in numbers: monograph 2.5, tables 2.2 to 2.5."""

from typing import NamedTuple

from sweep.controllers.gaits import GALLOP

FRONT, MIDDLE, REAR = GALLOP
FLOOR, RUNG, LEDGE, ALONG = "floor", "rung", "ledge", "along"


class Move(NamedTuple):
    """A stage: the base goes to a place and pitch, and some feet, or none, to another place. Lengths in `leg_unit`."""

    name: str
    # of the base: along the ladder from its lower end (`LadderSite.along`) and out of its plane, or beyond the ledge's
    # edge and above the ledge; before the first move above the floor and from the ladder's lower end
    base: tuple[float, float]
    pitch: float  # nose up, of the ladder's lean
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
    Move("front1", (0.8371, 0.7126), 0.1067, legs=FRONT, rung=1, place=(0.53, 0.197),
         first=(0.024, 0.155, 0.2025), last=(0.032, 0.198, 0.2065), time=1.5),
    Move("tilt1", (1.126, 0.61), 0.164),
    Move("middle1", (1.1995, 0.6187), 0.2747, legs=MIDDLE, where=FLOOR, place=(0.567, 0.35),
         first=(0.0, 0.0, 0.15), last=(0.0, 0.0, 0.15), time=1.5),
    Move("front3", (1.2508, 0.6372), 0.3627, legs=FRONT, rung=3, place=(0.48, 0.2),
         first=(0.0388, 0.1049, 0.3118), last=(0.0298, 0.2439, 0.1878), time=1.5),
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
    Move("rear2a", (2.594, 0.124), 0.9867, legs=(1,), where=FLOOR, place=(0.35, 0.35),
         first=(0.061, -0.059, 0.106), last=(0.063, -0.07, 0.119), time=1.5),
    Move("rear2b", (2.594, 0.124), 0.9867, legs=(2,), where=FLOOR, place=(0.35, 0.35),
         first=(0.061, -0.059, 0.106), last=(0.063, -0.07, 0.119), time=1.5),
    Move("middle5", (2.456, 0.195), 1.0373, legs=MIDDLE, rung=3, place=(0.626, 0.2),
         first=(0.03, 0.1, 0.25), last=(0.03, 0.25, 0.12), time=1.5),
    Move("up1", (2.4175, 0.1878), 0.9667),
    Move("front5", (2.865, 0.248), 1.0307, legs=FRONT, rung=5, place=(0.403, 0.116),
         first=(0.03, 0.1, 0.25), last=(0.03, 0.25, 0.12), time=1.5),
    Move("up2", (2.698, 0.379), 0.9667),
    Move("middle6", (2.864, 0.164), 0.9787, legs=MIDDLE, rung=2, place=(0.66, 0.2),
         first=(0.011, 0.157, 0.308), last=(0.028, 0.253, 0.116), time=1.5),
    Move("rear3a", (2.864, 0.164), 0.9787, legs=(1,), rung=1, place=(0.35, 0.2),
         first=(0.186, 0.177, -0.027), last=(-0.016, 0.444, -0.002), time=1.5),
    Move("rear3b", (2.9265, 0.1405), 0.9833, legs=(2,), rung=1, place=(0.35, 0.2),
         first=(0.186, 0.177, -0.027), last=(-0.016, 0.444, -0.002), time=1.5),
    Move("up3", (3.3509, 0.1424), 0.892),
    Move("middle7", (3.4622, 0.1076), 0.9693, legs=MIDDLE, rung=4, place=(0.627, 0.2),
         first=(-0.1875, 0.2583, 0.12), last=(-0.1655, 0.3823, -0.022), time=1.5),
    Move("front6", (4.173, 0.1624), 1.0333, legs=FRONT, where=LEDGE, place=(0.493, 0.037),
         first=(0.05, 0.25, 0.2), last=(0.03, 0.1, 0.35), time=1.5),
    Move("middle8", (4.179, 0.14), 1.032, legs=MIDDLE, rung=3, place=(0.652, 0.2),
         first=(0.1146, 0.3284, 0.1669), last=(0.1316, 0.4274, -0.0241), time=1.5),
    Move("rear4a", (4.179, 0.14), 1.032, legs=(1,), rung=2, place=(0.618, 0.046),
         first=(0.2004, -0.0191, 0.2035), last=(0.2628, 0.0789, 0.0354), time=1.5),
    Move("rear4b", (4.209, 0.14), 1.032, legs=(2,), rung=2, place=(0.618, 0.046),
         first=(0.03, 0.1, 0.3), last=(0.03, 0.3, 0.14), time=1.5),
    Move("up4", (4.5761, 0.1313), 0.9267),
    Move("middle9", (4.7826, 0.1195), 0.9988, legs=MIDDLE, rung=5, place=(0.6942, 0.157),
         first=(0.1949, 0.2629, 0.1554), last=(0.1097, 0.4129, 0.0636), time=1.5),
    Move("middle10", (4.922, 0.1027), 0.9867, legs=MIDDLE, rung=4, place=(0.564, 0.2),
         first=(0.0978, 0.2251, 0.2307), last=(0.0998, 0.3141, 0.0527), time=1.5),
    Move("rear5", (4.9317, 0.0959), 0.9993, legs=(1,), rung=3, place=(0.418, 0.2),
         first=(-0.1126, 0.2805, 0.0419), last=(-0.1036, 0.3728, -0.0053), time=1.5),
    Move("rear6", (5.1997, 0.1613), 0.8674, legs=(2,), rung=3, place=(0.4288, 0.2168),
         first=(-0.1697, 0.2908, 0.0163), last=(-0.1647, 0.3888, -0.0657), time=1.5),
    Move("up5", (5.5883, 0.2464), 0.622),
    Move("front7", (5.6086, 0.263), 0.8377, legs=FRONT, where=LEDGE, place=(0.557, 0.447),
         first=(0.0773, 0.0815, 0.2505), last=(0.0773, 0.0815, 0.2505), time=1.5),
    Move("middle11", (5.7862, 0.1737), 0.6826, legs=MIDDLE, where=LEDGE, place=(0.476, 0.045),
         first=(0.0521, 0.1538, 0.2668), last=(0.0482, 0.1428, 0.2467), time=1.5),
    Move("up6", (5.8329, 0.1586), 0.7082),
    Move("middle12", (5.8703, 0.1435), 0.7217, legs=MIDDLE, rung=5, place=(0.66, 0.154),
         first=(-0.2003, 0.1717, 0.0912), last=(-0.2263, 0.2737, -0.0198), time=1.5),
    Move("rear7", (5.9935, 0.1107), 0.7526, legs=(1,), rung=4, place=(0.478, 0.2),
         first=(-0.1413, 0.3363, 0.0482), last=(-0.1513, 0.4635, -0.0765), time=1.5),
    Move("rear8", (6.2474, 0.1196), 0.5257, legs=(2,), rung=4, place=(0.465, 0.2),
         first=(0.029, 0.4041, -0.0643), last=(-0.1599, 0.5038, -0.1604), time=1.5),
    Move("up7", (6.5837, 0.036), 0.497),
    Move("middle13", (-0.0296, 0.1885), 0.7247, LEDGE, legs=MIDDLE, where=LEDGE, place=(0.66, 0.045),
         first=(0.1927, 0.1136, 0.188), last=(0.2376, 0.0253, 0.2692), time=1.5),
    Move("over1", (0.0654, 0.1629), 0.66, LEDGE),
    Move("rear9", (0.0921, 0.1974), 0.6594, LEDGE, legs=(1,), rung=5, place=(0.534, 0.199),
         first=(0.206, 0.3145, 0.0467), last=(0.206, 0.4645, -0.0833), time=1.5),
    Move("rear10", (0.1214, 0.3198), 0.6328, LEDGE, legs=(2,), rung=5, place=(0.534, 0.19),
         first=(-0.0661, 0.2284, 0.1642), last=(-0.0611, 0.3384, 0.0292), time=1.5),
    Move("middle14", (0.0874, 0.3144), 0.6992, LEDGE, legs=MIDDLE, where=LEDGE, place=(0.708, 0.237),
         first=(0.0019, -0.0123, 0.1317), last=(0.0539, -0.0013, 0.1137), time=1.5),
    Move("front8", (0.1097, 0.3875), 0.5278, LEDGE, legs=FRONT, where=LEDGE, place=(0.536, 0.663),
         first=(0.033, -0.035, 0.16), last=(-0.003, 0.003, 0.15), time=1.5),
    Move("over2", (0.4, 0.32), 0.34, LEDGE),
    Move("rear11", (0.42, 0.335), 0.34, LEDGE, legs=REAR, where=LEDGE, place=(0.542, 0.045),
         first=(0.108, 0.183, 0.223), last=(0.072, 0.089, 0.344), time=1.5),
    Move("middle15", (0.366, 0.33), 0.352, LEDGE, legs=MIDDLE, where=LEDGE, place=(0.594, 0.55),
         first=(0.025, -0.029, 0.165), last=(0.044, -0.045, 0.183), time=1.5),
    Move("front9", (0.3968, 0.2943), 0.3324, LEDGE, legs=FRONT, where=LEDGE, place=(0.466, 1.0),
         first=(0.002, 0.025, 0.147), last=(-0.026, 0.059, 0.162), time=1.5),
    Move("over3", (0.6, 0.5), 0.0, LEDGE),
)  # fmt: skip

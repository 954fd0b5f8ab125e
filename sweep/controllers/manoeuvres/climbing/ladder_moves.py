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
    Move("middle6", (2.8106, 0.1737), 0.9787, legs=MIDDLE, rung=2, place=(0.66, 0.2),
         first=(0.011, 0.157, 0.308), last=(0.028, 0.253, 0.116), time=1.5),
    Move("rear3a", (2.8547, 0.1077), 0.9787, legs=(1,), rung=1, place=(0.35, 0.2),
         first=(0.2495, 0.1221, -0.0067), last=(0.0422, 0.3819, 0.0356), time=1.5),
    Move("rear3b", (3.2246, 0.1027), 0.9833, legs=(2,), rung=1, place=(0.35, 0.2),
         first=(0.1632, 0.4539, -0.2792), last=(-0.0388, 0.7209, -0.2542), time=1.5),
    Move("up3", (3.516, 0.1416), 0.892),
    Move("middle7", (3.4943, 0.1275), 0.9693, legs=MIDDLE, rung=4, place=(0.627, 0.2),
         first=(-0.2576, 0.3134, 0.0336), last=(-0.2296, 0.4322, -0.1076), time=1.5),
    Move("front6", (4.1711, 0.1692), 1.0333, legs=FRONT, where=LEDGE, place=(0.493, 0.037),
         first=(0.05, 0.25, 0.2), last=(0.03, 0.1, 0.35), time=1.5),
    Move("middle8", (4.1924, 0.1162), 1.032, legs=MIDDLE, rung=3, place=(0.652, 0.2),
         first=(0.148, 0.395, 0.1727), last=(0.1339, 0.4889, -0.0183), time=1.5),
    Move("rear4a", (4.1938, 0.1171), 1.032, legs=(1,), rung=2, place=(0.618, 0.046),
         first=(0.3307, 0.0708, 0.083), last=(0.2586, 0.1626, 0.0767), time=1.5),
    Move("rear4b", (4.497, 0.1048), 1.032, legs=(2,), rung=2, place=(0.618, 0.046),
         first=(-0.3199, 0.0634, -0.0103), last=(-0.3176, 0.2523, -0.1883), time=1.5),
    Move("up4", (4.6264, 0.1403), 0.9267),
    Move("middle9", (4.9012, 0.1085), 0.9988, legs=MIDDLE, rung=5, place=(0.6871, 0.1743),
         first=(0.2517, 0.5016, 0.1578), last=(0.1059, 0.6516, 0.0783), time=1.5),
    Move("middle10", (4.9212, 0.1029), 0.9867, legs=MIDDLE, rung=4, place=(0.564, 0.2),
         first=(0.0978, 0.2251, 0.2307), last=(0.0998, 0.3141, 0.0527), time=1.5),
    Move("rear5", (4.933, 0.0959), 0.9993, legs=(1,), rung=3, place=(0.418, 0.2),
         first=(-0.123, 0.3895, -0.1392), last=(-0.0568, 0.3996, -0.0846), time=1.5),
    Move("rear6", (5.1882, 0.1603), 0.8674, legs=(2,), rung=3, place=(0.4288, 0.2168),
         first=(-0.2103, 0.4651, -0.0872), last=(-0.1691, 0.5423, -0.1288), time=1.5),
    Move("up5", (5.5682, 0.2511), 0.622),
    Move("front7", (5.411, 0.2313), 0.8377, legs=FRONT, where=LEDGE, place=(0.557, 0.447),
         first=(0.0946, 0.1008, 0.2633), last=(0.0946, 0.1008, 0.2633), time=1.5),
    Move("middle11", (5.7795, 0.1747), 0.6826, legs=MIDDLE, where=LEDGE, place=(0.476, 0.045),
         first=(-0.1841, -0.0136, 0.4348), last=(-0.2026, 0.0316, 0.2627), time=1.5),
    Move("up6", (5.824, 0.1588), 0.7082),
    Move("middle12", (5.8703, 0.1435), 0.7217, legs=MIDDLE, rung=5, place=(0.66, 0.154),
         first=(-0.243, 0.1835, 0.0683), last=(-0.269, 0.2449, -0.0571), time=1.5),
    Move("rear7", (5.9935, 0.1107), 0.7526, legs=(1,), rung=4, place=(0.478, 0.2),
         first=(-0.1768, 0.4941, -0.2189), last=(-0.0815, 0.453, -0.1839), time=1.5),
    Move("rear8", (6.2474, 0.1196), 0.5257, legs=(2,), rung=4, place=(0.465, 0.2),
         first=(0.029, 0.4041, -0.0643), last=(-0.1599, 0.5038, -0.1604), time=1.5),
    Move("up7", (6.5558, 0.044), 0.497),
    Move("middle13", (-0.0364, 0.1673), 0.7247, LEDGE, legs=MIDDLE, where=LEDGE, place=(0.66, 0.045),
         first=(0.2639, 0.0738, 0.2413), last=(0.5497, -0.0784, 0.282), time=1.5),
    Move("over1", (0.0654, 0.1629), 0.66, LEDGE),
    Move("rear9", (0.0921, 0.1974), 0.6594, LEDGE, legs=(1,), rung=5, place=(0.534, 0.199),
         first=(0.1676, 0.3594, -0.1156), last=(0.1187, 0.5178, -0.2184), time=1.5),
    Move("rear10", (0.1214, 0.3198), 0.6328, LEDGE, legs=(2,), rung=5, place=(0.534, 0.19),
         first=(-0.0661, 0.2284, 0.1642), last=(-0.0611, 0.3384, 0.0292), time=1.5),
    Move("middle14", (0.0874, 0.3144), 0.6992, LEDGE, legs=MIDDLE, where=LEDGE, place=(0.708, 0.237),
         first=(0.0019, -0.0123, 0.1317), last=(0.0539, -0.0013, 0.1137), time=1.5),
    Move("front8", (0.1493, 0.3838), 0.5015, LEDGE, legs=FRONT, where=LEDGE, place=(0.536, 0.663),
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

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
    # how the base goes with a ledge that is higher over the rungs, by shares of what it is higher by: along the ladder,
    # over the ledge along its own axis; out of the ladder's plane, over the ledge out of its own; and nose up, of the
    # ladder's lean for every `leg_unit`
    follow: tuple[float, float, float] = (0.0, 0.0, 0.0)
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
    Move("arrive", (0.5, 0.55), 0.0),
    Move("front1", (0.8371, 0.73), 0.1067, legs=FRONT, rung=1, place=(0.53, 0.197),
         first=(0.034, 0.167, 0.187), last=(0.042, 0.21, 0.191), time=1.5),
    Move("tilt1", (1.126, 0.61), 0.164),
    Move("middle1", (1.1995, 0.636), 0.2747, legs=MIDDLE, where=FLOOR, place=(0.567, 0.35),
         first=(0.0, 0.0, 0.15), last=(0.0, 0.0, 0.15), time=1.5),
    Move("front3", (1.2508, 0.662), 0.3627, legs=FRONT, rung=3, place=(0.48, 0.2),
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
    Move("up1", (2.4175, 0.1878), 0.9667, time=1.5),
    Move("front5", (2.862, 0.2523), 1.0219, legs=FRONT, rung=5, place=(0.403, 0.116),
         first=(0.03, 0.1, 0.25), last=(0.03, 0.25, 0.12), time=1.5),
    Move("up2", (2.698, 0.379), 0.9667, time=1.5),
    Move("middle6", (2.7169, 0.1706), 0.9781, legs=MIDDLE, rung=2, place=(0.66, 0.2),
         first=(0.011, 0.157, 0.308), last=(0.028, 0.253, 0.116), time=2.0),
    Move("rear4", (2.8546, 0.1443), 0.9163, legs=(1,), rung=1, place=(0.35, 0.2),
         first=(0.2759, 0.0915, 0.0255), last=(0.0783, 0.3418, 0.0749), time=2.0),
    Move("rear5", (3.3017, 0.1063), 0.9766, follow=(0.0917, 0.011, -0.014), legs=(2,), rung=1, place=(0.35, 0.2),
         first=(0.211, 0.4567, -0.2844), last=(0.0154, 0.6957, -0.2128), time=2.0),
    Move("up3", (3.5088, 0.1449), 0.8977, follow=(0.081, 0.0603, 0.0775), time=1.5),
    Move("middle7", (3.5027, 0.1239), 0.965, follow=(0.1394, -0.0043, -0.0064), legs=MIDDLE, rung=4, place=(0.627, 0.2),
         first=(0.01, 0.123, 0.262), last=(0.032, 0.247, 0.12), time=1.5),
    Move("front6", (4.1051, 0.1575), 1.0635, follow=(0.4082, -0.0399, 0.3306),
         legs=FRONT, where=LEDGE, place=(0.493, 0.037),
         first=(0.05, 0.25, 0.2), last=(0.03, 0.1, 0.35), time=2.0),
    Move("middle8", (4.1179, 0.1129), 1.0329, follow=(0.1318, 0.0201, 0.0265), legs=MIDDLE, rung=3, place=(0.652, 0.2),
         first=(0.009, 0.157, 0.308), last=(0.028, 0.256, 0.117), time=1.5),
    Move("rear6", (4.1302, 0.1156), 1.0178, follow=(0.0969, -0.0908, 0.0872), legs=(1,), rung=2, place=(0.618, 0.046),
         first=(0.03, 0.1, 0.3), last=(0.03, 0.3, 0.14), time=1.5),
    Move("rear7", (4.5842, 0.119), 1.0244, follow=(0.5149, 0.0343, 0.0089), legs=(2,), rung=2, place=(0.618, 0.046),
         first=(0.03, 0.1, 0.3), last=(0.03, 0.3, 0.14), time=2.0),
    Move("up4", (4.6078, 0.1391), 0.9297, follow=(0.3804, -0.036, 0.0276), time=1.5),
    Move("middle9", (4.8881, 0.1021), 1.0019, follow=(0.4719, -0.0864, 0.0424),
         legs=MIDDLE, rung=5, place=(0.6871, 0.1743),
         first=(0.03, 0.1, 0.25), last=(0.03, 0.25, 0.12), time=2.0),
    Move("middle10", (4.8987, 0.0977), 0.9944, follow=(0.4085, -0.0455, 0.0655),
         legs=MIDDLE, rung=4, place=(0.564, 0.2),
         first=(0.028, 0.156, 0.3), last=(0.03, 0.245, 0.122), time=1.5),
    Move("rear8", (4.7463, 0.0943), 1.0061, follow=(-0.091, -0.0002, -0.0128), legs=(1,), rung=3, place=(0.418, 0.2),
         first=(0.025, 0.156, 0.206), last=(0.03, 0.253, 0.126), time=2.0),
    Move("rear9", (5.1577, 0.1763), 0.8686, follow=(0.683, 0.0395, 0.0639), legs=(2,), rung=3, place=(0.4288, 0.2168),
         first=(0.025, 0.156, 0.206), last=(0.03, 0.254, 0.124), time=2.0),
    Move("up5", (5.5371, 0.2591), 0.6335, follow=(0.6541, -0.0218, 0.1769), time=1.5),
    Move("front7", (5.411, 0.2313), 0.8377, follow=(0.6901, 0.0, -0.0002),
         legs=FRONT, where=LEDGE, place=(0.557, 0.447),
         first=(0.0, 0.0, 0.15), last=(0.0, 0.0, 0.15), time=2.0),
    Move("middle11", (5.7659, 0.1767), 0.7026, follow=(0.673, -0.0329, 0.1885),
         legs=MIDDLE, where=LEDGE, place=(0.476, 0.045),
         first=(0.003, 0.329, 0.205), last=(-0.001, 0.189, 0.299), time=1.5),
    Move("up6", (5.8106, 0.1603), 0.7254, follow=(0.6903, -0.0323, 0.1976), time=1.5),
    Move("middle12", (5.8524, 0.1462), 0.7454, follow=(0.6933, -0.0488, 0.2468),
         legs=MIDDLE, rung=5, place=(0.66, 0.154),
         first=(0.056, 0.143, 0.315), last=(0.03, 0.245, 0.204), time=1.5),
    Move("rear10", (5.9441, 0.1233), 0.7834, follow=(0.4789, 0.0502, 0.1804), legs=(1,), rung=4, place=(0.478, 0.2),
         first=(0.032, 0.115, 0.246), last=(0.03, 0.252, 0.119), time=2.0),
    Move("rear11", (6.2704, 0.1353), 0.5536, follow=(0.7806, 0.0887, 0.1501), legs=(2,), rung=4, place=(0.465, 0.2),
         first=(0.123, 0.24, 0.101), last=(-0.085, 0.4, -0.031), time=2.0),
    Move("up7", (6.5504, 0.0512), 0.5043, follow=(0.6853, 0.1016, 0.0951), time=1.5),
    Move("middle13", (-0.0364, 0.1673), 0.7247, LEDGE, follow=(0.4999, -0.0002, 0.0003),
         legs=MIDDLE, where=LEDGE, place=(0.66, 0.045),
         first=(0.018, 0.217, 0.236), last=(0.03, 0.127, 0.336), time=1.5),
    Move("over1", (0.0594, 0.1703), 0.6426, LEDGE, follow=(0.3577, -0.0002, 0.3658), time=1.5),
    Move("rear12", (0.0642, 0.1883), 0.6691, LEDGE, follow=(0.208, -0.0091, 0.3761),
         legs=(1,), rung=5, place=(0.534, 0.199),
         first=(0.03, 0.1, 0.25), last=(0.03, 0.25, 0.12), time=2.0),
    Move("rear13", (0.1214, 0.3198), 0.6328, LEDGE, follow=(0.5, -0.0001, 0.0002),
         legs=(2,), rung=5, place=(0.534, 0.19),
         first=(0.025, 0.136, 0.255), last=(0.03, 0.246, 0.12), time=2.0),
    Move("middle14", (0.0874, 0.3144), 0.6992, LEDGE, follow=(0.7, 0.0, 0.0),
         legs=MIDDLE, where=LEDGE, place=(0.708, 0.205),
         first=(-0.034, 0.039, 0.12), last=(0.018, 0.05, 0.102), time=1.5),
    Move("front8", (0.1493, 0.3838), 0.5015, LEDGE, follow=(0.6, 0.0, 0.0),
         legs=FRONT, where=LEDGE, place=(0.536, 0.663),
         first=(0.033, -0.035, 0.16), last=(-0.003, 0.003, 0.15), time=1.5),
    Move("over2", (0.4, 0.32), 0.34, LEDGE, follow=(0.7, 0.0, 0.0), time=1.5),
    Move("rear14", (0.42, 0.335), 0.34, LEDGE, follow=(0.7, 0.0, 0.0), legs=REAR, where=LEDGE, place=(0.542, 0.045),
         first=(0.108, 0.183, 0.223), last=(0.072, 0.089, 0.344), time=1.5),
    Move("middle15", (0.366, 0.33), 0.352, LEDGE, follow=(1.0, 0.0, 0.0), legs=MIDDLE, where=LEDGE, place=(0.594, 0.55),
         first=(0.025, -0.029, 0.165), last=(0.044, -0.045, 0.183), time=1.5),
    Move("front9", (0.3968, 0.2943), 0.3324, LEDGE, follow=(1.0, 0.0, 0.0), legs=FRONT, where=LEDGE, place=(0.466, 1.0),
         first=(0.002, 0.025, 0.147), last=(-0.026, 0.059, 0.162), time=1.5),
    Move("over3", (0.6, 0.5), 0.0, LEDGE, follow=(1.0, 0.0, 0.0)),
)  # fmt: skip
